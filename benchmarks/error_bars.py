"""The error that two ray subsets estimate, against the true error, over scenes and settings."""

import harness
import numpy as np

FACTORS = (0.5, 0.71, 1.0, 1.41)  # of the automatic ray spacing
REFERENCE, REFERENCE_RUNS = 0.25, 4
RUNS = 4  # lattices of their own
PIECES = {"tower": 0.6, "buildings16": 0.5, "urban_block": 0.4, "bridge": 0.5}  # share of the image
TOLERANCE = 1.5  # dB


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.simulation.refinement.error_bars import SHARED_DB

    report = harness.Report(
        "error_bars",
        "Error bars",
        "Whole-image sampling error estimated from two ray subsets, against the true error: the distance to the "
        f"mean of {REFERENCE_RUNS} runs at {REFERENCE:g} of the automatic spacing with lattices of their own. "
        f"`factor` is on the automatic spacing. Every setting is run {RUNS} times with lattices of its own; `true` and "
        "`estimate` are means of their energies, `within` counts runs whose own estimate is within "
        f"{TOLERANCE:g} dB of their own truth. The estimate is half the difference of the "
        f"two sets (three quarters and a quarter of the coherent rays) and {SHARED_DB:g} dB, one number, the mean over "
        "all of these.",
    )
    figure, axes = harness.new_figure(5.4, 5.0)
    rows = []
    for name, share in {"tower": 0.5}.items() if quick else PIECES.items():
        methods = ("image", "hybrid") if not quick and name in ("tower", "buildings16") else ("image",)
        for method in methods:
            rows += _rows(load_scene(name), name, share, method, FACTORS[1:3] if quick else FACTORS, quick)
    munich = None if quick else harness.load_munich()
    if munich is not None:
        rows += _rows(munich, "munich", 0.35, "image", FACTORS, quick)
    for name in dict.fromkeys(r["scene"] for r in rows):
        mine = [r for r in rows if r["scene"] == name]
        true = np.concatenate([r["true"] for r in mine])
        axes.plot(true, np.concatenate([r["estimate"] for r in mine]), "o", label=name, mfc="none", ms=4)
    table = []
    for r in rows:
        off = np.array(r["estimate"]) - np.array(r["true"])
        mean = mean_db(r["estimate"]) - mean_db(r["true"])
        r["mean_difference"], r["within"] = mean, int((np.abs(off) <= TOLERANCE).sum())
        mean_estimate, mean_true = mean_db(r["estimate"]), mean_db(r["true"])
        figures = [f"{mean_estimate:.1f}", f"{mean_true:.1f}", f"{mean:+.2f}"]
        spread = f"{off.min():+.1f} ... {off.max():+.1f}"
        table.append([r["scene"], r["method"], r["factor"], *figures, spread, f"{r['within']} of {off.size}"])
    report.table(
        "",
        ["scene", "method", "factor", "estimate dB", "true dB", "difference dB", "single runs dB", "within"],
        table,
    )
    report.data["rows"] = rows
    runs = sum(len(r["true"]) for r in rows)
    within = 100.0 * sum(r["within"] for r in rows) / runs
    worst = max(abs(r["mean_difference"]) for r in rows)
    report.claim(f"largest difference, mean of {RUNS} runs", worst, TOLERANCE, at_least=False, unit="dB")
    near = 100.0 * float(np.mean([abs(r["mean_difference"]) <= TOLERANCE for r in rows]))
    report.claim(
        f"settings within {TOLERANCE:g} dB, mean of {RUNS} runs", near, 90.0, at_least=True, unit="%"
    )
    report.claim(f"single runs within {TOLERANCE:g} dB", within, 90.0, at_least=True, unit="%")
    report.notes.append(
        f"{within:.0f} % of {runs} single runs lie within {TOLERANCE:g} dB. One run is a draw: where a few bright "
        "lines carry the error, the difference of two subsets is a few random numbers."
    )
    every = np.concatenate([r["true"] for r in rows])
    limits = [every.min() - 3, every.max() + 3]
    axes.plot(limits, limits, "k-", lw=0.8)
    axes.fill_between(
        limits,
        [v - TOLERANCE for v in limits],
        [v + TOLERANCE for v in limits],
        color="0.9",
        label=f"{TOLERANCE:g} dB",
    )
    axes.set(
        xlabel="true error (dB)", ylabel="estimate from two subsets (dB)", title="Error bars", aspect="equal"
    )
    axes.legend()
    report.figure("scatter", figure)
    return report


def _rows(whole, name: str, share: float, method: str, factors, quick: bool) -> list[dict]:  # type: ignore[no-untyped-def]
    """True and estimated error of every run, by factor."""
    from sarmitsuba.cost.trial import Setting, mean_image
    from sarmitsuba.focusing import default_grid
    from sarmitsuba.image.metrics import image_error_db
    from sarmitsuba.simulation.pilot import plan_scene
    from sarmitsuba.simulation.refinement.error_bars import estimate_error
    from sarmitsuba.simulation.render import render
    from sarmitsuba.simulation.sampling.piece import crop
    from sarmitsuba.simulation.sampling.plan import SamplingPlan

    plan = plan_scene(whole)
    sampling = SamplingPlan.of(whole, plan.flags)
    rays = sampling.spacings
    scene = crop(whole, share, 0.1)
    grid = default_grid(scene.radar, scene.image)
    # as many bounces in all runs: their error is not the rays'
    base = Setting(
        {
            "method": method,
            "scatterer_cell": sampling.scatterer_cell,
            "max_depth": plan.max_depth,
        }
    )
    reference = mean_image(scene, base.but(**rays.at(REFERENCE)), grid, 1 if quick else REFERENCE_RUNS)
    rows = []
    for factor in factors:
        changed = base.but(**rays.at(factor), keep_subsets=True).apply(scene)
        true, estimate = [], []
        for index in range(1 if quick else RUNS):
            image = render(changed, grid=grid, pass_index=index)
            estimate.append(estimate_error(image.data, image.layers, pixels=False).error_db[0])
            true.append(image_error_db(image.total(), reference))
        rows.append({"scene": name, "method": method, "factor": factor, "true": true, "estimate": estimate})
    return rows


def mean_db(values: list[float]) -> float:
    """Mean of energies given in dB."""
    return 10.0 * float(np.log10(np.mean(10.0 ** (np.array(values) / 10.0))))


if __name__ == "__main__":
    harness.main(run)
