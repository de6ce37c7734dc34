"""Counts of the rays, bytes and seconds of a run, from its sampling plan, before anything is allocated."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sarmitsuba.machine.exclusive import threads
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.block import plan_block
from sarmitsuba.signal.chirp import n_fast_chirped
from sarmitsuba.signal.direct import plan_direct
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import (
    DEFAULT,
    PIXEL,
    Focuser,
    focusing_bytes,
    look_bytes,
    parse_focuser,
)
from sarmitsuba.signal.focusing.look import look_size
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.execution.layers import LayerPlan
from sarmitsuba.simulation.execution.tracing import MAX_GRID_BYTES, MAX_LANES
from sarmitsuba.simulation.planning.prediction.needs import Needs
from sarmitsuba.simulation.planning.prediction.speed import (
    USUAL_CORE,
    Machine,
    Work,
    deep_tree,
    scatterers_met,
)
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.kernel.accumulators import grid_numbers
from sarmitsuba.tracing.kernel.launch import Purpose
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.scatterers.sources import Expected, expected_sources

# bytes of one ray: coordinates; and while its lattice is sorted, twice these, a key and an index
RAY, SORTED_RAY = 8, 28
# bytes of one lane of a launch: coordinates, level, counts and powers lost, and their sums' float64 copies
LANE = 52
# bytes of a node of the square about the window from which a lattice is cut, and of its strips, at most
NODE, SLAB_NODES = 40, 4_000_000
# bytes that compiled kernels, transforms and the pages of libraries take at first use
FIRST_USE = 8_000_000
# time of a launch of a source relative to one of a lattice: each has its own kernel to record
SOURCE_LAUNCHES = 2.0
# bytes of a raster's pixel: its blur, and each channel's planes and transforms
RASTER_PIXEL, RASTER_PLANE = 16, 60
# time of a raster's sample relative to a ray, and seconds of a pixel that is formed by transforms
RASTER_SHARE, FORMED_PIXEL = 0.1, 2.1e-7
# seconds of a run of any size: lattices, sources, the first transforms; and of an ideal point's pulse
SETUP, FIRST_FOCUS, POINT_PULSE = 0.07, 0.04, 1e-7
# seconds of a sample's noise
NOISE_SAMPLE = 8e-8
# of a chirped sample through the receive chain, two passes
RECEIVED_SAMPLE = 3e-7
# seconds of the first finer lattice of a process over those of the next
FIRST_LAID = 0.2
# share of a run's rays and contributions that one witness may take, and rays that the one of the rays may take in short
# runs; a run has three (sarmitsuba.simulation.execution.witnesses)
WITNESS_SHARE, WITNESS_LEAST, WITNESSES = 0.016, 3e5, 3
# seconds for the scattering table of a rough material at another frequency
TABLES = 0.04


def needs_of(
    scene: Scene,
    sampling: SamplingPlan | None,
    layers: LayerPlan,
    grid: ImageGrid | None = None,
    trace_scene: TraceScene | None = None,
    sub_bands: int = 1,
    measured: Mapping[str, object] | None = None,
) -> Needs:
    """Rays, bytes and seconds that a run needs.

    Parameters
    ----------
    scene, sampling : with the effects plan applied; no sampling without a mesh
    layers : channels, orders and subsets kept separately
    grid : pixels; default: those of the scene; one pulse gives no image
    trace_scene : traced geometry; None: finer lattices over its small parts, and pairs, are left out
    sub_bands : number of frequencies that the band is traced at
    measured : measurements of kinds of sources, by name

    Notes
    -----
    Ignores passes beyond the first (:attr:`Needs.of_passes` adds their data), copies of the raw data in other domains,
    compilation of kernels (once per machine), and blocks of pulses that have to be shortened during tracing.
    """
    tracing = None
    if sampling is not None:
        if scene.settings.method == "image":
            sampling = sampling.of_one_look()
        tracing = _TracingCost.of(sampling, layers, trace_scene, sub_bands, measured)
    method = scene.settings.method
    if method not in ("image", "raster") and grid is None and scene.radar.track.n_pulses < 2:
        return _count_raw(scene, tracing, layers, None)
    grid = grid or default_grid(scene.radar, scene.image)
    return {"raster": _count_raster, "image": _count_image}.get(method, _count_raw)(
        scene, tracing, layers, grid
    )


@dataclass(frozen=True)
class _TracingCost:
    """Rays, bytes and seconds of the tracing, for any method.

    Parameters
    ----------
    sampling, layers : of the run
    rays, finer : number of rays of every lattice of one key pulse; of these, rays over small parts
    laying : s of a reference core, for laying out the lattices
    sources : scatterers at known positions
    sub_bands : number of frequencies that the band is traced at
    """

    sampling: SamplingPlan
    layers: LayerPlan
    rays: tuple[int, ...]
    finer: tuple[int, ...]
    laying: float
    sources: tuple[Expected, ...]
    sub_bands: int

    @staticmethod
    def of(
        sampling: SamplingPlan,
        layers: LayerPlan,
        trace_scene: TraceScene | None,
        sub_bands: int,
        measured: Mapping[str, object] | None,
    ) -> "_TracingCost":
        """Count rays and sources; the time of finer lattices is estimated from sparse ones laid out here."""
        plain, before = lattice_rays(sampling, layers), time.process_time()
        finer = finer_rays(sampling, layers, trace_scene)
        sparse = (time.process_time() - before) / Machine.here().slowness - FIRST_LAID if any(finer) else 0.0
        wanted = _purposes(sampling, layers)
        laying = max(sparse, 0.0) * len(wanted) / len(set(wanted)) + sum(finer) * USUAL_CORE.node
        return _TracingCost(
            sampling,
            layers,
            tuple(map(sum, zip(plain, finer, strict=True))),
            finer,
            laying + sum(plain) * USUAL_CORE.plain_node,
            expected_sources(RunSite(sampling, None, trace_scene, measured), sub_bands),
            sub_bands,
        )

    @property
    def making(self) -> float:
        """Peak bytes while lattices and sources are laid out, in addition to the rays that are kept."""
        window = self.sampling.window
        reach = 2.0 * float(np.hypot(window.half_x + window.taper, window.half_y + window.taper))
        nodes = max(reach / spacing for _, spacing in _purposes(self.sampling, self.layers)) ** 2
        lattice = SORTED_RAY * max(self.rays) + NODE * min(SLAB_NODES, nodes)
        return max(lattice, *(source.bytes for source in self.sources), 0.0)

    @property
    def source_bytes(self) -> int:
        """Bytes of the sources; the device keeps the memory used to lay them out."""
        return int(sum(source.bytes for source in self.sources))

    def seconds(self, keys: int, launches: int) -> dict[str, float]:
        """Seconds by stage for ``keys`` key pulses, in ``launches`` launches of each lattice and source."""
        subsets, flags = len(self.layers.subsets), self.sampling.flags
        rays, traced = float(sum(self.rays)), subsets * self.sub_bands * keys
        kinds = len({purpose for purpose, _ in _purposes(self.sampling, self.layers)}) + len(self.sources)
        work = Work(
            rays=self.sub_bands * keys * rays,
            launches=self.sub_bands
            * launches
            * (len(self.rays) + subsets * SOURCE_LAUNCHES * len(self.sources)),
            kernels=kinds,
            scatterers=traced * scatterers_met(self.sampling),
        )
        trace = USUAL_CORE.stages(work)["trace"]
        more = USUAL_CORE.slab_ray * flags.transmission + USUAL_CORE.water_ray * flags.water_motion
        more += USUAL_CORE.wide_ray * (self.sub_bands > 1)
        trace += self.sub_bands * keys * (USUAL_CORE.finer_ray * sum(self.finer) + more * rays)
        trace *= deep_tree(self.sampling.scene.geometry.n_faces)
        trace += traced * sum(source.scatterers * source.each for source in self.sources)
        if flags.motion:  # finer lattices over moving shapes are laid out for every key pulse
            trace += keys * self.laying * any(self.finer)
        laying = SETUP + self.laying + sum(source.making for source in self.sources)
        if self.sub_bands > 1:  # scattering tables of rough surfaces at each frequency
            rough = sum(material.scatters for material in list_with_parts(self.sampling.scene.materials))
            laying += self.sub_bands * rough * TABLES
        return {"launch grid": laying, "trace": trace}


def _count_raster(scene: Scene, tracing: _TracingCost | None, layers: LayerPlan, grid: ImageGrid) -> Needs:
    pixels, n_channels = int(np.prod(grid.shape)), len(layers.channels)
    screen = 0
    if tracing is not None:
        sampling = tracing.sampling
        screen = int(sampling.window.area / (0.5 * min(sampling.range_cell, sampling.azimuth_cell)) ** 2)
    forming = pixels * (RASTER_PIXEL + RASTER_PLANE * n_channels)
    seconds = RASTER_SHARE * screen * USUAL_CORE.ray + pixels * n_channels * FORMED_PIXEL
    return Needs(
        name=scene.name,
        method="raster",
        rays=screen,
        image_shape=grid.shape,
        pixel_spacing=(grid.azimuth_spacing, grid.range_spacing),
        layers=n_channels,
        stages={"image": FIRST_USE + forming},
        parts={"image": forming},
        seconds={"raster": SETUP + USUAL_CORE.kernel + seconds},
        kept=FIRST_USE + forming,
    )


def _count_image(scene: Scene, tracing: _TracingCost | None, layers: LayerPlan, grid: ImageGrid) -> Needs:
    n_layers = len(layers.layers)
    rays: tuple[int, ...] = (0,)
    rows, columns, looks = look_size(scene.radar, grid)
    numbers = grid_numbers((len(layers.orders), rows, columns), len(layers.channels))
    seconds = {"form image": SETUP + float(np.prod(grid.shape)) * n_layers * FORMED_PIXEL}
    if tracing is not None:
        rays = tracing.rays
        each = max(1, min(looks, MAX_LANES // max(rays)))
        seconds = tracing.seconds(looks, -(-looks // each)) | seconds
    lanes = max(rays) * max(1, min(looks, MAX_LANES // max(max(rays), 1)))
    forming = look_bytes(grid, n_layers, rows * columns)
    held, sources = RAY * sum(rays) + _device_bytes(lanes, numbers), tracing.source_bytes if tracing else 0
    stages = {"image": FIRST_USE + held + forming}
    if tracing is not None:
        stages = {
            "launch grid": int(RAY * sum(rays) + tracing.making),
            "trace": FIRST_USE + max(held + 4 * numbers, sources) + forming,
            **stages,
        }
    return Needs(
        name=scene.name,
        method="image",
        rays=(tracing.sub_bands if tracing else 1) * looks * sum(rays),
        key_pulses=looks,
        image_shape=grid.shape,
        pixel_spacing=(grid.azimuth_spacing, grid.range_spacing),
        layers=n_layers,
        stages=stages,
        parts={
            "rays": _ray_bytes(rays, lanes),
            "sources": sources,
            "grids": _grid_bytes(numbers),
            "image": forming,
        },
        seconds=seconds,
        ray_spacing=tracing.sampling.spacings.coherent if tracing else 0.0,
        kept=FIRST_USE + held + forming,
    )


def _count_raw(
    scene: Scene, tracing: _TracingCost | None, layers: LayerPlan, grid: ImageGrid | None
) -> Needs:
    radar, n_layers = scene.radar, len(layers.layers)
    n_pulses = radar.track.n_pulses
    samples = n_layers * n_pulses * radar.window.n_samples
    focuser = default_focuser(radar, grid, tracing is None) if grid else None
    focusing = (
        focusing_bytes(grid, n_layers, focuser.making_bytes(radar, grid, n_layers)) if grid and focuser else 0
    )
    shape = grid.shape if grid else (0, 0)
    spacing = (grid.azimuth_spacing, grid.range_spacing) if grid else (1.0, 1.0)
    image = PIXEL * int(np.prod(shape)) * n_layers
    after = {}
    if scene.points:
        after["points"] = SETUP + len(scene.points) * n_pulses * n_layers * POINT_PULSE
    if radar.noise_temperature > 0.0:
        after["noise"] = samples * NOISE_SAMPLE
    if radar.received:
        after["noise"] = (
            after.get("noise", 0.0) + n_layers * n_pulses * n_fast_chirped(radar) * RECEIVED_SAMPLE
        )
        focusing = max(focusing, 3 * 8 * samples)
    if grid and focuser:
        after["focus"] = FIRST_FOCUS + n_layers * focuser.cpu_seconds(radar.start_stop(), grid)
    if tracing is None:
        return Needs(
            name=scene.name,
            method=scene.settings.method,
            rays=0,
            key_pulses=0,
            raw_bytes=8 * samples,
            image_shape=shape,
            pixel_spacing=spacing,
            layers=n_layers,
            stages={"image": FIRST_USE + 8 * samples + focusing},
            parts={"raw data": 8 * samples, "image": focusing},
            seconds=after,
            kept=FIRST_USE + 8 * samples + image,
            n_pulses=n_pulses,
        )
    sampling, rays = tracing.sampling, tracing.rays
    interval = sampling.key_pulse_interval
    keys = n_pulses if interval == 1 else -(-n_pulses // interval)
    numbers, lanes, synthesis = _synthesis(sampling, layers, max(rays))
    launches = -(-keys * max(rays) // lanes) if interval == 1 else keys
    work = Work(samples=samples, syntheses=tracing.sub_bands * launches * len(layers.subsets))
    device = RAY * sum(rays) + _device_bytes(lanes, numbers)
    held = FIRST_USE + 8 * samples + device
    return Needs(
        name=scene.name,
        method=scene.settings.method,
        rays=tracing.sub_bands * keys * sum(rays),
        key_pulses=keys,
        key_pulse_interval=interval,
        raw_bytes=8 * samples,
        image_shape=shape,
        pixel_spacing=spacing,
        layers=n_layers,
        stages={
            "launch grid": int(RAY * sum(rays) + tracing.making + 8 * samples),
            "trace": held + max(4 * numbers + synthesis, tracing.source_bytes - device),
            "image": held + focusing,
        },
        parts={
            "rays": _ray_bytes(rays, lanes),
            "sources": tracing.source_bytes,
            "grids": _grid_bytes(numbers) + synthesis,
            "raw data": 8 * samples,
            "image": focusing,
        },
        seconds={
            **(traced := tracing.seconds(keys, launches)),
            "witnesses": _witness_seconds(traced["trace"], len(layers.subsets)),
            "synthesise": USUAL_CORE.stages(work)["synthesise"],
            **after,
        },
        ray_spacing=sampling.spacings.coherent,
        kept=held + image,
        n_pulses=n_pulses,
    )


def _witness_seconds(trace: float, subsets: int) -> float:
    """Seconds of the witnesses of a run whose tracing takes so long."""
    return max(WITNESSES * WITNESS_SHARE * trace, WITNESS_LEAST * USUAL_CORE.ray * (subsets > 1))


def default_focuser(radar: Radar, grid: ImageGrid, exact: bool) -> Focuser:
    """The focuser that a run takes where none is named; ``exact``: its echoes are those of ideal points."""
    radar = radar.as_recorded().start_stop()
    return parse_focuser(DEFAULT).resolved(radar, grid, lambda: -math.inf if exact else math.nan)[0]


def _purposes(sampling: SamplingPlan, layers: LayerPlan) -> list[tuple[Purpose, float]]:
    """Kind of return and ray spacing, m, of each lattice of a key pulse; all subsets."""
    return [each for subset in layers.subsets for each in sampling.purposes(subset)]


def lattice_rays(sampling: SamplingPlan, layers: LayerPlan) -> tuple[int, ...]:
    """Number of rays of every plain lattice of one key pulse, all subsets."""
    area = sampling.window.area
    return tuple(int(area / spacing**2) + 1 for _, spacing in _purposes(sampling, layers))


def finer_rays(sampling: SamplingPlan, layers: LayerPlan, trace_scene: TraceScene | None) -> tuple[int, ...]:
    """Number of rays that finer lattices over small parts add to each lattice of :func:`lattice_rays`."""
    wanted = _purposes(sampling, layers)
    if trace_scene is None:
        return (0,) * len(wanted)
    known = {each: sampling.finer_rays(trace_scene, each[1], each[0]) for each in dict.fromkeys(wanted)}
    return tuple(known[each] for each in wanted)


def check_rays(name: str, sampling: SamplingPlan, layers: LayerPlan) -> None:
    """Raise an error if the lattices alone do not fit into memory.

    Raises
    ------
    ResourceError
        More memory is needed than there is.
    """
    rays, spacing = lattice_rays(sampling, layers), sampling.spacings.coherent
    remedy = (
        f"{sum(rays):.3g} rays, {spacing:.3g} m apart, need the most: check that the model is in metres (to_world), "
        "make the image smaller, or set ray_spacing"
    )
    check_fits(name, _ray_bytes(rays, max(rays)), remedy)


def copies() -> int:
    """Number of copies of an accumulator's grid: one for each thread that adds to it, and one for the caller."""
    return threads() + 1


def _device_bytes(lanes: int, numbers: int) -> int:
    """Bytes of a launch; Dr.Jit keeps them for the next one."""
    return LANE * lanes + _grid_bytes(numbers)


def _grid_bytes(numbers: int) -> int:
    """Bytes of an accumulator's grid with its copies."""
    return 8 * numbers * (1 + copies())


def _ray_bytes(rays: tuple[int, ...], lanes: int) -> int:
    """Peak bytes of lattices and lanes."""
    return RAY * sum(rays) + max(SORTED_RAY * max(rays), LANE * lanes)


def _synthesis(sampling: SamplingPlan, layers: LayerPlan, most_rays: int) -> tuple[int, int, int]:
    """Numbers in the accumulator's grid, lanes of a launch, and additional bytes of the synthesis."""
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
