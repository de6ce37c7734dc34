"""Named materials: permittivity by name, with registration of user materials."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from sarmitsuba.core.constants import VACUUM_PERMITTIVITY
from sarmitsuba.core.parameters import Param
from sarmitsuba.core.registry import Registry


@dataclass(frozen=True)
class Typical:
    """Typical surface of a named material, see :func:`sarmitsuba.scene.materials.typical.typical_surface`.

    Parameters
    ----------
    rms_height : m
    law : diffuse law; ``none``: a mirror
    level_db : of the law; at 10 GHz for ``constant_gamma``
    absorbs : whether power that the mirror loses to the roughness may be lost; False for metal
    """

    rms_height: float
    law: str
    level_db: float
    absorbs: bool = True

    @property
    def smooth(self) -> bool:
        """Whether it is a mirror."""
        return self.law == "none"


class NamedMaterial(ABC):
    """Material selected in a scene file by name: ``<string name="material" value="NAME"/>``.

    Attributes
    ----------
    name : in the scene file
    title : half a line for tables: kind and source of the values
    pec : perfect electric conductor, without permittivity
    thickness : m, of a slab; 0: a half space
    sheet_resistance : ohm per square, of a slab's coating; 0: none
    typical : surface where a scene gives none; None: that of the name in ``TYPICAL``
    """

    name: str
    title: str
    pec: bool = False
    thickness: float = 0.0
    sheet_resistance: float = 0.0
    typical: Typical | None = None

    @property
    def parameters(self) -> tuple[Param, ...]:
        """Parameters of the material (of the kind ``float``, with a default), accepted by ``radar_material``."""
        return ()

    def at(self, values: Mapping[str, float]) -> "NamedMaterial":
        """The material with values of its ``parameters``, by name."""
        return self

    @abstractmethod
    def permittivity(self, frequency: float) -> complex:
        """Relative permittivity ``eps' - j eps''`` (``eps'' >= 0``) at a frequency, Hz."""

    def note(self, frequency: float) -> str:
        """Warning where the values are invalid at a frequency, Hz; else empty."""
        return ""


@dataclass(frozen=True)
class ConstantMaterial(NamedMaterial):
    """Material of constant permittivity.

    Parameters
    ----------
    name, title : see `NamedMaterial`
    value : relative permittivity, ``eps' - j eps''``
    """

    name: str
    title: str
    value: complex

    def permittivity(self, frequency: float) -> complex:
        """See the class."""
        return self.value


MATERIALS: Registry[NamedMaterial] = Registry("material", NamedMaterial, "sarmitsuba.scene.materials.named")


def material_parameters() -> tuple[Param, ...]:
    """Parameters of the named materials; several may share one."""
    return tuple(sorted({p for entry in MATERIALS for p in entry.parameters}, key=lambda p: p.name))


def permittivity_from_conductivity(real: float, conductivity: float, frequency: float) -> complex:
    r"""Relative permittivity of a lossy material.

    .. math:: \epsilon = \epsilon' - j \sigma / (2 \pi f \epsilon_0)

    Parameters
    ----------
    real : relative permittivity, real part
    conductivity : S/m
    frequency : Hz
    """
    return complex(real, -conductivity / (2.0 * math.pi * frequency * VACUUM_PERMITTIVITY))
