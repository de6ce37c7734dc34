"""The error that ray subsets and passes state, against the true one, over scenes, densities and ways to share rays."""

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.support import harness
from benchmarks.support.denser_runs import DENSER, MOST_PASSES, TARGETS, converged, drawn_scene

if TYPE_CHECKING:
    pass

FACTORS = (0.71, 1.0, 1.41)  # of the automatic ray spacing
REFERENCE, REFERENCE_RUNS = 0.25, 4
RUNS = 9  # lattices of their own: 108 runs over all scenes
# share of the image; the whole aperture, as in a run: a part of it has longer cells, and fewer of them
PIECES = {"tower": 0.5, "buildings16": 0.35, "urban_block": 0.3, "bridge": 0.35}
TOLERANCE = 1.5  # dB
# passes over boxes on ground, drawn by seed (the constant of the estimate was chosen with seeds 0 to 15 and the scenes
# above): `refine` until a target drawn from this range, against runs of eight times the rays of its last pass
FIRST, COUNT = 400, 24
# pixels that share the error: where fewer do, its size is one draw's
SPREAD = 150.0
# ways to share out the coherent rays; the first is what is shipped
DESIGNS = {
    "1 : 1": (0.5, 0.5),
    "3 : 1": (0.75, 0.25),
    "2 : 1 : 1": (0.5, 0.25, 0.25),
    "1 : 1 : 1": (1 / 3, 1 / 3, 1 / 3),
    "1 : 1 : 1 : 1": (0.25, 0.25, 0.25, 0.25),
}


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.simulation.execution.error_bars import SHARED_DB

    report = harness.Report(
        "error_bars",
        "Error bars",
        "Whole-image sampling error estimated from two ray subsets, against the true error: the distance to the "
        f"mean of {REFERENCE_RUNS} runs at {REFERENCE:g} of the automatic spacing with lattices of their own. One look "
        f"(`image`) over the whole aperture. `factor` is on the automatic spacing. Every setting is run {RUNS} times "
        "with lattices of its own; `true` and `estimate` are means of their energies, `scatter` the standard deviation "
        f"of the true error over them, `within` counts runs whose own estimate is within {TOLERANCE:g} dB of their own "
        "truth. The estimate is half the difference of the two sets (half of the coherent "
        f"rays each) and {SHARED_DB:g} dB, one number for all.",
    )
    figure, axes = harness.new_figure(5.4, 5.0)
    rows = []
    for name, share in {"tower": 0.5}.items() if quick else PIECES.items():
        mine = _rows(load_scene(name), name, share, (1.0,) if quick else FACTORS, 3 if quick else RUNS)
        rows += mine
        true = np.concatenate([r["true"] for r in mine])
        axes.plot(true, np.concatenate([r["estimate"] for r in mine]), "o", label=name, mfc="none", ms=4)
    _settings(report, rows)
    _designs(report, rows)
    every = np.concatenate([r["true"] for r in rows])
    limits = [every.min() - 3, every.max() + 3]
    axes.plot(limits, limits, "k-", lw=0.8)
    band = [[v + side * TOLERANCE for v in limits] for side in (-1, 1)]
    axes.fill_between(limits, *band, color="0.9", label=f"{TOLERANCE:g} dB")
    axes.set(
        xlabel="true error (dB)", ylabel="estimate from two subsets (dB)", title="Error bars", aspect="equal"
    )
    axes.legend()
    report.figure("scatter", figure)
    _passes(report, 2 if quick else COUNT)
    return report


