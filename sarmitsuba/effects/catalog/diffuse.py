"""Persistent diffuse scatterers on rough surfaces."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.context import Context
from sarmitsuba.effects.registry import Assessment, Decision, Effect
from sarmitsuba.effects.text import names
from sarmitsuba.materials.diffuse import diffuse_tables


class Diffuse(Effect):
    """On where a material that rays can hit scatters diffusely: it is the clutter itself, no tolerance applies."""

    name = "diffuse"
    title = "diffuse scattering"
    rank = 10
    cost = 0.65

    def assess(self, context: Context, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        rough = [m.name for m in context.materials if m.diffuse_law != "none"]
        if not rough:
            return Assessment(False, "no material scatters diffusely", -np.inf)
        error = 0.0
        if context.pilot is not None and context.pilot.total > 0:
            error = context.pilot.energy_db(slice(1, 3), 1)
        return Assessment(True, f"diffuse law on {names(rough)}", error)

    def flags(self, on: bool, context: Context, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """Laws that tell h from v need the plane of incidence; that is a property of the law, not an effect."""
        return {"diffuse": on, "polarised_diffuse": on and _polarised(context)}


def _polarised(context: Context) -> bool:
    wavelength = context.scene.radar.waveform.wavelength
    for m in context.materials:
        if m.diffuse_law in ("small_perturbation", "iem"):  # the others treat h and v alike
            table = diffuse_tables(m, wavelength, 16)
            if not np.allclose(table.amplitude_h, table.amplitude_v, rtol=1e-3):
                return True
    return False


EFFECT = Diffuse()
