"""Coherent loss of rough surfaces."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length


class Roughness(Effect):
    """Off where every rms height is too small for ``1 - exp(-2 (k s cos)^2)`` to count, or nothing is coherent."""

    name = "roughness"
    title = "coherent loss by roughness"
    documentation = "loss of coherent reflection to the rms height"
    off_when = "every rms height takes less than the tolerance from the wave"
    off_means = "no exponentials"
    rank = 40
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "roughness": "coherent loss of rough surfaces: an exponential at every closing and reflection",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        height = max((m.rms_height for m in context.materials), default=0.0)
        if height == 0.0:
            return Assessment(False, "every surface is smooth", -np.inf)
        mirrors = decided["max_depth"].on or context.scene.has_sources
        if not mirrors and not decided["coherent"].on:
            return Assessment(False, "nothing reflects and nothing returns coherently", -np.inf)
        loss = -np.expm1(-2.0 * (context.wavenumber * height) ** 2)  # at normal incidence, the most
        error = 20.0 * float(np.log10(loss))
        rough = f"rms height up to {length(height)}"
        if error <= context.tolerance_db:
            return Assessment(False, f"{rough} takes {error:.0f} dB of the amplitude", error)
        # what roughness takes may be more than what it leaves
        return Assessment(True, rough, float("nan"))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """An exponential at every closing and reflection."""
        return {"roughness": on}


EFFECTS.register(Roughness())
