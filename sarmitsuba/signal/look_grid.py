"""Grid of the image-domain method (``image``), onto which the contributions of looks are spread before focusing."""

from dataclasses import dataclass
from types import ModuleType

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64, I64, Samples
from sarmitsuba.signal.gridding import GriddingKernel, gridding_kernel
from sarmitsuba.signal.sub_bands import RangeFilter


@dataclass(frozen=True)
class BeamFan:
    r"""Coordinates of points in the slant plane by the pulse whose beam axis passes over them (steered beams).

    The axes of a steered beam are lines from the track that intersect in its rotation centre (at infinity for a beam
    fixed to the track). A point at the distance a along the line through the fan's centre, and b across it, has

    .. math:: p = \frac{2 a - \kappa (a^2 + b^2)}{1 + \sqrt{(1 - \kappa a)^2 + \kappa^2 b^2}}

    its distance along its line from the circle about the rotation centre through the fan's centre, and c, the azimuth
    of the antenna on that line. The gradient of p is the unit vector along the line, so that
    :math:`\exp(-4 \pi j p / \lambda)` is, to first order about every point, the phase of its echo when the beam axis
    passes over it: the residual phase over the aperture is the same everywhere.

    Parameters
    ----------
    azimuth, closest_range : m, of the fan's centre
    sine : of the angle of its line off the zero-Doppler plane, positive ahead
    curvature : kappa, 1/m; inverse distance from there to the rotation centre, 0 for parallel lines
    speed : m/s, effective, of the antenna along the azimuth
    """

    azimuth: float
    closest_range: float
    sine: float
    curvature: float
    speed: float

    @property
    def cosine(self) -> float:
        """Cosine of the angle of the centre's line off the zero-Doppler plane."""
        return float(np.sqrt(1.0 - self.sine**2))

    @property
    def stretch(self) -> float:
        """Ratio of the distance across the centre's line to the change of c."""
        return self.cosine / (1.0 + self.curvature * self.closest_range / self.cosine)

    def place(
        self,
        slant_range: Samples,
        range_rate: Samples,
        antenna: Samples,
        numbers: tuple[Samples, ...] | None = None,
        xp: ModuleType = np,
    ) -> tuple[Samples, Samples, Samples]:
        """Coordinates p and c of points at rest, and their distance when the beam axis passes over them, m.

        Parameters
        ----------
        slant_range, range_rate : m and m/s, as seen from one look; float64
        antenna : m, azimuth of the antenna in that look
        numbers : as :attr:`numbers`, for kernels that must not be compiled for each value
        xp : NumPy, or Dr.Jit
        """
        azimuth, closest, sine, cosine, curvature, per_rate = numbers or self.numbers
        u = range_rate * per_rate
        r = slant_range * xp.sqrt(xp.maximum(1.0 - u * u, 1e-6))
        x = antenna + slant_range * u
        across, along = r - closest, x - azimuth
        a, b = across * cosine + along * sine, along * cosine - across * sine
        ahead, aside = 1.0 - a * curvature, b * curvature
        size = xp.sqrt(ahead * ahead + aside * aside)
        p = (a * 2.0 - (a * a + b * b) * curvature) / (size + 1.0)
        distance = r / (ahead * cosine + aside * sine)
        return p, x - distance * (ahead * sine - aside * cosine), distance * size

    @property
    def numbers(self) -> tuple[float, ...]:
        """Parameters of :meth:`place`: azimuth, closest range, sine, cosine, curvature and -1 / speed."""
        return (
            self.azimuth,
            self.closest_range,
            self.sine,
            self.cosine,
            self.curvature,
            -1.0 / self.speed,
        )


