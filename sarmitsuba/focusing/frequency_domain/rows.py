r"""Common parts of the frequency-domain focusers: raw data to two-dimensional spectrum, and range lines to pixels.

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

from sarmitsuba.arrays import C64, F64
from sarmitsuba.echo.phasor import phase_ramp, unit_phasor
from sarmitsuba.errors import DataError, SarmitsubaWarning
from sarmitsuba.focusing.focuser import Focused, FocusTask
from sarmitsuba.focusing.frequency_domain.aperture_filter import aperture_filter
from sarmitsuba.focusing.frequency_domain.chirp_z import ChirpZ
from sarmitsuba.focusing.frequency_domain.track_geometry import (
    TrackGeometry,
    own_apertures,
    range_walk,
    rate_factor,
    slant_grid,
    track_geometry,
    track_period,
    track_refusal,
    wavenumber,
)
from sarmitsuba.focusing.frequency_domain.weights import normalisation, pulse_weights
from sarmitsuba.focusing.ground import slant_ranges, to_ground
from sarmitsuba.focusing.profiles import ProfilePlan, plan_spectrum
from sarmitsuba.focusing.windows import Window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

# Doppler band of the image over the PRF above which a warning about azimuth aliasing is given
_FOLDED = 1.05
# samples of the spectrum mapped at once by a thread: bounds the temporary memory and fits the caches
_BATCH = 1 << 18
# bins beyond the band's edges that a longer transform keeps: profiles that end with the receive window leak there
_EDGE = 16
# pulses of zeros on either side of the aperture while the pulse rate is raised
_GUARD = 32


@dataclass(frozen=True, eq=False)
class WavenumberBand:
    """Wavenumbers of the spectrum's rows, and the pixels made from them.

    Parameters
    ----------
    center_wavenumber : k_c, rad/m
    first, count, step : wavenumbers k - k_c are ``(first + arange(count)) * step``, rad/m
    sines : (2,) float64, range of k_x / k
    rho : (n_range,) float64, m, ranges of the pixels
    geometry : of data and image
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
        """(n_range,) float64, m, range pixels minus the reference range."""
        return np.asarray(
            (np.arange(self.rho.size, dtype=np.float64) - self.rho.size // 2) * self.pixel_spacing
        )


class RangeLaw(ABC):
    """Evaluation of the sum over k by one algorithm, row by row of the spectrum."""

    @abstractmethod
    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Phase, rad, (rows, count), that multiplies the spectrum; ``kx`` is (rows, 1), ``offset`` (count,)."""

    @abstractmethod
    def lines(self, spectrum: C64, kx: F64, ky: F64) -> C64:
        """Pixels (rows, n_range) of rows of the spectrum (rows, count); zero without data."""


def _no_room(sines: F64, extent: float) -> float:
    """Range margin, zero, of an algorithm that does not shift echoes."""
    return 0.0


def focus_rows(
    name: str,
    task: FocusTask,
    law: Callable[[WavenumberBand], RangeLaw],
    room: Callable[[F64, float], float] = _no_room,
) -> Focused:
    """Focus range-compressed data of a straight track with one algorithm's law.

    Parameters
    ----------
    name : of the algorithm, for messages
    task : what to focus; a ground grid is interpolated from the slant grid of its ranges
    law : makes the algorithm's law from the band
    room : range margin, m, that the algorithm needs for data of a range of sines and an extent in m

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
    a still wider image is aliased, with a warning.
    """
    raw, radar = task.raw, task.raw.radar
    if raw.domain != "compressed":
        raise DataError(f"{name}: the data are not range compressed; call range_compress first")
    refusal = track_refusal(radar, task.grid)
    if refusal:
        raise DataError(f"{name}: {refusal}")
    grid = slant_grid(radar, task.grid)
    geometry = track_geometry(radar, grid)
    own = own_apertures(radar)
    weights = np.ones(radar.track.n_pulses) if own else task.azimuth_window.aperture(radar.track.n_pulses)

    upsampling, band_fill = rate_factor(radar, grid, geometry)
    if band_fill > _FOLDED:
        warnings.warn(
            f"{name}: the image needs a Doppler bandwidth of {band_fill:.2f} times the PRF, and so folds over; "
            "shrink it in azimuth, raise prf or use focuser backprojection",
            SarmitsubaWarning,
            stacklevel=3,
        )
    kc = wavenumber(radar)
    reach = replace(geometry, spacing=geometry.spacing / upsampling).reach(kc)
    sines = np.clip(geometry.sin_squint + np.array([-reach, reach]), -0.999, 0.999)
    extra = range_walk(radar, grid, geometry) + int(
        np.ceil(room(sines, radar.window.extent) / radar.window.sample_spacing)
    )
    plan = plan_spectrum(radar, task.range_window)
    n_fft = max(plan.n_fft, plan_spectrum(radar, task.range_window, extra=extra).n_fft)
    used = scipy.fft.fftfreq(plan.n_fft)[plan.gains > 0.0]
    low = max(int(used.min() * n_fft) - _EDGE, -(n_fft // 2))
    high = min(int(used.max() * n_fft) + _EDGE, (n_fft - 1) // 2)
    band = WavenumberBand(
        center_wavenumber=kc,
        first=low,
        count=high - low + 1,
        step=2.0 * np.pi / (n_fft * radar.window.sample_spacing),
        sines=sines,
        rho=grid.range,
        geometry=geometry,
    )
    factor = normalisation(radar, grid, geometry, task.azimuth_window) * (grid.range**2.5 / n_fft)
    turn = np.sqrt(2.0 * np.pi) * np.exp(0.25j * np.pi)
    rows_law = law(band)
    image = np.empty((len(raw.layers), *grid.shape), dtype=np.complex64)
    for layer in range(len(raw.layers)):
        spectrum = _range_spectrum(raw.data[layer], radar, plan, n_fft, band, weights)
        dense = geometry
        if upsampling > 1:
            spectrum, dense = _densify(spectrum, kc + band.offset, geometry, upsampling)
        n_x = int(scipy.fft.next_fast_len(int(np.ceil(track_period(radar, grid, dense) / dense.spacing))))
        spectrum = scipy.fft.fft(spectrum, n=n_x, axis=0, workers=-1, overwrite_x=True)
        columns, first = _map_rows(spectrum, radar, grid, dense, band, rows_law, n_x, task.azimuth_window)
        del spectrum
        _to_azimuth(columns, first, n_x, dense, grid, image[layer])
        image[layer] *= (factor * (1.0 / (n_x * dense.spacing))).astype(np.float32) * np.complex64(turn)
        task.progress("focus", layer + 1.0, float(len(raw.layers)), {})
    if task.grid.kind == "ground":
        image = to_ground(image, grid, slant_ranges(radar, task.grid), kc * geometry.cosine)
    return Focused(image, lambda point: pulse_weights(radar, grid, point, task.azimuth_window))


def _in_threads(work: Callable[[int, int], None], count: int, block: int) -> None:
    """Call ``work(start, stop)`` for all of ``count`` in blocks, on all cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # reading the results raises exceptions of the threads
        list(pool.map(lambda start: work(start, min(start + block, count)), range(0, count, block)))


def _range_spectrum(
    data: C64, radar: Radar, plan: ProfilePlan, n_fft: int, band: WavenumberBand, weights: F64
) -> C64:
    """Weighted spectra (n_pulses, count) over fast time, its origin at the range to the image's centre for all."""
    out = np.empty((data.shape[0], band.count), dtype=np.complex64)
    index = (band.first + np.arange(band.count)) % n_fft
    shift = radar.window.start_range - band.geometry.range_center

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        line = plan.spectrum(data[part], workers=1)
        if n_fft > plan.n_fft:
            # longer transforms weight the band's edges differently: first the profiles common to all focusers are made
            line = scipy.fft.ifft(line, axis=1, overwrite_x=True)[:, : data.shape[1]]
            line = scipy.fft.fft(line, n=n_fft, axis=1, overwrite_x=True)
        line = line[:, index]
        line *= phase_ramp(-shift[part] * band.step, band.first, band.count)
        line *= weights[part, None].astype(np.float32)
        out[part] = line

    _in_threads(work, data.shape[0], max(1, _BATCH // n_fft))
    return out


def _map_rows(
    spectrum: C64,
    radar: Radar,
    grid: ImageGrid,
    geometry: TrackGeometry,
    band: WavenumberBand,
    law: RangeLaw,
    n_x: int,
    window: Window,
) -> tuple[C64, int]:
    """Map (kx, k) to (kx, rho): returns (n_kx, n_range) complex64 and the index m of its first kx = 2 pi m / period."""
    offset = band.offset
    k = band.center_wavenumber + offset
    dkx = 2.0 * np.pi / (n_x * geometry.spacing)
    center = k * geometry.sin_squint
    side = geometry.reach(band.center_wavenumber) * band.center_wavenumber
    first = int(np.ceil((center.min() - side) / dkx))
    last = int(np.floor((center.max() + side) / dkx))
    m = np.arange(first, last + 1)
    reach = np.array([first, last + 1]) * (dkx / k.min())
    aperture = aperture_filter(radar, grid, geometry, window, reach)
    out = np.zeros((m.size, grid.range.size), dtype=np.complex64)

    def work(start: int, stop: int) -> None:
        kx: F64 = np.asarray(m[start:stop, None] * dkx, dtype=np.float64)
        square = k**2 - kx**2
        keep = (np.abs(kx - center) <= side) & (square > 0.0)
        ky: F64 = np.sqrt(np.where(keep, square, 1.0))
        phase = law.bulk(kx, ky, offset)
        phase -= offset * geometry.range_center
        phase -= kx * (geometry.x[0] - geometry.x_center)
        ratio = (k / ky).astype(np.float32)
        gain = ratio * ratio * ratio / np.sqrt(ky.astype(np.float32))
        gain[~keep] = 0.0
        value = unit_phasor(phase)
        value *= gain
        if aperture is not None:
            value *= aperture(kx, k, ky)
        value *= spectrum[m[start:stop] % n_x]
        out[start:stop] = law.lines(value, kx, ky)

    _in_threads(work, m.size, max(1, _BATCH // k.size))
    return out, first


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
