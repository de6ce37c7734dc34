"""Motion of water under wind during the aperture."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.scene.materials.diffuse import water_in
from sarmitsuba.scene.materials.diffuse_law import WindWaves


class WaterMotion(Effect):
    r"""Motion of water; on where a surface is water under wind, off keeps the waves as at time zero.

    The coherence of the scatterers at one point falls to 1/e in :math:`\lambda / (\sqrt 8 \pi \sigma_v)`, with the
    standard deviation :math:`\sigma_v` of their radial velocity; for longer apertures the phase of the clutter is
    completely changed.
    """

    name = "water_motion"
    title = "motion of water under wind"
    documentation = "motion of water: waves, and random velocities of its scatterers"
    off_when = "no surface is water under wind"
    off_means = "waves at rest, as at time zero"
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
            return Assessment(False, "method raster has no phase", -np.inf)
        speed = max(float(w.speeds[2]) for w in water)
        time = float(np.ptp(scene.radar.track.time))
        phase = context.wavenumber * speed * time  # at the ends of the aperture, relative to its middle
        error = db_from_amplitude(max(min(phase, 1.0), 1e-15))
        lasts = 1.0 / (np.sqrt(2.0) * context.wavenumber * max(speed, 1e-9))
        waves = max(len(w.waves) for w in water)
        field = f", {waves} long waves" if waves else ""
        why = f"water moves at {speed:.2g} m/s rms{field}: coherence time {1e3 * lasts:.3g} ms, aperture {time:.3g} s"
        return Assessment(error > context.tolerance_db, why, error)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the motion of water scatterers."""
        return {"water_motion": on and bool(_waters(context))}


def _waters(context: SceneContext) -> tuple[WindWaves, ...]:
    """Wind-wave models of the scene's water surfaces."""
    scene = context.scene
    return water_in(context.materials, scene.radar.waveform.wavelength, scene.settings.seed)


EFFECTS.register(WaterMotion())
