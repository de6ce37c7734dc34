"""Backprojection and its adjoint divided into independent launches of pixels and batches of pulses.

A lane of the compiled kernel has a line of pixels along azimuth, as long as its error allows.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import islice
from math import comb
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C64, F32, F64, I64, LinearMap
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress
from sarmitsuba.machine.backend import arrays, device_array, dr
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import beam_turn, bistatic_refusal, flight
from sarmitsuba.signal.focusing.backprojection_kernel import (
    AXES_STRIDE,
    PULSE_STRIDE,
    ApertureBand,
    Beam,
    LanePixels,
    ProfileBatch,
    Scales,
    Weighting,
    accumulate,
    distribute,
)
from sarmitsuba.signal.focusing.profiles import ProfilePlan, plan_profiles
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

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
    enough = np.flatnonzero(_bound_series() @ series <= tolerance)
    return int(enough[0]) + 1 if enough.size else None


def _power_terms(x: float) -> F64:
    """Terms (``_SERIES``,) of the exponential's power series, :math:`x^n / n!`."""
    return np.cumprod(np.concatenate([[1.0], x / np.arange(1, _SERIES)]))


@cache
def _bound_series() -> F64:
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
    return not _lies_within(radar, *_range_bounds(grid, np.array(padded), radar.track.position))


def _lies_within(radar: Radar, near: F64, far: F64) -> bool:
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


# layers that share one evaluation of the geometry; more would spill registers
_MAX_LAYERS = 4
# pixels whose summed weight is below this part of the aperture's were not illuminated
_DARK = 1e-6
# pixels of one launch
TILE_PIXELS = 1 << 20
# nodes of the azimuth window over a pixel's own aperture
_WINDOW_NODES = 1025


class _Meter:
    """Sums the work done and reports it with its rate."""

    def __init__(self, progress: Progress, total: float) -> None:
        self.progress, self.total, self.done = progress, total, 0.0
        self.start = time.perf_counter()

    def add(self, work: float) -> None:
        self.done += work
        rate = self.done / max(time.perf_counter() - self.start, 1e-9)
        self.progress("focus", self.done, self.total, {"pixel-pulses/s": rate})


@dataclass(frozen=True, eq=False)
class Tile:
    """Pixels of some layers between two places of the flat image.

    Parameters
    ----------
    layers : which
    start, stop : places in the flat image
    pixels : (layers, stop - start) complex64
    """

    layers: slice
    start: int
    stop: int
    pixels: C64


