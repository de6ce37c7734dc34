"""Complex Gaussian scatterers, the source of speckle."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue


class Speckle(Effect):
    """Speckle; on where anything is diffuse. Off gives every cell the same modulus and a random phase.

    The mean square of ``g - g / |g|`` for a unit complex Gaussian g is ``2 - sqrt(pi)``, -6.4 dB.
    """

    name = "speckle"
    title = "Gaussian scatterers"
    documentation = (
        "persistent random reflectivity of the diffuse scatterers; off: equal modulus, random phase"
    )
    off_when = "nothing is diffuse"
    off_means = "scatterers of equal modulus and random phase"
    rank = 50
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "speckle": "complex Gaussian scatterers; off gives each cell the same modulus and a random phase",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        if not decided["diffuse"].on:
            return Assessment(False, "nothing diffuse", -np.inf)
        return Assessment(True, "diffuse scatterers are random", db_from_power(2.0 - np.sqrt(np.pi)))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Box-Muller on the cell's hash."""
        return {"speckle": on}


EFFECTS.register(Speckle())
