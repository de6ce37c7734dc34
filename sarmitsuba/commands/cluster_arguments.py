"""The ``--cluster`` argument and the workers that it selects."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console

if TYPE_CHECKING:
    from sarmitsuba.apps.cluster import DaskWorkers
    from sarmitsuba.scene.settings import TraceSettings


def add_cluster_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--cluster``."""
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="share the work with the workers of a Dask cluster: local or local:N for N processes on this machine, or "
        "the address of a scheduler; the result has the same bits",
    )


def check_cluster_argument(args: argparse.Namespace) -> None:
    """Raise a ClusterError for an invalid address, before any other work."""
    if args.cluster:
        from sarmitsuba.apps.cluster import ClusterAddress

        ClusterAddress.parse(args.cluster)


@contextmanager
def open_workers(
    args: argparse.Namespace, console: Console, settings: "TraceSettings"
) -> "Iterator[DaskWorkers | None]":
    """Workers of the cluster in the arguments; None where none is named or the method cannot be distributed."""
    if not args.cluster:
        yield None
        return
    if settings.one_look:
        console.note(
            f"--cluster {args.cluster}: method {settings.method} takes one look, which this process makes alone; "
            "hybrid and raw are shared"
        )
        yield None
        return
    from sarmitsuba.apps.cluster import ClusterAddress
    from sarmitsuba.apps.cluster import open_workers as opened

    with opened(ClusterAddress.parse(args.cluster), getattr(args, "extension", ())) as workers:
        console.say(f"cluster {workers.name}: {workers.n_workers} workers")
        yield workers
