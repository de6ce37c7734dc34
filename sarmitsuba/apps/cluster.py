r"""Runs on a Dask cluster of local or remote workers: address, client, worker process, focusing, and predicted cost.

The client distributes tasks and collects results. A worker builds the scene once per run, and traces or focuses its
tasks; backprojection has one task per launch of pixels, and every worker holds all raw data.
"""

import dataclasses
import logging
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import partial
from tempfile import TemporaryDirectory
from typing import Generic, TypeVar
from uuid import uuid4

import numpy as np
from distributed import Worker, WorkerPlugin, get_worker

from sarmitsuba.core.errors import ClusterError
from sarmitsuba.core.registry import load_extension
from sarmitsuba.machine.backend import dr, ensure_backend
from sarmitsuba.machine.memory import format_bytes
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.focuser import Auto, Focused, Focuser, FocusTask, OptionValue
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection
from sarmitsuba.signal.focusing.pixel_tiles import TILE_PIXELS, Tiles
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.threads import n_threads
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer, Traced, TraceJob
from sarmitsuba.simulation.planning.prediction.needs import duration
from sarmitsuba.simulation.planning.prediction.prediction import Prediction
from sarmitsuba.version import __version__

# cores of a local worker if the number of workers is not given: more workers hold more copies of the scene, fewer
# lose more work when one fails
CORES_PER_WORKER = 4
LOCAL = "local"


