"""Triangles collected by part of the scene and by material."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32

Mesh = tuple[F64, I32]


class Parts:
    """Meshes by part (``walls``, ``roofs`` ...) and name of the material."""

    def __init__(self) -> None:
        self._meshes: dict[tuple[str, str], list[Mesh]] = {}

    def add(self, part: str, material: str, vertices: ArrayLike, faces: ArrayLike) -> None:
        """Add a mesh: vertices (n, 3) m, faces (m, 3); one without faces is ignored."""
        f = np.asarray(faces, dtype=np.int32).reshape(-1, 3)
        if len(f):
            self._meshes.setdefault((part, material), []).append((np.asarray(vertices, dtype=np.float64), f))

    def __iter__(self) -> Iterator[tuple[str, str, F64, I32]]:
        """Part, material, vertices and faces of one mesh per pair; ground first, then in order of addition."""
        for (part, material), meshes in self._meshes.items():
            start = np.cumsum([0, *(len(v) for v, _ in meshes[:-1])])
            faces = np.concatenate([f + n for (_, f), n in zip(meshes, start, strict=True)])
            yield part, material, np.concatenate([v for v, _ in meshes]), faces.astype(np.int32)

    @property
    def n_triangles(self) -> int:
        """Number of triangles of all meshes."""
        return sum(len(f) for meshes in self._meshes.values() for _, f in meshes)

    def bounds(self) -> F64:
        """Lowest and highest coordinates, (2, 3) float64, m."""
        every = [v for meshes in self._meshes.values() for v, _ in meshes]
        return np.array(
            [np.min([v.min(axis=0) for v in every], axis=0), np.max([v.max(axis=0) for v in every], axis=0)]
        )
