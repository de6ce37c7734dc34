"""Motion of the antenna within the pulse against the exact echo of one that moves, from orbit and for long chirps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.files import read_raw
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing.focuser import FOCUSERS
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.chain import bandwidth, make_scene
from sarmitsuba.view.page.quantised_profiles import page_profiles
from tests.support.draws import few_of
from tests.support.unweighted import focus, render

pytestmark = pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # few rays, odd pulse rates

LIGHT = 299792458.0
CARRIER = 9.65e9
F64 = np.ndarray[Any, np.dtype[np.float64]]

# from orbit, and a frequency-modulated continuous wave from a drone; each with the longest squint drawn, deg
RADARS: dict[str, tuple[dict[str, Any], float]] = {
    "orbit": ({"slant_range": 700e3, "speed": 7500.0, "bandwidth": 60e6, "pulse_width": 40e-6}, 1.0),
    "drone": ({"slant_range": 600.0, "speed": 15.0, "bandwidth": 150e6, "pulse_width": 1e-3}, 8.0),
}


def scene_of(kind: str, seed: int, mesh: Any = None, **changes: Any) -> Scene:
    """A point off the aim point, or a rough plate; any heading, side, incidence and squint."""
    rng = np.random.default_rng(seed)
    given, squint = RADARS[kind]
    settings = {"effects": {"motion_in_pulse": changes.pop("switch", "on")}} | changes.pop("settings", {})
    given = given | {
        "center_frequency": CARRIER,
        "look_angle_deg": float(rng.uniform(25.0, 55.0)),
        "heading_deg": float(rng.uniform(-180.0, 180.0)),
        "look_side": str(rng.choice(["left", "right"])),
        "squint_angle_deg": float(rng.uniform(-squint, squint)),
        "n_pulses": 5,
        "azimuth_resolution": 4.0,
        "image_extent_azimuth": 60.0,
        "image_extent_range": 60.0,
    }
    point = PointTarget("p", rng.uniform(-20.0, 20.0, 3), 3.0, phase=0.3)
    materials = () if mesh is None else (ROUGH,)
    points = (point,) if mesh is None else ()
    return make_scene(mesh, materials, given | changes, points=points, settings=TraceSettings(**settings))


ROUGH = Material(
    "rough", permittivity=5.0 - 0.5j, diffuse_law="constant", diffuse_level_db=-8.0, rms_height=0.01
)


def error_db(found: F64, exact: F64) -> float:
    return float(10.0 * np.log10(np.sum(np.abs(found - exact) ** 2) / np.sum(np.abs(exact) ** 2)))


@pytest.mark.parametrize("seed", few_of(range(3)))
@pytest.mark.parametrize("kind", RADARS)
def test_the_exact_echo_of_a_moving_antenna(kind: str, seed: int) -> None:
    """The delay equation solved at every instant, the chirp correlated with the one sent; raw data know no more."""
    scene = scene_of(kind, seed)
    radar, wave, point = scene.radar, scene.radar.waveform, scene.points[0]
    raw = simulate(scene)
    still = simulate(scene_of(kind, seed, switch="off"))
    found, exact, without = [], [], []
    for t, (x, v) in enumerate(zip(radar.track.position, radar.track.velocity, strict=True)):
        r = radar.window.start_range[t] + np.arange(radar.window.n_samples) * radar.window.sample_spacing
        distance = float(np.linalg.norm(point.position - x))
        near = np.abs(r - distance) < 5.0 * wave.range_cell
        echo = theory.moving_echo(
            x,
            v,
            point.position,
            2.0 * r[near] / LIGHT,
            center_frequency=CARRIER,
            bandwidth=wave.bandwidth,
            pulse_width=wave.pulse_width,
        )
        exact.append(echo * radar.amplitude_constant * np.sqrt(3.0) * np.exp(0.3j) / distance**2)
        found.append(raw.data[0, t, near])
        without.append(still.data[0, t, near])
    # tol: the chirp is stretched by 2 v sin(squint) / c, its band shifted; ripples of a chirp of finite length
    assert error_db(np.concatenate(found), np.concatenate(exact)) < -44.0
    turn = np.angle(np.vdot(np.concatenate(exact), np.concatenate(found)))
    # tol: pi B T_p of the stretch at the chirp's ends, a third of it in the mean
    assert abs(turn) < 5e-3
    # what it is for: without it the echo is elsewhere
    assert error_db(np.concatenate(without), np.concatenate(exact)) > -28.0


@pytest.mark.parametrize("method", ["raw", "hybrid"])
@pytest.mark.parametrize("kind", RADARS)
def test_every_path_of_a_mesh(kind: str, method: str) -> None:
    """Both adders against the definition, path by path."""
    changes = {
        "n_pulses": 24,
        "azimuth_resolution": 8.0,
        "image_extent_azimuth": 90.0,
        "image_extent_range": 90.0,
    }
    scene = scene_of(
        kind,
        1,
        targets.plate(20.0, 20.0),
        settings={
            "method": method,
            "max_depth": 1,
            "ray_spacing": 1.0,
            "scatterer_cell": 2.0,
            "key_pulse_interval": 0 if method == "raw" else 24,
            "effects": {"motion_in_pulse": "on", "coherent": "off"},
        },
        **changes,
    )
    raw = simulate(scene)
    radar, wave = raw.radar, scene.radar.waveform
    assert radar.delay is not None and radar.receiver is not None
    kappa = CARRIER * wave.pulse_width / wave.bandwidth
    pulses = [0, 11, 23]
    exact = np.zeros((3, radar.window.n_samples), dtype=complex)
    for row, pulse in enumerate(pulses):
        paths = trace_paths(scene, pulse)
        r, rate = paths.slant_range, paths.range_rate
        place = r + kappa * rate
        way = r + rate / LIGHT * (place - 0.5 * LIGHT * radar.delay[pulse])
        value = np.abs(paths.amplitude[:, 0]) * np.exp(1j * np.angle(paths.amplitude[:, 0]))
        value = value * np.exp(-4j * np.pi * CARRIER / LIGHT * (way - r))
        samples = radar.window.start_range[pulse] + np.arange(exact.shape[1]) * radar.window.sample_spacing
        exact[row] = np.sinc((samples[:, None] - place) / wave.range_cell) @ value
    # tol: gridding kernels four cells wide
    assert error_db(raw.data[0, pulses], exact) < -48.0


def focused(raw: RawData, scene: Scene, **changes: Any) -> tuple[float, float, float]:
    """Errors of the point's place along and across the track, m, and of its phase, rad."""
    point = scene.points[0]
    known = KnownPoint((float(point.position[0]), float(point.position[1]), 0.0), "p", 3.0, 0.3)
    (found,) = image_quality(focus(raw, request=scene.image, **changes), [known], []).points
    return found.azimuth_error, found.range_error, found.phase_error


