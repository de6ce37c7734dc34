"""From a scene to range-compressed raw data: plan, trace key pulses, synthesise the pulses around each."""

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import dr, ensure_backend, mi
from sarmitsuba.constants import SUBSET_SHARES
from sarmitsuba.echo.block import BlockPlan, choose_block_length, least_error_db, plan_block, synthesise
from sarmitsuba.echo.direct import box_distance, finish, plan_direct
from sarmitsuba.echo.raw import Layer, RawData
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import RadarError, SarmitsubaWarning
from sarmitsuba.progress import Progress, silent
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.pilot import plan_scene
from sarmitsuba.simulation.points import add_points
from sarmitsuba.simulation.window import (
    RAYS_PER_WAVELENGTH,
    LaunchWindow,
    azimuth_cell,
    diffuse_spacing,
    launch_window,
    ray_lattices,
    scatterer_cell,
    share_of_small_facets,
)
from sarmitsuba.trace.accumulators import BlockAccumulator, DirectAccumulator, GridAccumulator
from sarmitsuba.trace.geometry import TraceScene, build_trace_scene
from sarmitsuba.trace.kernel import KernelSettings, trace
from sarmitsuba.trace.launch import LaunchGrid, PulseBatch, Purpose

# lanes of one launch; bounds the memory of a batch whatever the number of pulses
MAX_LANES = 8_000_000
# bytes of one accumulator grid; bounds the pulses of a direct batch
MAX_GRID_BYTES = 256_000_000
# share of the surface in facets smaller than the rays' spacing that is worth a warning
SMALL_FACETS = 0.01


@dataclass(frozen=True)
class TraceStatistics:
    """What a simulation did.

    Parameters
    ----------
    rays, hits, contributions : over all pulses traced
    outside : contributions outside the receive window or the Doppler window, dropped
    key_pulses : pulses that were traced
    path_pulses : contributions times the pulses they went to
    """

    rays: int = 0
    hits: int = 0
    contributions: int = 0
    outside: int = 0
    key_pulses: int = 0
    path_pulses: int = 0

    def plus(self, other: "TraceStatistics") -> "TraceStatistics":
        """Sum."""
        return TraceStatistics(
            self.rays + other.rays,
            self.hits + other.hits,
            self.contributions + other.contributions,
            self.outside + other.outside,
            self.key_pulses + other.key_pulses,
            self.path_pulses + other.path_pulses,
        )


