r"""Common parts of the frequency-domain focusers: raw data to two-dimensional spectrum, and range lines to pixels.

Every one of them makes

.. math:: I(x, \rho) = \frac{\sqrt{2 \pi} e^{j \pi / 4} \rho^{5/2}}{K N P \sum_t w_t} \sum_{k_x} e^{j k_x x}
          \sum_k S(k_x, k) \frac{k^3}{k_y^{7/2}} e^{j \rho k_y},
          \quad k = 4 \pi (f_c + f) / c, \quad k_y = \sqrt{k^2 - k_x^2},

from the data's spectrum S over track and fast time, and they differ in how they evaluate, or approximate, the sum over
k. It is the sum of :func:`sarmitsuba.signal.focusing.focusers.backprojection.backproject` (its weights :math:`R^2
e^{jkR}` transformed over the track by stationary phase), so that all give the same complex pixels.
"""

import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64, I64, LinearMap
from sarmitsuba.core.errors import DataError, SarmitsubaWarning
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import FocusTask
from sarmitsuba.signal.focusing.frequency_domain.aperture_filter import ApertureFilter, aperture_filter
from sarmitsuba.signal.focusing.frequency_domain.chirp_z import ChirpZ
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import (
    TrackGeometry,
    filter_overhang,
    own_apertures,
    range_walk,
    rate_factor,
    slant_grid,
    track_geometry,
    track_period,
    track_refusal,
    wavenumber,
)
from sarmitsuba.signal.focusing.frequency_domain.weights import normalisation, pulse_weights
from sarmitsuba.signal.focusing.grid import RangeInterpolation, slant_ranges
from sarmitsuba.signal.focusing.profiles import plan_spectrum
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.gridding import phase_ramp, unit_phasor
from sarmitsuba.signal.image import ImageGrid

# Doppler band of the image over the PRF above which a warning about azimuth aliasing is given
_FOLDED = 1.05
# samples of the spectrum mapped at once by a thread: bounds the temporary memory and fits the caches
_BATCH = 1 << 18
# bins beyond the band's edges that a longer transform keeps: profiles that end with the receive window leak there
_EDGE = 16
# pulses of zeros on either side of the aperture and of the matched filter while the pulse rate is raised
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

    @abstractmethod
    def adjoint_lines(self, pixels: C64, kx: F64, ky: F64) -> C64:
        """Adjoint of :meth:`lines`: rows of the spectrum (rows, count) from pixels (rows, n_range)."""


def _no_room(sines: F64, extent: float) -> float:
    """Range margin, zero, of an algorithm that does not shift echoes."""
    return 0.0


