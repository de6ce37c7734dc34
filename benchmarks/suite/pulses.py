"""Cost and memory over the number of pulses."""

from benchmarks.support import harness


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.simulation.planning.sampling.piece import crop

    report = harness.Report(
        "pulses",
        "Number of pulses",
        "The same aperture of the tower scene sampled by more and more pulses (simulation only, without compiling). "
        "`raw` is measured on few pulses and scaled by their number. Memory is what the process grows by, less the raw "
        "data themselves, which the caller keeps: it must not grow with the pulses.",
    )
    rows = []
    counts = (512,) if quick else (1024, 2048, 4096, 8192)
    for n in counts:
        scene = load_scene("tower", parameters={"sar_antenna.n_pulses": str(n)})
        scene = crop(scene, 0.5)
        run_trial(scene, TrialSetting({"method": "hybrid"}))
        trial = run_trial(scene, TrialSetting({"method": "hybrid"}))
        few = crop(scene, 1.0, 24 / n)
        run_trial(few, TrialSetting({"method": "raw"}))
        raw = run_trial(few, TrialSetting({"method": "raw"}))
        window = scene.radar.window
        own = 8e-6 * n * window.n_samples
        seconds = trial.seconds - trial.stages["focus"]
        direct = (raw.seconds - raw.stages["focus"]) * n / few.radar.track.n_pulses
        memory = trial.peak_bytes / 1e6
        rows.append([n, trial.statistics.key_pulses, seconds, direct, memory, own])
    report.table(
        "",
        ["pulses", "key pulses", "hybrid s", "raw s (scaled)", "ratio", "memory MB", "of it raw data MB"],
        [
            [r[0], r[1], f"{r[2]:.2f}", f"{r[3]:.1f}", f"{r[3] / r[2]:.0f}", f"{r[4]:.0f}", f"{r[5]:.0f}"]
            for r in rows
        ],
    )
    report.data["rows"] = rows
    figure, axes = harness.new_figure()
    axes.loglog([r[0] for r in rows], [r[2] for r in rows], "o-", label="hybrid")
    axes.loglog([r[0] for r in rows], [r[3] for r in rows], "s--", label="raw")
    axes.set(xlabel="pulses", ylabel="seconds", title="Number of pulses")
    axes.legend()
    report.figure("time", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
