"""Spherical spreading inside the scene; without it every path has the spreading of the scene's middle."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict


class Spreading(Effect):
    """Off where ``1 / R^2`` is the same all over the scene and the aperture, to the tolerance."""

    name = "spreading"
    title = "spreading inside the scene"
    rank = 100

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        reference = np.linalg.norm(facts.corners[-1] - facts.scene.radar.track.center_position)
        distance = np.linalg.norm(facts.corners[:, None] - facts.antenna, axis=-1)
        change = float(np.abs((reference / distance) ** 2 - 1.0).max())
        error = 20.0 * float(np.log10(change)) if change > 0 else -np.inf
        if change <= facts.tolerance:
            return Verdict(False, f"1/R^2 varies by {100 * change:.2g} % only", error)
        return Verdict(True, f"1/R^2 varies by {100 * change:.2g} %", error)

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """A division by both legs at every hit."""
        return {"spreading": on}


EFFECT = Spreading()
