"""A receiver apart from the transmitter, simulated: points, facets, corners, rough scenes, at drawn baselines."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.errors import RadarError
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.path_table import KINDS, trace_paths
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.chain import bandwidth, make_scene
from tests.support.draws import few_of
from tests.support.unweighted import focus, render

pytestmark = pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # few rays, on purpose

LIGHT = 299792458.0
CARRIER = 9.65e9
LAMBDA = LIGHT / CARRIER
F64 = np.ndarray[Any, np.dtype[np.float64]]


def drawn(rng: np.random.Generator, baseline: float, **changes: Any) -> dict[str, Any]:
    """Any heading, side and incidence, and a baseline of so many metres in any direction."""
    b = rng.normal(size=3)
    b *= baseline / np.linalg.norm(b)
    return {
        "slant_range": float(rng.uniform(2e3, 8e3)),
        "look_angle_deg": float(rng.uniform(25.0, 60.0)),
        "heading_deg": float(rng.uniform(-180.0, 180.0)),
        "look_side": str(rng.choice(["left", "right"])),
        "squint_angle_deg": float(rng.uniform(-8.0, 8.0)),
        "n_pulses": 9,
        "azimuth_resolution": 0.5,
        "bandwidth": bandwidth(0.5),
        "center_frequency": CARRIER,
        "image_extent_azimuth": 12.0,
        "image_extent_range": 12.0,
        "receiver_offset_along": float(b[0]),
        "receiver_offset_across": float(b[1]),
        "receiver_offset_up": float(b[2]),
    } | changes


def antennas(parameters: dict[str, Any], scene: Scene) -> tuple[F64, F64]:
    """Places of both, the receiver's by the definition of its parameters."""
    heading = np.radians(parameters["heading_deg"])
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    right = np.array([np.cos(heading), -np.sin(heading), 0.0])
    b = [parameters[f"receiver_offset_{axis}"] for axis in ("along", "across", "up")]
    sent = scene.radar.track.position
    return sent, sent + b[0] * along + b[1] * right + b[2] * np.array([0.0, 0.0, 1.0])


def profiles(scene: Scene, slant_range: F64, amplitude: F64) -> F64:
    """Range-compressed echoes (n_pulses, n_samples) of returns (n_pulses, n) without the radar's constant."""
    window, cell = scene.radar.window, scene.radar.waveform.range_cell
    r = window.start_range[:, None] + np.arange(window.n_samples) * window.sample_spacing
    out = np.zeros(r.shape, dtype=complex)
    for one, value in zip(slant_range.T, amplitude.T, strict=True):
        out += value[:, None] * np.sinc((r - one[:, None]) / cell)
    return np.asarray(out * scene.radar.amplitude_constant)


def error_db(found: F64, exact: F64) -> float:
    return float(10.0 * np.log10(np.sum(np.abs(found - exact) ** 2) / np.sum(np.abs(exact) ** 2)))


@pytest.mark.parametrize("seed", few_of(range(4), 2))
def test_ideal_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = drawn(rng, 10.0 ** rng.uniform(-1.0, 2.5))
    point = PointTarget("p", rng.uniform(-4.0, 4.0, 3), 5.0, phase=0.7)
    scene = make_scene(None, (), given, points=(point,))
    sent, received = antennas(given, scene)
    assert scene.radar.receiver is not None
    # tol: rounding of axes made from sines and cosines
    np.testing.assert_allclose(scene.radar.receiver.position, received, atol=1e-9)
    r = theory.bistatic_range(sent, point.position, received)
    spread = np.linalg.norm(point.position - sent, axis=1) * np.linalg.norm(point.position - received, axis=1)
    amplitude = np.sqrt(5.0) * np.exp(0.7j) / spread * np.exp(-4j * np.pi / LAMBDA * r)
    exact = profiles(scene, r[:, None], amplitude[:, None])
    raw = simulate(scene)
    # tol: complex64
    np.testing.assert_allclose(raw.data[0], exact, atol=3e-7 * np.abs(exact).max())
    peak = np.argmax(np.abs(exact), axis=1)
    turn = np.angle(raw.data[0][np.arange(9), peak] / exact[np.arange(9), peak])
    # tol: complex64
    assert np.abs(turn).max() < 1e-6


