"""Scatterers of kinds of a user's own."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.scene import Scene


class OwnScatterers(Effect):
    """On where the scene holds scatterers of a kind that an extension registers; off leaves them out."""

    name = "own_scatterers"
    title = "scatterers of kinds of one's own"
    documentation = "returns of the scatterers of kinds that extensions register"
    off_when = "the scene has none"
    off_means = "they return nothing"
    rank = 137

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        targets = context.scene.scatterers
        if not targets:
            return Assessment(False, "none", -np.inf)
        kinds = dict.fromkeys(target.kind for target in targets)
        counts = [f"{sum(t.kind == kind for t in targets)} {kind}" for kind in kinds]
        return Assessment(True, ", ".join(counts), 0.0)

    def without(self, scene: Scene) -> Scene:
        """The scene without them."""
        return dataclasses.replace(scene, scatterers=())


EFFECTS.register(OwnScatterers())
