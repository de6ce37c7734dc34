"""Window glass slabs."""

from dataclasses import dataclass

from sarmitsuba.scene.materials.named_materials import MATERIALS, NamedMaterial


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
