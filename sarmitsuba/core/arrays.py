"""Arrays: types named for their elements, boxes along the axes, checks for NaN and infinity, and linear maps.

Shapes and units are stated where arrays are used. A linear map has its adjoint. Formulas shared by NumPy and Dr.Jit
kernels have types of arrays that serve both.
"""

from abc import ABC, abstractmethod
from itertools import product
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.errors import DataError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
# two 32-bit floats, and two of 64 bits
C64 = NDArray[np.complex64]
C128 = NDArray[np.complex128]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


def box_of_each(points: F64) -> tuple[F64, F64]:
    """Least and greatest coordinates (n, k) of a few points each (n, few, k); much faster than a reduction."""
    low = high = points[:, 0]
    for column in np.moveaxis(points[:, 1:], 1, 0):
        low, high = np.minimum(low, column), np.maximum(high, column)
    return low, high


def boxes_meet(points: F64, box: F64) -> NDArray[np.bool_]:
    """Whether the boxes of a few points each (n, few, 3) meet a box (2, 3), (n,)."""
    low, high = box_of_each(points)
    meets = np.ones(len(points), dtype=bool)
    for axis in range(points.shape[2]):
        meets &= (low[:, axis] <= box[1, axis]) & (high[:, axis] >= box[0, axis])
    return meets


def box_corners(box: F64) -> F64:
    """Corners (8, 3) of a box (2, 3): least and greatest coordinates, z fastest."""
    return np.array(list(product(*np.asarray(box).T)))


def unit_rows(vectors: F64) -> F64:
    """Vectors (..., k) over their lengths; one of length zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def sum_energy(values: NDArray[np.complexfloating]) -> float:
    """Sum of squared magnitudes, added up in float64."""
    return float(np.sum(values.real**2 + values.imag**2, dtype=np.float64))


def sum_energies(planes: NDArray[np.complexfloating]) -> F64:
    """Energy (n,) of each plane (n, ...), see :func:`sum_energy`."""
    axes = tuple(range(1, planes.ndim))
    return np.asarray(np.sum(planes.real**2 + planes.imag**2, axis=axes, dtype=np.float64))


def all_finite(data: NDArray[np.complexfloating] | NDArray[np.floating]) -> bool:
    """Whether every number is finite, tested by a sum of squares in one pass without a temporary array."""
    flat = np.ascontiguousarray(data).reshape(-1)
    real = flat.view(flat.real.dtype)
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(np.dot(real, real)):
            return True
    return bool(np.isfinite(real).all())  # the squares of large numbers overflow


def check_pulses(data: C64, where: str = "") -> None:
    """Raise an error for echoes with NaN or infinite numbers.

    Parameters
    ----------
    data : (n_layers, n_pulses, n_fast)
    where : start of the message, such as a file's name and a colon

    Raises
    ------
    DataError
        A pulse holds NaN or infinite numbers.
    """
    if all(all_finite(plane) for plane in data):
        return
    bad = [i for i in range(data.shape[1]) if not np.isfinite(data[:, i]).all()]
    raise DataError(
        f"{where}{len(bad)} of {data.shape[1]} pulses hold NaN or infinite numbers, the first is pulse {bad[0]}; set "
        "them to zero"
    )


class LinearMap(ABC):
    r"""Linear map A of complex arrays, planned once, with its adjoint.

    .. math:: \langle y, A x \rangle = \langle A^H y, x \rangle, \quad \langle u, v \rangle = \sum_i u_i^* v_i
    """

    @abstractmethod
    def forward(self, values: C64) -> C64:
        """Result A x of the map."""

    @abstractmethod
    def adjoint(self, values: C64) -> C64:
        """Result A^H y of its adjoint."""


class KernelArray(Protocol):
    """Array with one number per lane of a kernel, such as Dr.Jit's ``Float``; its operations in shared formulas."""

    def __add__(self, other: "float | KernelArray", /) -> "KernelArray":
        """Sum."""
        ...

    def __radd__(self, other: float, /) -> "KernelArray":
        """Sum."""
        ...

    def __sub__(self, other: "float | KernelArray", /) -> "KernelArray":
        """Difference."""
        ...

    def __rsub__(self, other: float, /) -> "KernelArray":
        """Difference."""
        ...

    def __mul__(self, other: "float | KernelArray", /) -> "KernelArray":
        """Product."""
        ...

    def __rmul__(self, other: float, /) -> "KernelArray":
        """Product."""
        ...

    def __truediv__(self, other: "float | KernelArray", /) -> "KernelArray":
        """Quotient."""
        ...

    def __pow__(self, other: int, /) -> "KernelArray":
        """Power."""
        ...

    def __abs__(self) -> "KernelArray":
        """Magnitude."""
        ...

    def __le__(self, other: float, /) -> object:
        """Mask of the lanes in which it is true."""
        ...

    def __ge__(self, other: float, /) -> object:
        """Mask of the lanes in which it is true."""
        ...

    def __gt__(self, other: float, /) -> object:
        """Mask of the lanes in which it is true."""
        ...


Samples = TypeVar("Samples", F64, KernelArray)
