"""Permittivity over frequency: what a material's was taken from, so that it can be taken again at another frequency."""

from dataclasses import dataclass

from sarmitsuba.materials.named_materials import MATERIALS, permittivity_from_conductivity


@dataclass(frozen=True)
class Dispersion:
    """Relative permittivity as a function of frequency.

    Parameters
    ----------
    kind : name in ``MATERIALS``; empty: ``real`` and ``conductivity`` tell
    values : name and value of what the named material has of its own; left out: its defaults
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


__all__ = ["Dispersion"]
