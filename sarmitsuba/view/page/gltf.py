"""Triangles of a scene as binary glTF, small enough to be embedded in a page."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scatterers import targets_by_kind
from sarmitsuba.scene.scene import Scene

# most faces drawn smoothly by a browser with software rendering; larger meshes are simplified on a grid
MOST_FACES = 400_000
# grid of stored positions, m: far below any pixel, and the trailing zeros compress well
GRID = 2.0**-10


@dataclass(frozen=True)
class PageMesh:
    """Mesh of a scene as drawn in a page.

    Parameters
    ----------
    glb : binary glTF, one mesh per pair of mesh and material, named ``<mesh number>/<material number>``; positions are
        in m from ``center``, axes east, north, up
    n_faces : number of triangles
    merged : edge of the grid on which vertices were merged, m; 0: all triangles are those of the simulation
    """

    glb: bytes
    n_faces: int
    merged: float


def page_mesh(geometry: Geometry, center: F64, most_faces: int = MOST_FACES) -> PageMesh:
    """Triangles of a scene as binary glTF.

    Parameters
    ----------
    geometry : in any frame
    center : (3,) float64, m, in the same frame; the page's origin
    most_faces : largest number of faces; above it vertices are merged on a grid

    Notes
    -----
    Merging vertices in the cells of a grid (vertex clustering) keeps large surfaces and removes details smaller than a
    cell. It changes the drawing, not the simulation.
    """
    vertices, faces, kept, edge = _fewer(geometry.vertices - center, geometry.faces, most_faces)
    mesh_of = np.searchsorted(geometry.mesh_face_offset, kept, side="right") - 1
    material_of = geometry.face_material[kept]
    scene = trimesh.Scene()
    pairs = np.stack([mesh_of, material_of], axis=1)
    for mesh, material in np.unique(pairs, axis=0):
        mine = faces[(mesh_of == mesh) & (material_of == material)]
        used, renumbered = np.unique(mine, return_inverse=True)
        part = trimesh.Trimesh(vertices[used], renumbered.reshape(-1, 3), process=False)
        name = f"{mesh}/{material}"
        scene.add_geometry(part, node_name=name, geom_name=name)
    glb = b"" if not len(pairs) else bytes(scene.export(file_type="glb", include_normals=False))
    return PageMesh(glb, int(faces.shape[0]), edge)


def draw_scene(scene: Scene) -> tuple[Geometry, tuple[str, ...]]:
    """Geometry that a page draws of a scene, in the file's frame, and the names of its materials.

    It consists of the meshes, and of one mesh for every kind of scatterers that is drawn, such as wires.
    """
    geometry, names = scene.geometry, tuple(material.name for material in scene.materials)
    vertices, faces = [geometry.vertices], [geometry.faces]
    for kind, targets in targets_by_kind(scene.scatterers).items():
        found = kind.drawn(targets, 8.0 * GRID)
        if found is None:
            continue
        names = (*names, kind.shown_as)
        faces.append(sum(map(len, vertices)) + found[1])
        vertices.append(found[0])
        more = len(found[1])
        geometry = replace(
            geometry,
            face_material=np.append(geometry.face_material, np.full(more, len(names) - 1, dtype=np.int32)),
            face_group=np.append(geometry.face_group, np.full(more, -1, dtype=np.int32)),
            mesh_names=(*geometry.mesh_names, kind.plural),
            mesh_face_offset=np.append(geometry.mesh_face_offset, geometry.mesh_face_offset[-1] + more),
            mesh_convex=(),
            mesh_motion=(),
        )
    at = np.concatenate(vertices) + scene.offset
    return replace(geometry, vertices=at, faces=np.concatenate(faces).astype(np.int32)), names


def _fewer(
    vertices: F64, faces: I32, most_faces: int
) -> tuple[F64, NDArray[np.integer], NDArray[np.integer], float]:
    """Vertices on a grid, remaining faces, their previous numbers, and the edge of the grid (0: not merged)."""
    numbers = np.arange(faces.shape[0])
    if faces.shape[0] <= most_faces:
        return np.asarray(np.round(vertices / GRID) * GRID), faces.astype(np.int64), numbers, 0.0
    edge = GRID
    size = float(np.ptp(vertices, axis=0).max())
    while True:
        edge = max(2.0 * edge, size / 65536.0)
        cells, cell_of = np.unique(np.round(vertices / edge).astype(np.int64), axis=0, return_inverse=True)
        merged = cell_of.reshape(-1)[faces]
        a, b, c = merged.T
        alive = np.flatnonzero((a != b) & (b != c) & (c != a))
        if alive.size <= most_faces:
            return np.asarray(cells * edge, dtype=np.float64), merged[alive], numbers[alive], edge
