"""Orbits in the scene frame: a circular one about the rotating Earth, or a path from state vectors.

The circular orbit sees the aim point at given incidence and squint. State vectors are read from a file and
interpolated, with time zero when the aim point is seen.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_GRAVITY, EARTH_RADIUS, EARTH_ROTATION
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.regular_files import read_bytes, read_text
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.mode import MODES, AimGeometry, FlightPath, right_of
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
    Ignores polar motion: the frame is taken as that of WGS-84.
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
    middle : s, on the vectors' time, at mid-aperture
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


# rad/s, ECEF
EARTH_SPIN = np.array([0.0, 0.0, EARTH_ROTATION])
# directions from the aim point sampled to bracket roots
_DIRECTIONS = 720
_OF_ORBIT = ("orbit_inclination_deg", "orbit_pass", "incidence_angle_deg")
_REPLACED = ("slant_range", "look_angle_deg", "heading_deg", "speed")


@dataclass(frozen=True, eq=False)
class CircularOrbit(FlightPath):
    """A circular orbit about the rotating Earth.

    Parameters
    ----------
    anchor : of the file's frame
    offset : (3,) float64, m; scene frame = file frame - offset
    position : (3,) float64, m; at mid-aperture, ECEF
    velocity : (3,) float64, m/s; at mid-aperture, inertial, in the axes that ECEF has then; square to ``position``

    Notes
    -----
    States are in the Earth-fixed frame: the velocity is that relative to the ground. Ignores the Earth's flattening in
    the satellite's motion (a Keplerian circle), drag and the atmosphere.
    """

    anchor: Anchor
    offset: F64
    position: F64
    velocity: F64

    def states(self, time: F64) -> tuple[F64, F64]:
        """See `FlightPath`."""
        rate = float(np.linalg.norm(self.velocity) / np.linalg.norm(self.position))
        cosine, sine = np.cos(rate * time)[:, None], np.sin(rate * time)[:, None]
        position = cosine * self.position + sine / rate * self.velocity
        velocity = cosine * self.velocity - rate * sine * self.position
        position, velocity = earth_fixed_states(position, velocity, time)
        return self.anchor.from_ecef(position) - self.offset, np.asarray(velocity @ self.anchor.axes.T)


def earth_fixed_states(position: F64, velocity: F64, time: F64) -> tuple[F64, F64]:
    """Positions and velocities (n, 3), ECEF, at (n,) times, s, from inertial ones in the ECEF axes of time zero."""
    velocity = velocity - np.cross(EARTH_SPIN, position)
    return _earth_fixed(position, time), _earth_fixed(velocity, time)


def _earth_fixed(vectors: F64, time: F64) -> F64:
    """Vectors (n, 3) given in the ECEF axes of time zero, in the ECEF axes of (n,) times, s."""
    angle = EARTH_ROTATION * time
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


@dataclass(frozen=True)
class OrbitRequest:
    """Requirements of a circular orbit.

    Parameters
    ----------
    altitude : m over the Earth's equatorial radius
    inclination, incidence_angle, squint_angle : rad
    ascending : northbound at mid-aperture, else southbound
    look_side : side of the aim point
    """

    altitude: float
    inclination: float
    incidence_angle: float
    squint_angle: float = 0.0
    ascending: bool = True
    look_side: Literal["left", "right"] = "right"

    @property
    def radius(self) -> float:
        """Orbit radius, m."""
        return EARTH_RADIUS + self.altitude


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Satellite states that see the aim point at the wanted incidence.

    Parameters
    ----------
    wanted : orbit
    anchor : of the file's frame
    aim : (3,) float64, m, file frame
    """

    wanted: OrbitRequest
    anchor: Anchor
    aim: F64

    def states(self, azimuth: F64) -> tuple[F64, F64]:
        r"""Position and inertial velocity, ECEF, for directions towards the satellite, (n,) rad clockwise from north.

        The position is the intersection of the line of sight with the orbit's sphere; the flight azimuth b is

        .. math:: \sin b = \cos i / \cos\delta

        with the inclination i and the geocentric latitude delta; due east or west beyond the largest latitude of the
        orbit.
        """
        sine, cosine = np.sin(self.wanted.incidence_angle), np.cos(self.wanted.incidence_angle)
        local = np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.full(azimuth.shape, cosine)], 1)
        line = local @ self.anchor.axes
        ground = self.anchor.to_ecef(self.aim)
        up = line @ ground
        radius = self.wanted.radius
        position = ground + (np.sqrt(up**2 + radius**2 - ground @ ground) - up)[:, None] * line
        level = np.maximum(np.hypot(position[:, 0], position[:, 1]), 1e-9 * radius)
        east = np.stack([-position[:, 1], position[:, 0], np.zeros(azimuth.shape)], 1) / level[:, None]
        north = np.cross(position / radius, east)
        eastward = np.clip(np.cos(self.wanted.inclination) * radius / level, -1.0, 1.0)
        northward = np.sqrt(1.0 - eastward**2) * (1.0 if self.wanted.ascending else -1.0)
        direction = eastward[:, None] * east + northward[:, None] * north
        return position, np.sqrt(EARTH_GRAVITY / radius) * direction

    def reach(self, azimuth: F64) -> F64:
        """(n,) float64; negative where the inclination does not reach the satellite's latitude."""
        position, _ = self.states(azimuth)
        return np.asarray(
            np.sin(self.wanted.inclination) ** 2 - (position[:, 2] / self.wanted.radius) ** 2 + 1e-12
        )

    def miss(self, azimuth: F64) -> F64:
        """(n,) float64; sine of the line of sight along the Earth-fixed velocity minus that of the wanted squint."""
        position, velocity = self.states(azimuth)
        fixed = velocity - np.cross(EARTH_SPIN, position)
        line = self.anchor.to_ecef(self.aim) - position
        size = np.linalg.norm(fixed, axis=1) * np.linalg.norm(line, axis=1)
        return np.asarray(np.einsum("ij,ij->i", fixed, line) / size - np.sin(self.wanted.squint_angle))

    def orbits(self) -> list[CircularOrbit]:
        """All orbits through the aim point's zero-Doppler (or squinted) plane, on either side."""
        grid = np.linspace(-np.pi, np.pi, _DIRECTIONS + 1)
        # ascending and descending passes end at the largest latitude
        turning = [_root(self.reach, low, high) for low, high in _brackets(grid, self.reach(grid))]
        inside = np.sort(np.concatenate([grid, turning]))
        brackets = [
            (low, high)
            for low, high in _brackets(inside, self.miss(inside))
            if self.reach(np.array([0.5 * (low + high)]))[0] >= 0.0
        ]
        found = []
        for low, high in brackets:
            position, velocity = self.states(np.array([_root(self.miss, low, high)]))
            found.append(CircularOrbit(self.anchor, np.zeros(3), position[0], velocity[0]))
        return found