class Timer:
    """Adds up seconds by stage name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on ``stage``."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now


def simulate(
    scene: Scene,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
    plan: EffectsPlan | None = None,
    pass_index: int = 0,
) -> RawData:
    """Trace a scene and return the range-compressed echoes of every pulse.

    Parameters
    ----------
    scene : as loaded
    seed : overrides the scene's
    progress : called after every batch
    plan : overrides the automatic effects plan
    pass_index : other values shift the ray lattices and nothing else: independent samples of the same scene

    Returns
    -------
    raw : ``compressed`` domain; layers are channels, times bounce orders and ray subsets where those are kept

    Raises
    ------
    RadarError
        When not a single path comes back.

    Notes
    -----
    Ignores what the kernel ignores; within a block of pulses amplitudes and visibility are those of its key pulse.
    """
    ensure_backend()
    report = progress or silent
    timer = Timer()
    if seed is not None:
        scene = replace(scene, settings=replace(scene.settings, seed=seed))
    trace_scene = window = None
    if scene.geometry.n_faces:
        trace_scene = build_trace_scene(scene.geometry, scene.materials, scene.radar.waveform.wavelength)
        timer.lap("build")
        window = launch_window(scene)
        timer.lap("launch grid")
    plan = plan or plan_scene(scene, trace_scene, window=window)
    flown = scene.radar.track
    scene = plan.apply(scene)
    timer.lap("plan")
    radar = scene.radar
    settings = scene.settings
    orders = tuple(range(1, plan.max_depth + 1)) if settings.keep_orders else (0,)
    subsets = (1, 2) if settings.keep_subsets else (0,)
    layers = tuple(Layer(c, o, s) for s in subsets for o in orders for c in radar.channels)
    per_subset = len(orders) * len(radar.channels)
    data = np.zeros((len(layers), radar.track.n_pulses, radar.window.n_samples), dtype=np.complex64)

    stats = TraceStatistics()
    facts: dict[str, Any] = {}
    if trace_scene is not None:
        assert window is not None
        if radar.track is not flown:
            window = launch_window(scene)
        flags = replace(plan.flags, taper=plan.flags.taper and window.taper > 0)
        job = TraceJob(scene, replace(plan, flags=flags), window, trace_scene, timer)
        rays = [ray_lattices(scene, window, plan.flags, draw=s + 2 * pass_index, subset=s) for s in subsets]
        from sarmitsuba.simulation.small_parts import with_small_parts

        ants = radar.track.position[[0, radar.track.center_index, -1]]
        rays = [
            tuple(
                g
                for grid in grids
                for g in (
                    [grid]
                    if grid.frame
                    else with_small_parts(
                        grid,
                        trace_scene,
                        window.frame,
                        ants,
                        np.random.default_rng([settings.seed & 0x7FFFFFFF, 77]),
                    )
                )
            )
            for grids in rays
        ]
        rays = [tuple(g for g in grids if g.n_rays) for grids in rays]
        timer.lap("launch grid")
        spacing = _spacings(rays)
        facts.update(
            ray_spacing=min(spacing.values()),
            ray_spacings=spacing,
            rays_per_key_pulse=sum(g.n_rays for grids in rays for g in grids),
            scatterer_cell=job.cell,
        )
        for i, grids in enumerate(rays):
            target = data[i * per_subset : (i + 1) * per_subset]
            for done, batch in job.run(grids, target, len(orders) if settings.keep_orders else 0, facts):
                stats = stats.plus(batch)
                rate = stats.rays / max(timer.seconds.get("trace", 0.0), 1e-9)
                report("trace", i + done, len(subsets), {"rays/s": rate})
        facts["grid_bytes"] = job.largest_grid
        for plane, layer in zip(data, layers, strict=True):  # each subset is a whole image of its own
            plane *= np.float32(SUBSET_SHARES[layer.subset])
    if scene.points:
        n = add_points(scene, plan.flags, trace_scene, data, layers)
        stats = stats.plus(TraceStatistics(contributions=n, path_pulses=n))
        timer.lap("points")
    notes = [*scene.notes, *plan.notes]
    _check_energy(scene, stats, data, notes)
    if window is not None:
        _check_sampling(scene, window, {} if rays[0][0].frame else spacing, notes)
    if "key_pulse_interval" in facts:
        interval = int(facts["key_pulse_interval"])
        plan = plan.with_key_pulses(interval, block_error_db(settings), settings.key_pulse_interval > 0)
    metadata = _metadata(scene, plan, stats, timer, facts, notes)
    raw = RawData(data, layers, "compressed", radar, metadata)
    if plan.on("noise"):
        from sarmitsuba.echo.noise import add_noise

        raw = add_noise(raw, seed=settings.seed)
        timer.lap("noise")
    return raw


def _spacings(rays: Sequence[Sequence[LaunchGrid]]) -> dict[Purpose, float]:
    """Spacing of all subsets' rays together, by what they are for; ``all`` where one lattice serves both."""
    density: dict[Purpose, float] = {}
    kinds: dict[Purpose, tuple[Purpose, ...]] = {
        "all": ("coherent", "diffuse"),
        "coherent": ("coherent",),
        "diffuse": ("diffuse",),
    }
    for grid in (g for grids in rays for g in grids):
        for kind in kinds[grid.purpose]:
            density[kind] = density.get(kind, 0.0) + grid.spacing**-2
    if all(g.purpose == "all" for grids in rays for g in grids):
        return {"all": float(density["coherent"] ** -0.5)}
    return {kind: float(d**-0.5) for kind, d in density.items()}


