"""How many bounces are followed."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import PilotResult, SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue

# bounces followed when neither a proof nor a pilot says how many matter, and no two faces look at each other between
# which more could. Rays that leave the scene cost nothing more, so a small run loses little by it
DEFAULT_DEPTH = 8
# most that may be asked for
DEEPEST = 1000


class MaxDepth(Effect):
    """Bounce depth: as asked, one by proof, or as many as the pilot finds above the tolerance."""

    name = "max_depth"
    title = "bounces beyond the first"
    off_when = "one bounce is proven, or the pilot finds no more"
    off_means = "no loop, no reflection, no virtual antenna"
    rank = 0
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "multi_bounce": "more than one hit; off leaves the loop and the reflection out",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        settings = context.scene.settings
        if settings.method == "raster":
            return Assessment(False, "the raster method has one bounce", float("nan"), 1)
        asked = settings.max_depth
        # the proof is of what reflects; what goes through a slab may be hit from its far side
        proof = "" if context.seen_through else context.shape.single_bounce
        if asked:
            if proof and asked > 1:
                return Assessment(False, f"asked for {asked}, but {proof}", -np.inf, 1)
            return Assessment(
                asked > 1, "set by the user", 0.0 if asked > 1 else float("nan"), asked, asked=True
            )
        if proof:
            return Assessment(False, proof, -np.inf, 1)
        if context.pilot is None:
            why = (
                f"one bounce is not proven and the run is too short for a pilot: {DEFAULT_DEPTH} are followed"
            )
            return Assessment(True, why, 0.0, DEFAULT_DEPTH)
        return _measured(context.pilot, context.tolerance_db)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Without it the loop and the reflection are left out."""
        depth = decided[self.name].value or DEFAULT_DEPTH
        # what goes through a slab needs the loop, even for one bounce
        return {"multi_bounce": depth > 1 or bool(context.seen_through)}


def _measured(pilot: PilotResult, tolerance_db: float) -> Assessment:
    """Fewest bounces after which what is left stays below the tolerance, two standard errors included."""
    depth = pilot.enough(tolerance_db) or pilot.n_orders
    over = "clutter" if pilot.clutter > 0 else "peak"
    if depth == pilot.n_orders:
        why = f"bounce {depth}, the last that the pilot follows, still returns {pilot.energy_db(3, depth):.0f} dB"
    elif depth == 1:
        seen = pilot.n_patches + pilot.n_features
        why = (
            f"{seen} pilot patches: further bounces return {_text(pilot.energy_db(3, 2, upper=True))} of the energy "
            f"at most"
        )
    else:
        why = (
            f"pilot: from bounce {depth} on {_text(pilot.energy_db(3, depth))} of the energy, strongest cell "
            f"{_text(pilot.cell_db(3, depth))} over the {over}; beyond it "
            f"{_text(pilot.energy_db(3, depth + 1, upper=True))} at most and {_text(pilot.cell_db(3, depth + 1))}"
        )
    # the last bounce holds at most all; where none is followed, the pilot's bound is of what is left out
    error = 0.0 if depth > 1 else pilot.energy_db(3, 2, upper=True)
    return Assessment(depth > 1, why, error, depth, measured=True)


def _text(value_db: float) -> str:
    return f"{value_db:.0f} dB" if np.isfinite(value_db) else "nothing"


EFFECTS.register(MaxDepth())
