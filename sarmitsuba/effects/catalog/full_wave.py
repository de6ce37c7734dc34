"""Full wave: surface currents of small metal bodies, solved by the method of moments."""

from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.errors import SceneError
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect

FULL_WAVE = "full_wave"


class FullWave(Effect):
    """Full wave; decided by ``rcs`` alone (:mod:`sarmitsuba.simulation.execution.solved_currents`): images follow rays.

    The radar cross section of perfect conductors of up to some 50 square wavelengths of surface is solved where ray
    optics is expected to err by more than 0.5 dB; ``on`` solves larger ones, as memory allows.
    """

    name = FULL_WAVE
    title = "solved surface currents"
    documentation = "surface currents of small metal bodies by the method of moments, in rcs"
    off_when = "always but in `rcs`, and there where ray optics is good to 0.5 dB, or the body is large"
    off_means = "ray optics: no waves that creep, travel or resonate"
    rank = 106
    at_key_pulses = False

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        scene = context.scene
        if scene.settings.effects.get(self.name) == "on":
            raise SceneError(
                f"{scene.name}: full_wave = on is of rcs alone: images follow rays; leave it out, or take rcs"
            )
        return Assessment(False, "images follow rays; rcs solves currents of small metal bodies", -np.inf)


EFFECTS.register(FullWave())
