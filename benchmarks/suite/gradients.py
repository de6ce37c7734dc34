"""Derivatives and fits beside plain runs of the same scenes: processor time and peak memory.

Usage: python -m benchmarks.suite.gradients [--quick] [-o FOLDER]
"""

import json
import subprocess
import sys

from benchmarks.support import harness

CASES = (
    "fields, 5 levels",
    "fields, track of 4 knots",
    "trihedrals, track of 4 knots",
    "Munich, 18 values of 7 materials",
)
# derivatives may cost so many plain runs each
ALLOWED = 0.7


def measured(case: str, kind: str) -> dict[str, float]:
    """Figures of one job, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.support.gradient_costs", case, kind]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=harness.ROOT)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


@harness.benchmark
def run(quick: bool) -> harness.Report:
    """Table of all cases."""
    report = harness.Report(
        "gradients",
        "Derivatives and fits",
        "Raw data of a scene, the same with their derivatives by all values (`sarmitsuba.jacobian`), and a fit of all "
        "values from wrong starts (`sarmitsuba.fit`, preparation of the scene included): processor seconds after "
        "compiling, and peak memory of the process. Scenes: `tests/support/fits.py`, `tests/support/tracks.py`, "
        "`benchmarks/studies/munich_materials.py --small`.",
    )
    rows, worst = [], 0.0
    for case in CASES[:1] if quick else CASES:
        if case.startswith("Munich") and harness.munich() is None:
            continue
        plain, derivatives, fitted = (measured(case, kind) for kind in ("plain", "jacobian", "fit"))
        ratio = derivatives["cpu_s"] / plain["cpu_s"]
        worst = max(worst, (ratio - 1.0) / derivatives["values"])
        rows.append(
            [
                case,
                f"{plain['data']:.2g}",
                plain["cpu_s"],
                derivatives["cpu_s"],
                ratio,
                fitted["cpu_s"],
                int(fitted["steps"]),
                *(1e-9 * one["peak_bytes"] for one in (plain, derivatives, fitted)),
            ]
        )
        report.data[case] = {"plain": plain, "jacobian": derivatives, "fit": fitted}
    report.table(
        "",
        [
            "scene and values",
            "samples",
            "run, CPU s",
            "with derivatives, CPU s",
            "ratio",
            "fit, CPU s",
            "steps",
            "run, GB",
            "with derivatives, GB",
            "fit, GB",
        ],
        rows,
    )
    report.claim("cost of one value over that of a plain run, largest", worst, ALLOWED, at_least=False)
    return report


if __name__ == "__main__":
    harness.main(run)
