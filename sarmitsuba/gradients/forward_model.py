"""Raw data of a scene and their derivatives, with rays, blocks of pulses and effects that stay the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from sarmitsuba.arrays import C64, C128, F64, I64
from sarmitsuba.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.echo.sub_bands import RangeFilter
from sarmitsuba.errors import RadarError, SceneError
from sarmitsuba.gradients.material_parameters import with_material
from sarmitsuba.gradients.parameter import Derivatives, Parameter, Step
from sarmitsuba.materials.map_materials import with_parts
from sarmitsuba.memory import check_fits
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.batches import Batch, BatchTracer, built
from sarmitsuba.simulation.blocks import Blocks
from sarmitsuba.simulation.metadata import raw_metadata
from sarmitsuba.simulation.pulses import KeyPulse, Pulses
from sarmitsuba.simulation.run import Run
from sarmitsuba.simulation.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.statistics import TraceStatistics
from sarmitsuba.simulation.tracing import Tracer
from sarmitsuba.trace.scene_tables import TraceScene
from sarmitsuba.trace.tangents import MOST, Displacement, StepTables, Tangents

# effects whose echoes have no derivative yet, by the kernel flag that switches them on
UNSUPPORTED = {
    "motion": "moving objects",
    "water_motion": "water under wind",
    "edge_diffraction": "edge diffraction",
    "diffuse_pairs": "pairs of diffuse scatterers",
    "transmission": "transmission through slabs",
}


# properties of materials that one launch carries at most: each needs two more sets of fields in every ray
MOST_STEPS = 8


class TangentBatches(BatchTracer):
    """Tracing of batches with the derivatives of every echo behind its channels.

    The layers of a batch are the channels, their derivatives by a common slant range, by each displacement and by each
    level.
    """

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: channels, and those of every derivative."""
        tangents = self.tracer.tangents
        return super().amplitudes * (1 if tangents is None else 1 + tangents.count)

    def of_grid(self, pulses: Pulses, grid: C64, share: RangeFilter | None) -> C64:
        """See the base class."""
        tangents = self.tracer.tangents
        assert tangents is not None
        radar = self.tracer.sampling.scene.radar
        c = len(radar.channels)
        moved = c * (1 + len(tangents.displacements))
        carrier = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
        farther = pulses.profiles(grid[:moved], partial(_per_metre, carrier, share))
        parts = [pulses.profiles(grid[:c], share), farther]
        if tangents.levels or tangents.properties:
            parts.append(pulses.profiles(grid[moved:], share))
        found = np.concatenate(parts)
        if isinstance(pulses, KeyPulse):
            _follow(found[c:], pulses, tangents.displacements, c)
        return found


def _per_metre(carrier: float, share: RangeFilter | None, cycles_per_metre: F64) -> C128:
    """Factor on the spectrum of range profiles that differentiates by the slant range, rad/m."""
    factor = -1j * (carrier + 2.0 * np.pi * cycles_per_metre)
    return np.asarray(factor if share is None else factor * share(cycles_per_metre), dtype=np.complex128)


def _follow(found: C64, pulses: KeyPulse, displacements: Sequence[Displacement], channels: int) -> None:
    """Turn the derivatives by antenna positions from a block's key pulse to every other pulse.

    The direction to the antenna changes over the block nearly equally for all echoes: as at the block's reference.
    """
    plan = pulses.plan
    to_antenna = pulses.radar.track.position[plan.start : plan.stop] - plan.reference
    to_antenna /= np.linalg.norm(to_antenna, axis=1, keepdims=True)
    key = plan.state.position[0] - plan.reference
    change = to_antenna - key / np.linalg.norm(key)
    farther = found[:channels]
    for k, displacement in enumerate(displacements, 1):
        rate = (change @ displacement.antenna).astype(np.float32)
        if rate.any():
            found[k * channels : (k + 1) * channels] += farther * rate[:, None]


@dataclass(frozen=True, eq=False)
class _At:
    """The scene at some values of the parameters, and its geometry on the device.

    ``displaced`` : whether shapes were displaced with their scatterers, as the tables of the geometry say
    """

    scene: Scene
    trace_scene: TraceScene
    displaced: bool = False


