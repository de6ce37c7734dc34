"""Compute the link budget of a scene's radar before tracing: signal, noise, pulses, data volume, contradictions.

Exit status: 1 where the radar cannot work as described, with one line that says why; see docs/radar.md.
"""

import argparse
import json

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of
from sarmitsuba.core.constants import DEFAULT_WINDOW

NAME = "link"
HELP = "compute the link budget of a scene's radar (SNR, NESZ, PRF bounds, ambiguities, data volume) before tracing"
EXIT_IMPOSSIBLE = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--window",
        default=DEFAULT_WINDOW,
        metavar="NAME",
        help="window of the image, as for render (default: taylor)",
    )
    parser.add_argument(
        "--rcs",
        type=float,
        default=1.0,
        metavar="M2",
        help="radar cross section of the point whose SNR is given (default: 1 m^2)",
    )
    parser.add_argument(
        "--sigma0",
        type=float,
        default=-10.0,
        metavar="DB",
        help="sigma0 of the ground whose SNR is given (default: -10 dB)",
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace, console: Console) -> int:
    """Print the link budget."""
    from sarmitsuba.analysis.link_budget import link_budget
    from sarmitsuba.core.errors import RadarError
    from sarmitsuba.machine.backend import ensure_backend

    if not args.rcs > 0.0:
        raise RadarError(f"link: --rcs = {args.rcs:g} m^2 must be above 0")
    ensure_backend()
    budget = link_budget(
        scene_of(args),
        range_window=args.window,
        azimuth_window=args.window,
        rcs=args.rcs,
        sigma0_db=args.sigma0,
    )
    console.say(json.dumps(budget.as_dict(), indent=2) if args.json else str(budget))
    return EXIT_IMPOSSIBLE if budget.impossible else 0
