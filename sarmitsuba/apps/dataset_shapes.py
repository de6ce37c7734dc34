"""Shapes of drawn scenes: meshes of a folder, walls, boxes, crowns of trees, ground with relief."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean, one_line, printable
from sarmitsuba.loading.library import scenes_dir
from sarmitsuba.loading.mesh_files import read_mesh
from sarmitsuba.scene.mesh.tessellate import sphere

_SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf")
# most meshes of a folder, and most points of ground along a side
_MOST_MESHES, _MOST_SIDE = 10_000, 400
# points of ground in a correlation length
_PER_LENGTH = 4
# half the width of the plan of a shape that is a line in plan, m
_HALF_LINE = 1e-3
# largest extent of a mesh, m
_MOST_EXTENT = 1e5


@dataclass(frozen=True, eq=False)
class InstanceMesh:
    """One mesh of the folder: an instance of its class.

    Parameters
    ----------
    name : path in the folder, without suffix
    semantic_class : of the shape
    vertices : (n, 3) float64, m; the middle of its plan at the origin, its lowest point at z = 0
    faces : (n, 3) int32
    """

    name: str
    semantic_class: str
    vertices: F64
    faces: I32


def mesh_folder(name: str, beside: Path) -> Path:
    """Folder of meshes: relative to the recipe, or a shipped one by name.

    Raises
    ------
    DataError
        There is no such folder.
    """
    own = beside / name
    if os.path.isdir(own):
        return own
    shipped = scenes_dir() / "meshes" / name
    if name and ".." not in Path(name).parts and os.path.isdir(shipped):
        return shipped
    known = sorted(p.name for p in (scenes_dir() / "meshes").iterdir() if os.path.isdir(p))
    raise DataError(
        f'[objects]: meshes = "{one_line(name)}": no such folder{did_you_mean(name, known)}; shipped: '
        f"{', '.join(known)}"
    )


def read_instances(folder: Path, classes: str) -> tuple[InstanceMesh, ...]:
    """All meshes of a folder and of the folders in it (not deeper), in order of their names.

    Parameters
    ----------
    folder : of files ply, obj, stl or glTF, in metres, z up
    classes : ``folder``: a mesh's class is the folder that it is in; ``mesh``: its own name

    Raises
    ------
    DataError
        There is none, or too many, or two of one name.
    SceneError
        A mesh cannot be read.
    """
    found = (p for pattern in ("*", "*/*") for p in folder.glob(pattern))
    files = sorted(islice((p for p in found if p.suffix.lower() in _SUFFIXES), _MOST_MESHES + 1))
    if not 1 <= len(files) <= _MOST_MESHES:
        raise DataError(
            f"{folder}: {'no' if not files else f'over {_MOST_MESHES}'} meshes ({', '.join(_SUFFIXES)}) in it and its "
            f"folders; a data set takes 1 to {_MOST_MESHES}"
        )
    out = []
    for path in files:
        name = printable(path.relative_to(folder).with_suffix("").as_posix())
        vertices, faces = read_mesh(path, f"{folder.name}: {name}")
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        extent = float((high - low).max())
        if not 0.0 < extent <= _MOST_EXTENT:  # not so for NaN either
            raise DataError(
                f"{path}: the mesh extends over {extent:g} m, which is not above 0 and up to {_MOST_EXTENT:g} m; "
                "meshes are in metres"
            )
        foot = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
        kind = printable(path.stem if classes == "mesh" else path.parent.name)
        out.append(InstanceMesh(name, kind, vertices - foot, faces))
    names = [mesh.name for mesh in out]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DataError(f"{folder}: two meshes are named {twice}; rename one")
    return tuple(out)


def hull(points: F64) -> F64:
    """Convex hull (n, 2) of points (m, 2), m, counter-clockwise; that of a plate on edge is 2 mm wide."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        around = _HALF_LINE * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
        wide = (points[:, None] + around).reshape(-1, 2)
        return np.asarray(wide[ConvexHull(wide).vertices])