def flown(kind: str, **changes: Any) -> Scene:
    given = {"n_pulses": 0, "squint_angle_deg": 0.0, "azimuth_resolution": 3.0} | changes
    scene = scene_of(kind, 2, **given)
    point = replace(scene.points[0], position=scene.points[0].position * [1.0, 1.0, 0.0])
    return replace(scene, points=(point,))


def test_from_orbit_the_focusers_know() -> None:
    scene = flown("orbit")
    raw = simulate(scene)
    for name in ("backprojection", "omega_k"):
        along, across, turn = focused(raw, scene, focuser=name)
        # tol: a thousandth of a cell
        assert abs(along) < 4e-3 and abs(across) < 4e-3
        # tol: the interpolated peak; halfway is too near by b^2 / 8 R, which were 0.089 rad
        assert abs(turn) < 2e-3
    # the sum over both places, pixel by pixel; tol: the shift by Doppler moves the profiles by up to 0.06 of a cell
    place = scene.points[0].position[None]
    image = np.sqrt(3.0) * np.exp(0.3j)
    assert abs(backproject(raw, place)[0, 0] / image - 1.0) < 5e-3
    assert not any("apart" in one.objection(raw.radar, default_grid(raw)) for one in FOCUSERS)


def test_who_takes_the_place_of_transmission_is_behind() -> None:
    scene = flown("orbit")
    raw = simulate(scene)
    blind = replace(raw, radar=replace(raw.radar, receiver=None, delay=None))
    image = focus(blind, request={"extent_azimuth": 90.0})
    row = int(np.argmax(np.abs(image.total()).max(axis=1)))
    along = scene.radar.track.along
    shift = (image.grid.positions_on_line(row)[0] - scene.points[0].position) @ along
    # tol: a pixel, half a cell of 3 m; the range of the point itself
    assert shift == pytest.approx(theory.start_stop_azimuth_shift(7500.0, 700e3), abs=1.5)


