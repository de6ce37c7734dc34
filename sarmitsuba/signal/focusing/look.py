"""Image formation from looks: grid plan, convolution with the impulse response, resampling to the pixels."""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.look_geometry import LookGeometry, geometries
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.look_grid import LookGrid

# resolution cells around the image whose side lobes are included
_MARGIN = 24.0
# pixels that are resampled together, and cells of the response that are made together; bounds the temporaries
_BATCH = 1 << 20
# largest frequency of a curved response, cycles per cell
_USED = 0.4
# share of the distance to the first azimuth ambiguity up to which the response is corrected for the width of the pulses
_FADED = 0.75


@dataclass(frozen=True, eq=False)
class Look:
    """Looks at a scene and their image formation.

    Parameters
    ----------
    time : (n_looks,) float64, s, of each look
    grid : where contributions are added
    image : the pixels
    offset : (n_azimuth, n_range) float64, m; range coordinate of each pixel less the grid's reference range
    x, y : (n_azimuth, n_range) float32, pixels on the grid, in cells
    gain : (n_azimuth, n_range) float32, range^2 / K: from received amplitude to square root of RCS
    response : (n_range, n_azimuth) float32 or complex64, spectrum of the impulse response, both gridding kernels
        divided out, FFT order
    noise_gain : rms of a pixel's noise over that of one range-compressed sample times ``gain``
    agreement : least coherence of clutter with backprojection's image, from the pulses' directions
    """

    time: F64
    grid: LookGrid
    image: ImageGrid
    offset: F64
    x: F32
    y: F32
    gain: F32
    response: F32 | C64
    noise_gain: float
    agreement: float


def plan_look(
    radar: Radar,
    image: ImageGrid,
    *,
    range_window: str = "rectangular",
    azimuth_window: str = "rectangular",
    width: int = 5,
) -> Look:
    r"""Plan of the looks that represent the apertures of all pixels.

    Where all pixels have the same pulses it is one look, from the aperture's centroid as seen from the image's centre.
    Every pulse t and frequency f of the aperture samples the spectrum of the image over (range, range rate) at

    .. math:: k_R = 4 \pi f / c, \quad k_s = 4 \pi (f_c + f) (t - t_c) / c,

    f the baseband frequency: the support of the response is that band with its windows. Where a beam passes over the
    pixels one after the other, the coordinates are those of its fan, p and c, with

    .. math:: k_p = 4 \pi ((f_c + f) \cos\delta - f_c) / c, \quad k_c = 4 \pi (f_c + f) \sin\delta \; (db / dc) / c,

    delta the angle of the pulse's line of sight off the pixel's beam axis.

    Parameters
    ----------
    radar : gives track, waveform and, for the weights of the pulses, antenna
    image : pixels wanted
    range_window, azimuth_window : as for :func:`sarmitsuba.signal.focusing.focus`
    width : of the gridding kernel of raw data

    Raises
    ------
    DataError
        One impulse response is not valid for all pixels: use another method.

    Notes
    -----
    Ignores how visibility, amplitude and wavefront curvature change over the aperture, and the defocusing of
    objects off the image plane by a track that is not straight.
    """
    geometry = geometries(radar, image, azimuth_window)
    if geometry.fan is None:
        # a narrower kernel by one cell each way: gridding dominates the time, and -44 dB is below the error of one look
        width = max(2, width - 1)
    steps = _steps(radar, geometry)
    places = image.positions()
    bare = geometry.grid(width, steps)
    pixel_look = geometry.nearest(bare, places)
    distance, range_rate = bare.state(places, pixel_look)
    r, s, distance = bare.coordinates(distance, range_rate, pixel_look)
    margin_r, margin_s = (2.0 * _MARGIN * step for step in steps)
    n_range, n_azimuth = (_cells(v, step) for v, step in zip((r, s), steps, strict=True))
    reference = float(0.5 * (r.min() + r.max()))
    grid = geometry.grid(
        width,
        steps,
        reference,
        (float(r.min()) - margin_r - reference, float(s.min()) - margin_s),
        (n_range, n_azimuth),
    )
    weights = geometry.weights
    broadening = parse_window(range_window).broadening
    return Look(
        time=geometry.time,
        grid=grid,
        image=image,
        offset=r - reference,
        x=((r - reference - grid.range0) / grid.range_step).astype(np.float32),
        y=((s - grid.azimuth0) / grid.azimuth_step).astype(np.float32),
        gain=(distance**2 / radar.amplitude_constant).astype(np.float32),
        response=_response(radar, grid, geometry, range_window),
        noise_gain=float(np.sqrt(broadening * np.sum(weights**2)) / np.sum(weights)),
        agreement=geometry.agreement,
    )


