"""Satellite path from state vectors: read from a file, interpolated, with time zero when the aim point is seen."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_RADIUS
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.regular_files import read_bytes, read_text
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.mode import right_of
from sarmitsuba.radar.path import FlightPath
from sarmitsuba.radar.utc import DEFAULT_EPOCH, epoch_of_stamp, is_number, is_time, seconds_of, utc_after

_COLUMNS = "time_s (or an ISO date and time), x_m, y_m, z_m, vx_m_s, vy_m_s, vz_m_s"
# vectors per polynomial through positions and velocities: degree 7
_NEIGHBOURS = 4
# share of the speed by which velocities may differ from the change of the positions: velocities in an inertial frame
# differ by 3 % and more
_SLIP = 0.01
_COMPONENTS = ("X", "Y", "Z", "VX", "VY", "VZ")  # elements of a vector in an Earth Explorer orbit file


@dataclass(frozen=True, eq=False)
class StateVectors:
    r"""Earth-fixed positions and velocities of a satellite, with the interpolated path.

    Between two vectors the path is the Hermite polynomial of degree 7 through the positions and velocities of the four
    nearest. For a circular orbit of radius a and angular rate n, sampled every h seconds, the error of the position
    is at most

    .. math:: |\Delta| \le \frac{a n^8}{8!} \left(\tfrac{9}{16}\right)^2 h^8

    in the middle of the four, and :math:`(n h)^8 a / 8!` between the two vectors at either end.

    Parameters
    ----------
    time : (n,) float64, s, strictly increasing; n >= 2
    position, velocity : (n, 3) float64, m and m/s, WGS-84 ECEF; velocities are those relative to the turning Earth
    source : start of errors
    epoch : UTC of time zero, datetime64[ns]
    dated : whether the epoch was given with the vectors; else it is the default

    Raises
    ------
    RadarError
        Too few vectors, not in order, below the ground, or velocities that are not the change of the positions.

    Notes
    -----
    Ignores polar motion: the frame is taken as WGS-84's own.
    """

    time: F64
    position: F64
    velocity: F64
    source: str = "state vectors"
    epoch: np.datetime64 = DEFAULT_EPOCH
    dated: bool = False

    def __post_init__(self) -> None:
        n = self.time.size
        if n < 2 or self.position.shape != (n, 3) or self.velocity.shape != (n, 3):
            raise RadarError(f"{self.source}: {n} state vectors; give at least two, of {_COLUMNS}")
        if not (np.isfinite(self.time).all() and (np.diff(self.time) > 0.0).all()):
            raise RadarError(f"{self.source}: times must increase strictly; sort the state vectors by time")
        if not (np.isfinite(self.position).all() and np.isfinite(self.velocity).all()):
            raise RadarError(f"{self.source}: positions and velocities must be finite numbers")
        lowest = float(np.linalg.norm(self.position, axis=1).min())
        if lowest < 0.99 * EARTH_RADIUS:
            raise RadarError(
                f"{self.source}: a position is {lowest:g} m from the Earth's centre, inside the Earth; give ECEF "
                "positions in metres"
            )
        moved = np.diff(self.position, axis=0) / np.diff(self.time)[:, None]
        slip = np.linalg.norm(moved - 0.5 * (self.velocity[1:] + self.velocity[:-1]), axis=1)
        speed = float(np.linalg.norm(self.velocity, axis=1).max())
        if slip.max() > _SLIP * speed:
            raise RadarError(
                f"{self.source}: the velocities differ from the change of the positions by up to {slip.max():.3g} m/s; "
                "give velocities in m/s relative to the turning Earth (ECEF), of vectors at most 5 minutes apart"
            )

    @staticmethod
    def read(path: Path | str) -> "StateVectors":
        """Read an orbit file of Sentinel-1 (``.EOF``), or else a CSV."""
        path = Path(path)
        return StateVectors.from_eof(path) if path.suffix.lower() == ".eof" else StateVectors.from_csv(path)

    @staticmethod
    def from_eof(path: Path | str) -> "StateVectors":
        """Read the ``OSV`` elements (UTC, X, Y, Z, VX, VY, VZ) of an Earth Explorer file in the Earth-fixed frame."""
        path = Path(path)
        try:
            root = _document(read_bytes(path), path)
        except OSError as error:
            raise RadarError(f"{path}: cannot read the state vectors: {error.strerror}") from error
        except ElementTree.ParseError as error:
            raise RadarError(f"{path}: not well-formed XML: {one_line(error)}") from error
        frame = root.findtext(".//Ref_Frame", "EARTH_FIXED")
        if frame != "EARTH_FIXED":
            raise RadarError(
                f"{path}: the reference frame is {one_line(frame)}; give vectors that are EARTH_FIXED"
            )
        found = root.findall(".//OSV")
        try:
            stamps = [item.findtext("UTC", "").removeprefix("UTC=") for item in found]
            time = np.array([seconds_of(stamp, stamps[0]) for stamp in stamps])
            epoch = epoch_of_stamp(stamps[0]) if stamps else DEFAULT_EPOCH
            rows = np.array([[float(item.findtext(name, "")) for name in _COMPONENTS] for item in found])
        except ValueError as error:
            raise RadarError(
                f"{path}: {one_line(error)}; every OSV needs UTC, {', '.join(_COMPONENTS)}"
            ) from error
        rows = rows.reshape(-1, 6)
        return StateVectors(time, rows[:, :3], rows[:, 3:], path.name, epoch, dated=True)

    @staticmethod
    def from_csv(path: Path | str) -> "StateVectors":
        """Read one vector per line, comma separated, ``#`` comments, one optional header.

        The columns: time_s (or an ISO 8601 date and time, UTC), x_m, y_m, z_m, vx_m_s, vy_m_s, vz_m_s.
        """
        path = Path(path)
        try:
            text = read_text(path)
        except OSError as error:
            raise RadarError(f"{path}: cannot read the state vectors: {error.strerror}") from error
        lines = [line.split(",") for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
        if lines and not is_time(lines[0][0]):
            lines = lines[1:]
        if not lines or any(len(cells) != 7 for cells in lines):
            raise RadarError(f"{path}: every line needs seven columns: {_COLUMNS}")
        try:
            epoch, first = epoch_of_stamp(lines[0][0]), seconds_of(lines[0][0], lines[0][0])
            time = np.array([seconds_of(cells[0], lines[0][0]) for cells in lines]) - first
            rows = np.array([[float(cell) for cell in cells[1:]] for cells in lines])
        except ValueError as error:
            raise RadarError(f"{path}: {one_line(error)}; every line needs {_COLUMNS}") from error
        dated = not is_number(lines[0][0])
        return StateVectors(time, rows[:, :3], rows[:, 3:], path.name, utc_after(epoch, first), dated)

    def at(self, time: F64) -> tuple[F64, F64]:
        """Position and velocity, two (n, 3) float64, ECEF, at (n,) times in s.

        Raises
        ------
        RadarError
            A time lies outside of the vectors' span.
        """
        if time.size and (time.min() < self.time[0] or time.max() > self.time[-1]):
            raise RadarError(
                f"{self.source}: the state vectors span {self.time[0]:g} to {self.time[-1]:g} s, and the track needs "
                f"{time.min():g} to {time.max():g} s; give more of them, or a shorter track"
            )
        position, velocity = np.empty((time.size, 3)), np.empty((time.size, 3))
        count = min(_NEIGHBOURS, self.time.size)
        interval = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, self.time.size - 2)
        first = np.clip(interval - (count // 2 - 1), 0, self.time.size - count)
        for begin in np.unique(first):
            part = slice(begin, begin + count)
            known = np.stack([self.position[part], self.velocity[part]], axis=1).reshape(-1, 3)
            middle = float(self.time[part].mean())
            curve = scipy.interpolate.KroghInterpolator(np.repeat(self.time[part] - middle, 2), known)
            here = first == begin
            position[here], velocity[here] = curve.derivatives(time[here] - middle, 2)
        return position, velocity

    def path_over(
        self, anchor: Anchor, offset: F64, aim: F64, squint: float = 0.0, side: str | None = None
    ) -> "EphemerisPath":
        """Path with time zero when the aim point is seen at the squint angle.

        Parameters
        ----------
        anchor : of the file's frame
        offset : (3,) float64, m; scene frame = file frame - offset
        aim : (3,) float64, m, scene frame
        squint : rad, forward of the plane square to the Earth-fixed velocity
        side : ``left`` or ``right``, of the aim point; None: either

        Raises
        ------
        RadarError
            The aim point is never seen at this angle from above the horizon. Of several times the one of the shortest
            slant range is used.
        """
        path = EphemerisPath(self, anchor, offset, 0.0)

        def miss(states: tuple[F64, F64]) -> F64:
            position, velocity = states
            line = aim - position
            size = np.linalg.norm(line, axis=1) * np.linalg.norm(velocity, axis=1)
            return np.asarray(np.einsum("ij,ij->i", line, velocity) / size - np.sin(squint))

        # the sign changes once per revolution
        value = miss(path.in_scene(self.position, self.velocity))
        found: list[tuple[float, float]] = []
        for i in np.flatnonzero((value[:-1] > 0.0) & (value[1:] <= 0.0)):
            zero = float(
                scipy.optimize.brentq(
                    lambda t: float(miss(path.states(np.array([t])))[0]),
                    self.time[i],
                    self.time[i + 1],
                    xtol=1e-12,
                )
            )
            position, velocity = (each[0] for each in path.states(np.array([zero])))
            line = aim - position
            seen = "right" if float(line @ right_of(velocity)) > 0.0 else "left"
            if line[2] < 0.0 and side in (None, seen):
                found.append((float(np.linalg.norm(line)), zero))
        if not found:
            how = f" on its {side}" if side else ""
            raise RadarError(
                f"{self.source}: the satellite never has the aim point{how} in its "
                f"{'zero-Doppler plane' if squint == 0.0 else f'plane of squint {np.degrees(squint):g} deg'} while the "
                "vectors last; give those of the pass, or change the anchor (latitude_deg, longitude_deg), look_side "
                "or aim point"
            )
        return EphemerisPath(self, anchor, offset, min(found)[1])


@dataclass(frozen=True, eq=False)
class EphemerisPath(FlightPath):
    """Path through state vectors, in the scene frame.

    Parameters
    ----------
    vectors : of the satellite
    anchor : of the file's frame
    offset : (3,) float64, m; scene frame = file frame - offset
    middle : s, on the vectors' own time, at mid-aperture
    """

    vectors: StateVectors
    anchor: Anchor
    offset: F64
    middle: float

    def states(self, time: F64) -> tuple[F64, F64]:
        """See `FlightPath`."""
        return self.in_scene(*self.vectors.at(time + self.middle))

    @property
    def epoch(self) -> np.datetime64:
        """UTC of mid-aperture, datetime64[ns]."""
        return utc_after(self.vectors.epoch, self.middle)

    @property
    def since_default(self) -> float:
        """Mid-aperture in s after time zero of the file, for vectors without dates."""
        return float((self.epoch - DEFAULT_EPOCH) / np.timedelta64(1, "ns")) * 1e-9

    def in_scene(self, position: F64, velocity: F64) -> tuple[F64, F64]:
        """Earth-fixed states, (n, 3) m and m/s, in the scene frame."""
        return self.anchor.from_ecef(position) - self.offset, np.asarray(velocity @ self.anchor.axes.T)


def _document(data: bytes, path: Path) -> ElementTree.Element:
    """Root of an XML document; RadarError where it has a document type, whose entities could expand without bound."""
    types: list[str] = []
    looker = expat.ParserCreate()
    looker.StartDoctypeDeclHandler = lambda name, *_: types.append(name)
    with suppress(expat.ExpatError, ValueError, LookupError):  # the reader below gives the message
        looker.Parse(data, True)
    if types:
        raise RadarError(
            f"{path}: holds a document type (<!DOCTYPE), which is not allowed in an orbit file; remove it"
        )
    return ElementTree.fromstring(data)
