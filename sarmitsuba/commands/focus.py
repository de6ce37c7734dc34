"""Focus saved raw data into a calibrated complex image."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sarmitsuba.commands.console import Console
from sarmitsuba.timing import StageTimer

if TYPE_CHECKING:
    from sarmitsuba.echo.raw import RawData

NAME = "focus"
HELP = "focus saved raw data into an image"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("raw", metavar="RAW", help="raw data written by `render` (raw.h5)")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the results")
    parser.add_argument("--force", action="store_true", help="overwrite the results in OUT")
    add_focus_arguments(parser)


def add_focus_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say how to focus."""
    parser.add_argument(
        "--focuser",
        choices=("backprojection", "omega_k"),
        default="backprojection",
        help="backprojection (default) takes any track and grid; omega_k is faster, for straight uniform tracks and "
        "slant-range grids",
    )
    parser.add_argument(
        "--window",
        default="rectangular",
        metavar="WINDOW",
        help="window against sidelobes in range and azimuth: rectangular (default), hamming, taylor or kaiser, with "
        "parameters if wanted, e.g. taylor:4:-35",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Focus."""
    from sarmitsuba.commands import results
    from sarmitsuba.io import read_raw

    watch = StageTimer()
    with results.output_folder(args.output, force=args.force) as folder:
        with watch.stage("read raw"):
            raw = read_raw(args.raw)
        results.clear_results(folder, keep=Path(args.raw))
        facts: dict[str, Any] = {
            "command": "focus",
            "raw_file": args.raw,
            "versions": results.versions(),
            "radar": results.radar_facts(raw.radar),
            "raw_domain": raw.domain,
            "simulation": raw.metadata,
        }
        picture = focus_into(folder, raw, args, console, watch, facts)
        facts["warnings"] = console.warnings
        facts["seconds"] = {**watch.seconds, "total": watch.total}
        results.save_facts(folder, facts)
        console.say(f"{picture} ({watch.total:.1f} s)")
    return 0


def focus_into(
    folder: Path,
    raw: "RawData",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    facts: dict[str, Any],
) -> Path:
    """Focus, write the image and its pictures into the folder, add to the facts. Return the picture's path."""
    from sarmitsuba.commands import results
    from sarmitsuba.focusing import focus

    with watch.stage("focus"):
        image = focus(
            raw,
            method=args.focuser,
            range_window=args.window,
            azimuth_window=args.window,
            progress=console.progress,
        )
    facts["focus"] = {"method": args.focuser, "window": args.window}
    return results.store_image(folder, image, watch, facts, console)


__all__ = ["HELP", "NAME", "add_arguments", "add_focus_arguments", "focus_into", "run"]
