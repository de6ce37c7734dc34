"""Complex Gaussian scatterers, the source of speckle."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.context import Context
from sarmitsuba.effects.registry import Assessment, Decision, Effect


class Speckle(Effect):
    """On where anything is diffuse; without it every cell has the same modulus and a phase of its own.

    The mean square of ``g - g / |g|`` for a unit complex Gaussian g is ``2 - sqrt(pi)``, -6.4 dB.
    """

    name = "speckle"
    title = "Gaussian scatterers"
    rank = 50

    def assess(self, context: Context, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        if not decided["diffuse"].on:
            return Assessment(False, "nothing diffuse", -np.inf)
        return Assessment(True, "diffuse cells carry speckle", 10.0 * float(np.log10(2.0 - np.sqrt(np.pi))))

    def flags(self, on: bool, context: Context, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """Box-Muller on the cell's hash."""
        return {"speckle": on}


EFFECT = Speckle()
