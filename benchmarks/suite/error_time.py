"""What accuracy costs: error against seconds on the shipped city and on Munich, one setting varied at a time."""

from typing import Any, NamedTuple

import numpy as np

from benchmarks.suite.methods import intensity_error_db
from benchmarks.suite.speed import thinned
from benchmarks.support import harness
from sarmitsuba.apps.cost_report import pareto
from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
from sarmitsuba.loading.load import load_scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.piece import crop
from tests.support.unweighted import focus

FACTORS = (4.0, 2.83, 2.0, 1.41, 1.0, 0.71)
DEPTHS = tuple(range(1, 9))
INTERVALS = (512, 256, 128, 64, 32, 16)
INTERPOLATIONS = ("linear", "kernel:4", "kernel:6", "kernel:8")
# of the reference: rays relative to the automatic spacing, pulses between key pulses, and bounces
REFERENCE_FACTOR, REFERENCE_DEPTH = 0.5, 10
REFERENCE_INTERVAL = {"urban_block": 16, "Munich": 32}
# raw on Munich is traced on every 64th pulse, and its time scaled
RAW_EVERY = {"urban_block": 8, "Munich": 64}
MARKS = {
    "ray spacing": ("o", "C0"),
    "bounces": ("s", "C1"),
    "key-pulse interval": ("^", "C2"),
    "interpolation": ("x", "C3"),
    "method": ("D", "C4"),
}


class Point(NamedTuple):
    """One run: what was varied, to what, its seconds and its error, dB."""

    curve: str
    value: str
    seconds: float
    error_db: float


def scenes(quick: bool) -> dict[str, Any]:
    block = load_scene("urban_block")
    if quick:
        return {"urban_block": crop(block, 0.3, 0.1)}
    city = harness.load_munich()
    return {"urban_block": block} | ({"Munich": city} if city is not None else {})


