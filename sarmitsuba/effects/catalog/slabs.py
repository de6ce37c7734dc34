"""Reflection of slabs: walls and panes of finite thickness."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length, names
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.slab import COSINES, slab_coefficients


class Slabs(Effect):
    """Slab reflection; on where a material has a thickness and reflects differently from a half space."""

    name = "slabs"
    title = "slabs of finite thickness"
    documentation = "reflection of materials with a thickness as slabs; off: as half spaces"
    off_when = "no material has a thickness, or all reflect like half spaces"
    off_means = "Fresnel coefficients of half spaces"
    rank = 32
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "slabs": "reflection coefficients of slabs, coated or not, at faces with a thickness",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        slabs = [m for m in context.materials if m.thickness > 0.0 and not m.pec]
        if not slabs:
            return Assessment(False, "no material has a thickness", -np.inf)
        if not decided["fresnel"].on:
            return Assessment(False, "every surface is a perfect conductor", -np.inf)
        error = max(_error_db(m, context.scene.radar.waveform.wavelength) for m in slabs)
        what = names([f"{m.name} ({length(m.thickness)})" for m in slabs])
        if error <= context.tolerance_db and not context.seen_through:
            return Assessment(False, f"{what}: within {error:.0f} dB of a half space", error)
        return Assessment(
            True, f"{what}: error of a half space {round(error)} dB of the incident field", error
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of slab coefficients in the kernel."""
        return {"slabs": on}


def _error_db(m: Material, wavelength: float) -> float:
    """Largest difference of the fields reflected by a slab and a half space, relative to the incident field, dB."""
    slab = slab_coefficients(m, wavelength)
    te, tm = fresnel(COSINES, m.permittivity)
    error = max(float(np.abs(slab.r_te - te).max()), float(np.abs(slab.r_tm - tm).max()))
    return db_from_amplitude(error)


EFFECTS.register(Slabs())
