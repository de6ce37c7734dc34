"""Walks over lattices, against brute force: scatterers of a patch, rays over outlines, blocks of a track."""

import numpy as np
import pytest

from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.scene.mesh import tessellate
from sarmitsuba.signal.block import _even
from sarmitsuba.simulation.planning.sampling.small_parts import Lattice, ManyNodesError, nodes_over
from sarmitsuba.tracing.kernel.launch import frame_towards, project
from sarmitsuba.tracing.kernel.speckle import TURN_COS, TURN_SIN, ScattererLattice
from sarmitsuba.tracing.kernel.tubes.tube import TubeExtent, patch


def test_every_node_of_a_patch_is_visited_once() -> None:
    ensure_backend()
    rng = np.random.default_rng(3)
    n = 2000
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point = rng.uniform(-50.0, 50.0, (n, 3))
    u, v = (w - normal * np.sum(w * normal, axis=1, keepdims=True) for w in rng.normal(size=(2, n, 3)))
    cell = rng.uniform(0.05, 0.6, n)
    ends = []
    for _ in range(4):  # cut by the facet's edge, at any slope, or not
        cut = rng.random(n) < 0.5
        ends += [np.where(cut, rng.random(n), 1e3), np.where(cut, rng.uniform(-1.0, 1.0, n), 0.0)]
    part = patch(TubeExtent(*(mi.Float(e.astype(np.float32)) for e in ends)))
    lattice = ScattererLattice.of(
        mi.Vector3d(*point.T),
        mi.Vector3d(*normal.T),
        mi.Vector3f(*u.T.astype(np.float32)),
        mi.Vector3f(*v.T.astype(np.float32)),
        part,
        mi.Float64(cell),
        dr.full(mi.Bool, True, n),
    )
    _, count = dr.while_loop(
        (lattice.first(), dr.zeros(mi.UInt32, n)),
        lambda node, count: node.column <= node.last,
        lambda node, count: (lattice.after(node, mi.Int32(1)), count + 1),
        mode="symbolic",
    )
    corners = np.array([[x.numpy() for x in corner] for corner in part.corners]).transpose(2, 0, 1)
    turn = np.array([[TURN_COS, TURN_SIN], [-TURN_SIN, TURN_COS]])
    differ = total = 0
    for i in range(n):
        kept = np.delete(np.arange(3), np.abs(normal[i]).argmax())
        hit, edges = turn @ point[i, kept], np.stack([turn @ w[i, kept] for w in (u, v)], axis=1)
        around = hit + corners[i] @ edges.T
        low, high = np.floor(around.min(axis=0) / cell[i]), np.floor(around.max(axis=0) / cell[i])
        if (high - low >= 64.0).any():  # bounded there
            continue
        a, b = np.meshgrid(*(np.arange(s, e + 1) for s, e in zip(low, high, strict=True)), indexing="ij")
        place = np.linalg.solve(edges, (np.stack([a.ravel(), b.ravel()]) + 0.5) * cell[i] - hit[:, None])
        inside = np.ones(a.size, dtype=bool)
        for p, q in zip(corners[i], np.roll(corners[i], -1, axis=0), strict=True):
            inside &= (q[0] - p[0]) * (place[1] - p[1]) >= (q[1] - p[1]) * (place[0] - p[0])
        total += int(inside.sum())
        differ += abs(int(inside.sum()) - int(count[i]))
    assert total > 20_000
    assert differ < 1e-4 * total  # tol: float32 rounds nodes that lie on a side to either side of it


def test_rays_over_outlines_are_those_near_a_triangle() -> None:
    rng = np.random.default_rng(5)
    triangles = 20.0 * rng.normal(size=(40, 1, 3)) + rng.normal(size=(40, 3, 3))
    antenna = np.array([[-3000.0, 0.0, 3000.0]])
    frame = frame_towards(antenna, np.zeros(3), np.array([0.0, 1.0, 0.0]))
    spacing, rotation, shift = 0.25, 0.4, np.array([0.1, 0.07])
    x, y = nodes_over(triangles, antenna, Lattice(frame, spacing, rotation, shift))
    turn = np.array([[np.cos(rotation), -np.sin(rotation)], [np.sin(rotation), np.cos(rotation)]])
    found = np.rint((np.stack([x, y], axis=1) - shift) @ turn / spacing).astype(int)
    assert len(np.unique(found, axis=0)) == len(found)
    outline = (project(triangles, antenna[0], frame) - shift) @ turn / spacing
    low, high = np.floor(outline.min(axis=(0, 1))) - 1, np.ceil(outline.max(axis=(0, 1))) + 1
    nodes = np.stack(np.meshgrid(*(np.arange(s, e + 1) for s, e in zip(low, high, strict=True))), axis=-1)
    nodes = nodes.reshape(-1, 2)
    inside = np.zeros(len(nodes), dtype=bool)
    for corner in outline:
        side = np.roll(corner, -1, axis=0) - corner
        out = nodes[:, None] - corner
        cross = side[:, 0] * out[..., 1] - side[:, 1] * out[..., 0]
        inside |= (cross >= 0.0).all(axis=1) | (cross <= 0.0).all(axis=1)
    wanted = {tuple(node) for node in nodes[inside].astype(int)}
    assert len(wanted) > 500
    assert wanted <= {tuple(node) for node in found}
    # and no more than a rim of a tenth of a step about them
    assert len(found) < 1.2 * len(wanted)


