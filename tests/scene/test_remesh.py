"""Meshes for surface currents: even triangles, the same surface, sides that meet, mirrors and contacts."""

import tracemalloc

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from sarmitsuba.scene.mesh.mirrors import _pieces, count_pieces, mirror_planes, part_of
from sarmitsuba.scene.mesh.remesh import (
    DEVIATION,
    LONGEST,
    conforming,
    contacts,
    distance_to_triangles,
    join_points,
    remesh,
)


def drawn_solid(rng: np.random.Generator) -> trimesh.Trimesh:
    """Convex hull, cylinder, box or ball, turned."""
    kind = int(rng.integers(4))
    if kind == 0:
        solid = trimesh.convex.convex_hull(rng.normal(size=(9, 3)))
    elif kind == 1:
        solid = trimesh.creation.cylinder(rng.uniform(0.3, 1.0), rng.uniform(0.5, 3.0), sections=40)
    elif kind == 2:
        solid = trimesh.creation.box(rng.uniform(0.2, 3.0, 3))
    else:
        solid = trimesh.creation.icosphere(subdivisions=4)
    solid.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
    return solid


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    t = vertices[faces]
    return np.asarray(0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1))


def test_drawn_solids_keep_their_surface_in_even_triangles() -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        solid, length = drawn_solid(rng), rng.uniform(0.12, 0.3)
        vertices, faces = remesh(np.asarray(solid.vertices), np.asarray(solid.faces), length)
        made = trimesh.Trimesh(vertices, faces, process=False)
        assert made.is_watertight
        size = np.asarray(made.edges_unique_length)
        assert size.max() <= LONGEST * length * 1.1 and np.median(size) > 0.6 * length
        # tol: corners that are given up, some of them twice
        assert abs(made.volume - solid.volume) < 6.0 * DEVIATION * length * solid.area
        _, off, _ = trimesh.proximity.closest_point_naive(solid, vertices[:: max(1, len(vertices) // 200)])
        assert off.max() < 1e-9  # corners stay on the surface


@pytest.mark.slow
def test_a_fine_mesh_is_coarsened_and_slivers_go() -> None:
    fine = trimesh.creation.cylinder(1.0, 3.0, sections=120)
    vertices, faces = remesh(np.asarray(fine.vertices), np.asarray(fine.faces), 0.3)
    t = vertices[faces]
    sides = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2)
    quality = 4.0 * np.sqrt(3.0) * areas(vertices, faces) / np.square(sides).sum(axis=1)
    assert len(faces) < 2 * fine.area / (0.43 * 0.3**2)
    assert np.quantile(quality, 0.02) > 0.2 and np.median(quality) > 0.6


def test_distance_to_triangles_against_dense_points() -> None:
    rng = np.random.default_rng(4)
    t, points = rng.normal(size=(40, 3, 3)), rng.normal(size=(40, 3))
    a, b = np.meshgrid(np.linspace(0, 1, 120), np.linspace(0, 1, 120))
    inside = a + b <= 1.0
    a, b = a[inside], b[inside]
    dense = np.einsum("kq,nqc->nkc", np.stack([1.0 - a - b, a, b], axis=1), t)
    nearest = np.linalg.norm(dense - points[:, None], axis=2).min(axis=1)
    found = distance_to_triangles(points, t)
    # tol: spacing of the dense points
    assert (found <= nearest + 1e-12).all() and np.abs(found - nearest).max() < 0.05


def test_sides_meet_after_cuts() -> None:
    """Two squares beside each other, one of them cut so that its corners lie within the other's side."""
    left = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    right = [
        [[1, 0, 0], [2, 0, 0], [1, 0.3, 0]],
        [[2, 0, 0], [2, 1, 0], [1, 0.3, 0]],
        [[2, 1, 0], [1, 0.8, 0], [1, 0.3, 0]],
        [[2, 1, 0], [1, 1, 0], [1, 0.8, 0]],
    ]
    vertices, faces = conforming(np.array([*left, *right], dtype=float), 1e-6)
    made = trimesh.Trimesh(vertices, faces, process=False)
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(ends, axis=0, return_counts=True)
    assert made.area == pytest.approx(2.0) and (count <= 2).all()
    assert (count == 1).sum() == 6  # the outline alone


def test_mirrors_of_turned_bodies_and_none_of_lopsided_ones() -> None:
    rng = np.random.default_rng(6)
    turn = Rotation.random(random_state=1).as_matrix()
    box = trimesh.creation.box((1.0, 0.7, 0.4))
    vertices, faces = np.asarray(box.vertices) @ turn.T + rng.normal(size=3), np.asarray(box.faces)
    center, normals = mirror_planes(vertices, faces, 1e-3, 0.05)
    assert len(normals) == 3 and np.allclose(
        np.abs(normals @ turn), np.eye(3)[np.abs(normals @ turn).argmax(axis=1)]
    )
    part, cut = part_of(vertices, faces, center, normals, 1e-3)
    assert 8.0 * areas(part, cut).sum() == pytest.approx(box.area, rel=1e-6)
    lopsided = trimesh.convex.convex_hull(rng.normal(size=(9, 3)))
    _, none = mirror_planes(np.asarray(lopsided.vertices), np.asarray(lopsided.faces), 1e-3, 0.05)
    assert len(none) == 0


def test_contacts_are_found_where_parts_cross_or_touch_alone() -> None:
    plate, faces = remesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]), 0.2
    )
    both = np.concatenate([faces, faces + len(plate)])
    apart = np.concatenate([plate, plate + np.array([0.0, 0.0, 0.1])])
    assert not len(contacts(apart, both, 0.02))
    touching = np.concatenate([plate, plate + np.array([0.03, 0.02, 0.01])])
    assert len(contacts(touching, both, 0.02))
    upright = plate[:, [0, 2, 1]] + [0.03, 0.51, -0.47]
    at = contacts(np.concatenate([plate, upright]), both, 1e-6)
    assert len(at) and np.allclose(at[:, 1], 0.51, atol=0.02) and np.abs(at[:, 2]).max() < 1e-6
    assert not len(contacts(plate, faces, 0.02))


