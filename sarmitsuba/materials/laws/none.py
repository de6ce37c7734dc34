"""Law without diffuse return: the surface only reflects."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface


class NoDiffuse(DiffuseLaw):
    """No diffuse return."""

    name = "none"
    title = "no diffuse return"
    scatters = False
    blocks_as_vacuum = False

    def sigma0(self, surface: Surface, wavelength: float, theta: NDArray[np.float64]) -> Sigma0:
        """Zero at every angle."""
        return Sigma0.none(theta)


LAWS.register(NoDiffuse())
