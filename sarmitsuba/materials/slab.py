"""How much of a wave goes through a material that is a slab."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba import theory
from sarmitsuba.materials.material import Material

# cosines of incidence that stand for all angles, and the power, two ways, below which a wall is opaque: no receiver
# knows it from noise and sidelobes
COSINES = np.linspace(0.05, 1.0, 39)
OPAQUE = 1e-8


def through(
    material: Material, wavelength: float, cos_theta: ArrayLike = COSINES
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Field behind a slab over that without it, TE and TM, at cosines of incidence; zero of a half space."""
    cosines = np.asarray(cos_theta, dtype=np.float64)
    if material.thickness <= 0.0 or material.pec:
        none = np.zeros(cosines.shape, dtype=np.complex128)
        return none, none
    return theory.slab_insertion(
        cosines, material.permittivity, material.thickness, wavelength, material.sheet_resistance
    )


def most_power_through(material: Material, wavelength: float, cos_theta: ArrayLike = COSINES) -> float:
    """Largest share of the power that goes through twice, at any of the angles."""
    return float(max(np.abs(t).max() for t in through(material, wavelength, cos_theta)) ** 4)


def lets_through(material: Material, wavelength: float) -> bool:
    """Whether what lies behind can be seen at all."""
    return not material.invisible and most_power_through(material, wavelength) > OPAQUE


__all__ = ["COSINES", "lets_through", "most_power_through", "through"]
