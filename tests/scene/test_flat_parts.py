"""Flat parts of meshes: as few triangles as the outline needs, however they are cut."""

import numpy as np
import pytest
import trimesh

from sarmitsuba.effects.omitted_waves import SimulatedWaves
from sarmitsuba.effects.theory_error import theory_error
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.mesh.flat_parts import join_flat_parts
from sarmitsuba.scene.visible_faces import VisibleFaces


def area(corners: np.ndarray) -> float:
    return float(
        0.5 * np.linalg.norm(np.cross(*(corners[:, i] - corners[:, 0] for i in (1, 2))), axis=1).sum()
    )


def drawn_turn(seed: int) -> np.ndarray:
    return trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))[:3, :3].T


def cut(mesh: trimesh.Trimesh, times: int, seed: int = 1) -> np.ndarray:
    """Triangles of a mesh, turned, some of which are halved at a time, conforming, as float32 files have them."""
    for _ in range(times):
        mesh = mesh.subdivide()
    return np.asarray((mesh.vertices @ drawn_turn(seed)).astype(np.float32)[mesh.faces], dtype=np.float64)


@pytest.mark.parametrize("times", [0, 1, 3])
def test_a_box_has_twelve_triangles_however_it_is_cut(times: int) -> None:
    corners = cut(trimesh.creation.box((1.0, 2.0, 0.3)), times)
    found, row = join_flat_parts(corners, np.zeros(len(corners), dtype=np.int64))
    assert len(found) == 12 and len(row) == 12
    assert area(found) == pytest.approx(area(corners), rel=1e-5)  # tol: float32 corners
    assert len(np.unique(found.reshape(-1, 3), axis=0)) == 8
    # outward as they were
    normal = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
    assert (np.einsum("ni,ni->n", normal, found.mean(axis=1)) > 0.0).all()


def test_kinds_stay_apart_and_share_corners() -> None:
    """Half of a plate of another kind: two triangles each, which meet corner to corner."""
    corners = cut(trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]), 3, 2)
    kind = (corners.mean(axis=1) @ drawn_turn(2).T[:, 0] > 0.6).astype(np.int64)
    found, row = join_flat_parts(corners, kind)
    for k in (0, 1):
        assert area(found[kind[row] == k]) == pytest.approx(area(corners[kind == k]), rel=1e-5)
    assert len(found) < 0.5 * len(corners)


@pytest.mark.parametrize(
    "mesh",
    [trimesh.creation.icosphere(2), trimesh.creation.annulus(0.3, 1.0, 0.2), trimesh.creation.cylinder(1, 2)],
)
def test_what_is_curved_or_holed_stays(mesh: trimesh.Trimesh) -> None:
    corners = np.asarray(mesh.triangles)
    found, row = join_flat_parts(corners, np.zeros(len(corners), dtype=np.int64))
    assert area(found) == pytest.approx(area(corners), rel=1e-9)
    assert len(found) == len(corners) or mesh.volume < 7.0
    # tol: rounding of sums
    volume = np.einsum("ni,ni->n", found[:, 0], np.cross(found[:, 1], found[:, 2])).sum() / 6.0
    assert volume == pytest.approx(mesh.volume, rel=1e-9)
    assert (row[:-1] <= row[1:]).all()


def test_what_is_said_of_a_plate_depends_on_no_cut() -> None:
    said = []
    for times in (0, 2, 4):
        mesh = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        for _ in range(times):
            mesh = mesh.subdivide()
        scene = build_scene(
            [SceneMesh(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), "pec", "plate")],
            radar=RadarDescription(center_frequency=3e9),
        )
        found = VisibleFaces.of(scene.geometry, scene.materials)
        assert len(found.corners) == 2
        look = np.array([[0.0, np.sin(a), np.cos(a)] for a in np.radians([0.0, 10.0, 30.0])])
        theory = theory_error(
            scene.geometry, scene.materials, look, np.ones((3, 1, 1), complex), ("VV",), 0.1, SimulatedWaves()
        )
        said.append(theory.missing.ravel())
    assert said[1] == pytest.approx(said[0], rel=1e-9) and said[2] == pytest.approx(said[0], rel=1e-9)
