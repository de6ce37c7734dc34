"""Orbits: what was asked for is what flies, state vectors give the same path, and contradictions are one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.errors import RadarError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.orbit import OrbitRequest, StateVectors, circular_orbit
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from tests.support.unweighted import focus

EARTH = np.array([0.0, 0.0, 7.292115e-5])
RADIUS = 6378137.0


def drawn(seed: int) -> tuple[OrbitRequest, Anchor, np.ndarray]:
    rng = np.random.default_rng([5, seed])
    inclination = float(np.radians(rng.choice([97.4, 98.2, 66.0, 90.0, 35.0])))
    reach = 0.85 * min(inclination, np.pi - inclination)
    wanted = OrbitRequest(
        altitude=rng.uniform(4e5, 9e5),
        inclination=inclination,
        incidence_angle=float(np.radians(rng.uniform(18.0, 60.0))),
        squint_angle=float(np.radians(rng.choice([0.0, rng.uniform(-10.0, 10.0)]))),
        ascending=bool(rng.integers(2)),
        look_side=("left", "right")[rng.integers(2)],
    )
    anchor = Anchor(float(rng.uniform(-reach, reach)), float(rng.uniform(-np.pi, np.pi)), 250.0)
    return wanted, anchor, rng.uniform(-2e3, 2e3, 3)


@pytest.mark.parametrize("seed", range(40))
def test_the_orbit_sees_the_aim_point_as_asked(seed: int) -> None:
    wanted, anchor, aim = drawn(seed)
    path = circular_orbit(wanted, anchor, aim)
    time = np.array([-0.5, 0.0, 0.5])
    position, velocity = path.states(time)
    line = aim - position[1]
    distance = np.linalg.norm(line)
    # tol: rounding of a root in float64
    assert np.arccos(-line[2] / distance) == pytest.approx(wanted.incidence_angle, abs=1e-9)
    squint = np.arcsin(line @ velocity[1] / distance / np.linalg.norm(velocity[1]))
    assert squint == pytest.approx(wanted.squint_angle, abs=1e-9)
    flown_right = np.cross(velocity[1], [0.0, 0.0, 1.0]) @ line > 0.0
    assert flown_right == (wanted.look_side == "right")
    # a Keplerian circle in inertial axes, of the inclination, northbound or southbound
    fixed = anchor.to_ecef(position)
    inertial = velocity @ anchor.axes + np.cross(EARTH, fixed)
    assert np.linalg.norm(fixed, axis=1) == pytest.approx(RADIUS + wanted.altitude, abs=1e-6)
    assert np.linalg.norm(inertial, axis=1) == pytest.approx(theory.orbital_speed(wanted.radius), abs=1e-6)
    normal = np.cross(fixed[1], inertial[1])
    assert np.arccos(normal[2] / np.linalg.norm(normal)) == pytest.approx(wanted.inclination, abs=1e-8)
    assert (inertial[1, 2] > 0.0) == wanted.ascending
    # the velocity is the change of the position
    h = 0.01
    near, _ = path.states(np.array([-h, h]))
    assert np.abs((near[1] - near[0]) / (2.0 * h) - velocity[1]).max() < 1e-6  # tol: h^2 / 6 of the jerk


def test_an_orbit_that_never_sees_the_scene_is_one_line() -> None:
    wanted, _, aim = drawn(0)
    low = replace(wanted, inclination=np.radians(35.0))
    with pytest.raises(
        RadarError, match=r"orbit_inclination_deg = 35 deg .*latitude 59.98 deg .*within 35 deg"
    ):
        circular_orbit(low, Anchor.of_degrees(60.0, 10.0), aim)


def radar(**changes: float | str) -> RadarDescription:
    given = RadarDescription(
        mode="spotlight",
        orbit_altitude=514e3,
        orbit_inclination_deg=97.44,
        orbit_pass="descending",
        incidence_angle_deg=33.0,
        latitude_deg=-33.4,
        longitude_deg=-70.6,
        height=540.0,
        azimuth_resolution=3.0,
        bandwidth=60e6,
    )
    return replace(given, **changes)  # type: ignore[arg-type]


POINT = np.array([21.0, -13.0, 4.0])
FILM = FilmDescription(
    image_grid="ground",
    image_extent_azimuth=90.0,
    image_extent_range=110.0,
    image_center_x=0.0,
    image_center_y=0.0,
    image_height=4.0,
)


def scene_of(description: RadarDescription) -> Scene:
    return build_scene(points=[PointTarget("point", POINT, 1.0)], radar=description, film=FILM)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"slant_range": 7e5}, "slant_range has no effect beside orbit_altitude"),
        ({"speed": 7600.0}, "speed has no effect beside orbit_altitude"),
        ({"orbit_altitude": 0.0, "orbit_pass": "descending"}, "has no effect alone; give orbit_altitude"),
        ({"mode": "circular", "azimuth_resolution": 0.0}, "mode = circular, which flies a path of its own"),
        (
            {"track_file": "track.csv", "azimuth_resolution": 0.0},
            "orbit_altitude has no effect beside track_file",
        ),
        (
            {
                "track_file": "track.csv",
                "azimuth_resolution": 0.0,
                "orbit_altitude": 0.0,
                "orbit_inclination_deg": 97.5,
            },
            "orbit_pass has no effect beside track_file",
        ),
        ({"state_vectors_file": "vectors.csv"}, "orbit_altitude has no effect beside state_vectors_file"),
        ({"latitude_deg": 86.0}, "no descending pass with orbit_inclination_deg = 97.44 deg"),
    ],
)
def test_contradictions_are_one_line(changes: dict[str, float | str], text: str) -> None:
    with pytest.raises(RadarError, match=text) as caught:
        scene_of(radar(**changes))
    assert "\n" not in str(caught.value)


def test_chain_keeps_the_phase_from_orbit() -> None:
    """The focused point has its own RCS and phase: nothing of 600 km of range is lost on the way."""
    raw = simulate(scene_of(radar(squint_angle_deg=3.0)))
    value = complex(backproject(raw, POINT[None])[0, 0])
    # tol: gridding at width 4 (-40 dB), interpolation of the profile
    assert abs(value) == pytest.approx(1.0, abs=0.01)
    assert abs(np.angle(value)) < 0.01


@pytest.mark.parametrize("focuser", ["range_doppler", "factorised", "polar_format"])
def test_other_focusers_find_the_point_from_orbit(focuser: str) -> None:
    image = focus(simulate(scene_of(radar())), focuser=focuser)
    found = point_target_in(image)
    line = POINT - image.grid.origin
    miss = np.array(
        [found.azimuth_position - line @ image.grid.along, found.range_position - line @ image.grid.across]
    )
    assert np.abs(miss).max() < 0.1 * image.range_resolution_cell  # tol: the tenth of a cell


STRIPMAP = radar(
    mode="stripmap",
    azimuth_resolution=0.0,
    bandwidth=20e6,
    pattern="rectangular",
    antenna_length=12.0,
    antenna_height=0.7,
)


def test_the_footprint_is_slower_than_the_satellite() -> None:
    """By V_eff^2 / V_s^2, which makes the ground resolution of a beam finer than half its antenna."""
    built = scene_of(STRIPMAP).radar
    i = built.track.center_index
    position = built.anchor.to_ecef(built.track.position[i])
    # no latitude in it: the closed form from the satellite's geocentric latitude alone
    argument = np.pi - np.arcsin(position[2] / np.linalg.norm(position) / np.sin(np.radians(97.44)))
    place = built.anchor.to_ecef(built.aim_point)
    closed = theory.circular_orbit_doppler(
        RADIUS + 514e3,
        float(np.radians(97.44)),
        float(argument),
        float(np.linalg.norm(place - position)),
        float(np.linalg.norm(place)),
        -1.0,
        built.waveform.wavelength,
    )
    expected = (closed.effective_velocity / closed.relative_speed) ** 2
    # tol: differences over two pulses; the middle pulse is not at mid-aperture
    assert built.footprint_speed == pytest.approx(expected, rel=1e-6)
    assert 0.85 < expected < 0.95


def test_every_row_has_its_whole_aperture() -> None:
    film = replace(FILM, image_extent_azimuth=4000.0, image_extent_range=1000.0)
    built = build_scene(points=[PointTarget("point", POINT, 1.0)], radar=STRIPMAP, film=film).radar
    ends = built.aim_point + np.array([[-2000.0], [0.0], [2000.0]]) * built.track.along
    total = matched_weights(built, ends).sum(axis=1)
    assert total == pytest.approx(total[1], rel=0.002)  # tol: slant range differs by 3e-4 over the rows
    # and no more track than that takes: both ends are used
    used = matched_weights(built, ends) > 0.0
    assert used[0, :4].any() and used[2, -4:].any()


def test_frequency_domain_takes_a_beam_that_turns_with_the_orbit() -> None:
    scene = scene_of(STRIPMAP)
    raw = simulate(scene)
    exact = focus(raw, default_grid(raw), focuser="backprojection")
    image = focus(raw, default_grid(raw), focuser="omega_k")
    error = np.linalg.norm(image.data - exact.data) / np.linalg.norm(exact.data)
    assert 20.0 * np.log10(error) < -45.0


def kepler(time: np.ndarray, radius: float = RADIUS + 514e3) -> np.ndarray:
    """Earth-fixed position and velocity of a circular orbit, (n, 6), written down anew."""
    rate = np.sqrt(3.986004418e14 / radius**3)
    inclination, start = np.radians(97.44), 0.4
    u = start + rate * time
    out = np.array([np.cos(u), np.sin(u) * np.cos(inclination), np.sin(u) * np.sin(inclination)])
    ahead = np.array([-np.sin(u), np.cos(u) * np.cos(inclination), np.cos(u) * np.sin(inclination)])
    turn = EARTH[2] * time
    east = (
        np.array([np.cos(turn), -np.sin(turn), 0.0 * turn]),
        np.array([np.sin(turn), np.cos(turn), 0.0 * turn]),
    )

    def fixed(v: np.ndarray) -> np.ndarray:
        return np.array([east[1][1] * v[0] + east[1][0] * v[1], east[0][1] * v[0] + east[0][0] * v[1], v[2]])

    position = radius * fixed(out)
    velocity = radius * rate * fixed(ahead)
    velocity -= EARTH[2] * np.array([-position[1], position[0], 0.0 * turn])
    return np.concatenate([position, velocity]).T


@pytest.mark.parametrize("spacing", [10.0, 60.0, 120.0])
def test_interpolated_vectors_keep_to_the_stated_error(spacing: float) -> None:
    time = np.arange(-5.0, 6.0) * spacing
    known = kepler(time)
    vectors = StateVectors(time, known[:, :3], known[:, 3:])
    fine = np.linspace(time[0], time[-1], 1001)
    position, velocity = vectors.at(fine)
    true = kepler(fine)
    error = np.linalg.norm(position - true[:, :3], axis=1)
    radius = RADIUS + 514e3
    # Earth-fixed: the eighth derivative turns with the Earth too, 7 % faster
    rate = np.sqrt(3.986004418e14 / radius**3) + EARTH[2]
    stated = radius * (rate * spacing) ** 8 / 40320.0
    inside = np.abs(fine) < 4.0 * spacing
    # tol: rounding of positions of 7e6 m
    assert error[inside].max() < stated * (9.0 / 16.0) ** 2 + 1e-8
    assert error.max() < stated + 1e-8
    if spacing == 120.0:  # the bound is no empty one
        assert error[inside].max() > 0.2 * stated * (9.0 / 16.0) ** 2
    assert np.abs(velocity - true[:, 3:]).max() < 10.0 * stated / spacing + 1e-8


def written(path: Path, time: np.ndarray, rows: np.ndarray, utc: bool = False) -> Path:
    stamps = [
        str(np.datetime64("2024-05-01T06:00:00", "ns") + np.timedelta64(round(t * 1e9), "ns")) + "Z"
        if utc
        else f"{t:.9f}"
        for t in time
    ]
    lines = ["time, x, y, z, vx, vy, vz", "# made by the test"]
    lines += [
        f"{stamp}, " + ", ".join(f"{v:.9f}" for v in row) for stamp, row in zip(stamps, rows, strict=True)
    ]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("utc", [False, True])
@pytest.mark.parametrize("squint", [0.0, 4.0])
def test_state_vectors_fly_the_orbit_that_they_sample(tmp_path: Path, utc: bool, squint: float) -> None:
    """An orbit sampled every 30 s in ECEF gives the track that the orbit's own parameters give."""
    description = radar(squint_angle_deg=squint)
    orbit = scene_of(description).radar
    path = circular_orbit(
        OrbitRequest(514e3, np.radians(97.44), np.radians(33.0), np.radians(squint), ascending=False),
        orbit.anchor,
        orbit.aim_point,
    )
    time = np.arange(-6.0, 7.0) * 30.0 + 7.3
    position, velocity = path.states(time)
    rows = np.concatenate([orbit.anchor.to_ecef(position), velocity @ orbit.anchor.axes], axis=1)
    name = str(written(tmp_path / "vectors.csv", time, rows, utc))
    blank = {
        "orbit_altitude": 0.0,
        "orbit_inclination_deg": 97.5,
        "orbit_pass": "ascending",
        "incidence_angle_deg": 35.0,
    }
    other = scene_of(replace(description, state_vectors_file=name, **blank)).radar
    assert other.track.n_pulses == orbit.track.n_pulses
    # tol: the file's nanometres, the root's 1e-12 s; 1e-8 s of UTC stamps at 7.6 km/s
    assert np.abs(other.track.position - orbit.track.position).max() < 1e-4
    assert other.look_side == orbit.look_side == "right"


