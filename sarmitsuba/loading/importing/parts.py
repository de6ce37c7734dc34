"""Triangles collected by building, part of the scene and material."""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.parameters import printable
from sarmitsuba.scene.geometry import PART_MARK

Mesh = tuple[F64, I32]


def _join(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    start = np.cumsum([0, *(len(v) for v, _ in meshes[:-1])])
    faces = np.concatenate([f + n for (_, f), n in zip(meshes, start, strict=True)])
    return np.concatenate([v for v, _ in meshes]), faces.astype(np.int32)


class Parts:
    """Meshes by building, part (``walls``, ``roofs`` ...) and name of the material."""

    def __init__(self) -> None:
        self._meshes: dict[tuple[str, str, str], list[Mesh]] = {}
        self._building = ""
        self._buildings: Counter[str] = Counter()

    @contextmanager
    def of_building(self, name: str) -> Iterator[None]:
        """Parts added within are those of one building, of this name or, where it is taken, of it with a number."""
        plain = printable(name).replace(PART_MARK, " ")
        self._buildings[plain] += 1
        n = self._buildings[plain]
        self._building = plain if n == 1 else f"{plain} ({n})"
        try:
            yield
        finally:
            self._building = ""

    def add(self, part: str, material: str, vertices: ArrayLike, faces: ArrayLike) -> None:
        """Add a mesh: vertices (n, 3) m, faces (m, 3); one without faces is ignored."""
        f = np.asarray(faces, dtype=np.int32).reshape(-1, 3)
        if len(f):
            key = (self._building, part, material)
            self._meshes.setdefault(key, []).append((np.asarray(vertices, dtype=np.float64), f))

    def __iter__(self) -> Iterator[tuple[str, str, F64, I32]]:
        """Part, material, vertices and faces of one mesh per pair, of all buildings, in order of addition."""
        joined: dict[tuple[str, str], list[Mesh]] = {}
        for (_, part, material), meshes in self._meshes.items():
            joined.setdefault((part, material), []).extend(meshes)
        for (part, material), meshes in joined.items():
            yield part, material, *_join(meshes)

    def shapes(self) -> Iterator[tuple[str, str, F64, I32]]:
        """Name, material, vertices and faces of one mesh per building, part and material, in order of addition.

        A part of a building is named ``BUILDING/PART``; others by their part and a number.
        """
        used: Counter[str] = Counter()
        for (building, part, material), meshes in self._meshes.items():
            name = f"{building}{PART_MARK}{part}" if building else printable(part)
            n = used[name]
            used[name] += 1
            yield (f"{name} {n}" if n or not building else name), material, *_join(meshes)

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