@dataclass(frozen=True, eq=False)
class _Needed:
    """Derivatives of echoes that parameters need; ``counts``: how many of each of the three sorts, by parameter."""

    displacements: tuple[Displacement, ...]
    levels: tuple[frozenset[int], ...]
    steps: tuple[Step, ...]
    counts: tuple[tuple[int, int, int], ...] = ()

    @staticmethod
    def of(parameters: Sequence[Parameter], here: _At) -> _Needed:
        """All that the parameters need, in their order."""
        scene = here.scene
        mesh = scene.geometry.face_mesh[here.trace_scene.geometry_faces]
        moves = [tuple(p.displacements(scene, mesh)) for p in parameters]
        levels = [tuple(p.levels(scene)) for p in parameters]
        steps = [tuple(p.steps(scene)) for p in parameters]
        return _Needed(
            tuple(chain.from_iterable(moves)),
            tuple(chain.from_iterable(levels)),
            tuple(chain.from_iterable(steps)),
            tuple((len(a), len(b), len(c)) for a, b, c in zip(moves, levels, steps, strict=True)),
        )

    def parts(self) -> Iterator[_Needed]:
        """The same in parts that one launch can carry, dealt evenly, as a grid grows with all that it carries.

        At least one, which may be empty.
        """
        longest = max(len(self.displacements), len(self.levels))
        n = max(1, -(-longest // MOST), -(-len(self.steps) // MOST_STEPS))
        for k in range(n):
            moves, levels, steps = (
                slice(k * len(one) // n, (k + 1) * len(one) // n)
                for one in (self.displacements, self.levels, self.steps)
            )
            yield _Needed(self.displacements[moves], self.levels[levels], self.steps[steps])


@dataclass(frozen=True, eq=False)
class _Found:
    """Derivatives found so far, in the order of a :class:`_Needed`."""

    displaced: list[C64]
    levelled: list[C64]
    changed: list[C64]

    def take(self, counts: tuple[int, int, int]) -> tuple[list[C64], list[C64], list[C64]]:
        """Remove the first of each sort and return them."""
        taken = []
        for own, n in zip((self.displaced, self.levelled, self.changed), counts, strict=True):
            taken.append(own[:n])
            del own[:n]
        return taken[0], taken[1], taken[2]


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
        scene = replace(scene, settings=replace(scene.settings, keep_orders=False, keep_subsets=False))
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
        if flags.extra:
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

    def _batches(self) -> list[Batch]:
        """Batches of the whole track, in blocks as long as the error of the raw data allows."""
        data = np.zeros(self.shape, dtype=np.complex64)
        tracer = self.run.tracer(self.sampling)
        if len(tracer.sources) > 1:
            raise SceneError(
                f"{self.scene.name}: scatterers beside the surfaces cannot be differentiated; leave them out"
            )
        layers = self.run.layers
        blocks = Blocks(tracer, self.rays, layers.layers, data, layers.max_order)
        blocks.settle()
        return blocks.every_batch()

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

    def possible(self, values: F64) -> bool:
        """Whether the scene can have these values."""
        try:
            self.at(values)
        except SceneError:
            return False
        return True

    def _at(self, values: F64) -> _At:
        scene = self.at(values)
        assert self.run.trace_scene is not None
        traced = self.run.trace_scene
        displaced = not scene.same_shapes(self.scene)
        if displaced:
            matrices, offsets = self._moved(values)
            moved = built(scene)
            number = scene.geometry.face_mesh[moved.geometry_faces].astype(np.uint32)
            traced = moved.displaced_from(traced, number, matrices, offsets)
        elif scene.materials is not self.scene.materials:
            traced = traced.at_frequency(scene.materials, scene.radar.waveform.wavelength)
        return _At(scene, traced, displaced)

    def traced_faces(self, values: F64) -> tuple[F64, I64]:
        """Corners (n, 3, 3), m, of the faces that the kernel traces at some values, and their meshes (n,)."""
        here = self._at(values)
        geometry, rows = here.scene.geometry, here.trace_scene.geometry_faces
        return geometry.vertices[geometry.faces[rows]], geometry.face_mesh[rows]

    def _moved(self, values: F64) -> tuple[F64, F64]:
        """(n_meshes, 3, 3) and (n_meshes, 3) m: where the points of every mesh came to with these values."""
        n = len(self.scene.geometry.mesh_names)
        matrices, offsets = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        scene = self.scene
        for parameter, own in zip(self.parameters, self.split(values), strict=True):
            found = parameter.moved(scene, own)
            if found is not None:
                mesh, matrix, offset = found
                matrices[mesh], offsets[mesh] = matrix @ matrices[mesh], matrix @ offsets[mesh] + offset
            scene = parameter.changed(scene, own)
        return matrices, offsets

    def _tracer(self, here: _At) -> Tracer:
        run, plan = self.run, self.run.plan
        sampling = replace(self.sampling, scene=here.scene)
        flags = replace(sampling.flags, motion=here.displaced)
        return Tracer(sampling, flags, here.trace_scene, plan.max_depth, run.timer, plan.sub_bands)

    def data(self, values: F64 | None = None) -> C64:
        """Raw data (channels, pulses, samples) at some values; None: of the scene as it is."""
        here = self._at(self.start if values is None else values)
        layers = self.run.layers
        return self._traced(BatchTracer(self._tracer(here), self.rays, layers.per_subset, layers.max_order))

    @property
    def carried(self) -> int:
        """Derivatives of each channel that the kernel carries: a track needs one for each axis, however many knots."""
        wanted = _Needed.of(self.parameters, self._at(self.start))
        return len(wanted.displacements) + len(wanted.levels) + len(wanted.steps)

    def derivative(
        self,
        values: F64 | None = None,
        progress: Callable[[float], None] | None = None,
        by: Sequence[Parameter] | None = None,
    ) -> tuple[C64, C64]:
        """Raw data (channels, pulses, samples) and derivative (n_values, channels, pulses, samples).

        ``by`` : parameters to differentiate by; None: the model's own
        """
        here = self._at(self.start if values is None else values)
        by = self.parameters if by is None else by
        n_values = sum(len(p.names(here.scene)) for p in by)
        check_fits(
            f"{here.scene.name}: {n_values} derivatives",
            8 * int(np.prod(self.shape)) * (2 * n_values + 4),
            "take fewer parameters, or fewer pulses",
        )
        wanted = _Needed.of(by, here)
        found = _Found([], [], [])
        data = farther = np.zeros(0, dtype=np.complex64)
        for some in wanted.parts():
            tracer = self._tracer(here)
            for one in {tracer, *tracer.by_frequency}:
                steps = [self._step_tables(here, one, step) for step in some.steps]
                n_materials = len(with_parts(here.scene.materials))
                one.tangents = Tangents.of(
                    some.displacements, some.levels, here.trace_scene.n_faces, n_materials, steps
                )
            assert tracer.tangents is not None
            layers = 2 + tracer.tangents.count
            batches = TangentBatches(tracer, self.rays, self.shape[0] * layers, 0)
            planes = list(self._traced(batches, progress).reshape(layers, *self.shape))
            data, farther = planes[:2]
            first = 2
            for own, number in zip(
                (found.displaced, found.levelled, found.changed),
                (len(some.displacements), len(some.levels), len(some.steps)),
                strict=True,
            ):
                own += planes[first : first + number]
                first += number
        out = np.empty((n_values, *self.shape), dtype=np.complex64)
        row = 0
        for parameter, counts in zip(by, wanted.counts, strict=True):
            radar = here.scene.radar
            own_planes = found.take(counts)
            derivatives = Derivatives(
                data, farther, *own_planes, radar.waveform.center_frequency, radar.track.time
            )
            for plane in parameter.derivative(derivatives):
                out[row] = plane
                row += 1
        return data, out

    @staticmethod
    def _step_tables(here: _At, tracer: Tracer, step: Step) -> StepTables:
        """Geometry with the tables of materials at both ends of a step, at a tracer's frequency."""
        wavelength = tracer.kernel.wavelength
        ends = []
        for change in (step.below, step.above):
            materials = with_material(here.scene, step.material, **change).materials
            materials = tuple(m.at_frequency(SPEED_OF_LIGHT / wavelength) for m in materials)
            ends.append(tracer.trace_scene.at_frequency(materials, wavelength))
        return StepTables(ends[0], ends[1], 1.0 / step.size)

    def raw(self, data: C64) -> RawData:
        """Data (channels, pulses, samples) as raw data of the scene."""
        radar, run = self.scene.radar, self.run
        metadata = raw_metadata(run, run.plan, run.notes)
        flown = radar.track if radar.recorded is not None else None
        layers = run.layers.layers
        return RawData(
            data, layers, "compressed", radar.as_recorded(), metadata, self.scene.image, flown=flown
        )

    def _traced(self, batches: BatchTracer, progress: Callable[[float], None] | None = None) -> C64:
        """Profiles (layers, pulses, samples) of all batches, subsets weighted by their shares and summed."""
        _, n_pulses, n_samples = self.shape
        out = np.zeros((batches.n_layers, n_pulses, n_samples), dtype=np.complex64)
        subsets = self.run.layers.subsets
        self.statistics = TraceStatistics()
        for batch in self.batches:
            traced = batches.trace(batch)
            self.statistics = self.statistics.plus(traced.statistics)
            if progress is not None:
                progress(batch.stop / n_pulses)
            # the pulse beyond a block's end belongs to the next block
            stop = batch.stop if not batch.together else self._end(batch)
            share = np.float32(SUBSET_SHARES[subsets[batch.subset]])
            out[:, batch.start : stop] += share * traced.profiles[:, : stop - batch.start]
        return out

    def _end(self, batch: Batch) -> int:
        later = [b.start for b in self.batches if b.start > batch.start]
        return min(later, default=batch.stop)


def refuse(scene: Scene) -> None:
    """Refuse scenes whose echoes cannot be differentiated.

    Raises
    ------
    SceneError, RadarError : one line: the reason and the remedy
    """
    method, name = scene.settings.method, scene.name
    if method in ("image", "raster"):
        raise RadarError(f"{name}: method {method} makes no raw data to differentiate; take hybrid or raw")
    if scene.radar.receiver is not None:
        raise RadarError(f"{name}: two antennas cannot be differentiated; take one that sends and receives")
    if scene.moves:
        raise SceneError(f"{name}: moving objects cannot be differentiated; stop them")
    if scene.points or scene.has_sources:
        raise SceneError(
            f"{name}: points, wires, volumes and scatterers beside the mesh cannot be differentiated; leave them out"
        )
    if not scene.geometry.n_faces:
        raise SceneError(f"{name}: there is no mesh whose echoes could be differentiated")
