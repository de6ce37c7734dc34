"""What returns echoes in a scene beside the surfaces that rays find, and what stands in the way of all waves."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.sampling.cropping import shares
from sarmitsuba.simulation.sampling.launch_window import LaunchWindow
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.trace.edges import FringeCurrents, edges_of
from sarmitsuba.trace.launch import project
from sarmitsuba.trace.lines import LineScatterers, cut, longest_step
from sarmitsuba.trace.passage import Passage
from sarmitsuba.trace.source import PointSource, Source
from sarmitsuba.trace.volumes import volume_passage, volume_scatterers

F64 = NDArray[np.float64]

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


def _edges(sampling: SamplingPlan, flags: KernelFlags) -> Source | None:
    """Sharp metal edges in pieces of half a resolution cell, as far as rays light their faces."""
    if not flags.edge_diffraction:
        return None
    scene = sampling.scene
    edges = edges_of(scene.geometry, scene.materials, scene.radar.waveform.wavelength, sampling.half_cell)
    if flags.taper:
        edges = edges.weighted(_light(edges.middle, sampling))
    return (
        PointSource(FringeCurrents(edges), most_bounces(scene) if flags.multi_bounce else 1)
        if edges.n
        else None
    )


def _light(points: F64, sampling: SamplingPlan) -> F64:
    """(n,) amplitude of the rays that would meet points (n, 3), of the sector that lights each best."""
    track = sampling.scene.radar.track
    shares = [np.zeros(len(points))]
    for window in sampling.windows:
        antenna = track.of_pulses(slice(*window.pulses)).center_position
        shares.append(_faded(window, project(points, antenna, window.frame)))
    return np.asarray(np.max(shares, axis=0))


def _faded(window: LaunchWindow, places: F64) -> F64:
    """What the launch window leaves of rays at places (n, 2) of its plane; see :func:`sarmitsuba.trace.beam.fade`."""
    if not window.taper:  # all of the scene lies within it
        return np.ones(len(places))
    beyond = np.abs(places) - [window.half_x, window.half_y]
    t = np.clip(beyond / window.taper, 0.0, 1.0)
    return np.asarray((0.5 + 0.5 * np.cos(np.pi * t)).prod(axis=1))


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
    step = longest_step(sampling.range_cell, sampling.azimuth_cell, distance, wavelength)
    nodes = cut(scene.lines, step)
    nodes = nodes.weighted(shares(scene, nodes.point))
    if not len(nodes.point):
        return None
    return PointSource(LineScatterers(nodes, scene.lines, wavelength), most_bounces(scene))


def most_bounces(scene: Scene) -> int:
    """Bounces of the longest path of a scatterer: both ways over the ground, where the scene has any and allows it."""
    return min(scene.settings.max_depth or MOST_BOUNCES, MOST_BOUNCES) if scene.geometry.n_faces else 1


def _volumes(sampling: SamplingPlan, flags: KernelFlags) -> Source | None:
    """What scatters within bodies that waves go through, straight and over the ground."""
    scene = sampling.scene
    if not scene.volumes:
        return None
    cell = sampling.azimuth_cell * scene.radar.waveform.range_cell
    scatterers = volume_scatterers(
        scene.volumes, cell, scene.settings.seed, lambda places: shares(scene, places)
    )
    return PointSource(scatterers, most_bounces(scene)) if scatterers.n else None


def passages_of(scene: Scene) -> tuple[Passage, ...]:
    """What stands in the way of waves in a scene and lets a part of them through; nothing in most scenes."""
    return (volume_passage(scene.volumes),) if scene.volumes else ()


_MAKERS: tuple[_Maker, ...] = (_lines, _volumes, _edges)

__all__ = ["MOST_BOUNCES", "most_bounces", "passages_of", "sources_of"]
