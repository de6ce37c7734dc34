"""Shadow rays from the second hit on."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict


class Visibility(Effect):
    """Off after one bounce (the first hit sees the antenna) and where no face can come between."""

    name = "visibility"
    title = "shadow rays"
    rank = 110

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        if not decided["max_depth"].on:
            return Verdict(False, "the first hit sees the antenna", -np.inf)
        if facts.shape.open_sight:
            return Verdict(False, "no face stands between any other and the antenna", -np.inf)
        error = 0.0  # a hidden return may be as strong as any
        if facts.pilot is not None and facts.pilot.total > 0:
            error = facts.pilot.energy_db(3, 2)
        return Verdict(True, "later hits can be hidden from the antenna", error)

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """One ray query a hit."""
        return {"visibility": on}


EFFECT = Visibility()
