"""Closed solids for the shipped scenes: unions and cuts of boxes, prisms, bodies of revolution, tree crowns.

Every function returns a watertight trimesh mesh with outward normals, in metres. Needs shapely >= 2.1.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64

Span = tuple[float, float]
Cut = tuple[str, Span, Span, Span]


def blocks(*cuts: Cut) -> trimesh.Trimesh:
    """Add ("+") and remove ("-") axis-parallel boxes, one after the other.

    The outline of every plane is triangulated as a whole, with all corners of its neighbours on its border,
    so that the mesh has no T-junctions.
    """
    grid = [np.unique(np.round([s for c in cuts for s in c[1 + k]], 6)) for k in range(3)]
    full = np.zeros([g.size - 1 for g in grid], dtype=bool)
    for sign, *spans in cuts:
        i = [slice(*np.searchsorted(g, np.round(s, 6))) for g, s in zip(grid, spans, strict=True)]
        full[tuple(i)] = sign == "+"
    outlines = [o for axis in range(3) for o in _outlines(full, grid, axis)]
    corners = np.unique(np.concatenate([o[0] for o in outlines]), axis=0)
    triangles = [
        _triangles(polygon, axis, level, sign, corners) for _, polygon, axis, level, sign in outlines
    ]
    return merged(np.concatenate(triangles))


def _outlines(full: NDArray[np.bool_], grid: list[F64], axis: int) -> list[tuple]:
    """Find (turning points in space, polygon, axis, level, sign) of every connected piece of surface."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    solid = np.pad(full, [(1, 1) if k == axis else (0, 0) for k in range(3)]).astype(np.int8)
    step = np.diff(solid, axis=axis).transpose(axis, a, b)  # +1: solid begins, so the normal points backwards
    found = []
    for level, plane in zip(grid[axis], step, strict=True):
        for sign in (-1, 1):
            i, j = np.nonzero(plane == -sign)
            if not i.size:
                continue
            cells = shapely.box(grid[a][i], grid[b][j], grid[a][i + 1], grid[b][j + 1])
            union = shapely.union_all(cells)
            for polygon in getattr(union, "geoms", [union]):
                rings = [_turns(np.asarray(r.coords)[:-1]) for r in (polygon.exterior, *polygon.interiors)]
                polygon = shapely.Polygon(rings[0], rings[1:])
                found.append((_lift(np.concatenate(rings), axis, level), polygon, axis, level, sign))
    return found


def _turns(ring: F64) -> F64:
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    return ring[np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) > 1e-12]


def _lift(points: F64, axis: int, level: float) -> F64:
    out = np.empty((len(points), 3))
    out[:, axis] = level
    out[:, (axis + 1) % 3] = points[:, 0]
    out[:, (axis + 2) % 3] = points[:, 1]
    return out


def _triangles(polygon: shapely.Polygon, axis: int, level: float, sign: int, corners: F64) -> F64:
    here = corners[np.abs(corners[:, axis] - level) < 1e-9][:, [(axis + 1) % 3, (axis + 2) % 3]]
    rings = [_with_points(np.asarray(r.coords), here) for r in (polygon.exterior, *polygon.interiors)]
    pieces = shapely.constrained_delaunay_triangles(shapely.Polygon(rings[0], rings[1:]))
    flat = np.array([np.asarray(t.exterior.coords)[:3] for t in pieces.geoms])
    e, g = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    wrong = (e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0]) * sign < 0
    flat[wrong] = flat[wrong][:, ::-1]
    return _lift(flat.reshape(-1, 2), axis, level).reshape(-1, 3, 3)


def _with_points(ring: F64, points: F64) -> F64:
    """Return the closed ring with every point that lies on one of its axis-parallel edges inserted."""
    out = []
    for p, q in pairwise(ring):
        k = int(np.abs(q - p).argmax())
        low, high = sorted((p[k], q[k]))
        on = points[(points[:, 1 - k] == p[1 - k]) & (points[:, k] > low) & (points[:, k] < high)]
        out += [p[None], on[np.argsort(on[:, k] * np.sign(q[k] - p[k]))]]
    return np.concatenate([*out, ring[:1]])


def box(x: Span, y: Span, z: Span) -> trimesh.Trimesh:
    """One axis-parallel box."""
    return blocks(("+", x, y, z))


