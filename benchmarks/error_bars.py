"""The error that two halves of the rays estimate, against the true error, over scenes and settings."""

import harness
import numpy as np

FACTORS = (0.5, 0.71, 1.0, 1.41)  # of the automatic ray spacing
REFERENCE = 0.3


def run(quick: bool) -> harness.Report:
    from sarmitsuba.focus import default_grid
    from sarmitsuba.image.metrics import image_error_db
    from sarmitsuba.methods import simulate_image
    from sarmitsuba.scene.loader import load_scene
    from sarmitsuba.study.cost_report import Rays
    from sarmitsuba.study.error_bars import estimate_error
    from sarmitsuba.study.sweep import Setting, crop, mean_image
    from sarmitsuba.trace.pilot import plan_scene
    from sarmitsuba.trace.window import launch_window, scatterer_cell

    report = harness.Report(
        "error_bars",
        "Error bars",
        "Whole-image sampling error estimated from two halves of the rays, against the true error: the distance to the "
        f"mean of three runs at {REFERENCE:g} of the automatic spacing with lattices of their own. `factor` is on the "
        "automatic spacing. `noise`: the half difference alone; `estimate` adds an allowance for what "
        "both halves share, "
        "one curve of two points fitted to these scenes (`sarmitsuba.study.error_bars.SHARED_DB`), and so is not "
        "independent of them. `difference`: estimate less truth.",
    )
    figure, axes = harness.new_figure(5.4, 5.0)
    pieces = (
        {"tower": 0.5} if quick else {"tower": 0.6, "buildings16": 0.5, "urban_block": 0.4, "bridge": 0.5}
    )
    rows = []
    for name, share in pieces.items():
        whole = load_scene(name)
        plan, window = plan_scene(whole), launch_window(whole)
        rays = Rays.of(whole, plan)
        cell = scatterer_cell(whole, window.incidence)
        for method in ("image",) if quick or name not in ("tower", "buildings16") else ("image", "hybrid"):
            scene = crop(whole, share, 0.1)
            grid = default_grid(scene.radar, scene.image)
            base = Setting({"method": method, "scatterer_cell": cell})
            reference = mean_image(scene, base.but(**rays.at(REFERENCE)), grid, 1 if quick else 3)
            for factor in FACTORS[1:3] if quick else FACTORS:
                setting = base.but(**rays.at(factor), keep_halves=True)
                image = simulate_image(setting.apply(scene), grid=grid)
                bars = estimate_error(image.data, image.layers, pixels=False)
                true = image_error_db(image.total(), reference)
                rows.append(
                    [name, method, factor, bars.error_db[0], true, bars.error_db[0] - true, bars.noise_db[0]]
                )
        mine = [r for r in rows if r[0] == name]
        axes.plot([r[4] for r in mine], [r[3] for r in mine], "o", label=name, mfc="none")
    report.table(
        "",
        ["scene", "method", "factor", "noise dB", "estimate dB", "true dB", "difference dB"],
        [[r[0], r[1], r[2], f"{r[6]:.1f}", f"{r[3]:.1f}", f"{r[4]:.1f}", f"{r[5]:+.2f}"] for r in rows],
    )
    report.data["rows"] = rows
    worst = max(abs(r[5]) for r in rows)
    within = 100.0 * float(np.mean([abs(r[5]) <= 1.5 for r in rows]))
    report.claim("largest difference of estimate and truth", worst, 1.5, at_least=False, unit="dB")
    report.notes.append(f"{within:.0f} % of {len(rows)} cases lie within 1.5 dB.")
    limits = [min(r[4] for r in rows) - 3, max(r[4] for r in rows) + 3]
    axes.plot(limits, limits, "k-", lw=0.8)
    axes.fill_between(
        limits, [v - 1.5 for v in limits], [v + 1.5 for v in limits], color="0.9", label="1.5 dB"
    )
    axes.set(
        xlabel="true error (dB)", ylabel="estimate from two halves (dB)", title="Error bars", aspect="equal"
    )
    axes.legend()
    report.figure("scatter", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
