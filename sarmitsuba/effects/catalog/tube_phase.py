"""Phase integral over a ray's footprint."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length


class TubePhase(Effect):
    """Phase integral of ray tubes; off where nothing is coherent, or it equals the area within the tolerance.

    Over a whole tube of phase -x ... x it is ``sin(x) / x`` of the area, smaller by ``x^2 / 6``, with
    ``x = k d max(1, tan theta)`` for rays d apart.
    """

    name = "tube_phase"
    title = "phase integral of ray tubes"
    documentation = "phase integral over each ray tube's footprint"
    off_when = "nothing coherent, or ray spacing a small part of a wavelength"
    off_means = (
        "the area of a ray's patch instead of the phase integral over it (a sum over its four corners)"
    )
    rank = 120
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "tube_phase": "the phase integral over a ray's patch; off takes the patch's area",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        if not decided["coherent"].on:
            return Assessment(False, "nothing coherent", -np.inf)
        if context.sampling is None:
            return Assessment(True, "the ray spacing is not known yet", float("nan"))
        spacing = context.sampling.ray_spacing
        cosine = max(context.incidence_cosine[0], 0.05)
        x = context.wavenumber * spacing * max(1.0, np.sqrt(1.0 - cosine**2) / cosine)
        change = min(1.0, float(x * x) / 6.0)
        error = db_from_amplitude(change)
        if change <= context.tolerance:
            return Assessment(False, f"ray spacing {length(spacing)}", error)
        return Assessment(
            True,
            f"ray spacing {length(spacing)} at a wavelength of {length(2 * np.pi / context.wavenumber)}",
            float(
                "nan"
            ),  # off specular directions the cancelled power may be larger than the remaining power
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the phase integral over the ray's patch at every coherent return; off, the patch's area."""
        return {"tube_phase": on}


EFFECTS.register(TubePhase())
