"""Physical-optics return of the smooth part of the surfaces."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.bounds import facet_bound, flash_bound, mean_clutter, specular_db
from sarmitsuba.effects.context import PilotResult, SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import names


class Coherent(Effect):
    """Coherent return; off where roughness makes it negligible against the clutter.

    A pilot measures the return of random cells, after any number of bounces. Faces that return specularly are bright in
    too few cells to be met by chance; their return is bounded from the geometry, see
    :mod:`sarmitsuba.effects.bounds`.
    """

    name = "coherent"
    title = "coherent return of smooth surfaces"
    documentation = "physical-optics return of the smooth part of the surfaces"
    off_when = "negligible against the clutter because of roughness"
    off_means = "no physical-optics return"
    rank = 20
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "coherent": "closing to the antenna by physical optics",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        smooth = [m.name for m in context.materials if not m.scatters or m.rms_height == 0.0]
        if not context.materials:
            return Assessment(False, "no mesh", -np.inf)
        scene = context.scene
        more = scene.points or scene.has_sources
        if scene.settings.effects.get(self.name) == "off" and not decided["diffuse"].on and not more:
            raise SceneError(
                f"{scene.name}: coherent = off leaves no echo at all, because diffuse is off "
                f"({decided['diffuse'].why}); set coherent to auto or give a material a diffuse_law"
            )
        if not decided["diffuse"].on or context.scene.settings.effects.get("roughness") == "off":
            return Assessment(
                True,
                "the only return of the surfaces" if not decided["diffuse"].on else "roughness is off",
                0.0,
            )
        if smooth:
            return Assessment(True, f"{names(smooth)} smooth", 0.0)
        if context.pilot is not None and context.pilot.total > 0.0:
            return _decide_by_pilot(context, context.pilot, max(1, decided["max_depth"].value or 1))
        if decided["max_depth"].on:
            return Assessment(True, "multi-bounce paths keep a coherent part", 0.0)
        bound = facet_bound(context).over_own_clutter_db
        if bound <= context.tolerance_db:
            why = f"rough: coherent return of a cell below {max(bound, -300.0):.0f} dB of the clutter"
            return Assessment(False, why, bound)
        return Assessment(
            True, f"coherent return of a cell up to {bound:.0f} dB over the clutter", min(bound, 0.0)
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the physical-optics return to the antenna."""
        return {"coherent": on}


def _decide_by_pilot(context: SceneContext, pilot: PilotResult, bounces: int) -> Assessment:
    """Decision from the pilot, and from the bounds of returns that it may have missed."""
    energy, cell = pilot.energy_db(0, 1, upper=True), pilot.cell_db(0, 1)
    specular, bound = _missed_db(context, pilot, bounces)
    limit = pilot.cell_limit_db(context.tolerance_db)
    found = (
        f"pilot: {pilot.energy_db(0, 1):.0f} dB of the energy, strongest cell {cell:.0f} dB over the clutter"
    )
    if max(energy, specular) <= context.tolerance_db and max(cell, bound) <= limit:
        why = f"{found}, of any face at most {bound:.0f} dB"
        return Assessment(False, why, max(energy, specular), measured=specular <= energy)
    if energy <= context.tolerance_db and cell <= limit:
        found += f", of any face up to {bound:.0f} dB"
    # random patches: bright lines are rare, and most of the energy
    return Assessment(True, found, 0.0)


def _missed_db(context: SceneContext, pilot: PilotResult, bounces: int) -> tuple[float, float]:
    """Bounds of the coherent return that random patches may miss: energy over all, a cell over its mean clutter, dB."""
    clutter = mean_clutter(context, pilot)
    if not clutter > 0.0:
        return np.inf, np.inf
    faces = facet_bound(context)
    cell = max(faces.cross_section, flash_bound(context, bounces)) / clutter
    return specular_db(context, pilot, faces), db_from_power(max(cell, 1e-30))


EFFECTS.register(Coherent())
