"""Phase integral over a ray's footprint."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.effects.text import length


class TubePhase(Effect):
    """Off where nothing is coherent, or tubes so fine that the phase integral is their area within the tolerance.

    Over a whole tube of phase -x ... x it is ``sin(x) / x`` of the area, short of it by ``x^2 / 6``, with
    ``x = k d max(1, tan theta)`` for rays d apart.
    """

    name = "tube_phase"
    title = "phase integral of ray tubes"
    rank = 120

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        if not decided["coherent"].on:
            return Verdict(False, "nothing coherent", -np.inf)
        if facts.sampling is None:
            return Verdict(True, "tubes may be wide", float("nan"))
        spacing = facts.sampling.ray_spacing
        cosine = max(facts.incidence_cosine[0], 0.05)
        x = facts.wavenumber * spacing * max(1.0, np.sqrt(1.0 - cosine**2) / cosine)
        change = min(1.0, float(x * x) / 6.0)
        error = 20.0 * float(np.log10(change))
        if change <= facts.tolerance:
            return Verdict(False, f"rays {length(spacing)} apart", error)
        return Verdict(
            True,
            f"rays {length(spacing)} apart at a wavelength of {length(2 * np.pi / facts.wavenumber)}",
            error,
        )

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """A sum over the four corners of the ray's patch at every closing; off, the patch's area."""
        return {"tube_phase": on}


EFFECT = TubePhase()
