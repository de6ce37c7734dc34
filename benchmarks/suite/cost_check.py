"""The `cost` study on Munich, and its recommendations run: estimated against measured error and time."""

import time

import _support
import harness

# of different methods: one look, blocks of pulses, dense blocks of pulses
TARGETS = (-20.0, -27.0, -33.0)


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.commands.cost import table
    from sarmitsuba.cost.study import study_cost
    from sarmitsuba.loader.load import load_scene

    budget = 12.0 if quick else 280.0
    scene = None if quick else harness.load_munich()
    name = "Munich"
    if scene is None:
        name = "dihedral" if quick else "buildings16"
        scene = load_scene(name)
    start = time.perf_counter()
    found = study_cost(scene, target_error_db=TARGETS[0], budget=budget)
    spent = time.perf_counter() - start
    report = harness.Report(
        "cost_check",
        "Recommended settings",
        f"`python -m sarmitsuba cost` on {name} with a budget of {budget:g} s and {TARGETS[0]:g} dB wanted; "
        f"swept on {found.piece}; errors of the sweeps against {found.reference}. Errors estimated and measured are of "
        f"{found.proof.text}, seconds of the whole scene. The other wanted errors are looked up in the same study. "
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
        report.claim(f"study on {name}", spent, 300.0, at_least=False, unit="s")
        for target, error, ratio in zip(TARGETS, errors, ratios, strict=True):
            report.claim(f"{target:g} dB: error off the estimate", error, 2.0, at_least=False, unit="dB")
            report.claim(f"{target:g} dB: time off the estimate, factor", ratio, 1.5, at_least=False)
        spare = TARGETS[0] - wanted[0].setting.error_db
        report.claim(f"{TARGETS[0]:g} dB: better than wanted by", spare, 3.0, at_least=False, unit="dB")
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
