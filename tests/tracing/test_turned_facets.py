"""Hits on turned facets and behind turned mirrors, against rotations by finite angles in NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.apps.fit.shape_parameters import Deformation
from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import mi
from sarmitsuba.tracing.derivatives.range_tangents import turned_hit
from sarmitsuba.tracing.derivatives.tangents import Displacement, Tangents
from tests.support.differences import drawn

ROTATION = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


@dataclass
class Struck:
    """The parts of a hit that turn."""

    active: mi.Bool
    face: mi.UInt32
    length: mi.Float64
    direction64: mi.Vector3d
    direction: mi.Vector3f
    normal64: mi.Vector3d
    normal: mi.Vector3f
    cos_incidence: mi.Float


def turned(x: F64, angle: float, base: F64) -> F64:
    """A point turned about the vertical through a base."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ (x - base) + base


def unit(x: F64) -> F64:
    """The vector over its length."""
    return np.asarray(x / np.linalg.norm(x))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("moved", [True, False])
def test_directions_and_normals_are_those_of_the_turned_shape(seed: int, moved: bool) -> None:
    """An antenna seen in a mirror of the shape from a facet of the same shape, or of another."""
    rng = np.random.default_rng(seed)
    antenna, base, place = rng.uniform(-1e3, 1e3, 3), rng.uniform(-5.0, 5.0, 3), rng.uniform(-5.0, 5.0, 3)
    mirror, facet, point = (
        unit(rng.standard_normal(3)),
        unit(rng.standard_normal(3)),
        rng.uniform(-5.0, 5.0, 3),
    )

    def image(angle: float) -> F64:
        n = turned(mirror, angle, np.zeros(3))
        return np.asarray(antenna - 2.0 * n * (n @ (antenna - turned(place, angle, base))))

    h, step = 1e-5, 3e-3
    velocity = (image(h) - image(-h)) / (2.0 * h)
    leg = point - image(0.0)
    length, d = float(np.linalg.norm(leg)), unit(leg)
    facet *= -np.sign(facet @ d)
    displacement = Displacement(np.zeros(3), np.array([moved]), -ROTATION @ base, ROTATION, 1.0)
    ray: Any = SimpleNamespace(derivative=SimpleNamespace(virtual=(mi.Vector3d(velocity),)))
    hit: Any = Struck(
        mi.Bool(True),
        mi.UInt32(0),
        mi.Float64(length),
        mi.Vector3d(d),
        mi.Vector3f(d),
        mi.Vector3d(facet),
        mi.Vector3f(facet),
        mi.Float(-float(d @ facet)),
    )
    carried = Tangents.of([displacement], [], 1, 1).carried()
    found = turned_hit(carried, 0, ray, hit, mi.Float(step))
    expected_d = unit(point - image(step))
    expected_n = turned(facet, step, np.zeros(3)) if moved else facet
    # tol: second order in the step, up to twice the turn of the image over its least distance of some hundred metres
    for own, expected in ((found.direction64, expected_d), (found.normal64, expected_n)):
        assert np.linalg.norm(np.array(own)[:, 0] - expected) < 8.0 * step**2
    assert float(found.cos_incidence[0]) == pytest.approx(
        max(-expected_d @ expected_n, 1e-7), abs=8.0 * step**2
    )


@pytest.mark.parametrize(
    ("kind", "parameter", "turns"),
    [
        ("alone", "height", False),
        ("alone", "scale", False),
        ("alone", "rotation", True),
        ("house", "height", True),
        ("house", "scale", False),
        ("house", "rotation", True),
    ],
)
def test_only_displacements_that_turn_facets_carry_more_fields(
    kind: str, parameter: str, turns: bool
) -> None:
    scene = drawn(1, kind)
    (displacement,) = Deformation(parameter, "box").displacements(scene, scene.geometry.face_mesh)
    plan = Tangents.of([displacement], [], scene.geometry.n_faces, 1)
    assert tuple(number for number, _ in plan.turns) == ((0,) if turns else ())
