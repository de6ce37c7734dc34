"""Fresnel coefficients of dielectrics and metals; without them every surface is a perfect conductor."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import names
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.material import Material


class Fresnel(Effect):
    """Fresnel coefficients; off where all materials are nearly perfect conductors, or nothing reflects coherently."""

    name = "fresnel"
    title = "Fresnel coefficients"
    documentation = "reflection coefficients of the materials; off: every surface is a perfect conductor"
    off_when = "every surface is a perfect conductor, or nothing reflects and nothing returns coherently"
    off_means = "the reflection of a perfect conductor, `E - 2 (E.n) n`"
    rank = 30
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "fresnel": "Fresnel coefficients; off treats every surface as a perfect conductor",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        lossy = [m for m in context.materials if not m.pec]
        if not lossy:
            return Assessment(False, "all surfaces are perfect conductors", -np.inf)
        mirrors = decided["max_depth"].on or context.scene.has_sources
        if not mirrors and not decided["coherent"].on:
            return Assessment(False, "nothing reflects and nothing returns coherently", -np.inf)
        error = max(_error_db(m) for m in lossy)
        if error <= context.tolerance_db:
            return Assessment(
                False, f"{names([m.name for m in lossy])} within {error:.0f} dB of a perfect conductor", error
            )
        # perfect conductors give a stronger image; by how much depends on the paths
        return Assessment(True, f"dielectric {names([m.name for m in lossy])}", float("nan"))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Complex reflection coefficients in the kernel."""
        return {"fresnel": on}


def _error_db(m: Material) -> float:
    """Largest error of the reflected field of a perfect conductor in place of the material, 0 to 85 degrees, dB."""
    te, tm = fresnel(np.cos(np.radians(np.linspace(0.0, 85.0, 18))), m.permittivity)
    # perfect conductor: R_TE = -1, R_TM = 1
    error = max(float(np.abs(te + 1.0).max()), float(np.abs(tm - 1.0).max()))
    return db_from_amplitude(error)


EFFECTS.register(Fresnel())
