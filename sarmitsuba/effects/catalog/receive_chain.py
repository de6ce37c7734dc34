"""Errors of the receiver behind its thermal noise."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.text import names
from sarmitsuba.scene.scene import Scene


class Chain(Effect):
    """Receive chain: quantisation, saturation, demodulator, oscillator, gain, lost pulses, distorted polarisations."""

    name = "receive_chain"
    title = "receive chain"
    documentation = "quantisation and other errors of the receiver"
    off_when = "no parameter of it is given"
    off_means = "an ideal receiver"
    rank = 141
    at_key_pulses = False
    of_receiver = True

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        chain = context.scene.radar.chain
        if chain is None:
            return Assessment(False, "an ideal receiver", -np.inf)
        return Assessment(True, names(chain.given), float("nan"))

    def without(self, scene: Scene) -> Scene:
        """Scene with an ideal receiver."""
        return replace(scene, radar=replace(scene.radar, chain=None))


EFFECTS.register(Chain())
