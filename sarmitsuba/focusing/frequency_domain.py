r"""What the frequency-domain focusers share: from raw data to the two-dimensional spectrum, and from lines to pixels.

Every one of them makes

.. math:: I(x, \rho) = \frac{\sqrt{2 \pi} e^{j \pi / 4} \rho^{5/2}}{K N P \sum_t w_t} \sum_{k_x} e^{j k_x x}
          \sum_k S(k_x, k) \frac{k^3}{k_y^{7/2}} e^{j \rho k_y},
          \quad k = 4 \pi (f_c + f) / c, \quad k_y = \sqrt{k^2 - k_x^2},

from the data's spectrum S over track and fast time, and they differ in how they evaluate, or approximate, the sum over
k.
It is the sum of :func:`sarmitsuba.focusing.focusers.backprojection.backproject` (its weights :math:`R^2 e^{jkR}`
transformed over the track by stationary phase), so that all give the same complex pixels.
"""

import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.echo.phasor import phase_ramp, unit_phasor
from sarmitsuba.errors import DataError, SarmitsubaWarning
from sarmitsuba.focusing.aperture import aperture_weights, band_weights, direction_gain, look_directions
from sarmitsuba.focusing.focuser import Focused, FocusTask
from sarmitsuba.focusing.ground import slant_below, slant_ranges, to_ground
from sarmitsuba.focusing.profiles import ProfilePlan, plan_spectrum
from sarmitsuba.focusing.stretching import ChirpZ
from sarmitsuba.focusing.windows import Window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]

# samples of the spectrum mapped at once by a thread: bounds the temporary memory and fits the caches
_BATCH = 1 << 18
# pulses of zeros on either side of the aperture while the pulse rate is raised
_GUARD = 32
# largest part of the (raised) PRF that the image's Doppler band may take: the rest is for the ripple at its edges
_BAND_FILL = 0.6
# nodes of the antenna's weight over the band's sines, linear between them
_NODES = 4097


@dataclass(frozen=True, eq=False)
class TrackGeometry:
    """Where the data and the image stand along the track's line.

    Parameters
    ----------
    x : (n_pulses,) float64, m, pulse positions from the grid's origin
    spacing : m between pulses
    x_center, rho_center : m, azimuth and closest-approach range of the image's central pixel
    range_center : m, slant range from mid-aperture to the central pixel
    sin_squint : sine of the angle between that line of sight and broadside
    """

    x: F64
    spacing: float
    x_center: float
    rho_center: float
    range_center: float
    sin_squint: float

    @property
    def cosine(self) -> float:
        """Cosine of the squint."""
        return float(np.sqrt(max(1.0 - self.sin_squint**2, 0.0)))


