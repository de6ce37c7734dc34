"""Cost study of a scene: one sweep per parameter, a model of all combinations, and the cheapest setting.

Sweeps and verification run on parts of the scene. The Pareto front is measured from near the wanted error outwards.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba.apps.cost_model import CostModel, correct_predictions
from sarmitsuba.apps.cost_report import (
    CHECK_PASS,
    Candidate,
    CostReport,
    Proof,
    ProofRun,
    Recommendation,
    Reference,
    beaten,
    pareto,
    recommend,
    reference_text,
)
from sarmitsuba.apps.cost_sweeps import (
    LEAST_DEPTH,
    NO_MORE_DB,
    Sweeps,
    hold_blocks,
    raw_seconds,
    sweep_all,
    whole_stages,
)
from sarmitsuba.apps.cost_trials import Changes, MeasuredClock, StudyClock, Trial, Trials, TrialSetting
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import DEFAULT
from sarmitsuba.simulation.planning.pilot import examine, plan_in, plan_scene
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.piece import crop

# largest error of interest, dB; share of the remaining time for a single combination far from the target
USELESS_DB, FAR_SHARE = -10.0, 0.35


def measure_front(
    predicted: Sequence[Candidate],
    proof: Proof,
    target_error_db: float,
    deadline: float,
    progress: Callable[[], None],
    own: int | None = None,
) -> list[Candidate]:
    """Measure the combinations on the Pareto front within the time, those near the target first.

    Parameters
    ----------
    predicted : all combinations, from the model
    proof : measures the combinations
    target_error_db : wanted error
    deadline : on the proof's clock
    progress : called after every run
    own : index of the scene's setting, whose seconds are measured already; None: it is not measured

    Returns
    -------
    candidates : measured, or corrected by measured neighbours
    """
    measured: dict[int, ProofRun] = {}
    skipped: set[int] = set()
    if own is not None:
        measured[own] = replace(proof.measure(predicted[own].changes), seconds=predicted[own].seconds)
        progress()
    while True:
        candidates = correct_predictions(predicted, measured)
        index = {id(c): i for i, c in enumerate(candidates)}
        front = pareto(candidates)
        mine = candidates[own] if own is not None else None
        chosen = recommend(candidates, target_error_db, own=mine).setting
        place = next((i for i, c in enumerate(front) if c is chosen), len(front) - 1)
        near = [chosen, *front[max(0, place - 1) : place + 2]]
        # the recommendation, the next cheaper, the next better, then the combination farthest from any measured one
        known = [np.log(check.seconds) for check in measured.values()]
        far = sorted(
            (c for c in front if c.error_db <= max(target_error_db, USELESS_DB)),
            key=lambda c: -min((abs(np.log(c.seconds) - k) for k in known), default=0.0),
        )
        todo = [c for c in (*near, *far) if not c.measured and index[id(c)] not in skipped]
        if not todo:
            return candidates
        pick = todo[0]
        left = deadline - proof.trials.clock.now() - proof.cost(chosen.seconds)
        if proof.cost(pick.seconds) > (left if any(pick is c for c in near) else FAR_SHARE * left):
            skipped.add(index[id(pick)])
            continue
        measured[index[id(pick)]] = proof.measure(pick.changes, expected=pick.seconds)
        progress()


# shares of the budget: for the sweeps, and largest share for the reference
SWEEP_SHARE, PROOF_SHARE = 0.55, 0.25
# cost of all sweeps and of the reference, in runs of the plain setting: each setting runs once, on shared geometry
SWEEP_RUNS = 36.0
# seconds of a run of the whole scene below which smaller pieces are hardly faster: launches and planning remain
SHORT = 10.0
# budget, in runs of the whole scene, below which sweeps and combinations have the same reference
SHORT_STUDY = 40.0
# candidate pieces of a scene: share of the image's extents, share of the pulses
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
# candidate references: share of the image's extents, ray spacing relative to the automatic one; best first. Denser than
# every candidate setting: at equal density it would share their errors
REFERENCES = ((1.0, 0.5), (1.0, 0.6), (0.7, 0.5), (0.7, 0.6), (0.5, 0.5), (0.5, 0.6), (0.35, 0.6))


def piece_to_sweep(
    scene: Scene, base: TrialSetting, budget: float, whole_seconds: float, trials: Trials
) -> tuple[Scene, str, Trial]:
    """Largest piece of the scene whose sweeps fit the budget, its description, and a timed run of it.

    Parameters
    ----------
    whole_seconds : s, estimate for the whole scene
    """
    allowed = SWEEP_SHARE * budget / SWEEP_RUNS
    guess = whole_seconds
    n = scene.radar.track.n_pulses
    steps = [(s, p) for s, p in _PIECES if p == 1.0 or n * p >= 64]
    if whole_seconds < SHORT:
        steps = [(s, p) for s, p in steps if p == 1.0]
    index = next((i for i, (s, p) in enumerate(steps) if guess * s * s * p <= allowed), len(steps) - 1)
    while True:
        share, pulses = steps[index]
        piece = scene if share >= 1.0 else crop(scene, share, pulses)
        plain = trials.steady(piece, base)
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


def field_of_proof(
    scene: Scene, full: Mapping[str, float], budget: float, left: float
) -> tuple[Scene | None, float, str]:
    """Part of the scene for measuring the estimates, and the relative ray spacing of its reference.

    As large and as densely sampled as a quarter of the budget allows; None if less than a third of the image's extents,
    and for small budgets: the swept piece and its reference serve.

    Parameters
    ----------
    full : seconds by stage of the plain setting on the whole scene
    budget, left : s, of the whole study, and its remainder
    """
    if budget < SHORT_STUDY * sum(full.values()):  # a second reference would take what the combinations need
        return None, 0.0, ""
    allowed = min(PROOF_SHARE * budget, 0.6 * left)
    fixed = full.get("build", 0.0) + full.get("plan", 0.0)
    for share, factor in REFERENCES:
        # two passes with twice the key pulses
        rays = 2.0 * full["rays"] / factor**2
        others = 2.0 * (sum(full.values()) - full["rays"] - fixed)
        if 2.0 * (fixed + share**2 * (rays + others)) <= allowed:
            if share == 1.0:
                return scene, factor, "the whole scene"
            piece = crop(scene, share)
            return piece, factor, _middle(piece) + ", the whole aperture"
    return None, 0.0, ""


# budget where none is given: runs of the whole scene, and at least these seconds, since small pieces of a scene that
# runs for a second run hardly faster
BUDGET_RUNS, LEAST_BUDGET = 15.0, 60.0
# share of the budget after which only the recommendation is checked
LAST_SHARE = 0.85
# ray spacing of the sweeps' reference, relative to the automatic one
SWEEP_FACTOR = 0.5


@dataclass(frozen=True, eq=False)
class _Task:
    """Task and budget of a study.

    Parameters
    ----------
    depth, unseen : bounces of the references, and relative energy of later ones
    whole : run of the plain setting on the whole scene
    own_seconds : of the scene's setting
    """

    scene: Scene
    plan: EffectsPlan
    sampling: SamplingPlan
    base: TrialSetting
    depth: int
    unseen: float
    target_error_db: float
    budget: float
    trials: Trials
    whole: Trial
    own_seconds: float
    begin: float
    report: Callable[[], None]

    @property
    def spent(self) -> float:
        """Elapsed seconds of the study, without compiling."""
        return self.trials.clock.now() - self.begin


def study_cost(
    scene: Scene,
    *,
    target_error_db: float = -20.0,
    budget: float = 0.0,
    progress: Progress | None = None,
    clock: StudyClock | None = None,
    state: Path | None = None,
    run_hash: str = "",
    say: Callable[[str], None] = lambda line: None,
) -> CostReport:
    """Sweep every parameter that trades accuracy for time, within a budget, and recommend a setting.

    Parameters
    ----------
    scene : as loaded; its settings are the plain setting
    target_error_db : energy of the error over that of the image, dB
    budget : s of the processor, without compiling; scenes are swept on a piece from the middle of the image that fits
        it; 0: ``BUDGET_RUNS`` times the run of the whole scene, at least ``LEAST_BUDGET``
    progress : called after every run
    clock : time source; default: processor seconds of all threads. With :class:`sarmitsuba.apps.cost_trials.WorkClock`
        time is computed from the work, and the budget allows the same runs everywhere
    state : file that keeps every finished trial; those of the same study in it are not repeated. None: none
    run_hash : of the study, for ``state``
    say : called with a line where ``state`` has trials of another study, which are dropped

    Returns
    -------
    CostReport

    Raises
    ------
    DataError
        The scene has no mesh, so that nothing is traced; a trial in ``state`` is not one of this program.
    OutputError
        ``state`` is another file, or cannot be written.

    Notes
    -----
    Three steps. First, sweeps of one parameter each on a piece of the scene. Second, predictions for combinations:
    errors of different parameters are assumed to be independent, so that energies add up, and each parameter scales
    the time of a stage by a factor. Third, a converged image of the whole scene, as far as the budget allows, and runs
    of the combinations on the Pareto front against it, those near the target first; other combinations are corrected
    by these runs. Finally the recommendation is run once more with other lattices. Errors of the scattering model are
    not included.

    Seconds to which others are compared, short ones and those that deviate are measured twice, and a third time where
    the two differ. The scene's setting is one of the combinations, and no slower one that is not more accurate is
    recommended: a recommendation that its last run shows to be such a one gives way to the next.

    A reference has all bounces that the scene needs by its plan, also where the scene sets fewer. What the pilot finds
    in later ones is added to every error.
    """
    if scene.geometry.n_faces == 0:
        raise DataError(
            f"{scene.name}: cost: the scene has no mesh, and the time for ideal points is negligible"
        )
    trials = Trials(clock or MeasuredClock(), state, run_hash)
    try:
        if str(trials):
            say(str(trials))
        return _study(_task(scene, target_error_db, budget, progress or silent, trials))
    finally:
        trials.close()


def _study(task: _Task) -> CostReport:
    """All steps."""
    spacings = task.sampling.spacings
    sweeps, piece_text, converged = _sweep(task)
    proof = _proof(task, sweeps, piece_text, converged)
    candidates = _candidates(task, sweeps, proof)
    recommendation, check = _check_recommendation(task, candidates, sweeps.skipped, proof)
    return CostReport(
        rows=tuple(sweeps.rows),
        candidates=tuple(candidates),
        front=tuple(pareto(candidates)),
        recommendation=recommendation,
        proof=proof,
        piece=piece_text,
        check=check,
        full_seconds=candidates[-1].seconds,
        reference=reference_text(spacings, SWEEP_FACTOR, task.depth, task.unseen),
        estimated_against=reference_text(spacings, proof.factor, task.depth, task.unseen),
        budget=task.budget,
        skipped=tuple(sweeps.skipped),
        reused=task.trials.reused,
        own=candidates[-1],
        seconds=task.spent,
        compile_seconds=task.trials.compile_seconds,
    )


def _check_recommendation(
    task: _Task, candidates: list[Candidate], skipped: list[str], proof: Proof
) -> tuple[Recommendation, ProofRun | None]:
    """Recommendation, and its run with other lattices where the budget allows.

    Where that shows it to be slower than the scene's setting and no more accurate, it is a candidate with these
    figures, and the next one is recommended.
    """
    own = candidates[-1]
    while True:
        found = recommend(candidates, task.target_error_db, skipped, own)
        best = found.setting
        if task.spent + proof.cost(best.seconds) >= task.budget:
            return found, None
        check = proof.measure(best.changes, CHECK_PASS, best.seconds)
        if best is own or not own.measured or not beaten(check, own):
            return found, check
        candidates[candidates.index(best)] = Candidate(best.changes, check.error_db, check.seconds, True)


def _task(scene: Scene, target_error_db: float, budget: float, progress: Progress, trials: Trials) -> _Task:
    begin = trials.clock.now()
    plan = plan_scene(scene)
    sampling = SamplingPlan.of(scene, plan.flags)
    # in metres, so that a piece of the aperture, of coarser resolution, is sampled as the whole scene
    base = TrialSetting(
        {
            "method": "hybrid",
            "max_depth": plan.max_depth,
            "keep_orders": False,
            "keep_subsets": False,
            **sampling.spacings.at(1.0),
            "scatterer_cell": sampling.scatterer_cell,
        }
    )

    own = own_changes(scene, sampling, plan.max_depth)
    # first, with its warnings; where they are the same, its echoes are focused again below
    trials.run(scene, base if own["method"] == "raw" else base.but(**own))
    whole = trials.steady(scene, base)
    run = whole if own["method"] == "raw" else trials.steady(scene, base.but(**own))
    budget = budget or max(LEAST_BUDGET, BUDGET_RUNS * run.seconds)

    def report() -> None:
        progress("cost", min(trials.clock.now() - begin, budget), budget, {"trials": float(trials.count)})

    trials.done = report
    depth, unseen = reference_depth(scene, plan)
    return _Task(
        scene,
        plan,
        sampling,
        base,
        depth,
        unseen,
        target_error_db,
        budget,
        trials,
        whole,
        run.seconds,
        begin,
        report,
    )


def own_changes(scene: Scene, sampling: SamplingPlan, depth: int) -> Changes:
    """The scene's setting, with the automatic values of its method."""
    method = scene.settings.method
    spacings = (sampling.of_one_look() if method == "image" else sampling).spacings
    own: dict[str, float | str] = {"method": method, "max_depth": depth, **spacings.at(1.0)}
    return own | {"focuser": DEFAULT} if method in ("hybrid", "raw") else own


