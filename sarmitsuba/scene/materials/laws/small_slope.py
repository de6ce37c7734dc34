"""Small-slope approximation: Bragg scattering, and the lobe about the specular direction."""

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.materials.diffuse_law import (
    LAWS,
    DiffuseLaw,
    Sigma0,
    Surface,
    correlation_length_of,
    permittivity_of,
)
from sarmitsuba.scene.materials.rough_surface import bragg_factors, roughness_spectrum

# Largest k s of the series, whose length grows with (k s)^2
_LARGEST_ROUGHNESS = 100.0
# Poisson weights further than this many standard deviations from the mean are below float64 rounding
_SERIES_WIDTH = 10.0


def small_slope_spectrum(
    sine: F64, cosine: F64, wavenumber: float, rms_height: float, correlation_length: float
) -> F64:
    r"""Sigma0 over the polarisation factor of first-order theory, in the small-slope approximation.

    .. math::
        G = 8 k^4 \frac{e^{-Q^2 s^2}}{Q^2} \sum_{n \ge 1} \frac{(Q s)^{2n}}{n!} W^{(n)}(K), \quad
        K = |k_{s\perp} - k_{i\perp}|, \quad Q = k (\cos\theta_i + \cos\theta_s), \quad
        \sigma^0_{pq} = G |\cos\theta_i \cos\theta_s\, \alpha_{pq}|^2

    With ``Q s`` small only n = 1 is left, first-order perturbation theory. A surface of long correlation scatters the
    power lost by the coherent wave, ``1 - exp(-(2 k s cos)^2)``, into the lobe about the specular direction.

    Parameters
    ----------
    sine : (n,) K / (2 k), 0 to 1: the sine of the incidence angle in backscatter
    cosine : (m,) Q / (2 k), 0 to 1: its cosine in backscatter
    wavenumber : k, rad/m
    rms_height, correlation_length : s and l, m; correlation exp(-r / l)

    Returns
    -------
    (m, n) float64
    """
    k, s = wavenumber, rms_height
    out = np.empty((cosine.size, sine.size))
    for row, c in enumerate(np.maximum(cosine, 1e-9)):
        phase2 = (2.0 * k * s * c) ** 2
        spread = _SERIES_WIDTH * np.sqrt(phase2) + _SERIES_WIDTH**2
        first = max(1, int(phase2 - spread))
        n = np.arange(first, int(phase2 + spread) + 1, dtype=np.float64)
        # (Q s)^2n e^-(Q s)^2 / n! over Q^2, with s^2 of the first order taken out: no 0/0 at grazing
        weight = s * s * np.exp((n - 1.0) * np.log(phase2) - scipy.special.gammaln(n + 1.0) - phase2)
        kept = weight > 1e-17 * weight.max()
        spectra = roughness_spectrum(n[kept], 2.0 * k * sine[:, None], correlation_length, "exponential")
        out[row] = [8.0 * k**4 * float(weight[kept] @ spectrum) for spectrum in spectra]
    return out


class SmallSlope(DiffuseLaw):
    r"""First small-slope approximation, exponential correlation: the law of ordinary rough materials.

    Backscatter and bistatic scattering are one formula, see `small_slope_spectrum`, with the polarisation factor of
    first-order perturbation theory: vv is above hh at every angle, as measured on slightly rough surfaces.

    Notes
    -----
    Ignores scattering that changes polarisation in backscatter, shadowing by the roughness, and that the
    ratio of vv to hh falls towards one as the surface grows rough (k s above 1): there use ``iem``.

    References
    ----------
    Voronovich, Wave Scattering from Rough Surfaces (1999), chapter 6 (first-order approximation); Elfouhaily and
    Guerin, Waves in Random Media 14 (2004), R1-R40.
    """

    name = "small_slope"
    title = "Bragg scattering and the lobe about the mirror direction, vv above hh"
    needs = ("rms_height", "correlation_length")
    bistatic = "spectrum"

    def spectrum(self, surface: Surface, wavelength: float, sine: F64, cosine: F64) -> F64:
        """See `small_slope_spectrum`."""
        k, s = 2.0 * np.pi / wavelength, surface.rms_height
        length = correlation_length_of(surface, self.name)
        if k * s < 1e-12:  # returns less than -240 dB
            return np.zeros((cosine.size, sine.size))
        if k * s > _LARGEST_ROUGHNESS:
            raise SceneError(
                f'material "{surface.name}": rms_height = {s:g} m is k s = {k * s:.3g}, above '
                f"{_LARGEST_ROUGHNESS:g}, where the small-slope series is invalid; set diffuse_law to kirchhoff or "
                "lambert"
            )
        return small_slope_spectrum(sine, cosine, k, s, length)

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """Backscatter: K = 2 k sin, Q = 2 k cos."""
        length = correlation_length_of(surface, self.name)
        k, s = 2.0 * np.pi / wavelength, surface.rms_height
        if s == 0.0:
            return Sigma0.none(theta)
        notes = []
        if s / length > 0.4:
            notes.append(
                f"s / l = {s / length:.3g} is above 0.4, multiple scattering matters; lengthen correlation_length"
            )
        if k * s > 1.0:
            notes.append(f"k s = {k * s:.3g} is above 1, where hh rises towards vv; use iem")
        one = np.stack([self.spectrum(surface, wavelength, np.sin([t]), np.cos([t]))[0, 0] for t in theta])
        h, v = bragg_factors(theta, permittivity_of(surface))
        return Sigma0(one * h, one * v, 0.0, np.radians(75.0), tuple(notes))


LAWS.register(SmallSlope())
