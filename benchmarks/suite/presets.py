"""Noise-equivalent sigma0 of the shipped radars: predicted, measured from focused noise, and published."""

import warnings

import numpy as np

from benchmarks.support import harness
from sarmitsuba.analysis.link_budget import link_budget
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.library import list_radars
from sarmitsuba.truth.validation.cases.link import measure_noise, preset_scene

# dB, as the sources in the radars' files have it
PUBLISHED = {
    "sentinel1_stripmap": "-22 at most, over 80 km",
    "terrasar_spotlight": "-19 at most",
    "iceye_spotlight": "-18 to -15",
    "airborne_l_band": "below -50",
}
DRAWS, QUICK_DRAWS = 6, 2  # of four channels: a sigma of 0.05 dB, 0.08 dB


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "presets",
        "Shipped radars",
        "Noise-equivalent sigma0 and signal-to-noise ratio of 1 m^2, in dB, in an image with Taylor windows: as "
        "`sarmitsuba link` predicts them, and from the focused noise of an empty scene and a focused point. In the "
        "beam's centre, and aimed beyond the point, 3.6 dB down in elevation. Idealised radars, without noise of their "
        "own, are given 580 K.",
    )
    rows, worst = [], 0.0
    for name in (entry.name for entry in list_radars()):
        for place in ("centre", "off"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SarmitsubaWarning)
                scene = preset_scene(name, off=place == "off")
                if place == "off" and scene.radar.antenna.pattern == "isotropic":
                    continue
                middle = link_budget(scene).middle
                predicted = 10.0 * np.log10([middle.nesz, middle.snr])
                found = 10.0 * np.log10(measure_noise(scene, "taylor", QUICK_DRAWS if quick else DRAWS))
            worst = max(worst, float(np.abs(found - predicted).max()))
            numbers = (predicted[0], found[0], predicted[1], found[1])
            published = PUBLISHED.get(name, "-") if place == "centre" else ""
            rows.append([name, place, *(f"{value:.2f}" for value in numbers), published])
    columns = [
        "radar",
        "beam",
        "NESZ predicted",
        "NESZ measured",
        "SNR predicted",
        "SNR measured",
        "NESZ published",
    ]
    report.table("", columns, rows)
    report.claim("largest deviation of the prediction", worst, 0.3, at_least=False, unit="dB")
    return report


if __name__ == "__main__":
    harness.main(run)
