"""Diffuse law with constant gamma: sigma0 proportional to the cosine of incidence."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import power_from_db
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface

# gamma sqrt(cos_i cos_s) integrates over the hemisphere to gamma / 3 of the power incident at normal incidence
_MOST_GAMMA = 3.0


class ConstantGamma(DiffuseLaw):
    r""":math:`\sigma^0 = \gamma \cos\theta`, equal for hh and vv."""

    name = "constant_gamma"
    title = "sigma0 = gamma cos(theta)"
    level = "gamma"

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See the class."""
        gamma = float(power_from_db(surface.diffuse_level_db))
        sigma = np.asarray(gamma * np.cos(theta))
        notes = []
        if gamma > _MOST_GAMMA:
            notes.append(
                f"diffuse_level_db = {surface.diffuse_level_db:g} dB returns more power than is incident; give at "
                "most 4.77 dB"
            )
        return Sigma0(sigma, sigma, notes=tuple(notes))


LAWS.register(ConstantGamma())
