"""What a run needs, from its sampling alone: rays, bytes and seconds, before any of it is allocated."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.backend import dr
from sarmitsuba.echo.block import plan_block
from sarmitsuba.echo.direct import plan_direct
from sarmitsuba.errors import ResourceError
from sarmitsuba.focusing import default_grid
from sarmitsuba.focusing.focusers.backprojection import Backprojection
from sarmitsuba.focusing.look import look_size
from sarmitsuba.focusing.needs import focusing_bytes, look_bytes
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.memory import check_fits, held_memory, in_bytes
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.layers import LayerPlan
from sarmitsuba.simulation.prediction.speed import TWO_CORES, scatterers_met
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.simulation.tracing import MAX_GRID_BYTES, MAX_LANES
from sarmitsuba.trace.accumulators import grid_numbers
from sarmitsuba.trace.geometry import TraceScene

# bytes of one ray: coordinates; and while its lattice is sorted, those twice, a key and a place in the order
RAY, SORTED_RAY = 8, 28
# bytes of one lane of a launch: coordinates, level, counts and powers lost, and their sums' float64 copies
LANE = 52
# bytes of the slabs that a lattice is cut from, at most, and of one of their nodes
SLAB_NODES, NODE = 4_000_000, 40
# bytes that compiling the kernels, transforms and the pages of libraries take at first use
FIRST_USE = 70_000_000
# copies of the raw data that passes hold beside those that are being made
PASSES_HELD = 3
# bytes of a raster's pixel: its blur, and each channel's planes and transforms
RASTER_PIXEL, RASTER_PLANE = 16, 60
# a raster's sample over a ray in time, and seconds of a pixel that is formed by transforms
RASTER_SHARE, FORMED_PIXEL = 0.1, 1e-6


@dataclass(frozen=True)
class Needs:
    """What a run takes beyond what the process holds already.

    Parameters
    ----------
    name : of the scene
    method : of simulation
    rays : of the whole run
    image_shape : pixels, azimuth and range
    layers : of raw data and image
    stages : bytes that each stage holds at most, what outlives it included
    parts : bytes of what they consist of
    seconds : by stage, on two usual cores
    key_pulses : pulses that are traced
    key_pulse_interval : pulses that share one tracing; 0 for methods without raw data, and where nothing is traced
    raw_bytes : of the raw data; 0 for methods without
    ray_spacing : m, of coherent rays
    """

    name: str
    method: str
    rays: int
    image_shape: tuple[int, int]
    layers: int
    stages: Mapping[str, int]
    parts: Mapping[str, int]
    seconds: Mapping[str, float]
    key_pulses: int = 1
    key_pulse_interval: int = 0
    raw_bytes: int = 0
    ray_spacing: float = 0.0

    @property
    def bytes(self) -> int:
        """Most that is held at a time."""
        return max(self.stages.values())

    @property
    def pixels(self) -> int:
        """Of the image, all layers."""
        return int(np.prod(self.image_shape)) * self.layers

    @property
    def memory(self) -> int:
        """Most that the process will hold at a time, bytes."""
        return held_memory() + self.bytes

    @property
    def by_progress(self) -> dict[str, float]:
        """Seconds by the stages that report progress: synthesis goes with tracing."""
        focus = self.seconds.get("focus", 0.0)
        before = sum(self.seconds.values()) - focus
        first = {"image": "image", "raster": "raster"}.get(self.method, "trace")
        return {name: s for name, s in ((first, before), ("focus", focus)) if s > 0.0}

    @property
    def remedy(self) -> str:
        """What to change, by the part that takes the most."""
        part = max(self.parts, key=lambda name: self.parts[name])
        rows, columns = self.image_shape
        metres = "check that the model is in metres (to_world)"
        remedies = {
            "rays": f"{self.rays / max(self.key_pulses, 1):.3g} rays per key pulse, {self.ray_spacing:.3g} m apart, "
            f"take the most: {metres}, make the image smaller, or set ray_spacing",
            "grids": "the grids that paths are added to take the most: make the image smaller, or leave out "
            f"keep_orders; {metres}",
            "raw data": "raw data take the most: widen azimuth_resolution, make the image smaller, or use method image",
            "image": f"the image of {rows} x {columns} pixels in {self.layers} layers takes the most: make its extents "
            f"smaller or its pixel spacings wider; {metres}",
        }
        return remedies[part]

    @property
    def refusal(self) -> str:
        """Why the run is refused, with the remedy; empty where it fits."""
        try:
            self.check()
        except ResourceError as error:
            return str(error)
        return ""

    @property
    def of_passes(self) -> "Needs":
        """The same where passes are added up: their mean, what the last one changed, and the step to the new mean."""
        more = PASSES_HELD * self.raw_bytes
        return replace(
            self,
            stages={name: size + more for name, size in self.stages.items()},
            parts={name: size + (more if name == "raw data" else 0) for name, size in self.parts.items()},
        )

    def check(self) -> None:
        """Refuse a run that does not fit.

        Raises
        ------
        ResourceError
            More memory is needed than there is.
        """
        check_fits(f"{self.name}: this run", self.bytes, self.remedy)

    def __str__(self) -> str:
        """One line."""
        rows, columns = self.image_shape
        total = sum(self.seconds.values())
        rays = f"{self.rays / 1e6:.3g} million rays"
        if self.raw_bytes:
            rays += f" at {self.key_pulses} key pulses, {in_bytes(self.raw_bytes)} of raw data"
        return (
            f"expected: {rays}, {rows} x {columns} pixels, {in_bytes(self.memory)} of memory, about "
            f"{duration(total)} on two cores"
        )


def duration(seconds: float) -> str:
    """A time for people: ``4.1 s``, ``12 min``, ``5.2 h``."""
    if seconds < 90.0:
        return f"{seconds:.1f} s" if seconds >= 1.0 else f"{1e3 * seconds:.0f} ms"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def needs_of(
    scene: Scene,
    sampling: SamplingPlan | None,
    layers: LayerPlan,
    grid: ImageGrid | None = None,
    trace_scene: TraceScene | None = None,
    sub_bands: int = 1,
) -> Needs:
    """Needs of a run.

    Parameters
    ----------
    scene, sampling : as the effects plan leaves them; no sampling where there is no mesh
    layers : what is kept apart
    grid : pixels; default: those that the scene asks for; one pulse makes no image
    trace_scene : what is traced; None: finer lattices over its small parts are left out
    sub_bands : number of frequencies that the band is traced at

    Notes
    -----
    Ignores passes beyond the first (:attr:`Needs.of_passes` adds their data), and copies of the raw data in other
    domains. The seconds are those of usual cores; :func:`predict` measures.
    """
    of_method = {"raster": _of_raster, "image": _of_image}.get(scene.settings.method)
    if of_method is None and grid is None and scene.radar.track.n_pulses < 2:
        needs = _of_raw(scene, sampling, layers, None, trace_scene)
    else:
        grid = grid or default_grid(scene.radar, scene.image)
        needs = (of_method or _of_raw)(scene, sampling, layers, grid, trace_scene)
    if sub_bands == 1:
        return needs
    repeated = {
        name: sub_bands * needs.seconds[name] for name in ("trace", "synthesise") if name in needs.seconds
    }
    return replace(needs, rays=sub_bands * needs.rays, seconds={**needs.seconds, **repeated})


def _of_raster(
    scene: Scene,
    sampling: SamplingPlan | None,
    layers: LayerPlan,
    grid: ImageGrid,
    trace_scene: TraceScene | None,
) -> Needs:
    pixels, n_channels = int(np.prod(grid.shape)), len(layers.channels)
    screen = 0
    if sampling is not None:
        screen = int(sampling.window.area / (0.5 * min(sampling.range_cell, sampling.azimuth_cell)) ** 2)
    forming = pixels * (RASTER_PIXEL + RASTER_PLANE * n_channels)
    return Needs(
        name=scene.name,
        method="raster",
        rays=screen,
        image_shape=grid.shape,
        layers=n_channels,
        stages={"image": FIRST_USE + forming},
        parts={"image": forming},
        seconds={"raster": RASTER_SHARE * screen * TWO_CORES.ray + pixels * n_channels * FORMED_PIXEL},
    )


def _of_image(
    scene: Scene,
    sampling: SamplingPlan | None,
    layers: LayerPlan,
    grid: ImageGrid,
    trace_scene: TraceScene | None,
) -> Needs:
    n_layers = len(layers.layers)
    rays: tuple[int, ...] = (0,)
    rows, columns, looks = look_size(scene.radar, grid)
    numbers = grid_numbers((len(layers.orders), rows, columns), len(layers.channels))
    seconds = {"form image": float(np.prod(grid.shape)) * n_layers * FORMED_PIXEL}
    if sampling is not None:
        sampling = sampling.of_one_look()
        finer = finer_rays(sampling, layers, trace_scene)
        rays = tuple(map(sum, zip(lattice_rays(sampling, layers), finer, strict=True)))
        seconds = _trace_seconds(sampling, layers, rays, finer, looks) | seconds
    lanes = max(rays) * max(1, min(looks, MAX_LANES // max(max(rays), 1)))
    forming = look_bytes(grid, n_layers, rows * columns)
    return Needs(
        name=scene.name,
        method="image",
        rays=looks * sum(rays),
        key_pulses=looks,
        image_shape=grid.shape,
        layers=n_layers,
        stages={
            "trace": _tracing_bytes(rays, lanes, numbers) + forming,
            "image": FIRST_USE + RAY * sum(rays) + _device_bytes(lanes, numbers) + forming,
        },
        parts={"rays": _ray_bytes(rays, lanes), "grids": _grid_bytes(numbers), "image": forming},
        seconds=seconds,
        ray_spacing=sampling.spacings.coherent if sampling else 0.0,
    )


def _of_raw(
    scene: Scene,
    sampling: SamplingPlan | None,
    layers: LayerPlan,
    grid: ImageGrid | None,
    trace_scene: TraceScene | None,
) -> Needs:
    radar, n_layers = scene.radar, len(layers.layers)
    n_pulses = radar.track.n_pulses
    samples = n_layers * n_pulses * radar.window.n_samples
    focusing = (
        focusing_bytes(grid, n_layers, Backprojection().making_bytes(radar, grid, n_layers)) if grid else 0
    )
    shape = grid.shape if grid else (0, 0)
    focus = float(np.prod(shape)) * n_layers * n_pulses * TWO_CORES.pixel_pulse
    if sampling is None:
        return Needs(
            name=scene.name,
            method=scene.settings.method,
            rays=0,
            key_pulses=0,
            raw_bytes=8 * samples,
            image_shape=shape,
            layers=n_layers,
            stages={"image": FIRST_USE + 8 * samples + focusing},
            parts={"raw data": 8 * samples, "image": focusing},
            seconds={"focus": focus},
        )
    finer, interval = finer_rays(sampling, layers, trace_scene), sampling.key_pulse_interval
    rays = tuple(map(sum, zip(lattice_rays(sampling, layers), finer, strict=True)))
    keys = n_pulses if interval == 1 else -(-n_pulses // interval)
    numbers, lanes, synthesis = _synthesis(sampling, layers, max(rays))
    return Needs(
        name=scene.name,
        method=scene.settings.method,
        rays=keys * sum(rays),
        key_pulses=keys,
        key_pulse_interval=interval,
        raw_bytes=8 * samples,
        image_shape=shape,
        layers=n_layers,
        stages={
            "trace": 8 * samples + _tracing_bytes(rays, lanes, numbers) + synthesis,
            "image": FIRST_USE + 8 * samples + RAY * sum(rays) + _device_bytes(lanes, numbers) + focusing,
        },
        parts={
            "rays": _ray_bytes(rays, lanes),
            "grids": _grid_bytes(numbers) + synthesis,
            "raw data": 8 * samples,
            "image": focusing,
        },
        seconds={
            **_trace_seconds(sampling, layers, rays, finer, keys),
            "synthesise": samples * TWO_CORES.sample,
            "focus": focus,
        },
        ray_spacing=sampling.spacings.coherent,
    )


def _trace_seconds(
    sampling: SamplingPlan, layers: LayerPlan, rays: tuple[int, ...], finer: tuple[int, ...], keys: int
) -> dict[str, float]:
    """Seconds by stage on two usual cores for so many key pulses, ``finer`` of the ``rays`` over small parts."""
    scatterers, few = len(layers.subsets) * scatterers_met(sampling), sum(finer)
    each = sum(rays) * TWO_CORES.ray + few * TWO_CORES.finer_ray
    each += len(rays) * TWO_CORES.launch + scatterers * TWO_CORES.scatterer
    layout = {"launch grid": few * TWO_CORES.node} if few else {}
    return layout | {"trace": keys * each}


def lattice_rays(sampling: SamplingPlan, layers: LayerPlan) -> tuple[int, ...]:
    """Rays of every plain lattice of one key pulse, all subsets."""
    area = sampling.window.area
    return tuple(
        int(area / spacing**2) + 1 for subset in layers.subsets for _, spacing in sampling.purposes(subset)
    )


def finer_rays(sampling: SamplingPlan, layers: LayerPlan, trace_scene: TraceScene | None) -> tuple[int, ...]:
    """Rays that the finer lattices over small parts of a scene add to each of :func:`lattice_rays`."""
    wanted = [each for subset in layers.subsets for each in sampling.purposes(subset)]
    if trace_scene is None:
        return (0,) * len(wanted)
    known = {each: sampling.finer_rays(trace_scene, each[1], each[0]) for each in dict.fromkeys(wanted)}
    return tuple(known[each] for each in wanted)


def check_rays(name: str, sampling: SamplingPlan, layers: LayerPlan) -> None:
    """Refuse lattices that do not fit, where nothing else of a run is held.

    Raises
    ------
    ResourceError
        More memory is needed than there is.
    """
    rays, spacing = lattice_rays(sampling, layers), sampling.spacings.coherent
    remedy = (
        f"{sum(rays):.3g} rays, {spacing:.3g} m apart, take the most: check that the model is in metres (to_world), "
        "make the image smaller, or set ray_spacing"
    )
    check_fits(name, _ray_bytes(rays, max(rays)), remedy)


def copies() -> int:
    """Copies of an accumulator's grid: one for each thread that adds to it, and one for the caller's."""
    return int(dr.thread_count()) + 1


def _device_bytes(lanes: int, numbers: int) -> int:
    """Bytes of a launch, which Dr.Jit keeps for the next one."""
    return LANE * lanes + _grid_bytes(numbers)


def _grid_bytes(numbers: int) -> int:
    """Bytes of an accumulator's grid with its copies."""
    return 8 * numbers * (1 + copies())


