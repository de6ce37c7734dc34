"""What returns echoes in a scene beside the surfaces that rays find, and what stands in the way of all waves."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.context import PairLevel
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.materials.cylinder import table_size
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.pairs import expected_pair_points
from sarmitsuba.simulation.sampling.cropping import shares
from sarmitsuba.simulation.sampling.launch_window import LaunchWindow
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.trace.edges import FringeCurrents
from sarmitsuba.trace.geometry import TraceScene
from sarmitsuba.trace.launch import project
from sarmitsuba.trace.lines import LineScatterers, cut, longest_step
from sarmitsuba.trace.passage import Passage
from sarmitsuba.trace.source import PointSource, Source
from sarmitsuba.trace.volumes import scatterer_spacing, volume_passage, volume_scatterers

F64 = NDArray[np.float64]

# the scatterer itself, and the ground on the way out and on the way home
MOST_BOUNCES = 3
# one line for each kind of scatterer
_Maker = Callable[[SamplingPlan, KernelFlags], Source | None]

# seconds of a usual core: a node of a rod and a number of its table and order, laid out; a rod's node and an edge's
# piece, traced; a cell of a volume's lattice, laid out, and a scatterer in it, traced through what stands in its way;
# a point that pairs are drawn from, laid out, and a pair, traced; and a draw of pairs that tells their level
ROD_NODE, ROD_NUMBER, ROD_TRACED, EDGE_TRACED = 1e-6, 1.1e-7, 1e-6, 5e-6
CELL_LAID, SCATTERER_TRACED = 1e-6, 8e-6
POINT_LAID, PAIR_TRACED, PAIRS_LEVEL = 1e-6, 2.5e-7, 0.25
# bytes of each while it is laid out: nodes, numbers of a table, cells of a volume, scatterers kept, points of pairs
ROD_BYTES, NUMBER_BYTES, CELL_BYTES, SCATTERER_BYTES, POINT_BYTES = 300, 150, 150, 100, 280
# about as many pairs as points
PAIRS_OF_POINTS = 0.1


@dataclass(frozen=True)
class Expected:
    """What a source takes, before it is made.

    Parameters
    ----------
    scatterers : about as many, all of them traced at every key pulse
    making, each : s of a usual core, to lay all out, and to trace one
    bytes : most while they are laid out
    """

    scatterers: float
    making: float
    each: float
    bytes: float


_Expects = Callable[[SamplingPlan, KernelFlags, int], Expected | None]


def sources_of(sampling: SamplingPlan, flags: KernelFlags) -> tuple[Source, ...]:
    """Sources of a scene as the effects plan leaves it; none in most scenes.

    Parameters
    ----------
    sampling : of the scene without what the plan has switched off
    flags : of the trace kernel
    """
    made = (maker(sampling, flags) for maker, _ in _KINDS)
    return tuple(source for source in made if source is not None)


def expected_sources(
    sampling: SamplingPlan,
    flags: KernelFlags,
    trace_scene: TraceScene | None = None,
    pairs: PairLevel | None = None,
    sub_bands: int = 1,
) -> tuple[Expected, ...]:
    """What each source of a scene takes, and its pairs of diffuse scatterers, before any is made.

    Parameters
    ----------
    sampling, flags : as of :func:`sources_of`
    trace_scene : geometry; None: pairs are left out
    pairs : their level, where it is known
    sub_bands : number of frequencies that the band is traced at

    Notes
    -----
    Ignores what cropped images leave of sources beside them: bounds there.
    """
    expected = [expects(sampling, flags, sub_bands) for _, expects in _KINDS]
    if flags.diffuse_pairs and trace_scene is not None:
        points = expected_pair_points(sampling, trace_scene, pairs)
        making = PAIRS_LEVEL + points * POINT_LAID
        expected.append(Expected(PAIRS_OF_POINTS * points, making, PAIR_TRACED, points * POINT_BYTES))
    return tuple(each for each in expected if each is not None)


def _edges(sampling: SamplingPlan, flags: KernelFlags) -> Source | None:
    """Sharp metal edges in pieces of half a resolution cell, as far as rays light their faces."""
    if not flags.edge_diffraction:
        return None
    scene = sampling.scene
    edges = sampling.sharp_edges
    if flags.taper:
        edges = edges.weighted(_light(edges.middle, sampling))
    return (
        PointSource(FringeCurrents(edges), most_bounces(scene) if flags.multi_bounce else 1)
        if edges.n
        else None
    )


def _expected_edges(sampling: SamplingPlan, flags: KernelFlags, sub_bands: int) -> Expected | None:
    """The edges are looked for here, and kept for the run."""
    if not flags.edge_diffraction or not sampling.sharp_edges.n:
        return None
    return Expected(sampling.sharp_edges.n, 0.0, EDGE_TRACED, 0.0)


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
    wavelength, step = scene.radar.waveform.wavelength, _line_step(sampling)
    nodes = cut(scene.lines, step)
    nodes = nodes.weighted(shares(scene, nodes.point))
    if not len(nodes.point):
        return None
    return PointSource(LineScatterers(nodes, scene.lines, wavelength), most_bounces(scene))


def _line_step(sampling: SamplingPlan) -> float:
    """Largest distance between the nodes of rods, m."""
    radar = sampling.scene.radar
    distance = min(
        float(np.linalg.norm(track.position - sampling.window.center, axis=1).min()) for track in radar.tracks
    )
    return longest_step(sampling.range_cell, sampling.azimuth_cell, distance, radar.waveform.wavelength)


def _expected_lines(sampling: SamplingPlan, flags: KernelFlags, sub_bands: int) -> Expected | None:
    """Their nodes, and a table for each thickness and material at each frequency."""
    scene = sampling.scene
    if not scene.lines:
        return None
    step, wavenumber = _line_step(sampling), 2.0 * np.pi / scene.radar.waveform.wavelength
    nodes = sum(line.length / step + 2.0 for line in scene.lines)
    tables = [
        table_size(wavenumber * radius, eps)
        for radius, eps in {(line.radius, line.permittivity) for line in scene.lines}
    ]
    terms = sum(tilts * azimuths * orders for tilts, azimuths, orders in tables)
    numbers = max(tilts * azimuths for tilts, azimuths, _ in tables)
    making = nodes * ROD_NODE + sub_bands * terms * ROD_NUMBER
    return Expected(nodes, making, ROD_TRACED, nodes * ROD_BYTES + numbers * NUMBER_BYTES)


def most_bounces(scene: Scene) -> int:
    """Bounces of the longest path of a scatterer: both ways over the ground, where the scene has any and allows it."""
    return min(scene.settings.max_depth or MOST_BOUNCES, MOST_BOUNCES) if scene.geometry.n_faces else 1


def _volumes(sampling: SamplingPlan, flags: KernelFlags) -> Source | None:
    """What scatters within bodies that waves go through, straight and over the ground."""
    scene = sampling.scene
    if not scene.volumes:
        return None
    scatterers = volume_scatterers(
        scene.volumes, _cell_area(sampling), scene.settings.seed, lambda places: shares(scene, places)
    )
    return PointSource(scatterers, most_bounces(scene)) if scatterers.n else None


def _cell_area(sampling: SamplingPlan) -> float:
    """Resolution cell across the line of elevation, m^2."""
    return sampling.azimuth_cell * sampling.scene.radar.waveform.range_cell


def _expected_volumes(sampling: SamplingPlan, flags: KernelFlags, sub_bands: int) -> Expected | None:
    """The cells of the boxes about the bodies are walked, and those in a body kept."""
    volumes, area = sampling.scene.volumes, _cell_area(sampling)
    if not volumes:
        return None
    steps = [scatterer_spacing(volume, area) for volume in volumes]
    boxes = [
        float(np.prod(np.ptp(volume.bounds, axis=0) / step + 1.0))
        for volume, step in zip(volumes, steps, strict=True)
    ]
    kept = sum(volume.content / step**3 for volume, step in zip(volumes, steps, strict=True))
    return Expected(
        kept, sum(boxes) * CELL_LAID, SCATTERER_TRACED, max(boxes) * CELL_BYTES + kept * SCATTERER_BYTES
    )


def passages_of(scene: Scene) -> tuple[Passage, ...]:
    """What stands in the way of waves in a scene and lets a part of them through; nothing in most scenes."""
    return (volume_passage(scene.volumes),) if scene.volumes else ()


_KINDS: tuple[tuple[_Maker, _Expects], ...] = (
    (_lines, _expected_lines),
    (_volumes, _expected_volumes),
    (_edges, _expected_edges),
)

__all__ = ["MOST_BOUNCES", "Expected", "expected_sources", "most_bounces", "passages_of", "sources_of"]
