"""Model of speed: seconds of a run from its work, with reference rates or with measured ones."""

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from sarmitsuba.machine.exclusive import threads
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan


@dataclass(frozen=True)
class Work:
    """Work of a run, by kind.

    Parameters
    ----------
    rays : number over all traced pulses
    launches : of tracing kernels
    kernels : different ones among them
    scatterers : diffuse ones hit at first bounces, over all traced pulses
    path_pulses : contributions times the pulses to which they are added
    samples : range-compressed samples that are synthesised, all layers
    syntheses : of pulses from a grid
    pixel_pulses : pixels of the image times pulses, all layers
    """

    rays: float = 0.0
    launches: float = 0.0
    kernels: float = 0.0
    scatterers: float = 0.0
    path_pulses: float = 0.0
    samples: float = 0.0
    syntheses: float = 0.0
    pixel_pulses: float = 0.0


@dataclass(frozen=True)
class SpeedModel:
    """Seconds per unit of work.

    Parameters
    ----------
    ray, launch, scatterer, path_pulse, sample, pixel_pulse : s for each
    kernel : s for recording a kernel for the first time and loading the compiled code
    synthesis, counted_sample : s for a synthesis and for a sample, where syntheses are counted
    finer_ray : additional s for a ray over small parts, which has more bounces
    slab_ray, water_ray, wide_ray : additional s for a ray of a scene with slabs that transmit, with moving water, or
        with a band traced at several frequencies (more terms of tube sides are computed)
    plain_node, node : s for laying out a ray of a plain lattice, and one over small parts, once for all pulses
    """

    ray: float
    launch: float
    scatterer: float
    path_pulse: float
    sample: float
    pixel_pulse: float
    finer_ray: float = 0.0
    slab_ray: float = 0.0
    water_ray: float = 0.0
    wide_ray: float = 0.0
    node: float = 0.0
    plain_node: float = 0.0
    kernel: float = 0.0
    synthesis: float = 0.0
    counted_sample: float = 0.0

    @staticmethod
    def measured(work: Work, seconds: Mapping[str, float]) -> "SpeedModel":
        """Model from a part of a run: its work, and its seconds by stage; tracing time is proportional to rays."""
        rates = {
            "ray": ("trace", work.rays),
            "sample": ("synthesise", work.samples),
            "pixel_pulse": ("focus", work.pixel_pulses),
        }
        each = {k: seconds.get(stage, 0.0) / done if done else 0.0 for k, (stage, done) in rates.items()}
        return SpeedModel(launch=0.0, scatterer=0.0, path_pulse=0.0, **each)

    def stages(self, work: Work) -> dict[str, float]:
        """Seconds by stage."""
        return {
            "trace": work.launches * self.launch
            + work.kernels * self.kernel
            + work.rays * self.ray
            + work.scatterers * self.scatterer
            + work.path_pulses * self.path_pulse,
            "synthesise": work.samples * (self.counted_sample if work.syntheses else self.sample)
            + work.syntheses * self.synthesis,
            "focus": work.pixel_pulses * self.pixel_pulse,
        }

    def seconds(self, work: Work) -> float:
        """Seconds of all stages."""
        return float(sum(self.stages(work).values()))


# processor seconds of a core of about 2.5 GHz: 5 million rays per second including their hits, as many diffuse
# scatterers including those of later bounces, 2 million samples; 400 million pixel-pulses, between backprojection
# without an antenna pattern and with one, for decisions before there is a focuser: forecasts take its `cpu_seconds`.
# A launch includes recording, setting up a block and reading its grid back; adding to the grid is included in rays and
# scatterers
USUAL_CORE = SpeedModel(
    ray=1 / 5e6,
    launch=9e-3,
    scatterer=1 / 5e6,
    path_pulse=0.0,
    sample=1 / 2e6,
    pixel_pulse=1 / 4e8,
    finer_ray=2e-7,
    slab_ray=1.1e-6,
    water_ray=3e-7,
    wide_ray=1.8e-7,
    node=1e-6,
    plain_node=1.2e-7,
    kernel=0.04,
    synthesis=8e-3,
    counted_sample=2.5e-7,
)
# number of faces whose tree and tables fit into the caches, and relative increase of a ray's time per doubling beyond
CACHED_FACES, PER_DOUBLING = 8192, 0.12
# stages that use all threads, and their approximate serial share
SHARED, ALONE = frozenset({"trace", "synthesise", "focus", "raster"}), 0.2
# size of the job by which a core is timed, and processor seconds that the reference core needs for it
JOB, JOB_SECONDS = 1 << 14, 0.9e-3
# rounds of it at a time, and times that a process does them: programs on the same core slow it by a third for tenths
# of a second, which a single measurement would include
ROUNDS, GLANCES = 6, 4
# cores that are timed at a time, at most
CORES = 4


