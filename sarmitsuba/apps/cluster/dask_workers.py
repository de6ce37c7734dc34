"""Client of a Dask cluster: starts or joins it, distributes tasks and collects results."""

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from tempfile import TemporaryDirectory
from typing import TypeVar
from uuid import uuid4

from sarmitsuba.apps.cluster.address import ClusterAddress
from sarmitsuba.core.errors import ClusterError
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.simulation.execution.batches import Batch, BatchTracer, Traced, TraceJob

try:
    import dask
    from distributed import Client, KilledWorker, LocalCluster, as_completed
    from distributed.security import Security

    from sarmitsuba.apps.cluster.worker import SLOT, ToolPlugin, run_task, version
except ImportError as error:
    raise ClusterError(
        f"a cluster needs Dask ({error}); pip install 'sarmitsuba[cluster]' here and on every worker"
    ) from None

from sarmitsuba.version import __version__

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
    """Workers of a Dask cluster; see :class:`sarmitsuba.simulation.execution.batches.Workers`.

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
