"""What a scene is after loading: frozen, validated data without any Mitsuba object in it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.materials.material import Material
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.settings import TraceSettings

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a simulation needs to know.

    Parameters
    ----------
    name : of the file, without suffix
    path : scene file, or None when it was built in memory
    geometry, materials, points : what there is to see
    radar : what sees it
    settings, image : how to trace and what to focus
    offset : (3,) float64, m; scene frame = file frame - offset. Zero unless the geometry lies more than
        5 km from the file's origin, whole metres then
    notes : one line each; what was assumed or repaired while loading
    """

    name: str
    path: Path | None
    geometry: Geometry
    materials: tuple[Material, ...]
    points: tuple[PointTarget, ...]
    radar: Radar
    settings: TraceSettings
    image: ImageRequest
    offset: F64 = field(default_factory=lambda: np.zeros(3))
    notes: tuple[str, ...] = ()


__all__ = ["Scene"]
