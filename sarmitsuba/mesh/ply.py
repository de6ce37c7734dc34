"""Meshes to PLY files."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike


def write_ply(path: Path, vertices: ArrayLike, faces: ArrayLike) -> None:
    """Write a binary PLY file with double-precision vertices, so that what is read back is exact.

    Parameters
    ----------
    path : file to write
    vertices : (n_v, 3) float, m
    faces : (n_f, 3) int
    """
    v = np.asarray(vertices, dtype="<f8")
    rows = np.zeros(len(np.asarray(faces)), dtype=[("n", "u1"), ("corner", "<i4", (3,))])
    rows["n"] = 3
    rows["corner"] = faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {v.shape[0]}"]
    header += [f"property double {axis}" for axis in "xyz"]
    header += [f"element face {rows.size}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + v.tobytes() + rows.tobytes())


__all__ = ["write_ply"]