class Study:
    """Runs of one scene against one converged reference of the same scatterers."""

    def __init__(self, name: str, scene: Any, quick: bool) -> None:
        self.name, self.scene, self.quick = name, scene, quick
        self.grid = default_grid(scene.radar, scene.image)
        plan = plan_scene(scene)
        sampling = SamplingPlan.of(scene, plan.flags)
        self.rays = sampling.spacings
        self.auto = TrialSetting({"method": "hybrid", "scatterer_cell": sampling.scatterer_cell})
        depth = max(REFERENCE_DEPTH, plan.max_depth)
        dense = self.auto.but(
            max_depth=depth,
            key_pulse_interval=REFERENCE_INTERVAL[name],
            **self.rays.at(1.0 if quick else REFERENCE_FACTOR),
        )
        self.reference_raw = echoes(Run(dense.apply(scene)), pass_index=1000)
        self.reference = focus(self.reference_raw, self.grid, focuser="backprojection").total()
        run_trial(scene, self.auto, self.grid)  # kernels compiled, memory touched
        self.base = run_trial(scene, self.auto, self.grid)
        self.automatic = Point("automatic", "all", self.base.seconds, self.base.error_db(self.reference))
        self.depth = plan.max_depth
        self.points: list[Point] = []

    def run(self, curve: str, value: object, **changes: Any) -> None:
        """Run the automatic setting with some changes."""
        trial = run_trial(self.scene, self.auto.but(**changes), self.grid)
        self.points.append(Point(curve, str(value), trial.seconds, trial.error_db(self.reference)))

    def sweep(self) -> None:
        """All curves."""
        few = 2 if self.quick else None
        for factor in FACTORS[:few]:
            self.run("ray spacing", f"{factor:g} x", **self.rays.at(factor))
        for depth in DEPTHS[:few]:
            self.run("bounces", depth, max_depth=depth)
        pulses = self.scene.radar.track.n_pulses
        for interval in [k for k in INTERVALS if k < pulses][:few]:
            self.run("key-pulse interval", interval, key_pulse_interval=interval)
        self._interpolations(few)
        self._methods()

    def _interpolations(self, few: int | None) -> None:
        """The automatic run's echoes, focused with other interpolations; the median of some rounds."""
        rounds = harness.ROUNDS_QUICK if self.quick else harness.ROUNDS
        for name in INTERPOLATIONS[:few]:
            setting = self.auto.but(interpolation=name)
            trials = [run_trial(self.scene, setting, self.grid, echoes_of=self.base) for _ in range(rounds)]
            seconds = float(np.median([trial.seconds for trial in trials]))
            self.points.append(Point("interpolation", name, seconds, trials[0].error_db(self.reference)))

    def _methods(self) -> None:
        """The other methods; raw on some pulses against the reference's echoes of the same, its time scaled."""
        self.run("method", "image", method="image")
        raster = run_trial(self.scene, self.auto.but(method="raster"), self.grid)
        error = intensity_error_db(raster.image, self.reference)
        self.points.append(Point("method", "raster (averaged intensity)", raster.seconds, error))
        every = RAW_EVERY[self.name]
        few = thinned(self.auto.but(method="raw").apply(self.scene), every)
        raw = simulate(few)
        pick = slice(every // 2, None, every)
        # the window of the few pulses may begin elsewhere
        shared = self.reference_raw.data[:, pick]
        n = min(raw.data.shape[-1], shared.shape[-1])
        error = image_error_db(raw.data[..., :n], shared[..., :n])
        traced = float(raw.metadata["seconds"]["trace"])
        scaled = self.base.seconds - self.base.stages["trace"] + traced * every
        self.points.append(Point("method", "raw (time scaled)", scaled, error))

    def front(self) -> list[Point]:
        """Pareto front by seconds; the averaged intensity is of another kind."""
        return pareto([p for p in (*self.points, self.automatic) if "averaged" not in p.value])

    def draw(self, axes: Any) -> None:
        """Curves, Pareto front and the automatic setting."""
        for curve, (mark, color) in MARKS.items():
            found = [p for p in self.points if p.curve == curve]
            joined = "none" if curve == "method" else "-"
            seconds, errors = [p.seconds for p in found], [p.error_db for p in found]
            axes.semilogx(seconds, errors, mark, ls=joined, color=color, ms=5, lw=1.0, label=curve)
            named = found if curve == "method" else found[:1] + found[-1:]
            for p in named:
                axes.annotate(
                    p.value.partition(" (")[0],
                    (p.seconds, p.error_db),
                    textcoords="offset points",
                    xytext=(4, 4),
                    fontsize=7,
                    color=color,
                )
        front = self.front()
        axes.step(
            [p.seconds for p in front],
            [p.error_db for p in front],
            where="post",
            color="0.3",
            lw=3,
            alpha=0.35,
            label="Pareto front",
        )
        best = self.automatic
        axes.plot(best.seconds, best.error_db, "*", color="k", ms=13, label="automatic settings")
        axes.set(title=self.name, xlabel="seconds: simulation and focusing, without compiling")
        axes.set_ylabel("error against the converged image (dB)")


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "error_time",
        "Error against seconds",
        "One setting at a time, all others automatic, against a converged image of the same random scatterers: "
        f"{1 / REFERENCE_FACTOR**2:g} times the rays in another lattice, {REFERENCE_DEPTH} bounces, a key pulse every "
        f"{REFERENCE_INTERVAL['urban_block']} pulses (Munich: {REFERENCE_INTERVAL['Munich']}). `raster` is "
        "incoherent: its error is of averaged intensities. `raw` is traced on some pulses, its time scaled and "
        "its error that of their echoes. "
        "**Bold**: on the Pareto front.",
    )
    found = scenes(quick)
    figure, axes = harness.new_figure(6.2 * len(found), 5.0, len(found))
    for (name, scene), ax in zip(found.items(), np.atleast_1d(axes), strict=True):
        study = Study(name, scene, quick)
        study.sweep()
        best, front = study.automatic, study.front()
        report.table(
            f"{name}: automatic settings {best.error_db:.1f} dB in {best.seconds:.2f} s "
            f"({study.depth} bounces, a key pulse every {study.base.key_pulse_interval} pulses)",
            ["varied", "value: error dB, seconds"],
            [
                [
                    curve,
                    "; ".join(
                        ("**{}**" if p in front else "{}").format(
                            f"{p.value}: {p.error_db:.1f}, {p.seconds:.2f}"
                        )
                        for p in study.points
                        if p.curve == curve
                    ),
                ]
                for curve in MARKS
            ],
        )
        report.data[name] = [p._asdict() for p in (best, *study.points)]
        study.draw(ax)
    np.atleast_1d(axes)[0].legend(fontsize=8)
    report.figure("front", figure)
    return report


if __name__ == "__main__":
    harness.main(run)
