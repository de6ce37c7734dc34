"""Polar format focuser of spotlight data: every pulse is a radial line in the image's spectrum."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import C64, C128, F64, I64, LinearMap
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import (
    aperture_weights,
    direction_gain,
    image_places,
    look_directions,
    weights_difference,
)
from sarmitsuba.signal.focusing.focuser import FOCUSERS, Focused, Focuser, FocusTask
from sarmitsuba.signal.focusing.profiles import plan_spectrum
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.gridding import gridding_kernel
from sarmitsuba.signal.image import ImageGrid

# taps of both kernels, polar samples onto the wavenumber grid and image onto the pixels; rms error of each, dB, is
# gridding_kernel(6).error_db
_WIDTH = 6
# largest phase error, rad, from wavefront curvature at the end of the aperture
LARGEST_PHASE = 0.3
# CPU seconds of a sample, and of a pixel
_SECONDS = 1.55e-6
# error of both kernels and the transforms, dB
_FLOOR_DB = -60.0
# pulses at which the curvature is computed
_NODES = 33
# pixels, or gridding cells, processed at once
_BATCH = 1 << 21
# bytes per pixel, per raw-data sample, and per item of such a batch, in all arrays held at the same time
_PIXEL_BYTES, _SAMPLE_BYTES, _BATCH_BYTES = 207, 63, 64_000_000


@dataclass(frozen=True, eq=False)
class _PlaneWaves:
    """Lines of sight to the image's centre, and the plane wave that approximates each wavefront.

    Parameters
    ----------
    center : (3,) float64, m; the image's central pixel
    axes : (2, 3) float64, along and across, horizontal
    distance : (n_pulses,) float64, m, antenna to centre
    slope : (n_pulses, 2) float64, growth of range per metre along the axes
    nodes : pulses at which curvature is worked out
    """

    center: F64
    axes: F64
    distance: F64
    slope: F64
    nodes: I64

    @staticmethod
    def of(radar: Radar, grid: ImageGrid) -> "_PlaneWaves":
        rows, columns = grid.shape
        center = grid.positions_on_line(rows // 2)[columns // 2]
        leg = center - radar.track.position
        distance = np.linalg.norm(leg, axis=1)
        axes = np.array([grid.along, grid.across])
        nodes = np.unique(np.linspace(0, distance.size - 1, _NODES).round().astype(np.int64))
        return _PlaneWaves(center, axes, distance, leg @ axes.T / distance[:, None], nodes)

    def differences(self, radar: Radar, points: F64) -> F64:
        """Ranges of points (n, 3) minus that of the centre at the nodes, (n, n_nodes), m."""
        leg = np.linalg.norm(points[:, None] - radar.track.position[self.nodes], axis=-1)
        return np.asarray(leg - self.distance[self.nodes])

    def places(self, differences: F64) -> F64:
        """Positions (n, 2) m of points in the plane-wave image, by least squares over the aperture."""
        return np.asarray(differences @ np.linalg.pinv(self.slope[self.nodes]).T)

    def residual(self, radar: Radar, points: F64) -> F64:
        """Range error of the plane waves at the nodes, (n, n_nodes), m."""
        differences = self.differences(radar, points)
        return np.asarray(differences - self.places(differences) @ self.slope[self.nodes].T)


def refusal(radar: Radar, grid: ImageGrid) -> str:
    """Reason why polar format cannot focus a radar's data on a grid; empty when it can."""
    if radar.track.n_pulses < 8:
        return f"{radar.track.n_pulses} pulses are too few, at least 8 are needed"
    if np.isfinite(radar.half_aperture):
        return "every pixel has its own aperture (stripmap), and polar format needs a common one"
    polar = _PlaneWaves.of(radar, grid)
    if np.linalg.matrix_rank(polar.slope, tol=1e-6) < 2:
        return "the line of sight does not rotate over the aperture"
    points = image_places(grid)
    left = 4.0 * np.pi / radar.waveform.wavelength * polar.residual(radar, points)
    # the mean phase is removed; the variation reduces the level, at a third of the bound rms by 0.04 dB
    phase = float(max(np.abs(left).max(), 3.0 * np.std(left, axis=1).max()))
    if phase > LARGEST_PHASE:
        radius = float(np.linalg.norm(points - polar.center, axis=1).max())
        return (
            f"the wavefront's curvature causes a phase error of {phase:.3g} rad at {radius:.4g} m from the image's "
            "centre (bound "
            f"{LARGEST_PHASE:g} rad, about {radius * np.sqrt(LARGEST_PHASE / phase):.3g} m)"
        )
    return ""


