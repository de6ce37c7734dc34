"""Compare the simulator with closed forms: a table on the terminal, a page with a plot for every case."""

import argparse
import time
from pathlib import Path

from sarmitsuba.commands.console import Console
from sarmitsuba.errors import OutputError

NAME = "validate"
HELP = "compare the simulator with closed forms and write the validation page"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("docs"),
        help="folder of validation.md and images/validation",
    )
    parser.add_argument("--case", nargs="+", metavar="NAME", help="only these cases; no page is written")
    parser.add_argument("--topic", nargs="+", metavar="TOPIC", help="only these topics; no page is written")
    parser.add_argument(
        "--quick", action="store_true", help="fewer bands, angles and looks, as the tests run them"
    )
    parser.add_argument("--list", action="store_true", help="list the cases and stop")


def run(args: argparse.Namespace, console: Console) -> int:
    """Run cases; exit status 1 when a comparison is out of tolerance."""
    from sarmitsuba.io.atomic import make_folder
    from sarmitsuba.validation.comparison import Case, all_cases
    from sarmitsuba.validation.report import report, summary_lines, write
    from sarmitsuba.view.validation import plot_case

    entries = all_cases()
    if args.list:
        console.say("\n".join(f"{entry.topic:<12} {entry.name}" for entry in entries))
        return 0
    partial = bool(args.case or args.topic)
    for name in args.case or ():
        if name not in {entry.name for entry in entries}:
            raise OutputError(f"validate: there is no case {name!r}; `validate --list` names them")
    for name in args.topic or ():
        if name not in {entry.topic for entry in entries}:
            raise OutputError(f"validate: there is no topic {name!r}; `validate --list` names them")
    if partial:
        entries = tuple(e for e in entries if e.name in (args.case or ()) or e.topic in (args.topic or ()))
    images = args.output / "images" / "validation"
    make_folder(images)
    cases: list[Case] = []
    for i, entry in enumerate(entries):
        console.progress("validate", i, len(entries), {})
        start = time.perf_counter()
        case = entry.build(args.quick)
        cases.append(case)
        plot_case(case, images / f"{case.name}.png")
        console.say("\n".join(summary_lines([case])[:-1]))
        console.say(f"     {case.name}: {time.perf_counter() - start:.1f} s")
    console.progress("validate", len(entries), len(entries), {})
    console.say(summary_lines(cases)[-1])
    if not partial:
        command = "python -m sarmitsuba validate" + (" --quick" if args.quick else "")
        write(args.output / "validation.md", report(cases, command, _facts(), "images/validation"))
        console.say(f"page: {args.output / 'validation.md'}")
    return 0 if all(case.passed for case in cases) else 1


def _facts() -> dict[str, str]:
    import importlib.metadata

    import sarmitsuba

    names = ("mitsuba", "drjit", "numpy", "scipy")
    return {"sarmitsuba": sarmitsuba.__version__} | {n: importlib.metadata.version(n) for n in names}


__all__ = ["HELP", "NAME", "add_arguments", "run"]
