"""Carrier of a focused image: its phase ramp over the pixels, from the geometry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.collection import Flight
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.metrics import Chip


@dataclass(frozen=True)
class Lobes:
    """Directions of the side lobes of a point on the grid.

    Parameters
    ----------
    azimuth, range : unit vectors (azimuth, range), grid metres, along the lobes
    slope : change of slant range per metre of the grid, along its steepest ascent
    skew : sine of the angle between the edges of the spectrum, 1 where the lobes are perpendicular
    """

    azimuth: tuple[float, float]
    range: tuple[float, float]
    slope: float
    skew: float


@dataclass(frozen=True, eq=False)
class Carrier:
    r"""Distance D that gives the carrier phase :math:`e^{j 4 \pi D / \lambda}` of the pixels of an image.

    It is removed before interpolation between pixels and before division of the spectrum into looks.

    .. math:: D_{spotlight} = |p - c|, \qquad D_{stripmap} = x \sin\psi + \rho \cos\psi, \qquad
              D_{sliding} = -|p - q|, \qquad D_{TOPS} = |p - q|

    with c the antenna at mid-aperture, x the position along its line of flight, rho the range of closest approach, psi
    the squint of a pixel's aperture, and q the rotation centre of a turning beam, through which the line of sight at
    the centre of a pixel's aperture passes: beyond the scene in sliding spotlight, behind the antenna in TOPS.

    Parameters
    ----------
    grid : of the image
    wavelength : m
    center : (3,) float64, m, frame of the grid; antenna at mid-aperture
    forward : (3,) float64, unit vector of its velocity; in orbit not horizontal in the scene frame
    squint_sine : sine of the squint if every pixel has its own aperture; None: one aperture for all
    turning_range : m, range of closest approach of q, negative behind the antenna; infinite for a beam at rest

    Notes
    -----
    For a track that is straight over the aperture of one pixel. For an aperture of many degrees the remaining band is
    wide, but centred.
    """

    grid: ImageGrid
    wavelength: float
    center: F64
    forward: F64
    squint_sine: float | None
    turning_range: float = np.inf

    @classmethod
    def of(cls, image: SarImage) -> "Carrier":
        """Carrier of an image.

        Raises
        ------
        DataError
            A ground image without a recorded track, or an image of a circular aperture.
        """
        facts = image.metadata.get("focus", {})
        if facts.get("all_round"):
            raise DataError(
                "image: a circular aperture has no carrier, and no lobes along azimuth and range; "
                "sarmitsuba.truth.theory.circular_response is the response of a point"
            )
        grid = image.grid
        if "center_position" in facts:
            center = np.asarray(facts["center_position"], dtype=np.float64) - grid.offset
        elif grid.kind == "slant":
            center = grid.origin
        else:
            raise DataError("image: no recorded track, which ground images need; focus the raw data again")
        velocity = np.asarray(grid.along, dtype=np.float64)
        if "flight" in facts:
            flown = Flight.from_dict(facts["flight"])
            first, middle, last = flown.span
            velocity = flown.velocity_at(np.asarray(middle)) if last > first else flown.velocity
        forward = velocity / np.linalg.norm(velocity)
        sine = facts.get("squint_sine")
        turning = float(facts.get("turning_range", np.inf))
        return cls(grid, image.wavelength, center, forward, None if sine is None else float(sine), turning)

    def distance(self, azimuth: ArrayLike, range: ArrayLike) -> F64:
        """Distance D at grid coordinates, m, of any broadcastable shapes."""
        x, rho = self._cylinder(azimuth, range)
        if self.squint_sine is None:
            return np.hypot(x, rho)
        if np.isfinite(self.turning_range):
            ahead = self.turning_range * self._tangent
            # of a beam that overtakes the antenna (TOPS) the rotation centre lies behind it
            away = np.hypot(x - ahead, rho - self.turning_range)
            return np.asarray(-np.copysign(away, self.turning_range))
        return np.asarray(x * self.squint_sine + rho * np.sqrt(1.0 - self.squint_sine**2))

    def phasor(self, azimuth: ArrayLike, range: ArrayLike) -> C128:
        """Unit phasor of the carrier at grid coordinates."""
        return np.asarray(np.exp(4j * np.pi / self.wavelength * self.distance(azimuth, range)))

    def remove_carrier(self, data: C64, rows: slice, columns: slice) -> C128:
        """Pixels of a part of the image without the carrier."""
        axes = self.grid.azimuth[rows, None], self.grid.range[None, columns]
        return np.asarray(data[rows, columns] * self.phasor(*axes).conj())

    def lobes(self, azimuth: float, range: float) -> "Lobes":
        r"""Directions of the side lobes of a point at grid coordinates.

        The spectrum of a point is about a parallelogram, with edges along the gradient :math:`\nabla D` and along its
        change over the aperture. Lobes are perpendicular to the edges.
        """
        x, rho = (float(v) for v in self._cylinder(azimuth, range))
        shift = 0.0  # along the track, to the middle of the point's own aperture
        if self.squint_sine is not None:
            # tangent of the squint: of lines through q, or constant
            beyond = self.turning_range - rho
            tangent = (
                (self.turning_range * self._tangent - x) / beyond if np.isfinite(beyond) else self._tangent
            )
            shift = x - rho * tangent
        step = 1e-3 * rho
        slopes = [self._slope(azimuth, range, shift + s) for s in (-step, 0.0, step)]
        turn = slopes[2] - slopes[0]
        length = float(np.linalg.norm(slopes[1]))
        u, v = slopes[1] / length, turn / np.linalg.norm(turn)
        skew = float(u[0] * v[1] - u[1] * v[0])
        # the azimuth lobe points forward, the range lobe away from the radar
        across = np.array([u[1], -u[0]]) * np.copysign(1.0, u[1])
        away = np.array([v[1], -v[0]]) * np.copysign(1.0, skew)
        return Lobes(
            (float(across[0]), float(across[1])), (float(away[0]), float(away[1])), length, abs(skew)
        )

    @property
    def _tangent(self) -> float:
        """Tangent of the squint, 0 if all pixels share one aperture."""
        sine = self.squint_sine or 0.0
        return sine / float(np.sqrt(1.0 - sine**2))

    def _slope(self, azimuth: float, range: float, shift: float) -> F64:
        """Gradient of the distance from an antenna ``shift`` m along the track from mid-aperture, (azimuth, range)."""
        step = 0.5
        a = azimuth + step * np.array([1.0, -1.0, 0.0, 0.0])
        r = range + step * np.array([0.0, 0.0, 1.0, -1.0])
        x, rho = self._cylinder(a, r)
        d = np.hypot(x - shift, rho)
        return np.array([d[0] - d[1], d[2] - d[3]]) / (2.0 * step)

    def chip_about(self, data: C64, azimuth: float, range: float, half: int = 32) -> Chip:
        """Chip of the image about grid coordinates, without the carrier, ``half`` pixels to every side."""
        grid = self.grid
        row = round((azimuth - float(grid.azimuth[0])) / grid.azimuth_spacing)
        column = round((range - float(grid.range[0])) / grid.range_spacing)
        rows, columns = (slice(max(i - half, 0), i + half + 1) for i in (row, column))
        return Chip(self.remove_carrier(data, rows, columns), rows.start, columns.start)

    def place(self, point: F64) -> tuple[float, float]:
        """Grid coordinates of the image of a point of any height: of equal range and Doppler on the image plane.

        Parameters
        ----------
        point : (3,) float64, m, frame of the grid

        Raises
        ------
        DataError
            The point is closer to the track than the image plane.
        """
        grid = self.grid
        line = point - self.center
        drop = grid.height - float(self.center[2])
        along, across = float(self.forward @ grid.along), float(self.forward @ grid.across)
        # (a, b) from the foot of the antenna along and across, on the plane: a along + b across = wanted
        wanted = float(line @ self.forward) - float(self.forward[2]) * drop
        left = float(line @ line) - drop**2  # a^2 + b^2
        scale = along**2 + across**2
        square = left * scale - wanted**2
        if square < 0.0:
            raise DataError(f"point at {point.tolist()} m is closer to the track than the image plane")
        root = float(np.sqrt(square)) / scale
        foot = self.center - grid.origin
        a = wanted * along / scale - root * across + float(foot @ grid.along)
        b = wanted * across / scale + root * along + float(foot @ grid.across)
        return a, b if grid.kind == "ground" else float(np.hypot(b, grid.origin[2] - grid.height))

    def scene_position(self, azimuth: float, range: float) -> F64:
        """Position of grid coordinates on the image plane, (3,) float64, m, frame of the user's file."""
        grid = self.grid
        across = range
        if grid.kind == "slant":
            across = float(np.sqrt(max(range**2 - (grid.origin[2] - grid.height) ** 2, 0.0)))
        flat = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
        return np.asarray(flat + azimuth * grid.along + across * grid.across + grid.offset)

    def _cylinder(self, azimuth: ArrayLike, range: ArrayLike) -> tuple[F64, F64]:
        """Position along the line of flight from mid-aperture, and distance from that line, m."""
        grid = self.grid
        r = np.asarray(range, dtype=np.float64)
        if grid.kind == "slant":
            r = np.sqrt(np.maximum(r**2 - (grid.origin[2] - grid.height) ** 2, 0.0))
        foot = np.array([*grid.origin[:2], grid.height]) - self.center
        along, across = np.broadcast_arrays(np.asarray(azimuth, dtype=np.float64), r)
        line = foot + along[..., None] * grid.along + across[..., None] * grid.across
        x = line @ self.forward
        return np.asarray(x), np.asarray(np.linalg.norm(line - x[..., None] * self.forward, axis=-1))
