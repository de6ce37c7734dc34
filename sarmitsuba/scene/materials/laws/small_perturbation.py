"""First-order small-perturbation model: Bragg scattering of slightly rough surfaces."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.diffuse_law import (
    LAWS,
    DiffuseLaw,
    Sigma0,
    Surface,
    correlation_length_of,
    permittivity_of,
)
from sarmitsuba.scene.materials.rough_surface import Correlation, bragg_factors, roughness_spectrum


def small_perturbation_sigma0(
    theta: F64,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
    correlation: Correlation = "exponential",
) -> tuple[F64, F64]:
    r"""First-order small-perturbation model, hh and vv.

    .. math::
        \sigma^0_{pp} = 8 k^4 s^2 \cos^4\theta |\alpha_{pp}|^2 W(2 k \sin\theta), \quad
        \alpha_{hh} = R_{TE}, \quad
        \alpha_{vv} = (\varepsilon - 1) \frac{\sin^2\theta - \varepsilon (1 + \sin^2\theta)}
        {(\varepsilon \cos\theta + q)^2}

    Source: Ulaby, Moore and Fung, Microwave Remote Sensing, volume II (1982), chapter 12. W as in
    ``roughness_spectrum`` with n = 1.
    """
    common = bragg_spectrum(np.sin(theta), wavenumber, rms_height, correlation_length, correlation)
    h, v = bragg_factors(theta, permittivity)
    return common * h, common * v


def bragg_spectrum(
    sine: F64,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
    correlation: Correlation = "exponential",
) -> F64:
    """First-order sigma0 over its polarisation factor, ``8 k^4 s^2 W(2 k sine)``, for any pair of directions."""
    first = np.ones(1)
    spectrum = [
        roughness_spectrum(first, 2.0 * wavenumber * float(x), correlation_length, correlation)[0]
        for x in sine
    ]
    return np.asarray(8.0 * wavenumber**4 * rms_height**2 * np.array(spectrum))


class SmallPerturbation(DiffuseLaw):
    """First-order perturbation theory, exponential correlation; vv above hh; without the quasi-specular lobe."""

    name = "small_perturbation"
    title = "Bragg scattering of slightly rough surfaces, vv above hh"
    needs = ("rms_height", "correlation_length")
    bistatic = "spectrum"

    def spectrum(self, surface: Surface, wavelength: float, sine: F64, cosine: F64) -> F64:
        """See `bragg_spectrum`: to first order the heights' phase does not enter."""
        length = correlation_length_of(surface, self.name)
        one = bragg_spectrum(sine, 2.0 * np.pi / wavelength, surface.rms_height, length)
        return np.broadcast_to(one, (cosine.size, sine.size)).copy()

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See `small_perturbation_sigma0`."""
        length = correlation_length_of(surface, self.name)
        k, s = 2.0 * np.pi / wavelength, surface.rms_height
        if s == 0.0:
            return Sigma0.none(theta)
        slope = np.sqrt(2.0) * s / length
        notes = []
        if k * s > 0.3:
            notes.append(f"k s = {k * s:.3g} is above 0.3; use iem, or kirchhoff for a very rough surface")
        if slope > 0.3:
            notes.append(f"rms slope {slope:.3g} is above 0.3; lengthen correlation_length")
        sigma_h, sigma_v = small_perturbation_sigma0(theta, permittivity_of(surface), k, s, length)
        return Sigma0(sigma_h, sigma_v, np.radians(15.0), np.radians(75.0), tuple(notes))


LAWS.register(SmallPerturbation())
