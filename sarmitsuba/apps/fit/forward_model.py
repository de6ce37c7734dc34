"""Raw data of a scene and their derivatives, with rays, blocks of pulses and effects that stay the same.

Batches of pulses are traced with the derivatives of every echo behind its channels. Derivatives of ideal points are
differences of their closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.material_parameters import change_material
from sarmitsuba.apps.fit.moving_edges import EdgeBatches
from sarmitsuba.apps.fit.parameter import Derivatives, Parameter, Step
from sarmitsuba.apps.fit.parsing import At, Found, Needed
from sarmitsuba.apps.fit.radar_parameters import BeamPointing
from sarmitsuba.apps.fit.shape_parameters import ComposedMoves
from sarmitsuba.core.arrays import C64, C128, F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.effects.effect import idealise_receiver
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track_errors import turn_axes
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.signal.sub_bands import RangeFilter
from sarmitsuba.simulation.execution.blocks import Blocks
from sarmitsuba.simulation.execution.metadata import raw_metadata
from sarmitsuba.simulation.execution.points import add_points
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.execution.tracing import (
    Batch,
    BatchTracer,
    KeyPulse,
    Pulses,
    Tracer,
    build_geometry,
)
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.derivatives.tangents import MOST, Displacement, StepTables, Tangents
from sarmitsuba.tracing.kernel.source import Source
from sarmitsuba.tracing.kernel.stage import own_stages

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene


class TangentBatches(BatchTracer):
    """Tracing of batches with the derivatives of every echo behind its channels.

    The layers of a batch are the channels, their derivatives by a common slant range, by each displacement, by each
    level and by each property. In a block of pulses derivatives of range rates times the time from the key pulse belong
    to those by displacements.
    """

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: channels, and those of every derivative."""
        return super().amplitudes * self.tangents.recorded

    @property
    def tangents(self) -> Tangents:
        """Derivatives that are recorded."""
        assert isinstance(self.tracer.tangents, Tangents)
        return self.tracer.tangents

    def of_grid(self, pulses: Pulses, grid: C64, share: RangeFilter | None) -> C64:
        """See the base class."""
        tangents = self.tangents
        radar = self.tracer.sampling.scene.radar
        c = len(radar.channels)
        moved = c * (1 + len(tangents.displacements))
        carrier = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
        farther = pulses.profiles(grid[:moved], partial(make_range_derivative, carrier, share))
        parts = [pulses.profiles(grid[:c], share), farther]
        end = c * (1 + tangents.count)
        if end > moved:
            parts.append(pulses.profiles(grid[moved:end], share))
        if tangents.pointing and isinstance(pulses, KeyPulse) and pulses.beam:
            parts[-1][-2 * c : -c] += pulses.by_azimuth(grid[:c], share)
        if tangents.rates and isinstance(pulses, KeyPulse) and pulses.each > 1:
            # slant ranges within the block change by those of the key pulse and by the range rate's times the time
            turning = pulses.profiles(grid[end:], partial(make_range_derivative, carrier, share))
            farther[c:] += pulses.plan.tau.astype(np.float32)[:, None] * turning
        return np.concatenate(parts)


def make_range_derivative(carrier: float, share: RangeFilter | None, cycles_per_metre: F64) -> C128:
    """Factor on the spectrum of range profiles that differentiates by the slant range, rad/m."""
    factor = -1j * (carrier + 2.0 * np.pi * cycles_per_metre)
    return np.asarray(factor if share is None else factor * share(cycles_per_metre), dtype=np.complex128)


# steps: of phase, rad; of the range, in range cells; of the beam, in half-power half-widths
PHASE_STEP, CELL_STEP, BEAM_STEP = 0.05, 0.02, 0.02