@dataclass(frozen=True, eq=False)
class LookGrid:
    """Grid of the looks over a range and an azimuth coordinate.

    If all pixels are lit by the same pulses (``fan`` None) there is one look, and a path is added at its slant range
    and range rate. If a beam passes over the pixels in turn there is one look per aperture along the track, and a
    path is added at its coordinates in the beam's ``fan``; it is divided linearly between the two looks whose antenna
    was nearest when the beam passed.

    Parameters
    ----------
    position, velocity : (n_looks, 3) float64, m and m/s, scene frame; of the antenna
    fan : coordinates of places that the beam passes over in turn
    antenna : (n_looks,) float64, m, azimuth of the antenna in the fan's coordinates, at equal distances
    reference_range : m; range coordinate of the origin, subtracted before the phase is formed
    range0, range_step, n_range : range coordinate of cell 0 less ``reference_range`` (m), cell (m), number of cells
    azimuth0, azimuth_step, n_azimuth : the same along range rate (m/s) or the fan's c (m)
    width : of the gridding kernel, both axes
    """

    position: F64
    velocity: F64
    fan: BeamFan | None
    antenna: F64
    reference_range: float
    range0: float
    range_step: float
    n_range: int
    azimuth0: float
    azimuth_step: float
    n_azimuth: int
    width: int

    @property
    def kernel(self) -> GriddingKernel:
        """Gridding kernel of both axes."""
        return gridding_kernel(self.width)

    @property
    def n_looks(self) -> int:
        """Number of looks."""
        return int(self.position.shape[0])

    @property
    def spacing(self) -> float:
        """Distance between the antenna positions of neighbouring looks, m; 1 for one look."""
        return float(self.antenna[1] - self.antenna[0]) if self.n_looks > 1 else 1.0

    def state(self, point: F64, look: int | I64 = 0) -> tuple[F64, F64]:
        """Slant range (m) and range rate (m/s) of points (..., 3) at rest, from looks (...)."""
        leg = point - self.position[look]
        distance = np.linalg.norm(leg, axis=-1)
        if isinstance(look, int):
            return distance, np.asarray(-(leg @ self.velocity[look]) / distance)
        return distance, np.asarray(-np.einsum("...i,...i->...", leg, self.velocity[look]) / distance)

    def coordinates(self, slant_range: F64, range_rate: F64, look: int | I64 = 0) -> tuple[F64, F64, F64]:
        """Range and azimuth coordinate of paths, and the distance (m) of their amplitudes, any shape."""
        if self.fan is None:
            return slant_range, range_rate, slant_range
        return self.fan.place(slant_range, range_rate, self.antenna[look])

    def share(self, azimuth: F64, look: int) -> F64:
        """Weight of a look for points of the fan coordinate c."""
        if self.n_looks == 1:
            return np.ones_like(azimuth)
        inside = np.clip(azimuth, self.antenna[0], self.antenna[-1])
        return np.asarray(np.maximum(1.0 - np.abs(inside - self.antenna[look]) / self.spacing, 0.0))

    def cells(self, range_coordinate: F64, azimuth: F64) -> tuple[F64, F64, F64]:
        """Range coordinate relative to the reference (m), and position on the two axes in cells."""
        offset = range_coordinate - self.reference_range
        x = (offset - self.range0) * (1.0 / self.range_step)
        y = (azimuth - self.azimuth0) * (1.0 / self.azimuth_step)
        return offset, x, y

    def filter_cells(self, cells: C64, share: RangeFilter | None, wavelength: float) -> C64:
        """Cells (n_layers, n_range, n_azimuth) with a factor on their spectrum over the band; None: unchanged.

        In a fan's coordinates frequencies are circles about the origin of the wavenumbers, as in the response.

        Parameters
        ----------
        wavelength : m, of the carrier, whose phase the cells have
        """
        if share is None:
            return cells
        cycles = scipy.fft.fftfreq(self.n_range, self.range_step)[:, None]
        axes = [0]
        if self.fan is not None:
            carrier = 2.0 / wavelength
            aside = scipy.fft.fftfreq(self.n_azimuth, self.azimuth_step) / self.fan.stretch
            cycles, axes = np.hypot(carrier + cycles, aside) - carrier, [0, 1]
        factor = share(cycles.reshape(-1)).reshape(cycles.shape).astype(np.float32)
        out = np.empty(cells.shape, dtype=np.complex64)
        for layer, plane in enumerate(cells):
            spectrum = scipy.fft.fftn(np.asarray(plane, dtype=np.complex64), axes=axes, workers=-1)
            spectrum *= factor
            out[layer] = scipy.fft.ifftn(spectrum, axes=axes, workers=-1, overwrite_x=True)
        return out
