"""Volumes that waves go through: crowns of trees, hedges, stands."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.scene import Scene


class Vegetation(Effect):
    """On where a shape is a volume; off leaves all volumes out."""

    name = "vegetation"
    title = "returns of volumes, and what they take from waves"
    documentation = "volumes, such as crowns of trees: their returns and their extinction"
    off_when = "no shape has a `radar_volume`"
    off_means = "bare ground: no volume returns or takes anything"
    rank = 137

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        volumes = context.scene.volumes
        if not volumes:
            return Assessment(False, "no volume", -np.inf)
        if context.scene.settings.method == "raster":
            return Assessment(False, "the raster method sees surfaces alone", float("nan"))
        line = context.corners[-1] - context.scene.radar.track.center_position
        cosine = float(abs(line[2]) / np.linalg.norm(line))
        # power that the mean way through each takes, and the strongest return of one square metre of volume
        depth = [float(v.medium.at(cosine)[0].mean()) * v.mean_chord for v in volumes]
        returned = max(float(v.medium.at(cosine)[1][:2].max()) * v.mean_chord for v in volumes)
        error = 10.0 * np.log10(max(1.0 - np.exp(-2.0 * max(depth)), min(returned, 1.0), 1e-30))
        what = "1 volume takes" if len(volumes) == 1 else f"{len(volumes)} volumes take"
        low, high = (10.0 / np.log(10.0) * x for x in (min(depth), max(depth)))
        span = f"{high:.1f}" if high - low < 0.1 else f"{low:.1f} to {high:.1f}"
        why = f"{what} {span} dB from a wave on a mean way through"
        return Assessment(True, why, float(error))

    def without(self, scene: Scene) -> Scene:
        """Surfaces and points alone."""
        return replace(scene, volumes=()) if scene.volumes else scene


EFFECTS.register(Vegetation())