def _passes(report: harness.Report, count: int) -> None:
    """What `refine` states of drawn scenes, and the truth."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST, FIRST + count):
            row = _refined(seed, Path(folder) / str(seed))
            rows += [row] if row else []
            # the whole takes long: what is known of it is seen
            print(seed, *(row or {"": "left out"}).values(), file=sys.stderr, flush=True)
    report.table(
        "passes: `refine` of boxes on ground, drawn by seed, until a drawn target",
        [
            "seed",
            "target dB",
            "passes",
            "stated dB",
            "+-",
            "at most dB",
            "true dB",
            "difference dB",
            "subsets dB",
            "pixels",
        ],
        [
            [
                *(
                    r["seed"],
                    f"{r['target']:.1f}",
                    r["passes"],
                    f"{r['stated']:.1f}",
                    f"{r['confidence']:.1f}",
                ),
                *(f"{r['at_most']:.1f}", f"{r['true']:.1f}", f"{r['stated'] - r['true']:+.1f}"),
                *(f"{r['subsets']:.1f}", f"{r['pixels']:.0f}"),
            ]
            for r in rows
        ],
    )
    report.data["passes"] = rows
    true, stated, at_most, confidence, pixels, subsets = (
        np.array([r[k] for r in rows])
        for k in ("true", "stated", "at_most", "confidence", "pixels", "subsets")
    )
    off = stated - true
    near = np.abs(off) <= TOLERANCE
    report.claim(f"passes within {TOLERANCE:g} dB", share(near), 90.0, at_least=True, unit="%")
    report.claim("true error at most as stated", share(true <= at_most), 90.0, at_least=True, unit="%")
    report.claim(
        "passes within two of their standard deviations",
        share(np.abs(off) <= 2 * confidence),
        90.0,
        at_least=True,
        unit="%",
    )
    wide = pixels >= SPREAD
    report.notes.append(
        f"Passes: {share(near):.0f} % of {len(rows)} runs lie within {TOLERANCE:g} dB (median {np.median(off):+.1f} "
        f"dB, rms {np.sqrt(np.mean(off**2)):.1f} dB), {share(near[wide]) if wide.any() else np.nan:.0f} % of the "
        f"{wide.sum()} whose error {SPREAD:g} pixels or more share; the two sets of rays of the same passes say "
        f"{np.median(subsets - true):+.1f} dB in the middle, {share(np.abs(subsets - true) <= TOLERANCE):.0f} % within."
    )


def share(which: "np.ndarray[Any, np.dtype[np.bool_]]") -> float:
    """Per cent that are true."""
    return 100.0 * float(np.mean(which))


def _refined(seed: int, folder: Path) -> dict[str, Any] | None:
    """Stated and true error of one scene after its passes; None where its truth would cost too much."""
    from sarmitsuba.signal.metrics import image_error_db
    from sarmitsuba.simulation.execution.error_bars import (
        PASSES_SCATTER_DB,
        PIXELS_TOGETHER,
        estimate_error,
    )
    from sarmitsuba.simulation.execution.run import Run
    from tests.support.unweighted import refine

    # bounces and blocks of pulses as in all of the passes: their error is not the rays'
    scene = drawn_scene(seed, folder)
    if scene is None:
        return None
    target = float(np.random.default_rng([seed, 0xBA]).uniform(*TARGETS))
    done = refine(scene, target_error_db=target, max_passes=MOST_PASSES)
    level = done.passes - 1
    reference = converged(Run(scene).at(2.0 ** (-0.5 * (level + DENSER))), done.image.grid)
    bar = next(iter(done.image.metadata["sampling_error"].values()))
    channel = done.image.channels[0]
    chance = bar["confidence_db"] ** 2 - PASSES_SCATTER_DB**2
    return {
        "seed": seed,
        "target": target,
        "passes": done.passes,
        "stated": bar["error_db"],
        "confidence": bar["confidence_db"],
        "at_most": bar.get("at_most_db", np.nan),
        "true": float(image_error_db(done.image.total(channel), reference)),
        "subsets": estimate_error(done.image.data, done.image.layers, pixels=False).error_db[0],
        "pixels": PIXELS_TOGETHER * (10.0 / np.log(10.0)) ** 2 / max(chance, 1e-9),
        "met": done.met,
    }


def _settings(report: harness.Report, rows: list[dict]) -> None:  # type: ignore[type-arg]
    """The shipped estimate, setting by setting."""
    table = []
    for r in rows:
        off = np.array(r["estimate"]) - np.array(r["true"])
        r["within"] = int((np.abs(off) <= TOLERANCE).sum())
        figures = [mean_db(r["estimate"]), mean_db(r["true"]), float(np.std(r["true"]))]
        spread = f"{off.min():+.1f} ... {off.max():+.1f}"
        row = [r["scene"], r["factor"], *(f"{v:.1f}" for v in figures), f"{figures[0] - figures[1]:+.2f}"]
        table.append([*row, spread, f"{r['within']} of {off.size}"])
    head = ["estimate dB", "true dB", "scatter dB", "difference dB", "single runs dB", "within"]
    report.table("", ["scene", "factor", *head], table)
    report.data["rows"] = rows
    off = np.concatenate([np.array(r["estimate"]) - np.array(r["true"]) for r in rows])
    within = 100.0 * float(np.mean(np.abs(off) <= TOLERANCE))
    near = [abs(mean_db(r["estimate"]) - mean_db(r["true"])) <= TOLERANCE for r in rows]
    report.claim(
        f"settings within {TOLERANCE:g} dB, mean of their runs",
        100.0 * float(np.mean(near)),
        90.0,
        at_least=True,
        unit="%",
    )
    report.claim(f"single runs within {TOLERANCE:g} dB", within, 90.0, at_least=True, unit="%")
    report.notes.append(
        f"{within:.0f} % of {off.size} single runs lie within {TOLERANCE:g} dB; "
        f"rms {np.sqrt(np.mean(off**2)):.1f} dB, mean {off.mean():+.1f} dB. "
        "One run is one draw of its lattices, whose true error scatters by itself (bridge), "
        "and what all lattices of a density blur alike is not in any difference (ends of bright lines)."
    )


def _designs(report: harness.Report, rows: list[dict]) -> None:  # type: ignore[type-arg]
    """Every way to share the rays with the best constant of its own."""
    table = []
    for design in DESIGNS:
        off = [np.array(r["designs"][design]) for r in rows]
        every = np.concatenate(off)
        constant = float(np.median(every))
        within = [100.0 * float(np.mean(np.abs(o - c) <= TOLERANCE)) for o, c in ((every, constant),)]
        own = 100.0 * float(np.mean(np.abs(np.concatenate([o - np.median(o) for o in off])) <= TOLERANCE))
        level = mean_db([v for r in rows for v in r["levels"][design]])
        table.append(
            [design, f"{-constant:.1f}", f"{every.std():.1f}", f"{within[0]:.0f} %", f"{own:.0f} %", level]
        )
    head = ["best constant dB", "rms dB", "within", "within, a constant per setting", "true error dB"]
    report.table("ways to share the coherent rays", ["sets", *head], table)


def _rows(whole, name: str, share: float, factors, runs: int) -> list[dict]:  # type: ignore[no-untyped-def, type-arg]
    """True and estimated error of every run, by factor."""
    from sarmitsuba.apps.cost_trials import TrialSetting, mean_image
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.signal.raw_data import Layer
    from sarmitsuba.simulation.execution.error_bars import estimate_error
    from sarmitsuba.simulation.execution.image import Imager
    from sarmitsuba.simulation.execution.run import Run
    from sarmitsuba.simulation.planning.pilot import plan_scene
    from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
    from sarmitsuba.simulation.planning.sampling.piece import crop

    plan = plan_scene(whole)
    sampling = SamplingPlan.of(whole, plan.flags)
    rays = sampling.spacings
    scene = crop(whole, share)
    grid = default_grid(scene.radar, scene.image)
    # as many bounces in all runs: their error is not the rays'
    base = TrialSetting(
        {"method": "image", "scatterer_cell": sampling.scatterer_cell, "max_depth": plan.max_depth}
    )
    reference = mean_image(scene, base.but(**rays.at(REFERENCE)), grid, REFERENCE_RUNS)
    layers = (Layer(scene.radar.channels[0], 0, 1), Layer(scene.radar.channels[0], 0, 2))
    rows = []
    for factor in factors:
        planes = {}
        for part in sorted({v for design in DESIGNS.values() for v in design}):
            # a set has its share of the coherent rays and all of the diffuse ones
            spacings = rays.at(factor)
            spacings["ray_spacing"] /= np.sqrt(part)
            imager = Imager(Run(base.but(**spacings).apply(scene)), grid)
            first = round(1000 * part)
            planes[part] = [imager.image(pass_index=100 * first + i).total() for i in range(runs)]
        row = {"scene": name, "factor": factor, "true": [], "estimate": [], "designs": {}, "levels": {}}
        for label, design in DESIGNS.items():
            offsets, levels = [], []
            for i in range(runs):
                # other draws for sets of one density
                sets = [planes[part][(i + 2 * j) % runs] for j, part in enumerate(design)]
                mean = sum(part * x for part, x in zip(design, sets, strict=True))
                power = float(np.sum(np.abs(mean) ** 2))
                true = 10.0 * np.log10(np.sum(np.abs(mean - reference) ** 2) / power)
                inner = sum(
                    part * np.sum(np.abs(x - mean) ** 2) for part, x in zip(design, sets, strict=True)
                )
                offsets.append(float(10.0 * np.log10(inner / (len(sets) - 1) / power) - true))
                levels.append(float(true))
                if label == next(iter(DESIGNS)):
                    data = np.stack([part * x for part, x in zip(design, sets, strict=True)])
                    bars = estimate_error(data.astype(np.complex64), layers, pixels=False)
                    row["estimate"].append(bars.error_db[0])
                    row["true"].append(float(true))
            row["designs"][label], row["levels"][label] = offsets, levels
        rows.append(row)
    return rows


def mean_db(values: list[float]) -> float:
    """Mean of energies given in dB."""
    return 10.0 * float(np.log10(np.mean(10.0 ** (np.array(values) / 10.0))))


if __name__ == "__main__":
    harness.main(run)
