"""Edges of meshes whose triangles do not share their corners: T-junctions, rounded and gaping facets."""

import numpy as np
import pytest
import scipy
import trimesh

from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges, sharp_edges
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.measured import bodies


def edges_of_metal(triangles: np.ndarray, widest: float = np.inf) -> SharpEdges:
    return sharp_edges(triangles, np.ones(len(triangles), dtype=bool), widest)


def cut_at_random(corner: np.ndarray, a: np.ndarray, b: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rectangle in triangles with corners of their own along its sides, which no neighbour knows of."""
    n = rng.integers(0, 4, 4)
    inner = rng.random((rng.integers(0, 5), 2))
    sides = [
        np.column_stack([rng.random(n[k]), np.full(n[k], k % 2)])[:, :: 1 if k < 2 else -1] for k in range(4)
    ]
    places = np.concatenate([[[0, 0], [0, 1], [1, 0], [1, 1]], *sides, inner])
    faces = scipy.spatial.Delaunay(places).simplices
    return np.asarray((corner + places[:, :1] * a + places[:, 1:] * b)[faces])


def drawn_box(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles of a turned box with unaligned faces, its sizes, and the rotation."""
    size = rng.uniform(0.2, 1.0, 3)
    parts = []
    for axis in range(3):
        a, b = (np.eye(3)[(axis + i) % 3] * size[(axis + i) % 3] for i in (1, 2))
        for low in (0.0, size[axis]):
            parts.append(cut_at_random(low * np.eye(3)[axis] - 0.5 * size, a, b, rng))
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    return np.concatenate(parts) @ turn.T, size, turn


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("rounding", [0.0, 1e-7, 1e-5])
def test_drawn_boxes_have_twelve_edges(seed: int, rounding: float) -> None:
    rng = np.random.default_rng(seed)
    triangles, size, turn = drawn_box(rng)
    triangles = triangles + rounding * rng.uniform(-1.0, 1.0, triangles.shape)
    edges = edges_of_metal(triangles)
    # tol: gaps turn the normals of facets of a centimetre
    assert np.allclose(edges.angle, 1.5, atol=1e-6 + 1e4 * rounding)
    assert edges.gap.max() <= 4.0 * rounding + 1e-9
    # back in the box's axes: each of the twelve edges is covered once, and both normals point outwards
    middle, along = edges.middle @ turn, np.abs(edges.along @ turn)
    axis = along.argmax(axis=1)
    rows = np.arange(edges.n)
    off = np.abs(np.abs(middle / size) - 0.5)
    off[rows, axis] = 0.0
    # tol: the gap, relative to the smallest size of 0.2 m
    assert off.max() < 50.0 * rounding + 1e-9
    for k in range(3):
        for signs in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            others = [i for i in range(3) if i != k]
            here = (axis == k) & (np.sign(middle[:, others]) == signs).all(axis=1)
            assert edges.length[here].sum() == pytest.approx(size[k], abs=60.0 * rounding + 1e-9)
    outward = np.einsum("ei,efi->ef", np.sign(middle) * (off < 0.1), edges.normal @ turn)
    assert (outward > 0.5).all()


@pytest.mark.parametrize("name", ["thick_plate", "prism", "duct"])
@pytest.mark.parametrize("rounding", [1e-9, 1e-7, 1e-6])
def test_bodies_in_loose_triangles_have_the_edges_of_whole_ones(name: str, rounding: float) -> None:
    vertices, faces = getattr(bodies, name)()
    triangles = vertices[faces]
    whole = edges_of_metal(triangles)
    rng = np.random.default_rng(3)
    loose = edges_of_metal(triangles + rounding * rng.uniform(-1.0, 1.0, triangles.shape))
    assert loose.n == whole.n and (whole.gap == -1.0).all() and (loose.gap >= 0.0).all()
    places = scipy.spatial.cKDTree(whole.middle).query(loose.middle)
    assert places[0].max() < 10.0 * rounding and np.unique(places[1]).size == whole.n
    assert np.allclose(loose.length, whole.length[places[1]], atol=20.0 * rounding)
    # tol: normals of facets of 1.6 mm turn by a milliradian
    assert np.allclose(loose.angle, whole.angle[places[1]], atol=3.0 * rounding / 1e-3 + 1e-6)


def test_partly_overlapping_sheets_keep_the_rest_of_their_rims() -> None:
    floor = targets.parallelogram([0, 0, 0], [1.0, 0, 0], [0, 0.5, 0])
    wall = targets.parallelogram([0.25, 0, 0], [0.5, 0, 0], [0, 0, 0.3])
    both = edges_of_metal(np.concatenate([v[f] for v, f in (floor, wall)]))
    wedge = both.angle < 2.0
    assert both.length[wedge] == pytest.approx([0.5]) and both.middle[wedge][0] == pytest.approx([0.5, 0, 0])
    assert both.angle[wedge] == pytest.approx([1.5]) and both.gap[wedge][0] == pytest.approx(0.0)
    # of 3 m and 1.6 m, 0.5 m each are the wedge
    assert both.length[~wedge].sum() == pytest.approx(3.0 - 0.5 + 1.6 - 0.5)
    # in one plane there is no edge where they meet; a third sheet there makes it an edge of three, which is ignored
    flat = targets.parallelogram([0.25, -0.3, 0], [0.5, 0, 0], [0, 0.3, 0])
    level = edges_of_metal(np.concatenate([v[f] for v, f in (floor, flat)]))
    assert (level.angle == 2.0).all() and level.length.sum() == pytest.approx(3.6)
    wide = targets.parallelogram([0.2, -0.3, 0], [0.6, 0, 0], [0, 0.3, 0])
    three = edges_of_metal(np.concatenate([v[f] for v, f in (floor, wall, wide)]))
    assert (three.angle == 2.0).all() and three.length.sum() == pytest.approx(2.4 + 1.1 + 1.2)


def test_gaps_wider_than_allowed_stay() -> None:
    for gap, joined in ((1e-3, True), (3e-3, False)):
        floor = targets.parallelogram([0, 0, 0], [1.0, 0, 0], [0, 0.5, 0])
        wall = targets.parallelogram([0, 0, gap], [1.0, 0, 0], [0, 0, 0.5])
        edges = edges_of_metal(np.concatenate([v[f] for v, f in (floor, wall)]), 2e-3)
        assert (edges.angle < 2.0).any() == joined
        assert edges.gap.max() == (pytest.approx(gap) if joined else -1.0)


@pytest.mark.filterwarnings("ignore:.*levels are not better than")  # two edges that act as one
def test_a_loose_plate_returns_what_the_whole_one_does() -> None:
    """Edges on, 7 GHz: the T-junctions of a drawn triangulation change nothing; before, such edges were dropped."""
    vertices, faces = bodies.thick_plate()
    x, y, z = np.diag(np.ptp(vertices, axis=0))
    low, rng = vertices.min(axis=0), np.random.default_rng(8)
    parts = [
        cut_at_random(low + shift, a, b, rng)
        for a, b, c in ((x, y, z), (y, z, x), (z, x, y))
        for shift in (0.0 * c, c)
    ]
    loose = np.concatenate(parts)
    radar = RadarDescription(center_frequency=7e9)
    azimuth = np.radians(np.arange(3.0, 90.0, 6.0))
    aspects = Aspects(azimuth, np.full(azimuth.size, 0.05))
    found, said = [], []
    for v, f in ((vertices, faces), (loose.reshape(-1, 3), np.arange(3 * len(loose)).reshape(-1, 3))):
        scene = build_scene([SceneMesh(v, f, "pec", "body")], radar=radar).replace(edge_diffraction="on")
        sweep = rcs_sweep(scene, aspects, channels=("HH", "VV"), checked=0)
        found.append(sweep.result.amplitude.sum(axis=1))
        why = plan_effects(scene.replace(edge_diffraction="auto")).decision("edge_diffraction").why
        said.append(
            [any("share no corners there" in text for text in texts) for texts in (sweep.notes, [why])]
        )
    peak = np.abs(found[0]).max()
    # tol: tubes over faces of 1.6 mm, 2e-3 of the peak; the plate's width behind a rim is that at the middle of each
    # piece, 3e-3 between pieces of two and of a fifth of a wavelength
    assert np.abs(found[1] - found[0]).max() < 1e-2 * peak
    # flat parts are cut anew before their edges are looked for, so that nothing is left to say
    assert said == [[False, False], [False, False]]