def test_an_orbit_file_of_sentinel_1_is_read(tmp_path: Path) -> None:
    time = np.arange(-4.0, 5.0) * 10.0
    rows = kepler(time)
    start = np.datetime64("2024-05-01T06:00:00", "ns")
    items = []
    for t, row in zip(time, rows, strict=True):
        tags = "".join(
            f'<{tag} unit="m">{v:.9f}</{tag}>'
            for tag, v in zip(("X", "Y", "Z", "VX", "VY", "VZ"), row, strict=True)
        )
        items.append(f"<OSV><UTC>UTC={start + np.timedelta64(round(t * 1e9), 'ns')}</UTC>{tags}</OSV>")
    head = "<Earth_Explorer_File><Data_Block><Ref_Frame>EARTH_FIXED</Ref_Frame><List_of_OSVs>"
    text = f"{head}{''.join(items)}</List_of_OSVs></Data_Block></Earth_Explorer_File>"
    path = tmp_path / "S1A_OPER_AUX_POEORB.EOF"
    path.write_text(text)
    vectors = StateVectors.read(path)
    assert np.abs(vectors.time - (time + 40.0)).max() < 1e-9
    assert np.abs(np.concatenate([vectors.position, vectors.velocity], axis=1) - rows).max() < 1e-8
    for damage, message in (
        (("EARTH_FIXED", "EARTH_INERTIAL"), "the reference frame is EARTH_INERTIAL"),
        (("<VZ", "<VW"), "mismatched tag"),
        (("UTC=2024", "UTC=x"), "every OSV needs UTC"),
    ):
        path.write_text(text.replace(*damage))
        with pytest.raises(RadarError, match=message):
            StateVectors.read(path)