@pytest.mark.parametrize("squint", [-8.0, 8.0])
def test_a_long_chirp_seen_squinted(squint: float) -> None:
    """Whoever does not know sees the point aside along the line of sight, whose direction the Doppler keeps."""
    scene = flown("drone", squint_angle_deg=squint)
    wave = scene.radar.waveform
    line = scene.points[0].position - scene.radar.track.center_position
    sine = float(line @ scene.radar.track.along / np.linalg.norm(line))
    shift = theory.chirp_range_shift(-15.0 * sine, CARRIER, wave.bandwidth, wave.pulse_width)
    assert abs(shift) > 0.1
    raw = simulate(scene)
    along, across, turn = focused(raw, scene)
    # tol: a hundredth of the range cell of 1 m: what the point's direction differs from the boresight's by
    assert abs(along) < 0.01 and abs(across) < 0.01 and abs(turn) < 5e-3
    along, across, _ = focused(replace(raw, radar=replace(raw.radar, receiver=None, delay=None)), scene)
    # tol: the same; the sine changes over the aperture by a tenth of itself
    assert along == pytest.approx(shift * sine, abs=0.01)
    assert across == pytest.approx(shift * np.sqrt(1.0 - sine**2), abs=0.01)


def test_it_is_on_where_it_matters() -> None:
    """Automatic: on from orbit and for long chirps, off for pulses from the air; explained in metres."""
    air = {"slant_range": 5e3, "speed": 100.0, "bandwidth": bandwidth(0.5), "pulse_width": 2e-6}
    for kind, changes, on in (
        ("orbit", {}, True),
        ("drone", {"squint_angle_deg": 8.0}, True),
        ("drone", air, False),
    ):
        scene = scene_of(kind, 0, switch="auto", **changes)
        raw = simulate(scene)
        effect = raw.metadata["effects"]["effects"]["motion_in_pulse"]
        assert effect["on"] is on and "shifted by up to" in effect["why"]
        assert (effect["error_db"] > -40.0) is on
        assert (raw.radar.delay is not None) is on and (raw.radar.receiver is not None) is on


def test_the_page_takes_the_antenna_halfway() -> None:
    raw = simulate(scene_of("orbit", 0))
    grid = default_grid(raw)
    found, still = page_profiles(raw, grid), raw.radar.start_stop()
    middle = 0.5 * (raw.radar.track.position + raw.radar.tracks[1].position)
    np.testing.assert_allclose(
        found.antenna, page_profiles(replace(raw, radar=still), grid).antenna, atol=0.0
    )
    # tol: float64 at 700 km
    np.testing.assert_allclose(still.track.position, middle, atol=1e-9)