def _ray_bytes(rays: tuple[int, ...], lanes: int) -> int:
    """Most bytes of lattices and lanes."""
    return RAY * sum(rays) + max(SORTED_RAY * max(rays), LANE * lanes)


def _tracing_bytes(rays: tuple[int, ...], lanes: int, numbers: int) -> int:
    """Most bytes while lattices are made and traced; ``numbers`` of the accumulator's grid."""
    kept = RAY * sum(rays)
    making = SORTED_RAY * max(rays) + NODE * min(SLAB_NODES, 4 * max(rays))
    return FIRST_USE + kept + max(making, _device_bytes(lanes, numbers) + 4 * numbers)


def _synthesis(sampling: SamplingPlan, layers: LayerPlan, most_rays: int) -> tuple[int, int, int]:
    """Numbers of the accumulator's grid, lanes of a launch, and bytes that synthesis adds."""
    radar, width = sampling.scene.radar, sampling.scene.settings.gridding_width
    n, slots, channels = sampling.key_pulse_interval, len(layers.orders), len(layers.channels)
    row = layers.per_subset * 2 * radar.window.n_samples * 2 * 16
    if n == 1:
        step = int(max(1, min(MAX_LANES // most_rays, MAX_GRID_BYTES // row, radar.track.n_pulses)))
        direct = plan_direct(radar, 0, step, sampling.phase_box, width, sampling.extra_slant_range)
        profiles = 8 * layers.per_subset * step * (radar.window.n_samples + 2 * direct.n_range)
        return grid_numbers(direct.shape(slots), channels), most_rays * step, profiles
    start = max(0, radar.track.center_index - n // 2)
    plan = plan_block(
        radar,
        start,
        min(start + n, radar.track.n_pulses),
        sampling.window.center,
        sampling.phase_box,
        width,
        extra_slant_range=sampling.extra_slant_range,
    )
    together = max(1, min(layers.per_subset, 2**24 // (plan.n_inner * max(plan.n_range_rate, n))))
    # spectrum of the grid, then profiles, their slope, both transforms and the samples
    profiles = 8 * together * plan.n_inner * (2 * plan.n_range_rate + 5 * n)
    return grid_numbers(plan.shape(slots), channels), most_rays, profiles


__all__ = ["Needs", "check_rays", "duration", "lattice_rays", "needs_of"]
