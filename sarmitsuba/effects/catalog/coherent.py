"""Physical-optics return of the smooth part of the surfaces."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.effects.facts import Facts
from sarmitsuba.effects.registry import Decision, Effect, Verdict
from sarmitsuba.effects.text import names
from sarmitsuba.errors import SceneError
from sarmitsuba.materials.diffuse import diffuse_tables


class Coherent(Effect):
    """Off where roughness leaves nothing of it beside the clutter.

    After one bounce a resolution cell of area A returns coherently at most
    ``4 pi A^2 / lambda^2 exp(-4 (k s cos)^2)``, even when it faces the antenna; diffusely ``sigma0 A``. Behind
    mirrors only a pilot can tell.
    """

    name = "coherent"
    title = "coherent return of smooth surfaces"
    rank = 20
    cost = 0.06

    def judge(self, facts: Facts, decided: Mapping[str, Decision]) -> Verdict:
        """See the class."""
        smooth = [m.name for m in facts.materials if m.diffuse_law == "none" or m.rms_height == 0.0]
        if not facts.materials:
            return Verdict(False, "no mesh", -np.inf)
        scene = facts.scene
        if scene.settings.effects.get(self.name) == "off" and not decided["diffuse"].on and not scene.points:
            raise SceneError(
                f"{scene.name}: coherent = off leaves nothing that returns, because diffuse is off "
                f"({decided['diffuse'].why}); set coherent to auto or give a material a diffuse_law"
            )
        if not decided["diffuse"].on or facts.scene.settings.effects.get("roughness") == "off":
            return Verdict(
                True, "nothing else returns" if not decided["diffuse"].on else "roughness is off", 0.0
            )
        if decided["max_depth"].on:
            return self._measured(facts, smooth)
        if smooth:
            return Verdict(True, f"{names(smooth)} smooth", 0.0)
        bound = _single_bounce_db(facts)
        if bound <= facts.tolerance_db:
            return Verdict(
                False, f"rough: coherent cell below {max(bound, -300.0):.0f} dB of the clutter", bound
            )
        return Verdict(True, f"coherent cell up to {bound:.0f} dB over the clutter", min(bound, 0.0))

    def _measured(self, facts: Facts, smooth: list[str]) -> Verdict:
        pilot = facts.pilot
        why = f"{names(smooth)} smooth" if smooth else "mirror chains keep some of the coherent wave"
        if pilot is None or pilot.total == 0.0:
            return Verdict(True, why, 0.0)
        energy, cell = pilot.energy_db(0, 1, upper=True), pilot.cell_db(0, 1)
        small = energy <= facts.tolerance_db and cell <= pilot.cell_limit_db(facts.tolerance_db)
        # a facet that faces the antenna flashes in too few cells to be met by chance
        if small and not smooth and _single_bounce_db(facts) <= facts.tolerance_db:
            return Verdict(
                False,
                f"pilot: {energy:.0f} dB of the energy, strongest cell {cell:.0f} dB",
                energy,
                measured=True,
            )
        share = pilot.energy_db(0, 1)
        return Verdict(
            True, f"pilot: {share:.0f} dB of the energy, strongest cell {cell:.0f} dB over the clutter", share
        )

    def flags(self, on: bool, facts: Facts, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """Closing to the antenna by physical optics."""
        return {"coherent": on}


def _single_bounce_db(facts: Facts) -> float:
    """Upper bound of a cell's coherent over its diffuse power after one bounce, any orientation, dB."""
    if facts.sampling is None:
        return np.inf
    wavelength = facts.scene.radar.waveform.wavelength
    area = max(facts.sampling.cell, facts.sampling.ray_spacing) ** 2
    cosine = facts.incidence_cosine[0]
    worst = -np.inf
    for m in facts.materials:
        loss_db = -4.0 * (facts.wavenumber * m.rms_height * cosine) ** 2 * 10.0 / np.log(10.0)
        coherent_db = 10.0 * np.log10(4.0 * np.pi * area / wavelength**2) + loss_db
        table = diffuse_tables(m, wavelength, 91)
        sigma = np.minimum(table.amplitude_h, table.amplitude_v)[table.theta <= np.arccos(cosine) + 1e-3] ** 2
        sigma0 = float(sigma.min()) if sigma.size else 0.0
        worst = max(worst, coherent_db - 10.0 * np.log10(sigma0) if sigma0 > 0 else np.inf)
    return float(worst)


EFFECT = Coherent()
