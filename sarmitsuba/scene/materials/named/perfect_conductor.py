"""Perfect electric conductor."""

from sarmitsuba.scene.materials.named_materials import MATERIALS, NamedMaterial


class PerfectConductor(NamedMaterial):
    """Perfect electric conductor: total reflection at every angle."""

    name = "pec"
    title = "perfect electric conductor"
    pec = True

    def permittivity(self, frequency: float) -> complex:
        """Not used: the limit is taken analytically."""
        return 1.0 + 0.0j


MATERIALS.register(PerfectConductor())
