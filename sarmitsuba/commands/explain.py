"""Show which effects a scene will be simulated with and why, and how long the run will take, before running it."""

import argparse
import dataclasses
import json
from pathlib import Path

from sarmitsuba.commands.console import Console

NAME = "explain"
HELP = "show the effects plan of a scene, with predicted time and memory"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (XML), or the name of a shipped scene")
    parser.add_argument(
        "--radar",
        metavar="RADAR",
        help="radar to use in place of the scene's own: an XML file or a shipped radar's name",
    )
    parser.add_argument(
        "-D",
        "--define",
        action="append",
        default=[],
        type=definition,
        metavar="NAME=VALUE",
        help="set a $NAME of the scene file, or a parameter such as sar_path.max_depth; may be repeated",
    )
    parser.add_argument(
        "--method",
        choices=("raw", "hybrid", "image", "raster"),
        help="how to simulate (default: the scene's)",
    )
    parser.add_argument(
        "--no-error-bars", action="store_true", help="as for render: one set of rays instead of two"
    )
    parser.add_argument(
        "--plan-only", action="store_true", help="show the plan without predicting time and memory"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace, console: Console) -> int:
    """Explain."""
    from sarmitsuba.backend import ensure_backend
    from sarmitsuba.loader.library import resolve_radar
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.simulation.prediction.explanation import explain

    ensure_backend()
    radar: Path | None = resolve_radar(args.radar) if args.radar else None
    scene = load_scene(args.scene, radar=radar, parameters=dict(args.define))
    settings = scene.settings
    if args.method:
        settings = dataclasses.replace(settings, method=args.method)
    if not args.no_error_bars:
        settings = dataclasses.replace(settings, keep_subsets=True)
    scene = dataclasses.replace(scene, settings=settings)
    found = explain(scene, predicted=not args.plan_only)
    console.say(json.dumps(found.as_dict(), indent=2) if args.json else str(found))
    return 0


def definition(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    return name, value


__all__ = ["HELP", "NAME", "add_arguments", "run"]
