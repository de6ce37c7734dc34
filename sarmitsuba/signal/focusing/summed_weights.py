"""Sum of the pulses' weights over an image, at nodes with cubic splines between, and the noise predicted from it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F32, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.link_budget import snr
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import (
    DARK,
    direction_gain,
    ground_cell_area,
    look_directions,
    pulse_ranges,
)
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid

# nodes along azimuth and range at first; the first check doubles them
_FIRST = (33, 17)
# relative error power, at the places between nodes, below which these need no more nodes. A spline through them as well
# errs by a 16th of its amplitude where the sum is smooth, and by half, over half the width, at a bend
_ENOUGH, _AT_BENDS = 1e-8, 0.125
# nodes after which an axis is no longer divided: steps of sharply cut apertures stay
_MOST = 20_000


@dataclass(frozen=True, eq=False)
class SummedWeights:
    """Sum of the pulses' weights at nodes of an image.

    Parameters
    ----------
    nodes : m, places along azimuth (n,) and range (m,), as the axes of :class:`ImageGrid`
    sums : (n, m) float64
    error_power : of an image of noise divided by the interpolated sum, relative to its power
    """

    nodes: tuple[F64, F64]
    sums: F64
    error_power: float

    @property
    def least(self) -> float:
        """Smallest sum over the largest; 0 where all are zero."""
        most = float(self.sums.max())
        return float(self.sums.min()) / most if most > 0.0 else 0.0

    def at(self, grid: ImageGrid) -> F32:
        """Sums (n_azimuth, n_range) float32 in all pixels."""
        rows = _spline_along(self.nodes[0], self.sums, grid.azimuth, 0)
        unit = _spline_along(self.nodes[1], np.eye(self.nodes[1].size), grid.range, 0)
        return np.asarray(rows.astype(np.float32) @ unit.T.astype(np.float32))


def sum_at_nodes(grid: ImageGrid, sums: Callable[[ImageGrid], F64], most: int = _MOST) -> SummedWeights:
    r"""Sum of the pulses' weights at as many nodes as cubic splines between them need.

    Every axis is divided until the splines meet the sums at the places halfway, which then become nodes. In noise,
    where a pixel's power is one over its sum W, an error :math:`\delta` of the sum is one of the image of

    .. math:: \epsilon^2 = \frac{\sum (\delta / W)^2 / W}{\sum 1 / W}

    over the illuminated places, those of at least 1 % of the largest sum.

    Parameters
    ----------
    grid : image
    sums : function of a grid of nodes that gives the sums there, (n_azimuth, n_range)
    most : nodes above which no axis is divided further; the error then says how much is missing

    Notes
    -----
    Ignores errors between the checked places, which are closer than half of a node's distance.
    """
    nodes = [
        np.linspace(axis[0], axis[-1], n) if axis.size > 1 else np.asarray(axis[:1], dtype=np.float64)
        for axis, n in zip((grid.azimuth, grid.range), _FIRST, strict=True)
    ]
    values = sums(replace(grid, azimuth=nodes[0], range=nodes[1]))
    power = [0.0, 0.0]
    dividing = [axis for axis in (0, 1) if nodes[axis].size > 1]
    while dividing:
        for axis in tuple(dividing):
            halfway = 0.5 * (nodes[axis][1:] + nodes[axis][:-1])
            places = [halfway if other == axis else nodes[other] for other in (0, 1)]
            found = sums(replace(grid, azimuth=places[0], range=places[1]))
            error = _error_power(
                found, _spline_along(nodes[axis], values, halfway, axis) - found, float(values.max())
            )
            order = np.argsort(np.concatenate([nodes[axis], halfway]))
            values = np.concatenate([values, found], axis=axis).take(order, axis=axis)
            nodes[axis] = np.concatenate([nodes[axis], halfway])[order]
            power[axis] = _AT_BENDS * error
            if error <= _ENOUGH or 2 * values.size > most:
                dividing.remove(axis)
    return SummedWeights((nodes[0], nodes[1]), values, power[0] + power[1])


def _spline_along(nodes: F64, values: F64, places: F64, axis: int) -> F64:
    """Cubic splines along one axis of values at nodes; the value itself where there is one node."""
    if nodes.size == 1:
        return np.repeat(values, places.size, axis=axis)
    return np.asarray(scipy.interpolate.CubicSpline(nodes, values, axis=axis)(places))


def _error_power(sums: F64, wrong: F64, largest: float) -> float:
    """Relative error power of noise divided by sums that are wrong by ``wrong``."""
    lit = sums > DARK * largest
    if not lit.any():
        return 0.0
    inverse = 1.0 / sums[lit]
    return float(np.sum((wrong[lit] * inverse) ** 2 * inverse) / np.sum(inverse))


def noise_equivalent_rcs(radar: Radar, point: ArrayLike, weights: F64, range_window: str | Window) -> float:
    r"""Noise-equivalent radar cross section of a pixel, m^2: its peak power equals the mean noise power.

    A pulse with the weight w and the antenna's two-way amplitude g counts as W = w g^2 in the image, because its echo
    has the amplitude :math:`K g / R^2` and is multiplied by :math:`w g R^2 / K`; its noise, of the same power in every
    pulse, is multiplied too:

    .. math:: \sigma_n = \frac{\beta}{\mathrm{SNR}_1}
              \frac{\sum_t (W_t R_t^2 / g_t)^2}{R_0^4 \left(\sum_t W_t\right)^2}

    with SNR_1 that of 1 m^2 at boresight, at R_0, in one pulse, and beta the range window's noise-equivalent width in
    cells. The signal-to-noise ratio of a point of RCS sigma is :math:`\sigma / \sigma_n`.

    Parameters
    ----------
    radar : whose track, antenna, waveform and noise temperature count
    point : (3,) m, scene frame
    weights : (n_pulses,) W of every pulse at that point, as `Focused.pulse_weights` gives them
    range_window : over the band

    Raises
    ------
    RadarError
        The radar has no noise temperature.
    DataError
        No pulse illuminates the point.

    Notes
    -----
    Ignores the Fresnel ripple of the pulse's spectrum (about ``1 / sqrt(B T_p)``), quantisation and ambiguities.
    """
    distance = pulse_ranges(radar, point)
    gain = direction_gain(radar, slice(None), look_directions(radar, point))
    used = weights > 0.0
    if not used.any():
        raise DataError("link: no pulse illuminates the point; move it into the beam, or lengthen the track")
    near = float(distance[used].min())
    noise = float(np.sum((weights[used] / gain[used] * (distance[used] / near) ** 2) ** 2))
    one = snr(radar, 1.0, near, 1)
    return parse_window(range_window).broadening * noise / (one * float(weights.sum()) ** 2)


def noise_equivalent_sigma0(
    radar: Radar, point: ArrayLike, weights: F64, range_window: str | Window
) -> float:
    r"""Noise-equivalent sigma0 of flat ground, linear: its mean image power equals that of the noise.

    .. math:: \sigma^0_{ne} = \sigma_n / A

    with :func:`noise_equivalent_rcs` and the impulse response's area A on the ground,
    :func:`sarmitsuba.signal.focusing.aperture_weights.ground_cell_area`; arguments, errors and limits are
    theirs.
    """
    area = ground_cell_area(radar, np.asarray(point, dtype=np.float64), weights, range_window)
    return noise_equivalent_rcs(radar, point, weights, range_window) / area
