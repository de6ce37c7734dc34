"""Cost over the number of buildings on the same ground, at the same number of rays."""

import tempfile
from pathlib import Path

from benchmarks.support import harness


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.simulation.planning.sampling.piece import crop
    from tests.support.city import make_city

    report = harness.Report(
        "buildings",
        "Number of buildings",
        "Boxes on 400 m x 400 m, 1 m resolution, the same rays and pulses for all: what a scene's size "
        "costs by itself. "
        "`trace` is the bounce loop; seconds are medians, without compiling.",
    )
    counts = (1, 16) if quick else (1, 4, 16, 64, 256, 1024)
    rounds = harness.ROUNDS_QUICK if quick else harness.ROUNDS
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        scenes = {
            n: crop(load_scene(make_city(n, Path(folder))), 0.3 if quick else 1.0, 0.25) for n in counts
        }
        # all to one depth, so that not the plan but the geometry changes
        setting = TrialSetting(
            {"method": "hybrid", "max_depth": 3, "ray_spacing": 0.25 if not quick else 0.5}
        )
        taken: dict[int, list[dict[str, float]]] = {n: [] for n in counts}
        rates = {}
        for round_ in range(rounds + 1):
            for n, scene in scenes.items():
                trial = run_trial(scene, setting)
                if round_:
                    taken[n].append({**trial.stages, "all": trial.seconds - trial.stages["focus"]})
                    rates[n] = trial.statistics
    for n in counts:
        middle = sorted(taken[n], key=lambda s: s["all"])[len(taken[n]) // 2]
        hits = rates[n].hits / rates[n].rays
        rows.append([n, scenes[n].geometry.n_faces, hits, middle["trace"], middle["build"], middle["all"]])
    report.table(
        "",
        ["buildings", "triangles", "hits per ray", "trace s", "build s", "all s", "against 1"],
        [
            [
                r[0],
                r[1],
                f"{r[2]:.2f}",
                f"{r[3]:.2f}",
                f"{r[4]:.3f}",
                f"{r[5]:.2f}",
                f"{r[5] / rows[0][5]:.2f}",
            ]
            for r in rows
        ],
    )
    report.data["rows"] = rows
    if not quick:
        growth = next(r[5] for r in rows if r[0] == 256) / rows[0][5]
        report.claim("cost of 256 buildings over that of 1, same rays", growth, 4.0, at_least=False)
    figure, axes = harness.new_figure()
    axes.semilogx([r[0] for r in rows], [r[5] for r in rows], "o-", label="all")
    axes.semilogx([r[0] for r in rows], [r[3] for r in rows], "s--", label="trace")
    axes.set(xlabel="buildings", ylabel="seconds", title="Number of buildings", ylim=(0, None))
    axes.legend()
    report.figure("time", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