def prism(profile: Sequence[tuple[float, float]], y: Span) -> trimesh.Trimesh:
    """Extrude a closed (x, z) profile along y: gabled and saw-tooth roofs."""
    p = np.asarray(profile, dtype=np.float64)
    if shapely.LinearRing(p).is_ccw:  # then the front cap at low y faces -y as (x, z) is seen from there
        p = p[::-1]
    n = len(p)
    pieces = shapely.constrained_delaunay_triangles(shapely.Polygon(p))
    flat = np.array(
        [np.asarray(shapely.geometry.polygon.orient(t).exterior.coords)[:3] for t in pieces.geoms]
    )
    front = np.insert(flat, 1, y[0], axis=2)
    back = np.insert(flat[:, ::-1], 1, y[1], axis=2)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    near, far = np.insert(p, 1, y[0], axis=1), np.insert(p, 1, y[1], axis=1)
    sides = np.concatenate([np.stack([near[i], near[j], far[j]], 1), np.stack([near[i], far[j], far[i]], 1)])
    return merged(np.concatenate([front, back, sides]))


def revolve(
    profile: Sequence[tuple[float, float]], center: tuple[float, float], segments: int
) -> trimesh.Trimesh:
    """Turn an (r, z) profile, from the axis at the bottom to the axis at the top, about a vertical axis."""
    a = 2.0 * np.pi * (np.arange(segments) + 0.5) / segments
    circle = np.column_stack([np.cos(a), np.sin(a)])
    rings = [np.insert(r * circle + center, 2, z, axis=1) for r, z in profile]
    parts = []
    for low, high in pairwise(rings):
        low2, high2 = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        parts += [np.stack([low, low2, high2], 1), np.stack([low, high2, high], 1)]
    return merged(np.concatenate(parts))


def crown(
    center: Sequence[float], radius: Sequence[float], seed: int, lumps: float = 0.16
) -> trimesh.Trimesh:
    """A lumpy ellipsoid of 80 triangles: the crown of a tree."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    rng = np.random.default_rng(seed)
    r = 1.0 + lumps * rng.standard_normal(len(ball.vertices)).clip(-2.0, 2.0)
    ball.vertices = np.round(np.asarray(center) + ball.vertices * r[:, None] * np.asarray(radius), 4)
    return ball


def windows(
    wall: str, at: float, along: Sequence[float], up: Sequence[float], size: Span, depth: float
) -> list[Cut]:
    """Recesses in the wall of a `blocks` building.

    Parameters
    ----------
    wall : outward normal, ``-x``, ``+x``, ``-y`` or ``+y``
    at : coordinate of the wall, m
    along, up : lower corners of the openings, m
    size : width and height, m
    depth : of the recess, m
    """
    inward = (at, at + depth) if wall[0] == "-" else (at - depth, at)
    cuts: list[Cut] = []
    for s in along:
        for z in up:
            span, rise = (s, s + size[0]), (z, z + size[1])
            cuts.append(("-", inward, span, rise) if wall[1] == "x" else ("-", span, inward, rise))
    return cuts


def turned(mesh: trimesh.Trimesh, angle_deg: float, about: tuple[float, float]) -> trimesh.Trimesh:
    """Turn a mesh about a vertical axis, counter-clockwise as seen from above."""
    matrix = trimesh.transformations.rotation_matrix(np.deg2rad(angle_deg), [0, 0, 1], [*about, 0])
    return mesh.copy().apply_transform(matrix)


def merged(triangles: F64) -> trimesh.Trimesh:
    """Return triangles (n, 3, 3) as a mesh with shared corners and without zero-area faces."""
    corner, index = np.unique(np.round(triangles.reshape(-1, 3), 6) + 0.0, axis=0, return_inverse=True)
    f = index.reshape(-1, 3)
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    return trimesh.Trimesh(corner, f, process=False)


def check_closed(name: str, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh, or raise when it is not a closed, outward solid without degenerate faces."""
    problems = [
        text
        for bad, text in (
            (not mesh.is_watertight, "not watertight"),
            (not mesh.is_winding_consistent, "winding not consistent"),
            (mesh.is_watertight and mesh.volume <= 0.0, "normals point inwards"),
            ((mesh.area_faces < 1e-8).any(), "degenerate faces"),
        )
        if bad
    ]
    if problems:
        raise SystemExit(f"{name}: {', '.join(problems)}")
    return mesh
