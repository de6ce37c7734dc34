"""Thermal noise of the receiver."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.core.constants import BOLTZMANN
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.scene import Scene


class Noise(Effect):
    """Receiver noise; on where a noise temperature is given.

    The noise-equivalent RCS of a focused cell is ``k T / T_p R^4 / (K^2 N)`` for N pulses.
    """

    name = "noise"
    title = "receiver noise"
    documentation = "thermal noise of the receiver"
    off_when = "no noise temperature"
    off_means = "no noise"
    rank = 140
    at_key_pulses = False
    of_receiver = True

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        radar = context.scene.radar
        if radar.noise_temperature <= 0:
            return Assessment(False, "no noise temperature given", -np.inf)
        distance = float(np.linalg.norm(context.corners[-1] - radar.track.center_position))
        power = BOLTZMANN * radar.noise_temperature / radar.waveform.pulse_width
        rcs = power * distance**4 / (radar.amplitude_constant**2 * radar.track.n_pulses)
        level = db_from_power(rcs)
        error = float("nan")
        if context.pilot is not None and context.pilot.total > 0:
            reference = (
                context.pilot.clutter if context.pilot.clutter > 0 else float(context.pilot.peak[3].max())
            )
            error = db_from_power(rcs / reference)
        return Assessment(
            True, f"{radar.noise_temperature:g} K: noise-equivalent RCS {level:.0f} dBsm per cell", error
        )

    def without(self, scene: Scene) -> Scene:
        """Scene with a noise-free receiver."""
        return replace(scene, radar=replace(scene.radar, noise_temperature=0.0))


EFFECTS.register(Noise())
