"""Diffuse law with constant sigma0."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import power_from_db
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface


class Constant(DiffuseLaw):
    """Constant sigma0, equal for hh and vv."""

    name = "constant"
    title = "sigma0 constant over angle"
    level = "sigma0"

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See the class."""
        sigma = np.full_like(theta, float(power_from_db(surface.diffuse_level_db)))
        return Sigma0(sigma, sigma)


LAWS.register(Constant())
