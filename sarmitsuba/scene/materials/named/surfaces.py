"""Named materials: surfaces by their everyday names, panes, conductors, plastics, wood.

A surface has the permittivity of a material, with a roughness and clutter level. Living wood has that of trunks, from
its moisture.
"""

from dataclasses import dataclass

from sarmitsuba.scene.materials.named_materials import MATERIALS, ConstantMaterial, NamedMaterial, Typical
from sarmitsuba.scene.materials.vegetation.canopy import plant_permittivity


@dataclass(frozen=True)
class NamedSurface(NamedMaterial):
    """Surface of another material.

    Parameters
    ----------
    name, title, typical : see `NamedMaterial`
    base : material of its permittivity
    """

    name: str
    title: str
    base: str
    typical: Typical

    def permittivity(self, frequency: float) -> complex:
        """That of the base material."""
        return MATERIALS[self.base].permittivity(frequency)

    def note(self, frequency: float) -> str:
        """Note of the base material."""
        return MATERIALS[self.base].note(frequency)


class Snow(ConstantMaterial):
    """Dry snow, whose permittivity is constant from 1 to 20 GHz to a few percent."""

    typical = Typical(0.01, "constant_gamma", -13.0)


_METAL = Typical(0.001, "lambert", -4.0, absorbs=False)
for _name, _base, _typical in (
    ("soil", "medium_dry_ground", Typical(0.02, "constant_gamma", -12.0)),
    ("grass", "medium_dry_ground", Typical(0.02, "constant_gamma", -11.0)),
    ("gravel", "concrete", Typical(0.01, "constant_gamma", -15.0)),
    ("asphalt", "asphalt_concrete", Typical(0.003, "constant_gamma", -23.0)),
    ("leaf", "fresh_wood", Typical(0.02, "constant_gamma", -9.0)),
    ("tile", "brick", Typical(0.008, "lambert", -7.0)),
    ("water", "fresh_water", Typical(0.002, "constant_gamma", -30.0)),
    ("metal_sheet", "metal", _METAL),
    ("car_paint", "metal", _METAL),
):
    MATERIALS.register(NamedSurface(_name, f"permittivity of {_base}", _base, _typical))
# eps' = 1 + 1.9 rho, rho in g/cm3 (Hallikainen, Ulaby and Abdelrazik, IEEE Trans. AP 34 (11) 1986)
MATERIALS.register(Snow("snow", "dry snow of 0.35 g/cm3 (Hallikainen et al. 1986)", 1.67 - 0.001j))


@dataclass(frozen=True)
class GlassSlab(NamedMaterial):
    """Slab of glass of ITU-R P.2040.

    Parameters
    ----------
    name, title, thickness, sheet_resistance : see `NamedMaterial`
    """

    name: str
    title: str
    thickness: float
    sheet_resistance: float = 0.0

    def permittivity(self, frequency: float) -> complex:
        """See the class."""
        return MATERIALS["glass"].permittivity(frequency)

    def note(self, frequency: float) -> str:
        """Note of glass."""
        return MATERIALS["glass"].note(frequency)


MATERIALS.register(GlassSlab("window_glass", "single glazing, 4 mm of ITU-R P.2040's glass", 0.004))
# hard coatings of tin oxide have about 15 ohm per square, soft ones of silver 2 to 6
MATERIALS.register(
    GlassSlab("low_e_glass", "single glazing with a silver coating of 4 ohm per square", 0.004, 4.0)
)


class PerfectConductor(NamedMaterial):
    """Perfect electric conductor: total reflection at every angle."""

    name = "pec"
    title = "perfect electric conductor"
    pec = True

    def permittivity(self, frequency: float) -> complex:
        """Not used: the limit is taken analytically."""
        return 1.0 + 0.0j


MATERIALS.register(PerfectConductor())


MATERIALS.register(ConstantMaterial("plastic", "polyethylene and similar", 2.25 - 0.01j))


@dataclass(frozen=True)
class PlantMaterial(NamedMaterial):
    """Plant matter of one moisture, see :func:`sarmitsuba.scene.materials.vegetation.canopy.plant_permittivity`.

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