def test_files_keep_it(tmp_path: Any) -> None:
    raw = simulate(scene_of("orbit", 0))
    raw.save(tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5").radar
    assert again.receiver is not None and raw.radar.receiver is not None
    assert again.delay is not None and raw.radar.delay is not None
    np.testing.assert_array_equal(again.delay, raw.radar.delay)
    np.testing.assert_array_equal(again.receiver.position, raw.radar.receiver.position)
    assert again.receives_itself and again.of_pulses(slice(1, 4)).delay is not None


def test_a_follower_moves_on_too() -> None:
    """Two antennas: the receiver is where it is when the echo arrives; neither stands for both."""
    scene = scene_of("orbit", 1, receiver_offset_along=-300.0, receiver_offset_across=100.0)
    before = scene.radar.receiver
    radar = simulate(scene).radar
    assert before is not None and radar.receiver is not None and radar.delay is not None
    moved = np.linalg.norm(radar.receiver.position - before.position, axis=1)
    # tol: the delay is that of the way over the aim point
    np.testing.assert_allclose(moved, 7500.0 * 2.0 * 700e3 / LIGHT, rtol=1e-3)
    assert not radar.receives_itself and radar.start_stop().receiver is radar.receiver
    with pytest.raises(DataError, match="page: bistatic data are not focused"):
        page_profiles(simulate(scene), focus_grid(scene))
    others = [one.name for one in FOCUSERS if not one.bistatic]
    assert others and all(
        "bistatic" in one.objection(radar, focus_grid(scene)) for one in FOCUSERS if not one.bistatic
    )


def focus_grid(scene: Scene) -> Any:
    return default_grid(scene.radar, scene.image)


def test_one_look_has_no_motion() -> None:
    scene = scene_of(
        "orbit", 1, targets.plate(20.0, 20.0), switch="auto", n_pulses=24, azimuth_resolution=8.0
    )
    image = render(scene, method="image")
    assert image.metadata["effects"]["effects"]["motion_in_pulse"]["on"] is False
    with pytest.raises(RadarError, match="take method hybrid or raw"):
        render(
            replace(scene, settings=replace(scene.settings, effects={"motion_in_pulse": "on"})),
            method="image",
        )


@pytest.mark.parametrize(
    ("turn", "slant_range"),
    [(5.0, 7.5e3), *(pytest.param(a, 700e3, marks=pytest.mark.slow) for a in (3, 12))],
)
def test_corners_of_unlike_facets_are_those_of_an_antenna_that_stands_still(
    turn: float, slant_range: float
) -> None:
    """Both chains of a corner share their return, whoever receives, the antenna itself a little later or one apart."""
    box = trimesh.creation.box((4.0, 6.0, 6.0), trimesh.transformations.translation_matrix([0.0, 0.0, 3.0]))
    box.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn), [0.0, 0.0, 1.0]))
    half = 18.0
    ground = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    meshes = [SceneMesh(ground, [[0, 1, 2], [0, 2, 3]], "pec", "ground"), SceneMesh.of(box, "pec", "box")]
    radar = RadarDescription(
        slant_range=slant_range,
        look_angle_deg=45.0,
        center_frequency=5.4e9,
        bandwidth=90e6,
        azimuth_resolution=1.5,
        speed=7500.0 if slant_range > 1e5 else 100.0,
        n_pulses=9,
    )
    film = FilmDescription(image_extent_azimuth=20.0, image_extent_range=20.0)
    scene = build_scene(meshes, radar=radar, film=film).replace(method="raw", motion_in_pulse="off")
    still = simulate(scene, seed=1).data
    moving = simulate(scene.replace(motion_in_pulse="on"), seed=1).data
    apart = simulate(scene.replace(receiver_offset_along=0.01), seed=1).data
    for other in (moving, apart):
        # tol: the antenna is 35 m farther on when echoes arrive from orbit, and sees the corner from there
        assert np.linalg.norm(other) == pytest.approx(np.linalg.norm(still), rel=0.02)
    if slant_range < 1e5:  # from orbit echoes turn in phase from pulse to pulse
        moving = moving * np.exp(-1j * np.angle(np.vdot(still, moving)))
        for other in (moving, apart):
            assert np.linalg.norm(other - still) < 0.01 * np.linalg.norm(still)  # tol: another aspect, -44 dB


def test_a_corner_returns_what_it_does_to_an_antenna_at_rest() -> None:
    """15 m/s for 4 us move nothing by a part of a wavelength: wall and ground keep their return."""
    given = RADARS["drone"][0] | {
        "center_frequency": CARRIER,
        "look_angle_deg": 40.0,
        "pulse_width": 1e-6,
        "n_pulses": 5,
        "azimuth_resolution": 4.0,
        "image_extent_azimuth": 40.0,
        "image_extent_range": 40.0,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
        "heading_deg": 90.0,
        "look_side": "right",
    }
    echoes = [
        simulate(
            make_scene(
                targets.wall_and_ground(4.0, 4.0, 4.0),
                (Material("pec", pec=True),) * 2,
                given,
                settings=TraceSettings(
                    effects={"motion_in_pulse": switch}, max_depth=2, key_pulse_interval=1
                ),
            )
        ).data
        for switch in ("on", "off")
    ]
    # tol: float32 directions of a receiver of its own; without the share of a corner's two facets -42 dB
    assert error_db(echoes[0], echoes[1]) < -75.0
