"""Scatterers of extensions' kinds."""

import dataclasses
from collections import Counter
from collections.abc import Mapping

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.scatterers import is_own
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
        counts = Counter(target.kind for target in context.scene.scatterers if is_own(target))
        if not counts:
            return Assessment(False, "none", -np.inf)
        return Assessment(True, ", ".join(f"{count} {kind}" for kind, count in counts.items()), 0.0)

    def without(self, scene: Scene) -> Scene:
        """The scene without them."""
        left = tuple(target for target in scene.scatterers if not is_own(target))
        return dataclasses.replace(scene, scatterers=left)


EFFECTS.register(OwnScatterers())
