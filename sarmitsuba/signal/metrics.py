"""Image quality: impulse response, coherence, error against a reference, equivalent number of looks."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image import SarImage

# samples of a cut per pixel
_FINE = 32


@dataclass(frozen=True)
class CutMetrics:
    """Quality measures of the impulse response along one line through the peak.

    Parameters
    ----------
    irw : m, -3 dB width
    pslr_db : peak sidelobe ratio: highest sidelobe beyond the first nulls over the peak
    islr_null_db : integrated sidelobe ratio: energy beyond the first nulls over that between them
    islr_2irw_db : energy beyond ``|x| = irw``, up to ``extent``, over that within
    islr_20irw_db : as ``islr_2irw_db``, with side lobes up to ``|x| = 10 irw``; NaN where the chip is smaller
    extent : m, slant range of the cut
    """

    irw: float
    pslr_db: float
    islr_null_db: float
    islr_2irw_db: float
    islr_20irw_db: float
    extent: float


@dataclass(frozen=True)
class PointTargetMetrics:
    """Measured point target: position, RCS, phase and cuts of the impulse response.

    Parameters
    ----------
    azimuth_position, range_position : m in the grid's coordinates, of the interpolated peak
    azimuth_index, range_index : the same in pixels
    rcs : m^2, |peak|^2
    phase : rad, of the peak (with the image's range carrier at that position)
    azimuth, range : cuts along the azimuth and range lobes
    """

    azimuth_position: float
    range_position: float
    azimuth_index: float
    range_index: float
    rcs: float
    phase: float
    azimuth: CutMetrics
    range: CutMetrics


class Chip:
    """Square chip of a complex image as a band-limited function, evaluated anywhere by its Fourier series.

    Parameters
    ----------
    data : (n, m) complex
    row, column : index of its first pixel in the image

    Notes
    -----
    The spectrum is centred first (circular centroid of its energy along each axis), which removes the carrier of a
    focused image. The chip is taken as periodic: keep the target far from its edges.
    """

    def __init__(self, data: NDArray[np.number], row: int = 0, column: int = 0) -> None:
        self.data = np.asarray(data, dtype=np.complex128)
        self.row, self.column = row, column
        centers = (self._centroid(self.data), self._centroid(self.data.T))
        turns = [
            np.exp(-2j * np.pi * f * np.arange(n)) for f, n in zip(centers, self.data.shape, strict=True)
        ]
        self.spectrum = np.fft.fft2(self.data * np.outer(*turns)) / self.data.size
        self.frequencies = [np.fft.fftfreq(n) + f for f, n in zip(centers, self.data.shape, strict=True)]

    @staticmethod
    def _centroid(data: C128) -> float:
        """Centre of energy of the spectrum along the first axis, cycles per pixel."""
        return float(np.angle(np.vdot(data[:-1], data[1:])) / (2.0 * np.pi))

    def at(self, rows: ArrayLike, columns: ArrayLike) -> C128:
        """Value at points given in image pixels (same shapes, 1-D)."""
        a, b = self._waves(rows, columns)
        return np.asarray(np.einsum("pi,ij,pj->p", a, self.spectrum, b, optimize=True))

    def on_grid(self, rows: ArrayLike, columns: ArrayLike) -> C128:
        """Values on the outer product of row and column positions, image pixels."""
        a, b = self._waves(rows, columns)
        return np.asarray(a @ self.spectrum @ b.T)

    def _waves(self, rows: ArrayLike, columns: ArrayLike) -> tuple[C128, C128]:
        r = np.asarray(rows, dtype=np.float64) - self.row
        c = np.asarray(columns, dtype=np.float64) - self.column
        return (
            np.exp(2j * np.pi * np.outer(r, self.frequencies[0])),
            np.exp(2j * np.pi * np.outer(c, self.frequencies[1])),
        )

    def peak(self, row: float, column: float) -> tuple[float, float]:
        """Position of the maximum magnitude near a pixel: nested grids of 9 x 9 points down to 1e-4 pixel."""
        step = 0.25
        while step > 5e-5:
            rows, columns = row + step * np.arange(-4, 5), column + step * np.arange(-4, 5)
            magnitude = np.abs(self.on_grid(rows, columns))
            i, j = np.unravel_index(int(magnitude.argmax()), magnitude.shape)
            row, column = float(rows[i]), float(columns[j])
            if 0 < i < 8 and 0 < j < 8:
                step /= 3.0
        return row, column


def point_target(
    data: NDArray[np.number],
    azimuth_spacing: float,
    range_spacing: float,
    *,
    near: tuple[float, float] | None = None,
    chip: int = 64,
    azimuth_direction: tuple[float, float] = (1.0, 0.0),
    range_direction: tuple[float, float] = (0.0, 1.0),
) -> PointTargetMetrics:
    """Measure a point target in a complex image.

    Parameters
    ----------
    data : (n_azimuth, n_range) complex
    azimuth_spacing, range_spacing : pixel spacings, m
    near : (row, column) within 4 pixels of the target; default: the brightest pixel
    chip : edge of the analysed square, pixels
    azimuth_direction, range_direction : (azimuth, range) in metres along the sidelobes; rotated by squint

    Returns
    -------
    PointTargetMetrics; positions are in pixels times spacing from pixel (0, 0)

    Notes
    -----
    Assumes one dominant point in the chip. Widths and positions come from the Fourier series of the chip, sampled 32
    times per pixel, not from a fit.
    """
    data = np.asarray(data)
    if near is None:
        i, j = np.unravel_index(int(np.abs(data).argmax()), data.shape)
    else:
        r, c = round(near[0]), round(near[1])
        low_r, low_c = max(r - 4, 0), max(c - 4, 0)
        part = np.abs(data[low_r : r + 5, low_c : c + 5])
        if part.size == 0:
            raise DataError(
                f"point target: ({near[0]:g}, {near[1]:g}) lies outside the image of {data.shape} pixels"
            )
        i, j = np.unravel_index(int(part.argmax()), part.shape)
        i, j = i + low_r, j + low_c
    row, column = _start(int(i), data.shape[0], chip), _start(int(j), data.shape[1], chip)
    piece = Chip(data[row : row + chip, column : column + chip], row, column)
    if min(piece.data.shape) < 8 or not np.abs(piece.data).max() > 0.0:
        raise DataError(
            "point target: the chip around it is smaller than 8 pixels or empty; choose a point farther inside"
        )
    top, left = piece.peak(float(i), float(j))
    value = complex(piece.at([top], [left])[0])
    spacing = np.array([azimuth_spacing, range_spacing])
    cuts = [
        _cut(piece, (top, left), np.asarray(direction, dtype=np.float64), spacing)
        for direction in (azimuth_direction, range_direction)
    ]
    return PointTargetMetrics(
        azimuth_position=top * azimuth_spacing,
        range_position=left * range_spacing,
        azimuth_index=top,
        range_index=left,
        rcs=abs(value) ** 2,
        phase=float(np.angle(value)),
        azimuth=cuts[0],
        range=cuts[1],
    )


def point_target_in(
    image: SarImage,
    channel: str | None = None,
    *,
    near: tuple[float, float] | None = None,
    chip: int = 64,
    squint_angle: float = 0.0,
) -> PointTargetMetrics:
    """Measure a point target in a SAR image; positions are in the grid's azimuth and range coordinates.

    Parameters
    ----------
    image : focused image
    channel : default the first
    near : (azimuth, range) in the grid's coordinates, m; default: the brightest pixel
    chip : edge of the analysed square, pixels
    squint_angle : rad, positive forward; rotates the cuts onto the lobes of a squinted image on a slant grid
    """
    grid = image.grid
    start = np.array([grid.azimuth[0], grid.range[0]])
    spacing = np.array([grid.azimuth_spacing, grid.range_spacing])
    pixel = None if near is None else tuple((np.asarray(near) - start) / spacing)
    sin, cos = float(np.sin(squint_angle)), float(np.cos(squint_angle))
    m = point_target(
        image.total(channel),
        spacing[0],
        spacing[1],
        near=pixel,
        chip=chip,
        azimuth_direction=(cos, -sin),
        range_direction=(sin, cos),
    )
    return PointTargetMetrics(
        azimuth_position=m.azimuth_position + float(start[0]),
        range_position=m.range_position + float(start[1]),
        azimuth_index=m.azimuth_index,
        range_index=m.range_index,
        rcs=m.rcs,
        phase=m.phase,
        azimuth=m.azimuth,
        range=m.range,
    )


def _start(center: int, size: int, chip: int) -> int:
    return int(np.clip(center - chip // 2, 0, max(size - chip, 0)))


def _cut(piece: Chip, peak: tuple[float, float], direction: F64, spacing: F64) -> CutMetrics:
    """Metrics along a line through the peak, up to the edges of the chip."""
    rate = direction / np.linalg.norm(direction) / spacing  # pixels per metre
    origin = np.array([piece.row, piece.column])
    room = np.minimum(np.array(peak) - origin, origin + np.array(piece.data.shape) - 1 - np.array(peak))
    with np.errstate(divide="ignore"):
        extent = float(np.min(np.where(np.abs(rate) > 1e-12, room / np.abs(rate), np.inf)))
    step = 1.0 / (_FINE * float(np.abs(rate).max()))
    n = int(extent / step)
    if n < 1:
        raise DataError("point target: its peak lies at the edge of the image; choose a point farther inside")
    x = np.asarray(step * np.arange(-n, n + 1), dtype=np.float64)
    power = np.abs(piece.at(peak[0] + rate[0] * x, peak[1] + rate[1] * x)) ** 2
    return cut_metrics(x, power.astype(np.float64))


def cut_metrics(x: F64, power: F64) -> CutMetrics:
    """Measure an impulse response sampled finely on a line, its peak at ``x = 0`` in the middle.

    Parameters
    ----------
    x : (2 n + 1,) float64, m, uniform
    power : (2 n + 1,) float64, |h|^2
    """
    n = x.size // 2
    step = float(x[1] - x[0])
    sides = [power[n:], power[n::-1]]
    widths, nulls = [], []
    for side in sides:
        below = np.flatnonzero(side < 0.5 * side[0])
        if below.size == 0:
            raise DataError("point target: the chip is smaller than the -3 dB width; use a larger chip")
        i = int(below[0])
        widths.append(i - 1 + (side[i - 1] - 0.5 * side[0]) / (side[i - 1] - side[i]))
        rising = np.flatnonzero(np.diff(side[i:]) > 0.0)
        nulls.append(i + int(rising[0]) if rising.size else side.size - 1)
    irw = step * float(sum(widths))
    outside = np.concatenate([side[null:] for side, null in zip(sides, nulls, strict=True)])
    distance = np.abs(x)
    null_mask = np.zeros(x.size, dtype=bool)
    null_mask[n - nulls[1] : n + nulls[0] + 1] = True
    far = 10.0 * irw <= distance[-1]
    return CutMetrics(
        irw=irw,
        pslr_db=_ratio_db(float(outside.max(initial=0.0)), float(power[n])),
        islr_null_db=_ratio_db(float(power[~null_mask].sum()), float(power[null_mask].sum())),
        islr_2irw_db=_ratio_db(float(power[distance > irw].sum()), float(power[distance <= irw].sum())),
        islr_20irw_db=_ratio_db(
            float(power[(distance > irw) & (distance <= 10.0 * irw)].sum()),
            float(power[distance <= irw].sum()),
        )
        if far
        else float("nan"),
        extent=float(distance[-1]),
    )


def _ratio_db(a: float, b: float) -> float:
    return float(10.0 * np.log10(a / b)) if a > 0.0 and b > 0.0 else float("-inf")


def coherence(a: NDArray[np.number], b: NDArray[np.number]) -> float:
    r"""Magnitude of the complex correlation of two images.

    .. math:: \gamma = \frac{|\sum a b^*|}{\sqrt{\sum |a|^2 \sum |b|^2}}
    """
    x, y = _pair(a, b)
    norm = np.linalg.norm(x) * np.linalg.norm(y)
    return float(abs(np.vdot(y, x)) / norm) if norm > 0.0 else 0.0


def image_error_db(a: NDArray[np.number], reference: NDArray[np.number]) -> float:
    r"""Relative error of an image, :math:`20 \log_{10} (\|a - b\| / \|b\|)`, dB; -inf if both are equal."""
    x, y = _pair(a, reference)
    norm = float(np.linalg.norm(y))
    if norm == 0.0:
        raise DataError("image error: the reference image is all zero")
    error = float(np.linalg.norm(x - y)) / norm
    return float(20.0 * np.log10(error)) if error > 0.0 else float("-inf")


def equivalent_number_of_looks(intensity: NDArray[np.number]) -> float:
    r"""Equivalent number of looks of a homogeneous area, :math:`\langle I \rangle^2 / \mathrm{var}(I)`."""
    values = np.asarray(intensity, dtype=np.float64)
    variance = float(values.var())
    return float(values.mean() ** 2 / variance) if variance > 0.0 else float("inf")


def windows_over(shape: tuple[int, int], size: int) -> Iterator[tuple[slice, slice]]:
    """Non-overlapping square pieces of an image, for local statistics."""
    for row in range(0, shape[0] - size + 1, size):
        for column in range(0, shape[1] - size + 1, size):
            yield slice(row, row + size), slice(column, column + size)


def _pair(a: NDArray[np.number], b: NDArray[np.number]) -> tuple[C128, C128]:
    x, y = np.asarray(a, dtype=np.complex128), np.asarray(b, dtype=np.complex128)
    if x.shape != y.shape:
        raise DataError(f"images of the shapes {x.shape} and {y.shape} cannot be compared pixel by pixel")
    return x.ravel(), y.ravel()
