"""Compare the simulator with closed forms. Prints a table and writes a page with one plot per case."""

import argparse
import importlib.metadata
import time
from pathlib import Path

import sarmitsuba
from sarmitsuba.commands.console import Console

NAME = "validate"
HELP = "compare the simulator with closed forms and write the validation page"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("docs"),
        help="folder for validation.md and images/validation (default docs)",
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
    from sarmitsuba.io.atomic import make_folder
    from sarmitsuba.validation.comparison import Case
    from sarmitsuba.validation.figures import plot_case
    from sarmitsuba.validation.report import report, summary_lines, write
    from sarmitsuba.validation.run import run_case, select

    entries = select(args.case, args.topic)
    if args.list:
        console.say("\n".join(f"{entry.topic:<12} {entry.name}" for entry in entries))
        return 0
    images = args.output / "images" / "validation"
    make_folder(images)
    cases: list[Case] = []
    for i, entry in enumerate(entries):
        console.progress("validate", i, len(entries), {})
        start = time.perf_counter()
        case = run_case(entry, args.quick)
        cases.append(case)
        plot_case(case, images / f"{case.name}.png")
        console.say("\n".join(summary_lines([case])[:-1]))
        console.say(f"     {case.name}: {time.perf_counter() - start:.1f} s")
    console.progress("validate", len(entries), len(entries), {})
    console.say(summary_lines(cases)[-1])
    if not (args.case or args.topic):
        command = "python -m sarmitsuba validate" + (" --quick" if args.quick else "")
        write(args.output / "validation.md", report(cases, command, _facts(), "images/validation"))
        console.say(f"page: {args.output / 'validation.md'}")
    return 0 if all(case.passed for case in cases) else 1


def _facts() -> dict[str, str]:
    names = ("mitsuba", "drjit", "numpy", "scipy")
    return {"sarmitsuba": sarmitsuba.__version__} | {n: importlib.metadata.version(n) for n in names}


__all__ = ["HELP", "NAME", "add_arguments", "run"]
