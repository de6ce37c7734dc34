"""Run every benchmark and collect the results into a page in ``docs/generated``, for ``make docs``.

``python -m benchmarks.run_all [FILE ...] [--quick] [--only NAME ...] [-o FOLDER] [--collect]``. Benchmarks are the
files in ``suite`` that hold ``@harness.benchmark``; FILE is one of your own that lies elsewhere. Results stay in
``benchmarks/results``, from which the page is made: with ``--only`` other sections stay. ``--collect`` runs nothing
and makes the page. ``--quick`` runs small sizes, makes no page and takes under a minute.
"""

import argparse
import shutil
import sys
import time
import traceback
import warnings
from pathlib import Path

from benchmarks.support import error_summary, harness, listing
from sarmitsuba.core.errors import ExtensionError
from sarmitsuba.core.registry import load_extension

HEAD = """# Benchmarks

`python -m benchmarks.run_all` makes this page; each section says where and when it was measured. A benchmark of the
suite is also run by itself, by `python -m benchmarks.suite.NAME [--quick]`; [studies](#studies) are run by hand. Errors
are against a converged reference, tracing every pulse, or theory, never against the same setting of the program itself.
Seconds depend on the machine and on its load; ratios were measured in one run.

{summary}The [list of all benchmarks](#all-benchmarks) is at the end.
"""
# sections that come first: what accuracy costs at a glance
FIRST = ("error_time", "bounce_depth")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="small sizes, one round, for continuous integration"
    )
    parser.add_argument(
        "files", nargs="*", metavar="FILE", help="benchmarks of your own, run with the others"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these benchmarks only")
    parser.add_argument("-o", "--output", type=Path, default=harness.RESULTS)
    parser.add_argument("--collect", action="store_true", help="only make the page of what was run before")
    args = parser.parse_args()
    try:
        harness.discover()
        for file in args.files:
            load_extension(file)
        wanted = [harness.BENCHMARKS[name] for name in args.only or harness.BENCHMARKS.names]
    except ExtensionError as error:
        parser.error(str(error))
    args.output.mkdir(parents=True, exist_ok=True)
    failed = [] if args.collect else run(wanted, args.output, args.quick)
    if not args.quick:
        collect(args.output, harness.PAGES / "benchmarks.md")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def run(wanted: list[harness.Benchmark], output: Path, quick: bool) -> list[str]:
    """Run benchmarks one after the other; return the names of those that broke."""
    from sarmitsuba.core.errors import SarmitsubaWarning
    from sarmitsuba.machine.backend import ensure_backend

    warnings.simplefilter("ignore", SarmitsubaWarning)
    ensure_backend()
    failed = []
    for benchmark in wanted:
        start = time.perf_counter()
        print(f"== {benchmark.name}", flush=True)
        try:
            benchmark.run(quick).save(output)
        except Exception:  # one broken benchmark must not lose the others
            traceback.print_exc()
            failed.append(benchmark.name)
        print(f"   {time.perf_counter() - start:.0f} s, load {harness.load()}", flush=True)
    return failed


def collect(output: Path, page: Path) -> None:
    """Make a page of the Markdown pieces of a folder, their pictures and the list of all scripts."""
    images = page.parent / "images" / "benchmarks"
    images.mkdir(parents=True, exist_ok=True)
    sections = {}
    for name in sorted(harness.BENCHMARKS.names, key=lambda name: (name not in FIRST, name)):
        path = output / f"{name}.md"
        if not path.is_file():
            continue
        text = path.read_text(encoding="utf-8")
        for picture in output.glob(f"{name}*.png"):
            shutil.copyfile(picture, images / picture.name)
            text = text.replace(f"({picture.name})", f"(images/benchmarks/{picture.name})")
        sections[name] = text.rstrip() + "\n"
    titles = {name: text.splitlines()[0].removeprefix("## ") for name, text in sections.items()}
    parts = [HEAD.format(summary=error_summary.table(sections)), *sections.values()]
    harness.write_page(page, "\n".join([*parts, f"{listing.suite(titles)}\n\n{listing.by_hand()}\n"]))


if __name__ == "__main__":
    sys.exit(main())
