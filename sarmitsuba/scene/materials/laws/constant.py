"""Simple diffuse laws: none, constant sigma0, constant gamma, Lambert.

Gamma is sigma0 over the cosine of incidence; Lambert's law has equal radiance in all directions.
"""

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
