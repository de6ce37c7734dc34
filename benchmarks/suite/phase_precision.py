"""Float32 against float64 lengths and phases, over the slant range."""

from benchmarks.support import harness


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.simulation.planning.sampling.piece import crop

    report = harness.Report(
        "phase_precision",
        "Precision of lengths and phases",
        "The same rays with path lengths in float32 and in float64 (`phase_precision`), tower at X band; "
        "the geometry of "
        "the antenna is float64 in both. A slant range rounded to float32 is off by up to 2^-25 of "
        "itself, in radians of "
        "two-way phase 4 pi / lambda times that: `rounding` is its rms.",
    )
    figure, axes = harness.new_figure()
    rows = []
    for kilometres in (10, 30) if quick else (1, 3, 10, 30, 100, 700):
        parameters = {"sar_antenna.slant_range": f"{1e3 * kilometres:g}"}
        if kilometres > 100:  # an orbit's speed; the same azimuth resolution
            parameters["sar_antenna.speed"] = "7500"
        scene = load_scene("tower", parameters=parameters)
        scene = crop(scene, 0.4, max(0.02, 64 / scene.radar.track.n_pulses))
        grid = default_grid(scene.radar, scene.image)
        base = TrialSetting({"method": "hybrid"})
        double = run_trial(scene, base.but(phase_precision="double"), grid)
        single = run_trial(scene, base.but(phase_precision="single"), grid)
        wavelength = scene.radar.waveform.wavelength
        rounding = 4 * 3.14159265 / wavelength * kilometres * 1e3 * 2.0**-24 / 12**0.5
        rows.append(
            [
                kilometres,
                single.error_db(double.image),
                rounding,
                single.stages["trace"],
                double.stages["trace"],
            ]
        )
    report.table(
        "",
        ["slant range km", "error of float32 dB", "rounding rad", "trace float32 s", "trace float64 s"],
        [[r[0], f"{r[1]:.1f}", f"{r[2]:.3g}", f"{r[3]:.2f}", f"{r[4]:.2f}"] for r in rows],
    )
    report.data["rows"] = rows
    axes.semilogx([r[0] for r in rows], [r[1] for r in rows], "o-")
    axes.set(xlabel="slant range (km)", ylabel="error of float32 (dB)", title="Lengths in float32")
    report.figure("error", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
