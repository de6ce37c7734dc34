"""A run of a scene, made ready for any method: effects decided, geometry on the device, sampling planned."""

import time
from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np

from sarmitsuba.backend import ensure_backend
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import RadarError
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.layers import LayerPlan
from sarmitsuba.simulation.pilot import plan_scene
from sarmitsuba.simulation.prediction.needs import Needs, needs_of
from sarmitsuba.simulation.sampling.launch_window import bounding_antennas, mirrors_outside
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.simulation.sampling.small_parts import Shortfall, with_small_parts
from sarmitsuba.simulation.statistics import SamplingReport, TraceStatistics
from sarmitsuba.simulation.tracing import Tracer
from sarmitsuba.timing import Clock, StageTimer
from sarmitsuba.trace.geometry import TraceScene, build_trace_scene
from sarmitsuba.trace.launch import LaunchGrid

# told when a run is made ready and before anything is traced, e.g. to show its plan and what it will take
Ready = Callable[["Run"], None]


class Run:
    """What every method of simulation starts from.

    Parameters
    ----------
    scene : as loaded
    plan : overrides the automatic effects plan
    clock : of the run's stages

    Attributes
    ----------
    scene : as the effects plan leaves it
    plan : decided effects
    trace_scene : geometry on the device; None where there is no mesh
    sampling : how the scene is sampled; None where there is no mesh
    layers : what is kept apart
    timer : seconds by stage
    statistics : of the last image or raw data
    report : the rays that raw data took; None before, and where there is no mesh
    shortfalls : surface that the lattices made last are too coarse for
    notes : one line each; what was assumed, repaired or is worth a warning
    """

    def __init__(
        self, scene: Scene, *, plan: EffectsPlan | None = None, clock: Clock = time.perf_counter
    ) -> None:
        ensure_backend()
        if scene.settings.method in ("image", "raster") and scene.radar.all_round:
            raise RadarError(
                f"{scene.name}: method {scene.settings.method} takes one look, but the track goes round the scene; "
                "take method hybrid or raw"
            )
        self.timer = StageTimer(clock)
        self.trace_scene: TraceScene | None = None
        self.sampling: SamplingPlan | None = None
        if scene.geometry.n_faces:
            wavelength = scene.radar.waveform.wavelength
            self.trace_scene = build_trace_scene(
                scene.geometry, scene.materials, wavelength, scene.radar.track.center_position
            )
            self.timer.lap("build")
            self.sampling = SamplingPlan.of(scene)
            self.timer.lap("launch grid")
        self.plan = plan or plan_scene(scene, self.trace_scene, sampling=self.sampling, clock=clock)
        self.scene = self.plan.apply(scene)
        if self.sampling is not None:
            self.sampling = self.sampling.obeying(self.scene, self.plan.flags)
        self.layers = LayerPlan.of(self.scene, self.plan)
        self.statistics = TraceStatistics()
        self.report: SamplingReport | None = None
        self.shortfalls: tuple[Shortfall, ...] = ()
        self.notes = [*scene.notes, *self.plan.notes]
        if self.sampling is not None and self.plan.flags.multi_bounce:
            left_out = mirrors_outside(self.scene, self.sampling.windows)
            self.notes += [left_out] if left_out else []
        self.timer.lap("plan")

    def at(self, factor: float) -> "Run":
        """The run with its rays so many times as far apart; it shares the geometry and every decision."""
        other = copy(self)
        other.timer = StageTimer(self.timer.clock)
        if self.sampling is not None:
            denser = self.sampling.spacings.at(factor)
            settings = replace(self.scene.settings, **denser)  # type: ignore[arg-type]
            other.scene = replace(self.scene, settings=settings)
            other.sampling = self.sampling.obeying(other.scene, self.sampling.flags)
        return other

    def needs(self, grid: ImageGrid | None = None) -> Needs:
        """What the run takes; nothing of it is allocated yet.

        Parameters
        ----------
        grid : pixels; default: those that the scene asks for
        """
        return needs_of(self.scene, self.sampling, self.layers, grid)

    def tracer(self, sampling: SamplingPlan, *, antenna_pattern: bool = True) -> Tracer:
        """What traces this scene; off, ``antenna_pattern`` leaves the beam's weight out."""
        assert self.trace_scene is not None
        flags = replace(
            sampling.flags,
            antenna_pattern=sampling.flags.antenna_pattern and antenna_pattern,
        )
        return Tracer(sampling, flags, self.trace_scene, self.plan.max_depth, self.timer)

    def lattices(self, sampling: SamplingPlan, pass_index: int) -> list[tuple[LaunchGrid, ...]]:
        """Lattices of every ray subset; other values of ``pass_index`` give independent ones.

        Raises
        ------
        RadarError
            Not a single ray is left for some pulse.
        """
        assert self.trace_scene is not None
        track = self.scene.radar.track
        made, short = [], []
        for subset in self.layers.subsets:
            draw = subset + 2 * pass_index
            rng = np.random.default_rng([self.scene.settings.seed & 0x7FFFFFFF, draw, 0x50A1])
            finer: list[LaunchGrid] = []
            for one in sampling.lattices(draw=draw, subset=subset):
                pulses, frame = one.pulses or (0, track.n_pulses), one.frame or sampling.window.frame
                antennas = bounding_antennas(track, pulses)
                grid, missed = with_small_parts(one, self.trace_scene, frame, antennas, rng)
                finer.append(grid)
                if missed is not None and one.serves(track.center_index):
                    short.append(missed)
            made.append(tuple(grid for grid in finer if grid.n_rays))
            self._check_rays(sampling, made[-1])
        self.shortfalls = tuple(short)
        self.timer.lap("launch grid")
        return made

    def _check_rays(self, sampling: SamplingPlan, grids: tuple[LaunchGrid, ...]) -> None:
        for window in sampling.windows:
            if not any(grid.serves(window.pulses[0]) for grid in grids):
                raise RadarError(
                    f"{self.scene.name}: rays {sampling.spacings.coherent:.3g} m apart all pass beside what is to be "
                    f"seen, {2 * window.half_x:.3g} m x {2 * window.half_y:.3g} m as the radar sees it; set "
                    "ray_spacing to a fraction of that"
                )


__all__ = ["Ready", "Run"]
