"""Persistent diffuse scatterers on rough surfaces."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.effects.text import names
from sarmitsuba.materials.diffuse import diffuse_tables


class Diffuse(Effect):
    """On where a material that rays can hit scatters diffusely: it is the clutter itself, no tolerance applies."""

    name = "diffuse"
    title = "diffuse scattering"
    rank = 10
    cost = 0.65

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        rough = [m.name for m in facts.materials if m.diffuse_law != "none"]
        if not rough:
            return Verdict(False, "no material scatters diffusely", -np.inf)
        error = 0.0
        if facts.pilot is not None and facts.pilot.total > 0:
            error = facts.pilot.energy_db(slice(1, 3), 1)
        return Verdict(True, f"diffuse law on {names(rough)}", error)

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """Laws that tell h from v need the plane of incidence; that is a property of the law, not an effect."""
        return {"diffuse": on, "polarised_diffuse": on and _polarised(facts)}


def _polarised(facts: Facts) -> bool:
    wavelength = facts.scene.radar.waveform.wavelength
    for m in facts.materials:
        if m.diffuse_law in ("small_perturbation", "iem"):  # the others treat h and v alike
            table = diffuse_tables(m, wavelength, 16)
            if not np.allclose(table.amplitude_h, table.amplitude_v, rtol=1e-3):
                return True
    return False


EFFECT = Diffuse()
