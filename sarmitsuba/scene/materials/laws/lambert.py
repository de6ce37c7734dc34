"""Lambert's law: diffuse scattering of equal radiance in all directions."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import power_from_db
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0, Surface


class Lambert(DiffuseLaw):
    r""":math:`\sigma^0 = 4 A \cos^2\theta` for an albedo ``A``, equal for hh and vv."""

    name = "lambert"
    title = "sigma0 = 4 A cos^2(theta), equal radiance in all directions"
    level = "sigma0 at normal incidence, 4 times the albedo"

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See the class."""
        albedo = float(power_from_db(surface.diffuse_level_db)) / 4.0
        sigma = np.asarray(4.0 * np.asarray(albedo) * np.cos(theta) ** 2)
        notes = []
        if albedo > 1.0 + 1e-9:
            notes.append(
                f"diffuse_level_db = {surface.diffuse_level_db:g} dB is an albedo of {albedo:.3g}, above 1; "
                "give at most 6.02 dB"
            )
        return Sigma0(sigma, sigma, notes=tuple(notes))


LAWS.register(Lambert())