@dataclass(frozen=True)
class Machine:
    """Speed of this machine relative to the reference core.

    Parameters
    ----------
    slowness : seconds of a core here over those of the reference core
    threads : number that trace and focus
    """

    slowness: float
    threads: int

    @staticmethod
    def here() -> "Machine":
        """Speed of this machine, timed by a NumPy job (sorting, phase factors); the least time so far counts."""
        if not _glanced:
            glance()
        return Machine(min(_glanced) / JOB_SECONDS, threads())

    def processor(self, seconds: Mapping[str, float]) -> dict[str, float]:
        """Processor seconds on this machine, of all threads, from seconds of the reference core."""
        return {stage: self.slowness * s for stage, s in seconds.items()}

    def elapsed(self, seconds: Mapping[str, float]) -> dict[str, float]:
        """Elapsed seconds on this machine without other load."""
        share = ALONE + (1.0 - ALONE) / self.threads
        return {
            stage: s * (share if stage in SHARED else 1.0) for stage, s in self.processor(seconds).items()
        }


# least processor seconds of the job, for each time it was run
_glanced: list[float] = []


def glance() -> None:
    """Time the cores for some milliseconds; called several times while a run is prepared.

    After ``GLANCES`` calls in a process it does nothing. Concurrent threads may time more often.
    """
    if len(_glanced) >= GLANCES:
        return
    phase = np.random.default_rng(0).random(JOB)

    def least(_core: int) -> float:
        taken = []
        for _ in range(ROUNDS):
            before = time.thread_time()
            np.exp(1j * phase).sum()
            phase[np.argsort(phase)].sum()
            taken.append(time.thread_time() - before)
        return min(taken)

    cores = min(CORES, threads())
    with ThreadPoolExecutor(cores) as pool:
        _glanced.append(min(pool.map(least, range(cores))))


def deep_tree(n_faces: int) -> float:
    """Factor on the seconds of tracing where the tree of the faces is too large for the caches."""
    return 1.0 + PER_DOUBLING * float(np.log2(max(n_faces / CACHED_FACES, 1.0)))


def expected_work(sampling: SamplingPlan) -> Work:
    """Estimated work of simulating and focusing a scene, with one ray subset and all bounce orders in one layer.

    Notes
    -----
    Ignores the finer lattices over small parts, which depend on the geometry on the device; their rays are bounded.
    """
    radar, image = sampling.scene.radar, sampling.scene.image
    n, channels = radar.track.n_pulses, len(radar.channels)
    cell = sampling.azimuth_cell * sampling.range_cell
    pixels = image.extent_azimuth * image.extent_range / max(cell, 1e-9) * 2.0
    keys = sampling.expected_key_pulses
    return Work(
        rays=sampling.rays_per_pulse * keys,
        scatterers=keys * scatterers_met(sampling),
        samples=n * radar.window.n_samples * channels,
        pixel_pulses=pixels * n * channels,
    )


def scatterers_met(sampling: SamplingPlan) -> float:
    """Estimated number of diffuse scatterers hit by the rays of one pulse at first bounces."""
    if not sampling.flags.diffuse:
        return 0.0
    surface = sampling.window.area / max(
        float(np.cos(sampling.window.incidence)), 0.2
    )  # visible area for level ground
    return surface / sampling.scatterer_cell**2


def run_seconds(sampling: SamplingPlan) -> float:
    """Estimated seconds of the reference core for simulating and focusing; basis of decisions on any machine."""
    return USUAL_CORE.seconds(expected_work(sampling))


def ray_share(statistics: TraceStatistics, subsets: int) -> float:
    """Share of the time of tracing that is proportional to the number of rays, on the reference core.

    The rest belongs to launches: one per key pulse and ray subset.
    """
    rays = USUAL_CORE.stages(Work(rays=statistics.rays))["trace"]
    launches = USUAL_CORE.stages(Work(launches=max(1, statistics.key_pulses) * subsets))["trace"]
    return rays / (rays + launches)


def split_trace(full: Mapping[str, float], sparse: Mapping[str, float], fewer: float) -> dict[str, float]:
    """Seconds by stage, with tracing split into a part proportional to launches and one proportional to rays.

    Parameters
    ----------
    full, sparse : of two runs that differ in their rays
    fewer : rays of ``full`` over those of ``sparse``
    """
    out = {k: v for k, v in full.items() if k != "trace"}
    seconds = full.get("trace", 0.0)
    rays = (seconds - sparse.get("trace", 0.0)) / (1.0 - 1.0 / fewer)
    out["rays"] = min(max(rays, 0.05 * seconds), seconds)
    out["launches"] = seconds - out["rays"]
    return out
