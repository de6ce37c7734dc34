"""Coherent loss of rough surfaces."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.effects.text import length


class Roughness(Effect):
    """Off where every rms height is too small for ``1 - exp(-2 (k s cos)^2)`` to count, or nothing is coherent."""

    name = "roughness"
    title = "coherent loss by roughness"
    rank = 40
    cost = 0.03

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        height = max((m.rms_height for m in facts.materials), default=0.0)
        if height == 0.0:
            return Verdict(False, "every surface is smooth", -np.inf)
        if not decided["max_depth"].on and not decided["coherent"].on:
            return Verdict(False, "nothing reflects and nothing returns coherently", -np.inf)
        loss = -np.expm1(-2.0 * (facts.wavenumber * height) ** 2)  # at normal incidence, the most
        error = 20.0 * float(np.log10(loss))
        rough = f"rms height up to {length(height)}"
        if error <= facts.tolerance_db:
            return Verdict(False, f"{rough} takes {error:.0f} dB of the amplitude", error)
        return Verdict(True, rough, error)

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """An exponential at every closing and reflection."""
        return {"roughness": on}


EFFECT = Roughness()
