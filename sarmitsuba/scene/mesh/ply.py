"""PLY meshes: writing, and fast reading of the plain binary layout."""

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.machine.regular_files import read_bytes

# positions and any other numbers of vertices, x, y and z first, and faces as lists only (texture coordinates of corners
# split vertices): the layout that exporters of triangles write
_HEADER = re.compile(
    rb"ply\r?\nformat binary_little_endian 1\.0\r?\n"
    rb"((?:comment [^\n]*\n|obj_info [^\n]*\n)*)"
    rb"element vertex (\d{1,10})\r?\n"
    rb"((?:property (?:float|float32|double|float64|uchar|uint8)"
    rb" \w+\r?\n)+)"
    rb"element face (\d{1,10})\r?\n"
    rb"property list (?:uchar|uint8) (int|uint|int32|uint32) vertex_ind(?:ices|ex)\r?\n"
    rb"end_header\r?\n"
)
_LONGEST_HEADER = 8192  # bytes
_TYPES = {
    **dict.fromkeys((b"float", b"float32"), "<f4"),
    **dict.fromkeys((b"double", b"float64"), "<f8"),
    **dict.fromkeys((b"uchar", b"uint8"), "u1"),
}


_FACE = np.dtype([("n", "u1"), ("corner", "<i4", (3,))])


def write_ply(path: Path, vertices: ArrayLike, faces: ArrayLike) -> None:
    """Write a binary PLY file with double-precision vertices, so that reading it back is exact.

    Parameters
    ----------
    path : file to write
    vertices : (n_v, 3) float, m
    faces : (n_f, 3) int
    """
    v = np.asarray(vertices, dtype="<f8")
    rows = np.zeros(len(np.asarray(faces)), dtype=_FACE)
    rows["n"] = 3
    rows["corner"] = faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {v.shape[0]}"]
    header += [f"property double {axis}" for axis in "xyz"]
    header += [f"element face {rows.size}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + v.tobytes() + rows.tobytes())


def read_ply(path: Path) -> tuple[F64, I64] | None:
    """Read triangles of a binary file of the plain layout; None: the file has another layout.

    A city has thousands of small files, and this takes a tenth of the time per file that general readers take.

    Parameters
    ----------
    path : of an existing file

    Returns
    -------
    vertices : (n_v, 3) float64, unit and axes of the file
    faces : (n_f, 3) int64, not checked against the number of vertices
    """
    data = read_bytes(path)
    header = _HEADER.match(data, 0, _LONGEST_HEADER)
    layout = None if header is None else _vertex_layout(header[3])
    if header is None or layout is None:
        return None
    kind, stride = layout
    n_vertices, n_faces = int(header[2]), int(header[4])
    first_face = header.end() + n_vertices * stride
    # a count byte of three, and three indices; lists of other lengths give another size
    if len(data) != first_face + 13 * n_faces:
        return None
    rows = np.frombuffer(data, _FACE, n_faces, first_face)
    if not (rows["n"] == 3).all():
        return None
    corners = np.ndarray((n_vertices, 3), kind, data, header.end(), (stride, kind.itemsize))
    faces = rows["corner"]
    if header[5].startswith(b"u"):
        faces = faces.view("<u4")
    return corners.astype(np.float64), faces.astype(np.int64)


@lru_cache(maxsize=64)
def _vertex_layout(properties: bytes) -> "tuple[np.dtype[np.float64], int] | None":
    """Type of the coordinates and bytes per vertex, from the lines of the header; None: not of the plain layout."""
    kinds, names = zip(*(line.split()[1:] for line in properties.splitlines()), strict=True)
    plain = names[:3] == (b"x", b"y", b"z") and len(set(kinds[:3])) == 1 and len(set(names)) == len(names)
    kind = np.dtype(_TYPES[kinds[0]])
    if not plain or kind.itemsize == 1:
        return None
    return kind, sum(np.dtype(_TYPES[each]).itemsize for each in kinds)