@dataclass(frozen=True, eq=False)
class PointChanges:
    """Echoes of the ideal points of a scene, which no other parameter than the radar's changes.

    Parameters
    ----------
    scene, flags, trace_scene, sub_bands : see :func:`sarmitsuba.simulation.execution.points.add_points`
    layers : labels of the data

    Notes
    -----
    Derivatives are differences of fourth order of closed forms, 1e-5 of the norm. They ignore that shapes which move
    may uncover points.
    """

    scene: Scene
    flags: KernelFlags
    trace_scene: TraceScene | None
    layers: Sequence[Layer]
    sub_bands: int

    def add(self, data: C64) -> None:
        """Add the echoes to data (channels, pulses, samples), in place."""
        if self.scene.points:
            add_points(self.scene, self.flags, self.trace_scene, data, self.layers, self.sub_bands)

    def _difference(self, changed: Callable[[float], Radar], step: float) -> C128:
        """Derivative by a number of which the radar is a function."""
        radar = self.scene.radar
        shape = len(self.layers), radar.track.n_pulses, radar.window.n_samples
        total = np.zeros(shape, dtype=np.complex128)
        for steps, weight in ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0)):
            data = np.zeros(shape, dtype=np.complex64)
            replace(self, scene=replace(self.scene, radar=changed(steps * step))).add(data)
            total += weight * data
        return np.asarray(total / (12.0 * step))

    def by_antenna(self, direction: F64, aside: F64) -> C128:
        """Derivative by a displacement of the antenna, (3,) m per unit, with the beam kept on the scene.

        ``aside`` : angle per m, see :class:`sarmitsuba.apps.fit.parameter.Derivatives`
        """
        radar = self.scene.radar
        angles, n = -(aside @ direction).T, len(radar.tracks)

        def changed(x: float) -> Radar:
            moved = radar.displaced(*[x * direction] * n)
            return replace(moved, pointing=turn_axes(radar.pointing, x * angles))

        step = PHASE_STEP * radar.waveform.wavelength / (4.0 * np.pi) / float(np.linalg.norm(direction))
        return self._difference(changed, step)

    def by_range(self, data: C64) -> C128:
        """Derivative by a slant range common to all points, per m; ``data``: of the points alone."""
        radar = self.scene.radar
        window = radar.window

        def changed(x: float) -> Radar:
            return replace(radar, window=replace(window, start_range=window.start_range - x))

        envelope = self._difference(changed, CELL_STEP * radar.waveform.range_cell)
        return np.asarray(
            envelope
            - 4j * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT * data.astype(np.complex128)
        )

    def by_pointing(self, axis: int) -> C128:
        """Derivative by the angle of the beam in azimuth (0) or elevation (1), per rad."""
        radar = self.scene.radar

        def changed(x: float) -> Radar:
            angles = np.zeros((radar.track.n_pulses, 2))
            angles[:, axis] = x
            return replace(radar, pointing=turn_axes(radar.pointing, angles))

        return self._difference(changed, BEAM_STEP / radar.antenna.per_width[axis])


# effects whose echoes have no derivative yet, by the kernel flag that switches them on
UNSUPPORTED = {
    "motion": "moving objects",
    "water_motion": "water under wind",
    "transmission": "transmission through slabs",
}


# texels of level maps in a Jacobian at most: 32 are traced at a time
MOST_TEXELS = 256