@dataclass(frozen=True, eq=False)
class Tiles:
    """Backprojection divided into independent launches; parameters as for :func:`backproject`.

    Raises
    ------
    DataError
        The data are not range compressed, or bistatic in a way that is not supported.
    """

    raw: RawData
    target: ImageGrid | ArrayLike
    range_window: Window
    azimuth_window: Window
    interpolation: str
    oversampling: int
    batch_bytes: int = 4 << 20
    tile_pixels: int = TILE_PIXELS

    def __post_init__(self) -> None:
        if self.raw.domain != "compressed":
            raise DataError("backprojection: the data are not range compressed; call range_compress first")
        refusal = bistatic_refusal(self.raw.radar)
        if refusal:
            raise DataError(f"backprojection: {refusal}")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one layer's pixels."""
        target = self.target
        return target.shape if isinstance(target, ImageGrid) else (np.asarray(target).shape[0],)

    @cached_property
    def plan(self) -> ProfilePlan:
        """Interpolation plan of the echoes."""
        return plan_profiles(
            self.raw.radar,
            self.range_window,
            interpolation=self.interpolation,
            oversampling=self.oversampling,
        )

    @cached_property
    def weights(self) -> F64:
        """Azimuth weights of the pulses."""
        n_pulses = self.raw.radar.track.n_pulses
        own = np.isfinite(self.raw.radar.half_aperture)
        return np.ones(n_pulses) if own else self.azimuth_window.aperture(n_pulses)

    def launches(self) -> Iterator[tuple[slice, PixelLines]]:
        """Layers and pixels of every launch."""
        n_layers = len(self.raw.layers)
        for start in range(0, n_layers, _MAX_LAYERS):
            layers = slice(start, min(start + _MAX_LAYERS, n_layers))
            if isinstance(self.target, ImageGrid):
                lines = grid_lines(self.raw.radar, self.plan, self.target, self.tile_pixels)
            else:
                lines = point_lines(self.target, self.tile_pixels)
            for some in lines:
                yield layers, some

    def tile(self, number: int) -> Tile:
        """Focus one launch by its number."""
        layers, lines = next(islice(self.launches(), number, None))
        image = np.zeros((len(self.raw.layers), int(np.prod(self.shape))), dtype=np.complex64)
        self.focus(layers, lines, image, lambda work: None)
        inside = lines.index[lines.index >= 0]
        start, stop = int(inside.min()), int(inside.max()) + 1
        return Tile(layers, start, stop, image[layers, start:stop].copy())

    def focus(self, layers: slice, lines: PixelLines, image: C64, told: Callable[[float], None]) -> None:
        """Sum all pulses for one launch and store its calibrated pixels in ``image`` (layers, flat)."""
        self._launch(lines).focus(layers, image, told)

    def image(self, progress: Progress) -> C64:
        """Calibrated pixels (n_layers, ...) of all launches."""
        image = np.empty((len(self.raw.layers), int(np.prod(self.shape))), dtype=np.complex64)
        meter = _Meter(progress, float(image.size) * self.raw.radar.track.n_pulses)
        for layers, lines in self.launches():
            self.focus(layers, lines, image, meter.add)
        return image.reshape(len(self.raw.layers), *self.shape)

    def adjoint(self, pixels: C64, progress: Progress) -> C64:
        """Adjoint of :meth:`image` as a function of the data: (n_layers, n_pulses, n_samples) complex64."""
        flat = pixels.reshape(len(self.raw.layers), -1)
        data = np.zeros(self.raw.data.shape, dtype=np.complex64)
        launches = list(self.launches())
        for done, (layers, lines) in enumerate(launches, 1):
            launch = self._launch(lines)
            launch.spread(layers, flat, self._factors(launch), data)
            progress("adjoint", float(done), float(len(launches)), {})
        return data

    def _factors(self, launch: _TileLanes) -> F64:
        """Calibration of a launch's pixels; kept, because it takes the sum of all pulses' weights."""
        if not launch.sums_weights:
            return launch.factors(None)
        first = int(launch.lines.index.max())
        if first not in self._known:
            self._known[first] = launch.factors(launch.sums(slice(0, 0), lambda work: None))
        return self._known[first]

    def _launch(self, lines: PixelLines) -> _TileLanes:
        types, radar = arrays(), self.raw.radar
        weighting = Weighting(
            beam=None if not radar.antenna.directive else Beam.of(types, radar.antenna),
            band=_band(types, radar, self.azimuth_window) if np.isfinite(radar.half_aperture) else None,
        )
        return _TileLanes(types, self, lines, weighting)

    @cached_property
    def _known(self) -> dict[int, F64]:
        """Calibrations by the last pixel of their launch."""
        return {}


