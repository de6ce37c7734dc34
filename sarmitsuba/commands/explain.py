"""Show a scene's effects with their reasons, and the predicted run time, before the run."""

import argparse
import dataclasses
import json

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of
from sarmitsuba.core.errors import ClusterError

NAME = "explain"
HELP = "show the effects plan of a scene, with predicted time and memory"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--method",
        choices=("raw", "hybrid", "image", "raster"),
        help="how to simulate (default: the scene's)",
    )
    parser.add_argument(
        "--no-error-bars", action="store_true", help="as for render: one set of rays instead of two"
    )
    depth = parser.add_mutually_exclusive_group()
    depth.add_argument(
        "--plan-only", action="store_true", help="show the plan without predicting time and memory"
    )
    depth.add_argument(
        "--measure",
        action="store_true",
        help="measure change and cost of every effect, and time on a part of the run; may take longer than the run",
    )
    depth.add_argument(
        "--quick",
        action="store_true",
        help="show the scene, its radar and image, and what was noted while loading; nothing is planned or traced",
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="also predict the time with N workers of a cluster, each like this machine (render --cluster)",
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace, console: Console) -> int:
    """Print the effects plan and the prediction."""
    if args.quick:
        return _quick(args, console)
    from sarmitsuba.machine.backend import ensure_backend
    from sarmitsuba.simulation.planning.prediction.prediction import explain

    if args.workers is not None and (args.workers < 1 or args.plan_only):
        raise ClusterError(
            f"explain: --workers {args.workers} needs a number of at least 1, and a prediction; leave --plan-only out"
        )
    ensure_backend()
    scene = scene_of(args)
    settings = scene.settings
    if args.method:
        settings = dataclasses.replace(settings, method=args.method)
    if args.no_error_bars:
        settings = dataclasses.replace(settings, keep_subsets=False)
    scene = dataclasses.replace(scene, settings=settings)
    if args.measure:
        console.busy("measuring every effect with and without it, and a part of the run")
    found = explain(scene, predicted=not args.plan_only, measured=args.measure)
    facts, text = found.as_dict(), str(found)
    if args.workers and found.prediction is not None:
        from sarmitsuba.apps.cluster import ClusterPlan

        plan = ClusterPlan.of(scene, found.prediction, args.workers)
        facts, text = {**facts, "cluster": plan.as_dict()}, f"{text}\n{plan}"
    console.say(json.dumps(facts, indent=2) if args.json else text)
    return 0


def _quick(args: argparse.Namespace, console: Console) -> int:
    """Print the summary of the scene; the simulation is not even imported."""
    if args.workers is not None:
        raise ClusterError("explain: --quick plans and predicts nothing; leave --workers out")
    from sarmitsuba.scene.summary import SceneSummary

    scene = scene_of(args)
    if args.method:
        scene = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, method=args.method))
    found = SceneSummary.of(scene)
    console.say(json.dumps(found.as_dict(), indent=2) if args.json else str(found))
    return 0
