"""Preparation of a run for any method: effects plan, geometry on the device, sampling plan."""

import time
import warnings
from collections.abc import Callable
from copy import copy
from dataclasses import replace

from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.timing import Clock, StageTimer
from sarmitsuba.core.witness import Witness
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.machine.exclusive import take_threads
from sarmitsuba.scene.ground import continue_ground
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.execution.finished import FinishedBlocks
from sarmitsuba.simulation.execution.layers import LayerPlan
from sarmitsuba.simulation.execution.statistics import SamplingReport, TraceStatistics
from sarmitsuba.simulation.execution.tracing import TraceJob, Tracer, Workers, build_geometry
from sarmitsuba.simulation.planning.pilot import examine, plan_in
from sarmitsuba.simulation.planning.prediction.counting import needs_of
from sarmitsuba.simulation.planning.prediction.needs import Needs
from sarmitsuba.simulation.planning.prediction.speed import SHARED, glance, run_seconds
from sarmitsuba.simulation.planning.sampling.cropping import lit_points
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.launch_window import ground_outside, mirrors_outside
from sarmitsuba.simulation.planning.sampling.movers import describe_vanished
from sarmitsuba.simulation.planning.sampling.rays import Rays
from sarmitsuba.simulation.planning.sampling.small_parts import Shortfall
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.stage import check_stages

# processor seconds of a reference core, in stages that use all threads, below which a run is computed by one: more
# threads would not be done sooner, and would take up to twice the processor time
ONE_THREAD = 0.5
# share of it that the first estimate, of rays and pixels alone, may take
SURELY_SHORT = 0.2
# callback for a prepared run before it is traced, e.g. to show its plan, time and memory
Ready = Callable[["Run"], None]


