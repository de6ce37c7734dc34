"""The perfect electric conductor."""

from sarmitsuba.materials.named_materials import MATERIALS, NamedMaterial


class PerfectConductor(NamedMaterial):
    """Reflects everything at every angle."""

    name = "pec"
    title = "perfect electric conductor"
    pec = True

    def permittivity(self, frequency: float) -> complex:
        """Not used: the limit is taken analytically."""
        return 1.0 + 0.0j


MATERIALS.register(PerfectConductor())
