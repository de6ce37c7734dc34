"""Paths over two diffuse scatterers."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import PairLevel, SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length

# how far above the tolerance pairs may be that are left out: of all clutter, and in the square of the ground that has
# most, dB. They are an even haze, no line and no point: all they change is a level. With the usual tolerance of -40 dB
# that is 0.04 dB of the clutter's, and 0.4 dB in that square, about what a calibrated radar's own level is known to
WHOLE_DB, SQUARE_DB = 20.0, 30.0


class DiffusePairs(Effect):
    """Off where no surface sees another, or where a realisation of pairs hardly changes the level of the clutter."""

    name = "diffuse_pairs"
    title = "two diffuse scatterers in a row"
    documentation = "paths over two diffuse scatterers, from one to the other"
    off_when = "no surface sees another, or the pilot finds too little of it to change a level"
    off_means = "no realisation of pairs, no launch of theirs"
    rank = 65
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "diffuse_pairs": "pairs of diffuse scatterers, a launch of their own beside that of the rays",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        depth = decided["max_depth"]
        if not decided["diffuse"].on:
            return Assessment(False, "nothing diffuse", -np.inf)
        if not depth.on and depth.source != "pilot":  # a pilot of mirrors says nothing of pairs
            return Assessment(
                False, f"one bounce: {depth.why}", -np.inf if depth.source == "fact" else np.nan
            )
        level = context.pairs
        if level is None:
            if context.scene.settings.effects.get(self.name) == "off":
                return Assessment(False, "what they return was not looked at", float("nan"))
            return Assessment(
                True, "surfaces may see each other, and no realisation of pairs was looked at", float("nan")
            )
        if level.share == 0.0:
            return Assessment(False, "pilot: no surface that scatters sees another", -np.inf, measured=True)
        return _measured(level, context.tolerance_db)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Nothing in the rays' kernel."""
        return {"diffuse_pairs": on and decided["diffuse"].on}


def _measured(level: PairLevel, tolerance_db: float) -> Assessment:
    share, square = (10.0 * float(np.log10(x)) for x in (level.share + 2.0 * level.error, level.strongest))
    mean = 10.0 * float(np.log10(level.share))
    cross = 10.0 * float(np.log10(max(level.cross, 1e-30)))
    on = max(share, cross) > tolerance_db + WHOLE_DB or square > tolerance_db + SQUARE_DB
    found = (
        f"pilot: {level.pairs} pairs return {mean:.1f} dB of the clutter (+- "
        f"{100.0 * level.error / level.share:.0f} %), {square:.0f} dB in the strongest {length(level.square)} square"
    )
    if level.cross > 0.0:
        found += (
            f", {cross:.0f} dB of the cross-polar clutter"
            if np.isfinite(cross)
            else ", all that is cross-polar"
        )
    if on:
        why = f"{found}; error of the run's realisation of pairs {10.0 * np.log10(level.realisation_error):.0f} dB"
    else:
        limits = f"{tolerance_db + WHOLE_DB:.0f} and {tolerance_db + SQUARE_DB:.0f} dB"
        why = f"{found}; left out below {limits}, where they hardly change a level"
    return Assessment(on, why, min(max(mean, cross), 0.0), measured=True)


EFFECTS.register(DiffusePairs())
