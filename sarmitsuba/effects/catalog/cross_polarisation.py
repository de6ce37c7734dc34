"""Cross-polar channels."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from sarmitsuba.core.errors import RadarError
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.scene.scene import Scene


class CrossPolarisation(Effect):
    """Cross-polar channels; on where the radar records one, off drops those channels from the data."""

    name = "cross_polarisation"
    title = "cross-polar channels"
    documentation = "channels with different transmit and receive polarisation"
    off_when = "the radar records no cross-polar channel"
    off_means = "no cross-polar channels in the data"
    rank = 70
    at_key_pulses = False
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "channels": "polarisation channels to record",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        channels = context.scene.radar.channels
        cross = [c for c in channels if c[0] != c[1]]
        if cross:
            return Assessment(True, f"the radar records {', '.join(channels)}", 0.0)
        return Assessment(False, f"the radar records only {', '.join(channels)}", -np.inf)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Channels to record."""
        return {"channels": context.scene.radar.channels if on else _co_polar(context.scene)}

    def without(self, scene: Scene) -> Scene:
        """Scene with a radar without the cross-polar channels."""
        return replace(scene, radar=replace(scene.radar, channels=_co_polar(scene)))


def _co_polar(scene: Scene) -> tuple[str, ...]:
    kept = tuple(c for c in scene.radar.channels if c[0] == c[1])
    if not kept:
        raise RadarError(
            f"{scene.name}: cross_polarisation = off leaves none of the channels {', '.join(scene.radar.channels)}; "
            f"add HH or VV to polarisation, or set cross_polarisation to auto"
        )
    return kept


EFFECTS.register(CrossPolarisation())
