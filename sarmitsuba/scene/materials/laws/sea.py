"""Wind-roughened water: two-scale scattering from a spectrum of wind waves, with the motion of those waves."""

from functools import lru_cache

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Param
from sarmitsuba.scene.materials.diffuse_law import (
    LAWS,
    DiffuseLaw,
    Sigma0,
    Surface,
    WindWaves,
    permittivity_of,
)
from sarmitsuba.scene.materials.rough_surface import bragg_amplitudes
from sarmitsuba.scene.materials.sea_spectrum import SeaState

# cut-off of the two-scale model, share of the radar's wavenumber: longer waves tilt the shorter ones; a third to a
# fifth is usual
TILTING = 0.25
# nodes over either slope, and their range in standard deviations
_SLOPES, _REACH = 32, 4.0
# incidence angles of the integral, steps of a degree; tables are interpolated between them
_ANGLES = 91
# angles to the wind from which the even harmonics are computed
_AZIMUTHS = (0.0, 0.25 * np.pi, 0.5 * np.pi)
_SPECTRUM_NODES = 512


def two_scale_sigma0(
    sea: SeaState, wavenumber: float, permittivity: complex, longest: float, theta: F64, azimuth: float
) -> tuple[F64, F64]:
    r"""Two-scale backscatter (hh, vv): Bragg scattering by short waves tilted by longer ones, and specular facets.

    .. math::
        \sigma^0_{pp} = \int 16 \pi k^4 \cos^4\theta_l
        \bigl|\cos^2\chi\, \alpha_{pp} + \sin^2\chi\, \alpha_{qq}\bigr|^2 \Psi(\mathbf K)
        \sqrt{1 + z^2}\, p(z_x, z_y)\, d^2z
        + \frac{\pi |R(0)|^2}{\cos^4\theta} e^{-4 k^2 s^2} p(z_x = -\tan\theta, 0)

    with the local incidence angle :math:`\theta_l`, the rotation :math:`\chi` of the local plane of incidence, the
    Bragg wave vector :math:`\mathbf K`, of length :math:`2 k \sin\theta_l`, along the facet, Gaussian slopes z of the
    waves between ``longest`` and ``TILTING`` k, and the height s of all shorter ones.

    Parameters
    ----------
    sea : spectrum
    wavenumber : k of the radar, rad/m
    permittivity : of the water
    longest : rad/m, least wavenumber of tilting waves; longer waves are traced as geometry
    theta : (n,) rad
    azimuth : angle between look and wind direction, rad

    References
    ----------
    Valenzuela, Boundary-Layer Meteorol. 13 (1978), 61-85, equations 4.1 to 4.3; Valenzuela's spectrum is four times
    this one's. Mirroring facets: Barrick, IEEE Trans. AP 16 (4) 1968.
    """
    split = TILTING * wavenumber
    tilt, short = sea.moments(longest, split), sea.moments(split)
    c, s = np.cos(azimuth), np.sin(azimuth)
    # axes of the look: x to the radar; slopes along and across the wind are independent
    nodes = np.linspace(-_REACH, _REACH, _SLOPES)
    weight = np.exp(-0.5 * nodes**2)
    weight /= weight.sum()
    zu, zc = (np.sqrt(v) * nodes for v in (tilt.slope_u, tilt.slope_c))
    zu, zc, p = zu[:, None], zc[None, :], weight[:, None] * weight
    zx, zy = (part.reshape(-1)[:, None] for part in (zu * c + zc * s, zc * c - zu * s))
    sin, cos = np.sin(theta), np.cos(theta)
    stretch = np.sqrt(1.0 + zx**2 + zy**2)
    cos_l = (cos - zx * sin) / stretch
    lit = cos_l > 0.0
    cos_l = np.clip(cos_l, 1e-6, 1.0)
    # line of sight projected onto the facet, seen from above: direction of the Bragg waves
    kx, ky = sin + zx * cos_l / stretch, zy * cos_l / stretch
    # the vertical plane of incidence and the facet's
    turned = np.square(zy) / np.maximum(np.square(zx * cos + sin) + np.square(zy), 1e-30)
    along, across = kx * c - ky * s, kx * s + ky * c
    twice = (along**2 - across**2) / np.maximum(along**2 + across**2, 1e-30)
    alpha_h, alpha_v = bragg_amplitudes(cos_l, permittivity)
    waves = 2.0 * wavenumber * np.sqrt(1.0 - cos_l**2)
    density = _density(sea, wavenumber, waves, twice) * (waves > split) * lit
    level = 16.0 * np.pi * wavenumber**4 * density * stretch * p.reshape(-1)[:, None]
    h, v = (
        np.sum(level * np.abs((1.0 - turned) * a + turned * b) ** 2, axis=0)
        for a, b in ((alpha_h, alpha_v), (alpha_v, alpha_h))
    )
    mirrored = _specular_return(
        tilt.slope_u, tilt.slope_c, short.height, wavenumber, permittivity, theta, azimuth
    )
    return h + mirrored, v + mirrored


def _density(sea: SeaState, wavenumber: float, waves: F64, twice: F64) -> F64:
    """Spectrum at the wave vectors, interpolated for speed."""
    grid = np.geomspace(TILTING * wavenumber, 2.0 * wavenumber, _SPECTRUM_NODES)
    at = np.log(np.maximum(waves, grid[0]))
    level, spread = sea.density(grid, 0.0), sea.spreading(grid)
    return np.asarray(
        np.exp(np.interp(at, np.log(grid), np.log(np.maximum(level, 1e-300))))
        * (1.0 + np.interp(at, np.log(grid), spread) * twice)
    )


