"""Key-pulse interval: error against tracing every pulse with the same rays, and time."""

from typing import Any

import harness


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.cost.trial import Setting, run_trial
    from sarmitsuba.focusing import default_grid
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.simulation.sampling.piece import crop

    report = harness.Report(
        "key_pulse_interval",
        "Key-pulse interval",
        "Image of `hybrid` with a key pulse every K pulses against `raw`, which traces every pulse with the same rays. "
        "Seconds: simulation only, without compiling. K = 1 is `raw` itself.",
    )
    pieces: dict[str, Any] = {
        "tower": crop(load_scene("tower"), 0.2 if quick else 0.4, 0.025 if quick else 0.1)
    }
    if not quick:
        city = harness.load_munich()
        if city is not None:
            pieces["Munich"] = crop(city, 0.35, 0.25)
    figure, axes = harness.new_figure()
    for name, scene in pieces.items():
        grid = default_grid(scene.radar, scene.image)
        n = scene.radar.track.n_pulses
        exact = run_trial(scene, Setting({"method": "raw"}), grid)
        base = exact.seconds - exact.stages["focus"]
        rows = [[1, float("nan"), base, 1.0]]
        for k in (8, 16, 32, 64, 128, 256):
            if k > n:
                break
            trial = run_trial(scene, Setting({"method": "hybrid", "key_pulse_interval": k}), grid)
            seconds = trial.seconds - trial.stages["focus"]
            rows.append([k, trial.error_db(exact.image), seconds, base / seconds])
        report.table(
            f"{name}, {n} pulses",
            ["K", "error dB", "seconds", "speed-up"],
            [[r[0], "-" if r[0] == 1 else f"{r[1]:.1f}", f"{r[2]:.2f}", f"{r[3]:.1f}"] for r in rows],
        )
        report.data[name] = rows
        axes.semilogx([r[0] for r in rows[1:]], [r[1] for r in rows[1:]], "o-", base=2, label=name)
    axes.set(
        xlabel="pulses a key pulse stands for", ylabel="error of the image (dB)", title="Key-pulse interval"
    )
    axes.legend()
    report.figure("error", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
