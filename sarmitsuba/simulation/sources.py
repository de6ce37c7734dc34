"""What returns echoes in a scene beside the surfaces that rays find."""

from collections.abc import Callable

import numpy as np

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.trace.lines import LineNodes, LineScatterers, cut, longest_step
from sarmitsuba.trace.source import PointSource, Source

# the scatterer itself, and the ground on the way out and on the way home
MOST_BOUNCES = 3
# one line for each kind of scatterer
_Maker = Callable[[SamplingPlan, KernelFlags], Source | None]


def sources_of(sampling: SamplingPlan, flags: KernelFlags) -> tuple[Source, ...]:
    """Sources of a scene as the effects plan leaves it; none in most scenes.

    Parameters
    ----------
    sampling : of the scene without what the plan has switched off
    flags : of the trace kernel
    """
    made = (maker(sampling, flags) for maker in _MAKERS)
    return tuple(source for source in made if source is not None)


def _lines(sampling: SamplingPlan, flags: KernelFlags) -> Source | None:
    """Rods, straight and over the ground."""
    scene = sampling.scene
    if not scene.lines:
        return None
    radar = scene.radar
    distance = min(
        float(np.linalg.norm(track.position - sampling.window.center, axis=1).min()) for track in radar.tracks
    )
    wavelength = radar.waveform.wavelength
    step = longest_step(min(sampling.azimuth_cell, sampling.range_cell), distance, wavelength)
    nodes = _lit(cut(scene.lines, step), sampling)
    if not len(nodes.point):
        return None
    return PointSource(LineScatterers(nodes, scene.lines, wavelength), most_bounces(scene))


def most_bounces(scene: Scene) -> int:
    """Bounces of the longest path of a scatterer: both ways over the ground, where the scene has any and allows it."""
    return min(scene.settings.max_depth or MOST_BOUNCES, MOST_BOUNCES) if scene.geometry.n_faces else 1


def _lit(nodes: LineNodes, sampling: SamplingPlan) -> LineNodes:
    """Nodes in the lit part of the scene; lines that go on fade out beyond it, so that they do not end there."""
    cell = max(sampling.range_cell, sampling.azimuth_cell)
    beyond = np.full(len(nodes.point), np.inf)
    for window in sampling.windows:
        if window.footprint is not None:
            beyond = np.minimum(beyond, window.footprint.beyond(nodes.point))
    t = np.minimum(beyond / max(10.0 * cell, 10.0 * float(nodes.step.max())), 1.0)
    return nodes.weighted(0.5 + 0.5 * np.cos(np.pi * t))


_MAKERS: tuple[_Maker, ...] = (_lines,)

__all__ = ["most_bounces", "sources_of"]
