"""Paths over two diffuse scatterers: when they are simulated."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length

# name of the source, and of the effect and its flag
PAIRS, FLAG = "pairs", "diffuse_pairs"
# level above the tolerance up to which pairs are left out, dB: relative to all clutter, and in the strongest square of
# the ground. They only raise the level of the clutter smoothly: with the default tolerance of -40 dB by 0.04 dB, and by
# 0.4 dB in that square, about the calibration accuracy of a radar
WHOLE_DB, SQUARE_DB = 20.0, 30.0


@dataclass(frozen=True)
class PairLevel:
    """Power of pairs of diffuse scatterers: unbiased estimate from a random sample of pairs.

    Parameters
    ----------
    share : their power relative to that of single diffuse scattering
    error : standard error of ``share``
    strongest : power in the strongest square of the ground, relative to mean clutter of the same area
    square : m, side of the squares
    pairs : number of drawn pairs with an echo
    realisation_error : energy of the image's error by the random choice of the run's pairs, relative to the clutter
    cell : m, of the points from which the run's pairs are drawn
    cross : their cross-polar power relative to single diffuse scattering; 0 where the radar records none
    """

    share: float
    error: float
    strongest: float
    square: float
    pairs: int
    realisation_error: float
    cell: float
    cross: float = 0.0


class DiffusePairs(Effect):
    """Double diffuse scattering; off where no surface sees another, or where it hardly changes the clutter level."""

    name = FLAG
    title = "two diffuse scatterers in a row"
    documentation = "paths over two diffuse scatterers, from one to the other"
    off_when = (
        "no diffuse surface sees another, or the pilot finds that pairs hardly change the clutter level"
    )
    off_means = "no echoes of pairs of diffuse scatterers"
    hidden = "the second scatterer of a pair"
    rank = 65
    kernel_flags: ClassVar[Mapping[str, str]] = {
        FLAG: "pairs of diffuse scatterers, in a separate launch",
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
        level = context.measured.get(PAIRS)
        if not isinstance(level, PairLevel):
            if context.scene.settings.effects.get(self.name) == "off":
                return Assessment(False, "their power was not estimated", float("nan"))
            return Assessment(
                True,
                "diffuse surfaces may see each other; the power of pairs was not estimated",
                float("nan"),
            )
        if level.share == 0.0:
            return Assessment(False, "pilot: no diffuse surface sees another", -np.inf, measured=True)
        return _decide_by_level(level, context)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the separate launch of pairs."""
        return {FLAG: on and decided["diffuse"].on}


def _decide_by_level(level: PairLevel, context: SceneContext) -> Assessment:
    tolerance_db = context.tolerance_db
    share, square = (db_from_power(max(x, 1e-30)) for x in (level.share + 2.0 * level.error, level.strongest))
    mean = db_from_power(level.share)
    cross = db_from_power(max(level.cross, 1e-30))
    on = max(share, cross) > tolerance_db + WHOLE_DB or square > tolerance_db + SQUARE_DB
    found = (
        f"pilot: {level.pairs} pairs have {mean:.1f} dB of the clutter's power (+- "
        f"{100.0 * level.error / level.share:.0f} %), {square:.0f} dB in the strongest {length(level.square)} square"
    )
    if level.cross > 0.0:
        found += (
            f", {cross:.0f} dB of the cross-polar clutter"
            if np.isfinite(cross)
            else ", the only cross-polar return"
        )
    if on:
        why = f"{found}; error of the run's realisation of pairs {db_from_power(level.realisation_error):.0f} dB"
    else:
        limits = f"{tolerance_db + WHOLE_DB:.0f} and {tolerance_db + SQUARE_DB:.0f} dB"
        why = f"{found}; left out below {limits}, where they hardly change the clutter level"
    return Assessment(
        on, why, min(max(mean + _clutter_db(context), cross), 0.0), measured=context.pilot is not None
    )


def _clutter_db(context: SceneContext) -> float:
    """Clutter's share of the image's energy, dB; 0 without a pilot: the image may be nothing but clutter."""
    if context.pilot is None or context.pilot.clutter == 0.0:
        return 0.0
    return min(0.0, context.pilot.energy_db(slice(1, 3), 1, upper=True))


EFFECTS.register(DiffusePairs())
