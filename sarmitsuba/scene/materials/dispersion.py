"""Permittivity over frequency: source of a material's permittivity, for evaluation at other frequencies."""

from dataclasses import dataclass

from sarmitsuba.scene.materials.named_materials import MATERIALS, permittivity_from_conductivity


@dataclass(frozen=True)
class Dispersion:
    """Relative permittivity as a function of frequency.

    Parameters
    ----------
    kind : name in ``MATERIALS``; empty: given by ``real`` and ``conductivity``
    values : name and value of the named material's own parameters; missing ones have their defaults
    real : relative permittivity, real part
    conductivity : S/m
    """

    kind: str = ""
    values: tuple[tuple[str, float], ...] = ()
    real: float = 1.0
    conductivity: float = 0.0

    def permittivity(self, frequency: float) -> complex:
        """Relative permittivity ``eps' - j eps''`` at a frequency, Hz."""
        if self.kind:
            return MATERIALS[self.kind].at(dict(self.values)).permittivity(frequency)
        return permittivity_from_conductivity(self.real, self.conductivity, frequency)
