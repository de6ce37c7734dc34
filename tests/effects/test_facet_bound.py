"""Bounds of the coherent return of a resolution cell against quadrature over drawn plates, and what they decide."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sarmitsuba.effects.bounds import facet_bound, flash_bound
from sarmitsuba.effects.context import PilotResult, SamplingFacts, SceneContext
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene

F64 = NDArray[np.float64]
CELL = 0.3


@pytest.fixture(scope="module")
def corner() -> Scene:
    return load_scene(resolve("dihedral"))


def plates(scene: Scene, corners: F64, rms_height: float) -> Scene:
    """The scene with triangles (n, 3, 3) of rough ground in place of its geometry."""
    n = len(corners)
    geometry = Geometry(
        corners.reshape(-1, 3),
        np.arange(3 * n, dtype=np.int32).reshape(n, 3),
        np.zeros(n, dtype=np.int32),
        np.zeros(n, dtype=np.int32),
        ("plates",),
        np.array([0, n]),
    )
    material = Material("rough", diffuse_law="lambert", diffuse_level_db=-12.0, rms_height=rms_height)
    return replace(scene, geometry=geometry, materials=(material,))


def context(scene: Scene) -> SceneContext:
    ground = CELL * 2.0**0.25  # at 45 degrees
    return SceneContext(scene, SamplingFacts(0.05, 1000, ground, scene.geometry.bounds, 8, CELL, CELL))


def quadrature(corners: F64, antenna: F64, k: float, rms_height: float, rng: np.random.Generator) -> float:
    """Largest physical-optics return of a drawn cell of one plate, m^2, by summing its surface.

    The cell is CELL wide and CELL over the sine of the incidence angle long, with a raised cosine as its weight; the
    distance is exact.
    """
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    share = rng.dirichlet([0.7, 0.7, 0.7])
    middle = share @ corners
    towards = (antenna - middle) / np.linalg.norm(antenna - middle)
    cosine = abs(normal @ towards)
    across = np.cross(normal, towards)
    sine = np.linalg.norm(across)
    across /= sine
    along = np.cross(normal, across)
    reach = np.linalg.norm(corners - middle, axis=1).max()
    length = min(CELL / sine, 2.0 * reach)
    step = min(np.pi / (k * sine) / 10.0, length / 200.0)
    x, y = np.arange(-length, length, step), np.arange(-CELL, CELL, CELL / 60.0)
    weight = np.outer(np.cos(0.5 * np.pi * x / length) ** 2, np.cos(0.5 * np.pi * y / CELL) ** 2)
    points = middle + x[:, None, None] * along + y[None, :, None] * across
    inside = np.ones(points.shape[:2], dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= (points - p) @ np.cross(normal, q - p) >= 0.0
    distance = np.linalg.norm(antenna - points, axis=2)
    field = np.where(inside, weight, 0.0) * np.exp(2j * k * distance)
    whole = abs(field.sum()) * step * (y[1] - y[0]) * cosine * np.exp(-2.0 * (k * rms_height * cosine) ** 2)
    return float(4.0 * np.pi / (2.0 * np.pi / k) ** 2 * whole**2)


def test_the_bound_holds_for_drawn_plates(corner: Scene) -> None:
    rng = np.random.default_rng(90210)
    positions = corner.radar.track.position
    k = 2.0 * np.pi / corner.radar.waveform.wavelength
    margins = []
    for _ in range(60):
        towards = positions[len(positions) // 2] / np.linalg.norm(positions[len(positions) // 2])
        tilt = rng.normal(size=3) * rng.choice([0.01, 0.1, 1.0])
        normal = towards + tilt
        first = np.cross(normal, rng.normal(size=3))
        frame = np.stack([first, np.cross(normal, first)]) / np.linalg.norm(normal)
        corners = rng.uniform(-1.0, 1.0, (3, 2)) * rng.choice([0.2, 1.0, 5.0]) @ frame
        height = rng.choice([0.0, 0.2, 1.0]) / k
        scene = plates(corner, corners[None], height)
        bound = facet_bound(context(scene)).cross_section
        true = max(
            quadrature(corners, positions[rng.integers(len(positions))], k, height, rng) for _ in range(4)
        )
        margins.append(10.0 * np.log10(bound / max(true, 1e-30)))
    assert min(margins) > -0.1  # tol: dB, quadrature of ten points a wavelength of phase
    assert min(margins) < 12.0, sorted(margins)[:8]  # a bound far from the truth would decide nothing


def test_a_path_of_mirrors_loses_at_least_the_bound(corner: Scene) -> None:
    """Specular paths of two and three bounces at drawn angles: their roughness losses against the bound."""
    rng = np.random.default_rng(4)
    k, height = 2.0 * np.pi / corner.radar.waveform.wavelength, 0.004
    scene = plates(corner, rng.uniform(-1, 1, (1, 3, 3)), height)
    seen = context(scene)
    low = k * (1.0 - 0.5 * scene.radar.waveform.bandwidth / scene.radar.waveform.center_frequency)
    whole = np.linalg.norm(np.ptp(seen.box, axis=0))  # all of a face towards the antenna is in one range cell
    face_on = 4.0 * np.pi * (CELL * whole) ** 2 / scene.radar.waveform.wavelength**2
    for bounces in (2, 3):
        for _ in range(200):
            ways = rng.normal(size=(bounces + 1, 3))
            ways /= np.linalg.norm(ways, axis=1, keepdims=True)
            ways[-1] = -ways[0]  # back to the antenna
            moved = low * np.diff(ways, axis=0)  # along each normal
            loss = np.exp(-(height**2) * np.square(moved).sum())
            assert face_on * loss <= flash_bound(seen, bounces) * (1 + 1e-9)  # tol: rounding
    assert flash_bound(seen, 1) == 0.0


def measured(clutter: float) -> PilotResult:
    """Pilot that met clutter and nothing coherent."""
    mean = np.zeros((4, 2))
    mean[1, 0] = mean[3, 0] = clutter
    return PilotResult((0,), 1, 100, 0, 0, mean, 0 * mean, np.ones(2), mean, 1.0, 0.1, patch_area=0.02)


def facing(corner: Scene, tilt: float) -> F64:
    """Triangle (3, 3), m, perpendicular to the line of sight, or tilted by an angle (rad)."""
    towards = corner.radar.track.center_position / np.linalg.norm(corner.radar.track.center_position)
    across = np.cross(towards, [0.0, 0.0, 1.0])
    normal = np.cos(tilt) * towards + np.sin(tilt) * np.cross(across, towards)
    frame = np.stack([across, np.cross(normal, across)])
    return np.array([[-2.0, -2.0], [2.0, -2.0], [0.0, 2.0]]) @ frame


@pytest.mark.parametrize(
    ("tilt", "ks", "on"), [(0.0, 1.0, True), (0.6, 1.0, True), (0.6, 6.0, False), (0.0, 6.0, False)]
)
def test_faces_that_a_pilot_may_miss_decide(corner: Scene, tilt: float, ks: float, on: bool) -> None:
    k = 2.0 * np.pi / corner.radar.waveform.wavelength
    scene = plates(corner, facing(corner, tilt)[None], ks / k)
    seen = replace(context(scene), pilot=measured(1e-3))
    decision = plan_effects(scene, seen.sampling, seen.pilot, warn=False).decision("coherent")
    assert decision is not None and decision.on is on


@pytest.mark.parametrize(("tilt", "ks", "on"), [(0.0, 1.5, True), (0.6, 1.5, False), (0.0, 6.0, False)])
def test_a_specular_rough_face_needs_a_wide_band(corner: Scene, tilt: float, ks: float, on: bool) -> None:
    """The coherent loss of what the face leaves changes over the band, not only that of the incident wave."""
    waveform = replace(corner.radar.waveform, bandwidth=0.1 * corner.radar.waveform.center_frequency)
    k = 2.0 * np.pi / waveform.wavelength
    scene = plates(corner, facing(corner, tilt)[None], ks / k)
    scene = replace(scene, radar=replace(scene.radar, waveform=waveform))
    seen = replace(context(scene), pilot=measured(1e-3))
    decision = plan_effects(scene, seen.sampling, seen.pilot, warn=False).decision("wideband")
    assert decision is not None and decision.on is on, decision.why
