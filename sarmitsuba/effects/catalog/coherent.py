"""Physical-optics return of the smooth part of the surfaces."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import names
from sarmitsuba.errors import SceneError
from sarmitsuba.materials.diffuse import diffuse_tables


class Coherent(Effect):
    """Coherent return; off where roughness makes it negligible against the clutter.

    After one bounce a resolution cell of area A returns coherently at most
    ``4 pi A^2 / lambda^2 exp(-4 (k s cos)^2)``, even when it faces the antenna; diffusely ``sigma0 A``. Behind
    mirrors only a pilot can tell.
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
        if decided["max_depth"].on:
            return self._measured(context, smooth)
        if smooth:
            return Assessment(True, f"{names(smooth)} smooth", 0.0)
        bound = _single_bounce_db(context)
        if bound <= context.tolerance_db:
            return Assessment(
                False,
                f"rough: coherent return of a cell below {max(bound, -300.0):.0f} dB of the clutter",
                bound,
            )
        return Assessment(
            True, f"coherent return of a cell up to {bound:.0f} dB over the clutter", min(bound, 0.0)
        )

    def _measured(self, context: SceneContext, smooth: list[str]) -> Assessment:
        pilot = context.pilot
        why = f"{names(smooth)} smooth" if smooth else "multi-bounce paths keep a coherent part"
        if pilot is None or pilot.total == 0.0:
            return Assessment(True, why, 0.0)
        energy, cell = pilot.energy_db(0, 1, upper=True), pilot.cell_db(0, 1)
        small = energy <= context.tolerance_db and cell <= pilot.cell_limit_db(context.tolerance_db)
        # a facet that faces the antenna is bright in too few cells to be hit by chance
        if small and not smooth and _single_bounce_db(context) <= context.tolerance_db:
            return Assessment(
                False,
                f"pilot: {energy:.0f} dB of the energy, strongest cell {cell:.0f} dB",
                energy,
                measured=True,
            )
        share = pilot.energy_db(0, 1)  # of random patches: bright lines are rare, and most of the energy
        return Assessment(
            True, f"pilot: {share:.0f} dB of the energy, strongest cell {cell:.0f} dB over the clutter", 0.0
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the physical-optics return to the antenna."""
        return {"coherent": on}


def _single_bounce_db(context: SceneContext) -> float:
    """Upper bound of a cell's coherent over its diffuse power after one bounce, any orientation, dB."""
    if context.sampling is None:
        return np.inf
    wavelength = context.scene.radar.waveform.wavelength
    area = max(context.sampling.cell, context.sampling.ray_spacing) ** 2
    cosine = context.incidence_cosine[0]
    worst = -np.inf
    for m in context.materials:
        loss_db = -4.0 * (context.wavenumber * m.rms_height * cosine) ** 2 * 10.0 / np.log(10.0)
        coherent_db = 10.0 * np.log10(4.0 * np.pi * area / wavelength**2) + loss_db
        table = diffuse_tables(m, wavelength, 91)
        sigma = np.minimum(table.amplitude_h, table.amplitude_v)[table.theta <= np.arccos(cosine) + 1e-3] ** 2
        sigma0 = float(sigma.min()) if sigma.size else 0.0
        worst = max(worst, coherent_db - 10.0 * np.log10(sigma0) if sigma0 > 0 else np.inf)
    return float(worst)


EFFECTS.register(Coherent())