@dataclass(frozen=True, eq=False)
class TiledImaging(LinearMap):
    """Linear map of backprojection, from range-compressed data to pixels.

    Parameters
    ----------
    tiles : with data of the right shape
    progress : called from time to time
    """

    tiles: Tiles
    progress: Progress

    def forward(self, values: C64) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) of data (n_layers, n_pulses, n_samples)."""
        return replace(self.tiles, raw=replace(self.tiles.raw, data=values)).image(self.progress)

    def adjoint(self, values: C64) -> C64:
        """Data from pixels."""
        return self.tiles.adjoint(values, self.progress)


@dataclass(frozen=True, eq=False)
class _TileLanes:
    """Pixels of one launch on the device, with the kernels' inputs from radar and data.

    Parameters
    ----------
    types : array types
    tiles : whose launch it is
    lines : its pixels
    weighting : antenna and aperture
    """

    types: ModuleType
    tiles: Tiles
    lines: PixelLines
    weighting: Weighting

    @cached_property
    def middle(self) -> tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]:
        """Positions of the lanes' middle pixels."""
        x, y, z = (device_array(self.types.Float64, self.lines.middle[:, axis]) for axis in range(3))
        return x, y, z

    @cached_property
    def line(self) -> LanePixels:
        """Pixels of a lane."""
        x, y, z = (dr.opaque(self.types.Float64, float(s)) for s in self.lines.step)
        return LanePixels(self.lines.index.shape[0], self.lines.n_nodes, (x, y, z), self.lines.checked)

    @property
    def reference(self) -> float:
        """Range whose spreading loss is divided out, m."""
        lines, track = self.lines, self.tiles.raw.radar.track
        return float(np.linalg.norm(lines.middle[lines.index.shape[1] // 2] - track.center_position))

    @cached_property
    def scales(self) -> Scales:
        """Numbers of the geometry."""
        Float64, wave = self.types.Float64, self.tiles.raw.radar.waveform
        return Scales(
            per_metre=dr.opaque(Float64, 1.0 / self.tiles.plan.step),
            turns_per_metre=dr.opaque(Float64, 2.0 * wave.center_frequency / SPEED_OF_LIGHT),
            inverse_square=dr.opaque(Float64, 1.0 / self.reference**2),
        )

    def pulses(self, batch: slice, profiles: C64) -> ProfileBatch:
        """Pulses of a batch with their profiles, of any layers."""
        types, plan, radar = self.types, self.tiles.plan, self.tiles.raw.radar
        n = batch.stop - batch.start
        receiver = None if radar.receiver is None else radar.receiver.position
        return ProfileBatch(
            n_pulses=dr.opaque(types.UInt32, n),
            n_stored=dr.opaque(types.UInt32, plan.n_stored),
            n_plane=dr.opaque(types.UInt32, n * plan.n_stored),
            last=dr.opaque(types.Int32, plan.last),
            positions=device_array(types.Float64, _pulse_table(radar, plan, batch)),
            receivers=None if receiver is None else device_array(types.Float64, receiver[batch].ravel()),
            axes=device_array(types.Float32, _axes_table(radar, self.tiles.weights, batch)),
            profiles=device_array(types.UInt64, profiles.view(np.uint64)),
        )

    def batches(self, n_layers: int) -> Iterator[slice]:
        """Slices of pulses whose profiles fit the batch size."""
        n_pulses = self.tiles.raw.radar.track.n_pulses
        size = max(8, self.tiles.batch_bytes // (8 * self.tiles.plan.n_stored * max(n_layers, 1)))
        for start in range(0, n_pulses, size):
            yield slice(start, min(start + size, n_pulses))

    def sums(self, layers: slice, told: Callable[[float], None]) -> list[dr.ArrayBase]:
        """Sums over all pulses as :func:`accumulate` returns them; of no layers, the weights alone."""
        n_layers = layers.stop - layers.start
        per_line, lanes = self.lines.index.shape
        state = [dr.zeros(self.types.Float32, lanes) for _ in range(per_line * (2 * n_layers + 1))]
        dr.make_opaque(state)  # otherwise the first batch would compile its own kernel
        for batch in self.batches(n_layers):
            profiles = np.zeros(1, dtype=np.complex64)
            if n_layers:
                profiles = self.tiles.plan.profiles(self.tiles.raw.data[layers, batch])
            pulses = self.pulses(batch, profiles)
            state = accumulate(
                self.types,
                state,
                self.middle,
                self.line,
                pulses,
                self.scales,
                self.tiles.plan.kernel,
                n_layers,
                self.weighting,
            )
            dr.eval(state)
            dr.sync_thread()
            told(float(np.count_nonzero(self.lines.index >= 0)) * (batch.stop - batch.start) * n_layers)
        return state

    def factors(self, weights: list[dr.ArrayBase] | None) -> F64:
        """Calibration (pixels per line, lanes) from the summed weights of every pixel of a lane; 0 where dark."""
        tiles = self.tiles
        scale = self.reference**2 / tiles.raw.radar.amplitude_constant
        whole = float(tiles.weights.sum())
        weight = np.full(self.lines.index.shape, whole)
        if weights is not None:
            weight = np.array([w.numpy().astype(np.float64) for w in weights])
        with np.errstate(divide="ignore"):
            return np.where(weight > _DARK * whole, scale / weight, 0.0)

    @property
    def sums_weights(self) -> bool:
        """Whether pixels differ in their summed weight."""
        return self.line.checked or not self.weighting.uniform

    def focus(self, layers: slice, image: C64, told: Callable[[float], None]) -> None:
        """Store calibrated pixels in ``image`` (layers, flat)."""
        stride = 2 * (layers.stop - layers.start) + 1
        state = self.sums(layers, told)
        factors = self.factors(state[stride - 1 :: stride] if self.sums_weights else None)
        for i, index in enumerate(self.lines.index):
            keep = index >= 0
            for layer in range(layers.stop - layers.start):
                re, im = (state[i * stride + 2 * layer + part].numpy()[keep] for part in (0, 1))
                image[layers.start + layer, index[keep]] = (re + 1j * im) * factors[i, keep]

    def spread(self, layers: slice, image: C64, factors: F64, data: C64) -> None:
        """Adjoint of :meth:`focus`: add pixels of ``image`` (layers, flat) to ``data`` (layers, pulses, samples)."""
        types, plan = self.types, self.tiles.plan
        n_layers = layers.stop - layers.start

        def on_device(part: F64) -> dr.ArrayBase:
            return device_array(types.Float32, part.astype(np.float32))

        values = []
        for i, index in enumerate(self.lines.index):
            pixels = image[layers][:, np.maximum(index, 0)] * np.where(index >= 0, factors[i], 0.0)
            values.append([(on_device(p.real), on_device(p.imag)) for p in pixels])
        for batch in self.batches(2 * n_layers):
            shape = (n_layers, batch.stop - batch.start, plan.n_stored)
            out = (dr.zeros(types.Float64, int(np.prod(shape))), dr.zeros(types.Float64, int(np.prod(shape))))
            dr.make_opaque(*out)
            pulses = self.pulses(batch, np.zeros(1, dtype=np.complex64))
            distribute(
                types, values, self.middle, self.line, pulses, self.scales, plan.kernel, self.weighting, out
            )
            dr.sync_thread()
            profiles = (out[0].numpy() + 1j * out[1].numpy()).astype(np.complex64).reshape(shape)
            data[layers, batch] += plan.adjoint_profiles(profiles)


def _pulse_table(radar: Radar, plan: ProfilePlan, batch: slice) -> F64:
    table = np.empty((batch.stop - batch.start, PULSE_STRIDE))
    table[:, :3] = radar.track.position[batch]
    table[:, 3] = radar.window.start_range[batch] / plan.step
    return table.ravel()


def _band(types: ModuleType, radar: Radar, window: Window) -> ApertureBand:
    nodes = window(np.linspace(-0.5, 0.5, _WINDOW_NODES)).astype(np.float32)
    return ApertureBand(dr.opaque(types.Float32, radar.half_aperture), device_array(types.Float32, nodes))


def _axes_table(radar: Radar, weights: F64, batch: slice) -> F32:
    table = np.zeros((batch.stop - batch.start, AXES_STRIDE), dtype=np.float32)
    table[:, 0:3] = radar.pointing.azimuth_axis[batch]
    table[:, 3] = weights[batch]
    table[:, 4:7] = radar.pointing.elevation_axis[batch]
    table[:, 8:11] = radar.pointing.boresight[batch]
    table[:, 11] = beam_turn(radar)[batch]
    table[:, 12:15], table[:, 15], table[:, 7] = (part[batch] for part in flight(radar))
    return table.ravel()