def turn_points(points: F64, heading: float) -> F64:
    """Points (n, 2 or 3) turned counter-clockwise about z by an angle, rad."""
    c, s = np.cos(heading), np.sin(heading)
    out = np.array(points, dtype=np.float64)
    out[:, :2] = points[:, :2] @ np.array([[c, s], [-s, c]])
    return out


def separation(first: F64, second: F64) -> float:
    """Largest distance, m, between convex polygons (n, 2) along a normal of their sides; negative where they overlap.

    At most their distance: equal to it where the nearest points lie on a side, less where both are corners.
    """
    sides = np.concatenate([np.roll(p, -1, axis=0) - p for p in (first, second)])
    normal = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1)[:, None]
    a, b = first @ normal.T, second @ normal.T
    return float(np.maximum(b.min(axis=0) - a.max(axis=0), a.min(axis=0) - b.max(axis=0)).max())


def box(size: Sequence[float]) -> tuple[F64, I32]:
    """Closed box (8, 3) m and (12, 3), its foot about the origin, outward normals."""
    x, y, z = size
    corner = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0.0, 1.0)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))]
    return corner * np.array([x, y, z]), np.array(faces, dtype=np.int32)


def crown(radius: float, height: float, generator: np.random.Generator) -> tuple[F64, I32]:
    """Lumpy crown of a tree of a height, m: an ellipsoid that begins at a quarter of it."""
    vertices, faces = sphere(1.0, 0.08)
    lumps = 1.0 + 0.1 * generator.standard_normal(len(vertices)).clip(-2.0, 2.0)
    half = 0.375 * height
    scaled = vertices * lumps[:, None] * np.array([radius, radius, half])
    scaled[:, 2] *= half / np.abs(scaled[:, 2]).max()
    return scaled + np.array([0.0, 0.0, height - half]), faces


def relief(extent: float, rms: float, length: float, generator: np.random.Generator) -> tuple[F64, I32]:
    """Square of ground with a Gaussian random height of Gaussian correlation, mean 0.

    Parameters
    ----------
    extent : side, m
    rms : standard deviation of the height, m
    length : correlation length, m: the correlation falls to exp(-1) there

    Raises
    ------
    DataError
        The square would take too many points.
    """
    from scipy.ndimage import gaussian_filter

    step = length / _PER_LENGTH
    n = int(np.ceil(extent / step)) + 1
    if n > _MOST_SIDE:
        raise DataError(
            f"[ground]: relief_length = {length:g} m on extent = {extent:g} m takes {n} x {n} points; the most is "
            f"{_MOST_SIDE} x {_MOST_SIDE}: give a greater length or a smaller extent"
        )
    # white noise filtered by exp(-2 x^2 / length^2) has the correlation exp(-x^2 / length^2)
    sigma = 0.5 * _PER_LENGTH
    pad = int(np.ceil(4.0 * sigma))
    white = generator.standard_normal((n + 2 * pad, n + 2 * pad))
    kernel = np.zeros((2 * pad + 1, 2 * pad + 1))
    kernel[pad, pad] = 1.0
    gain = float(np.sqrt((gaussian_filter(kernel, sigma, mode="constant", truncate=4.0) ** 2).sum()))
    height = gaussian_filter(white, sigma, mode="constant", truncate=4.0)[pad:-pad, pad:-pad] * (rms / gain)
    axis = np.linspace(-0.5 * extent, 0.5 * extent, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (
        part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
    )
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)
    return np.column_stack([x.ravel(), y.ravel(), height.ravel()]), faces


def lowest_under(ground: F64, outline: F64) -> float:
    """Lowest height, m, of the points of ground (n, 3) in and next to the bounds of an outline (m, 2), m."""
    step = np.sort(np.unique(ground[:, 0]))
    margin = float(step[1] - step[0])
    low, high = outline.min(axis=0) - margin, outline.max(axis=0) + margin
    inside = ((ground[:, :2] >= low) & (ground[:, :2] <= high)).all(axis=1)
    return float(ground[inside, 2].min(initial=np.inf)) if inside.any() else float(ground[:, 2].min())
