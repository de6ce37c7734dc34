"""Write a web page of a run: the scene in 3-D, the radar on its track, range profiles, the image and its ray paths."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console

if TYPE_CHECKING:
    from sarmitsuba.machine.output import OutputFolder
    from sarmitsuba.view.page.payload import Value

NAME = "view"
HELP = "write a web page that shows a run in 3-D"

PAGE = "page.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "folders",
        metavar="OUT",
        nargs="+",
        help="folders that `render` or `focus` wrote; further ones are shown beside the first: another mode, focuser, "
        "method, polarisation or date",
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="page to write (default: page.html in the first OUT)"
    )
    parser.add_argument("--force", action="store_true", help="replace FILE where it exists")
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="let the scene refer to files outside its own folder, as for render",
    )
    parser.add_argument("--channel", metavar="NAME", help="polarisation, such as HV (default: the first)")


def run(args: argparse.Namespace, console: Console) -> int:
    """Write the page."""
    from sarmitsuba.machine.output import OutputFile, OutputFolder

    folders = [Path(folder) for folder in args.folders]
    if args.output:
        file = OutputFile(args.output, force=args.force)
        payload = _payload(folders, args.channel, console, args.allow_outside)
        with file.writing() as target:
            _write(target, payload)
    else:
        target = view_folder(
            OutputFolder(folders[0]), console, folders[1:], args.channel, allow_outside=args.allow_outside
        )
    console.say(f"{target} ({target.stat().st_size / 1e6:.1f} MB; open it in a browser)")
    return 0


def view_folder(
    folder: "OutputFolder",
    console: Console,
    others: Sequence[Path] = (),
    channel: str | None = None,
    *,
    allow_outside: bool = False,
) -> Path:
    """Write the page of a folder of results into it. Return the page's path."""
    folder.check_names((PAGE,))
    payload = _payload([folder.path, *others], channel, console, allow_outside)
    with folder.writing(PAGE) as target:
        _write(target, payload)
    return target


def _payload(
    folders: list[Path], channel: str | None, console: Console, allow_outside: bool
) -> "dict[str, Value]":
    from sarmitsuba.view.page.payload import page_payload
    from sarmitsuba.view.page.run_folder import read_run

    runs = [read_run(folder, allow_outside=allow_outside) for folder in folders]
    for run_folder in runs:
        for note in run_folder.notes:
            console.note(note)
    return page_payload(runs, channel, console.say)


def _write(target: Path, payload: "dict[str, Value]") -> None:
    from sarmitsuba.view.page.write import write_page

    write_page(target, payload)
