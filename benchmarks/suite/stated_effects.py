"""What the plan of effects states against what happens: every effect of shipped and drawn scenes the other way.

``python -m benchmarks.suite.stated_effects [SCENE ...] [--draws N] [--drawn] [--blocks N] [--changes]``. Truth is the
focused image of the whole simulation, with the effect and without it, with the same blocks of pulses: energy of the
change over that of the image, worst channel. Every scene is made small (coarse resolution, a piece of the image), so
that a scene takes seconds; stated figures are those of ``explain`` for the same small scene, or (``--blocks``) what so
few blocks of pulses tell. Costs are processor seconds of simulating what is planned, least of a few rounds in turn.
"""

import tempfile
import time
import warnings
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.support import harness
from sarmitsuba.core.errors import SarmitsubaError, SarmitsubaWarning
from sarmitsuba.effects.effect import Decision
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.loading.library import list_scenes, resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.prediction.both_ways import (
    MOST_PLACES,
    measured_both_ways,
    share_of,
    switch_effect,
)
from sarmitsuba.simulation.planning.prediction.prediction import explain
from tests.support.unweighted import focus

# a shipped scene is made coarser by this, and no wider than so many of its resolution cells
COARSER, WIDEST = 2.0, 150.0
# drawn scenes of rough and metal boxes on ground
DRAWS = 10
# dB: wanted between stated and true, in so great a part, and most that may be understated
WITHIN, PART, UNDERSTATED = 2.0, 0.9, 3.0
# dB; weaker changes are float rounding, in truth and in what is stated
FLOOR = -90.0
# limits above the tolerance of effects that have their own, dB; docs/effects.md
OWN_LIMITS = {"diffuse_pairs": 20.0, "wideband": 10.0}
# shares of the run below which a cost is not compared by its ratio
LEAST_SHARE = 0.25
# of the timing; the least of each counts
ROUNDS = 3


@dataclass(frozen=True)
class Row:
    """An effect of a scene: what was decided and stated, and what is true."""

    scene: str
    decision: Decision
    tolerance_db: float
    true_db: float
    true_cost: float

    @property
    def excess(self) -> float:
        """Stated above true, dB."""
        return max(self.decision.error_db, FLOOR) - max(self.true_db, FLOOR)

    @property
    def idle(self) -> bool:
        """On, and changes nothing."""
        return self.decision.on and self.true_db <= FLOOR

    @property
    def missing(self) -> bool:
        """Off, and beyond its tolerance."""
        limit = self.tolerance_db + OWN_LIMITS.get(self.decision.name, 0.0)
        return not self.decision.on and self.decision.source != "user" and self.true_db > limit + 1.0

    def cells(self) -> list[str]:
        """For the table."""
        d = self.decision
        remark = "idle" if self.idle else "missing" if self.missing else ""
        cost = "" if np.isnan(d.cost) else f"{100 * d.cost:.0f} %"
        state = "on" if d.on else "off"
        stated = "?" if np.isnan(d.error_db) else f"{d.error_db:.1f}"
        return [
            self.scene,
            d.name,
            state if d.value is None else str(d.value),
            f"{stated} ({d.error_is})",
            f"{self.true_db:.1f}",
            cost,
            "" if np.isnan(self.true_cost) else f"{100 * self.true_cost:.0f} %",
            remark,
        ]


def small(scene: Scene) -> Scene:
    """The scene at a coarse resolution, no wider than some of its cells; as it is where it is small."""
    radar, image = scene.radar, scene.image
    cell = 0.5 * 299_792_458.0 / radar.waveform.bandwidth
    if max(image.extent_azimuth, image.extent_range) < 20.0 * cell:
        return scene
    extent = {
        name: min(value, WIDEST * COARSER * cell)
        for name, value in (
            ("image_extent_azimuth", image.extent_azimuth),
            ("image_extent_range", image.extent_range),
        )
    }
    spacing = {f"pixel_spacing_{axis}": 0.6 * COARSER * cell for axis in ("azimuth", "range")}
    return scene.replace(
        azimuth_resolution=COARSER * cell, bandwidth=radar.waveform.bandwidth / COARSER, **extent, **spacing
    )


def scenes(names: list[str], draws: int) -> Iterator[Scene]:
    """Shipped scenes with something to trace, then drawn ones."""
    from benchmarks.support import random_scenes

    for entry in list_scenes():
        if names and entry.name not in names:
            continue
        scene = load_scene(resolve(entry.name))
        if scene.traced:
            yield small(scene)
    for seed in range(draws):
        with tempfile.TemporaryDirectory() as folder:
            yield load_scene(random_scenes.draw_boxes(seed).write(Path(folder)))


def image_of(scene: Scene, plan: EffectsPlan) -> tuple[np.ndarray, int]:
    """Image (channels, azimuth, range) of a whole run, and the pulses that shared one tracing."""
    raw = simulate(scene, plan=plan)
    image = focus(raw)
    sampling = raw.metadata.get("sampling") or {}
    return np.stack([image.total(channel) for channel in image.channels]), int(sampling["key_pulse_interval"])


def seconds_of(*ways: tuple[Scene, EffectsPlan]) -> list[float]:
    """Processor seconds of simulating what is planned already, least of a few rounds in turn."""
    least = [np.inf] * len(ways)
    for _ in range(ROUNDS):
        for i, (scene, plan) in enumerate(ways):
            before = time.process_time()
            simulate(scene, plan=plan)
            least[i] = min(least[i], time.process_time() - before)
    return least


