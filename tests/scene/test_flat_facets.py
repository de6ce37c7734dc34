"""Facets that are flat but for noise of their vertices, and faces that are given twice."""

import numpy as np
import pytest
import scipy
import trimesh

from sarmitsuba.scene.mesh.boundary_edges import facets
from sarmitsuba.scene.mesh.double_faces import double_faces
from sarmitsuba.scene.mesh.flattening import LARGEST_DISTANCE, flatten_facets
from sarmitsuba.scene.mesh.sharp_edges import sharp_edges
from sarmitsuba.scene.mesh.topology import copies_apart, edge_pairs, weld

WAVELENGTH = 0.03


def drawn_plate(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a turned rectangle in triangles, slivers among them."""
    n, m = rng.integers(2, 8, 2)
    border = np.concatenate([np.column_stack([rng.random(n), np.zeros(n)]), [[0, 0], [0, 1], [1, 0], [1, 1]]])
    places = np.concatenate([border, rng.random((m, 2)), [[0.5, 0.003]]]) * rng.uniform(0.1, 0.4, 2)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    return places @ turn[:2], scipy.spatial.Delaunay(places).simplices


@pytest.mark.parametrize("noise", [1e-8, 1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("seed", range(8))
def test_noisy_plates_are_one_facet_of_four_sides(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = drawn_plate(rng)
    vertices = vertices + noise * WAVELENGTH * rng.uniform(-1.0, 1.0, vertices.shape)
    corners = vertices[faces]
    vertex = weld(corners.reshape(-1, 3))
    pairs = edge_pairs(vertex)
    flat = flatten_facets(corners, pairs, WAVELENGTH)
    assert np.abs(flat - corners).max() <= 2.0 * noise * WAVELENGTH
    normal = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
    size = np.linalg.norm(normal, axis=1)
    across = np.abs((normal / size[:, None]) @ (normal / size[:, None])[size.argmax()])
    # tol: rounding of float64 over the height of slivers
    assert across.min() > 1.0 - 1e-9
    found = facets(flat, vertex, None, WAVELENGTH, pairs)
    # tol: slivers as narrow as the noise may stay apart; the parts still tile the plate
    assert found.closed.all()
    if noise < 1e-4:
        assert (found.part == found.part[0]).all()
        assert ((found.edges[:, :, 3] > -1.0).sum(axis=1) == 4).all()


def test_what_is_flat_or_curved_stays_as_it_is() -> None:
    rng = np.random.default_rng(1)
    vertices, faces = drawn_plate(rng)
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    for corners in (vertices[faces], np.asarray(sphere.vertices[sphere.faces])):
        pairs = edge_pairs(weld(corners.reshape(-1, 3)))
        # tol: rounding
        assert np.abs(flatten_facets(corners, pairs, WAVELENGTH) - corners).max() < 1e-15


def test_planes_that_bend_little_stay_two() -> None:
    """A ridge of 5 degrees, with noise: each side is flattened alone."""
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(0.0, 0.3, 5))
    places = np.column_stack([x.ravel(), y.ravel()])
    vertices = np.column_stack([places, -np.tan(np.radians(5.0)) * np.abs(places[:, 0])])
    noisy = vertices + 1e-7 * rng.uniform(-1.0, 1.0, vertices.shape)
    corners = noisy[scipy.spatial.Delaunay(places).simplices]
    corners = corners[np.abs(corners[:, :, 0].sum(axis=1)) > 1e-3]
    flat = flatten_facets(corners, edge_pairs(weld(corners.reshape(-1, 3))), WAVELENGTH)
    assert 0.0 < np.abs(flat - corners).max() < 2e-7
    normal = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None] * np.sign(normal[:, 2:])
    kinds = np.unique(np.round(normal, 7), axis=0)
    assert len(kinds) == 2
    assert LARGEST_DISTANCE * WAVELENGTH > 1e-7


@pytest.mark.parametrize("seed", range(8))
def test_double_faces_against_drawn_points(seed: int) -> None:
    """A triangle is covered if all points drawn on it lie in triangles of one shape before it."""
    rng = np.random.default_rng(seed)
    places, turn = rng.random((12, 2)), trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    first = places[scipy.spatial.Delaunay(places).simplices]
    small = rng.uniform(0.2, 0.8, (30, 1, 2)) + rng.uniform(-0.15, 0.15, (30, 3, 2))
    small = np.concatenate([small, first[:4, [0, 2, 1]]])
    weights = np.concatenate([np.eye(3), rng.dirichlet(np.ones(3), 3997)])
    side = np.roll(first, -1, axis=1) - first
    inside = np.zeros((len(small), 4000), dtype=bool)
    for corners, step in zip(first, side, strict=True):
        away = (weights @ small)[:, :, None] - corners
        cross = step[:, 0] * away[..., 1] - step[:, 1] * away[..., 0]
        inside |= (cross >= -1e-12).all(axis=2) | (cross <= 1e-12).all(axis=2)
    corners = np.concatenate([first, small])
    shape = np.repeat([0, 1], [len(first), len(small)])
    flat = np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2) @ turn.T + rng.uniform(
        -1, 1, 3
    )
    found = double_faces(flat, shape)
    assert not found[: len(first)].any()
    np.testing.assert_array_equal(found[len(first) :], inside.all(axis=1))
    # the same a millimetre above is none
    flat[len(first) :] += 1e-3 * turn[:, 2]
    assert not double_faces(flat, shape).any()
    assert double_faces(flat, shape, 2e-3).any()


@pytest.mark.parametrize("flip", [False, True])
def test_box_with_faces_given_twice_has_twelve_edges(flip: bool) -> None:
    box = trimesh.creation.box(extents=(0.2, 0.3, 0.4))
    corners = np.asarray(box.vertices[box.faces])
    again = corners[:5, ::-1] if flip else corners[:5]
    both, shape = np.concatenate([corners, again]), np.repeat([0, 1], [12, 5])
    edges = sharp_edges(both, np.ones(17, dtype=bool), np.inf, shape)
    assert edges.doubled == 5 and "5 metal triangles" in edges.joined_text
    assert np.isclose(edges.length.sum(), 4.0 * 0.9) and np.allclose(edges.angle, 1.5)
    # each copy keeps its neighbours
    vertex = weld(both.reshape(-1, 3))
    assert len(edge_pairs(vertex)[0]) < 18
    one, two = edge_pairs(copies_apart(vertex))
    assert ((one < 36) & (two < 36)).sum() == 18
    assert (copies_apart(vertex[:36]) == vertex[:36]).all()


def test_edges_over_a_gap_lie_where_the_planes_meet() -> None:
    box = trimesh.creation.box(extents=(0.2, 0.3, 0.4))
    corners = np.asarray(box.vertices[box.faces])
    normal = np.rint(np.asarray(box.face_normals))
    moved = corners + 2e-4 * normal[:, None]
    edges = sharp_edges(moved, np.ones(12, dtype=bool), 6e-4)
    half = 0.5 * np.array([0.2, 0.3, 0.4]) + 2e-4
    off = np.sort(np.abs(np.abs(edges.middle) - half), axis=1)
    # tol: rounding
    assert edges.n == 12 and off[:, 1].max() < 1e-12