def test_doubtful_vectors_are_one_line(tmp_path: Path) -> None:
    time = np.arange(-3.0, 4.0) * 30.0
    known = kepler(time)
    inertial = known.copy()
    inertial[:, 3:] += np.cross(EARTH, known[:, :3])
    cases = {
        "relative to the turning Earth": inertial,
        "inside the Earth": known * 1e-3,
        "finite": np.where(np.arange(6) == 2, np.nan, known),
    }
    for text, rows in cases.items():
        with pytest.raises(RadarError, match=text):
            StateVectors(time, rows[:, :3], rows[:, 3:])
    good = StateVectors(time, known[:, :3], known[:, 3:], "vectors.csv")
    with pytest.raises(
        RadarError, match=r"vectors.csv: the state vectors span -90 to 90 s, and the track needs"
    ):
        good.at(np.array([0.0, 91.0]))
    # under a point on the other side of the Earth
    with pytest.raises(RadarError, match="never has the aim point in its zero-Doppler plane"):
        good.path_over(Anchor.of_degrees(-40.0, 150.0), np.zeros(3), np.zeros(3))
    short = tmp_path / "short.csv"
    short.write_text("0, 1, 2, 3\n")
    with pytest.raises(RadarError, match="seven columns"):
        StateVectors.from_csv(short)
    with pytest.raises(RadarError, match="cannot read the state vectors"):
        StateVectors.from_csv(tmp_path / "none.csv")
