"""Every error that the program states against the true one, over cases drawn by seed.

``python -m benchmarks.suite.stated_errors [--kind NAME ...] [--first N] [--count N] [--lines FILE]``; ``--summary
FILE ...`` makes the tables of lines that earlier calls wrote. One topic is a function of a seed that gives rows: what
was stated, what is true, or that it was refused. Errors are energies over that of the image, dB.
"""

import argparse
import json
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.support import harness
from benchmarks.support.stated_echoes import focusers, focusers_outside
from benchmarks.support.stated_row import BELOW, FLOOR, Row
from benchmarks.support.stated_traces import block_model, blocks, gridding, passes, rays, rcs
from benchmarks.support.stated_wide import wide, wide_effects, wide_rays

TOPICS: dict[str, Callable[[int], Iterator[Row]]] = {
    "focusers": focusers,
    "focusers_outside": focusers_outside,
    "rays": rays,
    "passes": passes,
    "blocks": blocks,
    "block_model": block_model,
    "gridding": gridding,
    "rcs": rcs,
    "wide": wide,
    "wide_effects": wide_effects,
    "wide_rays": wide_rays,
}
# cases of a topic: quick, and of the page
QUICK, COUNT = 1, 30
# seeds of the page; what was mended was found with others
FIRST = 1000


def cases(topics: Sequence[str], first: int, count: int, lines: Path | None = None) -> list[Row]:
    """Rows of all topics; each is written to a file of lines as it comes, and a case that breaks is said."""
    rows = []
    for seed in range(first, first + count):
        for topic in topics:
            start = time.process_time()
            try:
                found = list(TOPICS[topic](seed))
            except Exception:  # the others are wanted all the same
                traceback.print_exc()
                found = [Row(topic, "broken", seed, topic, note=traceback.format_exc(limit=1)[-200:])]
            took = time.process_time() - start
            print(f"{topic} {seed}: {took:.1f} CPU s", file=sys.stderr, flush=True)
            for row in found:
                if row.excess > BELOW:
                    print(row.text, file=sys.stderr, flush=True)
            if lines:
                with lines.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(asdict(row)) + "\n" for row in found)
            rows += found
    return rows


def table(rows: Sequence[Row]) -> list[list[object]]:
    """By kind: cases, refused, without a statement, worst, share too small, looseness."""
    out: list[list[object]] = []
    for kind in sorted({(row.topic, row.kind) for row in rows}):
        mine = [row for row in rows if (row.topic, row.kind) == kind]
        stated = [row for row in mine if row.excess == row.excess]
        excess = np.array([row.excess for row in stated])
        cells = [float("nan")] * 3
        if stated:
            cells = [float(excess.max()), 100.0 * float(np.mean(excess > BELOW)), float(np.median(-excess))]
        refused = sum(row.refused for row in mine)
        out.append([*kind, len(mine), refused, len(mine) - refused - len(stated), *cells])
    return out


def report_of(rows: Sequence[Row]) -> harness.Report:
    """Table by kind, the claim, and every case where the statement is too small."""
    report = harness.Report(
        "stated_errors",
        "Stated and true errors",
        "Errors that the program states against the true ones, over scenes, radars, tracks and images drawn by seed. "
        f"Differences are of dB; an error below {FLOOR:g} dB, the rounding of complex64 echoes and sums over pulses, "
        "counts as that.",
    )
    report.table(
        "By kind",
        [
            "topic",
            "kind",
            "cases",
            "refused",
            "none stated",
            "worst: true - stated",
            f"> {BELOW:g} dB, %",
            "looseness",
        ],
        table(rows),
    )
    small = sorted((row for row in rows if row.excess > BELOW), key=lambda row: -row.excess)
    report.table(
        "Stated too small",
        ["topic", "kind", "seed", "case", "stated dB", "true dB"],
        [[r.topic, r.kind, r.seed, r.case, f"{r.stated:.1f}", f"{r.true:.1f}"] for r in small[:40]],
    )
    report.claim("statements too small by more than 3 dB", len(small), 0.0, at_least=False)
    report.data["rows"] = [asdict(row) for row in rows]
    return report


@harness.benchmark
def run(quick: bool) -> harness.Report:
    return report_of(cases(list(TOPICS), FIRST, QUICK if quick else COUNT))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", nargs="+", choices=list(TOPICS), default=list(TOPICS), help="topics")
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--lines", type=Path, help="file that every row is added to")
    parser.add_argument("--summary", type=Path, nargs="+", help="files of lines to make the tables of")
    args = parser.parse_args()
    if args.summary:
        lines = [line for path in args.summary for line in path.read_text(encoding="utf-8").splitlines()]
        rows = [Row(**json.loads(line)) for line in lines]
    else:
        from sarmitsuba.core.errors import SarmitsubaWarning
        from sarmitsuba.machine.backend import ensure_backend

        warnings.simplefilter("ignore", SarmitsubaWarning)
        ensure_backend()
        rows = cases(args.kind, args.first, args.count, args.lines)
    print(report_of(rows).markdown())


if __name__ == "__main__":
    main()
