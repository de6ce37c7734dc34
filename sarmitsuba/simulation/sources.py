"""What returns echoes in a scene beside the surfaces that rays find, and what stands in the way of all waves."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.sampling.plan import azimuth_cell
from sarmitsuba.trace.passage import Passage
from sarmitsuba.trace.source import PointSource, Source
from sarmitsuba.trace.volumes import volume_passage, volume_scatterers


def sources_of(scene: Scene, flags: KernelFlags) -> tuple[Source, ...]:
    """Sources of a scene as the effects plan leaves it; none in most scenes.

    Parameters
    ----------
    scene : without what the plan has switched off
    flags : of the trace kernel
    """
    sources: list[Source] = []
    if scene.volumes:
        cell = azimuth_cell(scene) * scene.radar.waveform.range_cell
        order = 1 if scene.settings.max_depth == 1 or scene.settings.method == "raster" else 3
        sources.append(PointSource(volume_scatterers(scene.volumes, cell), order))
    return tuple(sources)


def passages_of(scene: Scene) -> tuple[tuple[Passage, ...], NDArray[np.float64] | None]:
    """What stands in the way of waves in a scene and lets a part of them through; nothing in most scenes.

    Returns
    -------
    passages : one of each kind
    bounds : (2, 3) m, of what they fill beyond the surfaces; None where that is nothing
    """
    if not scene.volumes:
        return (), None
    passage = volume_passage(scene.volumes)
    return (passage,), passage.bodies.bounds


__all__ = ["passages_of", "sources_of"]
