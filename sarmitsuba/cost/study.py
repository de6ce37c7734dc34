"""What accuracy costs on the user's own scene: one sweep a parameter, a model of both, the cheapest setting."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sarmitsuba.cost.cells import cells_text, has_cells, measure_cells
from sarmitsuba.cost.model import AFFECTS, FLOOR_DB, CostModel, corrected, split_stages
from sarmitsuba.cost.proof import Check, Proof, Reference
from sarmitsuba.cost.report import (
    CHECK_PASS,
    SPARE_DB,
    Candidate,
    CostReport,
    Rays,
    Row,
    pareto,
    recommend,
    reference_text,
)
from sarmitsuba.cost.sweep import Setting, Trial, crop, run_trial
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import DataError, SarmitsubaError
from sarmitsuba.focusing import default_grid
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.progress import Progress, silent
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.pilot import plan_scene
from sarmitsuba.simulation.window import launch_window, ray_spacing, scatterer_cell

# deepest bounce of the reference; what comes later has been weaker than -40 dB in every shipped scene
REFERENCE_DEPTH = 6
# shares of the budget: for the sweeps; at most for the reference of the proof; after which nothing more is measured
# but the recommendation's check
SWEEP_SHARE, PROOF_SHARE, LAST_SHARE = 0.4, 0.3, 0.85
# cost of all sweeps and of the reference, in runs of the plain setting
SWEEP_RUNS = 60.0
# ray spacings, in automatic ones, image's finer because its runs are short; coarser ones follow while they are better
# than wanted
SPACINGS = (0.71, 1.0, 1.41, 2.0, 2.83)
IMAGE_SPACINGS = (1.0, 1.19, 1.41, 1.68, 2.0, 2.38, 2.83, 3.36, 4.0, 4.76, 5.66)
COARSEST = 16.0
# no image so wrong is wanted, dB; most of the time left that one combination far from the target may take
USELESS_DB, FAR_SHARE = -10.0, 0.35
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
# ray spacing of the sweeps' reference, in automatic ones
SWEEP_FACTOR = 0.5
# what a reference may be made of: share of the image's extents, ray spacing in automatic ones; best first. Always
# denser than every candidate: of equal density it would share what that density blurs
_REFERENCES = ((1.0, 0.5), (1.0, 0.6), (0.7, 0.5), (0.7, 0.6), (0.5, 0.5), (0.5, 0.6), (0.35, 0.6))


@dataclass
class _Study:
    scene: Scene  # the piece that is swept
    grid: ImageGrid
    base: Setting
    plain: Trial
    whole: Trial
    n_pulses: int  # of the whole scene
    launch_seconds: float  # of one launch, whatever its rays
    deadline: float  # of the sweeps
    model: CostModel
    report: Progress
    begin: float
    budget: float
    target_error_db: float
    rows: list[Row] = field(default_factory=list)
    now: Trial | None = None

    def left(self) -> float:
        return self.deadline - time.perf_counter()

    def progress(self) -> None:
        self.report("cost", min(time.perf_counter() - self.begin, self.budget), self.budget, {})

    def run(self, **changes: Any) -> Trial:
        trial = run_trial(self.scene, self.base.but(**changes), self.grid)
        self.progress()
        return trial

    def refresh(self, **changes: Any) -> None:
        """Run the plain setting again: ratios are to a run of the same minute, whatever else the machine does."""
        self.now = self.run(**changes)

    def extend(self, factors: list[float], factor: float, error_db: float) -> None:
        """Go on to coarser rays while the coarsest are better than wanted."""
        coarser = 2.0**0.5 * factor
        if factor == factors[-1] and error_db < self.target_error_db - SPARE_DB and coarser < COARSEST:
            factors.append(coarser)

    def ratios(self, trial: Trial, parameter: str, value: Any) -> dict[str, float]:
        """Seconds by stage over those of the plain setting."""
        now = stages_of(trial, self.launch_seconds)
        then = stages_of(self.now or self.plain, self.launch_seconds)
        # a stage too short to time is taken not to change
        out = {s: now.get(s, 0.0) / t if t > 1e-3 else 1.0 for s, t in then.items()}
        if parameter == "key_pulse_interval":  # the piece's few pulses do not show it
            before = int(self.whole.facts["sampling"].get("key_pulse_interval", 1))
            launches = -(-self.n_pulses // value) / -(-self.n_pulses // before)
            out["launches"] = out["rays"] = launches
        return out

    def note(self, parameter: str, value: Any, trial: Trial, error_db: float, remark: str = "") -> None:
        """Put a trial into the table and the model."""
        error_db = max(error_db, FLOOR_DB)
        ratios = self.ratios(trial, parameter, value)
        self.model.errors[parameter, value] = error_db
        self.model.ratios[parameter, value] = ratios
        kept = AFFECTS.get(parameter, tuple(ratios))
        full = sum(
            t * (ratios.get(s, 1.0) if s in kept else 1.0) for s, t in self.model.full["hybrid"].items()
        )
        self.row(parameter, value, trial, error_db, full, remark)

    def row(
        self, parameter: str, value: Any, trial: Trial, error_db: float, full: float, remark: str = ""
    ) -> None:
        """Put a trial into the table."""
        shown = f"{value:.3g}" if isinstance(value, float) else str(value)
        megabytes = trial.peak_bytes / 1e6 if trial.peak_bytes >= 0 else float("nan")
        self.rows.append(Row(parameter, shown, error_db, trial.seconds, full, megabytes, remark))

    def paired(self, parameter: str, values: Iterable[Any], best: Any) -> None:
        """Sweep a parameter with the same rays; errors are against its best value."""
        if self.left() < 0.0:
            return
        self.refresh()
        reference = self.run(**{parameter: best})
        self.note(parameter, best, reference, FLOOR_DB, "reference of its sweep")
        for value in values:
            if self.left() < 0.0:
                break
            trial = self.run(**{parameter: value})
            self.note(parameter, value, trial, trial.error_db(reference.image))


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
    Three steps. Sweeps of one parameter each on a piece of the scene. Their combinations: errors of different
    parameters are taken to be independent, so that their energies add up, and each parameter to scale the time of a
    stage by a factor of its own. Then a converged image of the whole scene, as far as the budget allows, and runs of
    the combinations on the Pareto front against it, those about the target first; what these runs show, the
    combinations not run are corrected by. The check at the end runs the recommendation once more with other lattices.
    Errors of the scattering model are not in any of this.
    """
    begin = time.perf_counter()
    report = progress or silent
    plan = plan_scene(scene)
    # in metres, so that a piece of the aperture, which resolves less, is sampled as the whole scene is
    rays = Rays.of(scene, plan)
    base = Setting(
        {
            "method": "hybrid",
            "max_depth": plan.max_depth,
            "keep_orders": False,
            "keep_subsets": False,
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
    interval = int(plain.facts["sampling"].get("key_pulse_interval", 1))
    model = CostModel(
        rays,
        {"hybrid": _whole_stages(scene, base, rays, full)},
        {
            "ray_spacing": rays.coherent,
            "max_depth": plan.max_depth,
            "gridding_width": scene.settings.gridding_width,
            "key_pulse_interval": interval,
            "focuser": "backprojection",
        },
    )
    study = _Study(
        piece,
        grid,
        base,
        plain,
        full,
        scene.radar.track.n_pulses,
        launch_seconds,
        begin + SWEEP_SHARE * budget,
        model,
        report,
        begin,
        budget,
        target_error_db,
    )
    dense = base.but(max_depth=REFERENCE_DEPTH, gridding_width=6)
    if interval >= 16:
        dense = dense.but(key_pulse_interval=interval // 2)
    converged = Reference.of(piece, dense.but(**rays.at(SWEEP_FACTOR)), grid)
    _sweeps(study, scene, plan, converged)

    field_, factor, where = _field(scene, model.full["hybrid"], begin, budget)
    if field_ is None or piece is scene:
        field_, factor, where, against = piece, SWEEP_FACTOR, text, converged
    else:
        own = default_grid(field_.radar, field_.image)
        against = Reference.of(field_, dense.but(**rays.at(factor)), own)
        study.progress()
    # combinations bring their own spacings, or none
    bare = Setting({k: v for k, v in base.changes.items() if k not in rays.at(1.0)})
    proof = Proof(scene, field_, default_grid(field_.radar, field_.image), bare, against, factor, where)
    deadline = begin + LAST_SHARE * budget
    cells = has_cells(scene, plan)
    through: list[Candidate] = []
    for method in model.full if cells else ():
        through += measure_cells(proof, {"method": method}, sum(model.full[method].values()), deadline)
    candidates = _measure_front(study, proof, deadline)
    if cells:  # the same with what else was found to save time
        best = recommend(candidates, target_error_db).setting
        end = begin + budget - proof.cost(best.seconds)
        through += measure_cells(proof, best.changes, best.seconds, end)
    # what the study switches off, the recommended line must
    off = {k: False for k in ("keep_orders", "keep_subsets") if getattr(scene.settings, k)}
    candidates = [replace(c, changes={**c.changes, **off}) for c in (*candidates, *through)]
    recommendation = recommend(candidates, target_error_db)
    check = None
    if time.perf_counter() - begin + proof.cost(recommendation.setting.seconds) < budget:
        check = proof.measure(recommendation.setting.changes, CHECK_PASS)
    return CostReport(
        rows=tuple(study.rows),
        candidates=tuple(candidates),
        front=tuple(pareto(candidates)),
        recommendation=recommendation,
        proof=proof,
        piece=text,
        check=check,
        full_seconds=full.seconds,
        reference=reference_text(rays, SWEEP_FACTOR, REFERENCE_DEPTH),
        estimated_against=reference_text(rays, factor, REFERENCE_DEPTH),
        cells=cells_text(through) if cells else "",
        seconds=time.perf_counter() - begin,
    )


def stages_of(trial: Trial, launch_seconds: float) -> dict[str, float]:
    """Seconds by stage, tracing split into what goes by launches and what goes by rays."""
    out = {k: v for k, v in trial.stages.items() if k != "trace"}
    seconds = trial.stages.get("trace", 0.0)
    launches = min(launch_seconds * trial.facts["statistics"].get("key_pulses", 0), 0.95 * seconds)
    return {**out, "launches": launches, "rays": seconds - launches}


def _whole_stages(scene: Scene, setting: Setting, rays: Rays, full: Trial) -> dict[str, float]:
    """Seconds by stage of a setting on the whole scene: what is fixed, and what goes by launches and by rays.

    A second run with an eighth of the rays tells them apart; of what both have in common the lesser time counts.
    """
    sparse = run_trial(scene, setting.but(**rays.at(8.0**0.5)))
    same = {
        k: min(v, sparse.stages.get(k, v))
        for k, v in full.stages.items()
        if k not in ("trace", "launch grid")
    }
    return split_stages({**full.stages, **same}, sparse.stages, 8.0)


def _sweeps(study: _Study, scene: Scene, plan: EffectsPlan, converged: Reference) -> None:
    """All parameters, one after the other."""
    study.paired("max_depth", [d for d in (1, 2, 3, 4) if d < REFERENCE_DEPTH], REFERENCE_DEPTH)
    study.paired("gridding_width", [2, 3, 4], 6)
    study.paired("phase_precision", ["single"], "double")
    _methods(study, scene, converged)
    study.refresh(max_depth=REFERENCE_DEPTH)
    factors = list(SPACINGS)
    for factor in factors:
        spacing = factor * study.model.rays.coherent
        trial = study.run(**study.model.rays.at(factor), max_depth=REFERENCE_DEPTH)
        error = converged.error_db(trial.image)
        study.note("ray_spacing", spacing, trial, error)
        if "image" not in study.model.full:  # else that is what coarse rays are for
            study.extend(factors, factor, error)
    _focusers(study)
    _cells(study, plan)
    _raw_row(study)
    interval = int(study.plain.facts["sampling"].get("key_pulse_interval", 1))
    n = study.scene.radar.track.n_pulses
    # against four times the launches; twice as many again cost as much as everything else here
    best = max(8, interval // 4)
    if interval > 1 and n >= 16:
        others = [k for k in (256, 128, 64, 32, 16) if best < k <= n and k != interval]
        study.paired("key_pulse_interval", [interval, *others] if interval > best else others, best)


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
    text = _middle(piece)
    text += (
        ", the whole aperture"
        if pulses == 1.0
        else f", the middle {piece.radar.track.n_pulses} of {n} pulses"
    )
    return piece, text, plain


def _middle(piece: Scene) -> str:
    return f"the middle {piece.image.extent_azimuth:.3g} m x {piece.image.extent_range:.3g} m of the image"


def _guess_seconds(scene: Scene) -> float:
    """Seconds of a plain run from its number of rays: a million a second, one key pulse in 64, and the focusing."""
    window = launch_window(scene)
    spacing = ray_spacing(scene, window, True, True)
    n = scene.radar.track.n_pulses
    pixels = float(np.prod(default_grid(scene.radar, scene.image).shape))
    return window.area / spacing**2 * max(1.0, n / 64.0) / 1e6 + pixels * n / 3e8


def _field(
    scene: Scene, full: Mapping[str, float], begin: float, budget: float
) -> tuple[Scene | None, float, str]:
    """What the estimates are to be measured on, and with which ray spacing its reference is made.

    As much of the scene, and as densely, as a third of the budget allows; None where that is not even a third of
    the image's extents.
    """
    left = budget - (time.perf_counter() - begin)
    allowed = min(PROOF_SHARE * budget, 0.6 * left)
    fixed = full.get("build", 0.0) + full.get("plan", 0.0)
    for share, factor in _REFERENCES:
        # two passes with twice the key pulses
        rays = 2.0 * full["rays"] / factor**2
        others = 2.0 * (sum(full.values()) - full["rays"] - fixed)
        if 2.0 * (fixed + share**2 * (rays + others)) <= allowed:
            if share == 1.0:
                return scene, factor, "the whole scene"
            piece = crop(scene, share)
            return piece, factor, _middle(piece) + ", the whole aperture"
    return None, 0.0, ""


def _measure_front(study: _Study, proof: Proof, deadline: float) -> list[Candidate]:
    """Run the combinations on the Pareto front while there is time, what the target depends on first."""
    predicted = study.model.combine()
    measured: dict[int, Check] = {}
    skipped: set[int] = set()
    while True:
        candidates = corrected(predicted, measured)
        index = {id(c): i for i, c in enumerate(candidates)}
        front = pareto(candidates)
        chosen = recommend(candidates, study.target_error_db).setting
        place = next((i for i, c in enumerate(front) if c is chosen), len(front) - 1)
        near = [chosen, *front[max(0, place - 1) : place + 2]]
        # the recommendation, the next cheaper, the next better, then what is least like anything measured
        known = [np.log(check.seconds) for check in measured.values()]
        far = sorted(
            (c for c in front if c.error_db <= max(study.target_error_db, USELESS_DB)),
            key=lambda c: -min((abs(np.log(c.seconds) - k) for k in known), default=0.0),
        )
        todo = [c for c in (*near, *far) if not c.measured and index[id(c)] not in skipped]
        if not todo:
            return candidates
        pick = todo[0]
        left = deadline - time.perf_counter() - proof.cost(chosen.seconds)
        if proof.cost(pick.seconds) > (left if any(pick is c for c in near) else FAR_SHARE * left):
            skipped.add(index[id(pick)])
            continue
        measured[index[id(pick)]] = proof.measure(pick.changes)
        study.progress()


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


def _methods(study: _Study, scene: Scene, converged: Reference) -> None:
    """The two image-domain methods: timed on the whole scene, which takes them little; spacings of ``image``."""
    model = study.model
    for name in ("raster", "image"):
        try:
            study.now = trial = study.run(method=name)
            whole = trial if study.scene is scene else run_trial(scene, study.base.but(method=name))
        except SarmitsubaError:
            continue  # ideal points only, or a scene that the method does not do
        if name == "raster":
            study.row("method", name, trial, converged.error_db(trial.image), whole.seconds)
            continue
        method = study.base.but(method=name)
        model.full = {**model.full, name: _whole_stages(scene, method, model.rays, whole)}
        factors = list(IMAGE_SPACINGS)
        for factor in factors:
            if study.left() < 0.0:
                return
            spacing = factor * model.rays.coherent
            trial = study.run(method=name, **model.rays.at(factor))
            error = converged.error_db(trial.image)
            model.errors[name, spacing] = error
            picks = {"ray_spacing": spacing}
            shown = name if factor == 1.0 else f"image, ray_spacing {spacing:.4g}"
            study.row("method", shown, trial, error, model.seconds(name, picks))
            study.extend(factors, factor, error)


def _raw_row(study: _Study) -> None:
    """Every pulse traced: its time follows from that of a key pulse; it has no error of its own to measure."""
    plain = study.plain
    keys = max(1, int(plain.facts["statistics"].get("key_pulses", 1)))
    factor = study.scene.radar.track.n_pulses / keys
    seconds = sum(t * (factor if s == "trace" else 1.0) for s, t in plain.stages.items())
    full = sum(
        t * (factor if s in ("launches", "rays") else 1.0) for s, t in study.model.full["hybrid"].items()
    )
    study.rows.append(
        Row("method", "raw", FLOOR_DB, seconds, full, float("nan"), "time predicted from the key pulses'")
    )


__all__ = ["stages_of", "study_cost"]
