"""Water that waves carry along while the radar flies by."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.materials.diffuse import water_in
from sarmitsuba.materials.diffuse_law import WindWaves


class WaterMotion(Effect):
    r"""On where a surface is water under wind and the method has raw data or phase; off freezes it at time zero.

    The coherence of the scatterers of one place falls to 1/e in :math:`\lambda / (\sqrt 8 \pi \sigma_v)`, with the
    deviation :math:`\sigma_v` of their range speed; what is left out is all of the clutter's phase once the aperture
    takes longer.
    """

    name = "water_motion"
    title = "motion of water under wind"
    documentation = "motion of water: waves, and random velocities of the scatterers that they carry"
    off_when = "no surface is water under wind"
    off_means = "the waves stand still, as they are at time zero"
    rank = 136
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "water_motion": "time and velocity of the scatterers of water under wind",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        scene, water = context.scene, _waters(context)
        if not water or not decided["diffuse"].on:
            return Assessment(False, "no water under wind", -np.inf)
        if scene.settings.method == "raster":
            return Assessment(False, "method raster knows no phase", -np.inf)
        # the vertical motion is the largest; waves that are drawn move alike over a cell and do not blur it
        speed = max(float(w.speeds[2]) for w in water)
        time = float(np.ptp(scene.radar.track.time))
        phase = context.wavenumber * speed * time  # at the ends of the aperture, of the mid-aperture's
        error = 20.0 * float(np.log10(max(min(phase, 1.0), 1e-15)))
        lasts = 1.0 / (np.sqrt(2.0) * context.wavenumber * max(speed, 1e-9))
        waves = max(len(w.waves) for w in water)
        field = f", {waves} long waves" if waves else ""
        why = f"water moves at {speed:.2g} m/s rms{field}: coherent for {1e3 * lasts:.3g} ms of {time:.3g} s"
        return Assessment(error > context.tolerance_db, why, error)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Two sines and six hashes a scatterer, and one sine for every long wave."""
        return {"water_motion": on and bool(_waters(context))}


def _waters(context: SceneContext) -> tuple[WindWaves, ...]:
    """What is water under wind in the scene."""
    scene = context.scene
    return water_in(context.materials, scene.radar.waveform.wavelength, scene.settings.seed)


EFFECTS.register(WaterMotion())
