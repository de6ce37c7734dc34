"""Sharing of ray tubes among the scatterer cells that they overlap."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.errors import SceneError


class CellSharing(Effect):
    r"""Off on bare level ground: the rays then go through the cells' middles and the tubes are the cells.

    What is lost are the parts of cells whose middle lies beyond the ground's rim, or on another's ground: half of a
    cell's amplitude at most. With a rim of length L around an area A of cells of edge c, which meets them in any
    direction:

    .. math:: \epsilon = \frac{1}{4} \frac{4}{\pi} \frac{L c}{A}
    """

    name = "cell_sharing"
    title = "tubes shared among cells"
    rank = 65
    cost = 0.44

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        if not decided["diffuse"].on:
            return Verdict(False, "nothing diffuse", -np.inf)
        obstacle = _obstacle(facts, decided)
        if obstacle:
            if facts.sampling is not None and facts.scene.settings.effects.get(self.name) == "off":
                raise SceneError(
                    f"{facts.scene.name}: cell_sharing = off is for bare level ground only ({obstacle}); "
                    f"set it to auto"
                )
            return Verdict(True, obstacle, float("nan"))
        error = _rim_db(facts)
        if error <= facts.tolerance_db:
            return Verdict(False, "bare level ground: one ray through the middle of each cell", error)
        return Verdict(True, f"the ground's rim cuts cells: {error:.0f} dB", error)

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """One contribution a tube in place of four; rays on a grid of their own."""
        return {"cell_sharing": on}


def _obstacle(facts: Facts, decided: Mapping[str, Decision]) -> str:
    """What stands against it, empty when nothing does."""
    settings = facts.scene.settings
    if decided["max_depth"].on:
        return "more than one bounce"
    if decided["coherent"].on:
        return "coherent tubes cross the cells"
    if settings.ray_spacing > 0 or settings.diffuse_ray_spacing > 0:
        return "rays as far apart as asked for"
    if settings.keep_halves:
        return "error bars compare independent rays"
    if settings.method == "raster":
        return "the raster method has no rays"
    if not facts.shape.level:
        return "not one level plane"
    return ""


def _rim_db(facts: Facts) -> float:
    """Most energy that parts of cells along the ground's rim may lose, over that of the ground, dB."""
    if facts.sampling is None:
        return np.inf
    low, high = facts.sampling.box[:, :2] + facts.sampling.cell * np.array([[-1.0], [1.0]])
    rim = facts.shape.rim_length(low, high)
    area = min(float(facts.shape.areas.sum()), float(np.prod(high - low)))
    share = rim * facts.sampling.cell / (np.pi * area)
    return 10.0 * float(np.log10(share)) if share > 0 else -np.inf


EFFECT = CellSharing()
