"""What returns echoes in a scene beside the surfaces that rays find, and what stands in the way of all waves."""

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


def passages_of(scene: Scene) -> tuple[Passage, ...]:
    """What stands in the way of waves in a scene and lets a part of them through; nothing in most scenes."""
    return (volume_passage(scene.volumes),) if scene.volumes else ()


__all__ = ["passages_of", "sources_of"]