def look_size(radar: Radar, image: ImageGrid) -> tuple[int, int, int]:
    """Approximate cells in range and azimuth of the grid of :func:`plan_look`, and the number of looks.

    Raises
    ------
    DataError
        As :func:`plan_look` does.
    """
    geometry = geometries(radar, image, "rectangular")
    steps = _steps(radar, geometry)
    bare = geometry.grid(1, steps)
    lines = np.array([image.positions_on_line(i) for i in (0, image.shape[0] // 2, image.shape[0] - 1)])
    look = geometry.nearest(bare, lines)
    r, s, _ = bare.coordinates(*bare.state(lines, look), look)
    return _cells(r, steps[0]), _cells(s, steps[1]), bare.n_looks


def _cells(values: F64, step: float) -> int:
    """Number of cells that contain the values with a margin on either side, of a fast FFT length."""
    return int(
        scipy.fft.next_fast_len(int(np.ceil((np.ptp(values) + 2.0 * (2.0 * _MARGIN * step)) / step)) + 1)
    )


def _steps(radar: Radar, geometry: LookGeometry) -> tuple[float, float]:
    """Cells of the grid's range and azimuth coordinate: 1/4 cycle per cell at the ends of the band."""
    wave = radar.waveform
    reach = float(np.abs(geometry.edges).max())
    highest = wave.center_frequency + 0.5 * wave.bandwidth
    if geometry.fan is None:
        return 0.5 * wave.range_cell, SPEED_OF_LIGHT / (8.0 * highest * reach)
    # a band of rotating directions extends to lower frequencies along the central one
    turned = wave.bandwidth + 2.0 * wave.center_frequency * (1.0 - np.cos(reach))
    # side lobes of the band's ends shift with the aperture from place to place
    fan = geometry.fan
    lobes = 0.5 * _MARGIN * SPEED_OF_LIGHT / (4.0 * wave.center_frequency * np.sin(reach))
    bent = 1.0 + min(1.0, lobes * (fan.cosine / fan.closest_range + fan.curvature) / np.sin(reach))
    return (
        SPEED_OF_LIGHT / (4.0 * turned),
        SPEED_OF_LIGHT / (8.0 * highest * np.sin(reach) * fan.stretch * bent),
    )


def _response(radar: Radar, grid: LookGrid, geometry: LookGeometry, range_window: str) -> F32 | C64:
    """Spectrum of the impulse response on the grid's FFT bins, both gridding kernels divided out."""
    kernel = grid.kernel
    correction = np.outer(
        kernel.transform(scipy.fft.fftfreq(grid.n_range)),
        kernel.transform(scipy.fft.fftfreq(grid.n_azimuth)),
    )
    if grid.fan is None:
        spectrum = _one_spectrum(radar, grid, geometry, range_window)
        spectrum *= spectrum.size / spectrum.sum()  # unit peak
        return np.asarray(spectrum / np.where(spectrum > 0.0, correction, 1.0) ** 2, dtype=np.float32)
    bent = _fan_response(radar, grid, geometry, range_window)
    bent[:, np.abs(scipy.fft.fftfreq(grid.n_azimuth)) > _USED] = 0.0
    bent /= (correction**2).astype(np.float32)
    return bent


def _fan_response(radar: Radar, grid: LookGrid, geometry: LookGeometry, range_window: str) -> C64:
    r"""Spectrum of a fan's response, with the weighting of scatterers off the pixel's beam axis by its aperture.

    During the pixel's aperture a scatterer at b across its axis has its own gains, and a phase from the curvature of
    the wavefront and of the fan's circles,

    .. math:: \exp\left(-\frac{2 \pi j}{\lambda} b^2 (1 / R + \kappa)\right)
    """
    assert grid.fan is not None
    fan = grid.fan
    index = scipy.fft.fftfreq(grid.n_azimuth, 1.0 / grid.n_azimuth)
    shift = index * grid.azimuth_step
    bend = fan.cosine / fan.closest_range + fan.curvature
    wavelength = radar.waveform.wavelength
    phase = np.exp(-2j * np.pi / wavelength * bend * (shift * fan.stretch) ** 2)
    # pulses are discrete directions, and the spectrum spreads each to the next one: this attenuates distant scatterers
    apart = float(np.mean(np.diff(geometry.edges))) * 2.0 * fan.stretch / wavelength
    phase /= np.sinc(np.clip(shift * apart, -_FADED, _FADED))
    out = np.zeros((grid.n_range, grid.n_azimuth), dtype=np.complex64)
    total = 0.0
    for weights, change in geometry.lit_across:
        part = np.interp(shift, geometry.shifts, change, left=0.0, right=0.0)
        spectrum = _fan_spectrum(radar, grid, geometry, weights, range_window).astype(np.complex64)
        total += float(spectrum.real.sum(dtype=np.float64) * part[0])
        field = scipy.fft.ifft(spectrum, axis=1, workers=-1, overwrite_x=True)
        field *= (phase * part).astype(np.complex64)
        out += field
    out *= np.float32(out.size / total)  # unit peak
    return np.asarray(scipy.fft.fft(out, axis=1, workers=-1, overwrite_x=True))


def _cumulative(range_window: str) -> tuple[F64, F64]:
    """Places on the band, -1/2 to 1/2, and the integral of the window up to there."""
    fine = np.linspace(-0.5, 0.5, 4097)
    window = parse_window(range_window)(fine)
    return fine, np.concatenate([[0.0], np.cumsum(0.5 * (window[1:] + window[:-1]) * np.diff(fine))])


def _one_spectrum(radar: Radar, grid: LookGrid, geometry: LookGeometry, range_window: str) -> F64:
    """Band over baseband frequency and range rate for pixels with the same pulses."""
    wave, edges = radar.waveform, geometry.edges
    bins = (
        scipy.fft.fftfreq(grid.n_range) * SPEED_OF_LIGHT / (2.0 * grid.range_step)
    )  # baseband frequency, Hz
    half = 0.25 * SPEED_OF_LIGHT / (grid.n_range * grid.range_step)
    fine, cumulative = _cumulative(range_window)
    band = np.interp((bins + half) / wave.bandwidth, fine, cumulative)
    band -= np.interp((bins - half) / wave.bandwidth, fine, cumulative)

    summed = np.concatenate([[0.0], np.cumsum(geometry.weights)])
    wave_rate = scipy.fft.fftfreq(grid.n_azimuth) / grid.azimuth_step  # cycles per m/s
    half_rate = 0.5 / (grid.n_azimuth * grid.azimuth_step)
    seconds = SPEED_OF_LIGHT / (2.0 * (wave.center_frequency + bins))[:, None]
    aperture = np.interp((wave_rate + half_rate) * seconds, edges, summed)
    aperture -= np.interp((wave_rate - half_rate) * seconds, edges, summed)
    return np.asarray(band[:, None] * aperture)


def _fan_spectrum(
    radar: Radar, grid: LookGrid, geometry: LookGeometry, weights: F64, range_window: str
) -> F64:
    """Band over the fan's coordinates: frequencies are circles about the origin, pulses are lines from there.

    ``weights`` (n,) : of the illuminating pulses
    """
    assert grid.fan is not None
    wave, edges = radar.waveform, geometry.edges
    fine, cumulative = _cumulative(range_window)
    summed = np.concatenate([[0.0], np.cumsum(weights)])
    # both wavenumbers as frequencies, Hz
    ahead = wave.center_frequency + scipy.fft.fftfreq(grid.n_range, grid.range_step) * 0.5 * SPEED_OF_LIGHT
    unit = 0.5 * SPEED_OF_LIGHT / grid.fan.stretch
    aside = scipy.fft.fftfreq(grid.n_azimuth, grid.azimuth_step) * unit
    half_ahead = 0.25 * SPEED_OF_LIGHT / (grid.n_range * grid.range_step)
    half_aside = 0.5 * unit / (grid.n_azimuth * grid.azimuth_step)
    spectrum = np.empty((grid.n_range, grid.n_azimuth))
    rows = max(1, _BATCH // grid.n_azimuth)
    for start in range(0, grid.n_range, rows):
        row = ahead[start : start + rows, None]
        frequency, angle = np.hypot(row, aside), np.arctan2(aside, row)
        place, half = (frequency - wave.center_frequency) / wave.bandwidth, half_ahead / wave.bandwidth
        band = np.interp(place + half, fine, cumulative) - np.interp(place - half, fine, cumulative)
        half_angle = half_aside / frequency
        band *= np.interp(angle + half_angle, edges, summed) - np.interp(angle - half_angle, edges, summed)
        spectrum[start : start + rows] = band
    return spectrum


def form_image(cells: NDArray[np.complexfloating], look: Look, radar: Radar) -> C64:
    r"""Image formation: pixels from the filled grid of the looks.

    A path of amplitude :math:`K \sqrt\sigma / R^2` becomes the impulse response with peak :math:`\sqrt\sigma`, and
    the carrier's phase at every pixel is that of backprojection, :math:`4 \pi f_c (R_{pixel} - R_{path}) / c`.

    Parameters
    ----------
    cells : (n_layers, n_range, n_azimuth) complex, any strides

    Returns
    -------
    (n_layers, n_azimuth, n_range) complex64
    """
    out = np.empty((cells.shape[0], *look.image.shape), dtype=np.complex64)
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    carrier = look.gain * np.exp(1j * np.mod(wavenumber * look.offset, 2.0 * np.pi)).astype(np.complex64)
    for layer, plane in enumerate(cells):
        spectrum = scipy.fft.fft2(np.asarray(plane, dtype=np.complex64), workers=-1)
        spectrum *= look.response
        smooth = scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True)
        out[layer] = resample(smooth, look) * carrier
    return out


def adjoint_cells(image: C64, look: Look, radar: Radar) -> C64:
    """Adjoint of :func:`form_image`: ``sum(conj(image) form_image(cells)) = sum(conj(adjoint_cells(image)) cells)``.

    Parameters
    ----------
    image : (n_layers, n_azimuth, n_range) complex

    Returns
    -------
    (n_layers, n_range, n_azimuth) complex64
    """
    kernel, grid = look.grid.kernel, look.grid
    out = np.empty((len(image), grid.n_range, grid.n_azimuth), dtype=np.complex64)
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    carrier = look.gain * np.exp(-1j * np.mod(wavenumber * look.offset, 2.0 * np.pi)).astype(np.complex64)
    x, y = look.x.reshape(-1), look.y.reshape(-1)
    base_x, base_y = np.floor(x + kernel.shift), np.floor(y + kernel.shift)
    taps_x, taps_y = kernel.taps(x + kernel.shift - base_x), kernel.taps(y + kernel.shift - base_y)
    first = (base_x.astype(np.int64) - kernel.lead) * grid.n_azimuth + base_y.astype(np.int64) - kernel.lead
    size = grid.n_range * grid.n_azimuth
    for layer, plane in enumerate(image):
        value = (plane * carrier).reshape(-1)
        cells = np.zeros(size, dtype=np.complex128)
        for i, tx in enumerate(taps_x):
            for j, ty in enumerate(taps_y):
                place, part = first + (i * grid.n_azimuth + j), value * (tx * ty)
                cells += np.bincount(place, part.real, size) + 1j * np.bincount(place, part.imag, size)
        spectrum = scipy.fft.fft2(
            cells.reshape(grid.n_range, grid.n_azimuth).astype(np.complex64), workers=-1
        )
        spectrum *= np.conj(look.response)
        out[layer] = scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True)
    return out


def resample(smooth: C64, look: Look) -> C64:
    """Interpolate a band-limited field on the look's grid at the pixels with the gridding kernel."""
    kernel, grid = look.grid.kernel, look.grid
    flat = np.ascontiguousarray(smooth).reshape(-1)
    out = np.empty(look.x.size, dtype=np.complex64)
    for start in range(0, look.x.size, _BATCH):
        x, y = look.x.reshape(-1)[start : start + _BATCH], look.y.reshape(-1)[start : start + _BATCH]
        base_x, base_y = np.floor(x + kernel.shift), np.floor(y + kernel.shift)
        taps_x, taps_y = kernel.taps(x + kernel.shift - base_x), kernel.taps(y + kernel.shift - base_y)
        first = (
            (base_x.astype(np.int64) - kernel.lead) * grid.n_azimuth + base_y.astype(np.int64) - kernel.lead
        )
        total = np.zeros(x.size, dtype=np.complex64)
        for i, tx in enumerate(taps_x):
            row = np.zeros(x.size, dtype=np.complex64)
            for j, ty in enumerate(taps_y):
                row += flat[first + (i * grid.n_azimuth + j)] * ty
            total += row * tx
        out[start : start + _BATCH] = total
    return out.reshape(look.x.shape)
