"""Temporal decorrelation: change of rough surfaces and volumes since the first pass."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.vegetation.canopy import VolumeMedium


class TemporalDecorrelation(Effect):
    r"""Temporal decorrelation; on in later passes over materials that lose coherence.

    Two numbers of mean power one and coherence :math:`\gamma` differ by :math:`2 (1 - \gamma)` in the mean square.
    """

    name = "temporal_decorrelation"
    title = "change between passes"
    documentation = (
        "change of rough surfaces and volumes since the first pass where temporal_coherence is below 1"
    )
    off_when = "the first pass, or no material changes"
    off_means = "every pass has the scatterers of the first"
    rank = 55
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "temporal": "random numbers of the scatterers mixed with those of their latest change",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        days = context.scene.settings.pass_days
        if days == 0.0:
            return Assessment(False, "the first pass", -np.inf)
        if context.scene.settings.method == "raster":
            return Assessment(False, "method raster has independent speckle in every image", -np.inf)
        diffuse = decided["diffuse"].on
        changing = [m for m in _changing(context, diffuse=diffuse) if m.coherence_after(days) < 1.0]
        if not changing:
            return Assessment(False, "nothing changes between passes", -np.inf)
        least = min(changing, key=lambda m: m.coherence_after(days))
        gamma = least.coherence_after(days)
        why = f'{days:g} days after the first pass, coherence down to {gamma:.2f} on "{least.name}"'
        return Assessment(True, why, 10.0 * float(np.log10(2.0 * (1.0 - gamma))))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the random change of scatterers, where some material can change."""
        changes = bool(_changing(context, diffuse=decided["diffuse"].on))
        return {"temporal": on and changes and context.scene.settings.pass_days != 0.0}


def _changing(context: SceneContext, *, diffuse: bool) -> list[Material | VolumeMedium]:
    """Diffuse surfaces and media of volumes that lose coherence between passes."""
    found: list[Material | VolumeMedium] = [m for m in context.materials if diffuse and m.scatters]
    found += [volume.medium for volume in context.scene.volumes]
    return [m for m in found if m.temporal_coherence < 1.0]


EFFECTS.register(TemporalDecorrelation())
