"""What each bounce buys: image error and time by bounce depth, on tower, bridge, urban block and Munich."""

from typing import Any

import numpy as np

from benchmarks.support import harness

# what comes back after the eighth bounce is below float32's rounding in all four scenes
DEEPEST = 8
DEPTHS = (1, 2, 3, 4, 5, 6, 8)
# bounces of the pictures, and the span of their grey levels below the brightest percent, dB
SHOWN, SPAN_DB = (1, 2, 3, 4), 45.0
# of the pulses: the middle of the aperture is enough for energies, and a quarter of the time
PULSES = {"tower": 0.25, "bridge": 0.25, "urban_block": 0.25, "Munich": 0.25}


def scenes(quick: bool) -> dict[str, Any]:
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.simulation.planning.sampling.piece import crop

    found = {name: load_scene(name) for name in (("tower",) if quick else ("tower", "bridge", "urban_block"))}
    city = None if quick else harness.load_munich()
    if city is not None:
        found["Munich"] = city
    return {n: crop(s, 0.2 if quick else 1.0, 0.03 if quick else PULSES[n]) for n, s in found.items()}


def pictures(name: str, layers: np.ndarray, seconds: list[float]) -> Any:
    """Image of each depth above what its last bounce adds, on one grey scale; titled with what the depth costs."""
    figure, axes = harness.new_figure(3.0 * len(SHOWN), 6.4, len(SHOWN), 2)
    total = np.abs(layers.sum(axis=0))
    top = 20.0 * np.log10(np.percentile(total, 99.0))
    for depth, (above, below) in zip(SHOWN, axes.T, strict=True):
        for ax, image in ((above, layers[:depth].sum(axis=0)), (below, layers[depth - 1])):
            level = 20.0 * np.log10(np.maximum(np.abs(image), 1e-30)) - top
            ax.imshow(level, cmap="gray", vmin=-SPAN_DB, vmax=0.0, origin="lower", aspect="auto")
            ax.set(xticks=[], yticks=[])
            ax.grid(False)
        above.set_title(f"up to bounce {depth}: {seconds[depth - 1]:.2f} s", fontsize=9)
        below.set_title(f"bounce {depth} alone", fontsize=9)
    figure.suptitle(f"{name}: range to the right, azimuth up, {SPAN_DB:g} dB", fontsize=10)
    return figure


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.apps.depth import study_depth

    report = harness.Report(
        "bounce_depth",
        "Bounce depth",
        f"Error of the image that stops after d bounces against all {DEEPEST}, from one run that keeps the bounces "
        "apart (same rays, so ray sampling does not mask the bounces), as `sarmitsuba depth` measures it. `changed` is "
        "the share of pixels that bounce d changes by more than 1 dB. Seconds are of a run of its own with that depth, "
        "without compiling, on the middle part of the aperture. Beyond a depth at which no path is left the error is "
        "zero.",
    )
    figure, (left, right) = harness.new_figure(10.0, 4.4, 2)
    for name, scene in scenes(quick).items():
        study = study_depth(scene, deepest=3 if quick else DEEPEST)
        layers = np.stack([study.image_of(n).total() for n in range(1, len(study.rows) + 1)])
        kept = [r for r in study.rows if r.bounces in DEPTHS]
        rows = [[r.bounces, r.error_db, r.energy_db, 100.0 * r.changed, r.seconds] for r in kept]
        report.table(
            name,
            ["bounces", "error dB", "energy of bounce dB", "changed %", "seconds"],
            [
                [
                    r[0],
                    "none" if r[1] < -100 else f"{r[1]:.1f}",
                    "none" if r[2] < -200 else f"{r[2]:.1f}",
                    f"{r[3]:.1f}",
                    f"{r[4]:.2f}",
                ]
                for r in rows
            ],
        )
        report.data[name] = rows
        shown = [r for r in rows if r[1] > -100]
        if name in ("urban_block", "Munich"):
            report.figure(name, pictures(name, layers, [r[4] for r in rows]))
        left.plot([r[0] for r in shown], [r[1] for r in shown], "o-", label=name)
        right.plot([r[0] for r in rows], [r[4] / rows[0][4] for r in rows], "o-", label=name)
    left.set(
        xlabel="bounces traced", ylabel="error of the image (dB)", title="What the bounces left out cost"
    )
    right.set(xlabel="bounces traced", ylabel="time, one bounce = 1", title="What the bounces cost")
    left.axhline(-40, color="0.6", ls="--", lw=0.8)
    left.legend()
    right.set_ylim(bottom=0)
    report.figure("error_time", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
