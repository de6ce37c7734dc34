"""Wavenumber-domain focusing (omega-K) of a straight, uniformly sampled track, by non-uniform FFT."""

import warnings
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.echo.gridding import spreading_kernel
from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError, SarmitsubaWarning
from sarmitsuba.focusing.aperture import aperture_weights, band_weights, direction_gain, look_directions
from sarmitsuba.focusing.azimuth_band import SAMPLE_SECONDS, azimuth_fits
from sarmitsuba.focusing.focuser import FOCUSERS, Focused, Focuser, FocusTask
from sarmitsuba.focusing.ground import slant_below, slant_ranges, to_ground
from sarmitsuba.focusing.profiles import plan_spectrum
from sarmitsuba.focusing.windows import Window, parse_window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.progress import Progress, silent
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]

# taps of the kernel that carries Stolt's mapping; at twofold oversampling its error is near single precision
_WIDTH = 8
# (kx, k) samples mapped at once: bounds the temporary memory
_BATCH = 1 << 19
# pulses of zeros on either side of the aperture while the pulse rate is raised
_GUARD = 32
# largest part of the (raised) PRF that the image's Doppler band may take: the rest is for the ripple at its edges
_BAND_FILL = 0.6


@dataclass(frozen=True, eq=False)
class _Geometry:
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


def omega_k(
    raw: RawData,
    grid: ImageGrid,
    *,
    range_window: str | Window = "rectangular",
    azimuth_window: str | Window = "rectangular",
    progress: Progress = silent,
) -> C64:
    r"""Focus range-compressed data of a straight track onto its slant grid, or onto a ground grid along the track.

    With :math:`k = 4 \pi (f_c + f) / c`, :math:`k_y = \sqrt{k^2 - k_x^2}` and the data's spectrum S over track and
    fast time:

    .. math:: I(x, \rho) = \frac{\sqrt{2 \pi} e^{j \pi / 4} \rho^{5/2}}{K N P \sum_t w_t} \sum_{k_x} e^{j k_x x}
              \sum_k S(k_x, k) \frac{k^3}{k_y^{7/2}} e^{j \rho k_y}

    which is the sum of :func:`sarmitsuba.focusing.focusers.backprojection.backproject` (its weights :math:`R^2 e^{jkR}`
    transformed over the track by stationary phase), so that both give the same complex pixels. The inner
    sum is the Stolt mapping: a type-1 non-uniform FFT from the curved k_y samples to the image's range
    pixels; the outer one is a chirp-z transform onto the azimuth pixels.

    Parameters
    ----------
    raw : range-compressed data of a straight, level, uniformly sampled track
    grid : slant grid of that track, or a ground grid along it, which is interpolated from the slant grid of its ranges
    range_window, azimuth_window : as in ``backproject``; azimuth weights are over the pulse index
    progress : called after every layer

    Returns
    -------
    (n_layers, n_azimuth, n_range) complex64, m (square root of RCS)

    Raises
    ------
    DataError
        Curved, climbing or non-uniform track, or a grid that does not lie along it.

    Notes
    -----
    Ignores the part of a range column's aperture that the receive window cuts off (backprojection renormalises it).
    In spotlight mode the antenna pattern is compensated at each pixel but not used as a weight; in stripmap mode
    the weight is the pattern at the image's central range, over the pixels' own apertures where the radar states
    them. Where the aperture's and the image's Doppler band together pass the PRF the pulse rate is raised by deramping;
    an image too wide even for that folds, with a warning.
    """
    if raw.domain != "compressed":
        raise DataError("omega-K: the data are not range compressed; call range_compress first")
    radar = raw.radar
    refusal = _refusal(radar, grid)
    if refusal:
        raise DataError(f"omega-K: {refusal}")
    wanted, grid = grid, _slant_grid(radar, grid)
    geometry = _geometry(radar, grid)
    window, own = parse_window(azimuth_window), np.isfinite(radar.half_aperture)
    weights = np.ones(radar.track.n_pulses) if own else window.aperture(radar.track.n_pulses)

    # spectrum over fast time, time origin at range_center for every pulse
    plan = plan_spectrum(radar, parse_window(range_window), extra=_walk(radar, geometry))
    bins = scipy.fft.fftfreq(plan.n_fft, 1.0 / plan.n_fft)
    used = np.flatnonzero(plan.gains > 0.0)
    used = used[np.argsort(bins[used])]
    dk = 2.0 * np.pi / (plan.n_fft * radar.window.sample_spacing)
    offset = bins[used] * dk  # k - k_c
    shift = np.exp(-1j * np.outer(radar.window.start_range - geometry.range_center, offset))
    shift = (shift * weights[:, None]).astype(np.complex64)

    factor = _normalisation(radar, grid, geometry, window) * np.sqrt(2.0 * np.pi) * np.exp(0.25j * np.pi)
    factor = factor * grid.range**2.5 / plan.n_fft
    upsampling = _upsampling(radar, grid, geometry)
    k = offset + 4.0 * np.pi / radar.waveform.wavelength

    image = np.empty((len(raw.layers), *grid.shape), dtype=np.complex64)
    for layer in range(len(raw.layers)):
        spectrum = plan.spectrum(raw.data[layer])[:, used] * shift
        dense = geometry
        if upsampling > 1:
            spectrum, dense = _densify(spectrum, k, geometry, upsampling)
        n_x = scipy.fft.next_fast_len(int(np.ceil(_period(radar, grid, dense) / dense.spacing)))
        spectrum = scipy.fft.fft(spectrum, n=n_x, axis=0, workers=-1, overwrite_x=True)
        columns, first = _stolt(spectrum, radar, grid, dense, offset, n_x, window)
        image[layer] = _to_azimuth(columns, first, n_x, grid, dense) * (factor / (n_x * dense.spacing))
        progress("focus", layer + 1.0, float(len(raw.layers)), {})
    if wanted.kind == "ground":
        kc = 4.0 * np.pi / radar.waveform.wavelength
        return to_ground(image, grid, slant_ranges(radar, wanted), kc * _cosine(geometry))
    return image


