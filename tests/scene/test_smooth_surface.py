"""Smooth surfaces through the corners of facets: spheres, cylinders, creases, and what counts as round."""

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sarmitsuba import load_scene
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.loading.from_mesh import MeshOptions
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.scene.mesh.smooth_surface import facet_sagitta, smooth_surface
from sarmitsuba.scene.round_facets import RoundFacets, smooth_geometry


def fitted(body: trimesh.Trimesh, sagitta: float) -> trimesh.Trimesh:
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32)
    made = smooth_surface(vertices, faces, smooth_groups(vertices, faces, 40.0), sagitta)
    assert (np.diff(made[2]) >= 0).all() and made[2].max() == len(faces) - 1
    return trimesh.Trimesh(*made[:2], process=False)


@pytest.mark.parametrize(
    "make",
    [
        lambda: trimesh.creation.icosphere(subdivisions=1),
        lambda: trimesh.creation.icosphere(subdivisions=2),
        lambda: trimesh.creation.uv_sphere(1.0, count=[12, 24]),
    ],
)
def test_spheres_come_out_exact(make: Callable[[], trimesh.Trimesh]) -> None:
    made = fitted(make(), 1e-3)
    assert made.is_watertight
    assert np.abs(np.linalg.norm(made.vertices, axis=1) - 1.0).max() < 1e-12
    # tol: chords of the asked sagitta
    assert made.volume == pytest.approx(4.0 / 3.0 * np.pi, rel=5e-3)


def test_rims_of_cylinders_become_circles_and_boxes_stay() -> None:
    made = fitted(trimesh.creation.cylinder(1.0, 2.0, sections=20), 1e-3)
    radius = np.hypot(made.vertices[:, 0], made.vertices[:, 1])
    assert made.is_watertight and np.allclose(radius[radius > 0.5], 1.0, atol=3e-4)
    assert np.abs(made.vertices[:, 2]).max() == pytest.approx(1.0)
    assert len(fitted(trimesh.creation.box((1.0, 2.0, 3.0)), 1e-3).faces) == 12


def test_round_bodies_have_a_sagitta_and_slopes_of_roofs_have_none() -> None:
    for n in (2, 3):
        ball = trimesh.creation.icosphere(subdivisions=n)
        t = np.asarray(ball.triangles)
        chord = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2).max(axis=1)
        found = facet_sagitta(t, smooth_groups(ball.vertices, ball.faces))
        assert np.allclose(found, 1.0 - np.sqrt(1.0 - 0.25 * chord**2), rtol=0.02)
    roof = np.array([[0.0, 0, 0], [4, 0, 0.5], [8, 0, 0], [0, 9, 0], [4, 9, 0.5], [8, 9, 0]])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], dtype=np.int32)
    assert smooth_groups(roof, faces).max() == 0
    assert not facet_sagitta(roof[faces], np.zeros(4, dtype=np.int32)).any()


def test_coarse_facets_of_metal_are_warned_of_with_the_number_needed() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = SceneMesh(np.asarray(ball.vertices) * 20.0, np.asarray(ball.faces, dtype=np.int32), "pec", "ball")
    radar = RadarDescription(center_frequency=SPEED_OF_LIGHT, aim_z=0.0)
    with pytest.warns(SarmitsubaWarning, match="320 facets of round metal lie up to 0.27 wavelengths"):
        scene = build_scene([mesh], radar=radar)
    found = RoundFacets.of(scene.geometry, scene.materials, 1.0)
    assert 3000 < found.needed < 6000
    fine = smooth_geometry(scene.geometry, 0.005)
    assert fine.mesh_face_offset.tolist() == [0, fine.n_faces] and fine.n_faces > found.needed
    finer = RoundFacets.of(fine, scene.materials, 1.0)
    assert not finer.doubt and finer.error_db < found.error_db - 20.0


def test_meshes_far_from_their_origin_in_single_precision_are_warned_of_and_materials_keep_their_names(
    tmp_path: Path,
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=40.0)
    ball.apply_translation([0.0, 5.334e6, 100.0])
    ball.vertices = np.asarray(ball.vertices).astype(np.float32)
    path = tmp_path / "ball.stl"
    ball.export(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load_scene(
            path, radar="airborne_x", mesh=MeshOptions(up="z", unit="m", materials={"*": "pec"})
        )
    said = [str(w.message) for w in caught]
    assert any("rounded to 0.5 m, 16 wavelengths" in text for text in said)
    assert [m.name for m in scene.materials] == ["pec"]
