"""Volumes with scattering and extinction: vegetation such as tree crowns, hedges, forest stands."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.scene import Scene


class Vegetation(Effect):
    """Volumes; on where a shape is a volume, off leaves all volumes out."""

    name = "vegetation"
    title = "scattering and extinction of volumes"
    documentation = "volumes, such as crowns of trees: their returns and their extinction"
    off_when = "no shape has a `radar_volume`"
    off_means = "no volumes: neither their echoes nor their extinction"
    rank = 137

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        volumes = context.scene.volumes
        if not volumes:
            return Assessment(False, "no volume", -np.inf)
        if context.scene.settings.method == "raster":
            return Assessment(False, "method raster shows surfaces only", float("nan"))
        line = context.corners[-1] - context.scene.radar.track.center_position
        cosine = float(abs(line[2]) / np.linalg.norm(line))
        # extinction along the mean path through each, and the strongest return of one square metre of volume
        depth = [float(v.medium.at(cosine)[0].mean()) * v.mean_chord for v in volumes]
        returned = max(float(v.medium.at(cosine)[1][:2].max()) * v.mean_chord for v in volumes)
        error = db_from_power(max(1.0 - np.exp(-2.0 * max(depth)), min(returned, 1.0), 1e-30))
        what = "1 volume" if len(volumes) == 1 else f"{len(volumes)} volumes"
        low, high = (10.0 / np.log(10.0) * x for x in (min(depth), max(depth)))
        span = f"{high:.1f}" if high - low < 0.1 else f"{low:.1f} to {high:.1f}"
        why = f"{what}: extinction {span} dB along a mean path"
        return Assessment(True, why, float(error))

    def without(self, scene: Scene) -> Scene:
        """Scene without its volumes."""
        return replace(scene, volumes=()) if scene.volumes else scene


EFFECTS.register(Vegetation())
