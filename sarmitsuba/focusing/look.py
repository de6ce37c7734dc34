"""One look as an image: plan of its grid, convolution with the impulse response, resampling to the pixels."""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.echo.look_grid import LookGrid
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.aperture import matched_weights
from sarmitsuba.focusing.windows import parse_window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]

# resolution cells about the image from which side lobes are taken in
_MARGIN = 24.0
# pixels that are resampled together; bounds the temporaries
_BATCH = 1 << 20


@dataclass(frozen=True, eq=False)
class Look:
    """One look at a scene and how it becomes an image.

    Parameters
    ----------
    time : s, of the look
    grid : where contributions are added
    image : the pixels
    offset : (n_azimuth, n_range) float64, m; range coordinate of each pixel less the grid's reference range
    x, y : (n_azimuth, n_range) float32, pixels on the grid, in cells
    gain : (n_azimuth, n_range) float32, range^2 / K: from received amplitude to square root of RCS
    response : (n_range, n_range_rate) float32, spectrum of the impulse response, both spreadings divided out, FFT order
    noise_gain : rms of a pixel's noise over that of one range-compressed sample times ``gain``
    """

    time: float
    grid: LookGrid
    image: ImageGrid
    offset: F64
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    gain: NDArray[np.float32]
    response: NDArray[np.float32]
    noise_gain: float


def plan_look(
    radar: Radar,
    image: ImageGrid,
    *,
    range_window: str = "rectangular",
    azimuth_window: str = "rectangular",
    width: int = 4,
) -> Look:
    r"""Plan the one look that stands for the whole aperture.

    It is taken from the aperture's centroid as seen from the image's centre. Every pulse t and frequency f of the
    aperture samples the spectrum of the image over (range, range rate) at

    .. math:: k_R = 4 \pi f / c, \quad k_s = 4 \pi (f_c + f) (t - t_c) / c,

    f the baseband frequency: the support of the response is that band with its windows.

    Parameters
    ----------
    radar : gives track, waveform and, for the weights of the pulses, antenna
    image : pixels wanted
    range_window, azimuth_window : as for :func:`sarmitsuba.focusing.focus`
    width : of the spreading kernel

    Notes
    -----
    Ignores how visibility, amplitude and wavefront curvature change over the aperture, and the defocusing of
    objects off the image plane by a track that is not straight.
    """
    weights, time, position, velocity = _centroid(radar, image, azimuth_window)
    # a beam fixed to the track passes over every pixel in turn: each has an aperture of its own
    zero_doppler = (
        radar.mode_law.own_apertures and radar.antenna.pattern != "isotropic" and radar.track.is_straight
    )
    leg = image.positions() - position
    distance = np.linalg.norm(leg, axis=-1)
    range_rate = -(leg @ velocity) / distance

    wave = radar.waveform
    tau, cosine = radar.track.time - time, 1.0
    if zero_doppler:  # pulses relative to the closest approach of the image's centre
        center = tuple(n // 2 for n in image.shape)
        tau = tau + range_rate[center] * distance[center] / float(velocity @ velocity)
        # range along closest approach changes by the cosine of the squint, azimuth by its sine, not its tangent
        cosine = float(np.sqrt(1.0 - range_rate[center] ** 2 / float(velocity @ velocity)))
        tau = tau * cosine
    lit = np.flatnonzero(weights > 0.0)
    weights, tau = weights[lit[0] : lit[-1] + 1], tau[lit[0] : lit[-1] + 1]
    edges = _edges(tau)
    reach = float(np.abs(edges).max())
    highest = wave.center_frequency + 0.5 * wave.bandwidth
    range_step = 0.5 * wave.range_cell
    range_rate_step = SPEED_OF_LIGHT / (
        8.0 * highest * reach
    )  # 1/4 cycle per cell at the end of the aperture
    bare = LookGrid(position, velocity, zero_doppler, 0.0, 0.0, range_step, 1, 0.0, range_rate_step, 1, width)
    r, s = bare.coordinates(distance, range_rate)
    margin_r, margin_s = 2.0 * _MARGIN * range_step, 2.0 * _MARGIN * range_rate_step
    n_range = int(scipy.fft.next_fast_len(int(np.ceil((np.ptp(r) + 2.0 * margin_r) / range_step)) + 1))
    n_range_rate = int(
        scipy.fft.next_fast_len(int(np.ceil((np.ptp(s) + 2.0 * margin_s) / range_rate_step)) + 1)
    )
    reference = float(0.5 * (r.min() + r.max()))
    grid = LookGrid(
        position=position,
        velocity=velocity,
        zero_doppler=zero_doppler,
        reference_range=reference,
        range0=float(r.min()) - margin_r - reference,
        range_step=range_step,
        n_range=n_range,
        range_rate0=float(s.min()) - margin_s,
        range_rate_step=range_rate_step,
        n_range_rate=n_range_rate,
        width=width,
    )
    response = _response(radar, grid, edges, weights, range_window, cosine)
    broadening = parse_window(range_window).broadening
    return Look(
        time=time,
        grid=grid,
        image=image,
        offset=r - reference,
        x=((r - reference - grid.range0) / range_step).astype(np.float32),
        y=((s - grid.range_rate0) / range_rate_step).astype(np.float32),
        gain=(distance**2 / radar.amplitude_constant).astype(np.float32),
        response=response,
        noise_gain=float(np.sqrt(broadening * np.sum(weights**2)) / np.sum(weights)),
    )


def _centroid(radar: Radar, image: ImageGrid, azimuth_window: str) -> tuple[F64, float, F64, F64]:
    """Weights of the pulses at the image's centre, their mean time, and the antenna's place and velocity then."""
    track = radar.track
    middle = image.positions_on_line(image.shape[0] // 2)[image.shape[1] // 2]
    weights = matched_weights(radar, middle, azimuth_window)
    if not weights.any():
        raise DataError("image: no pulse illuminates the image's centre; move the image into the beam")
    share = weights / weights.sum()
    time = float(share @ track.time)
    position = np.array([np.interp(time, track.time, track.position[:, i]) for i in range(3)])
    centered = track.time - time
    spread = float(share @ centered**2)
    if spread == 0.0:
        return weights, time, position, track.velocity[track.center_index]
    velocity = (share * centered) @ (track.position - share @ track.position) / spread
    return weights, time, position, np.asarray(velocity)


def _edges(tau: F64) -> F64:
    """(n + 1,) limits of the time that each of n pulses stands for, s."""
    if tau.size < 2:
        return np.array([tau[0] - 0.5, tau[0] + 0.5]) * 1e-6
    middle = 0.5 * (tau[1:] + tau[:-1])
    return np.concatenate([[2.0 * tau[0] - middle[0]], middle, [2.0 * tau[-1] - middle[-1]]])


def _response(
    radar: Radar, grid: LookGrid, edges: F64, weights: F64, range_window: str, cosine: float
) -> NDArray[np.float32]:
    """Spectrum of the impulse response on the grid's FFT bins, each bin by the part of the band that it holds.

    ``cosine`` : change of slant range over that of the grid's range coordinate
    """
    wave = radar.waveform
    bins = (
        scipy.fft.fftfreq(grid.n_range) * SPEED_OF_LIGHT / (2.0 * grid.range_step)
    )  # baseband frequency, Hz
    half = 0.25 * SPEED_OF_LIGHT / (grid.n_range * grid.range_step)
    bins, half = bins / cosine, half / cosine
    fine = np.linspace(-0.5, 0.5, 4097)
    window = parse_window(range_window)(fine)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (window[1:] + window[:-1]) * np.diff(fine))])
    band = np.interp((bins + half) / wave.bandwidth, fine, cumulative)
    band -= np.interp((bins - half) / wave.bandwidth, fine, cumulative)

    summed = np.concatenate([[0.0], np.cumsum(weights)])
    wave_rate = scipy.fft.fftfreq(grid.n_range_rate) / grid.range_rate_step  # cycles per m/s
    half_rate = 0.5 / (grid.n_range_rate * grid.range_rate_step)
    seconds = SPEED_OF_LIGHT / (2.0 * (wave.center_frequency + bins))[:, None]
    aperture = np.interp((wave_rate + half_rate) * seconds, edges, summed)
    aperture -= np.interp((wave_rate - half_rate) * seconds, edges, summed)

    spectrum = band[:, None] * aperture
    spectrum *= spectrum.size / spectrum.sum()  # unit peak
    kernel = grid.kernel
    correction = np.outer(
        kernel.transform(scipy.fft.fftfreq(grid.n_range)),
        kernel.transform(scipy.fft.fftfreq(grid.n_range_rate)),
    )
    return np.asarray(spectrum / np.where(spectrum > 0.0, correction, 1.0) ** 2, dtype=np.float32)