def stated_error_db(radar: Radar, grid: ImageGrid) -> float:
    """Bound of the error against backprojection, dB, at the worst place of the image; NaN where it leaves the beam.

    Sum of the powers of the curvature's phase error, of the change of R^2 over the aperture against that of the centre,
    of the pulse weights' difference to backprojection's, and of a floor.
    """
    polar, points = _PlaneWaves.of(radar, grid), image_places(grid)
    phase = 4.0 * np.pi / radar.waveform.wavelength * polar.residual(radar, points)
    spread = np.std(2.0 * polar.differences(radar, points) / polar.distance[polar.nodes], axis=1)
    power = float((np.mean(phase**2, axis=1) + spread**2).max())
    power += weights_difference(radar, points, pulse_weights(radar, points, "rectangular"))
    return db_from_power(power + power_from_db(_FLOOR_DB)) if np.isfinite(power) else float("nan")


class _PolarImaging(LinearMap):
    r"""Linear map of polar format, from range-compressed data with one aperture for all pixels to the pixels.

    With :math:`k = 4 \pi (f_c + f) / c`, S the spectrum of pulse t about the image's centre at the distance
    :math:`R_t`, and :math:`\mathbf u_t` the growth of range per metre along and across the image plane, every sample
    lies at the wavenumber :math:`k \mathbf u_t`, on a polar raster:

    .. math:: I(p) = \frac{1}{K N \sum_t w_t g_t} \sum_{t, k} w_t R_t^2 S_t(k) e^{j k R_t} e^{j k \mathbf u_t \cdot
              \mathbf q(p)}

    It is resampled onto a Cartesian raster (type-1 non-uniform FFT, gridding kernel of width 6), transformed, and the
    image resampled to the positions :math:`\mathbf q(p)` of the pixels in the plane-wave image: the least squares over
    the aperture of :math:`|p - A_t| - R_t = \mathbf u_t \cdot \mathbf q`. That undoes the distortion by curved
    wavefronts and leaves their defocusing,

    .. math:: \phi \approx \frac{\pi \lambda r^2}{8 \rho_a^2 R}

    at the distance r from the centre for an azimuth cell :math:`\rho_a`; the focuser refuses images at whose edges the
    exact value passes ``LARGEST_PHASE``. The phase is that of backprojection: of the phase that is left, the mean over
    the aperture is taken out of every pixel.

    Notes
    -----
    Source: W. G. Carrara, R. S. Goodman, R. M. Majewski, Spotlight Synthetic Aperture Radar (1995), chapters 3 and 4;
    their limit :math:`r < \rho_a \sqrt{2 R / \lambda}` is :math:`\phi < \pi / 4`. The defocusing by curvature that is
    left is ignored, and so is the change over the aperture of a pixel's :math:`R^2` against the centre's. The antenna
    pattern is compensated at each pixel, not used as a weight. Pixels that the receive window does not hold at
    mid-aperture are zero.
    """

    def __init__(self, task: FocusTask) -> None:
        raw, grid, radar = task.raw, task.grid, task.raw.radar
        if raw.domain != "compressed":
            raise DataError("polar format: the data are not range compressed; call range_compress first")
        polar = _PlaneWaves.of(radar, grid)
        lag = radar.window.start_range - polar.distance
        self.plan = plan_spectrum(
            radar, task.range_window, extra=int(np.ceil(np.ptp(lag) / radar.window.sample_spacing))
        )
        self.used = np.flatnonzero(self.plan.gains > 0.0)
        offset = 2.0 * np.pi * scipy.fft.fftfreq(self.plan.n_fft, radar.window.sample_spacing)[self.used]
        kc = 4.0 * np.pi / radar.waveform.wavelength
        weight = task.azimuth_window.aperture(radar.track.n_pulses) * polar.distance**2 / self.plan.n_fft
        turn = weight * np.exp(1j * np.mod(kc * polar.distance, 2.0 * np.pi))
        self.turn = turn[:, None] * np.exp(-1j * np.outer(lag, offset))
        self.scale, places = _scale_and_places(radar, grid, polar, task.azimuth_window)
        self.raster = _WavenumberRaster.of((kc + offset) * polar.slope[:, :, None], places)
        self.progress = task.progress

    def forward(self, values: C64) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) complex64, m (square root of RCS)."""
        image = np.empty((len(values), *self.scale.shape), dtype=np.complex64)
        for layer, data in enumerate(values):
            spectrum = self.plan.spectrum(data)[:, self.used] * self.turn
            image[layer] = self.raster.forward(spectrum.ravel()).reshape(self.scale.shape) * self.scale
            self.progress("focus", layer + 1.0, float(len(values)), {})
        return image

    def adjoint(self, values: C64) -> C64:
        """Data (n_layers, n_pulses, n_samples) complex64."""
        data = np.empty((len(values), len(self.turn), self.plan.n_samples), dtype=np.complex64)
        for layer, pixels in enumerate(values):
            samples = self.raster.adjoint((pixels * self.scale.conj()).ravel())
            spectrum = np.zeros((len(self.turn), self.plan.n_fft), dtype=np.complex64)
            spectrum[:, self.used] = samples.reshape(self.turn.shape) * self.turn.conj()
            data[layer] = self.plan.adjoint_spectrum(spectrum)
            self.progress("adjoint", layer + 1.0, float(len(values)), {})
        return data


def _scale_and_places(radar: Radar, grid: ImageGrid, polar: _PlaneWaves, window: Window) -> tuple[C128, F64]:
    """Calibration of every pixel (n_azimuth, n_range), and its position in the plane-wave image (n_pixels, 2), m."""
    rows, columns = (np.unique(np.linspace(0, n - 1, 17).round().astype(int)) for n in grid.shape)
    total = np.array(
        [pulse_weights(radar, grid.positions_on_line(int(row))[columns], window).sum(axis=-1) for row in rows]
    )
    if rows.size > 1 and columns.size > 1:
        # cubic: at the edge of a beam the sum falls steeply
        spline = scipy.interpolate.RectBivariateSpline(
            rows, columns, total, kx=min(3, rows.size - 1), ky=min(3, columns.size - 1)
        )
        total = spline(np.arange(grid.shape[0]), np.arange(grid.shape[1]))
    else:
        total = np.broadcast_to(total.mean(), grid.shape)
    middle = radar.track.center_index
    start = float(radar.window.start_range[middle])
    scale = np.empty(grid.shape, dtype=np.complex128)
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    weight = pulse_weights(radar, polar.center[None], window)[0, polar.nodes]
    weight = weight / weight.sum()
    places = np.empty((*grid.shape, 2))
    for row in range(grid.shape[0]):
        points = grid.positions_on_line(row)
        differences = polar.differences(radar, points)
        places[row] = polar.places(differences)
        left = (differences - places[row] @ polar.slope[polar.nodes].T) @ weight
        spread = (1.0 + differences / polar.distance[polar.nodes]) ** -2 @ weight
        leg = np.linalg.norm(points - radar.track.position[middle], axis=1)
        held = (leg >= start) & (leg <= start + radar.window.extent)
        scale[row] = held / spread * np.exp(1j * wavenumber * left)
    lit = total > 1e-6 * total.max()
    scale *= np.divide(1.0, total, out=np.zeros(grid.shape), where=lit) / radar.amplitude_constant
    return scale, places.reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class _WavenumberRaster(LinearMap):
    """Cartesian raster between samples anywhere in the wavenumber plane and pixels anywhere in the image plane.

    Parameters
    ----------
    shape : cells along and across
    cells : (2, n_samples) float64, of every sample, from the raster's middle
    pixels : (2, n_pixels) float64, of every pixel, in cells of the image
    shift : (n_samples,) complex64, to the image's middle; the kernel that reads pixels is divided out
    deapodise : of the image's rows and of its columns: the kernel that spreads samples is divided out
    carrier : (n_pixels,) complex64
    """

    shape: tuple[int, int]
    cells: F64
    pixels: F64
    shift: C64
    deapodise: tuple[F64, F64]
    carrier: C64

    @staticmethod
    def of(wavenumber: F64, places: F64) -> "_WavenumberRaster":
        """Raster for wavenumbers (n_pulses, 2, n_frequencies), rad/m, and places (n_pixels, 2), m."""
        kernel = gridding_kernel(_WIDTH)
        k = np.moveaxis(wavenumber, 1, 0).reshape(2, -1)
        low, high = k.min(axis=1), k.max(axis=1)
        middle = 0.5 * (low + high)
        offset = 0.5 * (places.min(axis=0) + places.max(axis=0))
        step = np.pi / np.maximum(high - low, 1e-12)  # the image's band is half of what its cells hold
        half = np.ptp(places, axis=0) / 2.0
        # and its extent half of the raster's
        shape = tuple(
            2 * scipy.fft.next_fast_len(int(np.ceil(2.0 * h / s)) + 2 * _WIDTH)
            for h, s in zip(half, step, strict=True)
        )
        size = np.array(shape)
        spacing = 2.0 * np.pi / (size * step)
        away = (places - offset) / step
        phase = places @ middle
        # the kernel's transform at the sample's wavenumber is divided out
        cells = (k - middle[:, None]) / spacing[:, None]
        read = kernel.inverse_transform(cells[0] / shape[0]) * kernel.inverse_transform(cells[1] / shape[1])
        shift = read * np.exp(1j * np.mod(offset @ (k - middle[:, None]), 2.0 * np.pi))
        nodes = [scipy.fft.fftfreq(n) for n in shape]
        gains = [
            np.where(np.abs(nu) <= 0.3, n * kernel.inverse_transform(nu), 0.0)
            for n, nu in zip(shape, nodes, strict=True)
        ]
        return _WavenumberRaster(
            shape=(shape[0], shape[1]),
            cells=cells,
            pixels=away.T,
            shift=shift.astype(np.complex64),
            deapodise=(gains[0], gains[1]),
            carrier=np.exp(1j * np.mod(phase, 2.0 * np.pi)).astype(np.complex64),
        )

    def forward(self, values: NDArray[np.complexfloating]) -> C64:
        """Sum of samples (n_samples,) times :math:`e^{j k q}` at every pixel, (n_pixels,) complex64."""
        plane = self._spread(values * self.shift, self.cells)
        field = scipy.fft.ifft2(plane.astype(np.complex64), workers=-1, overwrite_x=True)
        field *= (self.deapodise[0][:, None] * self.deapodise[1]).astype(np.float32)
        return self._read(np.ascontiguousarray(field), self.pixels) * self.carrier

    def adjoint(self, values: NDArray[np.complexfloating]) -> C64:
        """Samples (n_samples,) complex64 from pixels (n_pixels,)."""
        field = self._spread(values * self.carrier.conj(), self.pixels).astype(np.complex64)
        field *= (self.deapodise[0][:, None] * self.deapodise[1]).astype(np.float32)
        plane = scipy.fft.fft2(field, workers=-1, overwrite_x=True, norm="forward")
        return self._read(np.ascontiguousarray(plane), self.cells) * self.shift.conj()

    def _taps(self, cells: F64) -> tuple[list[I64], list[list[F64]]]:
        kernel = gridding_kernel(_WIDTH)
        base = np.floor(cells)
        first = [(b.astype(np.int64) - kernel.lead) for b in base]
        return first, [kernel.taps(cell - b) for cell, b in zip(cells, base, strict=True)]

    def _spread(self, samples: NDArray[np.complexfloating], cells: F64) -> C128:
        plane = np.zeros(self.shape[0] * self.shape[1], dtype=np.complex128)
        step = _BATCH // _WIDTH**2
        for start in range(0, samples.size, step):
            part = slice(start, start + step)
            first, taps = self._taps(cells[:, part])
            line, column = (
                (cell + np.arange(_WIDTH)[:, None]) % n for cell, n in zip(first, self.shape, strict=True)
            )
            index = (line[:, None] * self.shape[1] + column).ravel()
            weight = np.array(taps[0])[:, None] * np.array(taps[1])
            plane.real += np.bincount(index, (weight * samples[part].real).ravel(), minlength=plane.size)
            plane.imag += np.bincount(index, (weight * samples[part].imag).ravel(), minlength=plane.size)
        return plane.reshape(self.shape)

    def _read(self, field: C64, cells: F64) -> C64:
        out = np.empty(cells.shape[1], dtype=np.complex64)
        for start in range(0, out.size, _BATCH):
            part = slice(start, start + _BATCH)
            first, taps = self._taps(cells[:, part])
            total = np.zeros(taps[0][0].size, dtype=np.complex64)
            for i, row in enumerate(taps[0]):
                line = (first[0] + i) % self.shape[0] * self.shape[1]
                for j, column in enumerate(taps[1]):
                    total += field.ravel()[line + (first[1] + j) % self.shape[1]] * (row * column).astype(
                        np.float32
                    )
            out[part] = total
        return out


def pulse_weights(radar: Radar, point: ArrayLike, azimuth_window: str | Window) -> F64:
    """Weight w g of every pulse in polar format's pixel at points (..., 3), giving (..., n_pulses) float64."""
    gain = direction_gain(radar, slice(None), look_directions(radar, point))
    return np.asarray(aperture_weights(radar, point, azimuth_window) * gain)


