"""Circular orbit about the rotating Earth that sees the aim point at given incidence and squint, in the scene frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_GRAVITY, EARTH_RADIUS, EARTH_ROTATION
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.ephemeris import StateVectors
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.mode import MODES, AimGeometry, right_of
from sarmitsuba.radar.path import FlightPath

# directions from the aim point sampled to bracket roots
_DIRECTIONS = 720
_ROTATION = np.array([0.0, 0.0, EARTH_ROTATION])
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
        velocity = velocity - np.cross(_ROTATION, position)
        turned = (_earth_fixed(each, time) for each in (position, velocity))
        position, velocity = turned
        return self.anchor.from_ecef(position) - self.offset, np.asarray(velocity @ self.anchor.axes.T)


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
        fixed = velocity - np.cross(_ROTATION, position)
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
    Incidence is counted from the frame's own z axis, which is the ellipsoid's normal at the anchor. The squint angle is
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