@dataclass(frozen=True)
class ClusterAddress:
    """Address of the workers of a cluster.

    Parameters
    ----------
    scheduler : address of a Dask scheduler, such as ``tcp://10.0.0.1:8786``; empty: this machine
    workers : processes to start on this machine; 0 with a scheduler
    """

    scheduler: str
    workers: int

    @staticmethod
    def parse(text: str) -> "ClusterAddress":
        """Read ``local``, ``local:N`` or a scheduler's address (``HOST:PORT``, ``tcp://...``, ``tls://...``).

        Raises
        ------
        ClusterError
            The text has another form, or asks for more workers than there are cores.
        """
        word, colon, number = text.partition(":")
        if word == LOCAL and not colon:
            return ClusterAddress("", max(min(2, n_threads()), n_threads() // CORES_PER_WORKER))
        if word == LOCAL:
            if not number.isdecimal() or not 1 <= int(number) <= n_threads():
                raise ClusterError(
                    f"cluster {text}: number of workers {number or '(empty)'} is outside 1 to {n_threads()}, the cores "
                    "of this machine; give local, or local:N"
                )
            return ClusterAddress("", int(number))
        if not re.fullmatch(r"(?:[a-z]+://)?[^\s/]+:\d+", text):
            raise ClusterError(
                f"cluster {text}: not the address of a Dask scheduler; give HOST:PORT as `dask scheduler` prints it, "
                "or local"
            )
        return ClusterAddress(text, 0)

    @property
    def threads(self) -> int:
        """Cores of each worker on this machine."""
        return max(1, n_threads() // max(1, self.workers))


try:
    import dask
    from distributed import Client, KilledWorker, LocalCluster, as_completed
    from distributed.security import Security

except ImportError as error:
    raise ClusterError(
        f"a cluster needs Dask ({error}); pip install 'sarmitsuba[cluster]' here and on every worker"
    ) from None


LOOPBACK = "127.0.0.1"
# no status pages of scheduler and workers
_NO_PAGES: dict[str, list[str]] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}

# longest wait for the scheduler, and for the first worker, s
PATIENCE = 60.0

Tool = TypeVar("Tool")
Task = TypeVar("Task")
Result = TypeVar("Result")


class DaskWorkers:
    """Workers of a Dask cluster; see :class:`sarmitsuba.simulation.execution.tracing.Workers`.

    Parameters
    ----------
    client : connected to the cluster
    name : of the cluster, for messages
    extensions : the user's extension modules, which every worker loads too

    Notes
    -----
    The tasks of a worker that fails, and results not yet delivered, are repeated by other workers. Results do not
    depend on the worker if all processors are of one kind; between kinds they differ by rounding.
    """

    def __init__(self, client: Client, name: str, extensions: Sequence[str] = ()) -> None:
        self.client, self.name, self.extensions = client, name, tuple(extensions)
        self._check()

    @property
    def n_workers(self) -> int:
        """Present number of workers."""
        return len(self.client.nthreads())

    def trace(self, job: TraceJob, batches: Sequence[Batch]) -> Iterator[Traced]:
        """Trace batches, in order of completion; every worker builds the scene once.

        Raises
        ------
        ClusterError
            Workers fail on a batch repeatedly, or the scheduler does not answer any more.
        """
        return self.spread(job.tracer, BatchTracer.trace, batches)

    def spread(
        self, make: Callable[[], Tool], use: Callable[[Tool, Task], Result], tasks: Sequence[Task]
    ) -> Iterator[Result]:
        """Run tasks with a tool that every worker creates once; results in order of completion."""
        plugin = f"{SLOT}-{uuid4().hex}"
        tool = ToolPlugin(make, use, ensure_backend().variant, self.extensions)
        self.client.register_plugin(tool, name=plugin)
        futures = self.client.map(
            partial(run_task, plugin), tasks, key=plugin, pure=False, resources={SLOT: 1}
        )
        try:
            for future in as_completed(futures):
                yield future.result()
                future.release()
        except KilledWorker:
            raise ClusterError(
                f"cluster {self.name}: one task ended worker after worker; see the workers' logs; the usual cause is "
                "memory: give each more, or start fewer on a machine"
            ) from None
        except CancelledError:
            raise ClusterError(
                f"cluster {self.name}: its scheduler does not answer any more; start it again and repeat the command"
            ) from None
        finally:
            self.client.cancel(futures)
            self.client.unregister_worker_plugin(plugin)

    def _check(self) -> None:
        """Raise a ClusterError where there is no worker, or one with another version of sarmitsuba."""
        try:
            self.client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise ClusterError(
                f"cluster {self.name}: no worker within {PATIENCE:g} s; start some with `dask worker {self.name}`"
            ) from None
        try:
            versions = self.client.run(version)
        except ImportError as error:
            raise ClusterError(
                f"cluster {self.name}: a worker cannot import sarmitsuba ({error}); install it on every machine"
            ) from None
        for worker, found in versions.items():
            if found != __version__:
                raise ClusterError(
                    f"cluster {self.name}: worker {worker} has sarmitsuba {found}, this machine {__version__}; "
                    "install the same version everywhere"
                )


def _own_certificate() -> Security:
    """Key and certificate of this run; clients without them, including other users of this machine, are refused."""
    try:
        return Security.temporary()
    except ImportError:
        raise ClusterError(
            "a cluster on this machine needs the package cryptography, so that nobody else here can use it; "
            "pip install 'sarmitsuba[cluster]'"
        ) from None


@contextmanager
def open_workers(address: ClusterAddress, extensions: Sequence[str] = ()) -> Iterator[DaskWorkers]:
    """Context manager of the workers at an address; local ones are started here, and stopped at the end.

    Local workers listen on the loopback address alone, by TLS with a certificate made for the run, and keep their
    files in a folder that only this user may open. The security of a remote scheduler is up to its operator: anyone who
    reaches one without TLS can run any code in its workers, and in this process; keys for ``tls://HOST:PORT`` are those
    of Dask's configuration.

    Raises
    ------
    ClusterError
        The scheduler cannot be reached, or there is no worker, or one of another version.
    """
    if not address.scheduler:
        security = _own_certificate()
        # queues of Dask's processes have named semaphores; where a signal ends this process, Python's tracker removes
        # them, and would warn of each run's: it starts with the filters that stand here
        sys.warnoptions.append("ignore:resource_tracker:UserWarning")
        # workers import modules from their folder: a shared folder could hold modules of other users
        with (
            dask.config.set(_NO_PAGES),
            TemporaryDirectory(prefix="sarmitsuba-", ignore_cleanup_errors=True) as folder,
            LocalCluster(
                n_workers=address.workers,
                local_directory=folder,
                threads_per_worker=address.threads,
                host=LOOPBACK,
                protocol="tls://",
                security=security,
                dashboard_address=f"{LOOPBACK}:0",  # a server without a page; None would listen on all addresses
                worker_dashboard_address=None,
                silence_logs=logging.CRITICAL,
                memory_limit=0,  # Dr.Jit keeps freed memory: a worker holds more than it needs
            ) as cluster,
            Client(cluster, security=security) as client,
        ):
            yield DaskWorkers(client, f"local:{address.workers}", extensions)
        return
    try:
        client = Client(address.scheduler, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ClusterError(
            f"cluster {address.scheduler}: no scheduler answers ({reason}); start one with `dask scheduler`"
        ) from None
    with client:
        yield DaskWorkers(client, address.scheduler, extensions)


@dataclass(frozen=True)
class SharedBackprojection(Backprojection):
    """:class:`Backprojection` with the same pixels, distributed to workers where it takes more than one launch."""

    workers: "DaskWorkers | None" = field(default=None, repr=False)
    tile_pixels: int = field(default=TILE_PIXELS, repr=False)

    @property
    def options(self) -> dict[str, OptionValue]:
        """Options of the backprojection."""
        return {option.name: getattr(self, option.name) for option in fields(Backprojection)}

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        tiles = Tiles(
            task.raw,
            task.grid,
            task.range_window,
            task.azimuth_window,
            self.interpolation,
            self.oversampling,
            tile_pixels=self.tile_pixels,
        )
        count = sum(1 for _ in tiles.launches())
        if self.workers is None or count < 2:
            return super().focus(task)
        image = np.empty((len(task.raw.layers), int(np.prod(tiles.shape))), dtype=np.complex64)
        for done, tile in enumerate(self.workers.spread(partial(_same, tiles), Tiles.tile, range(count)), 1):
            image[tile.layers, tile.start : tile.stop] = tile.pixels
            task.progress("focus", float(done), float(count), {"workers": float(self.workers.n_workers)})
        pixels = image.reshape(len(task.raw.layers), *tiles.shape)
        return Focused(pixels, lambda point: matched_weights(task.raw.radar, point, task.azimuth_window))


@dataclass(frozen=True)
class SharedAuto(Auto):
    """:class:`Auto` whose choice is distributed to workers where it is backprojection."""

    workers: "DaskWorkers | None" = field(default=None, repr=False)

    @property
    def options(self) -> dict[str, OptionValue]:
        """Options of the choice."""
        return {"error": self.error}

    def resolved(
        self, radar: Radar, grid: ImageGrid, data_error_db: Callable[[], float] = lambda: math.nan
    ) -> tuple[Focuser, str]:
        """The focuser used, distributed to the workers, and why."""
        found, reason = super().resolved(radar, grid, data_error_db)
        return (distribute_focuser(found, self.workers) if self.workers else found), reason


def distribute_focuser(focuser: Focuser, workers: DaskWorkers) -> Focuser:
    """The focuser distributed to workers; itself where it is not backprojection."""
    if type(focuser) is Auto:
        return SharedAuto(focuser.error, workers)
    if type(focuser) is not Backprojection:
        return focuser
    return SharedBackprojection(focuser.interpolation, focuser.oversampling, workers)


def _same(tiles: Tiles) -> Tiles:
    return tiles


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
            f"{duration(self.moving_seconds)} for {format_bytes(round(self.moved_bytes))} of traffic at "
            f"{8e-9 * self.bytes_per_second:g} Gbit/s; "
            f"{self.worker_hours:.3g} worker hours, {100.0 * self.efficiency:.0f} % of them busy"
        )


def _share(parts: int, workers: int) -> float:
    """Share of the work of the busiest worker, in whole parts; 1 where this process does all of it (0 parts)."""
    return -(-parts // workers) / parts if parts else 1.0


# one per worker: a task uses all threads of its worker, which takes one task at a time
SLOT = "sarmitsuba"


class ToolPlugin(WorkerPlugin, Generic[Tool, Task, Result]):
    """Dask plugin that holds the tool of a run's tasks in every worker, also in workers that join later.

    Parameters
    ----------
    make : creates the tool in the worker, before its first task
    use : executes one task with the tool
    variant : of Mitsuba, that of the client
    extensions : the user's extension modules
    """

    def __init__(
        self,
        make: Callable[[], Tool],
        use: Callable[[Tool, Task], Result],
        variant: str,
        extensions: tuple[str, ...],
    ) -> None:
        self.make, self.use, self.variant, self.extensions = make, use, variant, extensions

    async def setup(self, worker: Worker) -> None:
        """Prepare a worker that joins."""
        self.tool: Tool | None = None
        self.threads, self.number = int(worker.state.nthreads), worker.name
        # Dr.Jit and Mitsuba keep their state per thread: one thread serves them
        self.thread = ThreadPoolExecutor(1)
        await worker.set_resources(**{SLOT: 1})

    def teardown(self, worker: Worker) -> None:
        """Release the tool when the worker leaves."""
        self.thread.shutdown(wait=False, cancel_futures=True)

    def run(self, task: Task) -> Result:
        """Execute one task; called in a worker."""
        return self.thread.submit(self._run, task).result()

    def _run(self, task: Task) -> Result:
        if self.tool is None:
            self._keep_to_own_cores()
            ensure_backend(self.variant)
            dr.set_thread_count(self.threads)
            for extension in self.extensions:
                load_extension(extension, again=False)
            self.tool = self.make()
        return self.use(self.tool, task)

    def _keep_to_own_cores(self) -> None:
        """Pin a numbered worker's threads to its own cores, where several run on one machine."""
        if isinstance(self.number, int) and hasattr(os, "sched_setaffinity"):
            cores = sorted(os.sched_getaffinity(0))
            own = cores[self.number * self.threads : (self.number + 1) * self.threads]
            if own:
                os.sched_setaffinity(0, own)


def run_task(plugin: str, task: object) -> object:
    """Execute one task with the plugin of that name, in a worker."""
    return get_worker().plugins[plugin].run(task)


def version() -> str:
    """Version of sarmitsuba in a worker."""
    return __version__
