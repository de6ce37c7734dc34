r"""Predicted time, traffic and price of a run on a cluster."""

import dataclasses
import math
from dataclasses import dataclass

from sarmitsuba.machine.memory import in_bytes
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.pixel_tiles import TILE_PIXELS
from sarmitsuba.simulation.planning.prediction.needs import duration
from sarmitsuba.simulation.planning.prediction.prediction import Prediction

# start of a worker: interpreter, Mitsuba and its kernels from the cache, s (benchmarks/suite/scale.py)
START = 5.0
# network of the client, bytes/s: 1 Gbit/s
NETWORK = 1.25e8
# bytes of a pixel; of a triangle with its vertices and edges as they are pickled
PIXEL, TRIANGLE = 8, 200


@dataclass(frozen=True)
class ClusterPlan:
    r"""Predicted time, traffic and price of a run on a cluster, from the time on one worker.

    .. math:: T = T_0 + \frac{T_t \lceil n / W \rceil}{n} + \frac{T_f \lceil m / W \rceil}{m} + \frac{D}{B}

    with W workers, T_t the time of tracing in n batches and T_f that of focusing in m tiles on one worker, T_0 the time
    for start, geometry and kernels of each worker, and D bytes over the client's network of B bytes/s.

    Parameters
    ----------
    workers : W
    trace_seconds, focus_seconds : T_t, T_f of the whole run on one worker, s
    batches, tiles : n, m
    own_seconds : T_0
    raw_bytes : of the raw data: once to the client as they are traced, then to every worker to be focused
    image_bytes : of the image, to the client
    scene_bytes : of the scene, to every worker
    bytes_per_second : B
    price_per_hour : of one worker, any currency
    """

    workers: int
    trace_seconds: float
    focus_seconds: float
    batches: int
    tiles: int
    own_seconds: float
    raw_bytes: float
    image_bytes: float
    scene_bytes: float
    bytes_per_second: float
    price_per_hour: float

    @staticmethod
    def of(
        scene: Scene,
        prediction: Prediction,
        workers: int,
        *,
        bytes_per_second: float = NETWORK,
        price_per_hour: float = 0.0,
    ) -> "ClusterPlan":
        """Plan of a run from its predicted time on one worker.

        Notes
        -----
        Takes all key pulses and tiles to be equal; ignores that the client traces the two middle blocks while the
        workers wait, that one launch of method raw holds several pulses, and repeated tasks of failed workers.
        """
        seconds = dict(prediction.seconds)
        focus = seconds.pop("focus", 0.0)
        shared = seconds.pop("trace", 0.0) + seconds.pop("synthesise", 0.0)
        tiles = math.ceil(prediction.pixels / TILE_PIXELS)
        return ClusterPlan(
            workers=workers,
            trace_seconds=shared,
            focus_seconds=focus,
            batches=prediction.key_pulses * (2 if scene.settings.keep_subsets else 1),
            tiles=tiles if tiles > 1 else 0,
            own_seconds=START + sum(seconds.values()),
            raw_bytes=prediction.raw_bytes,
            image_bytes=PIXEL * prediction.pixels,
            scene_bytes=TRIANGLE * scene.geometry.n_faces,
            bytes_per_second=bytes_per_second,
            price_per_hour=price_per_hour,
        )

    @property
    def moved_bytes(self) -> float:
        """D: traffic over the client's network, bytes."""
        to_workers = self.workers * (self.scene_bytes + (self.raw_bytes if self.tiles else 0.0))
        return self.raw_bytes + self.image_bytes + to_workers

    @property
    def moving_seconds(self) -> float:
        """D / B: time of the traffic, s."""
        return self.moved_bytes / self.bytes_per_second

    @property
    def working_seconds(self) -> float:
        """T without the traffic, s."""
        return (
            self.own_seconds
            + self.trace_seconds * _share(self.batches, self.workers)
            + self.focus_seconds * _share(self.tiles, self.workers)
        )

    @property
    def seconds(self) -> float:
        """T."""
        return self.working_seconds + self.moving_seconds

    @property
    def worker_hours(self) -> float:
        """Worker hours from start to end."""
        return self.workers * self.seconds / 3600.0

    @property
    def price(self) -> float:
        """Price of the worker hours."""
        return self.worker_hours * self.price_per_hour

    @property
    def efficiency(self) -> float:
        """Share of the worker hours spent tracing and focusing."""
        return (self.trace_seconds + self.focus_seconds) / (self.workers * self.seconds)

    def as_dict(self) -> dict[str, float]:
        """Parameters and predictions as a dictionary for JSON."""
        found = ("moved_bytes", "moving_seconds", "seconds", "worker_hours", "price", "efficiency")
        return {**dataclasses.asdict(self), **{name: getattr(self, name) for name in found}}

    def __str__(self) -> str:
        """One line."""
        return (
            f"on {self.workers} workers like this machine: {duration(self.seconds)}, of which "
            f"{duration(self.moving_seconds)} for {in_bytes(round(self.moved_bytes))} of traffic at "
            f"{8e-9 * self.bytes_per_second:g} Gbit/s; "
            f"{self.worker_hours:.3g} worker hours, {100.0 * self.efficiency:.0f} % of them busy"
        )


def _share(parts: int, workers: int) -> float:
    """Share of the work of the busiest worker, in whole parts; 1 where this process does all of it (0 parts)."""
    return -(-parts // workers) / parts if parts else 1.0
