"""Raw data of a scene and their derivatives, with rays, blocks of pulses and effects that stay the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product

import numpy as np

from sarmitsuba.arrays import C64, C128, F64
from sarmitsuba.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.echo.sub_bands import RangeFilter
from sarmitsuba.errors import RadarError, SceneError
from sarmitsuba.gradients.material_parameters import with_material
from sarmitsuba.gradients.parameter import Derivatives, Parameter, Step
from sarmitsuba.gradients.point_changes import PointChanges
from sarmitsuba.gradients.radar_parameters import BeamPointing
from sarmitsuba.materials.map_materials import with_parts
from sarmitsuba.memory import check_fits
from sarmitsuba.radar.radar import Radar
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
from sarmitsuba.trace.source import Source
from sarmitsuba.trace.tangents import MOST, Displacement, StepTables, Tangents

# effects whose echoes have no derivative yet, by the kernel flag that switches them on
UNSUPPORTED = {
    "motion": "moving objects",
    "water_motion": "water under wind",
    "transmission": "transmission through slabs",
}


# properties of materials, and displacements that turn facets, that one launch carries at most: each needs two more sets
# of fields in every ray
MOST_STEPS = 8


class TangentBatches(BatchTracer):
    """Tracing of batches with the derivatives of every echo behind its channels.

    The layers of a batch are the channels, their derivatives by a common slant range, by each displacement, by each
    level and by each property. In a block of pulses derivatives of range rates times the time from the key pulse belong
    to those by displacements.
    """

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: channels, and those of every derivative."""
        tangents = self.tracer.tangents
        return super().amplitudes * (1 if tangents is None else tangents.recorded)

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
        end = c * (1 + tangents.count)
        if end > moved:
            parts.append(pulses.profiles(grid[moved:end], share))
        if tangents.pointing and isinstance(pulses, KeyPulse) and pulses.beam:
            parts[-1][-2 * c : -c] += pulses.by_azimuth(grid[:c], share)
        if tangents.rates and isinstance(pulses, KeyPulse) and pulses.each > 1:
            # slant ranges within the block change by those of the key pulse and by the range rate's times the time
            turning = pulses.profiles(grid[end:], partial(_per_metre, carrier, share))
            farther[c:] += pulses.plan.tau.astype(np.float32)[:, None] * turning
        return np.concatenate(parts)


