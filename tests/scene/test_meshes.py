"""Cleaning of triangle meshes and their smooth groups."""

import re
import sys

import numpy as np
import pytest

from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.mesh.cleaning import clean_mesh, single_precision_step
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.scene.mesh.tessellate import cube, cylinder, rectangle, sphere
from sarmitsuba.scene.mesh.topology import label_connected


def as_set(vertices, faces):
    """Faces as a set of corner positions, whatever their order and winding."""
    return {frozenset(map(tuple, vertices[f])) for f in faces}


def soup(vertices, faces):
    """Give every triangle three vertices of its own."""
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def test_clean_mesh_leaves_a_good_mesh_alone():
    v, f = cube()
    cv, cf, notes = clean_mesh("box", v, f)
    assert notes == []
    np.testing.assert_array_equal(cv, v)
    np.testing.assert_array_equal(cf, f)
    assert cv.dtype == np.float64
    assert cf.dtype == np.int32


def test_duplicates_flipped_copies_and_flat_faces_go_with_a_note_each():
    v, f = cube()
    bad = np.concatenate([f, f[:3, [1, 2, 0]], f[5:7, [0, 2, 1]], [[0, 0, 1], [2, 2, 2]]])
    cv, cf, notes = clean_mesh("box", v, bad)
    assert as_set(cv, cf) == as_set(v, f)
    assert len(cf) == len(f)
    assert notes == [
        'mesh "box": removed 2 of 19 faces without area',
        'mesh "box": removed 5 duplicate faces of 19 (2 flipped copies)',
    ]


def test_copies_with_vertices_of_their_own_are_found():
    v, f = soup(*cube())
    cv, cf, notes = clean_mesh("soup", np.concatenate([v, v]), np.concatenate([f, f[:, ::-1] + len(v)]))
    assert len(cf) == 12
    assert "12 duplicate faces of 24 (12 flipped copies)" in notes[0]
    assert len(cv) == 36  # the unused copies' vertices are dropped


def test_collinear_corners_at_map_coordinates_have_no_area():
    # three points on a line, 4e6 m from the origin: not collinear to the last bit after rounding
    p = np.array([4.5e6, 5.3e6, 500.0]) + np.linspace(0, 1, 3)[:, None] * np.array([10.0, 1.0 / 3.0, 0.1])
    v = np.concatenate([p, [[4.5e6, 5.3e6, 600.0]]])
    _, cf, notes = clean_mesh("map", v, [[0, 1, 2], [0, 2, 3]])
    assert len(cf) == 1
    assert "1 of 2 faces without area" in notes[0]


def test_slivers_with_area_stay():
    v = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0]])
    assert len(clean_mesh("sliver", v, [[0, 1, 2]])[1]) == 1


def test_result_is_independent_of_face_order():
    rng = np.random.default_rng(2)
    v, f = sphere(1.0, 0.02)
    bad = np.concatenate([f, f[:50], f[20:90, ::-1], f[:10, [0, 0, 1]]])
    cv, cf, notes = clean_mesh("ball", v, bad)
    order = rng.permutation(len(bad))
    pv, pf, pnotes = clean_mesh("ball", v, bad[order])
    assert notes == pnotes

    def rolled(vertices, faces):  # winding kept, start corner free
        t = vertices[faces]
        first = np.lexsort(t.transpose(2, 0, 1)[::-1], axis=1)[:, 0]
        return {tuple(map(tuple, np.roll(a, -k, axis=0))) for a, k in zip(t, first, strict=True)}

    assert rolled(cv, cf) == rolled(pv, pf)
    assert len(cf) == len(f)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (
            [[0, 0, np.nan], [1, 0, 0], [0, np.inf, 0]],
            [[0, 1, 2]],
            '"bad": 2 of 3 vertices are NaN or infinite',
        ),
        (
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            [[0, 1, 3], [0, 1, 2], [-1, 0, 1]],
            "2 of 3 faces have corners outside",
        ),
        (np.zeros((0, 3)), np.zeros((0, 3), int), "empty (0 vertices, 0 faces)"),
        (np.zeros((4, 3)), np.zeros((0, 3), int), "empty (4 vertices, 0 faces)"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "all 1 faces have zero area"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "vertices have the shape (3, 2)"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0.0, 1.0, 2.0]], "not (n, 3) of integers"),
    ],
)
def test_meshes_that_mean_nothing_are_refused_by_name_and_count(vertices, faces, message):
    with pytest.raises(SceneError, match=re.escape(message)) as caught:
        clean_mesh("bad", vertices, faces)
    assert str(caught.value).startswith('mesh "bad": ')
    assert "\n" not in str(caught.value)


