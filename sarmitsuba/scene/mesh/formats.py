"""Mesh files: triangles of Wavefront OBJ in linear time and memory, plain binary PLY, and Mitsuba's ``serialized``.

PLY is also written. ``serialized`` is compressed by zlib.
"""

import re
import struct
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.machine.regular_files import check_unpacked, read_bytes


@dataclass(frozen=True, eq=False)
class ObjMesh:
    """Surfaces of an OBJ file.

    Parameters
    ----------
    vertices : (n_v, 3) float64, all vertices of the file
    faces : (n_f, 3) int64, in the order of the file, polygons as fans; checked against the number of vertices
    group : (n_f,) int64, number of the face's material; -1 before the first ``usemtl``
    materials : names, in order of first use by ``usemtl``
    owner : (n_f,) int64, number of the face's object
    objects : names by ``o``, or by ``g`` in a file without ``o``; empty for faces before the first
    """

    vertices: F64
    faces: I64
    group: I64
    materials: tuple[str, ...]
    owner: I64
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
    # names and their numbers, and the number of every face's, by ``o`` and by ``g``
    named: dict[bytes, dict[bytes, int]] = {b"o": {b"": 0}, b"g": {b"": 0}}
    owners: dict[bytes, list[int]] = {b"o": [], b"g": []}
    current = {b"o": 0, b"g": 0}
    group = -1
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
            owners[b"o"].append(current[b"o"])
            owners[b"g"].append(current[b"g"])
        elif kind == b"usemtl" and len(words) > 1:
            group = materials.setdefault(b" ".join(words[1:]), len(materials))
        elif kind in named:
            current[kind] = named[kind].setdefault(b" ".join(words[1:]), len(named[kind]))
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
    polygon = np.repeat(np.arange(len(number)), fans)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = (np.cumsum(number) - number)[polygon]
    faces = np.stack([index[first], index[first + step + 1], index[first + step + 2]], axis=-1)
    by = b"o" if len(named[b"o"]) > 1 else b"g"
    return ObjMesh(
        vertices,
        faces.reshape(-1, 3),
        np.array(groups, dtype=np.int64)[polygon],
        tuple(name.decode("utf-8", "replace") for name in materials),
        np.array(owners[by], dtype=np.int64)[polygon],
        tuple(name.decode("utf-8", "replace") for name in named[by]),
    )


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


_FORMAT = 0x041C
_VERSION_3, _VERSION_4 = 3, 4
_NORMALS, _TEXTURE, _COLOURS, _DOUBLE = 0x0001, 0x0002, 0x0008, 0x2000
# values of a vertex beside its position, by flag
_BESIDE = {_NORMALS: 3, _TEXTURE: 2, _COLOURS: 3}
_LONGEST_NAME = 4096  # bytes of a shape's name
# most bytes of an unpacked mesh: a scene takes 25 times as much memory, and triangles compress tenfold at best
_LEAST_UNPACKED, _UNPACKED_PER_BYTE = 10_000_000, 20
_PIECE = 1 << 16  # bytes unpacked at a time


def read_serialized(path: Path, index: int) -> tuple[F64, I64]:
    """Read the triangles of one shape of a file.

    The format is that of Mitsuba's manual: format and version, then a zlib stream of flags, name (version 4), the
    numbers of vertices and faces, the arrays of the vertices, and three indices a face. The file ends with the offsets
    of the shapes and their number.

    Parameters
    ----------
    path : of a regular file
    index : of the shape, from 0

    Returns
    -------
    vertices : (n_v, 3) float64, of single or double precision in the file
    faces : (n_f, 3) int64, not checked against the number of vertices

    Raises
    ------
    ValueError
        The file has another format or is truncated.
    DataError
        Its header states far more data than a file of its size holds.
    """
    data = read_bytes(path)
    start = _start(data, index)
    form, version = struct.unpack_from("<HH", data, start) if start + 4 <= len(data) else (0, 0)
    if form != _FORMAT or version not in (_VERSION_3, _VERSION_4):
        raise ValueError("it has another format or version")
    stream = _Stream(data, start + 4)
    (flags,) = struct.unpack("<I", stream.take(4))
    if version == _VERSION_4:
        stream.skip_name()
    n_vertices, n_faces = struct.unpack("<QQ", stream.take(16))
    kind = np.dtype("<f8" if flags & _DOUBLE else "<f4")
    each = np.dtype("<u8" if n_vertices > 0xFFFFFFFF else "<u4")
    beside = n_vertices * kind.itemsize * sum(n for flag, n in _BESIDE.items() if flags & flag)
    places, corners = 3 * n_vertices * kind.itemsize, 3 * n_faces * each.itemsize
    check_unpacked(places + beside + corners, len(data), _LEAST_UNPACKED + _UNPACKED_PER_BYTE * len(data))
    vertices = np.frombuffer(stream.take(places), kind).reshape(-1, 3).astype(np.float64)
    stream.take(beside)
    faces = np.frombuffer(stream.take(corners), each).reshape(-1, 3).astype(np.int64)
    return vertices, faces


def _start(data: bytes, index: int) -> int:
    """Offset of a shape."""
    if index == 0:
        return 0
    (count,) = struct.unpack_from("<I", data, len(data) - 4) if len(data) >= 4 else (0,)
    if not 0 <= index < count:
        raise ValueError(f"shape_index = {index}, but the file has {count} shapes (counted from 0)")
    (version,) = struct.unpack_from("<H", data, 2)
    form = "<Q" if version == _VERSION_4 else "<I"
    place = len(data) - 4 - struct.calcsize(form) * (count - index)
    if place < 0:
        raise ValueError("it is truncated")
    return int(struct.unpack_from(form, data, place)[0])


class _Stream:
    """Compressed bytes, unpacked on demand."""

    def __init__(self, data: bytes, start: int) -> None:
        self._data, self._at = data, start
        self._unpack = zlib.decompressobj()

    def take(self, size: int) -> bytes:
        parts, left = [], size
        while left:
            packed = self._unpack.unconsumed_tail
            if not packed:
                packed = self._data[self._at : self._at + _PIECE]
                self._at += len(packed)
            try:
                part = self._unpack.decompress(packed, left)
            except zlib.error as error:
                raise ValueError(str(error)) from None
            if not part and (self._unpack.eof or not packed):
                raise ValueError("it is truncated")
            parts.append(part)
            left -= len(part)
        return b"".join(parts)

    def skip_name(self) -> None:
        for _ in range(_LONGEST_NAME):
            if self.take(1) == b"\x00":
                return
        raise ValueError(f"a name of more than {_LONGEST_NAME} bytes")
