"""Thermal noise of the receiver."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.constants import BOLTZMANN
from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.scene.spec import Scene


class Noise(Effect):
    """On where a noise temperature is given.

    The noise-equivalent RCS of a focused cell is ``k T / T_p R^4 / (K^2 N)`` for N pulses.
    """

    name = "noise"
    title = "receiver noise"
    rank = 140

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        radar = facts.scene.radar
        if radar.noise_temperature <= 0:
            return Verdict(False, "no noise temperature given", -np.inf)
        distance = float(np.linalg.norm(facts.corners[-1] - radar.track.center_position))
        power = BOLTZMANN * radar.noise_temperature / radar.waveform.pulse_width
        rcs = power * distance**4 / (radar.amplitude_constant**2 * radar.track.n_pulses)
        level = 10.0 * float(np.log10(rcs))
        error = float("nan")
        if facts.pilot is not None and facts.pilot.total > 0:
            reference = facts.pilot.clutter if facts.pilot.clutter > 0 else float(facts.pilot.peak[3].max())
            error = 10.0 * float(np.log10(rcs / reference))
        return Verdict(True, f"{radar.noise_temperature:g} K: {level:.0f} dBsm a cell", error)

    def without(self, scene: Scene) -> Scene:
        """A receiver at zero kelvin."""
        return replace(scene, radar=replace(scene.radar, noise_temperature=0.0))


EFFECT = Noise()
