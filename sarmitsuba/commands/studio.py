"""Open a scene in the studio: a web page with sliders that simulates the scene again at every change."""

import argparse
from pathlib import Path

from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import SarmitsubaError

NAME = "studio"
HELP = "a live page with sliders for look angle, heading, mode, band, resolution, bounces, materials and size"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        default="tower",
        help="scene file (XML) or the name of a shipped scene (default: tower)",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        help="folder for saved results (default: studio_ and the scene's name)",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="loopback address to serve at: 127.0.0.1 (default), ::1 or localhost; from another machine use ssh -L",
    )
    parser.add_argument("--port", type=int, default=8080, help="(default: 8080, or the next free port)")


def run(args: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C."""
    from sarmitsuba.machine.atomic import removed_if_stopped
    from sarmitsuba.machine.backend import ensure_backend
    from sarmitsuba.machine.output import output_folder

    if not 1 <= args.port <= 65535:
        raise SarmitsubaError(f"studio: --port {args.port} is not from 1 to 65535")
    try:
        from sarmitsuba.apps.studio import Studio
    except ImportError as error:
        raise SarmitsubaError(
            f"studio: {error.name} is missing; install it with pip install sarmitsuba[studio]"
        ) from None
    with output_folder(args.output or f"studio_{Path(args.scene).stem}") as folder:
        ensure_backend()
        studio = Studio(args.scene, folder.path, args.host, args.port)
        console.say(f"{studio.address}  (Ctrl-C ends it)")
        try:
            with removed_if_stopped(studio.discard):
                studio.serve()
        finally:
            studio.close()
    return 0
