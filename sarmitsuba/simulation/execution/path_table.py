"""Table of the individual paths of a pulse's echo or of a pixel: hit points, lengths and amplitudes."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128, F64, I32, U8
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.parameters import fill_description
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.machine.backend import dr
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.simulation.execution.blame import blame_stages, check_traced
from sarmitsuba.simulation.execution.points import point_echo, point_history
from sarmitsuba.simulation.execution.recording import Gate, Recording, Rows
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import AntennaStates, Tracer
from sarmitsuba.simulation.planning.prediction.counting import check_rays
from sarmitsuba.simulation.planning.sampling.density_plan import azimuth_cell
from sarmitsuba.simulation.planning.sampling.rays import Rays
from sarmitsuba.tracing.kernel.source import Launch
from sarmitsuba.tracing.kernel.state import RECIPROCAL, REVERSED

# kinds of path by their number: physical optics; diffuse scatterer, straight to the antenna; diffuse scatterer,
# reciprocal (back along the chain of mirrors); ideal point; diffuse scatterer, reversed (through mirrors to a separate
# receiver); scatterer at a known position
KINDS = ("coherent", "diffuse", "reciprocal", "point", "reversed", "scatterer")
POINT = 3
# initial capacity for contributions, per ray and at least; a launch with more contributions is repeated
ROOM_PER_RAY, LEAST_ROOM = 2, 1 << 16
# change of amplitudes over the band that gives a warning, dB: a tenth of the amplitude
CHANGES_DB = -20.0


@dataclass(frozen=True, eq=False)
class PathTable:
    """Table of paths from the antenna over the scene and back, one per row, strongest first within a pulse.

    Parameters
    ----------
    channels : of the last axis of ``amplitude``
    mesh_names, material_names : names indexed by ``shape`` and ``material``
    pulse : (n,) int32 number of the pulse
    kind : (n,) uint8 index into ``KINDS``
    order : (n,) int32 number of bounces, from 1
    length : (n,) float64, m, from the transmitter over the scene to the receiver
    range_rate : (n,) float64, m/s, of half the length
    amplitude : (n, n_channels) complex128, sqrt(W), with the phase ``exp(-j 2 pi length / wavelength)``
    points : (n, n_most, 3) float64, m, scene frame; bounce after bounce, NaN beyond the last bounce. The bounce at
        which the path turns back is its phase centre: the diffuse scatterer, or the phase centre of the tube on the
        facet; of a pair of diffuse scatterers both bounces are given at the midpoint between the two
    face : (n, n_most) int32 row of ``Scene.geometry.faces``, beyond these of ground that
        goes on (:func:`sarmitsuba.scene.ground.continue_ground`); -1 where there is none
    shape : (n, n_most) int32 number of the mesh, -1 where there is none
    material : (n, n_most) int32 index into ``Scene.materials``, -1 where there is none

    Notes
    -----
    The other bounces are the hits of the tube's central ray, so that the legs of a path behind mirrors add up to its
    length to second order in the tube's width. Transmission through slabs is no bounce; the length includes its delay.
    For scatterers at known positions, such as a wire over the ground, all bounces are given at the phase centre, on no
    face.
    """

    channels: tuple[str, ...]
    mesh_names: tuple[str, ...]
    material_names: tuple[str, ...]
    pulse: I32
    kind: U8
    order: I32
    length: F64
    range_rate: F64
    amplitude: C128
    points: F64
    face: I32
    shape: I32
    material: I32

    def __len__(self) -> int:
        return int(self.length.size)

    def __repr__(self) -> str:
        kinds = ", ".join(
            f"{n} {KINDS[k]}" for k, n in enumerate(np.bincount(self.kind, minlength=len(KINDS))) if n
        )
        pulses = np.unique(self.pulse).size
        return (
            f"PathTable({len(self)} paths of {pulses} pulses: {kinds or 'none'}; {', '.join(self.channels)})"
        )

    def __getitem__(self, rows: "slice | ArrayLike") -> "PathTable":
        """Table of some of the rows: a slice, a mask, or one or more numbers."""
        pick = rows if isinstance(rows, slice) else np.atleast_1d(rows)
        one = {f.name: getattr(self, f.name)[pick] for f in fields(self) if f.name not in _NAMES}
        return fill_description(self, one)

    @property
    def slant_range(self) -> F64:
        """Slant range (n,) float64, m, of the path in the echo: half its length."""
        return 0.5 * self.length

    @property
    def power(self) -> F64:
        """Power (n,) float64, W, summed over channels."""
        return np.asarray((np.abs(self.amplitude) ** 2).sum(axis=1))

    def strongest(self, share: float) -> "PathTable":
        """The strongest paths of each pulse that together hold this share (0 ... 1) of the sum of all powers.

        Notes
        -----
        Powers are summed, not amplitudes: the echo of a large plate is the residue of thousands of strong paths that
        nearly cancel.
        """
        if not 0.0 < share <= 1.0:
            raise RadarError(f"strongest = {share:g} is not a share of the energy; give more than 0, up to 1")
        kept = []
        power = self.power
        for pulse in np.unique(self.pulse):
            mine = np.flatnonzero(self.pulse == pulse)
            mine = mine[np.argsort(-power[mine], kind="stable")]
            total = np.cumsum(power[mine])
            kept.append(mine[: int(np.searchsorted(total, share * total[-1] * (1.0 - 1e-12))) + 1])
        return self[np.concatenate(kept)] if kept else self


_NAMES = ("channels", "mesh_names", "material_names")


def _name_path(path: PathTable) -> str:
    """Description of one path."""
    order = int(path.order[0])
    shape, material = (int(v[0, order - 1]) for v in (path.shape, path.material))
    last = "from no shape"
    if shape >= 0:
        last = (
            f'that ends on the shape "{path.mesh_names[shape]}", material "{path.material_names[material]}",'
        )
    return f"pulse {path.pulse[0]}: a path of {order} bounce{'s' if order > 1 else ''} {last}"


@exclusive
def trace_paths(
    scene: SceneLike,
    pulses: int | Sequence[int] | None = None,
    *,
    strongest: float = 1.0,
    near: ArrayLike | None = None,
    cells: float = 1.0,
    seed: int | None = None,
    plan: EffectsPlan | None = None,
    pass_index: int = 0,
) -> PathTable:
    """Table of all paths of single pulses, coherent and diffuse.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene
    pulses : number or numbers of pulses, negative ones from the end; None takes the middle one
    strongest : wanted share of the energy; see :meth:`PathTable.strongest`
    near : (3,) m, scene frame; keeps only the paths of one pixel, such as ``image.grid.positions()[i, j]``: those with
        the slant range and range rate of this point
    cells : largest distance of paths from the point, resolution cells in range and azimuth; 1 is the first null of an
        unweighted response
    seed : overrides the scene's
    plan : overrides the automatic effects plan
    pass_index : as for :func:`sarmitsuba.simulation.execution.raw.simulate`

    Returns
    -------
    the paths whose sum is the pulse's echo by method ``raw`` with the same seed, without noise and with the effect
    ``wideband`` off: each contributes ``amplitude sinc((r - slant_range) / range_cell)``; with the effect
    ``motion_in_pulse`` it is also shifted by its range rate, see :mod:`sarmitsuba.signal.pulse_motion`

    Raises
    ------
    RadarError
        There is no such pulse, or ``strongest`` or ``cells`` is out of bounds.

    Notes
    -----
    Limitations are those of the kernel. One launch per lattice of rays and pulse; a launch with more paths than the
    memory holds is repeated. Amplitudes are those at the carrier, also for wide bands.
    """
    table = PathTracer(Scene.of(scene), seed=seed, plan=plan, pass_index=pass_index).trace(
        pulses, near=near, cells=cells
    )
    return table if strongest == 1.0 else table.strongest(strongest)


class PathTracer:
    """Tracer of path tables for several pulses or pixels of a scene that is prepared once.

    Parameters
    ----------
    scene, seed, plan, pass_index : as for :func:`trace_paths`
    """

    def __init__(
        self, scene: Scene, *, seed: int | None = None, plan: EffectsPlan | None = None, pass_index: int = 0
    ) -> None:
        settings = replace(scene.settings, method="raw", keep_subsets=False, keep_orders=False)
        if seed is not None:
            settings = replace(settings, seed=seed)
        self._run = Run(replace(scene, settings=settings), plan=plan)
        self._tracer: Tracer | None = None
        self._rays: Rays | None = None
        wideband = self._run.plan.decision("wideband")
        if wideband is not None and wideband.on and wideband.error_db > CHANGES_DB:
            text = (
                f"{scene.name}: tables of paths hold the amplitudes at the carrier, and echoes change over the band; "
                "give wideband=off to the integrator for echoes with the carrier's amplitudes at all frequencies"
            )
            warnings.warn(text, SarmitsubaWarning, stacklevel=3)
        if self._run.sampling is not None:
            check_rays(f"{scene.name}: a table of paths", self._run.sampling, self._run.layers)
            self._tracer = self._run.tracer(self._run.sampling)
            self._rays = self._run.rays(self._run.sampling, pass_index)

    def trace(
        self, pulses: int | Sequence[int] | None = None, *, near: ArrayLike | None = None, cells: float = 1.0
    ) -> PathTable:
        """All paths, strongest first within a pulse; see :func:`trace_paths`."""
        run = self._run
        radar = run.scene.radar
        wanted = _pulse_numbers(radar, pulses)
        if not cells > 0.0:
            raise RadarError(f"cells = {cells:g} is not above 0")
        gate = None if near is None else _gate(run.scene, np.asarray(near, dtype=np.float64), cells)
        parts = [_list_points(run, pulse, gate) for pulse in wanted]
        if self._tracer is not None and self._rays is not None:
            for pulse in wanted:
                self._tracer.pose(radar.track.time[pulse : pulse + 1])
                serving = [grid for grid in self._rays.at(pulse)[0] if grid.serves(pulse)]
                parts += [
                    _trace_launch(run, self._tracer, launch, pulse, gate)
                    for launch in self._tracer.launches(serving, 1)
                ]
        table = join_tables(parts)
        lost = ~(np.isfinite(table.power) & np.isfinite(table.length) & np.isfinite(table.range_rate))
        if lost.any():
            blame_stages(run.plan.flags, f"{run.scene.name}: {_name_path(table[lost][0:1])}", lambda _: True)
            check_traced(
                np.zeros(0, np.complex64), np.nan, run.scene.name, lambda: _name_path(table[lost][0:1])
            )
        phase = np.exp(-2j * np.pi / radar.waveform.wavelength * table.length)
        table = replace(table, amplitude=table.amplitude * phase[:, None])
        return table[np.lexsort((-table.power, table.pulse))]


def _pulse_numbers(radar: Radar, pulses: int | Sequence[int] | None) -> list[int]:
    n = radar.track.n_pulses
    if pulses is None:
        return [radar.track.center_index]
    given = [pulses] if isinstance(pulses, int | np.integer) else list(pulses)
    for pulse in given:
        if not -n <= pulse < n:
            raise RadarError(f"pulse {pulse} is not there; the track has the pulses 0 ... {n - 1}")
    return list(dict.fromkeys(int(pulse) % n for pulse in given))


def _gate(scene: Scene, point: F64, cells: float) -> Gate:
    """Gate about the slant range and range rate of a point at every pulse, as wide as its resolution cells."""
    if point.shape != (3,) or not np.isfinite(point).all():
        raise RadarError(f"near has the shape {point.shape}; give one finite point (3,), m, scene frame")
    track = scene.radar.track
    distance, rate = point_history(scene.radar, PointTarget("near", point), slice(None))
    # change of the range rate for a step along the track, by the rotation of the line of sight
    per_metre = (np.einsum("ni,ni->n", track.velocity, track.velocity) - rate**2) / distance
    speed = np.linalg.norm(track.velocity, axis=1)
    half_rate = cells * azimuth_cell(scene) * per_metre / np.maximum(speed, 1e-300)
    return Gate(distance, rate, np.full(distance.shape, cells * scene.radar.waveform.range_cell), half_rate)


def _trace_launch(run: Run, tracer: Tracer, launch: Launch, pulse: int, gate: Gate | None) -> PathTable:
    """Paths of one launch from one pulse."""
    radar, part = run.scene.radar, launch.part
    pick = slice(pulse, pulse + 1)
    one = None if gate is None else Gate(*(getattr(gate, f.name)[pick] for f in fields(Gate)))
    most = max(LEAST_ROOM, ROOM_PER_RAY * part.count)
    room = (LEAST_ROOM if gate is not None and part.rays else most, most if part.rays else 0)
    while True:
        recording = Recording(max(1, part.rays), len(radar.channels), room, one)
        kernel = tracer.kernel_of(part.grid, AntennaStates.on_tracks(radar, pick), recording)
        counts, state = launch.record(kernel, radar.antenna, recording)
        dr.eval(counts.hits, state, recording.memory)
        if recording.whole:
            rows = recording.rows()
            return _table(run, tracer, rows, pulse) if part.rays else _list_places(run.scene, rows, pulse)
        room = recording.found()


def _list_places(scene: Scene, rows: Rows, pulse: int) -> PathTable:
    """Table of scatterers at known positions; amplitudes still without the phase of the length."""
    order = rows.labels[:, 2].astype(np.int32)
    there = np.arange(1, int(order.max(initial=1)) + 1) <= order[:, None]
    nothing = np.full(there.shape, -1, dtype=np.int32)
    return replace(
        _empty(scene),
        pulse=np.full(order.size, pulse, dtype=np.int32),
        kind=rows.labels[:, 1].astype(np.uint8),
        order=order,
        length=2.0 * rows.lengths[:, 0],
        range_rate=rows.lengths[:, 1].copy(),
        amplitude=rows.amplitudes.astype(np.complex128),
        points=np.where(there[..., None], rows.lengths[:, None, 2:], np.nan),
        face=nothing,
        shape=nothing,
        material=nothing,
    )


def _table(run: Run, tracer: Tracer, rows: Rows, pulse: int) -> PathTable:
    """Table of the rows of a recording; amplitudes still without the phase of the length."""
    scene = run.scene
    kind, order = (rows.labels[:, i].astype(np.int64) for i in (1, 2))
    turn = np.where(kind == RECIPROCAL, (order + 1) // 2, order)  # bounce at which the path turns back
    chain, chain_rows = rows.chains(turn)
    path = np.arange(kind.size)
    most = int(order.max(initial=1))
    step = np.arange(1, most + 1)
    # reciprocal paths: back through the chain
    bounce = np.where(step <= turn[:, None], step, 2 * turn[:, None] - step)
    bounce = np.where((kind == REVERSED)[:, None], order[:, None] + 1 - step, bounce)
    there = step <= order[:, None]
    bounce = np.where(there, bounce, 1) - 1
    points = chain[path[:, None], bounce]
    points[path, np.where(kind == REVERSED, 0, turn - 1)] = rows.lengths[:, 2:]
    points[~there] = np.nan
    row = chain_rows[path[:, None], bounce]
    assert not (there & (row < 0)).any()
    face = np.where(there, tracer.trace_scene.geometry_faces[np.where(there, row, 0)], -1).astype(np.int32)
    geometry = scene.geometry
    shape = np.searchsorted(geometry.mesh_face_offset, face, side="right") - 1
    return replace(
        _empty(scene),
        pulse=np.full(kind.size, pulse, dtype=np.int32),
        kind=kind.astype(np.uint8),
        order=order.astype(np.int32),
        length=2.0 * rows.lengths[:, 0],
        range_rate=rows.lengths[:, 1].copy(),
        amplitude=rows.amplitudes.astype(np.complex128),
        points=points,
        face=face,
        shape=np.where(there, shape, -1).astype(np.int32),
        material=np.where(there, geometry.face_material[np.where(there, face, 0)], -1).astype(np.int32),
    )


def _list_points(run: Run, pulse: int, gate: Gate | None) -> PathTable:
    """Table of the paths of visible ideal points at a pulse."""
    scene, pick = run.scene, slice(pulse, pulse + 1)
    channels = scene.radar.channels
    flags = run.plan.flags
    wavelength = scene.radar.waveform.wavelength
    rows = []
    for point in scene.points:
        echo = point_echo(scene, flags, run.trace_scene, point, pick, wavelength)
        distance, rate = float(echo.slant_range[0]), float(echo.range_rate[0])
        outside = gate is not None and (
            abs(distance - gate.slant_range[pulse]) > gate.half_range[pulse]
            or abs(rate - gate.range_rate[pulse]) > gate.half_rate[pulse]
        )
        if echo.seen[0] and echo.amplitude[0] and not outside:
            shown = [echo.channel(channel)[0] for channel in channels]
            rows.append((distance, rate, shown, point.position_at(scene.radar.track.time[pulse])))
    n = len(rows)
    none = np.full((n, 1), -1, dtype=np.int32)
    return replace(
        _empty(scene),
        pulse=np.full(n, pulse, dtype=np.int32),
        kind=np.full(n, POINT, dtype=np.uint8),
        order=np.ones(n, dtype=np.int32),
        length=2.0 * np.array([row[0] for row in rows], dtype=np.float64),
        range_rate=np.array([row[1] for row in rows], dtype=np.float64),
        amplitude=np.array([row[2] for row in rows], dtype=np.complex128).reshape(n, len(channels)),
        points=np.array([row[3] for row in rows], dtype=np.float64).reshape(n, 1, 3),
        face=none,
        shape=none,
        material=none,
    )


def _empty(scene: Scene) -> PathTable:
    """Table without rows."""
    number, none = np.zeros(0, dtype=np.int32), np.zeros((0, 1), dtype=np.int32)
    return PathTable(
        channels=scene.radar.channels,
        mesh_names=scene.geometry.mesh_names,
        material_names=tuple(material.name for material in scene.materials),
        pulse=number,
        kind=np.zeros(0, dtype=np.uint8),
        order=number,
        length=np.zeros(0),
        range_rate=np.zeros(0),
        amplitude=np.zeros((0, len(scene.radar.channels)), dtype=np.complex128),
        points=np.zeros((0, 1, 3)),
        face=none,
        shape=none,
        material=none,
    )


def join_tables(tables: Sequence[PathTable]) -> PathTable:
    """Concatenation of several tables of the same scene."""
    most = max(table.points.shape[1] for table in tables)
    wide = [_widen_table(table, most) for table in tables]
    columns = [f.name for f in fields(PathTable) if f.name not in _NAMES]
    return fill_description(
        wide[0], {name: np.concatenate([getattr(t, name) for t in wide]) for name in columns}
    )


def _widen_table(table: PathTable, most: int) -> PathTable:
    """Table with space for ``most`` bounces."""
    more = most - table.points.shape[1]
    pad = ((0, 0), (0, more))
    numbers = {
        name: np.pad(getattr(table, name), pad, constant_values=-1) for name in ("face", "shape", "material")
    }
    points = np.pad(table.points, (*pad, (0, 0)), constant_values=np.nan)
    return fill_description(table, {**numbers, "points": points})
