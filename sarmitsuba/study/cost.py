"""What accuracy costs on the user's own scene: one sweep a parameter, a model of both, the cheapest setting."""

import itertools
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import DataError, SarmitsubaError
from sarmitsuba.focus import default_grid
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.progress import Progress, silent
from sarmitsuba.scene.spec import Scene
from sarmitsuba.study.cost_report import Candidate, CostReport, Rays, Row
from sarmitsuba.study.sweep import Setting, Trial, crop, mean_image, run_trial
from sarmitsuba.trace.pilot import plan_scene
from sarmitsuba.trace.window import launch_window, ray_spacing, scatterer_cell

# deepest bounce of the reference; what comes later has been weaker than -40 dB in every shipped scene
REFERENCE_DEPTH = 6
# share of the budget for the sweeps; the rest is for the full scene and the check of the recommendation
SWEEP_SHARE = 0.6
# cost of all sweeps and of the reference, in runs of the plain setting
SWEEP_RUNS = 60.0
# error that counts as none: float32 and the reference's own
FLOOR_DB = -80.0
# a smaller gain in error is not worth a line of its own, nor any time
STEP_DB = 0.5
# stages whose time a parameter changes; what else differs between two runs is the machine's mood
AFFECTS = {
    "ray_spacing": ("rays", "launch grid"),
    "max_depth": ("rays",),
    "gridding_width": ("launches", "rays", "synthesise"),
    "key_pulse_interval": ("launches", "rays", "synthesise"),
    "focuser": ("focus",),
}
# pieces of a scene to choose from: share of the image's extents, share of the pulses
_PIECES = (
    (1.0, 1.0),
    (0.7, 1.0),
    (0.5, 1.0),
    (0.35, 1.0),
    (0.35, 0.5),
    (0.25, 0.5),
    (0.25, 0.25),
    (0.15, 0.25),
)