def reference_depth(scene: Scene, plan: EffectsPlan) -> tuple[int, float]:
    """Bounces of a reference, and the most energy of later ones relative to the image, by the pilot (0 without one).

    They are at least those of the scene's plan, and of the plan without the scene's limit, and more until the pilot
    bounds the rest by ``NO_MORE_DB``, if it does.
    """
    settings = scene.settings
    if settings.max_depth or settings.method == "raster":
        free = replace(scene, settings=replace(settings, max_depth=0, method="hybrid"))
        planned = plan_in(examine(free), warn=False)
    else:
        planned = plan
    least = max(LEAST_DEPTH, plan.max_depth, planned.max_depth)
    later = [-np.inf if x is None else x for x in planned.pilot.get("energy_from_order_upper_db", [])]
    if not later:
        return least, 0.0
    depth = next((d for d in range(least, len(later)) if later[d] <= NO_MORE_DB), least)
    # a rest that the pilot did not trace is assumed to be at most what was left before its last bounce
    return depth, power_from_db(later[min(depth, len(later) - 1)])


def _dense(task: _Task, sweeps: Sweeps) -> TrialSetting:
    """Setting of a reference, except its ray spacings."""
    dense = task.base.but(max_depth=task.depth, gridding_width=6)
    interval = sweeps.plain.key_pulse_interval
    return dense.but(key_pulse_interval=interval // 2) if interval >= 16 else dense


def _sweep(task: _Task) -> tuple[Sweeps, str, Reference]:
    """All sweeps, the description of the piece of the scene, and its reference."""
    scene, base, spacings, trials, whole = (
        task.scene,
        task.base,
        task.sampling.spacings,
        task.trials,
        task.whole,
    )
    piece, text, plain = piece_to_sweep(scene, base, task.budget, whole.seconds, trials)
    grid = default_grid(piece.radar, piece.image)
    # few rays: the remaining time is that of launches
    few = trials.run(piece, hold_blocks(base, plain).but(**spacings.at(12.0)), grid)
    model = CostModel(
        spacings,
        {"hybrid": whole_stages(scene, base, spacings, whole, trials)},
        {
            "ray_spacing": spacings.coherent,
            "max_depth": task.plan.max_depth,
            "gridding_width": scene.settings.gridding_width,
            "key_pulse_interval": plain.key_pulse_interval,
            "focuser": "backprojection",
        },
    )
    sweeps = Sweeps(
        scene=piece,
        grid=grid,
        base=base,
        depth=task.depth,
        plain=plain,
        whole=whole,
        n_pulses=scene.radar.track.n_pulses,
        launch_seconds=few.stages.get("trace", 0.0) / max(1, few.statistics.key_pulses),
        deadline=task.begin + SWEEP_SHARE * task.budget,
        model=model,
        target_error_db=task.target_error_db,
        trials=trials,
    )
    dense = _dense(task, sweeps).but(**spacings.at(SWEEP_FACTOR))
    converged = Reference.of(piece, dense, grid, trials, task.unseen)
    sweep_all(sweeps, scene, task.plan, converged)
    return sweeps, text, converged


def _proof(task: _Task, sweeps: Sweeps, piece_text: str, converged: Reference) -> Proof:
    """Measurement on as much of the scene as the budget allows for a reference, else on the piece."""
    left = task.budget - task.spent
    field, factor, where = field_of_proof(task.scene, sweeps.model.full["hybrid"], task.budget, left)
    spacings = task.sampling.spacings
    if field is None or sweeps.scene is task.scene:
        field, factor, where, against = sweeps.scene, SWEEP_FACTOR, piece_text, converged
        grid = sweeps.grid
    else:
        grid = default_grid(field.radar, field.image)
        dense = _dense(task, sweeps).but(**spacings.at(factor))
        against = Reference.of(field, dense, grid, task.trials, task.unseen)
    # combinations have their own spacings, or none
    bare = TrialSetting({k: v for k, v in task.base.changes.items() if k not in spacings.at(1.0)})
    return Proof(task.scene, field, grid, bare, against, factor, where, task.trials)


def _candidates(task: _Task, sweeps: Sweeps, proof: Proof) -> list[Candidate]:
    """All combinations, measured or corrected, the scene's setting as the last.

    Of method ``raw`` it is predicted.
    """
    deadline = task.begin + LAST_SHARE * task.budget
    own = own_changes(task.scene, task.sampling, task.plan.max_depth)
    model, raw = sweeps.model, own["method"] == "raw"
    energy = sum(model.energy(k, own[k]) for k in ("ray_spacing", "max_depth"))
    seconds = raw_seconds(sweeps) if raw else task.own_seconds
    combinations = [*model.combine(), Candidate(own, db_from_power(energy), seconds)]
    last = None if raw else len(combinations) - 1
    found = measure_front(combinations, proof, task.target_error_db, deadline, task.report, last)
    # the recommended options must switch off the same as the study
    off = {k: False for k in ("keep_orders", "keep_subsets") if getattr(task.scene.settings, k)}
    return [replace(c, changes={**c.changes, **off}) for c in found]
