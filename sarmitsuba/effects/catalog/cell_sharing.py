"""Sharing of ray tubes among the scatterer cells that they overlap."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.errors import SceneError


class CellSharing(Effect):
    r"""Off on bare level ground: the rays then go through the cells' middles and the tubes are the cells.

    A cell whose middle lies beyond the ground's rim, or on another's ground, gets no ray. The part of it that is on
    the ground is not lost: the neighbouring cell's patch reaches to the rim and returns it, with that cell's random
    number and phase. Up to half of a cell's amplitude, a quarter of its energy, is so in the wrong cell. Counted for
    each cell on a rim of length L around an area A of cells of edge c, which meets them in any direction:

    .. math:: \epsilon = \frac{1}{4} \frac{4}{\pi} \frac{L c}{A}

    An amplitude x is missing in its own cell and too much in the other: 2 x^2, a twelfth in the mean over all places of
    the rim. Only along the cells and through their middles is it a half, and 2 dB above this.
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
                    f"{facts.scene.name}: cell_sharing = off is for bare level ground only "
                    f"({obstacle}); {_REMEDIES[obstacle]}"
                )
            return Verdict(True, obstacle, float("nan"))
        error = _rim_db(facts)
        if error <= facts.tolerance_db:
            return Verdict(False, "bare level ground: one ray through the middle of each cell", error)
        return Verdict(True, f"the ground's rim cuts cells: {error:.0f} dB", error)

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """One contribution a tube in place of four; rays on a grid of their own."""
        return {"cell_sharing": on}


_BOUNCES = "more than one bounce"
_COHERENT = "coherent tubes cross the cells"
_SPACED = "rays as far apart as asked for"
_HALVES = "error bars compare independent rays"
_RASTER = "the raster method has no rays"
_SHAPE = "not one level plane"
# what the user can do about each
_REMEDIES = {
    _BOUNCES: "max_depth = 1 leaves the others out, cell_sharing = auto keeps them",
    _COHERENT: "coherent = off leaves the coherent return out, cell_sharing = auto keeps it",
    _SPACED: "leave ray_spacing and diffuse_ray_spacing out",
    _HALVES: "render with --no-error-bars (keep_halves = false)",
    _RASTER: "take another method, or cell_sharing = auto",
    _SHAPE: "this scene needs cell_sharing = auto",
}


def _obstacle(facts: Facts, decided: Mapping[str, Decision]) -> str:
    """What stands against it, empty when nothing does."""
    settings = facts.scene.settings
    if decided["max_depth"].on:
        return _BOUNCES
    if decided["coherent"].on:
        return _COHERENT
    if settings.ray_spacing > 0 or settings.diffuse_ray_spacing > 0:
        return _SPACED
    if settings.keep_halves:
        return _HALVES
    if settings.method == "raster":
        return _RASTER
    if not facts.shape.level:
        return _SHAPE
    return ""


def _rim_db(facts: Facts) -> float:
    """Energy of what is in the wrong cell along the ground's rim, over that of the ground, dB."""
    if facts.sampling is None:
        return np.inf
    low, high = facts.sampling.box[:, :2] + facts.sampling.cell * np.array([[-1.0], [1.0]])
    rim = facts.shape.rim_length(low, high)
    area = min(float(facts.shape.areas.sum()), float(np.prod(high - low)))
    share = rim * facts.sampling.cell / (np.pi * area)
    return 10.0 * float(np.log10(share)) if share > 0 else -np.inf


EFFECT = CellSharing()
