"""Slabs, walls and panes of finite thickness: when their reflection and transmission are simulated."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude, db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length, names
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.slab import COSINES, lets_through, most_power_through, slab_coefficients


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


class Transmission(Effect):
    """Transmission; on where a slab transmits and something is behind it, off makes slabs opaque."""

    name = "transmission"
    title = "transmission through slabs"
    documentation = "transmission through materials with a thickness; off: they are opaque"
    off_when = "no slab transmits, or nothing lies behind one"
    off_means = "opaque slabs; one path per ray"
    rank = 34
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "transmission": "paths branch at slabs, and legs to the antenna are transmitted through them",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        scene = context.scene
        wavelength = scene.radar.waveform.wavelength
        slabs = [m for m in context.materials if m.thickness > 0.0 and not m.pec]
        if not slabs:
            return Assessment(False, "no material has a thickness", -np.inf)
        if not decided["slabs"].on and (decided["slabs"].source == "user" or not decided["fresnel"].on):
            return Assessment(False, "slabs is off: materials are opaque half spaces", -np.inf)
        if scene.settings.method == "raster":
            return Assessment(False, "the raster method has one bounce and no fields", float("nan"))
        error = db_from_power(max(most_power_through(m, wavelength) for m in slabs) + 1e-30)
        if error <= context.tolerance_db or not any(lets_through(m, wavelength) for m in slabs):
            return Assessment(
                False, f"{names([m.name for m in slabs])}: two-way transmission at most {error:.0f} dB", error
            )
        if not context.seen_through:
            return Assessment(False, f"nothing lies behind {names([m.name for m in slabs])}", -np.inf)
        return Assessment(
            True,
            f"objects behind {names([m.name for m in context.seen_through])}: two-way transmission up to "
            f"{error:.1f} dB",
            error,
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the branches at slabs; it needs the bounce loop and the slabs' reflection."""
        return {"transmission": on}


EFFECTS.register(Slabs())
EFFECTS.register(Transmission())
