"""Types of arrays for formulas shared by NumPy and Dr.Jit kernels."""

from typing import Protocol, TypeVar

from sarmitsuba.core.arrays import F64


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