def rows_of(scene: Scene, places: int, costs: bool) -> Iterator[Row]:
    """Every effect of a scene that is not proven to change nothing, measured by whole runs."""
    run = Run(scene)
    base, interval = image_of(scene, run.plan)
    if places or not costs:
        clock = time.process_time if costs else None
        plan = measured_both_ways(run, scene, interval, clock=clock, most_places=places or MOST_PLACES)
    else:
        plan = explain(scene, measured=True).plan

    def alike(switched: Scene) -> Scene:
        """With the same blocks of pulses: their length has a line of its own in the plan."""
        if scene.settings.method == "raw":
            return switched
        return replace(switched, settings=replace(switched.settings, key_pulse_interval=interval))

    for decision in plan.decisions:
        if decision.error_db == -np.inf and not decision.measured:
            continue
        if decision.name in ("key_pulse_interval", "noise"):
            continue
        try:
            other = switch_effect(scene, decision)
            way = (alike(other), run.otherwise(other).plan)
            changed, _ = image_of(*way)
        except SarmitsubaError:  # nothing would be left
            continue
        if changed.shape != base.shape:
            continue
        change = np.square(np.abs(changed - base)).sum(axis=(1, 2), dtype=np.float64)
        energy = np.square(np.abs(base)).sum(axis=(1, 2), dtype=np.float64)
        true = float(np.max(change / energy))
        seconds, otherwise = seconds_of((alike(scene), run.plan), way) if costs else (np.nan, np.nan)
        yield Row(
            scene.name,
            decision,
            scene.settings.tolerance_db,
            10.0 * float(np.log10(max(true, 1e-30))),
            share_of(decision.on, seconds, otherwise) if costs else np.nan,
        )


def claims(rows: list[Row]) -> list[list[str]]:
    """What is wanted and what was found."""
    measured = [row for row in rows if row.decision.measured]
    bounds = [row for row in rows if not row.decision.measured]
    near = [row for row in measured if abs(row.excess) <= WITHIN]
    under = [row for row in rows if row.excess < -UNDERSTATED]
    costs = [
        row
        for row in measured
        if max(row.true_cost, row.decision.cost) >= LEAST_SHARE and not np.isnan(row.decision.cost)
    ]
    fair = [
        row
        for row in costs
        if max(row.true_cost, 1e-3) <= 1.5 * max(row.decision.cost, 1e-3)
        and row.decision.cost <= 1.5 * max(row.true_cost, 1e-3)
    ]

    def named(some: list[Row]) -> str:
        return "; ".join(f"{row.scene} {row.decision.name}" for row in some) or "none"

    return [
        [f"measured, within {WITHIN:g} dB", f"{len(near)} of {len(measured)}", f"{100 * PART:.0f} %"],
        [
            f"understated by more than {UNDERSTATED:g} dB",
            f"{len(under)} of {len(rows)}: {named(under)}",
            "none",
        ],
        ["upper bounds", f"{len(bounds)}", ""],
        ["on, and changes nothing", named([r for r in rows if r.idle]), "none"],
        [
            f"of these, takes {100 * LEAST_SHARE:.0f} % and more",
            named([r for r in rows if r.idle and r.true_cost >= LEAST_SHARE]),
            "none",
        ],
        ["off, and beyond its tolerance", named([r for r in rows if r.missing]), "none"],
        [
            f"cost of {100 * LEAST_SHARE:.0f} % and more within a factor 1.5",
            f"{len(fair)} of {len(costs)}",
            "all",
        ],
    ]


def study(names: list[str], draws: int, places: int = 0, costs: bool = True) -> harness.Report:
    """All scenes."""
    rows: list[Row] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)  # of what is switched off
        for scene in scenes(names, draws):
            for row in rows_of(scene, places, costs):
                print(" | ".join(row.cells()), flush=True)
                rows.append(row)
    report = harness.Report(
        "stated_effects",
        "Stated and true effects",
        "Every effect switched the other way: change of the image as `explain` states it, and of the focused images of "
        "whole runs, dB of the image's energy. Scenes at half their resolution, and drawn ones.",
    )
    report.table("Wanted", ["", "found", "wanted"], claims(rows))
    report.table(
        "Effects",
        ["scene", "effect", "", "stated, dB", "true, dB", "cost stated", "cost true", ""],
        [row.cells() for row in rows],
    )
    return report


@harness.benchmark
def run(quick: bool) -> harness.Report:
    return study(["dihedral", "tower"] if quick else [], 1 if quick else DRAWS)


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help="names of shipped scenes (default: all)")
    parser.add_argument("--drawn", action="store_true", help="drawn scenes alone")
    parser.add_argument("--draws", type=int, default=DRAWS, help="drawn scenes")
    parser.add_argument("--blocks", type=int, default=0, help="state from so many blocks of pulses at most")
    parser.add_argument("--changes", action="store_true", help="costs are not timed")
    args: Namespace = parser.parse_args()
    names = ["none"] if args.drawn else args.scenes
    print(study(names, args.draws, args.blocks, not args.changes).markdown())


if __name__ == "__main__":
    main()
