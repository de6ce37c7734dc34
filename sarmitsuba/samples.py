"""Array types of formulas evaluated by NumPy outside the kernels and by Dr.Jit inside them."""

from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray


class KernelArray(Protocol):
    """Numbers of a kernel, one per lane, as far as shared formulas use them; Dr.Jit's ``Float`` is one."""

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
        """Mask of the lanes where it holds."""
        ...

    def __ge__(self, other: float, /) -> object:
        """Mask of the lanes where it holds."""
        ...

    def __gt__(self, other: float, /) -> object:
        """Mask of the lanes where it holds."""
        ...


Samples = TypeVar("Samples", NDArray[np.float64], KernelArray)

__all__ = ["KernelArray", "Samples"]
