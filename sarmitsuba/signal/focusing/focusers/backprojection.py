"""Time-domain backprojection for any track and any set of pixels."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C64, C128, F64, LinearMap
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import (
    beam_rounding,
    bistatic_refusal,
    dimness,
    ends_rounding,
    image_places,
    matched_weights,
)
from sarmitsuba.signal.focusing.focuser import (
    CALL_SECONDS,
    FOCUSERS,
    Focused,
    Focuser,
    FocusTask,
    backprojection_bytes,
    option,
)
from sarmitsuba.signal.focusing.pixel_tiles import (
    TILE_PIXELS,
    TiledImaging,
    Tiles,
    may_leave_window,
    plan_line,
)
from sarmitsuba.signal.focusing.profiles import (
    INTERPOLATIONS,
    parse_interpolation,
    plan_profiles,
    plan_spectrum,
)
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

# relative time of a pixel and pulse: single; on a line; and per node of the line; unit: a line of 32 pixels and 10
# nodes
PIXEL_ALONE, PIXEL_ON_LINE, NODE_ON_LINE = 4.0, 0.3, 2.2
# processor seconds of that unit with a kernel of six taps (benchmarks/suite/focusers.py measures it), how many times
# that with apertures of the pixels' own, and what an antenna's pattern adds (benchmarks/suite/focuser_limits.py)
PIXEL_PULSE_SECONDS, OWN_APERTURES, PATTERN_SECONDS = 1.2e-9, 1.9, 1.9e-9
# of a raw-data sample made into a profile, and of a pixel in NumPy
PROFILE_SECONDS, PIXEL_SECONDS = 6e-8, 4e-7


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
    r"""Focus range-compressed data by summing every pulse at every pixel's range.

    .. math:: I(p) = \frac{\sum_t w_t g_t R_t^2 s_t(R_t) e^{+j 4 \pi f_c R_t / c}}{K \sum_t w_t g_t^2},
              \quad R_t = |p - A_t|

    with w the azimuth window over the pulses, or over the pixel's aperture where the radar states one (stripmap),
    and g the antenna's relative two-way amplitude towards p, so that :math:`|I|^2` is the RCS at a point's peak
    whatever the range, track, window and pattern. Where the receiver is at B_t, apart from the transmitter,
    :math:`R_t = (|p - A_t| + |p - B_t|) / 2`, and :math:`R_t^2` is the product of both.

    Parameters
    ----------
    raw : range-compressed data
    target : a grid, or an (n, 3) list of scene-frame points, m
    range_window, azimuth_window : names for :func:`sarmitsuba.signal.focusing.windows.parse_window`; azimuth is over
        the pulse index, or over the sine along the flight within the pixel's aperture
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
    return tiles.image(progress)


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

        Powers add up of the interpolation's, as benchmarks/suite/focusers.py measures it, and of the rounding of
        directions at the ends of pixels' apertures and in narrow beams. All grow where a place is weakly
        illuminated: its pixel is divided by the summed weight of its pulses.
        """
        width = parse_interpolation(self.interpolation)
        if width == 2:  # falls with the square of the step; worst where the band fills the sampling rate
            error = -16.0 - 12.0 * float(np.log2(self.oversampling or 6))
        else:
            error = _KERNEL_ERROR_DB[width]
        rounding = ends_rounding(radar) + beam_rounding(radar)
        power = (power_from_db(error) + rounding) * dimness(radar, image_places(grid, _PLACES))
        return db_from_power(power)

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Approximate processor time of one layer on one core."""
        rate = PIXEL_PULSE_SECONDS * self.effort(radar, grid)
        if np.isfinite(radar.half_aperture):
            rate *= OWN_APERTURES
        if radar.antenna.directive:
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

    def imaging(self, task: FocusTask) -> LinearMap:
        """Linear map from data to pixels."""
        windows = task.range_window, task.azimuth_window
        tiles = Tiles(task.raw, task.grid, *windows, self.interpolation, self.oversampling)
        return TiledImaging(tiles, task.progress)

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        pixels = self.imaging(task).forward(task.raw.data)
        return Focused(pixels, lambda point: matched_weights(task.raw.radar, point, task.azimuth_window))


FOCUSERS.register(Backprojection())
