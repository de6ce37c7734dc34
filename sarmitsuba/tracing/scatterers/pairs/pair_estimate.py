"""Pairs of diffuse scatterers of a scene: their number, and their power relative to the clutter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64, box_of_each, boxes_meet
from sarmitsuba.core.units import power_from_db
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.mesh.surface_samples import spanned_area, surface_samples
from sarmitsuba.tracing.kernel.launch import LaunchGrid, PulseBatch, frame_towards
from sarmitsuba.tracing.kernel.leg import Surroundings
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.source import launches
from sarmitsuba.tracing.kernel.state import Contribution, Kernel, KernelSettings
from sarmitsuba.tracing.scatterers.pairs.diffuse_pairs import PairSource
from sarmitsuba.tracing.scatterers.pairs.kind import PAIRS, PairLevel
from sarmitsuba.tracing.scatterers.pairs.pair_search import SurfacePairs, find_pairs
from sarmitsuba.tracing.scatterers.sources import Site

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.kernel import LaneArrays


# approximate number of points for the estimate of the level: two per cent error if half of them contribute
PILOT_POINTS = 30_000
# bound on the points of a run, and their least cell relative to that of the diffuse scatterers: pairs then cost no
# more than the rays
MOST_POINTS, FINEST = 500_000, 0.5
# largest number of cells visited per wanted point
MOST_CELLS = 16
# least number of pairs in a square of the ground for an estimate of its level
SQUARE_PAIRS = 30


@dataclass(frozen=True, eq=False)
class PairEstimate:
    """Estimated power of pairs of diffuse scatterers at the middle of the track.

    Parameters
    ----------
    cell : m, of the points from which they were drawn
    pairs : the drawn pairs
    power : (n,) float64, m^2, mean of HH and VV of each
    cross : m^2, HV of all; 0 where the radar records no cross-polar channel
    """

    cell: float
    pairs: SurfacePairs
    power: F64
    cross: float = 0.0


def run_pairs(site: Site, pilot: PairEstimate) -> SurfacePairs:
    """SurfacePairs of a run, as many as their sampling error requires."""
    return scene_pairs(site, _cell_of_run(site, pilot, _pair_areas(site)))


def pair_level(site: Site) -> PairLevel:
    """Level of pairs of diffuse scatterers relative to the clutter, estimated at the middle of the track.

    Parameters
    ----------
    site : of the run
    """
    areas = _pair_areas(site)
    pilot = estimate_pairs(site, _cell_for(areas, PILOT_POINTS))
    total = float(pilot.power.sum())
    count = int((pilot.power > 0.0).sum())
    if not total or not pilot.pairs.clutter:
        return PairLevel(
            share=0.0,
            error=0.0,
            strongest=0.0,
            square=0.0,
            pairs=count,
            realisation_error=0.0,
            cell=pilot.cell,
        )
    strongest, square = _strongest(site, pilot)
    cell = _cell_of_run(site, pilot, areas)
    finer = cell / pilot.cell
    share = total / pilot.pairs.clutter
    return PairLevel(
        share=share,
        error=float(np.sqrt(np.square(pilot.power).sum())) / pilot.pairs.clutter,
        strongest=strongest,
        square=square,
        pairs=count,
        realisation_error=min(share, _realisation_error(site, pilot) * finer**2),
        cell=cell,
        cross=_divide_by_clutter(pilot.cross, pilot.pairs.cross),
    )


def _divide_by_clutter(power: float, clutter: float) -> float:
    """Power relative to the clutter; infinite where there is no clutter."""
    if power == 0.0:
        return 0.0
    return power / clutter if clutter > 0.0 else float("inf")


def scene_pairs(site: Site, cell: float) -> SurfacePairs:
    """SurfacePairs of points on the lit diffuse surfaces at rest, with one point in each cell (m)."""
    trace_scene = _geometry(site)
    if not site.flags.texture:
        trace_scene = replace(trace_scene, surfaces=None)
    usable = _usable(site)
    box = site.box + np.array([[-cell], [cell]])
    rows = np.flatnonzero(usable & boxes_meet(trace_scene.triangles, box))
    seed = site.scene.settings.seed
    samples = surface_samples(trace_scene.triangles[rows], cell, box, seed)
    samples = replace(samples, face=rows[samples.face])
    around = Surroundings.of(trace_scene, site.flags, site.wavelength)
    pairs = find_pairs(around, samples, site.views, cell, box, seed=seed, scatters=usable)
    keep = usable[pairs.face[:, 1]]
    return replace(
        pairs,
        **{name: getattr(pairs, name)[keep] for name in ("point", "normal", "face", "weight", "key")},
    )


def _geometry(site: Site) -> TraceScene:
    assert site.trace_scene is not None
    return site.trace_scene


def _usable(site: Site) -> NDArray[np.bool_]:
    """Mask of the faces that scatter diffusely and are at rest."""
    trace_scene = _geometry(site)
    scene = site.scene
    scatters = np.array([any(p.scatters for p in list_with_parts([m])) for m in scene.materials], dtype=bool)
    usable = scatters[scene.geometry.face_material[trace_scene.geometry_faces]]
    if site.flags.texture and trace_scene.surfaces is not None:  # materials by place
        usable[:] = True
    if trace_scene.movers is not None:
        usable &= trace_scene.movers.number == 0
    return np.asarray(usable)


def pilot_cell(site: Site, points: float) -> float:
    """Edge of the cells that give about ``points`` points, m; a power of the square root of two.

    Similar looks and passes have the same. Oblique slivers have many more cells in their bounding rectangle than
    points: at most ``MOST_CELLS`` for each point are visited.
    """
    return _cell_for(_pair_areas(site), points)


def _cell_for(areas: tuple[float, float], points: float) -> float:
    """As :func:`pilot_cell`, from the areas of :func:`_pair_areas`."""
    return _rounded_down(float(np.sqrt(max(*areas, 1e-6) / points)))


def expected_pair_points(site: Site) -> float:
    """Estimated number of points for the pairs of a run; the upper bound where no level is known."""
    areas = _pair_areas(site)
    finest = max(_cell_for(areas, MOST_POINTS), FINEST * site.scatterer_cell)
    known = site.measured.get(PAIRS)
    cell = known.cell if isinstance(known, PairLevel) else finest
    return areas[0] / cell**2


def _pair_areas(site: Site) -> tuple[float, float]:
    """Area on which points are drawn, in the planes of their cells, and area of the visited cells, m^2."""
    triangles = _geometry(site).triangles
    triangles = triangles[_usable(site) & boxes_meet(triangles, site.box)]
    least, most = box_of_each(triangles)
    whole = np.prod(np.partition(most - least, 1, axis=1)[:, 1:], axis=1)
    size = np.minimum(most, site.box[1]) - np.maximum(least, site.box[0])
    within = np.prod(np.partition(size, 1, axis=1)[:, 1:], axis=1)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1) * within / np.maximum(whole, 1e-12)
    return float(area.sum()), spanned_area(triangles, site.box) / MOST_CELLS


def _realisation_error(site: Site, found: PairEstimate) -> float:
    r"""Error of the image by the random choice of pairs, relative to the power of the clutter.

    A resolution cell in which pairs of powers w return is :math:`\delta` off in its mean power,
    :math:`\langle \delta^2 \rangle = \sum w^2 / (\sum w)^2`, and :math:`\delta / 2` in its field: a quarter of that
    square is error energy. It falls with the number of pairs; squares of the ground stand for the resolution cells in
    them.
    """
    if not found.power.any() or not found.pairs.clutter:
        return 0.0
    squares, side = _squares(found)
    power, fourth = (np.bincount(squares, w) for w in (found.power, np.square(found.power)))
    lit = power > 0.0
    resolved = side**2 / site.resolution**2
    return 0.25 * resolved * float((fourth[lit] / power[lit]).sum()) / found.pairs.clutter


def _cell_of_run(site: Site, pilot: PairEstimate, areas: tuple[float, float]) -> float:
    """Edge of the cells of a run, m: the sampling error equals the tolerance, or the cells are as fine as allowed."""
    error = _realisation_error(site, pilot)
    if error == 0.0:
        return pilot.cell
    tolerance = power_from_db(site.scene.settings.tolerance_db)
    wanted = _rounded_down(pilot.cell * float(np.sqrt(tolerance / error)))
    finest = max(_cell_for(areas, MOST_POINTS), FINEST * site.scatterer_cell)
    return min(pilot.cell, max(wanted, finest))


def _rounded_down(cell: float) -> float:
    return float(2.0 ** (0.5 * np.floor(2.0 * np.log2(cell) + 1e-9)))


def _squares(found: PairEstimate) -> tuple[NDArray[np.intp], float]:
    """Index of the square of the ground in which each pair lies, and the side of the squares, m."""
    middle = found.pairs.point.mean(axis=1)[:, :2]
    lit = found.power > 0.0
    low, high = middle.min(axis=0), middle.max(axis=0)
    extent = np.maximum(high - low, 1e-3)
    side = float(np.sqrt(extent.prod() * SQUARE_PAIRS / max(int(lit.sum()), 1)))
    columns = int(extent[0] / side) + 1
    at = ((middle - low) / side).astype(np.intp)
    return at[:, 1] * columns + at[:, 0], side


def _strongest(site: Site, found: PairEstimate) -> tuple[float, float]:
    """Largest power of a square relative to the mean clutter of the same area; side of the squares, m."""
    squares, side = _squares(found)
    ground = float(np.prod(np.ptp(site.box[:, :2], axis=0)))
    clutter = found.pairs.clutter * side**2 / max(ground, side**2)
    count = np.bincount(squares, found.power > 0.0)
    power = np.where(count >= SQUARE_PAIRS / 3, np.bincount(squares, found.power), 0.0)
    return float(power.max()) / clutter, side


def estimate_pairs(site: Site, cell: float) -> PairEstimate:
    """Power of randomly drawn pairs, seen from the middle of the track."""
    pairs = scene_pairs(site, cell)
    if not pairs.n:
        return PairEstimate(cell, pairs, np.zeros(0))

    def power(channels: tuple[str, ...], *, depolarised: bool) -> F64:
        echo = pair_echo(
            pairs,
            _geometry(site),
            site.views[len(site.views) // 2],
            site.center,
            replace(site.flags, channels=channels, depolarisation=depolarised),
            wavelength=site.wavelength,
            seed=site.scene.settings.seed,
        )
        return np.asarray(np.square(np.abs(echo.amplitude)).mean(axis=1))

    cross = 0.0
    if any(channel[0] != channel[1] for channel in site.scene.radar.channels):
        cross = float(power(("HV",), depolarised=site.flags.depolarisation).sum())
    return PairEstimate(cell, pairs, power(("HH", "VV"), depolarised=False), cross)


@dataclass(frozen=True, eq=False)
class PairEcho:
    """Echoes of pairs at one antenna position.

    Parameters
    ----------
    amplitude : (n, n_channels) complex128, m; root of the RCS, without the phase of the slant range
    slant_range : (n,) float64, m
    """

    amplitude: C128
    slant_range: F64


def pair_echo(
    pairs: SurfacePairs,
    trace_scene: TraceScene,
    position: F64,
    center: F64,
    flags: KernelFlags,
    *,
    wavelength: float,
    seed: int = 0,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> PairEcho:
    """Echoes of pairs at one antenna position, without antenna pattern and launch window.

    Parameters
    ----------
    position, center : (3,) m, of the antenna, and of the point for which spreading is computed
    flags : effects and channels
    wavelength : m
    seed : of the random phases
    up : vertical reference of the polarisation
    """
    reference = float(np.linalg.norm(center - position))
    frame = frame_towards(position[None], center, np.array([0.0, 1.0, 0.0]))
    none = np.zeros(0, np.float32)
    grid = LaunchGrid(none, none, 1.0, 0.0, 1.0, 1.0, 0.0)
    settings = KernelSettings(
        wavelength=wavelength,
        max_depth=1,
        cell=1.0,
        seed=seed,
        amplitude=reference**2,
        reference_range=reference,
        up=up,
    )
    flags = replace(flags, antenna_pattern=False, spreading=False, taper=False)
    batch = PulseBatch(position[None], np.zeros((1, 3)), frame)
    kernel = Kernel.of(trace_scene, grid, batch, flags, settings)
    echoes = []
    for launch in launches([PairSource(pairs)], [grid], 1):
        kept = _Kept(launch.part.count, len(flags.channels))
        _, state = launch.record(kernel, Antenna(), kept)
        dr.eval(state, kept.memory, kept.slant_range)
        amplitude = kept.memory.numpy().astype(np.float64).reshape(launch.part.count, -1, 2)
        echoes.append((amplitude[..., 0] + 1j * amplitude[..., 1], kept.slant_range.numpy()))
    return PairEcho(*(np.concatenate(column) for column in zip(*echoes, strict=True)))


class _Kept:
    """Accumulator that stores amplitudes and slant range of each lane.

    See :func:`sarmitsuba.tracing.kernel.kernel.trace`.
    """

    def __init__(self, n_lanes: int, n_channels: int) -> None:
        self.n_lanes, self.n_channels = n_lanes, n_channels
        self.memory = dr.zeros(mi.Float, 2 * n_lanes * n_channels)
        self.slant_range = dr.zeros(mi.Float64, n_lanes)

    def begin(self) -> LaneArrays:
        """The lane's number."""
        return (dr.arange(mi.UInt32, self.n_lanes),)

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """Store a contribution; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        (lane,), active = state, contribution.active
        dr.scatter(self.slant_range, contribution.slant_range, lane, active)
        for i, a in enumerate(contribution.amplitudes):
            slot = 2 * (self.n_channels * lane + i)
            dr.scatter(self.memory, a.real, slot, active)
            dr.scatter(self.memory, a.imag, slot + 1, active)
        return state
