"""Energy-conserving diffuse law: Lambert-like scattering of the power lost by the coherent reflection."""

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface
from sarmitsuba.scene.materials.fresnel import fresnel


def shared_energy_sigma0(theta: F64, reflectivity: F64, rms_phase: float) -> F64:
    r"""Sigma0 of Lambert-like scattering of exactly the power that roughness removes from the coherent reflection.

    .. math::
        A(\theta) = |R(\theta)|^2 (1 - e^{-4 (k s \cos\theta)^2}), \quad
        \sigma^0(\theta_i, \theta_s) = 4 \cos\theta_i \cos\theta_s \frac{A(\theta_i) A(\theta_s)}{\bar A},
        \quad \bar A = 2 \int_0^{\pi/2} A \cos\theta \sin\theta\, d\theta

    Integrated over the hemisphere, this is the fraction ``A(theta_i)`` of the incident power for *every* incidence
    angle, and it is reciprocal; both hold because of the mean albedo in the denominator.

    Parameters
    ----------
    theta : (n,) equally spaced from 0 to pi/2, rad
    reflectivity : (n,) |R|^2
    rms_phase : k s
    """
    c = np.cos(theta)
    albedo = reflectivity * -np.expm1(-4.0 * (rms_phase * c) ** 2)
    mean = float(scipy.integrate.simpson(2.0 * albedo * c * np.sin(theta), x=theta))
    return 4.0 * c**2 * albedo**2 / mean if mean > 0.0 else np.zeros_like(theta)


class RoughnessLaw(DiffuseLaw):
    """Lambert's law with the power that the roughness factor removes from the specular direction, hh and vv each.

    Notes
    -----
    Conserves energy over all angles only: hh is above vv as in the specular wave, where measured surfaces have vv above
    hh, and there is no lobe about the mirror direction. `small_slope` has both.
    """

    name = "roughness"
    title = "Lambert's law with the power lost by the coherent reflection from rms_height; hh above vv"
    blocks_as_vacuum = False

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See `shared_energy_sigma0`."""
        rms_phase = 2.0 * np.pi / wavelength * surface.rms_height
        if surface.rms_height == 0.0:
            return Sigma0.none(theta)
        if surface.pec:
            sigma = shared_energy_sigma0(theta, np.ones_like(theta), rms_phase)
            return Sigma0(sigma, sigma)
        te, tm = fresnel(np.cos(theta), surface.permittivity)
        return Sigma0(
            shared_energy_sigma0(theta, np.abs(te) ** 2, rms_phase),
            shared_energy_sigma0(theta, np.abs(tm) ** 2, rms_phase),
        )


LAWS.register(RoughnessLaw())