@dataclass(frozen=True, eq=False)
class Band:
    """The wavenumbers of the spectrum's rows, and the pixels that they become.

    Parameters
    ----------
    center_wavenumber : k_c, rad/m
    first, count, step : wavenumbers k - k_c are ``(first + arange(count)) * step``, rad/m
    sines : (2,) float64, range of k_x / k
    rho : (n_range,) float64, m, ranges of the pixels
    geometry : where data and image stand
    """

    center_wavenumber: float
    first: int
    count: int
    step: float
    sines: F64
    rho: F64
    geometry: TrackGeometry

    @property
    def offset(self) -> F64:
        """(count,) float64, k - k_c."""
        return np.asarray((self.first + np.arange(self.count)) * self.step)

    @property
    def pixel_spacing(self) -> float:
        """Spacing of the range pixels, m."""
        return float((self.rho[-1] - self.rho[0]) / max(self.rho.size - 1, 1))

    @property
    def away(self) -> F64:
        """(n_range,) float64, m, range pixels less the reference range."""
        return np.asarray(
            (np.arange(self.rho.size, dtype=np.float64) - self.rho.size // 2) * self.pixel_spacing
        )


class RangeLaw(ABC):
    """How one algorithm evaluates the sum over k, row by row of the spectrum."""

    @abstractmethod
    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Phase, rad, (rows, count), that the spectrum is multiplied by; ``kx`` is (rows, 1), ``offset`` (count,)."""

    @abstractmethod
    def lines(self, spectrum: C64, kx: F64, ky: F64) -> C64:
        """Pixels (rows, n_range) of rows of the spectrum (rows, count), zero where there is nothing."""


def _no_room(sines: F64, extent: float) -> float:
    """Free range that an algorithm needs which leaves echoes where they are."""
    return 0.0


def focus_rows(
    name: str,
    task: FocusTask,
    law: Callable[[Band], RangeLaw],
    room: Callable[[F64, float], float] = _no_room,
) -> Focused:
    """Focus range-compressed data of a straight track with one algorithm's law.

    Parameters
    ----------
    name : of the algorithm, for messages
    task : what to focus; a ground grid is interpolated from the slant grid of its ranges
    law : makes the algorithm's law from the band
    room : range, m, that the algorithm needs free beside data of a range of sines and of an extent in m

    Raises
    ------
    DataError
        Data that are not range compressed, a curved, climbing or non-uniform track, a grid that does not lie along it.

    Notes
    -----
    Ignores the part of a range column's aperture that the receive window cuts off (backprojection renormalises it).
    In spotlight mode the antenna pattern is compensated at each pixel but not used as a weight; in stripmap mode
    the weight is the pattern at the image's central range, over the pixels' own apertures where the radar states
    them. Where the aperture's and the image's Doppler band together pass the PRF the pulse rate is raised by deramping;
    an image too wide even for that folds, with a warning.
    """
    raw, radar = task.raw, task.raw.radar
    if raw.domain != "compressed":
        raise DataError(f"{name}: the data are not range compressed; call range_compress first")
    refusal = track_refusal(radar, task.grid)
    if refusal:
        raise DataError(f"{name}: {refusal}")
    grid = slant_grid(radar, task.grid)
    geometry = track_geometry(radar, grid)
    own = np.isfinite(radar.half_aperture)
    weights = np.ones(radar.track.n_pulses) if own else task.azimuth_window.aperture(radar.track.n_pulses)

    upsampling = _upsampling(name, radar, grid, geometry)
    kc = 4.0 * np.pi / radar.waveform.wavelength
    reach = np.pi * upsampling / (geometry.spacing * kc)
    sines = np.clip(geometry.sin_squint + np.array([-reach, reach]), -0.999, 0.999)
    extra = _walk(radar, geometry) + int(
        np.ceil(room(sines, radar.window.extent) / radar.window.sample_spacing)
    )
    plan = plan_spectrum(radar, task.range_window, extra=extra)
    bins = scipy.fft.fftfreq(plan.n_fft, 1.0 / plan.n_fft)
    half = int(bins[plan.gains > 0.0].max())
    low = int(bins[plan.gains > 0.0].min())
    band = Band(
        center_wavenumber=kc,
        first=low,
        count=half - low + 1,
        step=2.0 * np.pi / (plan.n_fft * radar.window.sample_spacing),
        sines=sines,
        rho=grid.range,
        geometry=geometry,
    )
    factor = _normalisation(radar, grid, geometry, task.azimuth_window) * (grid.range**2.5 / plan.n_fft)
    turn = np.sqrt(2.0 * np.pi) * np.exp(0.25j * np.pi)
    rows_law = law(band)
    image = np.empty((len(raw.layers), *grid.shape), dtype=np.complex64)
    for layer in range(len(raw.layers)):
        spectrum = _range_spectrum(raw.data[layer], radar, plan, band, weights)
        dense = geometry
        if upsampling > 1:
            spectrum, dense = _densify(spectrum, kc + band.offset, geometry, upsampling)
        n_x = int(scipy.fft.next_fast_len(int(np.ceil(_period(radar, grid, dense) / dense.spacing))))
        spectrum = scipy.fft.fft(spectrum, n=n_x, axis=0, workers=-1, overwrite_x=True)
        columns, first = _map_rows(spectrum, radar, grid, dense, band, rows_law, n_x, task.azimuth_window)
        del spectrum
        _to_azimuth(columns, first, n_x, dense, grid, image[layer])
        image[layer] *= (factor * (1.0 / (n_x * dense.spacing))).astype(np.float32) * np.complex64(turn)
        task.progress("focus", layer + 1.0, float(len(raw.layers)), {})
    if task.grid.kind == "ground":
        image = to_ground(image, grid, slant_ranges(radar, task.grid), kc * geometry.cosine)
    return Focused(image, lambda point: pulse_weights(radar, grid, point, task.azimuth_window))


def slant_grid(radar: Radar, grid: ImageGrid) -> ImageGrid:
    """Where the focusing itself takes place."""
    return slant_below(radar, grid) if grid.kind == "ground" else grid


def track_refusal(radar: Radar, grid: ImageGrid) -> str:
    """What keeps a frequency-domain focuser from focusing a radar's data on a grid; empty when nothing does."""
    track = radar.track
    if track.n_pulses < 8:
        return f"{track.n_pulses} pulses are too few, at least 8 are needed"
    if not track.is_straight:
        return "the track is curved or not uniformly sampled"
    ground = grid.kind == "ground"
    relative = track.position - (track.center_position if ground else grid.origin)
    off = np.abs(relative - (relative @ grid.along)[:, None] * grid.along).max()
    if off > 1e-4 or (track.position[-1] - track.position[0]) @ grid.along < 0.0:
        return f"the track runs {off:.3g} m off the {grid.kind} grid's horizontal axis (bound 1e-4 m)"
    if ground and slant_ranges(radar, grid).min() <= 0.0:
        return "the ground grid reaches across the ground track"
    return ""


def track_geometry(radar: Radar, grid: ImageGrid) -> TrackGeometry:
    """Where the data and the image stand along the track's line."""
    track = radar.track
    spacing = float(np.linalg.norm((track.position[-1] - track.position[0]) / (track.n_pulses - 1)))
    x = (track.position - grid.origin) @ grid.along
    x_center = float(grid.azimuth[grid.azimuth.size // 2])
    rho = float(grid.range[grid.range.size // 2])
    middle = 0.5 * (x[0] + x[-1])
    distance = float(np.hypot(x_center - middle, rho))
    return TrackGeometry(x, spacing, x_center, rho, distance, (x_center - middle) / distance)


def _upsampling(name: str, radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> int:
    """Whole factor on the pulse rate so that the whole image's Doppler band fits with room for its edges' ripple.

    Raising the rate needs the echoes deramped to the image's centre first, which must itself fit the PRF: it does in
    spotlight geometry, where the aperture, not the image, makes the band. Warns where the image folds all the same.
    """
    corners = (
        replace(grid, azimuth=grid.azimuth[[0, -1]], range=grid.range[[0, -1]]).positions().reshape(4, 3)
    )
    step = max(1, radar.track.n_pulses // 256)
    look = look_directions(radar, corners)[:, ::step]
    center = np.hypot(geometry.x - geometry.x_center, geometry.rho_center)
    sin = look @ grid.along
    own = np.isfinite(radar.half_aperture)
    # pixels with apertures of their own: the beam's side lobes fold over, as in any stripmap radar
    seen = direction_gain(radar, slice(None, None, step), look) > (0.05 if own else 0.02)
    nyquist = np.pi / geometry.spacing / (4.0 * np.pi / radar.waveform.wavelength)  # in sin(angle)
    band = float(np.abs(sin - geometry.sin_squint)[seen].max(initial=0.0)) / nyquist
    deramped = sin - ((geometry.x_center - geometry.x) / center)[::step]
    if own:  # what folds must stay out of the band that is processed, nothing more
        extent = np.abs(sin - _boresight_sine(radar))[seen].max(initial=0.0) + radar.half_aperture
        band = 0.5 * float(extent) / nyquist
        if band < 1.0:
            return 1
    if float(np.abs(deramped)[seen].max(initial=0.0)) / nyquist < 0.95:
        return max(1, int(np.ceil(band / _BAND_FILL)))
    if band > 1.05:
        warnings.warn(
            f"{name}: the image needs a Doppler bandwidth of {band:.2f} times the PRF, and so folds over; "
            "shrink it in azimuth, raise prf or use focuser backprojection",
            SarmitsubaWarning,
            stacklevel=3,
        )
    return 1


def _in_threads(work: Callable[[int, int], None], count: int, block: int) -> None:
    """Call ``work(start, stop)`` for all of ``count`` in blocks, on all cores."""
    starts = range(0, count, block)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for done in pool.map(lambda start: work(start, min(start + block, count)), starts):
            assert done is None


def _range_spectrum(data: C64, radar: Radar, plan: ProfilePlan, band: Band, weights: F64) -> C64:
    """Weighted spectra (n_pulses, count) over fast time, its origin at the range to the image's centre for all."""
    out = np.empty((data.shape[0], band.count), dtype=np.complex64)
    index = (band.first + np.arange(band.count)) % plan.n_fft
    shift = radar.window.start_range - band.geometry.range_center

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        line = plan.spectrum(data[part], workers=1)[:, index]
        line *= phase_ramp(-shift[part] * band.step, band.first, band.count)
        line *= weights[part, None].astype(np.float32)
        out[part] = line

    _in_threads(work, data.shape[0], max(1, _BATCH // plan.n_fft))
    return out


def _map_rows(
    spectrum: C64,
    radar: Radar,
    grid: ImageGrid,
    geometry: TrackGeometry,
    band: Band,
    law: RangeLaw,
    n_x: int,
    window: Window,
) -> tuple[C64, int]:
    """Map (kx, k) to (kx, rho): returns (n_kx, n_range) complex64 and the index m of its first kx = 2 pi m / period."""
    offset = band.offset
    k = band.center_wavenumber + offset
    dkx = 2.0 * np.pi / (n_x * geometry.spacing)
    nyquist = np.pi / geometry.spacing
    center = k * geometry.sin_squint
    first = int(np.ceil((center.min() - nyquist) / dkx))
    last = int(np.floor((center.max() + nyquist) / dkx))
    m = np.arange(first, last + 1)
    weight = _sine_weight(radar, grid, (first * dkx / k.min(), last * dkx / k.min()))
    own = np.isfinite(radar.half_aperture)
    out = np.zeros((m.size, grid.range.size), dtype=np.complex64)

    def work(start: int, stop: int) -> None:
        kx: F64 = np.asarray(m[start:stop, None] * dkx, dtype=np.float64)
        square = k**2 - kx**2
        keep = (np.abs(kx - center) <= nyquist) & (square > 0.0)
        ky: F64 = np.sqrt(np.where(keep, square, 1.0))
        phase = law.bulk(kx, ky, offset)
        phase -= offset * geometry.range_center
        phase -= kx * (geometry.x[0] - geometry.x_center)
        ratio = (k / ky).astype(np.float32)
        gain = ratio * ratio * ratio / np.sqrt(ky.astype(np.float32))
        sine = kx / k
        if weight is not None:
            gain *= np.interp(sine, *weight)
        if own:
            gain *= band_weights(sine - _boresight_sine(radar), dkx / k, radar.half_aperture, window)
        gain[~keep] = 0.0
        value = unit_phasor(phase)
        value *= gain
        value *= spectrum[m[start:stop] % n_x]
        out[start:stop] = law.lines(value, kx, ky)

    _in_threads(work, m.size, max(1, _BATCH // k.size))
    return out, first


def _sine_weight(radar: Radar, grid: ImageGrid, sines: tuple[float, float]) -> tuple[F64, F64] | None:
    """Matched weight of the pattern at nodes of k_x / k; None where it is 1 throughout."""
    if radar.antenna.pattern == "isotropic" or not radar.mode_law.own_apertures:
        return None
    low, high = min(sines[0], -1e-6), max(sines[1], 1e-6)
    nodes = np.linspace(max(1.01 * low, -1.0), min(1.01 * high, 1.0), _NODES)
    return nodes, _filter_gain(radar, grid, nodes)


def _densify(spectrum: C64, k: F64, geometry: TrackGeometry, factor: int) -> tuple[C64, TrackGeometry]:
    """Raise the pulse rate by a whole factor: deramp to the image's centre, zero-pad the Doppler spectrum, reramp."""
    n = scipy.fft.next_fast_len(spectrum.shape[0] + 2 * _GUARD)
    x = geometry.x[0] + geometry.spacing * (np.arange(n * factor) / factor - _GUARD)
    distance = np.hypot(x - geometry.x_center, geometry.rho_center) - geometry.range_center
    out = np.empty((n * factor, k.size), dtype=np.complex64)

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        ramp = unit_phasor(np.outer(distance, k[part]))
        line = np.zeros((n, ramp.shape[1]), dtype=np.complex64)
        line[_GUARD : _GUARD + spectrum.shape[0]] = spectrum[:, part]
        line = scipy.fft.fft(line * ramp[::factor], axis=0)
        wide = np.zeros_like(ramp)
        wide[: n - n // 2] = line[: n - n // 2]
        wide[wide.shape[0] - n // 2 :] = line[n - n // 2 :]
        out[:, part] = scipy.fft.ifft(wide, axis=0) * ramp.conj()

    _in_threads(work, k.size, max(1, _BATCH // (n * factor)))
    return out, replace(geometry, x=x, spacing=geometry.spacing / factor)


def _walk(radar: Radar, geometry: TrackGeometry) -> int:
    """Samples by which the range to the image's centre moves against the receive window over the aperture."""
    r = np.hypot(geometry.x - geometry.x_center, geometry.rho_center) - radar.window.start_range
    return int(np.ceil((r.max() - r.min()) / radar.window.sample_spacing))


def _period(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> float:
    """Length of track, m, over which the azimuth transform must not repeat itself.

    Data, image and the matched filter of full PRF bandwidth, each with its own extent; the filter ties a pixel to the
    pulses that see it within half the PRF of the centre's Doppler frequency.
    """
    k = 4.0 * np.pi / radar.waveform.wavelength
    edge = np.clip(
        geometry.sin_squint + np.array([-1.0, 1.0]) * np.pi / (geometry.spacing * k), -0.999, 0.999
    )
    reach = grid.range[-1] * np.tan(np.arcsin(edge))  # pixel minus pulse
    data = geometry.x[[0, -1]]
    pixels = grid.azimuth[[0, -1]]
    # farthest that any pixel's filter reaches beyond the farther end of the data
    low = min(pixels[0] - reach[1], data[0])
    high = max(pixels[-1] - reach[0], data[1])
    return float(max(high - data[0], data[1] - low)) + 32.0 * geometry.spacing


def _normalisation(radar: Radar, grid: ImageGrid, geometry: TrackGeometry, window: Window) -> F64:
    """1 / (K sum w g g_filter) per pixel (n_azimuth, n_range); zero where the data hold nothing."""
    if radar.antenna.pattern == "isotropic" and np.isinf(radar.half_aperture):
        total = np.full(grid.shape, window.aperture(radar.track.n_pulses).sum())
    else:  # smooth: summed at a few nodes, linear between them
        columns = np.unique(np.linspace(0, grid.range.size - 1, 33).astype(int))
        rows = np.unique(np.linspace(0, grid.azimuth.size - 1, 65).astype(int))
        nodes = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
        coarse = np.array(
            [pulse_weights(radar, grid, line, window).sum(axis=-1) for line in nodes.positions()]
        )
        between = np.array([np.interp(np.arange(grid.range.size), columns, line) for line in coarse])
        total = np.array([np.interp(np.arange(grid.azimuth.size), rows, line) for line in between.T]).T
    scale = np.divide(1.0, total, out=np.zeros(grid.shape), where=total > 1e-6 * total.max())
    # pixels that the receive window does not contain at mid-aperture hold no data
    start = float(radar.window.start_range[radar.track.center_index])
    r = np.hypot(grid.azimuth[:, None] - 0.5 * (geometry.x[0] + geometry.x[-1]), grid.range)
    scale[(r < start) | (r > start + radar.window.extent)] = 0.0
    return np.asarray(scale / radar.amplitude_constant)


def pulse_weights(radar: Radar, grid: ImageGrid, point: ArrayLike, azimuth_window: str | Window) -> F64:
    """Weight w g g_filter of every pulse in the pixel at points (..., 3), giving (..., n_pulses) float64."""
    weights = aperture_weights(radar, point, azimuth_window)
    look = look_directions(radar, point)
    gain = direction_gain(radar, slice(None), look)
    return np.asarray(weights * gain * _filter_gain(radar, grid, look @ grid.along))


def _boresight_sine(radar: Radar) -> float:
    """Sine of the beam along the flight, the same for all pulses of a straight track's stripmap."""
    middle = radar.track.center_index
    return float(radar.pointing.boresight[middle] @ radar.track.along)


def _filter_gain(radar: Radar, grid: ImageGrid, sin_angle: F64) -> F64:
    """Pattern used as matched weight: that at the image's central range if pixels have own apertures, else 1."""
    if radar.antenna.pattern == "isotropic" or not radar.mode_law.own_apertures:
        return np.ones_like(sin_angle)
    drop = float(grid.origin[2] - grid.height)
    rho = float(grid.range[grid.range.size // 2])
    broadside = np.sqrt(max(rho**2 - drop**2, 0.0)) * grid.across - np.array([0.0, 0.0, drop])
    broadside = broadside / np.linalg.norm(broadside)
    cos_angle = np.sqrt(np.clip(1.0 - sin_angle**2, 0.0, None))
    look = sin_angle[..., None] * grid.along + cos_angle[..., None] * broadside
    return direction_gain(radar, radar.track.center_index, look)


def _to_azimuth(
    columns: C64, first: int, n_x: int, geometry: TrackGeometry, grid: ImageGrid, out: C64
) -> None:
    r"""Write :math:`\sum_m c_m e^{j 2 \pi m x / P}` at the azimuth pixels (chirp-z transform) into ``out``."""
    n_az = grid.azimuth.size
    turn = 2.0 * np.pi * grid.azimuth_spacing / (n_x * geometry.spacing)
    sums = ChirpZ(columns.shape[0], n_az, first, -(n_az // 2), turn)

    def work(start: int, stop: int) -> None:
        out[:, start:stop] = sums(np.ascontiguousarray(columns[:, start:stop].T)).T

    _in_threads(work, columns.shape[1], max(1, _BATCH // sums.n_fft))


__all__ = [
    "Band",
    "RangeLaw",
    "TrackGeometry",
    "focus_rows",
    "pulse_weights",
    "slant_grid",
    "track_geometry",
    "track_refusal",
]
