"""The `cost` study on Munich and on drawn scenes: estimated against measured values of settings it never ran."""

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import harness, random_scenes

# of different methods: one look, blocks of pulses, dense blocks of pulses
TARGETS = (-20.0, -27.0, -33.0)
# drawn scenes, and settings of each that are checked: its own, and drawn ones of the front's neighbourhood
FIRST, COUNT, PICKED = 700, 10, 3


def _drawn(report: harness.Report, count: int) -> None:
    """Settings that a study of a drawn scene estimated and never ran, run: every focuser at least once over the scenes.

    Seconds are those of the processor, so that other programs on the machine matter little.
    """
    from sarmitsuba.apps.cost import study_cost
    from sarmitsuba.loading.load import load_scene

    rows: list[list[Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST, FIRST + count):
            scene = load_scene(random_scenes.draw_boxes(seed).write(Path(folder) / str(seed)))
            found = study_cost(scene)
            share = found.seconds / found.budget
            rng = np.random.default_rng(seed)
            near = [c for c in found.candidates if not c.measured and c.error_db < -10.0]
            by_focuser: dict[str, list[Any]] = {}
            for candidate in near:
                by_focuser.setdefault(str(candidate.changes.get("focuser", "image")), []).append(candidate)
            names = sorted(by_focuser)
            picked = [
                by_focuser[n][rng.integers(len(by_focuser[n]))] for n in rng.permutation(names)[:PICKED]
            ]
            for candidate in picked:
                check = found.proof.measure(candidate.changes, pass_index=9)
                ratio = max(check.seconds / candidate.seconds, candidate.seconds / check.seconds)
                error = check.error_db - candidate.error_db
                name = str(candidate.changes.get("focuser", "method image"))
                rows.append([seed, f"{share:.2f}", name, candidate.error_db, error, candidate.seconds, ratio])
                print(*rows[-1], file=sys.stderr, flush=True)
    report.table(
        "Boxes on ground, drawn by seed: settings that were estimated and never run",
        [
            "seed",
            "study, of its budget",
            "focuser",
            "estimated dB",
            "measured - estimated dB",
            "estimated CPU s",
            "factor",
        ],
        [[*r[:3], f"{r[3]:.1f}", f"{r[4]:+.1f}", f"{r[5]:.2f}", f"{r[6]:.2f}"] for r in rows],
    )
    report.data["drawn"] = rows
    off = np.array([[abs(r[4]), r[6]] for r in rows])
    report.claim(
        "drawn: error within 2 dB", 100.0 * float(np.mean(off[:, 0] <= 2.0)), 80.0, at_least=True, unit="%"
    )
    report.claim(
        "drawn: time within 1.3", 100.0 * float(np.mean(off[:, 1] <= 1.3)), 80.0, at_least=True, unit="%"
    )
    report.claim("drawn: longest study over its budget", max(float(r[1]) for r in rows), 1.1, at_least=False)


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost import study_cost
    from sarmitsuba.commands.cost import table
    from sarmitsuba.loading.load import load_scene

    budget = 12.0 if quick else 280.0
    scene = None if quick else harness.load_munich()
    name = "Munich"
    if scene is None:
        name = "dihedral" if quick else "buildings16"
        scene = load_scene(name)
    start = time.process_time()
    found = study_cost(scene, target_error_db=TARGETS[0], budget=budget)
    spent = time.process_time() - start
    report = harness.Report(
        "cost_check",
        "Recommended settings",
        f"`python -m sarmitsuba cost` on {name} with a budget of {budget:g} processor seconds and {TARGETS[0]:g} dB "
        f"wanted; swept on {found.piece}; errors of the sweeps against {found.reference}. "
        f"Errors estimated and measured are of {found.proof.text}, seconds of the whole scene. "
        "The other wanted errors are looked up in the same study. "
        "Every recommendation is then run again, with rays that nothing in the study used.",
    )
    lines = [line.strip("| ").split(" | ") for line in table(found)]
    report.table(
        "Sweeps",
        [c.strip(" |") for c in lines[0][:6]],
        [[c.strip(" |") for c in line[:6]] for line in lines[2:]],
    )
    report.table(
        "Pareto front",
        ["error dB", "seconds", "", "settings"],
        [
            [
                f"{c.error_db:.1f}",
                f"{c.seconds:.2f}",
                "measured" if c.measured else "predicted",
                ", ".join(
                    f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in c.changes.items()
                ),
            ]
            for c in found.front
        ],
    )
    wanted = [found.recommend(target) for target in TARGETS]
    rows, errors, ratios = [], [], []
    for recommendation in wanted:
        best, check = recommendation.setting, found.verify(recommendation)
        errors.append(abs(check.error_db - best.error_db))
        ratios.append(max(check.seconds / best.seconds, best.seconds / check.seconds))
        rows.append(
            [
                f"{recommendation.target_error_db:g}" + ("" if recommendation.met else " (not met)"),
                best.changes["method"],
                f"{best.error_db:.1f}",
                f"{check.error_db:.1f}",
                f"{best.seconds:.2f}",
                f"{check.seconds:.2f}",
                f"{ratios[-1]:.2f}",
            ]
        )
        report.notes.append(f"{recommendation.target_error_db:g} dB: `{recommendation.options()}`")
        if recommendation.remark:
            report.notes.append(f"{recommendation.target_error_db:g} dB: {recommendation.remark}")
    report.table(
        "Recommendations",
        ["wanted dB", "method", "estimated dB", "measured dB", "estimated s", "measured s", "factor"],
        rows,
    )
    report.data["recommendations"] = rows
    if not quick:
        report.claim(f"study on {name}", spent, 300.0, at_least=False, unit="CPU s")
        for target, error, ratio in zip(TARGETS, errors, ratios, strict=True):
            report.claim(f"{target:g} dB: error off the estimate", error, 2.0, at_least=False, unit="dB")
            report.claim(f"{target:g} dB: time off the estimate, factor", ratio, 1.5, at_least=False)
        spare = TARGETS[0] - wanted[0].setting.error_db
        report.claim(f"{TARGETS[0]:g} dB: better than wanted by", spare, 3.0, at_least=False, unit="dB")
    _drawn(report, 2 if quick else COUNT)
    figure, axes = harness.new_figure()
    axes.semilogx(
        [c.seconds for c in found.candidates], [c.error_db for c in found.candidates], ".", ms=3, color="0.75"
    )
    axes.step([c.seconds for c in found.front], [c.error_db for c in found.front], "o-", where="post")
    for recommendation in wanted:
        axes.plot(recommendation.setting.seconds, recommendation.setting.error_db, "*", ms=14)
    axes.set(xlabel="seconds, whole scene", ylabel="error (dB)", title=f"{name}: all combinations")
    report.figure("pareto", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
