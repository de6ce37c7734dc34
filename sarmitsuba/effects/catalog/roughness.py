"""Coherent loss of rough surfaces."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length


class Roughness(Effect):
    """Roughness loss; off where ``1 - exp(-2 (k s cos)^2)`` is negligible for all surfaces, or nothing is coherent."""

    name = "roughness"
    title = "coherent loss by roughness"
    documentation = "loss of coherent reflection to the rms height"
    off_when = "the coherent loss by every rms height is below the tolerance"
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
        loss = -np.expm1(-2.0 * (context.wavenumber * height) ** 2)  # largest, at normal incidence
        error = db_from_amplitude(loss)
        rough = f"rms height up to {length(height)}"
        if error <= context.tolerance_db:
            return Assessment(False, f"{rough}: coherent loss {error:.0f} dB of the amplitude", error)
        return Assessment(True, rough, float("nan"))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """An exponential at every closing and reflection."""
        return {"roughness": on}


EFFECTS.register(Roughness())