def circular_orbit(wanted: OrbitRequest, anchor: Anchor, aim: F64, where: str = "orbit") -> CircularOrbit:
    """The circular orbit that sees the aim point at the wanted incidence and squint at mid-aperture.

    One unknown is left: the azimuth of the satellite as seen from the aim point. Incidence and the orbit's radius put
    it on a cone, the inclination gives its direction of flight there, and the squint is the condition.

    Parameters
    ----------
    wanted : orbit
    anchor : of the file's frame
    aim : (3,) float64, m, file frame
    where : start of the error

    Raises
    ------
    RadarError
        No such orbit sees the aim point.

    Notes
    -----
    Incidence is counted from the frame's z axis, which is the ellipsoid's normal at the anchor. The squint angle is
    that between the line of sight and the plane square to the Earth-fixed velocity; 0 is zero Doppler.
    """
    found = _Candidates(wanted, anchor, aim).orbits()
    fitting = [path for path in found if geometry_of_path(path, aim)[1] == wanted.look_side]
    if not fitting:
        latitude = float(np.degrees(anchor.to_geodetic(aim)[0]))
        squint = float(np.degrees(wanted.squint_angle))
        squinted = f" and squint_angle_deg = {squint:g} deg" if squint else ""
        turning = 90.0 - abs(90.0 - float(np.degrees(wanted.inclination)))
        raise RadarError(
            f"{where}: no {'ascending' if wanted.ascending else 'descending'} pass with orbit_inclination_deg = "
            f"{np.degrees(wanted.inclination):g} deg and orbit_altitude = {wanted.altitude:g} m sees latitude "
            f"{latitude:.4g} deg on its {wanted.look_side} at incidence_angle_deg = "
            f"{np.degrees(wanted.incidence_angle):g} deg{squinted} (the satellite stays within "
            f"{turning:.4g} deg of the equator); change orbit_pass, look_side or orbit_inclination_deg"
        )
    return fitting[0]


