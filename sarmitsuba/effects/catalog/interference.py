"""Interference by emitters on the ground."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.scene import Scene


class Interference(Effect):
    """Signals of emitters on the ground; on where a file of them is given."""

    name = "interference"
    title = "interference"
    documentation = "signals of emitters on the ground"
    off_when = "no interference_file is given"
    off_means = "echoes alone"
    rank = 142
    at_key_pulses = False
    of_receiver = True

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        emitters = context.scene.radar.emitters
        if emitters is None:
            return Assessment(False, "no emitter", -np.inf)
        n = emitters.kind.size
        return Assessment(True, f"{n} emitter{'s' if n > 1 else ''}", float("nan"))

    def without(self, scene: Scene) -> Scene:
        """Scene without emitters."""
        return replace(scene, radar=replace(scene.radar, emitters=None))


EFFECTS.register(Interference())
