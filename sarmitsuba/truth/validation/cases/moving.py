"""Moving targets: displacement, smearing, and along-track interferometric phase."""

from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.truth.theory import moving as theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, bandwidth, chain, make_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison

RANGE, SPEED, CELL, FREQUENCY = 5e3, 150.0, 1.0, 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
# m, edges of the corner and of the wall
EDGE, WALL = 0.5, 2.0
# s, between the looks of the along-track interferogram
LAG = 2e-3
# m, between the receivers of the other one
BASELINE = 1.0
# tubes end at the edges of flat facets exactly: no more rays are needed
SPARSE = TraceSettings(ray_spacing=0.03, max_depth=3)
SOURCE = "Raney, IEEE Trans. AES 7 (1971)"


@dataclass(frozen=True, eq=False)
class FlightAxes:
    """A flight past the origin, drawn at random, and its axes.

    Parameters
    ----------
    parameters : of the radar
    antenna, velocity : (3,) m and m/s at mid-aperture
    along, away, sight : (3,) unit vectors of flight, on the ground away from the radar, and to the origin
    time : s, of the aperture
    """

    parameters: dict[str, Parameter]
    antenna: F64
    velocity: F64
    along: F64
    away: F64
    sight: F64
    time: float

    @staticmethod
    def drawn(rng: np.random.Generator) -> "FlightAxes":
        """Any heading, either side, looks between 35 and 50 degrees."""
        parameters: dict[str, Parameter] = {
            "slant_range": RANGE,
            "look_angle_deg": float(rng.uniform(35.0, 50.0)),
            "heading_deg": float(rng.uniform(0.0, 360.0)),
            "look_side": str(rng.choice(["left", "right"])),
            "azimuth_resolution": CELL,
            "bandwidth": bandwidth(CELL),
            "center_frequency": FREQUENCY,
            "speed": SPEED,
            "image_extent_azimuth": 32.0,
            "image_extent_range": 32.0,
        }
        track = make_scene(None, (), parameters, points=(PointTarget("aim", np.zeros(3)),)).radar.track
        sight = -track.center_position / RANGE
        away = sight * np.array([1.0, 1.0, 0.0])
        n, span = track.n_pulses, float(track.time[-1] - track.time[0])
        return FlightAxes(
            parameters,
            track.center_position,
            track.velocity[track.center_index],
            track.along,
            away / np.linalg.norm(away),
            sight,
            span * n / (n - 1),
        )

    def motion(
        self,
        range_speed: float = 0.0,
        azimuth_speed: float = 0.0,
        range_acceleration: float = 0.0,
        climb: float = 0.0,
    ) -> Motion:
        """Motion on the ground with these components to the radar's line of sight and track, and a climb, m/s."""
        slope = float(self.away @ self.sight)
        velocity = self.away * range_speed / slope + self.along * azimuth_speed
        return Motion.of(velocity + np.array([0.0, 0.0, climb]), self.away * range_acceleration / slope)

    def scene(
        self, body: Geometry | PointTarget, motion: Motion, shows: F64, settings: TraceSettings = SPARSE
    ) -> Scene:
        """The body, moving, in an image about the place where it is to show."""
        if isinstance(body, PointTarget):
            scene = make_scene(None, (), self.parameters, points=(replace(body, motion=motion),))
        else:
            moves = tuple(motion if i < MOVING else Motion() for i in range(len(body.mesh_names)))
            body = replace(body, mesh_motion=moves)
            scene = make_scene(body, targets.PEC, self.parameters, settings=settings)
        # the radar aims at where the body is
        image = replace(scene.image, center_x=float(shows[0]), center_y=float(shows[1]))
        return replace(scene, image=image)

    def ahead(self, image: SarImage) -> float:
        """How far along the track from the origin the brightest target shows, m."""
        grid = image.grid
        metrics = point_target_in(image)
        first = grid.positions()[0, grid.shape[1] // 2]
        return float((first - grid.along * (grid.azimuth[0] - metrics.azimuth_position)) @ self.along)


# of the meshes of a body, the first so many move: three faces of a corner, or the wall without its ground
MOVING = 3


def corner(view: FlightAxes) -> Geometry:
    """Square trihedral that looks at the radar."""
    n = -view.sight
    x = np.cross(n, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    turn = 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    edges = n / np.sqrt(3.0) + np.sqrt(2.0 / 3.0) * (np.cos(turn) * x + np.sin(turn) * np.cross(x, n))
    return targets.geometry(
        [targets.parallelogram(np.zeros(3), EDGE * edges[i], EDGE * edges[(i + 1) % 3]) for i in range(3)]
    )


def wall(view: FlightAxes) -> Geometry:
    """Wall along the track on level ground at rest, to which it reaches down however it climbs."""
    up, low = np.array([0.0, 0.0, WALL]), -0.5 * WALL * view.along - np.array([0.0, 0.0, 0.5 * WALL])
    third = [
        targets.parallelogram(low + WALL / 3.0 * i * view.along, WALL / 3.0 * view.along, 1.25 * up)
        for i in range(3)
    ]
    ground = targets.parallelogram(-4.0 * view.along - 6.0 * view.away, 8.0 * view.along, 7.0 * view.away)
    return targets.geometry([*third, ground])


def displacement(quick: bool = False) -> Case:
    """Points, corners and the double bounce of wall and ground, displaced along the track by their range speed."""
    rng = np.random.default_rng(71)
    comparisons = []
    count = 3 if quick else 8

    def compare(label: str, speeds: F64, got: list[float], tolerance: float, reason: str) -> None:
        want = theory.azimuth_displacement(RANGE, speeds, SPEED)
        comparisons.append(
            Comparison(
                label, speeds, want, np.asarray(got), tolerance=tolerance, reason=reason, unit="m", shown=0
            )
        )

    for label, body in (("ideal point", None), ("trihedral", corner)):
        speeds, got = np.sort(rng.uniform(-4.0, 4.0, count)), []
        for speed in speeds:
            view = FlightAxes.drawn(rng)
            motion = view.motion(range_speed=float(speed))
            shows = theory.apparent_place(
                view.antenna, view.velocity, np.zeros(3), np.asarray(motion.velocity), 0.0
            )
            target = PointTarget("point", np.zeros(3)) if body is None else body(view)
            got.append(view.ahead(chain(view.scene(target, motion, shows))))
        compare(label, speeds, got, 0.02, "interpolation of the peak; the aperture is not infinitely short")
    climbs = rng.uniform(-1.5, 1.5, count)
    speeds, got = np.sort(rng.uniform(-2.0, 2.0, count)), []
    for speed, climb in zip(speeds, climbs, strict=True):
        view = FlightAxes.drawn(rng)
        motion = view.motion(range_speed=float(speed), climb=float(climb))
        of_both = theory.double_bounce_range_speed(view.sight, view.away, np.asarray(motion.velocity))
        assert np.isclose(of_both, speed)
        ahead = float(theory.azimuth_displacement(RANGE, of_both, SPEED))
        image = chain(view.scene(wall(view), motion, ahead * view.along))
        got.append(view.ahead(image))
    compare("wall and ground, the wall climbing too", speeds, got, 0.02, "interpolation of the peak")
    return Case(
        name="moving_displacement",
        topic="geometry",
        title="What moves shows elsewhere along the track",
        formula="-R v_r / v; of a wall and the ground v_r = (w.n)(d.n), whatever the climb",
        source=SOURCE,
        x_label="range speed (m/s)",
        y_label="displacement along the track (m)",
        comparisons=tuple(comparisons),
        note=f"X band, {RANGE / 1e3:g} km, {SPEED:g} m/s, cell {CELL:g} m; heading, side and look angle drawn.",
    )


def smear(quick: bool = False) -> Case:
    """Loss of the peak by speed along the track and by acceleration, points and corners."""
    rng = np.random.default_rng(72)
    comparisons = []
    count = 3 if quick else 8
    for label, body, name, most in (
        ("ideal point, speed along the track", None, "azimuth_speed", 3.6),
        ("ideal point, acceleration away", None, "range_acceleration", 0.23),
        ("trihedral, speed along the track", corner, "azimuth_speed", 3.6),
        ("trihedral, acceleration away", corner, "range_acceleration", 0.23),
    ):
        amounts = np.sort(rng.uniform(-most, most, count if body is None else count // 2))
        want, got = [], []
        for amount in amounts:
            view = FlightAxes.drawn(rng)
            motion = view.motion(**{name: float(amount)})
            target = PointTarget("point", np.zeros(3)) if body is None else body(view)
            peaks = [
                float(db_from_power(point_target_in(chain(view.scene(target, m, np.zeros(3)))).rcs))
                for m in (motion, Motion())
            ]
            got.append(peaks[0] - peaks[1])
            change = theory.range_acceleration(
                view.antenna,
                view.velocity,
                np.zeros(3),
                np.asarray(motion.velocity),
                np.asarray(motion.acceleration),
            )
            phase = theory.quadratic_phase(change, view.time, WAVELENGTH)
            want.append(float(theory.smear_loss_db(phase)))
        comparisons.append(
            Comparison(
                label,
                amounts / most,
                np.asarray(want),
                np.asarray(got),
                tolerance=0.02 if body is None else 0.15,
                reason="interpolation of the peak"
                if body is None
                else "a corner's return over its aspects is not a point's; blocks of pulses",
                unit="dB",
                shown=0,
            )
        )
    return Case(
        name="moving_smear",
        topic="geometry",
        title="What moves along the track or accelerates smears",
        formula="(C^2(s) + S^2(s)) / s^2, s^2 = 2 phi / pi, phi = pi D T^2 / 2 lambda, "
        "D = (|v - w|^2 - v^2) / R + a.d",
        source=SOURCE + "; Carrara et al., Spotlight SAR (1995), ch. 5",
        x_label="azimuth speed over 3.6 m/s, acceleration over 0.23 m/s^2",
        y_label="loss of the peak (dB)",
        comparisons=tuple(comparisons),
        note="Uniform aperture; the middle of the response is the peak up to a quadratic phase of pi.",
    )


def measure_along_track(quick: bool = False) -> Case:
    """Phase between two passes that follow each other by milliseconds, and between two receivers on one aircraft."""
    rng = np.random.default_rng(73)
    comparisons = []
    for label, body, lag, count in (
        ("ideal point, two passes", None, LAG, 4 if quick else 12),
        (f"ideal point, receivers {BASELINE:g} m apart", None, 0.5 * BASELINE / SPEED, 2 if quick else 12),
        (f"trihedral, receivers {BASELINE:g} m apart", corner, 0.5 * BASELINE / SPEED, 1 if quick else 6),
    ):
        speeds, got = np.sort(rng.uniform(-3.5, 3.5, count)), []
        for speed in speeds:
            view = FlightAxes.drawn(rng)
            motion = view.motion(range_speed=float(speed), azimuth_speed=float(rng.uniform(-1.0, 1.0)))
            velocity = np.asarray(motion.velocity)
            shows = theory.apparent_place(view.antenna, view.velocity, np.zeros(3), velocity, 0.0)
            target = PointTarget("point", np.zeros(3)) if body is None else body(view)
            early = view.scene(target, motion, shows)
            if lag == LAG:
                track = early.radar.track
                late = replace(early, radar=replace(early.radar, track=replace(track, time=track.time + lag)))
            else:
                late = replace(
                    view, parameters={**view.parameters, "receiver_offset_along": -BASELINE}
                ).scene(target, motion, shows)
            first, second = (chain(scene).total() for scene in (early, late))
            at = np.unravel_index(int(np.argmax(np.abs(first))), first.shape)
            got.append(float(np.degrees(np.angle(second[at] * np.conj(first[at])))))
        want = np.degrees(theory.phase_along_track(speeds, lag, WAVELENGTH))
        comparisons.append(
            Comparison(
                label,
                speeds,
                want,
                want + (np.asarray(got) - want + 180.0) % 360.0 - 180.0,
                tolerance=0.1 if body is None else 1.0,
                reason="it goes on by millimetres along the image between the looks"
                + ("" if body is None else "; blocks of pulses that start with another aspect of it"),
                unit="deg",
                shown=0,
            )
        )
    return Case(
        name="along_track_phase",
        topic="geometry",
        title="Phase of what moves between two looks along the track",
        formula="-4 pi v_r tau / lambda; tau = B / (2 v) for one transmitter and two receivers",
        source="Goldstein and Zebker, Nature 328 (1987)",
        x_label="range speed (m/s)",
        y_label="phase (deg)",
        comparisons=tuple(comparisons),
        note=f"The same track flown {1e3 * LAG:g} ms later, or a receiver {BASELINE:g} m behind; up to 1 m/s along the "
        "track besides.",
    )


CASES.register(CaseEntry("moving_displacement", "geometry", displacement))
CASES.register(CaseEntry("moving_smear", "geometry", smear))
CASES.register(CaseEntry("along_track_phase", "geometry", measure_along_track))