def geometry_of_path(path: FlightPath, aim: F64) -> tuple[AimGeometry, str]:
    """Geometry of a path's mid-aperture about the aim point (3,), and the side on which the aim point lies."""
    position, velocity = path.states(np.zeros(1))
    level = velocity[0] * np.array([1.0, 1.0, 0.0])
    along = level / np.linalg.norm(level)
    right = right_of(along)
    side = "right" if float((aim - position[0]) @ right) > 0.0 else "left"
    return AimGeometry(aim, position[0], along, right if side == "right" else -right), side


def orbit_of(
    given: RadarInput, anchor: Anchor, aim: F64, offset: F64
) -> tuple[AimGeometry, FlightPath] | None:
    """Geometry and path of the orbit or the state vectors in a description; None without either.

    Parameters
    ----------
    given : description
    anchor : of the file's frame
    aim : (3,) float64, m, scene frame
    offset : (3,) float64, m; scene frame = file frame - offset

    Raises
    ------
    RadarError
        Parameters contradict each other, or the satellite never sees the aim point at these angles.
    """
    s, where = given.sensor, given.where
    on = "state_vectors_file" if s.state_vectors_file else "orbit_altitude" if s.orbit_altitude > 0.0 else ""
    for name in _REPLACED if on else _OF_ORBIT:
        if name in given.sensor_given:
            remedy = "leave one of them out" if on else "give orbit_altitude, or leave it out"
            raise RadarError(f"{where}: {name} has no effect {f'beside {on}' if on else 'alone'}; {remedy}")
    if not on:
        return None
    if MODES[s.mode].path_parameters:
        raise RadarError(
            f"{where}: {on} has no effect with mode = {s.mode}, which flies a path of its own; leave one of them out"
        )
    squint = float(np.radians(s.squint_angle_deg))
    if on == "orbit_altitude":
        path: FlightPath = _moved_orbit(given, anchor, aim, offset, squint)
    else:
        for name in ("orbit_altitude", *_OF_ORBIT):
            if name in given.sensor_given:
                raise RadarError(
                    f"{where}: {name} has no effect beside state_vectors_file; leave one of them out"
                )
        vectors = StateVectors.read(given.folder / s.state_vectors_file)
        side = s.look_side if "look_side" in given.sensor_given else None
        path = vectors.path_over(anchor, offset, aim, squint, side)
    return geometry_of_path(path, aim)[0], path


def _moved_orbit(given: RadarInput, anchor: Anchor, aim: F64, offset: F64, squint: float) -> CircularOrbit:
    s = given.sensor
    wanted = OrbitRequest(
        altitude=s.orbit_altitude,
        inclination=float(np.radians(s.orbit_inclination_deg)),
        incidence_angle=float(np.radians(s.incidence_angle_deg)),
        squint_angle=squint,
        ascending=s.orbit_pass == "ascending",
        look_side=s.look_side,
    )
    found = circular_orbit(wanted, anchor, aim + offset, given.where)
    return replace(found, offset=offset)


def _root(law: Callable[[F64], F64], low: float, high: float) -> float:
    """Root of a vectorised function."""
    return float(scipy.optimize.brentq(lambda x: float(law(np.array([x]))[0]), low, high, xtol=1e-14))


def _brackets(x: F64, y: F64) -> list[tuple[float, float]]:
    """Neighbouring nodes between which y changes its sign."""
    pick = np.flatnonzero(np.sign(y[:-1]) * np.sign(y[1:]) <= 0.0)
    return [(float(x[i]), float(x[i + 1])) for i in pick]