def test_a_slender_body_is_laid_out_as_one() -> None:
    """Every node over a tube of 200 facets as any antenna sees it, and few others; with facets by themselves too."""
    vertices, faces = tessellate.cylinder(0.3, 0.0, 40.0, 1e-4)
    tilt = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.2], [-0.3, 0.2, 1.0]])
    triangles = (vertices @ tilt)[faces]
    antennas = np.array([[-3000.0, y, 3000.0] for y in (-30.0, 0.0, 30.0)])
    frame = frame_towards(antennas[1:2], np.zeros(3), np.array([0.0, 1.0, 0.0]))
    lattice = Lattice(frame, 0.05, 0.4, np.array([0.01, 0.03]))
    found = []
    for piece in (np.zeros(len(triangles), dtype=np.int64), None):
        xy = np.stack(nodes_over(triangles, antennas, lattice, piece=piece), axis=1)
        nodes = np.rint((xy - lattice.shift) @ lattice.axes / lattice.spacing).astype(int)
        assert len(np.unique(nodes, axis=0)) == len(nodes)
        found.append({tuple(node) for node in nodes})
    wanted: set[tuple[int, ...]] = set()
    for antenna in antennas:
        for corner in lattice.steps(triangles, antenna):
            low, high = np.ceil(corner.min(axis=0)), np.floor(corner.max(axis=0))
            rows = np.arange(low[0], high[0] + 1.0)
            side = np.roll(corner, -1, axis=0) - corner
            # where the rows cross the sides
            for row in rows:
                at = (row - corner[:, 0]) / np.where(side[:, 0] == 0.0, 1.0, side[:, 0])
                on = corner[:, 1] + at * side[:, 1]
                on = on[(at >= 0.0) & (at <= 1.0) & (side[:, 0] != 0.0)]
                if on.size:
                    wanted |= {
                        (int(row), c) for c in range(int(np.ceil(on.min())), int(np.floor(on.max())) + 1)
                    }
    assert len(wanted) > 5000
    for nodes_found in found:
        # tol: nodes within rounding of an outline
        assert len(wanted - nodes_found) <= 2
        # what moves between the antennas, and the rim
        assert len(nodes_found) < 1.25 * len(wanted)
    with pytest.raises(ManyNodesError):
        nodes_over(triangles, antennas, lattice, most=0.5 * len(wanted))


def test_no_block_of_few_pulses_is_left_over() -> None:
    assert _even(514, 128) == 129  # rather than a fifth block of two pulses
    for length in (48, 96, 128):
        for n in range(length, 6 * length):
            even = _even(n, length)
            assert even <= length * 17 / 16 + 1
            assert n % even == 0 or n % even > even / 2


def test_a_window_keeps_the_nodes_within_it() -> None:
    """Triangles of which some lie beyond the window, many are long: nodes within are those without a window."""
    rng = np.random.default_rng(11)
    triangles = 40.0 * rng.normal(size=(80, 1, 3)) + rng.choice([1.0, 60.0], (80, 1, 1)) * rng.normal(
        size=(80, 3, 3)
    )
    antennas = np.array([[-3000.0, y, 3000.0] for y in (-20.0, 0.0, 25.0)])
    frame = frame_towards(antennas[1:2], np.zeros(3), np.array([0.0, 1.0, 0.0]))
    lattice = Lattice(frame, 0.5, 0.3, np.array([0.2, 0.1]))
    reach = (25.0, 14.0)
    every = np.stack(nodes_over(triangles, antennas, lattice, stretches=40.0), axis=1)
    within = np.stack(nodes_over(triangles, antennas, lattice, reach=reach, stretches=40.0), axis=1)
    expected = every[(np.abs(every) <= reach).all(axis=1)]
    assert 500 < len(within) < 0.5 * len(every)
    np.testing.assert_array_equal(within, expected)
