"""Triangles of Mitsuba's binary mesh format ``serialized``, which is compressed by zlib."""

import struct
import zlib
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.machine.regular_files import check_unpacked, read_bytes

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