def facets(mesh: Geometry, least: float) -> tuple[F64, F64, F64]:
    """Middles, normals and areas of triangles, each cut into equal ones of edges below ``least``."""
    middles, normals, areas = [], [], []
    for face in mesh.faces:
        a, b, c = mesh.vertices[face]
        n = int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a), np.linalg.norm(c - b)) / least))
        i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        up, down = i + j < n, i + j < n - 1
        s = np.concatenate([(i[up] + 1 / 3) / n, (i[down] + 2 / 3) / n])
        t = np.concatenate([(j[up] + 1 / 3) / n, (j[down] + 2 / 3) / n])
        normal = np.cross(b - a, c - a)
        size = float(np.linalg.norm(normal))
        middles.append(a + s[:, None] * (b - a) + t[:, None] * (c - a))
        normals.append(np.tile(normal / size, (s.size, 1)))
        areas.append(np.full(s.size, 0.5 * size / n**2))
    return np.concatenate(middles), np.concatenate(normals), np.concatenate(areas)


def brute_force(scene: Scene, given: dict[str, Any], channel: str) -> F64:
    """Sum over facets, every pulse and every facet with its own path."""
    middles, normals, areas = facets(scene.geometry, 0.25 * LAMBDA)
    cell, window = scene.radar.waveform.range_cell, scene.radar.window
    out = np.zeros((scene.radar.track.n_pulses, window.n_samples), dtype=complex)
    for t, (sent, received) in enumerate(zip(*antennas(given, scene), strict=True)):
        value = theory.bistatic_po(middles, normals, areas, sent, received, LAMBDA, channel)
        r = theory.bistatic_range(sent, middles, received)
        samples = window.start_range[t] + np.arange(window.n_samples) * window.sample_spacing
        out[t] = [np.sum(value * np.sinc((sample - r) / cell)) for sample in samples]
    return np.asarray(out * scene.radar.amplitude_constant)


