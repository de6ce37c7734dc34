"""Make a data set of drawn scenes with labels from a recipe: images, COCO annotations and a data card."""

import argparse
import os
from contextlib import nullcontext

from sarmitsuba.commands.cluster_arguments import add_cluster_argument, check_cluster_argument
from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import SarmitsubaError

NAME = "dataset"
HELP = "many labelled images of drawn scenes, from a recipe"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recipe", metavar="RECIPE", help="recipe (TOML or JSON) or the name of a shipped one")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the data set")
    parser.add_argument(
        "--sample",
        type=int,
        action="append",
        metavar="N",
        help="make this sample alone, with the bits that it has in the whole; may be given several times",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=0,
        metavar="N",
        help="processes (default: one for each processor); the result has the same bits",
    )
    add_cluster_argument(parser)
    parser.add_argument(
        "--force", action="store_true", help="replace the data set of another recipe in OUT; other files stay"
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Make or continue a data set."""
    if not 0 <= args.jobs <= 4096:
        raise SarmitsubaError(f"dataset: --jobs {args.jobs} is not from 0 to 4096")
    check_cluster_argument(args)
    from sarmitsuba.apps.dataset_draw import Drawer
    from sarmitsuba.apps.dataset_generate import DATASET_FILES, GenerationPlan, generate
    from sarmitsuba.machine.output import output_folder

    drawer = Drawer.of(args.recipe)
    recipe = drawer.recipe
    rows, columns = recipe.tile

    def ready(plan: GenerationPlan) -> None:
        console.say(
            f"{recipe.path.name}: {plan.samples} samples, {plan.rows} images of {rows} x {columns}, {plan.left} to "
            f"make; at least {plan.bytes_needed / 1e6:.3g} MB of disk"
        )

    with output_folder(args.output, DATASET_FILES) as folder, _workers(args) as workers:
        file = generate(
            drawer,
            folder,
            numbers=args.sample,
            processes=args.jobs or _processors(),
            workers=workers,
            extensions=getattr(args, "extension", ()),
            force=args.force,
            ready=ready,
            progress=console.progress,
        )
    console.say(f"wrote {file}, {file.stat().st_size / 1e6:.3g} MB")
    return 0


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _workers(args: argparse.Namespace):  # type: ignore[no-untyped-def]
    """Workers of the cluster in the arguments, None without."""
    if not args.cluster:
        return nullcontext()
    from sarmitsuba.apps.cluster import ClusterAddress, open_workers

    return open_workers(ClusterAddress.parse(args.cluster), getattr(args, "extension", ()))
