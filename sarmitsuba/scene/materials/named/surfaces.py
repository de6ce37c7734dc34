"""Surfaces by their everyday names: the permittivity of a material, with a roughness and clutter level of their own."""

from dataclasses import dataclass

from sarmitsuba.scene.materials.named_materials import MATERIALS, ConstantMaterial, NamedMaterial, Typical


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
