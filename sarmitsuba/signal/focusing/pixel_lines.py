"""Lines of pixels along azimuth, one per lane of the compiled backprojection, and their largest length."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import flight
from sarmitsuba.signal.focusing.profiles import ProfilePlan
from sarmitsuba.signal.image.sar_image import ImageGrid

LONGEST_LINE = 32
# line length where every pixel is interpolated: longer lines save no time
_LONGEST_DIRECT = 8
# bound of the expansion's phase error, rad: -106 dB at the worst pixel and pulse, far below the best interpolation's
# error
_PHASE_ERROR = 5e-6
# bound of the relative error of the weights, which vary by less than a beam or a band over the line
_WEIGHT_ERROR = 3e-5
# terms of a power series: those left out are below 1e-9 where fewer nodes than pixels suffice
_SERIES = 40
# more nodes would cost more than shorter lines
_MOST_NODES = 12
# pixels per line and nodes are literals of the kernel: few values of both, so that compiled kernels are reused
_LINES = (1, _LONGEST_DIRECT, LONGEST_LINE)
_NODES = (4, 6, 8, 10, _MOST_NODES)
# bound of the polynomial's error between nodes, as a share of the interpolation kernel's largest error
_NODE_ERROR = 0.5
# but at least the rounding error of float32
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class PixelLines:
    """Pixels of one launch.

    Parameters
    ----------
    index : (pixels per line, lanes) places in the flat image, -1 for padding
    middle : (lanes, 3) m, positions of the pixels ``pixels per line // 2``
    step : (3,) m, from one pixel of a line to the next
    n_nodes : places per line where the profiles are interpolated, see :func:`plan_line`
    checked : whether a pixel, padding included, may be outside a pulse's receive window
    """

    index: I64
    middle: F64
    step: F64
    n_nodes: int = 1
    checked: bool = True


def expansion_error(radar: Radar, near: float, half: float, cubic: float) -> tuple[float, float]:
    r"""Error bounds of the expansions over ``half`` metres on either side at ranges of at least ``near``.

    With s the sine between the line of pixels and the line of sight's normal plane, the range's terms past its parabola
    are :math:`h^3 s (1 - s^2) / 2 R^2` and at most :math:`h^4 / 8 R^3`; ``cubic`` is the largest :math:`s (1 - s^2)`, 0
    where the expansion includes the third order. A weight that is a function of the sine with a scale of :math:`\delta`
    (beam or band) loses :math:`(\pi h / R \delta)^3 / 9 \sqrt 3`, the cubic remainder of an interpolated sine wave.

    Returns
    -------
    phase, rad, and relative error of the weights
    """
    if near <= 4.0 * half:
        return np.inf, np.inf
    # a half more for all the orders that follow, each below a quarter of the one before
    loss = cubic * half**3 / (2.0 * near**2) + 1.5 * half**4 / (8.0 * near**3)
    phase = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT * loss
    scales = [] if np.isinf(radar.half_aperture) else [1.0 / (2.0 * radar.half_aperture)]
    if radar.antenna.directive:
        scales += list(radar.antenna.per_width)
    weight = (np.pi * half / near * max(scales, default=0.0)) ** 3 / (9.0 * np.sqrt(3.0))
    return float(phase), float(weight)


def nodes_needed(kappa: float, bend: float, tolerance: float) -> int | None:
    r"""Least number k of Chebyshev points for polynomial interpolation of the echo over a line.

    The echo is :math:`e^{j (\kappa x + b x^2)}`, :math:`|x| \le 1`, whose power series has coefficients of at most
    :math:`c_n = \sum_{i + 2 q = n} \kappa^i b^q / i! q!`. Of :math:`x^n = 2^{1 - n} \sum_m \binom{n}{(n - m) / 2} T_m`
    the polynomial misses :math:`T_k`, zero at all points, and at most twice every :math:`T_m`, m > k.

    Parameters
    ----------
    kappa : phase of the band's edge at the line's end, from its middle, rad
    bend : phase that the range's curvature adds there, rad
    tolerance : on the error so bounded

    Returns
    -------
    None where more than ``_MOST_NODES`` were needed
    """
    if max(kappa, bend) > _SERIES:  # any term of the series is then larger than any tolerance
        return None
    order = np.arange(_SERIES)
    bends = np.zeros(_SERIES)
    bends[::2] = _power_terms(bend)[: bends[::2].size]
    series = np.convolve(_power_terms(kappa), bends)[order]
    enough = np.flatnonzero(_missed() @ series <= tolerance)
    return int(enough[0]) + 1 if enough.size else None


def _power_terms(x: float) -> F64:
    """Terms (``_SERIES``,) of the exponential's power series, :math:`x^n / n!`."""
    return np.cumprod(np.concatenate([[1.0], x / np.arange(1, _SERIES)]))


