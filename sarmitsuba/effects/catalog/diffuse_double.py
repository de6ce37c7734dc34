"""Diffuse hits behind mirrors: the reversed path and the way back along the chain."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict


class DiffuseDouble(Effect):
    """Off where nothing is diffuse, nothing bounces twice, or the pilot finds too little of it.

    It doubles the amplitude of diffuse returns behind mirrors and adds those that retrace their chain, so its share
    of the energy is at most that of both.
    """

    name = "diffuse_double"
    title = "reciprocal and retro diffuse paths"
    rank = 60
    cost = 0.26

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        if not decided["diffuse"].on:
            return Verdict(False, "nothing diffuse", -np.inf)
        if not decided["max_depth"].on:
            return Verdict(False, "no diffuse hit behind a mirror", -np.inf)
        pilot = facts.pilot
        if pilot is None or pilot.total == 0.0:
            return Verdict(True, "diffuse hits behind mirrors", 0.0)
        energy, cell = pilot.energy_db(slice(1, 3), 2, upper=True), pilot.cell_db(slice(1, 3), 2)
        if energy <= facts.tolerance_db and cell <= pilot.cell_limit_db(facts.tolerance_db):
            return Verdict(False, f"pilot: {energy:.0f} dB of the energy at most", energy, measured=True)
        share = pilot.energy_db(slice(1, 3), 2)
        return Verdict(
            True, f"pilot: {share:.0f} dB of the energy, strongest cell {cell:.0f} dB over the clutter", share
        )

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """A second operator and a third contribution at every hit."""
        return {"diffuse_double": on}


EFFECT = DiffuseDouble()
