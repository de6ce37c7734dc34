"""The four methods on the 16-building scene against converged raw; two references of the literature beside them."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import harness

# Franceschetti et al. (2003) on a workstation of its day: seconds for 2 and 16 buildings, 512 x 512 pixels
LITERATURE_2003 = {2: 62.0, 16: 458.0}
# what counts as interactive, s, once kernels are compiled
INTERACTIVE = 1.0
# raw traces 0.8 M rays per pulse: a twentieth of the aperture keeps this benchmark under three minutes
APERTURE = 0.05
LOOKS = 9  # pixels per side that intensities are averaged over: speckle of 1 / sqrt(81 / 4) remains


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.cost_trials import TrialSetting, mean_image, run_trial
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.simulation.planning.sampling.piece import crop

    report = harness.Report(
        "methods",
        "Methods",
        "Sixteen buildings, four ways to the same image grid. `error`: complex image against converged "
        "raw (mean of two "
        "`raw` runs with lattices of their own and twice the rays). `intensity`: the same of intensities "
        "averaged over "
        f"{LOOKS} x {LOOKS} pixels, which is all an incoherent method can be assessed by; its speckle alone makes "
        "about -10 dB. "
        f"The aperture is the middle {100 * APERTURE:g} % of the pulses; `whole aperture` is measured, for "
        "raw extrapolated "
        "by the number of pulses. Seconds include focusing and exclude compiling.",
    )
    whole = load_scene("buildings16")
    share = 0.3 if quick else 1.0
    scene = crop(whole, share, 0.02 if quick else APERTURE)
    grid = default_grid(scene.radar, scene.image)
    from sarmitsuba.simulation.planning.pilot import plan_scene
    from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan

    sampling = SamplingPlan.of(whole, plan_scene(whole).flags)
    rays = sampling.spacings
    base = TrialSetting({"scatterer_cell": sampling.scatterer_cell, **rays.at(1.0)})
    dense = base.but(method="raw", **rays.at(0.5**0.5))
    reference = mean_image(scene, dense, grid, 1 if quick else 2)

    rows = []
    n = whole.radar.track.n_pulses
    raw_seconds = 0.0
    for method in ("raw", "hybrid", "image", "raster"):
        trial = run_trial(scene, base.but(method=method), grid)
        if method == "raw":
            raw_seconds = trial.seconds
            full = trial.seconds * n / scene.radar.track.n_pulses / share**2
        elif quick:
            full = float("nan")
        else:
            full = run_trial(whole, base.but(method=method)).seconds
        rows.append(
            [
                method,
                trial.error_db(reference),
                intensity_error_db(trial.image, reference),
                trial.seconds,
                raw_seconds / trial.seconds,
                full,
            ]
        )
    report.table(
        "Methods",
        ["method", "error dB", "intensity dB", "seconds", "faster than raw", "whole aperture s"],
        [[r[0], f"{r[1]:.1f}", f"{r[2]:.1f}", f"{r[3]:.3g}", f"{r[4]:.0f}", f"{r[5]:.3g}"] for r in rows],
    )
    report.data["methods"] = rows
    cities = literature(quick)
    report.table(
        "2 to 16 buildings on 512 x 512 pixels, seconds",
        ["program", "2", "16", "ratio"],
        [
            [
                "raw-signal simulator of 2003 (its own machine)",
                LITERATURE_2003[2],
                LITERATURE_2003[16],
                f"{LITERATURE_2003[16] / LITERATURE_2003[2]:.1f}",
            ],
            *[[m, f"{a:.3g}", f"{b:.3g}", f"{b / a:.1f}"] for m, a, b in cities],
            ["interactive rasterisers of the literature", "< 0.1", "< 0.1", "1"],
        ],
    )
    report.data["cities"] = cities
    _interactive(report, quick)
    figure, axes = harness.new_figure()
    for name, error, intensity, seconds, _, _ in rows:
        axes.semilogx(seconds, error, "o", color="C0")
        axes.semilogx(seconds, intensity, "s", color="C1", mfc="none")
        axes.annotate(name, (seconds, error), textcoords="offset points", xytext=(5, 5))
    axes.plot([], [], "o", color="C0", label="complex image")
    axes.plot([], [], "s", color="C1", mfc="none", label="averaged intensity")
    axes.set(xlabel="seconds", ylabel="error against converged raw (dB)", title="Methods, 16 buildings")
    axes.legend()
    report.figure("error_time", figure)
    return report


def _interactive(report: harness.Report, quick: bool) -> None:
    """Seconds of the two image-domain methods on Munich, once compiled: the whole run, and one more image."""
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.simulation.execution.image import Imager
    from sarmitsuba.simulation.execution.run import Run
    from tests.support.unweighted import render

    scene = None if quick else harness.load_munich()
    if scene is None:
        report.notes.append("Munich, once compiled: not here (quick, or sionna-rt is not installed)")
        return
    grid = default_grid(scene.radar, scene.image)
    imager = Imager(Run(scene), grid)
    jobs = {
        "raster": lambda: render(scene, method="raster", grid=grid),
        "image": lambda: render(scene, method="image", grid=grid),
        "raster again": imager.raster,
        "image again": imager.image,
    }
    timing = harness.interleave(jobs, harness.ROUNDS)
    report.table(
        "Munich, once compiled: seconds from the loaded scene, and of one more image of a prepared scene "
        "(`sarmitsuba.simulation.execution.image.Imager`)",
        ["method", "whole run", "one more image"],
        [[name, str(timing[name]), str(timing[f"{name} again"])] for name in ("raster", "image")],
    )
    report.data["interactive"] = {name: vars(t) for name, t in timing.items()}
    for name in ("raster", "image"):
        report.claim(
            f"{name} on Munich, once compiled", timing[name].median, INTERACTIVE, at_least=False, unit="s"
        )


def intensity_error_db(image: np.ndarray, reference: np.ndarray) -> float:
    """Relative error of the averaged intensities' square roots, dB: bright corners do not outweigh all the rest."""
    from sarmitsuba.signal.image import sliding_means

    a, b = (
        np.sqrt(sliding_means(np.abs(x).astype(np.float64) ** 2, (LOOKS, LOOKS), "reflect"))
        for x in (image, reference)
    )
    return float(10 * np.log10(np.sum((a - b) ** 2) / np.sum(b**2)))


def literature(quick: bool) -> list[tuple[str, float, float]]:
    """Seconds of hybrid, image and raster for 2 and 16 buildings on the same ground, warm."""
    from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
    from sarmitsuba.loading.load import load_scene
    from tests.support.city import make_city

    out: dict[str, list[float]] = {
        m: [] for m in (("image", "raster") if quick else ("hybrid", "image", "raster"))
    }
    with tempfile.TemporaryDirectory() as folder:
        for n in (2, 16):
            path = make_city(n, Path(folder), extent=128.0, resolution=0.5)
            scene = load_scene(path, parameters=PIXELS)
            for method, seconds in out.items():
                run_trial(scene, TrialSetting({"method": method}))
                seconds.append(run_trial(scene, TrialSetting({"method": method})).seconds)
    return [(m, s[0], s[1]) for m, s in out.items()]


PIXELS: dict[str, Any] = {
    "range_film.image_grid": "ground",
    "range_film.pixel_spacing_azimuth": "0.25",
    "range_film.pixel_spacing_range": "0.25",
}

if __name__ == "__main__":
    harness.main(run)