@pytest.mark.parametrize(
    ("shape", "seed"),
    [
        ("plate", 0),
        ("sphere", 0),
        *(
            pytest.param(shape, seed, marks=pytest.mark.slow)
            for shape in ("plate", "sphere")
            for seed in (1, 2)
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_conducting_bodies_against_a_sum_over_facets(shape: str, seed: int) -> None:
    """Phase and amplitude of physical optics; baselines up to a fifth of the range."""
    rng = np.random.default_rng(seed)
    distance = float(rng.uniform(500.0, 900.0))
    given = drawn(
        rng,
        distance * 10.0 ** rng.uniform(-3.0, -0.7),
        slant_range=distance,
        n_pulses=3,
        polarisation="VV,HH",
    )
    mesh = targets.plate(0.9, 0.6) if shape == "plate" else targets.sphere(0.2, 2e-4)
    settings = TraceSettings(method="raw", max_depth=1, effects={"edge_diffraction": "off"})
    scene = make_scene(mesh, targets.PEC, given, settings=settings)
    if shape == "plate":
        # turned so that it mirrors the middle pulse from one antenna to the other, give or take half a lobe
        sent, received = (at[1] / np.linalg.norm(at[1]) for at in antennas(given, scene))
        normal = sent + received + rng.normal(size=3) * 0.5 * LAMBDA / 0.9
        normal /= np.linalg.norm(normal)
        axis = np.cross(normal, rng.normal(size=3))
        axis /= np.linalg.norm(axis)
        turned = mesh.vertices @ np.stack([axis, np.cross(normal, axis), normal])
        scene = make_scene(replace(mesh, vertices=turned), targets.PEC, given, settings=settings)
    raw = simulate(scene)
    for layer, found in zip(raw.layers, raw.data, strict=True):
        exact = brute_force(scene, given, layer.channel)
        # tol: tubes of a curved body at 4.5 a wavelength; of a flat one, the sum over finite facets
        assert error_db(found, exact) < (-33.0 if shape == "sphere" else -45.0)
        # tol: the same
        assert abs(np.angle(np.vdot(exact, found))) < (0.02 if shape == "sphere" else 2e-4)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_corner_against_its_line(seed: int) -> None:
    """Two bounces: what a baseline changes is the mean phase along the corner line."""
    rng = np.random.default_rng(seed)
    given = drawn(rng, 10.0 ** rng.uniform(-1.0, 1.2), slant_range=2000.0, squint_angle_deg=0.0)
    given |= {"look_side": "right", "look_angle_deg": 45.0, "heading_deg": 180.0, "n_pulses": 3}
    given["receiver_offset_along"] *= 0.2  # within the lobe of the corner line
    # wall and floor along the track: the corner line is the y axis
    mesh = targets.wall_and_ground(1.0, 1.2, 1.0)
    line = np.array([[0.0, -0.6, 0.0], [0.0, 0.6, 0.0]])
    settings = TraceSettings(method="raw", max_depth=2, keep_orders=True)
    two = make_scene(mesh, targets.PEC * 2, given, settings=settings)
    one = make_scene(
        mesh, targets.PEC * 2, {k: v for k, v in given.items() if "receiver" not in k}, settings=settings
    )
    sent, received = antennas(given, two)
    amplitudes = []
    for scene, other in ((two, received), (one, sent)):
        raw = simulate(scene)
        double = raw.data[[layer.order for layer in raw.layers].index(2)]
        r = theory.bistatic_range(sent, np.zeros(3), other)
        at = np.argmin(
            np.abs(
                scene.radar.window.start_range[:, None]
                + np.arange(double.shape[1]) * scene.radar.window.sample_spacing
                - r[:, None]
            ),
            axis=1,
        )
        shape = np.sinc(
            (scene.radar.window.start_range + at * scene.radar.window.sample_spacing - r)
            / scene.radar.waveform.range_cell
        )
        spread = np.linalg.norm(sent, axis=1) * np.linalg.norm(other, axis=1)
        amplitudes.append(double[np.arange(3), at] / shape * spread)
    exact = [
        [theory.corner_line(a, b, *line, LAMBDA) for a, b in zip(sent, other, strict=True)]
        for other in (received, sent)
    ]
    ratio = amplitudes[0] / amplitudes[1] / (np.array(exact[0]) / np.array(exact[1]))
    # tol: range over the faces beside the corner line, and rays: a third of a per cent
    assert np.abs(np.abs(ratio) - 1.0).max() < 0.01 and np.abs(np.angle(ratio)).max() < 2e-3


ROUGH = Material(
    "rough",
    permittivity=5.0 - 0.5j,
    diffuse_law="small_perturbation",
    correlation_length=0.03,
    rms_height=0.002,
)


def rough_corner(baseline: float, rng: np.random.Generator, **settings: Any) -> tuple[Scene, dict[str, Any]]:
    given = drawn(
        rng, baseline, slant_range=3000.0, look_side="right", heading_deg=180.0, squint_angle_deg=0.0
    )
    given |= {"image_extent_azimuth": 20.0, "image_extent_range": 20.0}
    chosen = {
        "method": "raw",
        "max_depth": 3,
        "ray_spacing": 0.05,
        "diffuse_ray_spacing": 0.05,
        "scatterer_cell": 0.25,
    }
    mesh = targets.wall_and_ground(4.0, 6.0, 8.0)
    scene = make_scene(mesh, (ROUGH, ROUGH), given, settings=TraceSettings(**(chosen | settings)))
    return scene, given


def test_either_antenna_may_transmit() -> None:
    """Reciprocity of rough surfaces behind mirrors: out and home have lengths of their own, and change places."""
    rng = np.random.default_rng(3)
    scene, _ = rough_corner(4.0, rng, keep_orders=True, effects={"coherent": "off"})
    radar = scene.radar
    assert radar.receiver is not None
    swapped = replace(
        radar,
        track=radar.receiver,
        receiver=radar.track,
        pointing=radar.pointings[1],
        receiver_pointing=radar.pointing,
    )
    there, back = simulate(scene), simulate(replace(scene, radar=swapped))
    errors = {
        layer.order: error_db(b, a) for layer, a, b in zip(there.layers, there.data, back.data, strict=True)
    }
    # tol: float32 amplitudes
    assert errors[1] < -80.0
    # tol: what is lit through a mirror is told by the transmitter's rays: the rim of 6 m moves by 6 m times 1.3 mrad;
    # with the lengths of either way taken for both it would be 0 dB
    assert max(errors[2], errors[3]) < -27.0


def test_lengths_behind_a_mirror() -> None:
    """The three ways over one mirror and one scatterer, each by the images of the antennas in the mirror's plane."""
    rng = np.random.default_rng(4)
    scene, given = rough_corner(30.0, rng, effects={"coherent": "off", "diffuse_pairs": "off"})
    sent, received = (at[scene.radar.track.center_index] for at in antennas(given, scene))
    velocity = scene.radar.track.velocity[scene.radar.track.center_index]
    paths = trace_paths(scene)
    names = np.array(KINDS)[paths.kind]
    found = 0
    for name, order, turn, images in (
        ("diffuse", 1, 0, (False, False)),
        ("diffuse", 2, 1, (True, False)),
        ("reversed", 2, 0, (False, True)),
        ("reciprocal", 3, 1, (True, True)),
    ):
        rows = paths[(names == name) & (paths.order == order)]
        found += len(rows)
        point = rows.points[:, turn]
        # the mirror is the other of wall (x = 0) and floor (z = 0)
        flip = np.where((np.abs(point[:, :1]) < 1e-9), [[1.0, 1.0, -1.0]], [[-1.0, 1.0, 1.0]])
        ways = [
            np.linalg.norm(point - at * (flip if image else 1.0), axis=1)
            for at, image in zip((sent, received), images, strict=True)
        ]
        assert len(rows) > 100
        # tol: the mirror's plane is float64, its normal and the mirrored antenna too
        np.testing.assert_allclose(rows.length, ways[0] + ways[1], rtol=0.0, atol=1e-7)
        rates = [
            np.sum((at * (turned := flip if image else 1.0) - point) * velocity * turned, axis=1) / way
            for at, image, way in zip((sent, received), images, ways, strict=True)
        ]
        # tol: the same at 100 m/s over 3 km
        np.testing.assert_allclose(rows.range_rate, 0.5 * (rates[0] + rates[1]), rtol=0.0, atol=1e-8)
    assert found == len(paths)


@pytest.mark.parametrize("seed", few_of(range(3)))
def test_two_receivers_differ_in_phase_by_geometry(seed: int) -> None:
    """A rough patch above the ground, on the ground or below: its echoes in the two receivers of one pass."""
    rng = np.random.default_rng(seed)
    given = drawn(rng, 10.0 ** rng.uniform(0.0, 1.0), slant_range=3000.0, image_extent_range=60.0)
    place = rng.uniform(-5.0, 5.0, 3)
    mesh = targets.plate(0.5, 0.5)
    mesh = replace(mesh, vertices=mesh.vertices + place)
    settings = TraceSettings(max_depth=1, scatterer_cell=0.05, ray_spacing=0.05, effects={"coherent": "off"})
    two = make_scene(mesh, (ROUGH,), given, settings=settings)
    sent, received = antennas(given, two)
    alone = {name: value for name, value in given.items() if "receiver" not in name}
    one = make_scene(mesh, (ROUGH,), alone, settings=settings)
    pair = [focus_at(simulate(scene), place) for scene in (two, one)]
    legs = [np.linalg.norm(place - at, axis=1)[4] for at in (received, sent)]
    # pixels hold the phase of what is at their place: the geometry is in the range that focusing takes off
    assert abs(np.angle(pair[0] * np.conj(pair[1]))) < 0.1  # tol: speckle of a patch, baselines of 0.003 rad
    raw = [simulate(scene) for scene in (two, one)]
    phases = []
    for data in raw:
        samples = data.radar.window.start_range[4] + np.arange(data.radar.window.n_samples) * (
            data.radar.window.sample_spacing
        )
        r = float(data.radar.slant_range(place, slice(4, 5))[0])
        phases.append(np.sum(data.data[0, 4] * np.sinc((samples - r) / data.radar.waveform.range_cell)))
    turn = np.angle(phases[0] * np.conj(phases[1]) * np.exp(2j * np.pi / LAMBDA * (legs[0] - legs[1])))
    assert abs(turn) < 0.1  # tol: the same


def focus_at(raw: RawData, place: F64) -> complex:
    """Pixel at a place."""
    return complex(backproject(raw, place[None])[0, 0])


def test_a_point_that_moves_in_two_receivers() -> None:
    """Along-track interferometry: the phase of a velocity over the way between the antennas."""
    rng = np.random.default_rng(6)
    given = drawn(rng, 1.0, n_pulses=9, speed=100.0)
    given |= {"receiver_offset_along": -8.0, "receiver_offset_across": 0.0, "receiver_offset_up": 0.0}
    velocity = rng.uniform(-5.0, 5.0, 3)
    point = PointTarget("p", np.zeros(3), 2.0, motion=Motion(tuple(velocity)))
    scene = make_scene(None, (), given, points=(point,))
    sent, received = antennas(given, scene)
    place = scene.radar.track.time[:, None] * velocity
    r = theory.bistatic_range(sent, place, received)
    spread = np.linalg.norm(place - sent, axis=1) * np.linalg.norm(place - received, axis=1)
    value = np.sqrt(2.0) / spread * np.exp(-4j * np.pi / LAMBDA * r)
    exact = profiles(scene, r[:, None], value[:, None])
    # tol: complex64
    np.testing.assert_allclose(simulate(scene).data[0], exact, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("seed", range(2))
def test_key_pulses_against_every_pulse_traced(seed: int) -> None:
    """Blocks of pulses know both tracks, and both beams."""
    rng = np.random.default_rng(seed)
    given = drawn(rng, 60.0, slant_range=3000.0, n_pulses=48, azimuth_resolution=2.0, squint_angle_deg=0.0)
    given |= {"pattern": "gaussian", "azimuth_beamwidth_deg": 0.7, "elevation_beamwidth_deg": 10.0}
    given |= {"receiver_offset_along": 20.0 * (-1) ** seed, "image_extent_azimuth": 20.0}
    off = {"coherent": "off", "antenna_pattern": "on"}
    settings = TraceSettings(scatterer_cell=0.4, diffuse_ray_spacing=0.2, key_pulse_interval=16, effects=off)
    scene = make_scene(targets.plate(8.0, 8.0), (ROUGH,), given, settings=settings)
    exact = simulate(replace(scene, settings=replace(settings, method="raw"))).data
    fast = simulate(scene).data
    # tol: kernels four cells wide and the change of what is lit within a block
    assert error_db(fast, exact) < -45.0


def test_a_focused_point_in_two_beams() -> None:
    """Stripmap with a beam, the receiver 30 m behind and 12 m beside: place and level of a point."""
    rng = np.random.default_rng(1)
    beam = {
        "pattern": "gaussian",
        "azimuth_beamwidth_deg": 1.5,
        "elevation_beamwidth_deg": 10.0,
        "speed": 100.0,
    }
    given = drawn(rng, 1.0, slant_range=5000.0, squint_angle_deg=0.0, **beam)
    given |= {
        "n_pulses": 0,
        "azimuth_resolution": 1.0,
        "receiver_offset_along": -30.0,
        "receiver_offset_across": 12.0,
    }
    point = PointTarget("p", np.array([1.3, -2.1, 0.0]), 5.0, phase=0.4)
    scene = make_scene(None, (), given, points=(point,))
    image = focus(simulate(scene), request=scene.image)
    (found,) = image_quality(image, [KnownPoint((1.3, -2.1, 0.0), "p", 5.0, 0.4)], []).points
    # tol: a thousandth of a cell; the pulses are weighed by the transmitter's beam
    assert abs(found.azimuth_error) < 1e-3 and abs(found.range_error) < 1e-3
    # tol: interpolation of the peak; the same weights
    assert abs(found.phase_error) < 1e-3 and abs(found.rcs_error_db) < 0.05


@pytest.mark.parametrize("seed", range(2))
def test_each_antenna_has_its_own_beam(seed: int) -> None:
    """Gaussian beams in stripmap, either steered at the aim point from its own place at mid-aperture."""
    rng = np.random.default_rng(seed)
    given = drawn(rng, 150.0, squint_angle_deg=0.0, pattern="gaussian")
    width = float(rng.uniform(1.0, 3.0))
    given |= {"azimuth_beamwidth_deg": width, "elevation_beamwidth_deg": 20.0, "azimuth_resolution": 1.0}
    point = PointTarget("p", np.array([*rng.uniform(-5.0, 5.0, 2), 0.0]), 1.0)
    scene = make_scene(None, (), given, points=(point,))
    heading = np.radians(given["heading_deg"])
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    gain = 1.0
    for at in antennas(given, scene):
        # the azimuth axis: across the boresight, in the plane of it and of the flight
        look = (point.position - at) / np.linalg.norm(point.position - at, axis=1, keepdims=True)
        aim = -at[4] / np.linalg.norm(at[4])
        axis = along - (along @ aim) * aim
        axis /= np.linalg.norm(axis)
        over = np.cross(axis, aim)
        for one, beam in ((axis, width), (over, 20.0)):
            sine = (look @ one) / np.sin(np.radians(0.5 * beam))
            gain = gain * np.exp2(-0.5 * sine**2)  # of the power: half at the half width, one way
    sent, received = antennas(given, scene)
    spread = np.linalg.norm(point.position - sent, axis=1) * np.linalg.norm(point.position - received, axis=1)
    r = theory.bistatic_range(sent, point.position, received)
    exact = profiles(scene, r[:, None], (gain / spread * np.exp(-4j * np.pi / LAMBDA * r))[:, None])
    # tol: complex64
    np.testing.assert_allclose(simulate(scene).data[0], exact, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"receiver_track_file": "no.csv"},
            "receiver_offset_across has no effect beside receiver_track_file",
        ),
        ({"receiver_offset_across": 9e4}, "angle at the aim point is [0-9.]+ deg, more than 30 deg"),
    ],
)
def test_wrong_receivers_are_one_line(change: dict[str, Any], message: str) -> None:
    given = drawn(np.random.default_rng(0), 10.0) | change
    with pytest.raises(RadarError, match=message):
        make_scene(None, (), given, points=(PointTarget("p", np.zeros(3), 1.0),))


def test_no_baseline_is_one_antenna() -> None:
    given = drawn(np.random.default_rng(0), 10.0) | {
        f"receiver_offset_{axis}": 0.0 for axis in ("along", "across", "up")
    }
    scene = make_scene(None, (), given, points=(PointTarget("p", np.zeros(3), 1.0),))
    assert scene.radar.receiver is None and scene.radar.receiver_pointing is None


def test_one_look_wants_one_antenna() -> None:
    given = drawn(np.random.default_rng(0), 10.0)
    scene = make_scene(targets.plate(4.0, 4.0), (ROUGH,), given)
    for method in ("image", "raster"):
        with pytest.raises(
            RadarError,
            match=r"the receiver is apart from the transmitter \(bistatic\); take method hybrid or raw",
        ):
            render(scene, method=method)
