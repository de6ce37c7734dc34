"""Cross-polar diffuse return."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import names


class Depolarisation(Effect):
    """Cross-polar diffuse return; on where a diffuse material has a cross-polar ratio visible in the recorded channels.

    A ratio r changes the co-polar amplitude by about ``sqrt(r)``; in a cross-polar channel it is the clutter itself.
    """

    name = "depolarisation"
    title = "cross-polar diffuse return"
    documentation = "cross-polar diffuse return, at each material's cross_polar_ratio_db"
    off_when = "no cross-polar ratio that is visible in the recorded channels"
    off_means = "one complex number per scatterer instead of a matrix"
    rank = 80
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "depolarisation": "two more Gaussians per cell and a full scattering matrix",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        ratios = {m.name: m.cross_polar_ratio_db for m in context.materials if m.scatters}
        strongest = max(ratios.values(), default=-np.inf)
        if not decided["diffuse"].on or not np.isfinite(strongest):
            return Assessment(False, "no material has a diffuse cross-polar return", -np.inf)
        given = names([n for n, r in ratios.items() if np.isfinite(r)])
        if decided["cross_polarisation"].on:
            return Assessment(True, f"cross-polar ratio on {given}", 0.0)
        if strongest <= context.tolerance_db:
            return Assessment(
                False, f"cross-polar ratio at most {strongest:.0f} dB, no cross-polar channel", strongest
            )
        return Assessment(True, f"cross-polar ratio up to {strongest:.0f} dB on {given}", strongest)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Two more Gaussians per cell and a full scattering matrix."""
        return {"depolarisation": on}


EFFECTS.register(Depolarisation())
