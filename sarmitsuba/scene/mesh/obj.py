"""Triangles of Wavefront OBJ files, in linear time and memory."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.machine.regular_files import read_bytes


@dataclass(frozen=True, eq=False)
class ObjMesh:
    """Surfaces of an OBJ file.

    Parameters
    ----------
    vertices : (n_v, 3) float64, all vertices of the file
    faces : (n_f, 3) int64, in the order of the file, polygons as fans; checked against the number of vertices
    group : (n_f,) int64, number of the face's material; -1 before the first ``usemtl``
    materials : names, in order of first use by ``usemtl``
    objects : name of the first object (``o``) with each material, last of faces without a material; empty without
    """

    vertices: F64
    faces: I64
    group: I64
    materials: tuple[str, ...]
    objects: tuple[str, ...]


def read_obj(path: Path) -> ObjMesh:
    """Read vertex positions and faces; texture coordinates, normals, colours, lines and curves are ignored.

    Raises
    ------
    ValueError
        A number is malformed, or a face refers to a missing vertex.
    """
    places: list[float] = []
    corners: list[int] = []
    # by face: number of corners, number of vertices before it (negative indices count from there), material
    counts: list[int] = []
    before: list[int] = []
    groups: list[int] = []
    materials: dict[bytes, int] = {}
    objects: dict[int, bytes] = {}
    group, current = -1, b""
    for row in read_bytes(path).replace(b"\\\r\n", b"").replace(b"\\\n", b"").split(b"\n"):
        words = row.split()
        kind = words[0] if words else b""
        if kind == b"v":
            if len(words) < 4:
                raise ValueError("a vertex has fewer than three numbers")
            places += map(float, words[1:4])
        elif kind == b"f":
            corners += [int(word.partition(b"/")[0]) for word in words[1:]]
            counts.append(len(words) - 1)
            before.append(len(places) // 3)
            groups.append(group)
            objects.setdefault(group, current)
        elif kind == b"usemtl" and len(words) > 1:
            group = materials.setdefault(b" ".join(words[1:]), len(materials))
        elif kind == b"o":
            current = b" ".join(words[1:])
    vertices = np.array(places, dtype=np.float64).reshape(-1, 3)
    number = np.array(counts, dtype=np.int64)
    try:
        index = np.array(corners, dtype=np.int64)
    except OverflowError:
        raise ValueError("a face refers to a missing vertex") from None
    index = np.where(index < 0, index + np.repeat(np.array(before, dtype=np.int64), number), index - 1)
    if index.size and not 0 <= index.min() <= index.max() < len(vertices):
        raise ValueError(f"a face refers to a missing vertex (the file has {len(vertices)})")
    # fans: the first corner with every two consecutive ones after it
    fans = np.maximum(number - 2, 0)
    owner = np.repeat(np.arange(len(number)), fans)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = (np.cumsum(number) - number)[owner]
    faces = np.stack([index[first], index[first + step + 1], index[first + step + 2]], axis=-1)
    return ObjMesh(
        vertices,
        faces.reshape(-1, 3),
        np.array(groups, dtype=np.int64)[owner],
        tuple(name.decode("utf-8", "replace") for name in materials),
        tuple(objects.get(i, b"").decode("utf-8", "replace") for i in (*range(len(materials)), -1)),
    )
