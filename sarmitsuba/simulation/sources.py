"""What returns echoes in a scene beside the surfaces that rays find."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.simulation.sampling.launch_window import LaunchWindow
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.trace.edges import FringeCurrents, edges_of
from sarmitsuba.trace.launch import project
from sarmitsuba.trace.source import PointSource, Source

F64 = NDArray[np.float64]

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
        edges = edges.weighted(_lit(edges.middle, sampling))
    return PointSource(FringeCurrents(edges), 3 if flags.multi_bounce else 1) if edges.n else None


def _lit(points: F64, sampling: SamplingPlan) -> F64:
    """(n,) amplitude of the rays that would meet points (n, 3), of the sector that lights each best."""
    track = sampling.scene.radar.track
    shares = [np.zeros(len(points))]
    for window in sampling.windows:
        antenna = track.of_pulses(slice(*window.pulses)).center_position
        shares.append(_faded(window, project(points, antenna, window.frame)))
    return np.asarray(np.max(shares, axis=0))


def _faded(window: LaunchWindow, places: F64) -> F64:
    """What the launch window leaves of rays at places (n, 2) of its plane; see :func:`sarmitsuba.trace.beam.fade`."""
    beyond = np.abs(places) - [window.half_x, window.half_y]
    if not window.taper:
        return np.asarray((beyond <= 0.0).all(axis=1), dtype=np.float64)
    t = np.clip(beyond / window.taper, 0.0, 1.0)
    return np.asarray((0.5 + 0.5 * np.cos(np.pi * t)).prod(axis=1))


_MAKERS: tuple[_Maker, ...] = (_edges,)

__all__ = ["sources_of"]