def test_smooth_groups_of_box_sphere_and_barrel():
    v, f = cube()
    groups = smooth_groups(v, f)
    assert groups.dtype == np.int32
    assert len(set(groups)) == 6
    assert (groups[0::2] == groups[1::2]).all()
    assert set(smooth_groups(*sphere(1.0, 0.01))) == {0}
    assert set(smooth_groups(*cylinder(1.0, 0.0, 3.0, 0.01))) == {0}


def test_smooth_groups_weld_by_position_and_ignore_winding():
    rng = np.random.default_rng(3)
    v, f = soup(*cube())
    f = f.copy()
    f[::2] = f[::2, ::-1]
    order = rng.permutation(12)
    groups = smooth_groups(v, f[order])
    back = np.empty(12, int)
    back[order] = groups
    assert (back[0::2] == back[1::2]).all()
    assert len(set(back)) == 6


def test_smooth_groups_threshold_is_the_bend():
    # two squares hinged along x = 0, bent by 30 degrees
    t = np.deg2rad(30.0)
    v = np.array(
        [[-1, 0, 0], [-1, 1, 0], [0, 0, 0], [0, 1, 0], [np.cos(t), 0, np.sin(t)], [np.cos(t), 1, np.sin(t)]]
    )
    f = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    assert len(set(smooth_groups(v, f, 29.0))) == 2
    assert len(set(smooth_groups(v, f, 31.0))) == 1


def test_smooth_groups_at_an_edge_of_three_faces():
    # a floor of two subsets with a wall on their common edge: the floor stays one group, in any face order
    v = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], dtype=float)
    f = np.array([[0, 3, 2], [3, 1, 2], [2, 3, 4]])
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        g = np.empty(3, int)
        g[order] = smooth_groups(v, f[order])
        assert g[0] == g[1] != g[2]


def test_smooth_groups_of_nothing():
    assert smooth_groups(np.zeros((3, 3)), np.zeros((0, 3), int)).shape == (0,)


@pytest.mark.parametrize("n", [200, pytest.param(708, marks=pytest.mark.slow)])
def test_a_million_triangles_take_no_loop_over_them(n):
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    v = np.column_stack([x.ravel(), y.ravel(), np.sin(x + 3.0 * y).ravel() * 0.01])
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    f = np.concatenate(
        [np.column_stack([i, i + n + 1, i + 1]), np.column_stack([i + 1, i + n + 1, i + n + 2])]
    )
    calls = 0

    def count(*_):
        nonlocal calls
        calls += 1

    sys.setprofile(count)
    try:
        cv, cf, notes = clean_mesh("terrain", v, f)
        groups = smooth_groups(cv, cf)
    finally:
        sys.setprofile(None)
    # work, not seconds: one call per face would be 2 n^2, up to a million
    assert calls < 10_000
    assert len(cf) == 2 * n * n > 70_000
    assert notes == []
    assert set(groups) == {0}


def test_one_triangle():
    v, f = rectangle()
    cv, cf, _ = clean_mesh("one", v, f[:1])
    assert cv.shape == (3, 3)
    assert smooth_groups(cv, cf).tolist() == [0]


def test_connected_parts_are_those_found_by_walking():
    """Random graphs, chains in any order and stars; parts are numbered by their first nodes."""
    rng = np.random.default_rng(4)
    order = rng.permutation(300)
    graphs = [(0, order[:0], order[:0]), (5, order[:0], order[:0]), (300, order[:-1], order[1:])]
    graphs.append((300, np.full(299, 299), np.arange(299)))
    graphs += [
        (n, rng.integers(n, size=m), rng.integers(n, size=m)) for n in (1, 40, 200) for m in (1, 30, 150)
    ]
    for count, first, second in graphs:
        beside = {node: [] for node in range(count)}
        for a, b in zip(first.tolist(), second.tolist(), strict=True):
            beside[a].append(b)
            beside[b].append(a)
        part, parts = np.full(count, -1), 0
        for start in range(count):
            walk = [start] if part[start] < 0 else []
            parts += len(walk)
            while walk:
                here = walk.pop()
                if part[here] < 0:
                    part[here] = parts - 1
                    walk += beside[here]
        np.testing.assert_array_equal(label_connected(count, first, second), part)


def test_coordinates_rounded_to_single_precision_are_told_from_whole_metres():
    rng = np.random.default_rng(1)
    far = np.array([0.0, 5.334e6, 0.0])
    near = rng.normal(size=(40, 3))
    rounded = (near * 5.0 + far).astype(np.float32).astype(np.float64)
    assert single_precision_step(rounded) == 0.5
    assert single_precision_step(near * 5.0 + far) == 0.0
    assert single_precision_step(np.round(near * 20.0) + far) == 0.0
    assert single_precision_step(near.astype(np.float32).astype(np.float64)) < 1e-6
