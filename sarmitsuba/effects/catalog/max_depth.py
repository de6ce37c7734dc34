"""Number of bounces that are traced."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import PilotResult, SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue

# bounces traced without a proof and without a pilot, in scenes without opposite faces. Rays that have left the scene
# cost nothing, so this is cheap in a small run
DEFAULT_DEPTH = 8
# largest value that may be set
DEEPEST = 1000


class MaxDepth(Effect):
    """Number of bounces: as set, one by proof, or as many as the pilot finds above the tolerance."""

    name = "max_depth"
    title = "bounces beyond the first"
    off_when = "proof that rays hit once only, or the pilot finds no further returns"
    off_means = "one bounce, no reflections"
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
        # the proof is for reflecting surfaces; a slab that transmits may be hit from its far side
        proof = "" if context.seen_through else context.shape.single_bounce
        if asked:
            if proof and asked > 1:
                return Assessment(False, f"set to {asked}, but {proof}", -np.inf, 1)
            return Assessment(
                asked > 1, "set by the user", 0.0 if asked > 1 else float("nan"), asked, asked=True
            )
        if proof:
            return Assessment(False, proof, -np.inf, 1)
        if context.pilot is None:
            why = f"more than one bounce is possible and the run is too short for a pilot: {DEFAULT_DEPTH} are traced"
            return Assessment(True, why, 0.0, DEFAULT_DEPTH)
        return _find_depth(context.pilot, context.tolerance_db)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the bounce loop and the reflection."""
        depth = decided[self.name].value or DEFAULT_DEPTH
        # transmission through slabs needs the loop, even for one bounce
        return {"multi_bounce": depth > 1 or bool(context.seen_through)}


def _find_depth(pilot: PilotResult, tolerance_db: float) -> Assessment:
    """Least number of bounces after which the rest is below the tolerance, two standard errors included."""
    depth = pilot.enough(tolerance_db) or pilot.n_orders
    over = "clutter" if pilot.clutter > 0 else "peak"
    if depth == pilot.n_orders:
        why = f"bounce {depth}, the last that the pilot traces, still has {pilot.energy_db(3, depth):.0f} dB"
    elif depth == 1:
        seen = pilot.n_patches + pilot.n_features
        why = (
            f"pilot, {seen} patches: further bounces have at most {_text(pilot.left_out_db(1))} of the energy"
        )
    else:
        why = (
            f"pilot: energy of bounces from {depth} on {_text(pilot.energy_db(3, depth))} (strongest cell "
            f"{_text(pilot.cell_db(3, depth))} over the {over}), after {depth} at most "
            f"{_text(pilot.left_out_db(depth))} ({_text(pilot.cell_db(3, depth + 1))})"
        )
    # the last bounce holds at most all energy; with one bounce, the pilot's bound is that of the bounces left out
    error = 0.0 if depth > 1 else pilot.left_out_db(1)
    return Assessment(depth > 1, why, error, depth, measured=True)


def _text(value_db: float) -> str:
    return f"{value_db:.0f} dB" if np.isfinite(value_db) else "zero"


EFFECTS.register(MaxDepth())
