"""Time-domain backprojection for any track and any set of pixels."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from types import ModuleType
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.arrays import C64, C128, F32, F64
from sarmitsuba.backend import arrays, device_array, dr
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.aperture_weights import (
    beam_turn,
    bistatic_refusal,
    dimness,
    ends_rounding,
    flight,
    image_places,
    matched_weights,
)
from sarmitsuba.focusing.backprojection_kernel import (
    AXES_STRIDE,
    PULSE_STRIDE,
    ApertureBand,
    Beam,
    LanePixels,
    ProfileBatch,
    Scales,
    Weighting,
    accumulate,
)
from sarmitsuba.focusing.focuser import CALL_SECONDS, FOCUSERS, Focused, Focuser, FocusTask, option
from sarmitsuba.focusing.memory_needs import backprojection_bytes
from sarmitsuba.focusing.pixel_lines import (
    PixelLines,
    grid_lines,
    may_leave_window,
    plan_line,
    point_lines,
)
from sarmitsuba.focusing.profiles import (
    INTERPOLATIONS,
    ProfilePlan,
    parse_interpolation,
    plan_profiles,
    plan_spectrum,
)
from sarmitsuba.focusing.windows import Window, parse_window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.progress import Progress, silent
from sarmitsuba.radar.radar import Radar

# layers that share one evaluation of the geometry; more would spill registers
_MAX_LAYERS = 4
# pixels whose summed weight is below this part of the aperture's were not illuminated
_DARK = 1e-6
# pixels of one launch
TILE_PIXELS = 1 << 20
# nodes of the azimuth window over a pixel's own aperture
_WINDOW_NODES = 1025
# relative time of a pixel and pulse: single; on a line; and per node of the line; unit: a line of 32 pixels and 10
# nodes
PIXEL_ALONE, PIXEL_ON_LINE, NODE_ON_LINE = 4.0, 0.3, 2.2
# processor seconds of that unit with a kernel of six taps (benchmarks/suite/focusers.py measures it), how many times
# that with apertures of the pixels' own, and what an antenna's pattern adds (benchmarks/suite/focuser_limits.py)
PIXEL_PULSE_SECONDS, OWN_APERTURES, PATTERN_SECONDS = 1.2e-9, 1.9, 1.9e-9
# of a raw-data sample made into a profile, and of a pixel in NumPy
PROFILE_SECONDS, PIXEL_SECONDS = 6e-8, 4e-7


class _Meter:
    """Sums the work done and reports it with its rate."""

    def __init__(self, progress: Progress, total: float) -> None:
        self.progress, self.total, self.done = progress, total, 0.0
        self.start = time.perf_counter()

    def add(self, work: float) -> None:
        self.done += work
        rate = self.done / max(time.perf_counter() - self.start, 1e-9)
        self.progress("focus", self.done, self.total, {"pixel-pulses/s": rate})


def backproject(
    raw: RawData,
    target: ImageGrid | ArrayLike,
    *,
    range_window: str | Window = "rectangular",
    azimuth_window: str | Window = "rectangular",
    interpolation: str = "kernel",
    oversampling: int = 0,
    progress: Progress = silent,
    batch_bytes: int = 4 << 20,
    tile_pixels: int = TILE_PIXELS,
) -> C64:
    r"""Focus range-compressed data by summing every pulse at every pixel's own range.

    .. math:: I(p) = \frac{\sum_t w_t g_t R_t^2 s_t(R_t) e^{+j 4 \pi f_c R_t / c}}{K \sum_t w_t g_t^2},
              \quad R_t = |p - A_t|

    with w the azimuth window over the pulses, or over the pixel's own aperture where the radar states one (stripmap),
    and g the antenna's relative two-way amplitude towards p, so that :math:`|I|^2` is the RCS at a point's peak
    whatever the range, track, window and pattern. Where the receiver is at B_t, apart from the transmitter,
    :math:`R_t = (|p - A_t| + |p - B_t|) / 2`, and :math:`R_t^2` is the product of both.

    Parameters
    ----------
    raw : range-compressed data
    target : a grid, or an (n, 3) list of scene-frame points, m
    range_window, azimuth_window : names for :func:`sarmitsuba.focusing.windows.parse_window`; azimuth is over the
        pulse index, or over the sine along the flight within the pixel's own aperture
    interpolation : ``linear`` (least accurate), ``kernel:4``, ``kernel`` = ``kernel:6``, ``kernel:8`` (most accurate)
    oversampling : range upsampling factor, 0 = 6 for ``linear`` and 2 for the others
    progress : called after every batch of pulses
    batch_bytes : of profiles per batch of pulses; they should stay in the last-level cache while every pixel reads
        them
    tile_pixels : pixels per launch, bounds the device memory of positions

    Returns
    -------
    (n_layers, n_azimuth, n_range) or (n_layers, n) complex64, m (square root of RCS)

    Notes
    -----
    Ignores the antenna's motion within a pulse and the atmosphere. Pixels that no pulse saw are zero. Memory beyond
    the image is bounded: pulses and pixels go in batches. Bistatic ranges are evaluated pixel by pixel, without lines.
    """
    tiles = Tiles(
        raw,
        target,
        parse_window(range_window),
        parse_window(azimuth_window),
        interpolation,
        oversampling,
        batch_bytes,
        tile_pixels,
    )
    image = np.empty((len(raw.layers), int(np.prod(tiles.shape))), dtype=np.complex64)
    meter = _Meter(progress, float(image.size) * raw.radar.track.n_pulses)
    for layers, lines in tiles.launches():
        tiles.focus(layers, lines, image, meter.add)
    return image.reshape(len(raw.layers), *tiles.shape)


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
        types, radar = arrays(), self.raw.radar
        weighting = Weighting(
            beam=None if radar.antenna.pattern == "isotropic" else Beam.of(types, radar.antenna),
            band=_band(types, radar, self.azimuth_window) if np.isfinite(radar.half_aperture) else None,
        )
        _focus_lines(
            types, self.raw, layers, self.plan, self.weights, weighting, lines, image, told, self.batch_bytes
        )


def _focus_lines(
    types: ModuleType,
    raw: RawData,
    layers: slice,
    plan: ProfilePlan,
    weights: F64,
    weighting: Weighting,
    lines: PixelLines,
    image: C64,
    told: Callable[[float], None],
    batch_bytes: int,
) -> None:
    """Sum all pulses for one launch and store its calibrated pixels in ``image``."""
    radar = raw.radar
    n_layers = layers.stop - layers.start
    receiver = None if radar.receiver is None else radar.receiver.position
    stride = 2 * n_layers + 1
    per_line, lanes = lines.index.shape
    middle = tuple(device_array(types.Float64, lines.middle[:, axis]) for axis in range(3))
    line = LanePixels(
        n_pixels=per_line,
        n_nodes=lines.n_nodes,
        step=tuple(dr.opaque(types.Float64, float(s)) for s in lines.step),
        checked=lines.checked,
    )
    reference = float(np.linalg.norm(lines.middle[lanes // 2] - radar.track.center_position))
    scales = Scales(
        per_metre=dr.opaque(types.Float64, 1.0 / plan.step),
        turns_per_metre=dr.opaque(types.Float64, 2.0 * radar.waveform.center_frequency / SPEED_OF_LIGHT),
        inverse_square=dr.opaque(types.Float64, 1.0 / reference**2),
    )
    state = [dr.zeros(types.Float32, lanes) for _ in range(per_line * stride)]
    dr.make_opaque(state)  # otherwise the first batch would compile its own kernel
    for batch in _batches(radar.track.n_pulses, plan, n_layers, batch_bytes):
        n = batch.stop - batch.start
        pulses = ProfileBatch(
            n_pulses=dr.opaque(types.UInt32, n),
            n_stored=dr.opaque(types.UInt32, plan.n_stored),
            n_plane=dr.opaque(types.UInt32, n * plan.n_stored),
            last=dr.opaque(types.Int32, plan.last),
            positions=device_array(types.Float64, _pulse_table(radar, plan, batch)),
            receivers=None if receiver is None else device_array(types.Float64, receiver[batch].ravel()),
            axes=device_array(types.Float32, _axes_table(radar, weights, batch)),
            profiles=device_array(types.UInt64, plan.profiles(raw.data[layers, batch]).view(np.uint64)),
        )
        state = accumulate(types, state, middle, line, pulses, scales, plan.kernel, n_layers, weighting)
        dr.eval(state)
        dr.sync_thread()
        told(float(np.count_nonzero(lines.index >= 0)) * n * n_layers)

    scale = reference**2 / radar.amplitude_constant
    whole = float(weights.sum())
    for i in range(per_line):
        keep = lines.index[i] >= 0
        weight = np.full(lanes, whole)
        if line.checked or not weighting.uniform:
            weight = state[i * stride + stride - 1].numpy().astype(np.float64)
        with np.errstate(divide="ignore"):
            factor = np.where(weight > _DARK * whole, scale / weight, 0.0)[keep]
        for layer in range(n_layers):
            re, im = (state[i * stride + 2 * layer + part].numpy()[keep] for part in (0, 1))
            image[layers.start + layer, lines.index[i][keep]] = (re + 1j * im) * factor


def _batches(n_pulses: int, plan: ProfilePlan, n_layers: int, batch_bytes: int) -> Iterator[slice]:
    """Slices of pulses whose profiles fit the batch size."""
    size = max(8, batch_bytes // (8 * plan.n_stored * n_layers))
    for start in range(0, n_pulses, size):
        yield slice(start, min(start + size, n_pulses))


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


def backproject_numpy(raw: RawData, points: ArrayLike, *, range_window: str = "rectangular") -> C128:
    """Reference backprojection at (n, 3) points: float64, exact trigonometric interpolation, isotropic antenna.

    Slow; the reference of the compiled kernel's tests. Returns (n_layers, n) complex128.
    """
    radar, points = raw.radar, np.asarray(points, dtype=np.float64)
    plan = plan_spectrum(radar, parse_window(range_window))
    image = np.zeros((len(raw.layers), points.shape[0]), dtype=np.complex128)
    tracks = [radar.track] if radar.receiver is None else [radar.track, radar.receiver]
    for t in range(radar.track.n_pulses):
        legs = [np.linalg.norm(points - track.position[t], axis=1) for track in tracks]
        r = sum(legs) / len(legs)
        spectrum = np.fft.fft(raw.data[:, t].astype(np.complex128), n=plan.n_fft) * plan.gains / plan.n_fft
        position = (r - radar.window.start_range[t]) / plan.sample_spacing
        profile = series_at(spectrum, position)
        image += (
            profile
            * legs[0]
            * legs[-1]
            * np.exp(4j * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT * r)
        )
    return image / (radar.amplitude_constant * radar.track.n_pulses)


def series_at(spectrum: C128, position: F64) -> C128:
    """Fourier series with coefficients (..., n_fft) in the order of the FFT, at positions (n,) in samples: (..., n).

    The sum over frequencies ``f = 64 a + c`` as two, so that there are few exponentials; exact to rounding.
    """
    n = spectrum.shape[-1]
    middle = n // 2
    rows = -(-n // _SERIES)
    padded = np.zeros((*spectrum.shape[:-1], rows * _SERIES), dtype=np.complex128)
    padded[..., :n] = np.fft.fftshift(spectrum, axes=-1)
    turn = 2j * np.pi / n * position
    inner = padded.reshape(*spectrum.shape[:-1], rows, _SERIES) @ np.exp(np.outer(np.arange(_SERIES), turn))
    outer = np.exp(np.outer(_SERIES * np.arange(rows) - middle, turn))
    return np.asarray(np.sum(inner * outer, axis=-2))


_SERIES = 64
# by taps, at twofold oversampling; of eight taps what sums in float32 leave
_KERNEL_ERROR_DB = {4: -66.0, 6: -105.0, 8: -115.0}
# of the upsampling: below it the interpolation leaves images of the band
OVERSAMPLING = (2, 64)
# rows and columns of an image at which the illumination is evaluated
_PLACES = (9, 9)


@dataclass(frozen=True)
class Backprojection(Focuser):
    """Time-domain backprojection, see :func:`backproject`; refuses only bistatic data with a pattern."""

    name: ClassVar[str] = "backprojection"
    title: ClassVar[str] = "any track and any grid, bistatic too"
    bistatic: ClassVar[bool] = True

    interpolation: str = option(
        "kernel",
        "of range profiles: linear (least accurate), kernel:4, kernel, kernel:8 (best)",
        choices=tuple(INTERPOLATIONS),
    )
    oversampling: int = option(
        0,
        "range upsampling factor; 0 = 6 for linear and 2 for the others",
        within=OVERSAMPLING,
        automatic=True,
    )

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        return bistatic_refusal(radar)

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """Error of range interpolation and rounding, dB, against the sum in float64 at exact ranges.

        Powers add up of the interpolation's, as benchmarks/suite/focusers.py measures it, and of the rounding of the
        ends of pixels' own apertures. Both grow where a place is weakly illuminated: its pixel is divided by the summed
        weight of its pulses.
        """
        width = parse_interpolation(self.interpolation)
        if width == 2:  # falls with the square of the step; worst where the band fills the sampling rate
            error = -16.0 - 12.0 * float(np.log2(self.oversampling or 6))
        else:
            error = _KERNEL_ERROR_DB[width]
        power = (10.0 ** (0.1 * error) + ends_rounding(radar)) * dimness(radar, image_places(grid, _PLACES))
        return 10.0 * float(np.log10(power))

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Approximate processor time of one layer on one core."""
        rate = PIXEL_PULSE_SECONDS * self.effort(radar, grid)
        if np.isfinite(radar.half_aperture):
            rate *= OWN_APERTURES
        if radar.antenna.pattern != "isotropic":
            rate += PATTERN_SECONDS
        pixels, pulses = float(np.prod(grid.shape)), radar.track.n_pulses
        profiles = PROFILE_SECONDS * pulses * radar.window.n_samples
        return CALL_SECONDS + profiles + (PIXEL_SECONDS + rate * pulses) * pixels

    def making_bytes(self, radar: Radar, grid: ImageGrid, n_layers: int) -> int:
        """Peak memory in bytes while the pixels are made, pixels included, raw data not."""
        per_line, _ = self._line(radar, grid)
        return backprojection_bytes(radar, grid, n_layers, per_line)

    def effort(self, radar: Radar, grid: ImageGrid) -> float:
        """Time per pixel and pulse relative to a line of 32 pixels and 10 nodes."""
        per_line, nodes = self._line(radar, grid)
        return PIXEL_ALONE if per_line == 1 else PIXEL_ON_LINE + NODE_ON_LINE * nodes / per_line

    def _line(self, radar: Radar, grid: ImageGrid) -> tuple[int, int]:
        """Pixels of a line and nodes of its range."""
        plan = plan_profiles(
            radar,
            parse_window("rectangular"),
            interpolation=self.interpolation,
            oversampling=self.oversampling,
        )
        return plan_line(radar, plan, grid, may_leave_window(radar, grid))

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        pixels = backproject(
            task.raw,
            task.grid,
            range_window=task.range_window,
            azimuth_window=task.azimuth_window,
            interpolation=self.interpolation,
            oversampling=self.oversampling,
            progress=task.progress,
        )
        return Focused(pixels, lambda point: matched_weights(task.raw.radar, point, task.azimuth_window))


FOCUSERS.register(Backprojection())
