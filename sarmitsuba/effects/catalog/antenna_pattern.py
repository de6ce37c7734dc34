"""Antenna pattern: gain over direction."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import unit_rows
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.scene.scene import Scene


class AntennaPattern(Effect):
    """Antenna pattern; off for an isotropic beam, or where the gain hardly varies over the scene and the aperture.

    Off makes the beam isotropic for focusing as well, which would otherwise correct for a pattern that was not applied.
    """

    name = "antenna_pattern"
    title = "beam over the scene"
    documentation = "two-way beam pattern"
    off_when = "isotropic, or flat over scene and aperture"
    off_means = "isotropic beam, also in focusing"
    rank = 90
    at_key_pulses = False
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "antenna_pattern": "gain over direction at launch and at every closing",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        radar = context.scene.radar
        kind = radar.antenna.pattern
        if kind == "isotropic":
            return Assessment(False, "isotropic beam", -np.inf)
        n = radar.track.n_pulses
        pick = np.unique(np.linspace(0, n - 1, min(n, 33)).round().astype(int))
        leg = context.corners[:, None] - radar.track.position[pick]
        u = unit_rows(leg)
        axes = (radar.pointing.azimuth_axis[pick], radar.pointing.elevation_axis[pick])
        gain = radar.antenna.two_way_amplitude(*(np.sum(u * a, axis=-1) for a in axes))
        change = float(np.abs(gain - 1.0).max())
        error = db_from_amplitude(change)
        if change <= context.tolerance:
            return Assessment(False, f"{kind} beam, constant gain over the scene to {error:.0f} dB", error)
        return Assessment(
            True, f"{kind} beam falls to {db_from_amplitude(max(float(gain.min()), 1e-15)):.1f} dB", error
        )

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Gain at launch and at every closing."""
        return {"antenna_pattern": on}

    def without(self, scene: Scene) -> Scene:
        """Scene with an isotropic beam of the same peak gain."""
        antenna = replace(scene.radar.antenna, pattern="isotropic")
        return replace(scene, radar=replace(scene.radar, antenna=antenna))


EFFECTS.register(AntennaPattern())