def _slant_grid(radar: Radar, grid: ImageGrid) -> ImageGrid:
    """Where the focusing itself takes place."""
    return slant_below(radar, grid) if grid.kind == "ground" else grid


def _cosine(geometry: _Geometry) -> float:
    return float(np.sqrt(max(1.0 - geometry.sin_squint**2, 0.0)))


def _refusal(radar: Radar, grid: ImageGrid) -> str:
    """What keeps omega-K from focusing a radar's data on a grid; empty when nothing does."""
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


def _geometry(radar: Radar, grid: ImageGrid) -> _Geometry:
    """Where the data and the image stand along the track's line."""
    track = radar.track
    spacing = float(np.linalg.norm((track.position[-1] - track.position[0]) / (track.n_pulses - 1)))
    x = (track.position - grid.origin) @ grid.along
    x_center = float(grid.azimuth[grid.azimuth.size // 2])
    rho = float(grid.range[grid.range.size // 2])
    middle = 0.5 * (x[0] + x[-1])
    distance = float(np.hypot(x_center - middle, rho))
    return _Geometry(x, spacing, x_center, rho, distance, (x_center - middle) / distance)


def _upsampling(radar: Radar, grid: ImageGrid, geometry: _Geometry) -> int:
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
            f"omega-K: the image needs a Doppler bandwidth of {band:.2f} times the PRF, and so folds over; "
            "shrink it in azimuth, raise prf or use focuser backprojection",
            SarmitsubaWarning,
            stacklevel=3,
        )
    return 1


def _densify(spectrum: C64, k: F64, geometry: _Geometry, factor: int) -> tuple[C64, _Geometry]:
    """Raise the pulse rate by a whole factor: deramp to the image's centre, zero-pad the Doppler spectrum, reramp."""
    n = scipy.fft.next_fast_len(spectrum.shape[0] + 2 * _GUARD)
    x = geometry.x[0] + geometry.spacing * (np.arange(n * factor) / factor - _GUARD)
    distance = np.hypot(x - geometry.x_center, geometry.rho_center) - geometry.range_center
    out = np.empty((n * factor, k.size), dtype=np.complex64)
    block = max(1, _BATCH // n)
    for start in range(0, k.size, block):
        part = slice(start, start + block)
        ramp = np.exp(1j * np.outer(distance, k[part])).astype(np.complex64)
        line = np.zeros((n, ramp.shape[1]), dtype=np.complex64)
        line[_GUARD : _GUARD + spectrum.shape[0]] = spectrum[:, part]
        line = scipy.fft.fft(line * ramp[::factor], axis=0, workers=-1)
        wide = np.zeros_like(ramp)
        wide[: n - n // 2] = line[: n - n // 2]
        wide[wide.shape[0] - n // 2 :] = line[n - n // 2 :]
        out[:, part] = scipy.fft.ifft(wide, axis=0, workers=-1) * ramp.conj()
    return out, replace(geometry, x=x, spacing=geometry.spacing / factor)


def _walk(radar: Radar, geometry: _Geometry) -> int:
    """Samples by which the range to the image's centre moves against the receive window over the aperture."""
    r = np.hypot(geometry.x - geometry.x_center, geometry.rho_center) - radar.window.start_range
    return int(np.ceil((r.max() - r.min()) / radar.window.sample_spacing))


def _period(radar: Radar, grid: ImageGrid, geometry: _Geometry) -> float:
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


def _normalisation(radar: Radar, grid: ImageGrid, geometry: _Geometry, window: Window) -> F64:
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
    """Weight w g g_filter of every pulse in omega-K's pixel at points (..., 3), giving (..., n_pulses) float64."""
    weights = aperture_weights(radar, point, azimuth_window)
    look = look_directions(radar, point)
    gain = direction_gain(radar, slice(None), look)
    return np.asarray(weights * gain * _filter_gain(radar, grid, look @ grid.along))


def _stolt(
    spectrum: C64, radar: Radar, grid: ImageGrid, geometry: _Geometry, offset: F64, n_x: int, window: Window
) -> tuple[C64, int]:
    """Map (kx, k) to (kx, rho): returns (n_kx, n_range) complex64 and the index m of its first kx = 2 pi m / period."""
    kernel = spreading_kernel(_WIDTH)
    kc = 4.0 * np.pi / radar.waveform.wavelength
    k = kc + offset
    dkx = 2.0 * np.pi / (n_x * geometry.spacing)
    nyquist = np.pi / geometry.spacing
    center = k * geometry.sin_squint
    first = int(np.ceil((center.min() - nyquist) / dkx))
    last = int(np.floor((center.max() + nyquist) / dkx))
    m = np.arange(first, last + 1)

    n_range = grid.range.size
    n_y = scipy.fft.next_fast_len(2 * n_range + 2 * _WIDTH)
    cells = n_y * grid.range_spacing / (2.0 * np.pi)  # grid cells per rad/m of k_y
    # pixel j stands at y = (j - n_range // 2) spacing; undo the kernel there
    pixel = np.arange(n_range) - n_range // 2
    deapodise = 1.0 / kernel.transform(pixel / n_y)
    ky_center = kc * _cosine(geometry)
    carrier = np.exp(1j * ky_center * pixel * grid.range_spacing) * deapodise * n_y

    out = np.zeros((m.size, n_range), dtype=np.complex64)
    rows = max(1, _BATCH // k.size)
    for start in range(0, m.size, rows):
        part = slice(start, min(start + rows, m.size))
        kx = m[part, None] * dkx
        square = k**2 - kx**2
        keep = (np.abs(kx - center) <= nyquist) & (square > 0.0)
        ky = np.sqrt(np.where(keep, square, 1.0))
        phase = geometry.rho_center * ky - offset * geometry.range_center
        phase -= kx * (geometry.x[0] - geometry.x_center)
        value = spectrum[m[part] % n_x] * np.exp(1j * phase) * (k**3 / ky**3.5)
        value *= _filter_gain(radar, grid, kx / k)
        if np.isfinite(radar.half_aperture):
            value *= band_weights(kx / k - _boresight_sine(radar), dkx / k, radar.half_aperture, window)
        value[~keep] = 0.0

        position = (ky - ky_center) * cells
        base = np.floor(position)
        taps = kernel.taps(position - base)
        row = np.arange(ky.shape[0])[:, None] * n_y
        gridded = np.zeros(ky.shape[0] * n_y, dtype=np.complex128)
        for tap, weight in enumerate(taps):
            index = (row + (base.astype(np.int64) - kernel.lead + tap) % n_y).ravel()
            part_value = value * weight
            gridded.real += np.bincount(index, part_value.real.ravel(), minlength=gridded.size)
            gridded.imag += np.bincount(index, part_value.imag.ravel(), minlength=gridded.size)
        lines = scipy.fft.ifft(gridded.reshape(-1, n_y).astype(np.complex64), axis=1, workers=-1)
        out[part] = lines[:, pixel % n_y] * carrier
    return out, first


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


def _to_azimuth(columns: C64, first: int, n_x: int, grid: ImageGrid, geometry: _Geometry) -> C64:
    r"""Evaluate :math:`\sum_m c_m e^{j 2 \pi m x / P}` at the azimuth pixels (Bluestein's chirp-z transform)."""
    n_kx, n_az = columns.shape[0], grid.azimuth.size
    turn = 2.0 * np.pi * grid.azimuth_spacing / (n_x * geometry.spacing)
    pixel = np.arange(n_az) - n_az // 2
    # i m = (i^2 + m^2 - (i - m)^2) / 2, with m counted from the band's middle to keep the chirps short
    middle = n_kx // 2
    m = np.arange(n_kx) - middle
    chirp_m = np.exp(0.5j * turn * m.astype(np.float64) ** 2)
    chirp_i = np.exp(1j * turn * pixel * (0.5 * pixel + first + middle))
    lag = np.arange(pixel[0] - m[-1], pixel[-1] - m[0] + 1)
    n = scipy.fft.next_fast_len(lag.size)
    response = scipy.fft.fft(np.exp(-0.5j * turn * lag.astype(np.float64) ** 2).astype(np.complex64), n=n)
    out = np.empty((n_az, columns.shape[1]), dtype=np.complex64)
    block = max(1, (1 << 23) // n)
    for start in range(0, columns.shape[1], block):
        part = slice(start, start + block)
        line = scipy.fft.fft(
            (columns[:, part] * chirp_m[:, None]).astype(np.complex64), n=n, axis=0, workers=-1
        )
        line = scipy.fft.ifft(line * response[:, None], axis=0, workers=-1)
        out[:, part] = line[n_kx - 1 : n_kx - 1 + n_az] * chirp_i[:, None]
    return out


@dataclass(frozen=True)
class OmegaK(Focuser):
    """Wavenumber-domain focusing: fast, for straight tracks and grids along them; see :func:`omega_k`."""

    name: ClassVar[str] = "omega_k"
    title: ClassVar[str] = "straight, level, uniform track and a grid along it; fast for large images"

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Why it cannot focus this radar's data on this grid; empty when it can."""
        return _refusal(radar, grid)

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """Of the stationary phase of the track's transform, for apertures from 50 pulses."""
        return -65.0 if azimuth_fits(radar, grid) and radar.track.n_pulses >= 50 else float("nan")

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Transforms and the mapping of every sample of the data."""
        return SAMPLE_SECONDS * radar.track.n_pulses * radar.window.n_samples

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        radar, grid = task.raw.radar, task.grid
        pixels = omega_k(
            task.raw,
            grid,
            range_window=task.range_window,
            azimuth_window=task.azimuth_window,
            progress=task.progress,
        )
        slant = _slant_grid(radar, grid)
        return Focused(pixels, lambda point: pulse_weights(radar, slant, point, task.azimuth_window))


FOCUSERS.register(OmegaK())

__all__ = ["OmegaK", "omega_k", "pulse_weights"]
