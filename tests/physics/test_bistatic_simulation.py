"""A receiver apart from the transmitter, simulated: points, facets, corners, rough scenes, at drawn baselines."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba import theory
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.raw import simulate
from sarmitsuba.validation import targets
from sarmitsuba.validation.chain import bandwidth, make_scene

pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.errors.SarmitsubaWarning")  # few rays, on purpose

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


@pytest.mark.parametrize("seed", range(4))
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
    middles, normals, areas = facets(scene.geometry, 0.2 * LAMBDA)
    cell, window = scene.radar.waveform.range_cell, scene.radar.window
    out = np.zeros((scene.radar.track.n_pulses, window.n_samples), dtype=complex)
    for t, (sent, received) in enumerate(zip(*antennas(given, scene), strict=True)):
        value = theory.bistatic_po(middles, normals, areas, sent, received, LAMBDA, channel)
        r = theory.bistatic_range(sent, middles, received)
        samples = window.start_range[t] + np.arange(window.n_samples) * window.sample_spacing
        out[t] = [np.sum(value * np.sinc((sample - r) / cell)) for sample in samples]
    return np.asarray(out * scene.radar.amplitude_constant)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shape", ["plate", "sphere"])
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
    mesh = targets.plate(0.9, 0.6) if shape == "plate" else targets.sphere(0.3, 2e-4)
    settings = TraceSettings(method="raw", max_depth=1)
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
        # tol: tubes of a curved body at 4.5 a wavelength; on a flat one the sum over facets a fifth of a wavelength wide
        assert error_db(found, exact) < (-33.0 if shape == "sphere" else -45.0)
        # tol: the same
        assert abs(np.angle(np.vdot(exact, found))) < (0.02 if shape == "sphere" else 2e-4)


@pytest.mark.parametrize("seed", range(3))
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
    one = make_scene(mesh, targets.PEC * 2, {k: v for k, v in given.items() if "receiver" not in k}, settings=settings)
    sent, received = antennas(given, two)
    amplitudes = []
    for scene, other in ((two, received), (one, sent)):
        raw = simulate(scene)
        double = raw.data[[layer.order for layer in raw.layers].index(2)]
        r = theory.bistatic_range(sent, np.zeros(3), other)
        at = np.argmin(np.abs(scene.radar.window.start_range[:, None] + np.arange(double.shape[1])
            * scene.radar.window.sample_spacing - r[:, None]), axis=1)
        shape = np.sinc((scene.radar.window.start_range + at * scene.radar.window.sample_spacing - r)
            / scene.radar.waveform.range_cell)
        spread = np.linalg.norm(sent, axis=1) * np.linalg.norm(other, axis=1)
        amplitudes.append(double[np.arange(3), at] / shape * spread)
    exact = [
        [theory.corner_line(a, b, *line, LAMBDA) for a, b in zip(sent, other, strict=True)]
        for other in (received, sent)
    ]
    ratio = amplitudes[0] / amplitudes[1] / (np.array(exact[0]) / np.array(exact[1]))
    print(np.abs(ratio), np.angle(ratio), np.abs(exact[0]))
