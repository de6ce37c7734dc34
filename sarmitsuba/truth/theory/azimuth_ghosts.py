"""Azimuth ambiguities of points: positions and levels of ghosts."""

import numpy as np

from sarmitsuba.truth.theory.antenna_gain import Gain, off_boresight

_NODES = 4001


def azimuth_ghost(
    wavelength: float, slant_range: float, prf: float, speed: float, order: int = 1, sin_squint: float = 0.0
) -> tuple[float, float]:
    r"""Position of the azimuth ambiguity of a point, relative to the point: along the track and in closest range, m.

    In the beam's centre the ghost has the point's range R, and a Doppler frequency higher by k PRF:

    .. math:: \Delta x = \frac{k \lambda R f_p}{2 v}, \quad
              \Delta\rho = R (\sqrt{1 - s_g^2} - \sqrt{1 - s^2}), \quad s = s_g - \frac{k \lambda f_p}{2 v}

    Parameters
    ----------
    wavelength, slant_range : lambda, R, m; the range is that at the pulse where the ghost is in the beam's centre
    prf, speed : Hz and m/s along a straight track
    order : k, any whole number but 0
    sin_squint : s_g, sine of the beam's centre along the flight

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    step = order * wavelength * prf / (2.0 * speed)
    closer = np.sqrt(1.0 - sin_squint**2) - np.sqrt(1.0 - (sin_squint - step) ** 2)
    return slant_range * step, slant_range * float(closer)


def azimuth_ghost_level(
    gain: Gain,
    wavelength: float,
    slant_range: float,
    prf: float,
    speed: float,
    bandwidth: float,
    order: int = 1,
    *,
    range_cell: float = np.inf,
    squint: float = 0.0,
    pointing_error: float = 0.0,
) -> float:
    r"""Power of the azimuth ambiguity of a point in a stripmap image relative to the point, at the ghost's centre.

    .. math:: \left| \frac{\int g(s) g'(s - k \lambda f_p / 2 v) \,\mathrm{sinc}(D / \delta_r)
              e^{-j 4 \pi (D - D' x) / \lambda} dx}{\int g(s) g'(s) dx} \right|^2

    over the positions x along the track whose direction s to the ghost lies in the processed band: g the nominal and g'
    the true relative one-way power gain, D the difference of the ranges to point and ghost, 0 in the middle. Where D
    stays within the range cell this is the textbooks' ratio of two-way patterns.

    Parameters
    ----------
    gain : over the sine off boresight
    wavelength, slant_range, prf, speed, order : as for :func:`azimuth_ghost`
    bandwidth : processed Doppler bandwidth, Hz
    range_cell : delta_r, of a flat spectrum, m
    squint : of the nominal boresight, rad
    pointing_error : true less nominal boresight in azimuth, rad

    Notes
    -----
    Ignores windows, and the difference of the gain in elevation between point and ghost.
    """
    step = order * wavelength * prf / (2.0 * speed)
    half = 0.25 * wavelength * bandwidth / speed
    center = float(np.sin(squint))
    edges = np.clip(center + half * np.array([-1.0, 1.0]), -0.999, 0.999)
    ahead, closest = slant_range * center, slant_range * np.sqrt(1.0 - center**2)
    # antenna's place along the track, 0 where the ghost is in the beam's centre
    ends = ahead - closest * np.tan(np.arcsin(edges))
    x = np.linspace(ends[0], ends[1], _NODES)
    to_ghost = np.hypot(ahead - x, closest)
    seen = center - step
    to_point = np.hypot(slant_range * seen - x, slant_range * np.sqrt(1.0 - seen**2))
    nominal = gain(off_boresight((ahead - x) / to_ghost, squint))
    true = gain(off_boresight((slant_range * seen - x) / to_point, squint + pointing_error))
    own = gain(off_boresight((ahead - x) / to_ghost, squint + pointing_error))
    apart = to_point - to_ghost
    turn = np.exp(-4j * np.pi / wavelength * (apart - step * x))
    ghost = np.sum(nominal * true * np.sinc(apart / range_cell) * turn)
    return float(abs(ghost) ** 2 / np.sum(nominal * own) ** 2)