def _specular_return(
    slope_u: float, slope_c: float, short: float, k: float, permittivity: complex, theta: F64, azimuth: float
) -> F64:
    """Specular return of facets facing the radar."""
    if min(slope_u, slope_c) <= 0.0:
        return np.zeros_like(theta)
    root = np.sqrt(permittivity)
    reflectivity = abs((1.0 - root) / (1.0 + root)) ** 2 * np.exp(-4.0 * k**2 * short)
    cos = np.maximum(np.cos(theta), 1e-3)
    exponent = -0.5 * np.tan(np.minimum(theta, 1.55)) ** 2
    exponent = exponent * (np.cos(azimuth) ** 2 / slope_u + np.sin(azimuth) ** 2 / slope_c)
    return np.asarray(reflectivity * np.exp(exponent) / (2.0 * np.sqrt(slope_u * slope_c) * cos**4))


@lru_cache(maxsize=64)
def _harmonics(sea: SeaState, wavenumber: float, permittivity: complex, longest: float) -> F64:
    """Mean level and relative second and fourth harmonic over the azimuth, (3, 2, _ANGLES): the last for h and v."""
    theta = np.linspace(0.0, 0.5 * np.pi, _ANGLES)
    up, between, cross = (
        np.array(two_scale_sigma0(sea, wavenumber, permittivity, longest, theta, azimuth))
        for azimuth in _AZIMUTHS
    )
    mean = 0.25 * (up + 2.0 * between + cross)
    some = np.maximum(mean, 1e-300)
    return np.array([mean, 0.5 * (up - cross) / some, 0.25 * (up + cross - 2.0 * between) / some])


class Sea(DiffuseLaw):
    r"""Water under wind: the two-scale model with the spectrum of Elfouhaily et al., and its motion.

    Waves longer than ``shortest_drawn_wave`` are one realisation of single waves: they tilt the surface and displace
    the scatterers. All shorter ones are in the level: see `two_scale_sigma0`.

    Notes
    -----
    Upwind and downwind are the same; C-band scatterometers see up to 2 dB between them. Ignores breaking waves and
    foam (hh is too low beyond 50 deg), scattering that changes polarisation (the material's cross-polar ratio is
    applied), and shadowing by waves.
    """

    name = "sea"
    title = "water under wind: Bragg waves tilted by longer ones, mirroring facets; moving"
    temporal_coherence = 0.0  # decorrelates within seconds
    parameters = (
        Param("wind_speed", "float", 5.0, "wind speed at 10 m", "m/s", 0.5, 40.0),
        Param(
            "wind_direction_deg",
            "float",
            0.0,
            "origin of the wind, clockwise from north",
            "deg",
            -360.0,
            360.0,
        ),
        Param(
            "fetch",
            "float",
            1e7,
            "fetch; a long one gives a fully developed sea",
            "m",
            10.0,
            1e7,
        ),
        Param(
            "shortest_drawn_wave",
            "float",
            4.0,
            "waves longer than this are realised one by one; shorter ones are in the level and the random velocities",
            "m",
            0.5,
            1e4,
        ),
    )

    def sea(self, surface: Surface) -> SeaState:
        """Spectrum of the waves."""
        return SeaState(surface.law_parameter("wind_speed"), surface.law_parameter("fetch"))

    def implied_rms_height(self, surface: Surface) -> float:
        """Rms height of all waves: nearly a mirror only in calm wind."""
        return float(np.sqrt(self.sea(surface).moments().height))

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """Mean over all directions of the wind; see `two_scale_sigma0`."""
        mean = self._harmonics(surface, wavelength)[0]
        h, v = (np.square(_interpolate_row(theta, np.sqrt(row))) for row in mean)
        speed, notes = surface.law_parameter("wind_speed"), []
        if speed < 3.0:
            notes.append(
                f"wind_speed = {speed:g} m/s is below 3 m/s, where the spectrum's short waves vanish; use "
                "small_slope for calm water"
            )
        if speed > 25.0:
            notes.append(
                f"wind_speed = {speed:g} m/s is above 25 m/s, where breaking waves dominate; lower it"
            )
        return Sigma0(h, v, 0.0, np.radians(65.0), tuple(notes))

    def wind_waves(self, surface: Surface, wavelength: float, theta: F64, seed: int) -> WindWaves:
        """Contrast over the azimuth, random velocities, and the realisation of long waves."""
        second, fourth = self._harmonics(surface, wavelength)[1:]
        sea, split = self.sea(surface), 2.0 * np.pi / surface.law_parameter("shortest_drawn_wave")
        # compass bearing of the wind's origin: it blows to the opposite side
        bearing = np.radians(surface.law_parameter("wind_direction_deg"))
        downwind = -np.array([np.sin(bearing), np.cos(bearing)])
        short = sea.moments(split)
        return WindWaves(
            downwind=downwind,
            contrast=np.stack([_interpolate_row(theta, row) for row in (*second, *fourth)], axis=1),
            speeds=np.sqrt([short.speed_u, short.speed_c, short.speed_u + short.speed_c]),
            waves=sea.drawn(split, downwind, seed),
        )

    def _harmonics(self, surface: Surface, wavelength: float) -> F64:
        longest = 2.0 * np.pi / surface.law_parameter("shortest_drawn_wave")
        return _harmonics(
            self.sea(surface), 2.0 * np.pi / wavelength, complex(permittivity_of(surface)), longest
        )


def _interpolate_row(theta: F64, row: F64) -> F64:
    """Values at other angles (rad) of those at steps of a degree."""
    return np.interp(theta, np.linspace(0.0, 0.5 * np.pi, _ANGLES), row)


LAWS.register(Sea())