def _run_in_threads(work: Callable[[int, int], None], count: int, block: int) -> None:
    """Call ``work(start, stop)`` for all of ``count`` in blocks, on all cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # reading the results raises exceptions of the threads
        list(pool.map(lambda start: work(start, min(start + block, count)), range(0, count, block)))


@dataclass(frozen=True, eq=False)
class _RowsMap(LinearMap):
    """Map from the spectrum (k_x, k) to range lines (k_x, rho).

    Parameters
    ----------
    geometry : of the track whose spectrum it is
    band, law : see there
    n_x : rows of the spectrum over the track
    m : whole numbers of the rows used, k_x = 2 pi m / period
    side : (count,) float64, rad/m, largest distance of k_x from that of the squint
    aperture : spectrum of the pulse weights; None where it is 1
    """

    geometry: TrackGeometry
    band: WavenumberBand
    law: RangeLaw
    n_x: int
    m: I64
    side: F64
    aperture: ApertureFilter | None

    @staticmethod
    def of(
        radar: Radar,
        grid: ImageGrid,
        geometry: TrackGeometry,
        band: WavenumberBand,
        law: RangeLaw,
        n_x: int,
        window: Window,
    ) -> "_RowsMap":
        """Map of a slant grid."""
        k = band.center_wavenumber + band.offset
        dkx = 2.0 * np.pi / (n_x * geometry.spacing)
        center = k * geometry.sin_squint
        side = np.array([geometry.reach(each) * each for each in k])
        bounds = np.outer(geometry.faded, k)  # every wavenumber's own
        low, high = np.maximum(center - side, bounds[0]), np.minimum(center + side, bounds[1])
        first, last = int(np.ceil(low.min() / dkx)), int(np.floor(high.max() / dkx))
        reach = np.array([first, last + 1]) * (dkx / k.min())
        aperture = aperture_filter(radar, grid, geometry, window, reach)
        return _RowsMap(geometry, band, law, n_x, np.arange(first, last + 1), side, aperture)

    def _reference(self, rows: slice) -> tuple[C64, F64, F64]:
        """Reference function (n, count) of some rows, with their k_x (n, 1) and k_y (n, count)."""
        band, geometry = self.band, self.geometry
        offset = band.offset
        k = band.center_wavenumber + offset
        dkx = 2.0 * np.pi / (self.n_x * geometry.spacing)
        center = k * geometry.sin_squint
        kx: F64 = np.asarray(self.m[rows, None] * dkx, dtype=np.float64)
        square = k**2 - kx**2
        sine = kx / k
        keep = (np.abs(kx - center) <= self.side) & (sine >= geometry.faded[0]) & (sine <= geometry.faded[1])
        ky: F64 = np.sqrt(np.where(keep, square, 1.0))
        phase = self.law.bulk(kx, ky, offset)
        phase -= offset * geometry.range_center
        phase -= kx * (geometry.x[0] - geometry.x_center)
        ratio = (k / ky).astype(np.float32)
        gain = ratio * ratio * ratio / np.sqrt(ky.astype(np.float32))
        gain[~keep] = 0.0
        value = unit_phasor(phase)
        value *= gain
        if self.aperture is not None:
            value *= self.aperture(kx, k, ky)
        fade = None if np.isfinite(geometry.half_band) else geometry.fade(sine)
        if fade is not None:
            value *= fade.astype(np.float32)
        return value, kx, ky

    def forward(self, values: C64) -> C64:
        """Lines (n_kx, n_range) of a spectrum (n_x, count)."""
        out = np.zeros((self.m.size, self.band.rho.size), dtype=np.complex64)

        def work(start: int, stop: int) -> None:
            line, kx, ky = self._reference(slice(start, stop))
            line *= values[self.m[start:stop] % self.n_x]
            out[start:stop] = self.law.lines(line, kx, ky)

        _run_in_threads(work, self.m.size, max(1, _BATCH // self.band.count))
        return out

    def adjoint(self, values: C64) -> C64:
        """Spectrum (n_x, count) from lines (n_kx, n_range)."""
        lines = np.empty((self.m.size, self.band.count), dtype=np.complex64)

        def work(start: int, stop: int) -> None:
            reference, kx, ky = self._reference(slice(start, stop))
            lines[start:stop] = self.law.adjoint_lines(values[start:stop], kx, ky) * reference.conj()

        _run_in_threads(work, self.m.size, max(1, _BATCH // self.band.count))
        out = np.zeros((self.n_x, self.band.count), dtype=np.complex64)
        for start in range(0, self.m.size, self.n_x):
            some = slice(start, start + self.n_x)
            out[self.m[some] % self.n_x] += lines[some]
        return out


class RowsImaging(LinearMap):
    """Linear map from range-compressed data of a straight track to pixels, by one algorithm's law.

    Parameters
    ----------
    name : of the algorithm, for messages
    task : of focusing; a ground grid is interpolated from the slant grid of its ranges
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
    the weight is the pattern at the image's central range, over the pixels' apertures where the radar states
    them. Where the aperture's and the image's Doppler band together pass the PRF the pulse rate is raised by deramping;
    a still wider image is aliased, with a warning.
    """

    def __init__(
        self,
        name: str,
        task: FocusTask,
        law: Callable[[WavenumberBand], RangeLaw],
        room: Callable[[F64, float], float] = _no_room,
    ) -> None:
        raw, radar = task.raw, task.raw.radar
        if raw.domain != "compressed":
            raise DataError(f"{name}: the data are not range compressed; call range_compress first")
        refusal = track_refusal(radar, task.grid)
        if refusal:
            raise DataError(f"{name}: {refusal}")
        self.radar, self.window, self.progress = radar, task.azimuth_window, task.progress
        self.grid = grid = slant_grid(radar, task.grid)
        self.geometry = geometry = track_geometry(radar, grid)
        own, n_pulses = own_apertures(radar), radar.track.n_pulses
        self.weights = np.ones(n_pulses) if own else self.window.aperture(n_pulses)

        self.upsampling, band_fill = rate_factor(radar, grid, geometry)
        if band_fill > _FOLDED:
            warnings.warn(
                f"{name}: the image needs a Doppler bandwidth of {band_fill:.2f} times the PRF, and so folds over; "
                "shrink it in azimuth, raise prf or use focuser backprojection",
                SarmitsubaWarning,
                stacklevel=4,
            )
        kc = wavenumber(radar)
        finer = replace(geometry, spacing=geometry.spacing / self.upsampling)
        sines = finer.sines(kc)
        extra = range_walk(radar, grid, geometry) + int(
            np.ceil(room(sines, radar.window.extent) / radar.window.sample_spacing)
        )
        self.plan = plan_spectrum(radar, task.range_window)
        n_fft = max(self.plan.n_fft, plan_spectrum(radar, task.range_window, extra=extra).n_fft)
        used = scipy.fft.fftfreq(self.plan.n_fft)[self.plan.gains > 0.0]
        low = max(int(used.min() * n_fft) - _EDGE, -(n_fft // 2))
        high = min(int(used.max() * n_fft) + _EDGE, (n_fft - 1) // 2)
        self.n_fft = n_fft
        self.band = WavenumberBand(
            center_wavenumber=kc,
            first=low,
            count=high - low + 1,
            step=2.0 * np.pi / (n_fft * radar.window.sample_spacing),
            sines=sines,
            rho=grid.range,
            geometry=geometry,
        )
        self.guard = _GUARD + int(filter_overhang(radar, grid, finer) / geometry.spacing)
        dense = _denser(geometry, self.upsampling, self.guard) if self.upsampling > 1 else geometry
        n_x = int(scipy.fft.next_fast_len(int(np.ceil(track_period(radar, grid, dense) / dense.spacing))))
        self.rows = _RowsMap.of(radar, grid, dense, self.band, law(self.band), n_x, self.window)
        factor = normalisation(radar, grid, geometry, self.window) * (grid.range**2.5 / n_fft)
        turn = np.sqrt(2.0 * np.pi) * np.exp(0.25j * np.pi)
        self.scale = (factor * (1.0 / (n_x * dense.spacing))).astype(np.float32) * np.complex64(turn)
        self.ground: RangeInterpolation | None = None
        if task.grid.kind == "ground":
            self.ground = RangeInterpolation(grid, slant_ranges(radar, task.grid), kc * geometry.cosine)

    def pulse_weights(self, point: F64) -> F64:
        """Weight of every pulse in the pixel at points (..., 3), (..., n_pulses) float64."""
        return pulse_weights(self.radar, self.grid, point, self.window)

    def forward(self, values: C64) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) of data (n_layers, n_pulses, n_samples)."""
        image = np.empty((len(values), *self.grid.shape), dtype=np.complex64)
        for layer, data in enumerate(values):
            spectrum = self._range_spectrum(data)
            if self.upsampling > 1:
                spectrum = self._densify(spectrum)
            spectrum = scipy.fft.fft(spectrum, n=self.rows.n_x, axis=0, workers=-1, overwrite_x=True)
            columns = self.rows.forward(spectrum)
            del spectrum
            self._to_azimuth(columns, image[layer])
            image[layer] *= self.scale
            self.progress("focus", layer + 1.0, float(len(values)), {})
        return image if self.ground is None else self.ground.forward(image)

    def adjoint(self, values: C64) -> C64:
        """Data (n_layers, n_pulses, n_samples) from pixels (n_layers, n_azimuth, n_range)."""
        image = values if self.ground is None else self.ground.adjoint(values)
        data = np.empty((len(image), self.weights.size, self.plan.n_samples), dtype=np.complex64)
        rows = self.rows.geometry.x.size
        for layer, pixels in enumerate(image):
            spectrum = self.rows.adjoint(self._from_azimuth(pixels * self.scale.conj()))
            spectrum = scipy.fft.ifft(spectrum, axis=0, workers=-1, overwrite_x=True, norm="forward")
            held = np.zeros((rows, self.band.count), dtype=np.complex64)
            held[: self.rows.n_x] = spectrum[:rows]
            del spectrum
            self._adjoint_spectrum(self._adjoint_densify(held) if self.upsampling > 1 else held, data[layer])
            self.progress("adjoint", layer + 1.0, float(len(image)), {})
        return data

    @property
    def _walk(self) -> F64:
        """Ranges (n_pulses,) of the first samples from the range to the image's centre, m."""
        return np.asarray(self.radar.window.start_range - self.geometry.range_center)

    def _range_spectrum(self, data: C64) -> C64:
        """Weighted spectra (n_pulses, count) over fast time, its origin at the range to the image's centre for all."""
        plan, band, shift = self.plan, self.band, self._walk
        out = np.empty((data.shape[0], band.count), dtype=np.complex64)
        index = (band.first + np.arange(band.count)) % self.n_fft

        def work(start: int, stop: int) -> None:
            part = slice(start, stop)
            line = plan.spectrum(data[part], workers=1)
            if self.n_fft > plan.n_fft:
                # longer transforms weight the band's edges differently: first the profiles common to all focusers
                line = scipy.fft.ifft(line, axis=1, overwrite_x=True)[:, : data.shape[1]]
                line = scipy.fft.fft(line, n=self.n_fft, axis=1, overwrite_x=True)
            line = line[:, index]
            line *= phase_ramp(-shift[part] * band.step, band.first, band.count)
            line *= self.weights[part, None].astype(np.float32)
            out[part] = line

        _run_in_threads(work, data.shape[0], max(1, _BATCH // self.n_fft))
        return out

    def _adjoint_spectrum(self, spectrum: C64, out: C64) -> None:
        """Adjoint of :meth:`_range_spectrum`, written into ``out``."""
        plan, band, shift = self.plan, self.band, self._walk
        index = (band.first + np.arange(band.count)) % self.n_fft

        def work(start: int, stop: int) -> None:
            part = slice(start, stop)
            value = spectrum[part] * self.weights[part, None].astype(np.float32)
            value *= phase_ramp(shift[part] * band.step, band.first, band.count)
            line = np.zeros((stop - start, self.n_fft), dtype=np.complex64)
            line[:, index] = value
            if self.n_fft > plan.n_fft:
                line = scipy.fft.ifft(line, axis=1, overwrite_x=True, norm="forward")[:, : plan.n_samples]
                line = scipy.fft.fft(line, n=plan.n_fft, axis=1, overwrite_x=True, norm="forward")
            out[part] = plan.adjoint_spectrum(line)

        _run_in_threads(work, spectrum.shape[0], max(1, _BATCH // self.n_fft))

    def _ramp(self, part: slice) -> C64:
        """Phase of the image's centre (n, columns) on the denser track, at columns of the spectrum."""
        geometry = self.geometry
        x = self.rows.geometry.x
        distance = np.hypot(x - geometry.x_center, geometry.rho_center) - geometry.range_center
        k = self.band.center_wavenumber + self.band.offset
        return unit_phasor(np.outer(distance, k[part]))

    def _densify(self, spectrum: C64) -> C64:
        """Raise the pulse rate by a whole factor: deramp to the centre, zero-pad the Doppler spectrum, reramp."""
        factor, rows = self.upsampling, self.rows.geometry.x.size
        n, held = rows // factor, slice(self.guard, self.guard + spectrum.shape[0])
        out = np.empty((rows, spectrum.shape[1]), dtype=np.complex64)

        def work(start: int, stop: int) -> None:
            ramp = self._ramp(slice(start, stop))
            line = np.zeros((n, ramp.shape[1]), dtype=np.complex64)
            line[held] = spectrum[:, start:stop]
            line = scipy.fft.fft(line * ramp[::factor], axis=0)
            wide = np.zeros_like(ramp)
            wide[: n - n // 2] = line[: n - n // 2]
            wide[rows - n // 2 :] = line[n - n // 2 :]
            out[:, start:stop] = scipy.fft.ifft(wide, axis=0) * ramp.conj()

        _run_in_threads(work, spectrum.shape[1], max(1, _BATCH // rows))
        return out

    def _adjoint_densify(self, spectrum: C64) -> C64:
        """Adjoint of :meth:`_densify`."""
        factor, rows = self.upsampling, spectrum.shape[0]
        n, held = rows // factor, slice(self.guard, self.guard + self.weights.size)
        out = np.empty((self.weights.size, spectrum.shape[1]), dtype=np.complex64)

        def work(start: int, stop: int) -> None:
            ramp = self._ramp(slice(start, stop))
            wide = scipy.fft.fft(spectrum[:, start:stop] * ramp, axis=0, norm="forward")
            line = np.concatenate([wide[: n - n // 2], wide[rows - n // 2 :]])
            line = scipy.fft.ifft(line, axis=0, norm="forward") * ramp[::factor].conj()
            out[:, start:stop] = line[held]

        _run_in_threads(work, spectrum.shape[1], max(1, _BATCH // rows))
        return out

    @property
    def _points(self) -> ChirpZ:
        """Sums over k_x at the azimuth pixels."""
        rows, n_azimuth = self.rows, self.grid.azimuth.size
        turn = 2.0 * np.pi * self.grid.azimuth_spacing / (rows.n_x * rows.geometry.spacing)
        return ChirpZ(rows.m.size, n_azimuth, int(rows.m[0]), -(n_azimuth // 2), turn)

    def _to_azimuth(self, columns: C64, out: C64) -> None:
        r"""Write :math:`\sum_m c_m e^{j 2 \pi m x / P}` at the azimuth pixels (chirp-z transform) into ``out``."""
        _write_columns(self._points, columns, out)

    def _from_azimuth(self, pixels: C64) -> C64:
        """Adjoint of :meth:`_to_azimuth`."""
        columns = np.empty((self.rows.m.size, pixels.shape[1]), dtype=np.complex64)
        _write_columns(self._points.adjoint, pixels, columns)
        return columns


def _write_columns(sums: ChirpZ, columns: C64, out: C64) -> None:
    """Write the sums of every column into ``out``."""

    def work(start: int, stop: int) -> None:
        out[:, start:stop] = sums(np.ascontiguousarray(columns[:, start:stop].T)).T

    _run_in_threads(work, columns.shape[1], max(1, _BATCH // sums.n_fft))


def _denser(geometry: TrackGeometry, factor: int, guard: int) -> TrackGeometry:
    """Track with a pulse rate raised by a whole factor, with pulses of zeros on either side.

    The parts between the last pulses and beyond them must reach as far as the matched filter, and not come round to the
    other end of the track.
    """
    n = scipy.fft.next_fast_len(geometry.x.size + 2 * guard)
    x = geometry.x[0] + geometry.spacing * (np.arange(n * factor) / factor - guard)
    return replace(geometry, x=x, spacing=geometry.spacing / factor)
