"""Motion of shapes during the aperture."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.scene.scene import Scene


class MovingTargets(Effect):
    """Moving targets; on where a shape moves, off keeps all at their positions at time zero."""

    name = "moving_targets"
    title = "moving shapes"
    documentation = "motion of shapes that have a velocity or an acceleration"
    off_when = "no shape moves"
    off_means = "all shapes at rest, at their positions at time zero"
    rank = 135
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "motion": "displacement and velocity of the face at every hit",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        scene = context.scene
        motions = [m for m, _ in scene.geometry.moving_meshes()]
        motions += [point.motion for point in scene.points if not point.motion.still]
        if not motions:
            return Assessment(False, "no shape moves", -np.inf)
        time = scene.radar.track.time
        moved = max(float(np.linalg.norm(np.ptp(m.displacement(time), axis=0))) for m in motions)
        what = "1 shape moves" if len(motions) == 1 else f"{len(motions)} shapes move"
        # rad over the aperture: from one on, the image is completely different
        error = db_from_amplitude(min(2.0 * context.wavenumber * moved, 1.0)) if moved else -np.inf
        return Assessment(True, f"{what}, up to {moved:.3g} m during the aperture", error)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the motion of faces, in scenes where a mesh moves."""
        return {"motion": on and context.scene.geometry.moves}

    def without(self, scene: Scene) -> Scene:
        """Scene with all shapes at rest."""
        return scene.frozen()


EFFECTS.register(MovingTargets())
