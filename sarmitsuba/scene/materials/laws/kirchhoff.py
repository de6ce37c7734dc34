"""Kirchhoff model in the limit of geometrical optics: specular facets of random slope."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface, correlation_length_of
from sarmitsuba.scene.materials.fresnel import fresnel

# rms slopes for which geometrical optics is evaluated: smaller ones are a mirror, larger ones have no return
_SLOPES = (1e-6, 1e6)


def geometrical_optics_sigma0(theta: F64, normal_reflectivity: float, slope: float) -> F64:
    r"""Kirchhoff model in the stationary-phase (geometrical optics) limit, the same for hh and vv.

    .. math:: \sigma^0 = \frac{|R(0)|^2 e^{-\tan^2\theta / (2 m^2)}}{2 m^2 \cos^4\theta}

    ``slope`` is m, the rms slope along one direction. Source: Ulaby, Moore and Fung, Microwave Remote
    Sensing, volume II (1982), chapter 12.
    """
    c = np.maximum(np.cos(theta), 1e-12)
    m2 = float(np.clip(slope, *_SLOPES)) ** 2
    exponent = -((np.sin(theta) / c) ** 2) / (2.0 * m2) - 4.0 * np.log(c)
    return np.asarray(normal_reflectivity * np.exp(exponent) / (2.0 * m2))


class Kirchhoff(DiffuseLaw):
    """Tilted facets, Gaussian correlation ``exp(-r^2/l^2)``: very rough, gently sloping surfaces.

    Between two directions ``|R(0)|^2`` is replaced by the Fresnel coefficients of the facet that mirrors one into the
    other, in that facet's plane of incidence.
    """

    name = "kirchhoff"
    title = "geometrical optics of tilted facets: a lobe about the vertical, for very rough surfaces"
    needs = ("rms_height", "correlation_length")
    bistatic = "facets"

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See `geometrical_optics_sigma0`."""
        length = correlation_length_of(surface, self.name)
        k, s = 2.0 * np.pi / wavelength, surface.rms_height
        if s == 0.0:
            return Sigma0.none(theta)
        slope = np.sqrt(2.0) * s / length
        notes = []
        largest_cos = np.sqrt(10.0) / (2.0 * k * s)  # (2 k s cos)^2 > 10
        if largest_cos > 1.0:
            notes.append(
                f"(2 k s)^2 = {(2 * k * s) ** 2:.3g} is below 10, not rough enough for geometrical optics; "
                "use iem or small_perturbation"
            )
        if k * length < 6.0:
            notes.append(f"k l = {k * length:.3g} is below 6; use iem")
        if length**2 < 2.76 * s * wavelength:
            notes.append(
                f"l^2 = {length**2:.3g} m^2 is below 2.76 s lambda = {2.76 * s * wavelength:.3g} m^2, too strongly "
                "curved for the tangent-plane approximation; use iem"
            )
        if slope < 2.0 * (theta[1] - theta[0]):
            notes.append(
                f"rms slope {slope:.3g} gives a lobe narrower than two steps of the table, "
                f"{2 * np.degrees(theta[1]):.2g} deg; "
                "raise rms_height, shorten correlation_length or use no diffuse law"
            )
        reflectivity = 1.0 if surface.pec else float(np.abs(fresnel(1.0, surface.permittivity)[0]) ** 2)
        sigma = geometrical_optics_sigma0(theta, reflectivity, slope)
        return Sigma0(sigma, sigma, 0.0, float(np.arccos(min(1.0, largest_cos))), tuple(notes))


LAWS.register(Kirchhoff())
