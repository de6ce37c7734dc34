"""Diffuse returns behind mirrors: the reversed path and the reciprocal path back along the chain."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue


class DiffuseDouble(Effect):
    """Reciprocal diffuse paths; off without diffuse surfaces or second bounces, or where the pilot finds too little.

    The effect doubles the amplitude of diffuse returns behind mirrors and adds those back along the chain, so its share
    of the energy is at most that of both.
    """

    name = "diffuse_double"
    title = "reciprocal diffuse paths behind mirrors"
    documentation = "diffuse return after a mirror chain, with its reciprocal path"
    off_when = "no diffuse hit behind a mirror, or too little of it"
    off_means = "no reversed path, no reciprocal path back along the chain"
    rank = 60
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "diffuse_double": "reversed and reciprocal paths of diffuse hits behind mirrors: two more echoes per hit",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        if not decided["diffuse"].on:
            return Assessment(False, "nothing diffuse", -np.inf)
        if not decided["max_depth"].on:
            return Assessment(False, "no diffuse hit after a mirror reflection", -np.inf)
        pilot = context.pilot
        if pilot is None or pilot.total == 0.0:
            return Assessment(True, "diffuse hits after mirror reflections", 0.0)
        energy, cell = pilot.energy_db(slice(1, 3), 2, upper=True), pilot.cell_db(slice(1, 3), 2)
        if energy <= context.tolerance_db and cell <= pilot.cell_limit_db(context.tolerance_db):
            return Assessment(False, f"pilot: {energy:.0f} dB of the energy at most", energy, measured=True)
        share = pilot.energy_db(slice(1, 3), 2)
        return Assessment(
            True, f"pilot: {share:.0f} dB of the energy, strongest cell {cell:.0f} dB over the clutter", 0.0
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the reversed and reciprocal contributions at every hit."""
        return {"diffuse_double": on}


EFFECTS.register(DiffuseDouble())
