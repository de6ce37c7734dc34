"""Derivatives with echoes of edges, wires, points, pairs and slabs against differences of whole runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import Material, PointTarget, Scene
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.errors import SceneError
from sarmitsuba.tracing.scatterers.wires.kind import WireTarget
from tests.support.differences import compared_all, drawn

pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")


def with_effects(scene: Scene, depth: int = 1, **effects: str) -> Scene:
    """The scene with other bounces, and effects in place of its own."""
    return replace(scene, settings=replace(scene.settings, max_depth=depth, effects=effects))


def edged(seed: int) -> Scene:
    """A metal box whose echoes are mostly those of its edges."""
    return with_effects(drawn(seed, "metal"), diffuse_pairs="off")


def wired(seed: int) -> Scene:
    """Wires beside a metal box, straight and over smooth ground."""
    rng = np.random.default_rng(seed)
    ends = [rng.uniform([6.0, -9.0, 0.5], [9.0, 9.0, 4.0], (2, 3)) for _ in range(6)]
    wires = tuple(WireTarget(f"wire{i}", start, end, 0.02) for i, (start, end) in enumerate(ends))
    scene = with_effects(drawn(seed, "metal"), 3, diffuse_pairs="off", edge_diffraction="off")
    return replace(scene, scatterers=wires)


def pointed(seed: int) -> Scene:
    """Ideal points beside a rough box, in a beam."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([6.0, -9.0, 0.5], [9.0, 9.0, 4.0], (4, 3))
    points = tuple(PointTarget(f"point{i}", place, 100.0) for i, place in enumerate(places))
    return replace(with_effects(drawn(seed, "beam"), diffuse_pairs="off"), points=points)


def paired(seed: int) -> Scene:
    """A rough box on rough ground with the pairs between both."""
    return with_effects(drawn(seed, "rough"), 2, diffuse_pairs="on")


@pytest.mark.parametrize(
    ("scenes", "kinds"),
    [
        # not lifted off the ground: edges that touch it are left out
        (edged, ("track:1", "shift:box:x,shift:box:y")),
        pytest.param(edged, ("gain", "clock_offset", "height:box"), marks=pytest.mark.slow),
        pytest.param(wired, ("gain", "clock_offset", "track:2"), marks=pytest.mark.slow),
        pytest.param(pointed, ("gain", "clock_offset", "track:1", "pointing"), marks=pytest.mark.slow),
        pytest.param(paired, ("gain", "track:2", "level:soil"), marks=pytest.mark.slow),
    ],
)
def test_derivatives_are_those_of_whole_runs(scenes: Callable[[int], Scene], kinds: tuple[str, ...]) -> None:
    found = [compared_all(scenes(seed), kinds, seed) for seed in range(1, 4)]
    for kind, own in zip(kinds, zip(*found, strict=True), strict=True):
        # tol: float32 amplitudes over the step of the differences, more where the slant range changes little along the
        # drawn direction; single rays that flip at edges count apart
        assert min(c.error for c in own) < 1e-3, kind
        assert all(c.error < 3e-3 for c in own if c.steady), kind


@pytest.mark.slow
def test_edges_of_turned_shapes_leave_out_the_angles_to_their_faces() -> None:
    found = [compared_all(edged(seed), ("rotation:box",), seed)[0] for seed in range(1, 7)]
    # tol: change of the fringe coefficients, 1 / 2 k over the arm of some metres
    assert np.median([c.error for c in found]) < 3e-3


def slab(seed: int) -> Scene:
    """A box of glass in place of the rough one, without waves through it."""
    scene = drawn(seed, "rough")
    rng = np.random.default_rng(seed)
    glass = Material(
        "wall",
        permittivity=complex(rng.uniform(3.0, 8.0), -0.05),
        thickness=float(rng.uniform(0.004, 0.02)),
        rms_height=1e-4,
    )
    number = [m.name for m in scene.materials].index("wall")
    materials = tuple(glass if i == number else m for i, m in enumerate(scene.materials))
    return with_effects(
        replace(scene, materials=materials),
        3,
        transmission="off",
        diffuse_pairs="off",
        edge_diffraction="off",
    )


@pytest.mark.slow
def test_the_thickness_of_a_slab_is_differentiated() -> None:
    found = [compared_all(slab(seed), ("thickness:wall",), seed)[0] for seed in range(4)]
    # tol: difference over a two-thousandth of the wavelength either way
    assert max(c.error for c in found if c.steady) < 1e-3
    assert sum(c.steady for c in found) >= 2


@pytest.mark.parametrize(
    ("scenes", "kind", "reason"),
    [
        (wired, "permittivity:soil", 'of kind "wire" cannot be differentiated by it'),
        (paired, "shift:box:x", 'of kind "diffuse pair" cannot be differentiated by it'),
        (paired, "rms_height:wall", 'of kind "diffuse pair" cannot be differentiated by it'),
    ],
)
def test_what_is_not_known_is_refused_parameter_by_parameter(
    scenes: Callable[[int], Scene], kind: str, reason: str
) -> None:
    scene = scenes(1)
    with pytest.raises(SceneError, match=reason):
        ForwardModel(scene, parse(f"gain,{kind}", scene))