class ForwardModel:
    """Raw data of a scene as a function of parameters.

    The launch windows, rays, effects and blocks of pulses are those of the scene as it is, so that the data are a fixed
    function of the values. Without receiver noise.

    Parameters
    ----------
    scene : as loaded
    parameters : each with one or several values
    leave_out : effects that have no derivative are left out, instead of an error

    Attributes
    ----------
    run : prepared run
    left_out : names of the effects left out
    names : of all values
    start : (n,) values of the scene as it is
    statistics : of the most recent data: where two values have equal numbers of hits and contributions, with the same
        rays, hardly any echo appeared or vanished between them

    Raises
    ------
    SceneError, RadarError
        The scene has echoes that cannot be differentiated.
    """

    def __init__(self, scene: Scene, parameters: Sequence[Parameter], *, leave_out: bool = False) -> None:
        refuse(scene)
        scene = replace(scene, settings=replace(scene.settings, keep_orders=False))
        self.parameters = tuple(parameters)
        self.run = Run(scene)
        self.left_out: tuple[str, ...] = ()
        if leave_out:
            self.left_out = tuple(name for name in UNSUPPORTED if getattr(self.run.plan.flags, name))
        if self.left_out:
            effects = dict(scene.settings.effects)
            for name in self.left_out:
                effects[name] = "off"
            self.run = self.run.otherwise(replace(scene, settings=replace(scene.settings, effects=effects)))
        self.run.admit()
        flags = self.run.plan.flags
        for name, what in UNSUPPORTED.items():
            if getattr(flags, name):
                raise SceneError(
                    f"{scene.name}: {what} cannot be differentiated; switch off the effect {name} (-D "
                    f"sar_path.{name}=off), or leave them out"
                )
        patterned = scene.radar.antenna.directive
        if (
            any(isinstance(p, BeamPointing) for p in self.parameters)
            and patterned
            and not flags.antenna_pattern
        ):
            raise SceneError(
                f"{scene.name}: the effect antenna_pattern is off, and pointing changes nothing; switch it on, or "
                "leave the parameter out"
            )
        if own_stages(flags):
            raise SceneError(f"{scene.name}: effects of extensions cannot be differentiated; switch them off")
        assert self.run.sampling is not None and self.run.trace_scene is not None
        self.sampling: SamplingPlan = self.run.sampling
        self.scene = self.run.scene
        self.names = tuple(name for p in self.parameters for name in p.names(self.scene))
        self.start = np.concatenate([p.values(self.scene) for p in self.parameters])
        self.statistics = TraceStatistics()
        self.rays = self.run.rays(self.sampling, 0)
        self.batches = self._batches()

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, pulses and samples of the data."""
        radar = self.scene.radar
        return len(radar.channels), radar.track.n_pulses, radar.window.n_samples

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Labels of the data: the channels, as ray sets are summed."""
        return tuple(Layer(channel) for channel in self.scene.radar.channels)

    def _batches(self) -> list[Batch]:
        """Batches of the whole track, in blocks as long as the error of the raw data allows."""
        tracer = self.run.tracer(self.sampling)
        check_sources(self.scene, tracer.sources[1:], self.parameters)
        layers = self.run.layers
        data = np.zeros((len(layers.layers), *self.shape[1:]), dtype=np.complex64)
        blocks = Blocks(tracer, self.rays, layers.layers, data, layers.max_order)
        blocks.settle()
        return blocks.every_batch()

    @property
    def turning(self) -> bool:
        """Whether pulses share a tracing, so that derivatives of range rates are needed."""
        return any(batch.together and batch.stop - batch.start > 1 for batch in self.batches)

    def checked(self, given: object) -> F64:
        """Values as an array (n,).

        Raises
        ------
        SceneError : they are no finite real numbers, one for each parameter
        """
        try:
            values = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            shown = one_line(repr(given))
            raise SceneError(f"gradient: values {shown} are no real numbers; give an array of them") from None
        if values.shape != self.start.shape:
            raise SceneError(
                f"gradient: {values.size} values for {len(self.start)} parameters; give one for each, of the shape "
                f"({len(self.start)},), not {values.shape}"
            )
        if not np.isfinite(values).all():
            wrong = ", ".join(n for n, x in zip(self.names, values, strict=True) if not np.isfinite(x))
            raise SceneError(f"gradient: no finite value of {wrong}")
        return values

    def split(self, values: F64) -> list[F64]:
        """Values of each parameter, from those of all."""
        sizes = [len(p.values(self.scene)) for p in self.parameters]
        return list(np.split(np.asarray(values, dtype=np.float64), np.cumsum(sizes)[:-1]))

    def at(self, values: F64) -> Scene:
        """The scene with these values."""
        scene = self.scene
        for parameter, own in zip(self.parameters, self.split(values), strict=True):
            if not np.array_equal(own, parameter.values(self.scene)):
                scene = parameter.changed(scene, own)
        return scene

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(n_values,) whether a value moves a shape."""
        own = zip(self.parameters, self.split(self.start), strict=True)
        return np.concatenate([np.full(len(v), p.moved(self.scene, v) is not None) for p, v in own])

    def possible(self, values: F64) -> bool:
        """Whether the scene can have these values."""
        try:
            self.at(values)
        except SceneError:
            return False
        return True

    def placed(self, values: F64 | None = None) -> At:
        """The scene with these values, and its geometry on the device; None: as it is."""
        values = self.start if values is None else values
        scene = self.at(values)
        assert self.run.trace_scene is not None
        traced = self.run.trace_scene
        displaced = not scene.same_shapes(self.scene)
        if displaced:
            matrices, offsets = self._move_points(values)
            moved = build_geometry(scene)
            number = scene.geometry.face_mesh[moved.geometry_faces].astype(np.uint32)
            traced = moved.displaced_from(traced, number, matrices, offsets)
        elif scene.materials is not self.scene.materials:
            traced = traced.at_frequency(scene.materials, scene.radar.waveform.wavelength)
            if traced.surfaces is not None:
                traced = replace(
                    traced, surfaces=traced.surfaces.with_levels(list_with_parts(scene.materials))
                )
        return At(scene, traced, self.moves(values), displaced)

    def moves(self, values: F64) -> ComposedMoves:
        """Displacements by the parameters at some values."""
        return ComposedMoves(self.scene, self.parameters, self.split(values))

    def traced_faces(self, values: F64) -> tuple[F64, I64]:
        """Corners (n, 3, 3), m, of the faces that the kernel traces at some values, and their meshes (n,)."""
        here = self.placed(values)
        geometry, rows = here.scene.geometry, here.trace_scene.geometry_faces
        return geometry.vertices[geometry.faces[rows]], geometry.face_mesh[rows]

    def _move_points(self, values: F64) -> tuple[F64, F64]:
        """(n_meshes, 3, 3) and (n_meshes, 3) m: where the points of every mesh came to with these values."""
        n = len(self.scene.geometry.mesh_names)
        matrices, offsets = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        scene = self.scene
        for parameter, own in zip(self.parameters, self.split(values), strict=True):
            if np.array_equal(own, parameter.values(self.scene)):
                continue
            found = parameter.moved(scene, own)
            if found is not None:
                mesh, matrix, offset = found
                matrices[mesh], offsets[mesh] = matrix @ matrices[mesh], matrix @ offsets[mesh] + offset
            scene = parameter.changed(scene, own)
        return matrices, offsets

    def tracer(self, here: At) -> Tracer:
        """Tracer of the scene at some values, with the rays and effects of the scene as it is."""
        run, plan = self.run, self.run.plan
        sampling = replace(self.sampling, scene=here.scene)
        flags = replace(sampling.flags, motion=here.displaced)
        return Tracer(sampling, flags, here.trace_scene, plan.max_depth, run.timer, plan.sub_bands)

    def data(self, values: F64 | None = None) -> C64:
        """Raw data (channels, pulses, samples) at some values; None: of the scene as it is."""
        here = self.placed(values)
        layers = self.run.layers
        data = self._trace(BatchTracer(self.tracer(here), self.rays, layers.per_subset, layers.max_order))
        self._points(here).add(data)
        return data

    def _points(self, here: At) -> PointChanges:
        """Ideal points of the scene."""
        run = self.run
        return PointChanges(here.scene, run.plan.flags, here.trace_scene, self.layers, run.plan.sub_bands)

    @property
    def carried(self) -> int:
        """Derivatives of each channel that the kernel carries: a track needs one for each axis, however many knots."""
        return self.needed(self.parameters, self.placed()).count

    def needed(self, parameters: Sequence[Parameter], here: At) -> Needed:
        """Derivatives of echoes that parameters need."""
        return Needed.of(parameters, here, beam=self.run.plan.flags.antenna_pattern)

    def _aside(self, radar: Radar) -> F64:
        """See :class:`Derivatives`."""
        away = np.linalg.norm(radar.track.position - self.sampling.window.center, axis=1)[:, None]
        return np.stack([radar.pointing.azimuth_axis / away, radar.pointing.elevation_axis / away])

    def derivative(
        self,
        values: F64 | None = None,
        progress: Callable[[float], None] | None = None,
        by: Sequence[Parameter] | None = None,
        *,
        edges: bool = True,
    ) -> tuple[C64, C64]:
        """Raw data (channels, pulses, samples) and derivative (n_values, channels, pulses, samples).

        ``by`` : parameters to differentiate by; None: those of the model. ``edges`` : with the parts that moving edges
        hide and show
        """
        here = self.placed(values)
        by = self.parameters if by is None else by
        n_values = sum(len(p.names(here.scene)) for p in by)
        check_fits(
            f"{here.scene.name}: {n_values} derivatives",
            8 * int(np.prod(self.shape)) * (2 * n_values + 4),
            "take fewer parameters, or fewer pulses; sarmitsuba.gradient takes any number",
        )
        out = np.empty((n_values, *self.shape), dtype=np.complex64)
        data, planes = self.planes(here, by, progress, edges=edges)
        for row, plane in enumerate(planes):
            out[row] = plane
        return data, out

    def planes(
        self,
        here: At,
        parameters: Sequence[Parameter],
        progress: Callable[[float], None] | None = None,
        *,
        edges: bool = True,
    ) -> tuple[C64, Iterator[C64]]:
        """Raw data and their derivatives by the values of some parameters, one after the other."""
        wanted = self.needed(parameters, here)
        if len(wanted.texels) > MOST_TEXELS:
            raise SceneError(
                f"{here.scene.name}: a Jacobian by {len(wanted.texels)} texels is traced {MOST} at a time; take "
                f"sarmitsuba.gradient, which traces once, or a map of at most {MOST_TEXELS}"
            )
        found, pointed = Found([], [], [], []), list[C64]()
        data = farther = np.zeros(0, dtype=np.complex64)
        for some in wanted.parts():
            tracer = self.tracer(here)
            for one in {tracer, *tracer.by_frequency}:
                steps = [self._step_tables(here, one, step) for step in some.steps]
                n_materials = len(list_with_parts(here.scene.materials))
                texels = here.texels(some.texels).tolist()
                one.tangents = Tangents.of(
                    some.displacements,
                    some.levels,
                    here.trace_scene.n_faces,
                    n_materials,
                    steps,
                    texels,
                    pointing=some.pointing,
                    rates=self.turning,
                )
            assert isinstance(tracer.tangents, Tangents)
            layers = 2 + tracer.tangents.count
            batches = TangentBatches(tracer, self.rays, self.shape[0] * layers, 0)
            planes = list(self._trace(batches, progress).reshape(layers, *self.shape))
            data, farther = planes[:2]
            first = 2
            numbers = (len(some.displacements), len(some.levels), len(some.steps), len(some.texels))
            for own, number in zip(found.sorts, numbers, strict=True):
                own += planes[first : first + number]
                first += number
            pointed += planes[first:]
        if edges:
            self._add_edges(here, wanted.displacements, found.displaced)
        radar = here.scene.radar
        aside = self._aside(radar)
        if here.scene.points:
            points = self._points(here)
            alone = np.zeros(self.shape, dtype=np.complex64)
            points.add(alone)
            points.add(data)
            farther += points.by_range(alone)
            for displacement, plane in zip(wanted.displacements, found.displaced, strict=True):
                if displacement.antenna.any():
                    plane += points.by_antenna(displacement.antenna, aside)
            for axis, plane in enumerate(pointed):
                plane += points.by_pointing(axis)

        def rows() -> Iterator[C64]:
            for parameter, counts in zip(parameters, wanted.counts, strict=True):
                displaced, levelled, changed, mapped = found.take(counts)
                frequency, times = radar.waveform.center_frequency, radar.times
                yield from parameter.derivative(
                    Derivatives(
                        data, farther, displaced, levelled, changed, mapped, pointed, aside, frequency, times
                    )
                )

        return data, rows()

    def _add_edges(self, here: At, displacements: Sequence[Displacement], displaced: Sequence[C64]) -> None:
        """Add the parts that moving edges hide and show to the derivatives by displacements; points once a launch."""
        for k in range(0, len(displacements), MOST):
            beside = self.beside_edges(here, displacements[k : k + MOST])
            for plane, more in zip(displaced[k:], beside, strict=False):
                plane += more

    def beside_edges(self, here: At, displacements: Sequence[Displacement]) -> Sequence[C64]:
        """Contribution of moving edges to the derivatives by displacements; nothing where no shape moves."""
        if not any(d.faces is not None for d in displacements):
            return ()
        tracer, n = self.tracer(here), len(displacements)
        plain = [replace(d, turn_rate=0.0) for d in displacements]
        for one in {tracer, *tracer.by_frequency}:
            one.tangents = Tangents.of(plain, (), here.trace_scene.n_faces, 0)
        planes = self._trace(EdgeBatches(tracer, self.rays, self.shape[0] * n, 0))
        return list(planes.reshape(n, *self.shape))

    @staticmethod
    def _step_tables(here: At, tracer: Tracer, step: Step) -> StepTables:
        """Geometry with the tables of materials at both ends of a step, at a tracer's frequency."""
        wavelength = tracer.kernel.wavelength
        ends = []
        for change in (step.below, step.above):
            materials = change_material(here.scene, step.material, **change).materials
            materials = tuple(m.at_frequency(SPEED_OF_LIGHT / wavelength) for m in materials)
            ends.append(tracer.trace_scene.at_frequency(materials, wavelength))
        return StepTables(ends[0], ends[1], 1.0 / step.size)

    def raw(self, data: C64) -> RawData:
        """Data (channels, pulses, samples) as raw data of the scene."""
        radar, run = self.scene.radar, self.run
        metadata = raw_metadata(run, run.plan, run.notes)
        flown = radar.track if radar.recorded is not None else None
        return RawData(
            data, self.layers, "compressed", radar.as_recorded(), metadata, self.scene.image, flown=flown
        )

    def _trace(self, batches: BatchTracer, progress: Callable[[float], None] | None = None) -> C64:
        """Profiles (layers, pulses, samples) of all batches, subsets weighted by their shares and summed."""
        _, n_pulses, n_samples = self.shape
        out = np.zeros((batches.n_layers, n_pulses, n_samples), dtype=np.complex64)
        self.statistics = TraceStatistics()
        for batch, pulses, share in self.weigh():
            traced = batches.trace(batch)
            self.statistics = self.statistics.plus(traced.statistics)
            if progress is not None:
                progress(batch.stop / n_pulses)
            out[:, pulses] += share * traced.profiles[:, : pulses.stop - pulses.start]
        return out

    def weigh(self) -> Iterator[tuple[Batch, slice, np.float32]]:
        """Every batch, its pulses, and the weight of its profiles."""
        subsets = self.run.layers.subsets
        for batch in self.batches:
            # the pulse beyond a block's end belongs to the next block
            stop = batch.stop if not batch.together else self._end(batch)
            yield batch, slice(batch.start, stop), np.float32(SUBSET_SHARES[subsets[batch.subset]])

    def _end(self, batch: Batch) -> int:
        later = [b.start for b in self.batches if b.start > batch.start]
        return min(later, default=batch.stop)