def block_error_db(settings: TraceSettings) -> float:
    """Error that a block of pulses may have against tracing every one: the tolerance, or what the gridding allows."""
    return least_error_db(settings.gridding_width, settings.tolerance_db)


class TraceJob:
    """The tracing of one scene: everything that does not change from batch to batch."""

    def __init__(
        self, scene: Scene, plan: EffectsPlan, window: LaunchWindow, trace_scene: TraceScene, timer: Timer
    ) -> None:
        self.scene, self.plan, self.window, self.trace_scene, self.timer = (
            scene,
            plan,
            window,
            trace_scene,
            timer,
        )
        self.cell = scatterer_cell(scene, window.incidence)
        self.largest_grid = 0
        radar = scene.radar
        reference = float(np.linalg.norm(window.center - radar.track.center_position))
        self.kernel = KernelSettings(
            wavelength=radar.waveform.wavelength,
            max_depth=plan.max_depth,
            cell=self.cell,
            seed=scene.settings.seed,
            amplitude=radar.amplitude_constant,
            reference_range=reference,
            up=_polarisation_up(radar, window.center),
        )

    def run(
        self, rays: Sequence[LaunchGrid], data: NDArray[np.complex64], max_order: int, facts: dict[str, Any]
    ) -> Iterator[tuple[float, TraceStatistics]]:
        """Fill ``data`` (layers, pulses, samples) batch by batch; yields the share done and that batch's figures."""
        radar, settings = self.scene.radar, self.scene.settings
        n = radar.track.n_pulses
        width = settings.gridding_width
        length = 1
        if settings.method != "raw":
            length = settings.key_pulse_interval or choose_block_length(
                radar,
                self.window.center,
                self.phase_box(),
                width,
                settings.tolerance_db,
                extra_slant_range=self.extra_slant_range(),
            )
        facts["key_pulse_interval"] = length
        if length > 1:
            for start in range(0, n, length):
                stop = min(n, start + length)
                plan = plan_block(
                    radar,
                    start,
                    stop,
                    self.window.center,
                    self.phase_box(),
                    width,
                    extra_slant_range=self.extra_slant_range(),
                )
                yield stop / n, self.block(rays, plan, data, max_order)
            return
        row = data.shape[0] * 2 * radar.window.n_samples * 2 * 16
        step = int(max(1, min(MAX_LANES // max(g.n_rays for g in rays), MAX_GRID_BYTES // row, n)))
        for start in range(0, n, step):
            stop = min(n, start + step)
            yield stop / n, self.direct(rays, start, stop, data, max_order)

    def phase_box(self) -> NDArray[np.float64]:
        """Bounds of the phase centres whose Doppler is kept: the lit box, and a quarter more for mirror images."""
        low, high = self.window.box
        margin = 0.25 * (high - low) * np.array([1.0, 1.0, 0.0]) + 2.0 * self.cell
        return np.stack([low - margin, high + margin])

    def extra_slant_range(self) -> float:
        """What multiple reflections may add to a slant range and still be inside the receive window, m."""
        window, track = self.scene.radar.window, self.scene.radar.track
        end = float(window.start_range.max()) + window.extent
        far = float(box_distance(self.phase_box(), track.position)[1].min())
        return max(0.0, end - far)

    def block(
        self, rays: Sequence[LaunchGrid], plan: BlockPlan, data: NDArray[np.complex64], max_order: int
    ) -> TraceStatistics:
        """Trace one key pulse and synthesise its block."""
        radar = self.scene.radar
        accumulator = BlockAccumulator(
            plan,
            data.shape[0] // len(radar.channels),
            len(radar.channels),
            max_order,
            radar.waveform.wavelength,
        )
        self.largest_grid = max(self.largest_grid, accumulator.n_bytes)
        position, velocity = plan.position[None], plan.velocity[None]
        pick = slice(plan.key, plan.key + 1)
        accumulator.watch(radar.window.start_range[pick], radar.window.extent)
        stats = self.launch_all(rays, position, velocity, pick, accumulator, plan.n_pulses)
        beam = self.plan.flags.antenna_pattern
        data[:, plan.start : plan.stop] = synthesise(accumulator.grid(), plan, radar, beam=beam)
        self.timer.lap("synthesise")
        return stats

    def direct(
        self, rays: Sequence[LaunchGrid], start: int, stop: int, data: NDArray[np.complex64], max_order: int
    ) -> TraceStatistics:
        """Trace every pulse of ``start:stop`` in one launch."""
        radar = self.scene.radar
        plan = plan_direct(
            radar, start, stop, self.phase_box(), self.scene.settings.gridding_width, self.extra_slant_range()
        )
        accumulator = DirectAccumulator(
            plan,
            data.shape[0] // len(radar.channels),
            len(radar.channels),
            max_order,
            radar.waveform.wavelength,
        )
        self.largest_grid = max(self.largest_grid, accumulator.n_bytes)
        pick = slice(start, stop)
        accumulator.watch(radar.window.start_range[pick], radar.window.extent)
        stats = self.launch_all(
            rays, radar.track.position[pick], radar.track.velocity[pick], pick, accumulator, 1
        )
        data[:, pick] = finish(accumulator.grid(), plan, radar)
        self.timer.lap("synthesise")
        return stats

    def launch_all(
        self,
        rays: Sequence[LaunchGrid],
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
        pick: slice,
        accumulator: GridAccumulator,
        pulses_each: int,
    ) -> TraceStatistics:
        """Run one kernel for each lattice, all into the same grid."""
        each = [self.launch(grid, position, velocity, pick, accumulator, pulses_each) for grid in rays]
        total = each[0]
        for more in each[1:]:
            total = total.plus(replace(more, key_pulses=0))
        return total

    def launch(
        self,
        grid: LaunchGrid,
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
        pick: slice,
        accumulator: GridAccumulator,
        pulses_each: int,
    ) -> TraceStatistics:
        """Record and run one kernel."""
        radar = self.scene.radar
        pointing = radar.pointing
        patterned = self.plan.flags.antenna_pattern
        batch = PulseBatch(
            position=position,
            velocity=velocity,
            frame=grid.frame or self.window.frame,
            boresight=pointing.boresight[pick] if patterned else None,
            azimuth_axis=pointing.azimuth_axis[pick] if patterned and pulses_each == 1 else None,
            elevation_axis=pointing.elevation_axis[pick] if patterned else None,
        )
        flags = self.plan.flags
        if grid.purpose == "coherent":
            flags = replace(flags, diffuse=False)
        elif grid.purpose == "diffuse":
            flags = replace(flags, coherent=False)
        counts, state = trace(self.trace_scene, grid, batch, flags, self.kernel, radar.antenna, accumulator)
        dr.eval(counts.hits, counts.contributions, state, accumulator.memory)
        totals = [int(dr.sum(mi.UInt64(c))[0]) for c in (counts.hits, counts.contributions, state[0])]
        self.timer.lap("trace")
        return TraceStatistics(
            rays=grid.n_rays * batch.n_pulses,
            hits=totals[0],
            contributions=totals[1],
            outside=totals[2],
            key_pulses=batch.n_pulses,
            path_pulses=totals[1] * pulses_each,
        )


def _polarisation_up(radar: Radar, center: NDArray[np.float64]) -> tuple[float, float, float]:
    """Vertical reference of the polarisation basis: the scene's vertical, or across track when looking down."""
    look = center - radar.track.center_position
    look = look / np.linalg.norm(look)
    up = np.array([0.0, 0.0, 1.0])
    if abs(look[2]) > np.cos(np.radians(1.0)):  # within a degree of nadir H and V lose their meaning
        up = radar.across
    return (float(up[0]), float(up[1]), float(up[2]))


def _check_energy(
    scene: Scene, stats: TraceStatistics, data: NDArray[np.complex64], notes: list[str]
) -> None:
    if scene.geometry.n_faces and stats.hits == 0 and not scene.points:
        raise RadarError(
            f"{scene.name}: none of {stats.rays} rays hits the scene; check that the image footprint "
            f"(image_center_x, image_center_y, image extents) lies on the geometry"
        )
    if not np.any(data):
        raise RadarError(
            f"{scene.name}: {stats.hits} hits but no echo within the receive window; widen near_range ... far_range "
            f"of the range_film"
        )
    if stats.outside > 0.05 * max(stats.contributions, 1):
        text = (
            f"{scene.name}: {100.0 * stats.outside / stats.contributions:.1f} % of the path contributions fall outside "
            f"the receive window and are not recorded; widen near_range ... far_range of the range_film"
        )
        notes.append(text)
        warnings.warn(text, SarmitsubaWarning, stacklevel=3)


def _check_sampling(
    scene: Scene, window: LaunchWindow, spacing: Mapping[Purpose, float], notes: list[str]
) -> None:
    """Say when rays asked for are too far apart for the resolution or for the diffuse scatterers."""
    texts = []
    half_cell = 0.5 * min(azimuth_cell(scene), scene.radar.waveform.range_cell)
    coherent = spacing.get("coherent", spacing.get("all", 0.0))
    if coherent > 1.01 * half_cell:
        texts.append(
            f"ray_spacing = {coherent:g} m is coarser than half a resolution cell; {half_cell:.3g} m would do"
        )
    fine = scene.radar.waveform.wavelength / RAYS_PER_WAVELENGTH
    asked = scene.settings.ray_spacing > 0
    if asked and coherent > 1.01 * fine:
        share = share_of_small_facets(scene.geometry, coherent)
        if share > SMALL_FACETS:
            texts.append(
                f"ray_spacing = {coherent:g} m is coarser than the facets of curved surfaces, {100 * share:.0f} % of "
                f"the area; their coherent return wants {RAYS_PER_WAVELENGTH:g} rays a wavelength: {fine:.3g} m"
            )
    diffuse = spacing.get("diffuse", 0.0)
    wanted = diffuse_spacing(
        replace(scene, settings=replace(scene.settings, diffuse_ray_spacing=0.0)), window
    )
    if diffuse > 1.5 * wanted:
        cell = scatterer_cell(scene, window.incidence)
        texts.append(
            f"diffuse_ray_spacing = {diffuse:g} m leaves out scatterer cells of {cell:.3g} m; "
            f"{wanted:.3g} m would do"
        )
    for text in texts:
        line = f"{scene.name}: {text}"
        notes.append(line)
        warnings.warn(line, SarmitsubaWarning, stacklevel=3)


def _metadata(
    scene: Scene,
    plan: EffectsPlan,
    stats: TraceStatistics,
    timer: Timer,
    facts: Mapping[str, Any],
    notes: list[str],
) -> dict[str, Any]:
    return {
        "scene": scene.name,
        "scene_path": str(scene.path) if scene.path else None,
        "scene_offset_m": scene.offset.tolist(),
        "settings": {k: v for k, v in vars(scene.settings).items() if k != "effects"},
        "effects": dict(plan.as_dict()),
        "plan": plan.summary(),
        "statistics": vars(stats),
        "sampling": dict(facts),
        "image": dict(vars(scene.image)),
        "seconds": timer.seconds,
        "notes": notes,
    }


__all__ = ["Timer", "TraceJob", "TraceStatistics", "block_error_db", "simulate"]
