"""Shadow rays from the second hit on."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect, effects
from sarmitsuba.effects.flags import FlagValue


class Visibility(Effect):
    """Shadow rays; off for one bounce (the first hit sees the antenna) and where no face can occlude.

    On where scatterers at known positions may be occluded by a mesh, and for edges unless one bounce is proven.
    """

    name = "visibility"
    title = "shadow rays"
    documentation = "shadow rays, which test whether the antenna is visible from a hit"
    off_when = "one bounce, or no face can occlude; and no scatterers other than the mesh"
    off_means = "no shadow rays"
    rank = 110
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "visibility": "shadow rays from the second hit on",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        if context.scene.has_sources and context.materials:
            return Assessment(True, "the mesh can hide wires, volumes or points", float("nan"))
        depth = decided["max_depth"]
        hidden = next(
            (e.hidden for e in effects() if e.hidden and e.name in decided and decided[e.name].on), ""
        )
        if not depth.on and (depth.source == "fact" or not hidden):
            return Assessment(False, "the antenna is visible from the first hit", -np.inf)
        if context.shape.open_sight:
            return Assessment(False, "no face stands between any other and the antenna", -np.inf)
        if not depth.on:
            return Assessment(True, f"{hidden} can be hidden from the antenna", float("nan"))
        # a hidden return may be stronger than all visible ones
        return Assessment(True, "later hits can be hidden from the antenna", float("nan"))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the shadow rays."""
        return {"visibility": on}


EFFECTS.register(Visibility())