def form_image(cells: NDArray[np.complexfloating], look: Look, radar: Radar) -> C64:
    r"""Make the pixels from the look's filled grid.

    A path of amplitude :math:`K \sqrt\sigma / R^2` becomes the impulse response with peak :math:`\sqrt\sigma`, and
    the carrier's phase at every pixel is that of backprojection, :math:`4 \pi f_c (R_{pixel} - R_{path}) / c`.

    Parameters
    ----------
    cells : (n_layers, n_range, n_range_rate) complex, any strides

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


def resample(smooth: C64, look: Look) -> C64:
    """Interpolate a band-limited field on the look's grid at the pixels with the spreading kernel."""
    kernel, grid = look.grid.kernel, look.grid
    flat = np.ascontiguousarray(smooth).reshape(-1)
    out = np.empty(look.x.size, dtype=np.complex64)
    for start in range(0, look.x.size, _BATCH):
        x, y = look.x.reshape(-1)[start : start + _BATCH], look.y.reshape(-1)[start : start + _BATCH]
        base_x, base_y = np.floor(x + kernel.shift), np.floor(y + kernel.shift)
        taps_x, taps_y = kernel.taps(x + kernel.shift - base_x), kernel.taps(y + kernel.shift - base_y)
        first = (
            (base_x.astype(np.int64) - kernel.lead) * grid.n_range_rate
            + base_y.astype(np.int64)
            - kernel.lead
        )
        total = np.zeros(x.size, dtype=np.complex64)
        for i, tx in enumerate(taps_x):
            row = np.zeros(x.size, dtype=np.complex64)
            for j, ty in enumerate(taps_y):
                row += flat[first + (i * grid.n_range_rate + j)] * ty
            total += row * tx
        out[start : start + _BATCH] = total
    return out.reshape(look.image.shape)


__all__ = ["Look", "form_image", "plan_look", "resample"]
