"""Circular orbits about the rotating Earth: Doppler in the echoes, and where and how sharply points are focused."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_RADIUS, EARTH_ROTATION, SPEED_OF_LIGHT
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.doppler import beam_doppler, doppler_history
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison


@dataclass(frozen=True)
class Mission:
    """Rounded figures of a satellite, from its mission's public pages.

    Parameters
    ----------
    name : as plots say it
    altitude : over the equatorial radius, m
    inclination_deg, incidence_deg : deg
    center_frequency : Hz
    antenna_length : m
    """

    name: str
    altitude: float
    inclination_deg: float
    incidence_deg: float
    center_frequency: float
    antenna_length: float


MISSIONS = (
    Mission("Sentinel-1-like", 693e3, 98.18, 39.0, 5.405e9, 12.3),
    Mission("TerraSAR-X-like", 514e3, 97.44, 35.0, 9.65e9, 4.8),
    Mission("ICEYE-like", 570e3, 97.69, 28.0, 9.65e9, 3.2),
)
# pulses and their rate where the phase history is measured, over a quarter of a second
_PULSES, _PRF = 1000, 4000.0
# half-power width of a sinc over its first null
_IRW = 0.8858929


def orbit_scene(
    mission: Mission, seed: int, point: F64, extent: float = 120.0, **changes: float | str
) -> Scene:
    """A point under a drawn pass of a mission (latitude, longitude, height, pass, side), ``extent`` m of azimuth."""
    rng = np.random.default_rng([29, seed])
    values: dict[str, float | str] = {
        "mode": "spotlight",
        "orbit_altitude": mission.altitude,
        "orbit_inclination_deg": mission.inclination_deg,
        "orbit_pass": ("ascending", "descending")[rng.integers(2)],
        "look_side": ("left", "right")[rng.integers(2)],
        "incidence_angle_deg": mission.incidence_deg,
        "latitude_deg": rng.uniform(-65.0, 65.0),
        "longitude_deg": rng.uniform(-180.0, 180.0),
        "height": rng.uniform(0.0, 3e3),
        "center_frequency": mission.center_frequency,
        "bandwidth": 100e6,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
        **changes,
    }
    radar = RadarDescription(**values)  # type: ignore[arg-type]
    film = FilmDescription(image_grid="ground", image_extent_azimuth=extent, image_extent_range=120.0)
    with suppress_warnings():  # pulses enough to unwrap the phase
        return build_scene(points=[PointTarget("point", point, 1.0)], radar=radar, film=film)


def orbit_state(radar: Radar) -> tuple[F64, F64]:
    """Position and inertial velocity at the middle pulse, ECEF, m and m/s."""
    i = radar.track.center_index
    position = radar.anchor.to_ecef(radar.track.position[i] + radar.offset)
    velocity = radar.track.velocity[i] @ radar.anchor.axes
    return position, velocity + np.cross([0.0, 0.0, EARTH_ROTATION], position)


def evaluate_expected(scene: Scene, mission: Mission, point: F64) -> theory.OrbitDoppler:
    """Closed form for a point of the file's frame, from the satellite's place at the middle pulse alone."""
    radar = scene.radar
    position, velocity = orbit_state(radar)
    inclination = np.radians(mission.inclination_deg)
    north = position[2] / (np.linalg.norm(position) * np.sin(inclination))
    latitude_argument = np.arcsin(np.clip(north, -1.0, 1.0))
    place = radar.anchor.to_ecef(point)
    return theory.circular_orbit_doppler(
        EARTH_RADIUS + mission.altitude,
        float(inclination),
        float(latitude_argument if velocity[2] > 0.0 else np.pi - latitude_argument),
        float(np.linalg.norm(place - position)),
        float(np.linalg.norm(place)),
        1.0 if radar.look_side == "left" else -1.0,
        SPEED_OF_LIGHT / mission.center_frequency,
    )


def measured_doppler(scene: Scene) -> tuple[float, float]:
    """Doppler (Hz) and its rate (Hz/s) at time zero from the phase of the point's echoes.

    Every pulse's phase is read at the nearest sample; samples of one point differ in amplitude only.
    """
    raw = simulate(scene)
    track, window = raw.radar.track, raw.radar.window
    distance = np.linalg.norm(scene.points[0].position - track.position, axis=1)
    sample = np.rint((distance - window.start_range) / window.sample_spacing).astype(int)
    phase = np.unwrap(np.angle(raw.total()[np.arange(track.n_pulses), sample].astype(np.complex128)))
    cubic = np.polynomial.Polynomial.fit(track.time, phase, 4).convert().coef
    return float(cubic[1] / (2.0 * np.pi)), float(2.0 * cubic[2] / (2.0 * np.pi))


def orbit_doppler(quick: bool = False) -> Case:
    """Effective velocity, Doppler centroid and rate over latitudes."""
    latitudes = np.array([-50.0, 20.0]) if quick else np.array([-75.0, -50.0, -20.0, 0.0, 20.0, 50.0, 75.0])
    point = np.zeros(3)
    comparisons = []
    for m, mission in enumerate(MISSIONS):
        rows = []
        for i, latitude in enumerate(latitudes):
            scene = orbit_scene(
                mission, 100 * m + i, point, latitude_deg=float(latitude), n_pulses=_PULSES, prf=_PRF
            )
            closed = evaluate_expected(scene, mission, point)
            frequency, rate = measured_doppler(scene)
            wavelength, track = scene.radar.waveform.wavelength, scene.radar.track
            distance = float(np.linalg.norm(track.center_position))
            speed = np.sqrt(-0.5 * rate * wavelength * distance)
            # before steering: a point far out on a line square to the inertial velocity
            position, velocity = orbit_state(scene.radar)
            up = position / np.linalg.norm(position)
            left = np.cross(up, velocity) / np.linalg.norm(velocity)
            side = 1.0 if scene.radar.look_side == "left" else -1.0
            line = side * np.sin(closed.look_angle) * left - np.cos(closed.look_angle) * up
            here = track.position[track.center_index]
            turned = doppler_history(track, here + 1e6 * scene.radar.anchor.axes @ line, wavelength)
            rows.append(
                (
                    (closed.effective_velocity, speed),
                    (closed.doppler_rate, rate),
                    (0.0, frequency),
                    (closed.rotation_doppler, turned.frequency[track.center_index]),
                )
            )
        table = np.array(rows)
        names = (
            ("effective velocity", "m/s", 0.1, "float32 echoes: 1e-3 rad of phase over 0.25 s"),
            ("Doppler rate", "Hz/s", 0.1, "float32 echoes: 1e-3 rad of phase over 0.25 s"),
            ("Doppler centroid, zero-Doppler steering", "Hz", 0.1, "float32 echoes"),
            ("Doppler centroid before yaw steering", "Hz", 1e-3, "rounding"),
        )
        comparisons += [
            Comparison(
                f"{mission.name}, {name}", latitudes, table[:, k, 0], table[:, k, 1], tol, why, unit, shown=1
            )
            for k, (name, unit, tol, why) in enumerate(names)
        ]
    return Case(
        name="orbit_doppler",
        topic="orbits",
        title="Doppler of a point from a circular orbit about the rotating Earth",
        formula="V_eff^2 = n^2 s.p - 2 s'.(w x p) - s.(w x (w x p)); K = -2 V_eff^2 / (lambda R); "
        "f = +-(2 a w_E / lambda) sin(look) sin(i) cos(u)",
        source="Raney, Int. J. Remote Sensing 7 (1986), 1153; "
        "Cumming and Wong, Digital Processing of SAR Data (2005), 4.3",
        x_label="latitude of the scene (deg)",
        y_label="m/s, Hz/s, Hz",
        comparisons=tuple(comparisons),
        note="Rate and centroid are read from the phase of simulated echoes; passes, sides, longitudes and heights are "
        "drawn. The orbit's state comes from the solver, the closed form from orbital elements alone.",
    )


def pattern_width(antenna_length: float, wavelength: float) -> float:
    r"""Azimuth IRW of a uniform aperture's beam on a straight track, m.

    .. math:: h(x) = \int_{-\lambda/D}^{\lambda/D} \mathrm{sinc}^4(D s / \lambda) \cos(4 \pi s x / \lambda) ds
    """
    sine = np.linspace(-1.0, 1.0, 401) * wavelength / antenna_length
    weight = np.sinc(sine * antenna_length / wavelength) ** 4
    x = np.linspace(0.0, antenna_length, 1001)
    response = (np.cos(4.0 * np.pi / wavelength * np.outer(x, sine)) @ weight) / weight.sum()
    lobe = slice(int(np.argmax(response < 0.3)))
    return 2.0 * float(np.interp(-np.sqrt(0.5), -response[lobe], x[lobe]))


def orbit_points(quick: bool = False) -> Case:
    """Place and width of points under drawn passes, by automatic settings."""
    comparisons = []
    n_seeds = 1 if quick else 4
    for mode in ("spotlight", "stripmap"):
        place, width = [], []
        for m, mission in enumerate(MISSIONS[:2] if quick else MISSIONS):
            for seed in range(n_seeds):
                rng = np.random.default_rng([31, m, seed, len(mode)])
                point = np.array([*rng.uniform(-10.0, 10.0, 2), 0.0])
                squint = float(rng.uniform(-5.0, 5.0)) if seed % 2 or (quick and m == 1) else 0.0
                changes: dict[str, float | str] = {
                    "mode": mode,
                    "incidence_angle_deg": rng.uniform(20.0, 55.0),
                    "squint_angle_deg": squint,
                }
                extent, length = 80.0, mission.antenna_length
                if mode == "stripmap":
                    extent = 30.0 + 8.0 * length
                    changes |= {"pattern": "rectangular", "antenna_length": length, "antenna_height": 0.05}
                    changes["azimuth_resolution"] = 0.2 * length  # all of the main lobe
                else:
                    changes["azimuth_resolution"] = 3.0
                scene = orbit_scene(mission, 1000 + 100 * m + seed, point, extent, **changes)
                image = focus(
                    simulate(scene),
                    request=scene.image,
                    focuser="auto,error=-50",
                    range_window="rectangular",
                    azimuth_window="rectangular",
                )
                found = point_target_in(image)
                grid = image.grid
                line = point - grid.origin
                cell = image.azimuth_resolution_cell
                ground_cell = image.range_resolution_cell / np.sin(image.incidence_angle.mean())
                place.append(
                    np.hypot(
                        (found.azimuth_position - line @ grid.along) / cell,
                        (found.range_position - line @ grid.across) / ground_cell,
                    )
                )
                if squint == 0.0:
                    closed = evaluate_expected(scene, mission, point)
                    track, wavelength = scene.radar.track, scene.radar.waveform.wavelength
                    if mode == "stripmap":
                        slower = (closed.effective_velocity / closed.relative_speed) ** 2
                        law = pattern_width(length, wavelength) * slower
                    else:
                        flown = closed.relative_speed * track.n_pulses * float(np.diff(track.time).mean())
                        distance = float(np.linalg.norm(point - track.center_position))
                        law = _IRW * wavelength * distance / (2.0 * flown)
                    width.append((law, found.azimuth.irw))
        error = np.array(place)
        widths = np.array(width)
        comparisons += [
            Comparison(
                f"{mode}, place",
                np.arange(1.0, error.size + 1.0),
                np.zeros(error.size),
                error,
                0.02,
                "interpolation of the peak",
                "cells",
            ),
            Comparison(
                f"{mode}, azimuth IRW",
                np.arange(1.0, widths.shape[0] + 1.0),
                widths[:, 0],
                widths[:, 1],
                0.02,
                "the aperture is a whole number of pulses; interpolation of the lobe",
                "m",
            ),
        ]
    return Case(
        name="orbit_points",
        topic="orbits",
        title="Points under a circular orbit: place, and resolution on the ground",
        formula="spotlight: 0.886 lambda R / (2 V_s T); "
        "stripmap: the beam's own width (about D/2) times V_eff^2 / V_s^2",
        source="Cumming and Wong, Digital Processing of SAR Data (2005), 4.3 and 4.7; the beam by quadrature",
        x_label="geometry",
        y_label="cells, m",
        comparisons=tuple(comparisons),
        note="Drawn latitudes, passes, sides, heights, incidences of 20 to 55 deg, squints up to 5 deg (place only); "
        "automatic settings.",
    )


def orbit_squint(quick: bool = False) -> Case:
    """Doppler centroid of a squinted beam."""
    squints = np.array([-8.0, 5.0]) if quick else np.array([-12.0, -8.0, -3.0, 3.0, 5.0, 12.0])
    comparisons = []
    for m, mission in enumerate(MISSIONS):
        closed, simulated = [], []
        for i, squint in enumerate(squints):
            scene = orbit_scene(
                mission,
                2000 + 100 * m + i,
                np.zeros(3),
                squint_angle_deg=float(squint),
                mode="stripmap",
                pattern="rectangular",
                antenna_length=mission.antenna_length,
                antenna_height=0.1,
            )
            i_middle = scene.radar.track.center_index
            speed = evaluate_expected(scene, mission, np.zeros(3)).relative_speed
            closed.append(2.0 / scene.radar.waveform.wavelength * speed * np.sin(np.radians(squint)) / 1e3)
            simulated.append(beam_doppler(scene.radar)[i_middle] / 1e3)
        comparisons.append(
            Comparison(
                mission.name,
                squints,
                np.array(closed),
                np.array(simulated),
                1e-4,
                "the middle pulse is up to half an interval off mid-aperture",
                "kHz",
                shown=1,
            )
        )
    return Case(
        name="orbit_squint",
        topic="orbits",
        title="Doppler centroid of a squinted beam from orbit",
        formula="2 V_s sin(squint) / lambda, V_s relative to the turning Earth",
        source="Raney, Int. J. Remote Sensing 7 (1986), 1153",
        x_label="squint (deg)",
        y_label="Doppler centroid (kHz)",
        comparisons=tuple(comparisons),
        note="The antenna's axes follow the velocity over the turning Earth: a squint of 0 has no Doppler.",
    )


for _entry in (
    CaseEntry("orbit_doppler", "orbits", orbit_doppler),
    CaseEntry("orbit_squint", "orbits", orbit_squint),
    CaseEntry("orbit_points", "orbits", orbit_points),
):
    CASES.register(_entry)