@dataclass
class _Study:
    scene: Scene
    grid: ImageGrid
    base: Setting
    plain: Trial
    whole: Trial
    n_pulses: int  # of the whole scene
    launch_seconds: float  # of one launch, whatever its rays
    deadline: float
    report: Progress
    budget: float
    rows: list[Row] = field(default_factory=list)
    now: Trial | None = None
    errors: dict[tuple[str, Any], float] = field(default_factory=dict)
    ratios: dict[tuple[str, Any], dict[str, float]] = field(default_factory=dict)

    def left(self) -> float:
        return self.deadline - time.perf_counter()

    def run(self, **changes: Any) -> Trial:
        trial = run_trial(self.scene, self.base.but(**changes), self.grid)
        self.report("cost", self.budget - max(self.left(), 0.0), self.budget, {})
        return trial

    def refresh(self, **changes: Any) -> None:
        """Run the plain setting again: ratios are to a run of the same minute, whatever else the machine does."""
        self.now = self.run(**changes)

    @property
    def full(self) -> dict[str, float]:
        """Seconds by stage of the plain setting on the whole scene."""
        return self.stages(self.whole)

    def stages(self, trial: Trial) -> dict[str, float]:
        """Seconds by stage, tracing split into what goes by launches and what goes by rays."""
        out = {k: v for k, v in trial.stages.items() if k != "trace"}
        seconds = trial.stages.get("trace", 0.0)
        launches = min(self.launch_seconds * trial.facts["statistics"].get("key_pulses", 0), 0.95 * seconds)
        return {**out, "launches": launches, "rays": seconds - launches}

    def full_seconds(self, ratios: Mapping[str, float]) -> float:
        return sum(self.full_stage(s) * r for s, r in ratios.items())

    def full_stage(self, stage: str) -> float:
        """Seconds of a stage of the plain setting on the whole scene; 1 for stages that it does not have."""
        return self.full.get(stage, 1.0)

    def _ratio(self, trial: Trial, parameter: str, value: Any) -> dict[str, float]:
        now, then = self.stages(trial), self.stages(self.now or self.plain)
        growth = self.whole.seconds / max(self.plain.seconds, 1e-9)
        out = {}
        for stage in {*now, *then}:
            a, b = now.get(stage, 0.0), then.get(stage, 0.0)
            # a stage that only this method has grows like the whole
            out[stage] = a / b if b > 1e-3 else (a * growth / self.full_stage(stage) if a else 0.0)
        if parameter == "key_pulse_interval":  # the piece's few pulses do not show it
            before = int(self.whole.facts["sampling"].get("key_pulse_interval", 1))
            launches = -(-self.n_pulses // value) / -(-self.n_pulses // before)
            out["launches"] = out["rays"] = launches
        return out

    def note(self, parameter: str, value: Any, trial: Trial, error_db: float, remark: str = "") -> None:
        """Put a trial into the table and the model."""
        shown = f"{value:.3g}" if isinstance(value, float) else str(value)
        error_db = max(error_db, FLOOR_DB)
        self.errors[parameter, value] = error_db
        self.ratios[parameter, value] = self._ratio(trial, parameter, value)
        megabytes = trial.peak_bytes / 1e6 if trial.peak_bytes >= 0 else float("nan")
        self.rows.append(
            Row(
                parameter,
                shown,
                error_db,
                trial.seconds,
                self.full_seconds(self.ratios[parameter, value]),
                megabytes,
                remark,
            )
        )

    def paired(self, parameter: str, values: Iterable[Any], best: Any) -> list[Any]:
        """Sweep a parameter with the same rays; errors are against its best value. Returns what was run."""
        if self.left() < 0.0:
            return []
        self.refresh()
        reference = self.run(**{parameter: best})
        self.note(parameter, best, reference, FLOOR_DB, "reference of its sweep")
        done = [best]
        for value in values:
            if self.left() < 0.0:
                break
            trial = self.run(**{parameter: value})
            self.note(parameter, value, trial, trial.error_db(reference.image))
            done.append(value)
        return done


def study_cost(
    scene: Scene,
    *,
    target_error_db: float = -20.0,
    budget: float = 300.0,
    progress: Progress | None = None,
) -> CostReport:
    """Sweep every parameter that trades accuracy for time, within a budget, and recommend a setting.

    Parameters
    ----------
    scene : as loaded; its explicit settings are the plain setting
    target_error_db : energy of the error over that of the image, dB
    budget : s; large scenes are swept on a piece from the middle of the image
    progress : called after every run

    Returns
    -------
    CostReport

    Notes
    -----
    Assumes that the errors of different parameters are independent, so that their energies add up, that each
    parameter scales the time of a stage by a factor of its own, and that the piece stands for the whole. The check at
    the end runs the recommendation itself. Errors of the scattering model are not in any of this.
    """
    begin = time.perf_counter()
    deadline = begin + budget
    report = progress or silent
    plan = plan_scene(scene)
    # in metres, so that a piece of the aperture, which resolves less, is sampled as the whole scene is
    rays = Rays.of(scene, plan)
    base = Setting(
        {
            "method": "hybrid",
            "max_depth": plan.max_depth,
            "keep_orders": False,
            "keep_halves": False,
            **rays.at(1.0),
            "scatterer_cell": scatterer_cell(scene, launch_window(scene).incidence),
        }
    )
    piece, text, plain = _piece(scene, base, budget)
    full = plain if piece is scene else run_trial(scene, base)
    grid = default_grid(piece.radar, piece.image)
    # hardly any rays: what is left is the launches
    few = run_trial(piece, base.but(**rays.at(12.0)), grid)
    launch_seconds = few.stages.get("trace", 0.0) / max(1, few.facts["statistics"].get("key_pulses", 1))
    study = _Study(
        piece,
        grid,
        base,
        plain,
        full,
        scene.radar.track.n_pulses,
        launch_seconds,
        begin + SWEEP_SHARE * budget,
        report,
        budget,
    )

    depths = study.paired("max_depth", [d for d in (1, 2, 3, 4) if d < REFERENCE_DEPTH], REFERENCE_DEPTH)
    widths = study.paired("gridding_width", [2, 3, 4], 6)
    study.paired("phase_precision", ["single"], "double")
    interval = int(plain.facts["sampling"].get("key_pulse_interval", 1))
    n = piece.radar.track.n_pulses
    others = [k for k in (256, 128, 64, 32, 16) if k <= n and k != interval]
    wanted = [interval, *others] if interval > 8 else others
    intervals = study.paired("key_pulse_interval", wanted, 8) if interval > 1 and n >= 16 else [interval]
    _focusers(study)

    dense = base.but(**rays.at(0.5), max_depth=REFERENCE_DEPTH, gridding_width=6)
    converged = mean_image(piece, dense, grid, 2)
    reference = (
        f"the mean of 2 runs with lattices of their own, ray_spacing {0.5 * rays.coherent:.3g} m, "
        f"{REFERENCE_DEPTH} bounces, "
        f"gridding_width 6"
    )
    spacings = []
    study.refresh(max_depth=REFERENCE_DEPTH)
    for factor in (0.71, 1.0, 1.41, 2.0, 2.83):
        spacing = factor * rays.coherent
        trial = study.run(**rays.at(factor), max_depth=REFERENCE_DEPTH)
        study.note("ray_spacing", spacing, trial, trial.error_db(converged))
        spacings.append(spacing)
    _cells(study, plan)
    _methods(study, converged, rays)
    _raw_row(study, plain)

    candidates = _combine(study, rays, spacings, depths, widths, intervals)
    front = _pareto(candidates)
    good = [c for c in front if c.error_db <= target_error_db]
    best = min(c.error_db for c in candidates)
    near = [c for c in candidates if c.error_db <= best + 2.0 * STEP_DB]
    recommended = good[0] if good else min(near, key=lambda c: c.seconds)
    check = {"error_db": float("nan"), "seconds": float("nan")}
    if time.perf_counter() < deadline:
        trial = run_trial(piece, Setting({**base.changes, **recommended.changes}), grid, pass_index=7)
        check["error_db"] = trial.error_db(converged)
    if time.perf_counter() + recommended.seconds < deadline:
        whole = Setting({**base.changes, **recommended.changes})
        check["seconds"] = run_trial(scene, whole).seconds
    return CostReport(
        rows=tuple(study.rows),
        candidates=tuple(candidates),
        front=tuple(front),
        recommended=recommended,
        target_error_db=target_error_db,
        met=bool(good),
        piece=text,
        check=check,
        full_seconds=full.seconds,
        reference=reference,
        seconds=time.perf_counter() - begin,
    )


def _piece(scene: Scene, base: Setting, budget: float) -> tuple[Scene, str, Trial]:
    """Largest piece of the scene whose sweeps fit the budget, and a timed run of it."""
    allowed = SWEEP_SHARE * budget / SWEEP_RUNS
    guess = _guess_seconds(scene)
    n = scene.radar.track.n_pulses
    steps = [(s, p) for s, p in _PIECES if p == 1.0 or n * p >= 64]
    index = next((i for i, (s, p) in enumerate(steps) if guess * s * s * p <= allowed), len(steps) - 1)
    run_trial(crop(scene, *steps[-1]), base)  # compiles
    while True:
        share, pulses = steps[index]
        piece = scene if share >= 1.0 else crop(scene, share, pulses)
        plain = run_trial(piece, base)
        if plain.seconds <= 1.5 * allowed or index == len(steps) - 1:
            break
        fall = plain.seconds / allowed / (share**2 * pulses)
        smaller = range(index + 1, len(steps))
        index = next((i for i in smaller if fall * steps[i][0] ** 2 * steps[i][1] <= 1.0), len(steps) - 1)
    if share >= 1.0:
        return scene, "the whole scene", plain
    im = piece.image
    text = f"the middle {im.extent_azimuth:.3g} m x {im.extent_range:.3g} m of the image, "
    text += (
        "the whole aperture" if pulses == 1.0 else f"the middle {piece.radar.track.n_pulses} of {n} pulses"
    )
    return piece, text, plain


def _guess_seconds(scene: Scene) -> float:
    """Seconds of a plain run from its number of rays: a million a second, one key pulse in 64, and the focusing."""
    window = launch_window(scene)
    spacing = ray_spacing(scene, window, True, True)
    n = scene.radar.track.n_pulses
    pixels = float(np.prod(default_grid(scene.radar, scene.image).shape))
    return window.area / spacing**2 * max(1.0, n / 64.0) / 1e6 + pixels * n / 3e8


def _focusers(study: _Study) -> None:
    """Backprojection's interpolations, and omega-K where track and grid allow it."""
    if study.left() < 0.0:
        return
    study.refresh()
    exact = study.run(interpolation="kernel:8")
    study.note("interpolation", "kernel:8", exact, FLOOR_DB, "reference of its sweep")
    for name in ("kernel", "kernel:4", "linear"):
        trial = study.run(interpolation=name)
        study.note("interpolation", name, trial, trial.error_db(exact.image))
    study.note("focuser", "backprojection", study.run(focuser="backprojection"), FLOOR_DB)
    try:
        trial = study.run(focuser="omega_k")
    except DataError:
        return  # the grid or the track is not omega-K's
    study.note("focuser", "omega_k", trial, trial.error_db(exact.image))


def _cells(study: _Study, plan: EffectsPlan) -> None:
    """Scatterer cells: other cells are other random surfaces, so the level is compared, not the pixels."""
    if not plan.flags.diffuse:
        return
    cell = float(study.base.changes["scatterer_cell"])
    study.refresh()
    reference = study.run(scatterer_cell=cell)
    level = float(np.mean(np.abs(reference.image) ** 2))
    for factor in (0.5, 1.0, 2.0):
        if study.left() < 0.0:
            return
        trial = reference if factor == 1.0 else study.run(scatterer_cell=factor * cell)
        change = 10.0 * np.log10(float(np.mean(np.abs(trial.image) ** 2)) / level)
        study.note("scatterer_cell", factor * cell, trial, FLOOR_DB, f"mean level {change:+.2f} dB")


def _methods(study: _Study, converged: NDArray[Any], rays: Rays) -> None:
    study.refresh()
    for name in ("raster", "image"):
        try:
            trial = study.run(method=name)
        except SarmitsubaError:
            continue
        study.note("method", name, trial, trial.error_db(converged))
        if name == "image":
            for factor in (1.41, 2.0):
                coarse = study.run(method=name, **rays.at(factor))
                study.note(
                    "method",
                    f"image, ray_spacing {factor * rays.coherent:.4g}",
                    coarse,
                    coarse.error_db(converged),
                )


def _raw_row(study: _Study, plain: Trial) -> None:
    """Every pulse traced: its time follows from that of a key pulse; it has no error of its own to measure."""
    statistics = plain.facts["statistics"]
    keys = max(1, int(statistics.get("key_pulses", 1)))
    factor = study.scene.radar.track.n_pulses / keys
    seconds = sum(t * (factor if s == "trace" else 1.0) for s, t in plain.stages.items())
    full = sum(t * (factor if s in ("launches", "rays") else 1.0) for s, t in study.full.items())
    study.rows.append(
        Row("method", "raw", FLOOR_DB, seconds, full, float("nan"), "time predicted from the key pulses'")
    )


def _combine(
    study: _Study,
    rays: Rays,
    spacings: list[float],
    depths: list[int],
    widths: list[int],
    intervals: list[int],
) -> list[Candidate]:
    """Every combination of the swept values, error energies added, stage ratios multiplied."""

    def energy(parameter: str, value: Any) -> float:
        return float(10.0 ** (study.errors.get((parameter, value), FLOOR_DB) / 10.0))

    plain_ratio = {
        "max_depth": study.ratios.get(("max_depth", study.base.changes["max_depth"])),
        "gridding_width": study.ratios.get(("gridding_width", 4)),
    }
    focusers = [f for f in ("backprojection", "omega_k") if ("focuser", f) in study.errors]
    # errors of the spacing sweep hold the reference's depth and a width of 4 already
    out = []
    for spacing, depth, width, interval, focuser in itertools.product(
        spacings,
        depths or [study.base.changes["max_depth"]],
        widths or [4],
        intervals,
        focusers or ["backprojection"],
    ):
        picks = {
            "ray_spacing": spacing,
            "max_depth": depth,
            "gridding_width": width,
            "key_pulse_interval": interval,
            "focuser": focuser,
        }
        total = sum(energy(k, v) for k, v in picks.items() if k != "gridding_width")
        total += max(0.0, energy("gridding_width", width) - energy("gridding_width", 4))
        seconds = 0.0
        for stage in study.full:
            ratio = 1.0
            for key, value in picks.items():
                if stage not in AFFECTS[key]:
                    continue
                own = study.ratios.get((key, value), {}).get(stage, 1.0)
                plain = (plain_ratio.get(key) or {}).get(stage, 1.0)
                ratio *= own if key not in plain_ratio or plain <= 0.0 else own / plain
            seconds += study.full_stage(stage) * ratio
        changes = {**picks, **rays.at(spacing / rays.coherent), "method": "hybrid"}
        out.append(Candidate(changes, 10.0 * float(np.log10(total)), seconds))
    for (parameter, value), error in study.errors.items():
        if parameter == "method" and str(value).startswith("image"):
            row = next(r for r in study.rows if r.parameter == "method" and r.value == value)
            _, _, text = str(value).partition("ray_spacing ")
            factor = float(text) / rays.coherent if text else 1.0
            depth = study.base.changes["max_depth"]
            image = {"method": "image", "max_depth": depth, **rays.at(factor)}
            out.append(Candidate(image, error, row.full_seconds))
    return out


def _pareto(candidates: list[Candidate]) -> list[Candidate]:
    """Those that none beats in both by more than ``STEP_DB``, by time."""
    front: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: (c.seconds, c.error_db)):
        if not front or candidate.error_db < front[-1].error_db - STEP_DB:
            front.append(candidate)
    return front


__all__ = ["study_cost"]