def check_sources(scene: Scene, sources: Sequence[Source], parameters: Sequence[Parameter]) -> None:
    """Refuse parameters by which the echoes of scatterers beside the surfaces cannot be differentiated.

    Raises
    ------
    SceneError : one line: the parameter, the echoes, the remedy
    """
    mesh = scene.geometry.face_mesh
    for source, parameter in product(sources, parameters):
        unknown = getattr(source, "unknown", None)
        if unknown is None:
            raise SceneError(
                f"{scene.name}: an extension's source of echoes cannot be differentiated; leave it out"
            )
        moves = any(d.faces is not None for d in parameter.displacements(scene, mesh))
        properties = parameter.steps(scene) or parameter.texels(scene)
        if (moves and "shapes" in unknown) or (properties and "materials" in unknown):
            raise SceneError(
                f"{scene.name}: parameter {parameter.label}: the echoes of kind {source_text(source)} cannot be "
                "differentiated by it; leave either out, or switch their effect off"
            )


def source_text(source: Source) -> str:
    """Kind of a source, in quotation marks."""
    scatterers = getattr(source, "scatterers", source)
    return f'"{getattr(scatterers, "mechanism", "scatterer")}"'


def refuse(scene: Scene) -> None:
    """Refuse scenes whose echoes cannot be differentiated.

    Raises
    ------
    SceneError, RadarError : one line: the reason and the remedy
    """
    method, name = scene.settings.method, scene.name
    if scene.settings.one_look:
        raise RadarError(f"{name}: method {method} makes no raw data to differentiate; take hybrid or raw")
    if scene.radar.receiver is not None and not scene.radar.receives_itself:
        raise RadarError(f"{name}: two antennas cannot be differentiated; take one that sends and receives")
    kept = idealise_receiver(scene, switched_off=True).radar.received
    if kept:
        raise RadarError(
            f"{name}: {kept[0]} of the receiver cannot be differentiated; leave it out, or its effect off"
        )
    if scene.moves:
        raise SceneError(f"{name}: moving objects cannot be differentiated; stop them")
    if not scene.geometry.n_faces:
        raise SceneError(f"{name}: there is no mesh whose echoes could be differentiated")
