"""The `cost` study on Munich, and its recommendation run: promised against measured error and time."""

import time

import harness


def run(quick: bool) -> harness.Report:
    from sarmitsuba.commands.cost import table
    from sarmitsuba.scene.loader import load_scene
    from sarmitsuba.study.cost import study_cost

    budget = 12.0 if quick else 280.0
    scene = None if quick else harness.load_munich()
    name = "Munich"
    if scene is None:
        scene, name = (
            load_scene("dihedral" if quick else "buildings16"),
            "dihedral" if quick else "buildings16",
        )
    target = -20.0
    start = time.perf_counter()
    found = study_cost(scene, target_error_db=target, budget=budget)
    spent = time.perf_counter() - start
    report = harness.Report(
        "cost_check",
        "Recommended settings",
        f"`python -m sarmitsuba cost` on {name} with a budget of {budget:g} s and {target:g} dB wanted; "
        f"swept on {found.piece}. "
        f"Errors against {found.reference}; the recommendation is then run itself.",
    )
    lines = [line.strip("| ").split(" | ") for line in table(found)]
    report.table(
        "Sweeps",
        [c.strip(" |") for c in lines[0][:6]],
        [[c.strip(" |") for c in line[:6]] for line in lines[2:]],
    )
    report.table(
        "Pareto front",
        ["error dB", "seconds", "settings"],
        [
            [f"{c.error_db:.1f}", f"{c.seconds:.2f}", ", ".join(f"{k} {v}" for k, v in c.changes.items())]
            for c in found.front
        ],
    )
    best, check = found.recommended, found.check
    report.table(
        "Recommendation",
        ["", "error dB", "seconds"],
        [
            ["promised", f"{best.error_db:.1f}", f"{best.seconds:.2f}"],
            ["measured", f"{check['error_db']:.1f}", f"{check['seconds']:.2f}"],
        ],
    )
    report.notes.append(f"`{found.options()}`")
    if not quick:
        report.claim("study on Munich", spent, 300.0, at_least=False, unit="s")
        report.claim("error over promise", check["error_db"] - best.error_db, 2.0, at_least=False, unit="dB")
        report.claim("time over promise", check["seconds"] / best.seconds, 1.5, at_least=False)
    figure, axes = harness.new_figure()
    axes.semilogx(
        [c.seconds for c in found.candidates], [c.error_db for c in found.candidates], ".", ms=3, color="0.75"
    )
    axes.step([c.seconds for c in found.front], [c.error_db for c in found.front], "o-", where="post")
    axes.plot(best.seconds, best.error_db, "*", ms=14)
    axes.set(xlabel="seconds, whole scene", ylabel="error (dB)", title=f"{name}: all combinations, predicted")
    report.figure("pareto", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
