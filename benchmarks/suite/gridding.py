"""Spreading kernel: image error and time over its width, direct and block accumulator."""

from benchmarks.support import harness


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.signal.gridding import gridding_kernel
    from sarmitsuba.simulation.planning.sampling.piece import crop

    report = harness.Report(
        "gridding",
        "Width of the spreading kernel",
        "Raw data gridded with kernels of w cells, focused, against kernels of 8 cells (-137 dB by "
        "theory) with the same "
        "rays and the same accumulator; `theory` is the kernel's own rms error over the used band, twice for the "
        "two axes of "
        "the block accumulator.",
    )
    scene = crop(load_scene("tower"), 0.4, 0.05)
    grid = default_grid(scene.radar, scene.image)
    figure, axes = harness.new_figure()
    widths = (4,) if quick else (2, 3, 4, 5, 6, 7)
    for method, dims in (("hybrid", 2),) if quick else (("raw", 1), ("hybrid", 2)):
        # one block, so that all widths share its geometry
        base = TrialSetting({"method": method, "key_pulse_interval": 32 if method == "hybrid" else 0})
        best = run_trial(scene, base.but(gridding_width=6 if quick else 8), grid)
        rows = []
        for width in widths:
            trial = run_trial(scene, base.but(gridding_width=width), grid)
            theory = gridding_kernel(width).error_db + (3.01 if dims == 2 else 0.0)
            rows.append(
                [
                    width,
                    trial.error_db(best.image),
                    theory,
                    trial.stages["trace"] + trial.stages["synthesise"],
                ]
            )
        name = "block accumulator (hybrid)" if dims == 2 else "direct accumulator (raw)"
        report.table(
            name,
            ["width", "error dB", "theory dB", "seconds"],
            [[r[0], f"{r[1]:.1f}", f"{r[2]:.1f}", f"{r[3]:.2f}"] for r in rows],
        )
        report.data[method] = rows
        axes.plot([r[0] for r in rows], [r[1] for r in rows], "o-", label=name)
    axes.plot(widths, [gridding_kernel(w).error_db for w in widths], "k--", lw=0.8, label="theory, one axis")
    axes.set(xlabel="width (cells)", ylabel="error of the image (dB)", title="Spreading kernel")
    axes.legend()
    report.figure("error", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
