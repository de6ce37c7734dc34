"""Sharing of ray tubes among the scatterer cells that they overlap."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.errors import SceneError


class FootprintSplitting(Effect):
    r"""Off on bare level ground: the rays then go through the cells' middles and the tubes are the cells.

    A cell whose middle lies beyond the ground's rim, or on another's ground, gets no ray. The part of it that is on
    the ground is not lost: the neighbouring cell's patch reaches to the rim and returns it, with that cell's random
    number and phase. Up to half of a cell's amplitude, a quarter of its energy, is so in the wrong cell. Counted for
    each cell on a rim of length L around an area A of cells of edge c, which meets them in any direction:

    .. math:: \epsilon = \frac{1}{4} \frac{4}{\pi} \frac{L c}{A}

    An amplitude x is missing in its own cell and too much in the other: 2 x^2, a twelfth in the mean over all places of
    the rim. Only along the cells and through their middles is it a half, and 2 dB above this.
    """

    name = "footprint_splitting"
    title = "tubes shared among cells"
    documentation = "ray footprints split among the scatterer cells that they overlap"
    off_when = "bare level ground: one plane, one bounce, nothing coherent"
    off_means = "rays through the centres of the scatterer cells, one contribution per ray instead of four"
    rank = 65
    cost = 0.44
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "footprint_splitting": "share each tube among the cells it overlaps; off gives it to its middle's cell",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        if not decided["diffuse"].on:
            return Assessment(False, "nothing diffuse", -np.inf)
        obstacle = _obstacle(context, decided)
        if obstacle:
            if context.sampling is not None and context.scene.settings.effects.get(self.name) == "off":
                raise SceneError(
                    f"{context.scene.name}: footprint_splitting = off is for bare level ground only "
                    f"({obstacle}); {_REMEDIES[obstacle]}"
                )
            return Assessment(True, obstacle, float("nan"))
        error = _rim_db(context)
        if error <= context.tolerance_db:
            return Assessment(False, "bare level ground: one ray through the centre of each cell", error)
        return Assessment(True, f"the ground's rim cuts cells: {error:.0f} dB", error)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """One contribution per tube in place of four; rays on a grid of their own."""
        return {"footprint_splitting": on}


_BOUNCES = "more than one bounce"
_COHERENT = "coherent tubes cross the cells"
_SPACED = "a ray spacing is given"
_HALVES = "error bars compare independent rays"
_RASTER = "the raster method has no rays"
_SHAPE = "not one level plane"
# what the user can do about each
_REMEDIES = {
    _BOUNCES: "set max_depth = 1 to leave the others out, or footprint_splitting = auto to keep them",
    _COHERENT: "set coherent = off to leave it out, or footprint_splitting = auto to keep it",
    _SPACED: "leave out ray_spacing and diffuse_ray_spacing",
    _HALVES: "render with --no-error-bars (keep_subsets = false)",
    _RASTER: "use another method, or set footprint_splitting = auto",
    _SHAPE: "set footprint_splitting = auto for this scene",
}


def _obstacle(context: SceneContext, decided: Mapping[str, Decision]) -> str:
    """What stands against it, empty when nothing does."""
    settings = context.scene.settings
    if decided["max_depth"].on:
        return _BOUNCES
    if decided["coherent"].on:
        return _COHERENT
    if settings.ray_spacing > 0 or settings.diffuse_ray_spacing > 0:
        return _SPACED
    if settings.keep_subsets:
        return _HALVES
    if settings.method == "raster":
        return _RASTER
    if not context.shape.level:
        return _SHAPE
    return ""


def _rim_db(context: SceneContext) -> float:
    """Energy of what is in the wrong cell along the ground's rim, over that of the ground, dB."""
    if context.sampling is None:
        return np.inf
    low, high = context.sampling.box[:, :2] + context.sampling.cell * np.array([[-1.0], [1.0]])
    rim = context.shape.rim_length(low, high)
    area = min(float(context.shape.areas.sum()), float(np.prod(high - low)))
    share = rim * context.sampling.cell / (np.pi * area)
    return 10.0 * float(np.log10(share)) if share > 0 else -np.inf


EFFECTS.register(FootprintSplitting())
