"""One model of speed: seconds of a run from what there is to do, with usual rates or with measured ones."""

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from sarmitsuba.backend import dr
from sarmitsuba.simulation.sampling.density_plan import SamplingPlan


@dataclass(frozen=True)
class Work:
    """What takes the time of a run.

    Parameters
    ----------
    rays : of all pulses traced
    launches : of kernels that trace
    kernels : different ones among them
    scatterers : diffuse ones met at first bounces, of all pulses traced
    path_pulses : contributions times the pulses they go to
    samples : range-compressed samples that are synthesised, all layers
    syntheses : times that a grid becomes pulses
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
    kernel : s for recording a kernel for the first time and loading what was compiled
    synthesis, counted_sample : s for a synthesis and for a sample, where syntheses are counted
    finer_ray : s more for a ray over small parts: it hits, and bounces among what is slender or round
    slab_ray, water_ray, wide_ray : s more for a ray of a scene whose slabs let waves through, whose water moves, or
        whose band is traced at several frequencies: facets keep more of their sides apart
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
        """From a part of a run: its work, and its seconds by stage; tracing goes by rays alone."""
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


# processor seconds of a core of 2.5 GHz or so: 5 million rays per second with all that a hit does, as many diffuse
# scatterers with those of later bounces, 2 million samples, 400 million pixel-pulses. The launch is what recording,
# laying out a block and reading its grid back take; adding to the grid is in the rays and scatterers
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
# faces whose tree and tables a core's caches hold, and what a ray takes more for each doubling beyond
CACHED_FACES, PER_DOUBLING = 8192, 0.12
# stages that all threads share, and about the part of them that one thread does alone
SHARED, ALONE = frozenset({"trace", "synthesise", "focus", "raster"}), 0.2
# numbers of the job that a core is timed by, and processor seconds that it takes the usual core
JOB, JOB_SECONDS = 1 << 14, 0.9e-3
# rounds of it at a time, and times that a process does them: neighbours that share a core's units slow it by a third
# for tenths of a second, so that one time would tell of them
ROUNDS, GLANCES = 6, 4
# cores that are timed at a time, at most
CORES = 4


@dataclass(frozen=True)
class Machine:
    """What turns processor seconds of the usual core into seconds here.

    Parameters
    ----------
    slowness : seconds of a core here over those of the usual one
    threads : that trace and focus
    """

    slowness: float
    threads: int

    @staticmethod
    def here() -> "Machine":
        """Machine that runs this: NumPy sorts numbers and turns phases, the least of what was timed so far counts."""
        if not _glanced:
            glance()
        return Machine(min(_glanced) / JOB_SECONDS, max(1, int(dr.thread_count())))

    def processor(self, seconds: Mapping[str, float]) -> dict[str, float]:
        """Processor seconds here, of all threads, of stages that take the usual core so long."""
        return {stage: self.slowness * s for stage, s in seconds.items()}

    def elapsed(self, seconds: Mapping[str, float]) -> dict[str, float]:
        """Seconds by the clock on the wall, where no other program wants the cores."""
        share = ALONE + (1.0 - ALONE) / self.threads
        return {
            stage: s * (share if stage in SHARED else 1.0) for stage, s in self.processor(seconds).items()
        }


# least processor seconds of the job, each time that it was done
_glanced: list[float] = []


def glance() -> None:
    """Time the cores, for some milliseconds; what a run that is being prepared does at several moments of it.

    After ``GLANCES`` times in a process it does nothing. Several threads at once time more often, no harm.
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

    cores = min(CORES, max(1, int(dr.thread_count())))
    with ThreadPoolExecutor(cores) as pool:
        _glanced.append(min(pool.map(least, range(cores))))


def deep_tree(n_faces: int) -> float:
    """Factor on the seconds of tracing where the tree of the faces is too large for the caches."""
    return 1.0 + PER_DOUBLING * float(np.log2(max(n_faces / CACHED_FACES, 1.0)))


def expected_work(sampling: SamplingPlan) -> Work:
    """About what simulating and focusing a scene takes, one ray subset and all bounce orders in one layer.

    Notes
    -----
    Ignores the finer lattices over small parts, which the geometry on the device decides; their rays are bounded.
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
    """About as many diffuse scatterers as the rays of one pulse meet at first bounces."""
    if not sampling.flags.diffuse:
        return 0.0
    surface = sampling.window.area / max(float(np.cos(sampling.window.incidence)), 0.2)  # seen, were it level
    return surface / sampling.scatterer_cell**2


def run_seconds(sampling: SamplingPlan) -> float:
    """About what simulating and focusing takes the usual core, s; what decisions go by on any machine."""
    return USUAL_CORE.seconds(expected_work(sampling))


def split_trace(full: Mapping[str, float], sparse: Mapping[str, float], fewer: float) -> dict[str, float]:
    """Seconds by stage, tracing split into what goes by launches and what goes by rays.

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


__all__ = [
    "USUAL_CORE",
    "Machine",
    "SpeedModel",
    "Work",
    "deep_tree",
    "expected_work",
    "glance",
    "run_seconds",
    "scatterers_met",
    "split_trace",
]
