"""Compare the simulator with closed forms. Prints a table and writes a page with one plot per case."""

import argparse
import importlib.metadata
import inspect
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import sarmitsuba
from sarmitsuba.commands.console import Console

if TYPE_CHECKING:
    from sarmitsuba.machine.output import OutputFolder
    from sarmitsuba.truth.validation.cases import CaseEntry

NAME = "validate"
HELP = "compare the simulator with closed forms and write the validation page"

PAGE, PICTURES = "validation.md", "images/validation"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out/validation"),
        help=f"folder for {PAGE} and {PICTURES} (default out/validation)",
    )
    parser.add_argument(
        "--force", action="store_true", help="replace files of these names that another program wrote"
    )
    parser.add_argument(
        "--case", nargs="+", default=[], metavar="NAME", help="run only these cases, and write no page"
    )
    parser.add_argument(
        "--topic", nargs="+", default=[], metavar="TOPIC", help="run only these topics, and write no page"
    )
    parser.add_argument(
        "--quick", action="store_true", help="use fewer bands, angles and looks, as the tests do"
    )
    parser.add_argument("--list", action="store_true", help="list the cases and stop")


def run(args: argparse.Namespace, console: Console) -> int:
    """Run cases; exit status 1 when a comparison is out of tolerance."""
    from sarmitsuba.machine.output import output_folder
    from sarmitsuba.truth.validation.cases import CASES
    from sarmitsuba.truth.validation.run_cases import select

    entries = select(args.case, args.topic)
    if args.list:
        width = max(len(entry.name) for entry in entries)
        console.say(
            "\n".join(f"{entry.topic:<12} {entry.name:{width}}  {_describe(entry)}" for entry in entries)
        )
        return 0
    pages = re.compile(re.escape(PAGE))
    pictures = re.compile("|".join(re.escape(name) for name in map(_picture, CASES)))
    with (
        output_folder(args.output, pages) as folder,
        output_folder(args.output / PICTURES, pictures) as images,
    ):
        page = [] if args.case or args.topic else [PAGE]
        for into, names in ((images, [_picture(entry) for entry in entries]), (folder, page)):
            if args.force:
                into.adopt(names)
            into.check_names(names)
        return _validate(args, entries, folder, images, console)


def _describe(entry: "CaseEntry") -> str:
    """First line of the case's description."""
    return (inspect.getdoc(entry.build) or "").partition("\n")[0]


def _picture(entry: "CaseEntry") -> str:
    return f"{entry.name}.png"


def _validate(
    args: argparse.Namespace,
    entries: "Sequence[CaseEntry]",
    folder: "OutputFolder",
    images: "OutputFolder",
    console: Console,
) -> int:
    """Run the cases and write their results."""
    from sarmitsuba.truth.validation.comparison import Case
    from sarmitsuba.truth.validation.run_cases import plot_case, report, run_case, summary_lines, write

    cases: list[Case] = []
    for i, entry in enumerate(entries):
        console.progress("validate", i, len(entries), {})
        start = time.perf_counter()
        case = run_case(entry, args.quick)
        cases.append(case)
        with images.writing(_picture(entry)) as path:
            plot_case(case, path)
        console.say("\n".join(summary_lines([case])[:-1]))
        console.say(f"     {case.name}: {time.perf_counter() - start:.1f} s")
    console.progress("validate", len(entries), len(entries), {})
    console.say(summary_lines(cases)[-1])
    if not (args.case or args.topic):
        command = "python -m sarmitsuba validate" + (" --quick" if args.quick else "")
        with folder.writing(PAGE) as path:
            write(path, report(cases, command, _facts(), PICTURES))
        console.say(f"page: {path}")
    return 0 if all(case.passed for case in cases) else 1


def _facts() -> dict[str, str]:
    names = ("mitsuba", "drjit", "numpy", "scipy")
    return {"sarmitsuba": sarmitsuba.__version__} | {n: importlib.metadata.version(n) for n in names}