def _per_metre(carrier: float, share: RangeFilter | None, cycles_per_metre: F64) -> C128:
    """Factor on the spectrum of range profiles that differentiates by the slant range, rad/m."""
    factor = -1j * (carrier + 2.0 * np.pi * cycles_per_metre)
    return np.asarray(factor if share is None else factor * share(cycles_per_metre), dtype=np.complex128)


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
    pointing: bool = False
    counts: tuple[tuple[int, int, int], ...] = ()

    @staticmethod
    def of(parameters: Sequence[Parameter], here: _At, *, beam: bool) -> _Needed:
        """All that the parameters need, in their order; ``beam``: whether the antenna's pattern counts."""
        scene = here.scene
        mesh = scene.geometry.face_mesh[here.trace_scene.geometry_faces]
        moves = [tuple(p.displacements(scene, mesh)) for p in parameters]
        levels = [tuple(p.levels(scene)) for p in parameters]
        steps = [tuple(p.steps(scene)) for p in parameters]
        return _Needed(
            tuple(chain.from_iterable(moves)),
            tuple(chain.from_iterable(levels)),
            tuple(chain.from_iterable(steps)),
            beam and any(p.pointing for p in parameters),
            tuple((len(a), len(b), len(c)) for a, b, c in zip(moves, levels, steps, strict=True)),
        )

    def parts(self) -> Iterator[_Needed]:
        """The same in parts that one launch can carry; at least one, which may be empty."""
        moves: list[list[Displacement]] = [[]]
        for displacement in self.displacements:
            turns = sum(d.turn_rate > 0.0 for d in (*moves[-1], displacement))
            if len(moves[-1]) == MOST or turns > MOST_STEPS:
                moves.append([])
            moves[-1].append(displacement)
        n = max(len(moves), -(-len(self.levels) // MOST), -(-len(self.steps) // MOST_STEPS))
        for k in range(n):
            yield _Needed(
                tuple(chain.from_iterable(moves[k : k + 1])),
                self.levels[k * MOST : (k + 1) * MOST],
                self.steps[k * MOST_STEPS : (k + 1) * MOST_STEPS],
                self.pointing and k == 0,
            )


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

    Attributes
    ----------
    run : prepared run
    names : of all values
    start : (n,) values of the scene as it is
    statistics : of the most recent data: where two values have equal numbers of hits and contributions, with the same
        rays, hardly any echo appeared or vanished between them

    Raises
    ------
    SceneError, RadarError
        The scene has echoes that cannot be differentiated.
    """

    def __init__(self, scene: Scene, parameters: Sequence[Parameter]) -> None:
        refuse(scene)
        scene = replace(scene, settings=replace(scene.settings, keep_orders=False, keep_subsets=False))
        self.parameters = tuple(parameters)
        self.run = Run(scene)
        self.run.admit()
        flags = self.run.plan.flags
        for name, what in UNSUPPORTED.items():
            if getattr(flags, name):
                raise SceneError(
                    f"{scene.name}: {what} cannot be differentiated; switch off the effect {name}, or leave them out"
                )
        patterned = scene.radar.antenna.pattern != "isotropic"
        if (
            any(isinstance(p, BeamPointing) for p in self.parameters)
            and patterned
            and not flags.antenna_pattern
        ):
            raise SceneError(
                f"{scene.name}: the effect antenna_pattern is off, and pointing changes nothing; switch it on, or "
                "leave the parameter out"
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
        check_sources(self.scene, tracer.sources[1:], self.parameters)
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

    def _moved(self, values: F64) -> tuple[F64, F64]:
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

    def _tracer(self, here: _At) -> Tracer:
        run, plan = self.run, self.run.plan
        sampling = replace(self.sampling, scene=here.scene)
        flags = replace(sampling.flags, motion=here.displaced)
        return Tracer(sampling, flags, here.trace_scene, plan.max_depth, run.timer, plan.sub_bands)

    def data(self, values: F64 | None = None) -> C64:
        """Raw data (channels, pulses, samples) at some values; None: of the scene as it is."""
        here = self._at(self.start if values is None else values)
        layers = self.run.layers
        data = self._traced(BatchTracer(self._tracer(here), self.rays, layers.per_subset, layers.max_order))
        self._points(here).add(data)
        return data

    def _points(self, here: _At) -> PointChanges:
        """Ideal points of the scene."""
        run = self.run
        return PointChanges(
            here.scene, run.plan.flags, here.trace_scene, run.layers.layers, run.plan.sub_bands
        )

    @property
    def carried(self) -> int:
        """Derivatives of each channel that the kernel carries: a track needs one for each axis, however many knots."""
        wanted = self._needed(self._at(self.start))
        return len(wanted.displacements) + len(wanted.levels) + len(wanted.steps) + 2 * wanted.pointing

    def _needed(self, here: _At) -> _Needed:
        return _Needed.of(self.parameters, here, beam=self.run.plan.flags.antenna_pattern)

    def _aside(self, radar: Radar) -> F64:
        """See :class:`Derivatives`."""
        away = np.linalg.norm(radar.track.position - self.sampling.window.center, axis=1)[:, None]
        return np.stack([radar.pointing.azimuth_axis / away, radar.pointing.elevation_axis / away])

    def derivative(
        self, values: F64 | None = None, progress: Callable[[float], None] | None = None
    ) -> tuple[C64, C64]:
        """Raw data (channels, pulses, samples) and derivative (n_values, channels, pulses, samples)."""
        here = self._at(self.start if values is None else values)
        check_fits(
            f"{here.scene.name}: {len(self.names)} derivatives",
            8 * int(np.prod(self.shape)) * (2 * len(self.names) + 4),
            "take fewer parameters, or fewer pulses",
        )
        wanted = self._needed(here)
        found, pointed = _Found([], [], []), list[C64]()
        data = farther = np.zeros(0, dtype=np.complex64)
        for some in wanted.parts():
            tracer = self._tracer(here)
            for one in {tracer, *tracer.by_frequency}:
                steps = [self._step_tables(here, one, step) for step in some.steps]
                n_materials = len(with_parts(here.scene.materials))
                one.tangents = Tangents.of(
                    some.displacements,
                    some.levels,
                    here.trace_scene.n_faces,
                    n_materials,
                    steps,
                    pointing=some.pointing,
                    rates=any(batch.together and batch.stop - batch.start > 1 for batch in self.batches),
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
            pointed += planes[first:]
        if here.scene.points:
            points = self._points(here)
            alone = np.zeros(self.shape, dtype=np.complex64)
            points.add(alone)
            points.add(data)
            farther += points.by_range(alone)
            for displacement, plane in zip(wanted.displacements, found.displaced, strict=True):
                if displacement.antenna.any():
                    plane += points.by_antenna(displacement.antenna, self._aside(here.scene.radar))
            for axis, plane in enumerate(pointed):
                plane += points.by_pointing(axis)
        out = np.empty((len(self.names), *self.shape), dtype=np.complex64)
        row = 0
        for parameter, counts in zip(self.parameters, wanted.counts, strict=True):
            radar = here.scene.radar
            own_planes = found.take(counts)
            derivatives = Derivatives(
                data,
                farther,
                *own_planes,
                pointed,
                self._aside(radar),
                radar.waveform.center_frequency,
                radar.track.time,
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
        if (moves and "shapes" in unknown) or (parameter.steps(scene) and "materials" in unknown):
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
    if method in ("image", "raster"):
        raise RadarError(f"{name}: method {method} makes no raw data to differentiate; take hybrid or raw")
    if scene.radar.receiver is not None:
        raise RadarError(f"{name}: two antennas cannot be differentiated; take one that sends and receives")
    if scene.moves:
        raise SceneError(f"{name}: moving objects cannot be differentiated; stop them")
    if not scene.geometry.n_faces:
        raise SceneError(f"{name}: there is no mesh whose echoes could be differentiated")
