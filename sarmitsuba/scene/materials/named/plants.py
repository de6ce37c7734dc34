"""Permittivity of living wood, for trunks, from its moisture."""

from dataclasses import dataclass

from sarmitsuba.scene.materials.named_materials import MATERIALS, NamedMaterial
from sarmitsuba.scene.materials.vegetation.permittivity import plant_permittivity


@dataclass(frozen=True)
class PlantMaterial(NamedMaterial):
    """Plant matter of one moisture, see :func:`sarmitsuba.scene.materials.vegetation.permittivity.plant_permittivity`.

    Parameters
    ----------
    name, title : see `NamedMaterial`
    moisture : gravimetric
    """

    name: str
    title: str
    moisture: float

    def permittivity(self, frequency: float) -> complex:
        """See the class."""
        return plant_permittivity(self.moisture, frequency)

    def note(self, frequency: float) -> str:
        """Warning outside the measured band."""
        if 0.2e9 <= frequency <= 20e9:
            return ""
        return f"Ulaby & El-Rayes measured plants from 0.2 to 20 GHz; extrapolated to {frequency / 1e9:g} GHz"


MATERIALS.register(PlantMaterial("fresh_wood", "living wood, half of it water (Ulaby & El-Rayes 1987)", 0.5))
