"""Law without diffuse return: the surface only reflects."""

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface


class NoDiffuse(DiffuseLaw):
    """No diffuse return."""

    name = "none"
    title = "no diffuse return"
    scatters = False
    blocks_as_vacuum = False

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """Zero at every angle."""
        return Sigma0.none(theta)


LAWS.register(NoDiffuse())