@cache
def _missed() -> F64:
    """Share (``_MOST_NODES``, ``_SERIES``) of the n-th power that a polynomial through k = 1, 2, ... points misses."""
    share = np.zeros((_MOST_NODES, _SERIES))
    for k in range(1, _MOST_NODES + 1):
        for n in range(k, _SERIES):
            terms = (comb(n, (n - m) // 2) * (1 if m == k else 2) for m in range(n, k - 1, -2))
            share[k - 1, n] = 2.0 ** (1 - n) * sum(terms)
    return share


def plan_line(radar: Radar, plan: ProfilePlan, grid: ImageGrid, checked: bool = False) -> tuple[int, int]:
    """Pixels per line and interpolation nodes with the least work.

    Ranges and weights are parabolas within the bounds; between the nodes the profiles' error is below that of their
    interpolation kernel at the band's edge. ``checked`` samples are tested pixel by pixel, without nodes.
    """
    if radar.receiver is not None:  # bistatic: two ranges, not expanded
        return 1, 1
    near = float(_range_bounds(grid, grid.azimuth[[0, -1]], radar.track.position)[0].min())
    steepest = _steepest(radar, grid)
    s = min(steepest, 1.0 / np.sqrt(3.0))  # maximum of s (1 - s^2)
    cubic = s * (1.0 - s * s)
    per_metre = steepest * np.pi * radar.waveform.bandwidth * 2.0 / SPEED_OF_LIGHT
    best, cost = (1, 1), np.inf
    for n in _LINES:
        half = 0.5 * n * grid.azimuth_spacing
        bend = 2.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT * half**2 / near
        k = nodes_needed(per_metre * half, bend, max(_NODE_ERROR * plan.kernel_error, _ROUNDING))
        k = None if k is None else next(few for few in _NODES if few >= k)
        direct = checked or k is None or k >= n
        phase, weight = expansion_error(radar, near, half, cubic if direct else 0.0)
        if n > 1 and (phase > _PHASE_ERROR or weight > _WEIGHT_ERROR or (direct and n > _LONGEST_DIRECT)):
            continue
        k = n if k is None or direct else k
        # in units of one float32 operation: of the line, of a node, of a pixel
        work = (100.0 + k * (12.0 * plan.width + 10.0)) / n + (6.0 + k if k < n else 14.0)
        if work < cost:
            best, cost = (n, k), work
    return best


def _steepest(radar: Radar, grid: ImageGrid) -> float:
    """Largest change of the range per metre along azimuth, over all pixels and the pulses that serve them."""
    across = grid.across_distance()[[0, -1]]
    line = radar.track.position - grid.origin
    a, c = line @ grid.along, line @ grid.across
    ahead = np.maximum(np.abs(a - grid.azimuth[0]), np.abs(a - grid.azimuth[-1]))
    aside = np.hypot(c - np.clip(c, across[0], across[1]), radar.track.position[:, 2] - grid.height)
    steepest = ahead / np.maximum(np.hypot(ahead, aside), 1e-30)
    if np.isfinite(radar.half_aperture):
        forward, center, gap = flight(radar)
        # pulses outside a pixel's own band have weight zero; the grid's azimuth may be inclined to the flight
        askew = np.linalg.norm(forward - grid.along, axis=1)
        steepest = np.minimum(
            steepest, np.abs(center) + radar.half_aperture + askew + gap / np.maximum(aside, gap)
        )
    return float(steepest.max())


def grid_lines(radar: Radar, plan: ProfilePlan, grid: ImageGrid, tile_pixels: int) -> Iterator[PixelLines]:
    """Cut a grid into launches; lines run along azimuth, neighbouring lanes along range."""
    checked = may_leave_window(radar, grid)
    per_line, n_nodes = plan_line(radar, plan, grid, checked)
    n_azimuth, n_range = grid.shape
    flat = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
    rows = max(per_line, tile_pixels // n_range // per_line * per_line)
    across = grid.across_distance()[None, :, None] * grid.across
    for start in range(0, n_azimuth, rows):
        n_lines = -(-min(rows, n_azimuth - start) // per_line)
        row = start + np.arange(n_lines * per_line).reshape(n_lines, per_line)
        index = row[:, :, None] * n_range + np.arange(n_range)
        index[row >= n_azimuth] = -1
        along = grid.azimuth[0] + row * grid.azimuth_spacing
        middle = flat + along[:, per_line // 2, None, None] * grid.along + across
        yield PixelLines(
            index.transpose(1, 0, 2).reshape(per_line, -1),
            middle.reshape(-1, 3),
            grid.azimuth_spacing * grid.along,
            n_nodes,
            checked,
        )


def point_lines(points: ArrayLike, tile_pixels: int) -> Iterator[PixelLines]:
    """Cut a list of points into launches, one pixel per lane."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"backprojection: points have the shape {points.shape}, (n, 3) is needed")
    for start in range(0, points.shape[0], tile_pixels):
        pick = np.arange(start, min(start + tile_pixels, points.shape[0]))
        yield PixelLines(pick[None], points[pick], np.zeros(3))


def may_leave_window(radar: Radar, grid: ImageGrid) -> bool:
    """Whether a pixel of the grid, padding included, may be outside a pulse's receive window."""
    if radar.receiver is not None:
        return True
    padded = grid.azimuth[0], grid.azimuth[-1] + LONGEST_LINE * grid.azimuth_spacing
    return not _within(radar, *_range_bounds(grid, np.array(padded), radar.track.position))


def _within(radar: Radar, near: F64, far: F64) -> bool:
    """Whether ranges between bounds (n_pulses,) lie within every pulse's receive window."""
    start, spacing = radar.window.start_range, radar.window.sample_spacing
    end = start + (radar.window.n_samples - 1) * spacing
    # margin of half a sample: the kernel rounds positions to float32
    return bool((near > start + 0.5 * spacing).all() and (far < end - 0.5 * spacing).all())


def _range_bounds(grid: ImageGrid, along: F64, antenna: F64) -> tuple[F64, F64]:
    """Exact least and largest range (n_pulses,) of antenna positions (n_pulses, 3) to a rectangle of the grid."""
    across = grid.across_distance()[[0, -1]]
    line = antenna - grid.origin
    a, c = line @ grid.along, line @ grid.across
    drop = antenna[:, 2] - grid.height
    inside = np.clip(a, along[0], along[1]), np.clip(c, across[0], across[1])
    near = np.sqrt((a - inside[0]) ** 2 + (c - inside[1]) ** 2 + drop**2)
    far_a = np.maximum(np.abs(a - along[0]), np.abs(a - along[1]))
    far_c = np.maximum(np.abs(c - across[0]), np.abs(c - across[1]))
    return near, np.sqrt(far_a**2 + far_c**2 + drop**2)