@dataclass(frozen=True)
class PolarFormat(Focuser):
    """Polar format, see :class:`_PolarImaging`: spotlight, any track, images small enough for plane waves."""

    name: ClassVar[str] = "polar_format"
    title: ClassVar[str] = "spotlight of small scenes, any track; plane waves about the image's centre"

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        return refusal(radar, grid)

    def making_bytes(self, radar: Radar, grid: ImageGrid, n_layers: int) -> int:
        """Peak memory in bytes while the pixels are made, pixels included."""
        pixels, samples = int(np.prod(grid.shape)), radar.track.n_pulses * radar.window.n_samples
        return pixels * (_PIXEL_BYTES + 8 * n_layers) + _SAMPLE_BYTES * samples + _BATCH_BYTES

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """See :func:`stated_error_db`."""
        return stated_error_db(radar, grid)

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Spreading of every sample and reading of every pixel, as measured by benchmarks/suite/focusers.py."""
        return _SECONDS * (radar.track.n_pulses * radar.window.n_samples + float(np.prod(grid.shape)))

    def imaging(self, task: FocusTask) -> LinearMap:
        """Linear map from data to pixels."""
        return _PolarImaging(task)

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        radar, pixels = task.raw.radar, self.imaging(task).forward(task.raw.data)
        return Focused(pixels, lambda point: pulse_weights(radar, point, task.azimuth_window))


FOCUSERS.register(PolarFormat())
