"""What is seen through slabs, such as windows and thin walls."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import names
from sarmitsuba.materials.slab import lets_through, most_power_through


class Transmission(Effect):
    """On where waves go through a slab to something behind it; off, slabs stop them."""

    name = "transmission"
    title = "transmission through slabs"
    documentation = "waves through materials with a thickness, out and home; off: they block"
    off_when = "no slab lets waves through, or nothing lies behind one"
    off_means = "slabs block; one path per ray"
    rank = 34
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "transmission": "paths branch at slabs, and ways home go through them",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        scene = context.scene
        wavelength = scene.radar.waveform.wavelength
        slabs = [m for m in context.materials if m.thickness > 0.0 and not m.pec]
        if not slabs:
            return Assessment(False, "no material has a thickness", -np.inf)
        if not decided["slabs"].on and (decided["slabs"].source == "user" or not decided["fresnel"].on):
            return Assessment(False, "slabs are half spaces, through which nothing is seen", -np.inf)
        if scene.settings.method == "raster":
            return Assessment(False, "the raster method has one bounce and no fields", float("nan"))
        error = 10.0 * float(np.log10(max(most_power_through(m, wavelength) for m in slabs) + 1e-30))
        if error <= context.tolerance_db or not any(lets_through(m, wavelength) for m in slabs):
            return Assessment(
                False, f"{names([m.name for m in slabs])} let at most {error:.0f} dB through both ways", error
            )
        if not context.seen_through:
            return Assessment(False, f"nothing lies behind {names([m.name for m in slabs])}", -np.inf)
        return Assessment(
            True,
            f"what lies behind {names([m.name for m in context.seen_through])} is seen, up to {error:.1f} dB "
            "both ways",
            error,
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Branches at slabs, in the loop of several bounces and with the slabs' reflection."""
        return {"transmission": on}


EFFECTS.register(Transmission())
