"""The error that ray subsets estimate, against the true error, over scenes, densities and ways to share the rays."""

import harness
import numpy as np

FACTORS = (0.71, 1.0, 1.41)  # of the automatic ray spacing
REFERENCE, REFERENCE_RUNS = 0.25, 4
RUNS = 9  # lattices of their own: 108 runs over all scenes
# share of the image; the whole aperture, as in a run: a part of it has longer cells, and fewer of them
PIECES = {"tower": 0.5, "buildings16": 0.35, "urban_block": 0.3, "bridge": 0.35}
TOLERANCE = 1.5  # dB
# ways to share out the coherent rays; the first is what is shipped
DESIGNS = {
    "3 : 1": (0.75, 0.25),
    "1 : 1": (0.5, 0.5),
    "2 : 1 : 1": (0.5, 0.25, 0.25),
    "1 : 1 : 1": (1 / 3, 1 / 3, 1 / 3),
    "1 : 1 : 1 : 1": (0.25, 0.25, 0.25, 0.25),
}


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.simulation.refinement.error_bars import SHARED_DB

    report = harness.Report(
        "error_bars",
        "Error bars",
        "Whole-image sampling error estimated from two ray subsets, against the true error: the distance to the "
        f"mean of {REFERENCE_RUNS} runs at {REFERENCE:g} of the automatic spacing with lattices of their own. One look "
        f"(`image`) over the whole aperture. `factor` is on the automatic spacing. Every setting is run {RUNS} times "
        "with lattices of its own; `true` and `estimate` are means of their energies, `scatter` the standard deviation "
        f"of the true error over them, `within` counts runs whose own estimate is within {TOLERANCE:g} dB of their own "
        "truth. The estimate is half the difference of the two sets (three quarters and a quarter of the coherent "
        f"rays) and {SHARED_DB:g} dB, one number for all.",
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
    return report


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
    from sarmitsuba.cost.trial import Setting, mean_image
    from sarmitsuba.echo.raw import Layer
    from sarmitsuba.focusing import default_grid
    from sarmitsuba.simulation.image import Imager
    from sarmitsuba.simulation.pilot import plan_scene
    from sarmitsuba.simulation.refinement.error_bars import estimate_error
    from sarmitsuba.simulation.run import Run
    from sarmitsuba.simulation.sampling.piece import crop
    from sarmitsuba.simulation.sampling.plan import SamplingPlan

    plan = plan_scene(whole)
    sampling = SamplingPlan.of(whole, plan.flags)
    rays = sampling.spacings
    scene = crop(whole, share)
    grid = default_grid(scene.radar, scene.image)
    # as many bounces in all runs: their error is not the rays'
    base = Setting(
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
