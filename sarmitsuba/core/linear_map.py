"""Linear maps between complex arrays, each with its adjoint."""

from abc import ABC, abstractmethod

from sarmitsuba.core.arrays import C64


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
