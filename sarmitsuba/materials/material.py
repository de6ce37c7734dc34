"""The electromagnetic surface of a half space, as data."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

DiffuseLaw = Literal[
    "none",
    "lambert",
    "constant",
    "constant_gamma",
    "kirchhoff",
    "small_perturbation",
    "iem",
    "roughness",
]

DIFFUSE_LAWS: tuple[DiffuseLaw, ...] = (
    "none",
    "lambert",
    "constant",
    "constant_gamma",
    "kirchhoff",
    "small_perturbation",
    "iem",
    "roughness",
)


@dataclass(frozen=True)
class Material:
    """Electromagnetic surface of a half space, at the carrier frequency.

    Parameters
    ----------
    name : unique in a scene
    pec : perfect electric conductor; ``permittivity`` is then ignored
    permittivity : relative, ``eps' - j eps''`` with ``eps'' >= 0`` (time convention exp(+j w t))
    rms_height : m; standard deviation of the surface height, reduces the coherent reflection
    diffuse_law : how the incoherent return depends on angle; ``roughness`` is Lambert's law with the power
        that the coherent wave lost to the rms height
    diffuse_level_db : sigma0 (``constant``), gamma (``constant_gamma``) or 4 * albedo (``lambert``, sigma0 at
        normal incidence), dB
    correlation_length : m; of the surface height, for the laws derived from a height spectrum
    cross_polar_ratio_db : cross- over co-polar diffuse power, dB; -inf for none
    invisible : neither reflects nor blocks (permittivity 1)

    Notes
    -----
    Ignores transmission through the surface, thickness, anisotropy and magnetic materials.
    """

    name: str
    pec: bool = False
    permittivity: complex = 1.0 + 0.0j
    rms_height: float = 0.0
    diffuse_law: DiffuseLaw = "none"
    diffuse_level_db: float = -np.inf
    correlation_length: float = 0.0
    cross_polar_ratio_db: float = -np.inf
    invisible: bool = False


__all__ = ["DIFFUSE_LAWS", "DiffuseLaw", "Material"]
