"""Ray density: image error against a converged reference, and time, over the distance between rays."""

import numpy as np

from benchmarks.support import harness

FACTORS = (2.83, 2.0, 1.41, 1.0, 0.71, 0.5)  # of the automatic spacing: rays double from one to the next
REFERENCE = 0.35  # spacing of the reference, as a factor: 8 times the rays of the default, two such passes


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost_trials import TrialSetting, mean_image, run_trial
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.simulation.planning.pilot import plan_scene
    from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
    from sarmitsuba.simulation.planning.sampling.piece import crop

    report = harness.Report(
        "ray_density",
        "Ray density",
        f"Error of the image against the mean of two runs at {REFERENCE:g} of the automatic spacing with lattices of "
        "their own; factor 1 is the automatic spacing. Seconds: simulation only, without compiling.",
    )
    figure, axes = harness.new_figure()
    pieces = (
        {"tower": (0.5, 0.25)}
        if quick
        else {"tower": (1.0, 0.25), "buildings16": (0.6, 0.25), "sphere": (1.0, 1.0)}
    )
    for name, (share, pulses) in pieces.items():
        whole = load_scene(name)
        sampling = SamplingPlan.of(whole, plan_scene(whole).flags)
        rays = sampling.spacings
        scene = crop(whole, share, pulses)
        grid = default_grid(scene.radar, scene.image)
        # in metres, from the whole aperture: a piece of it resolves less and would get larger cells
        base = TrialSetting({"method": "hybrid", "scatterer_cell": sampling.scatterer_cell})
        reference = mean_image(scene, base.but(**rays.at(REFERENCE)), grid, 1 if quick else 2)
        rows = []
        for factor in FACTORS[1:4] if quick else FACTORS:
            trial = run_trial(scene, base.but(**rays.at(factor)), grid)
            count = trial.statistics.rays // max(trial.statistics.key_pulses, 1)
            seconds = trial.seconds - trial.stages["focus"]
            rows.append([factor, factor * rays.coherent, count, trial.error_db(reference), seconds])
        report.table(
            name,
            ["factor", "spacing m", "rays per key pulse", "error dB", "seconds"],
            [[r[0], f"{r[1]:.4g}", r[2], f"{r[3]:.1f}", f"{r[4]:.2f}"] for r in rows],
        )
        slope = np.polyfit(10 * np.log10([r[2] for r in rows]), [r[3] for r in rows], 1)[0]
        report.notes.append(f"{name}: error falls by {-3.01 * slope:.1f} dB for twice the rays.")
        report.data[name] = rows
        axes.semilogx([r[2] for r in rows], [r[3] for r in rows], "o-", label=name)
    axes.set(xlabel="rays per key pulse", ylabel="error of the image (dB)", title="Ray density")
    axes.legend()
    report.figure("error", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
