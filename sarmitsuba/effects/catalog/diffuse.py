"""Persistent diffuse scatterers on rough surfaces."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import names
from sarmitsuba.scene.materials.diffuse import diffuse_tables

# angles at which hh and vv are compared, 6 degrees apart
_POLARISED_NODES = 16


class Diffuse(Effect):
    """Diffuse return; on where a visible material scatters diffusely (this is the clutter, so no tolerance applies)."""

    name = "diffuse"
    title = "diffuse scattering"
    documentation = "incoherent return of rough surfaces"
    off_when = "no material scatters diffusely"
    off_means = "no scatterers, no diffuse polarisation"
    rank = 10
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "diffuse": "persistent diffuse scatterers",
        "polarised_diffuse": "diffuse laws that differ between h and v, which need the plane of incidence",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        rough = [m.name for m in context.materials if m.scatters]
        if not rough:
            return Assessment(False, "no material scatters diffusely", -np.inf)
        return Assessment(True, f"diffuse law on {names(rough)}", 0.0)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flags of diffuse scatterers, and of laws that differ between h and v, which need the plane of incidence."""
        return {"diffuse": on, "polarised_diffuse": on and _is_polarised(context)}


def _is_polarised(context: SceneContext) -> bool:
    """Whether hh and vv differ in the table of some material's law."""
    wavelength = context.scene.radar.waveform.wavelength
    return any(diffuse_tables(m, wavelength, _POLARISED_NODES).polarised for m in context.materials)


EFFECTS.register(Diffuse())