class Run:
    """Prepared run: the common starting point of all methods of simulation.

    Parameters
    ----------
    scene : as loaded
    plan : overrides the automatic effects plan
    clock : of the run's stages
    workers : workers that share the tracing of raw data; None: this process traces alone
    geometry : of the scene as loaded, on the device; None: it is built

    Attributes
    ----------
    scene : with the effects plan applied, and ground continued beyond its rim
    plan : decided effects
    context : of the decisions; None where the plan was given
    trace_scene : geometry on the device; None in a scene of ideal points only
    sampling : sampling plan; likewise
    layers : channels, orders and subsets kept separately
    timer : seconds by stage
    statistics : of the last image or raw data
    report : on the sampling of the raw data; None before, and without a mesh
    witnesses : errors measured in the last image or raw data, by stage: ``rays``, ``blocks``, ``bounces``, ``effects``
    shortfalls : surface for which the most recent lattices are too coarse
    notes : one line each: assumptions, repairs and warnings
    finished : file of finished blocks of raw data; None (default): no file
    """

    def __init__(
        self,
        scene: Scene,
        *,
        plan: EffectsPlan | None = None,
        clock: Clock = time.perf_counter,
        workers: Workers | None = None,
        geometry: TraceScene | None = None,
    ) -> None:
        ensure_backend()
        check_stages()
        glance()
        if scene.settings.one_look and scene.radar.all_round:
            raise RadarError(
                f"{scene.name}: method {scene.settings.method} takes one look, but the track goes round the scene; "
                "take method hybrid or raw"
            )
        self.timer, self.workers = StageTimer(clock), workers
        scene = continue_ground(scene)
        self.trace_scene: TraceScene | None = None
        self.sampling: SamplingPlan | None = None
        if scene.traced:
            self.trace_scene, self._built_from = geometry or build_geometry(scene), scene
            self.timer.lap("build")
            glance()
            self.sampling = SamplingPlan.of(scene)
            take_threads(one=run_seconds(self.sampling) < SURELY_SHORT * ONE_THREAD)
            self.timer.lap("launch grid")
        self.context: SceneContext | None = None
        if plan is None:
            self.context = examine(scene, self.trace_scene, sampling=self.sampling, clock=clock)
            plan = plan_in(self.context)
        self.plan = plan
        self.scene = self.plan.apply(scene)
        left_out = ""
        if self.scene.points:
            points, left_out = lit_points(self.scene)
            self.scene = replace(self.scene, points=points)
        if self.sampling is not None and not self.scene.same_shapes(scene):
            # moving shapes were stopped, or something was left out
            if self.scene.traced:
                self.trace_scene, self._built_from = build_geometry(self.scene), self.scene
            else:
                self.trace_scene = self.sampling = None
        if self.sampling is not None:
            self.sampling = self.sampling.obeying(self.scene, self.plan.flags)
        self.layers = LayerPlan.of(self.scene, self.plan)
        self.statistics = TraceStatistics()
        self.report: SamplingReport | None = None
        self.witnesses: dict[str, Witness] = {}
        self.shortfalls: tuple[Shortfall, ...] = ()
        self.finished: FinishedBlocks | None = None
        self._needs: tuple[tuple[SamplingPlan | None, ImageGrid | None], Needs] | None = None
        self.notes = [*scene.notes, *self.plan.notes, *([left_out] if left_out else [])]
        if vanished := describe_vanished(self.scene):
            warnings.warn(vanished, SarmitsubaWarning, stacklevel=3)
            self.notes.append(vanished)
        if self.sampling is not None and self.plan.flags.multi_bounce:
            for unlit in (mirrors_outside, ground_outside):
                self.notes += [note] if (note := unlit(self.scene, self.sampling.windows)) else []
        glance()
        self.timer.lap("plan")

    @property
    def batch_shape(self) -> tuple[int, int, int]:
        """Layers of one ray subset, pulses and samples of the raw data."""
        return self.layers.per_subset, self.scene.radar.track.n_pulses, self.scene.radar.window.n_samples

    def at(self, factor: float) -> "Run":
        """Run with all ray spacings multiplied by a factor; geometry and decisions are shared."""
        other = copy(self)
        other.timer = StageTimer(self.timer.clock)
        if self.sampling is not None:
            denser = self.sampling.spacings.at(factor)
            settings = replace(self.scene.settings, **denser)  # type: ignore[arg-type]
            other.scene = replace(self.scene, settings=settings)
            other.sampling = self.sampling.obeying(other.scene, self.sampling.flags)
        return other

    def otherwise(self, scene: Scene) -> "Run":
        """Run of the same scene with other settings, its effects decided in the same context."""
        assert self.context is not None
        continued = continue_ground(scene)
        plan = plan_in(replace(self.context, scene=continued), warn=False)
        shared = self.trace_scene if continued.same_shapes(self._built_from) else None
        return Run(scene, plan=plan, clock=self.timer.clock, geometry=shared)

    def needs(self, grid: ImageGrid | None = None) -> Needs:
        """Rays, bytes and seconds that the run needs, before anything is allocated; computed once.

        Parameters
        ----------
        grid : pixels; default: those of the scene
        """
        key = (self.sampling, grid)
        if self._needs is None or self._needs[0] != key:
            measured = self.context.measured if self.context is not None else None
            needs = needs_of(
                self.scene, self.sampling, self.layers, grid, self.trace_scene, self.plan.sub_bands, measured
            )
            self._needs = (key, needs)
        return self._needs[1]

    def label_needs(self) -> Needs:
        """Needs of one look by method ``image`` of the same scene, of which labels are made."""
        settings = replace(self.scene.settings, method="image", keep_subsets=False, keep_orders=False)
        scene = replace(self.scene, settings=settings)
        sampling = self.sampling and self.sampling.obeying(scene, self.plan.flags)
        measured = self.context.measured if self.context is not None else None
        layers = LayerPlan.of(scene, self.plan)
        return needs_of(scene, sampling, layers, None, self.trace_scene, self.plan.sub_bands, measured)

    def admit(self, grid: ImageGrid | None = None) -> None:
        """Refuse a run that does not fit into memory; a short one is computed by one thread.

        Raises
        ------
        ResourceError
            The run does not fit into memory.
        """
        self.needs(grid).check()
        self.choose_threads(grid)

    def choose_threads(self, grid: ImageGrid | None = None) -> None:
        """Let one thread compute a short run, and all threads a longer one; see :mod:`sarmitsuba.machine.exclusive`."""
        seconds = self.needs(grid).seconds
        take_threads(one=sum(seconds.get(stage, 0.0) for stage in SHARED) < ONE_THREAD)

    def tracer(self, sampling: SamplingPlan, *, antenna_pattern: bool = True) -> Tracer:
        """Tracer of this scene; ``antenna_pattern`` off leaves out the weight of the beam."""
        assert self.trace_scene is not None
        flags = replace(
            sampling.flags,
            antenna_pattern=sampling.flags.antenna_pattern and antenna_pattern,
        )
        plan = self.plan
        return Tracer(sampling, flags, self.trace_scene, plan.max_depth, self.timer, plan.sub_bands)

    def job(self, sampling: SamplingPlan, pass_index: int) -> TraceJob:
        """Input for another process to trace a part of the run's raw data."""
        plan = self.plan
        return TraceJob(self._built_from, sampling, self.layers, plan.max_depth, pass_index, plan.sub_bands)

    def rays(self, sampling: SamplingPlan, pass_index: int) -> Rays:
        """Lattices of every ray subset, for every pulse; other values of ``pass_index`` give independent ones.

        Raises
        ------
        RadarError
            There is no ray for some pulse.
        """
        assert self.trace_scene is not None
        rays = Rays(sampling, self.trace_scene, self.layers.subsets, pass_index, self.plan.max_depth)
        middle = self.scene.radar.track.center_index
        for grids in rays.at(middle):
            self._check_rays(sampling, grids)
        self.shortfalls = rays.shortfalls
        self.timer.lap("launch grid")
        return rays

    def lattices(self, sampling: SamplingPlan, pass_index: int) -> list[tuple[LaunchGrid, ...]]:
        """Lattices (see :meth:`rays`) at the middle of the track; the same for all pulses where nothing moves."""
        return self.rays(sampling, pass_index).at(self.scene.radar.track.center_index)

    def _check_rays(self, sampling: SamplingPlan, grids: tuple[LaunchGrid, ...]) -> None:
        for window in sampling.windows:
            if not any(grid.serves(window.pulses[0]) for grid in grids):
                raise RadarError(
                    f"{self.scene.name}: ray spacing {sampling.spacings.coherent:.3g} m is larger than the lit scene, "
                    f"{2 * window.half_x:.3g} m x {2 * window.half_y:.3g} m across the line of sight; set "
                    "ray_spacing to a fraction of that"
                )