def test_a_hole_opposite_a_whole_wall_is_no_mirror_image_of_it() -> None:
    """A wall of two triangles whose corners and middles lie on the other wall, which has a slot elsewhere."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    front = np.asarray(box.triangles)[:, :, 0].min(axis=1) > 0.49
    walls = np.asarray(box.triangles)[~front]
    y = [-0.5, -0.4, 0.4, 0.5]
    z = [-0.5, 0.1, 0.3, 0.5]
    pieces = []
    for i in range(3):
        for j in range(3):
            if (i, j) != (1, 1):
                a, b = (0.5, y[i], z[j]), (0.5, y[i + 1], z[j])
                c, d = (0.5, y[i + 1], z[j + 1]), (0.5, y[i], z[j + 1])
                pieces += [[a, b, c], [a, c, d]]
    vertices, faces = conforming(np.concatenate([walls, np.array(pieces)]), 1e-6)
    _, normals = mirror_planes(vertices, faces, 1e-3, 0.05)
    assert len(normals) == 1 and abs(normals[0, 1]) > 0.99


def test_narrow_tapes_and_thin_boxes_keep_their_width() -> None:
    tape = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0.004, 0], [0, 0.004, 0]])
    vertices, faces = remesh(tape, np.array([[0, 1, 2], [0, 2, 3]]), 0.2)
    assert areas(vertices, faces).sum() == pytest.approx(0.004, rel=1e-6)
    box = trimesh.creation.box((1.0, 0.7, 0.004))
    vertices, faces = remesh(np.asarray(box.vertices), np.asarray(box.faces), 0.2)
    made = trimesh.Trimesh(vertices, faces, process=False)
    assert made.is_watertight and made.volume == pytest.approx(box.volume, rel=1e-6)


def test_triangles_on_one_another_are_contacts() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    twice = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]])
    assert len(contacts(square, twice, 0.01)) and not len(contacts(square, twice[:2], 0.01))


@pytest.mark.parametrize(("squeeze", "length"), [(1.0, 0.4), (1.0, 1.1), (0.5, 0.4)])
def test_bodies_of_revolution_come_out_even_and_closed_at_their_poles(squeeze: float, length: float) -> None:
    """Slivers at the poles of a sphere and a spheroid."""
    ball = trimesh.creation.uv_sphere(1.0, count=[16, 32])
    ball.apply_scale([squeeze, squeeze, 1.0])
    corners, faces = conforming(np.asarray(ball.triangles), length / 200.0)
    vertices, faces = remesh(corners, faces, length)
    made = trimesh.Trimesh(vertices, faces, process=False)
    assert made.is_watertight and not len(contacts(vertices, faces, 0.1 * length))
    t = vertices[faces]
    sides = np.square(t - np.roll(t, 1, axis=1)).sum(axis=(1, 2))
    assert np.quantile(4.0 * np.sqrt(3.0) * areas(vertices, faces) / sides, 0.02) > 0.1


def test_corners_are_joined_by_pairs_and_not_by_chains() -> None:
    row = np.arange(1000)[:, None] * np.array([0.9e-3, 0.0, 0.0])
    label = join_points(row, 1e-3)
    assert np.linalg.norm(row - row[label], axis=1).max() <= 1e-3
    assert 400 < len(np.unique(label)) < 600


def test_mirrors_of_slender_triangles_take_little_memory() -> None:
    """Samples of a needle are as many as its length asks for, not its square."""
    ball = trimesh.creation.cylinder(1.0, 6.0, sections=100)
    tracemalloc.start()
    _, normals = mirror_planes(np.asarray(ball.vertices), np.asarray(ball.faces), 4e-3, 0.2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(normals) == 3
    # tol: 16 MB measured, and room for other versions of SciPy
    assert peak < 6e7


def test_surfaces_are_cut_into_few_pieces_for_their_mirrors() -> None:
    """Fans of slivers, right-angled slivers and wide triangles: no side too long, no area lost, forecast at least."""
    mesh = trimesh.creation.cylinder(0.5, 1.0, sections=500)
    for corners in (np.asarray(mesh.triangles), np.asarray(trimesh.creation.box((1.0, 2.0, 0.3)).triangles)):
        pieces = _pieces(corners, 0.05)
        sides = np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2)
        assert sides.max() <= 0.05 * (1.0 + 1e-9)
        areas = [
            np.linalg.norm(np.cross(*(t[:, i] - t[:, 0] for i in (1, 2))), axis=1).sum()
            for t in (pieces, corners)
        ]
        assert areas[0] == pytest.approx(areas[1], rel=1e-9)
        # slivers half as wide were cut lengthwise too, into four times as many
        assert 0.1 * count_pieces(corners, 0.05) < len(pieces) < count_pieces(corners, 0.05)
