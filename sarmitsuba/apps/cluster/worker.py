"""Worker process of a cluster: builds the scene once per run, and traces or focuses its tasks."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

from distributed import Worker, WorkerPlugin, get_worker

from sarmitsuba.core.registry import load_extension
from sarmitsuba.machine.backend import dr, ensure_backend
from sarmitsuba.version import __version__

# one per worker: a task uses all threads of its worker, which takes one task at a time
SLOT = "sarmitsuba"

Tool = TypeVar("Tool")
Task = TypeVar("Task")
Result = TypeVar("Result")


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
