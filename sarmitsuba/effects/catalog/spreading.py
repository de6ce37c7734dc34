"""Spherical spreading inside the scene; off: every path has the spreading of the scene's middle."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue


class Spreading(Effect):
    """Spherical spreading; off where ``1 / R^2`` is constant over the scene and the aperture within the tolerance."""

    name = "spreading"
    title = "spreading inside the scene"
    documentation = "spherical spreading inside the scene; off: that of the scene's middle everywhere"
    off_when = "1/R^2 is nearly constant over the scene"
    off_means = "one factor"
    rank = 100
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "spreading": "division by both legs at every hit; off uses the reference point's range for all",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        reference = np.linalg.norm(context.corners[-1] - context.scene.radar.track.center_position)
        distance = np.linalg.norm(context.corners[:, None] - context.antenna, axis=-1)
        change = float(np.abs((reference / distance) ** 2 - 1.0).max())
        error = db_from_amplitude(change)
        if change <= context.tolerance:
            return Assessment(False, f"1/R^2 varies by {100 * change:.2g} % only", error)
        return Assessment(True, f"1/R^2 varies by {100 * change:.2g} %", error)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """A division by both legs at every hit."""
        return {"spreading": on}


EFFECTS.register(Spreading())
