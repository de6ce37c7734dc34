"""Sweeps of a cost study: one parameter at a time on a piece of the scene, for error and time by stage."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sarmitsuba.apps.cost_model import AFFECTS, FLOOR_DB, CostModel
from sarmitsuba.apps.cost_report import SPARE_DB, Reference, Row
from sarmitsuba.apps.cost_trials import Trial, Trials, TrialSetting, Value
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import FOCUSERS, parse_focuser
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.planning.prediction.speed import split_trace
from sarmitsuba.simulation.planning.sampling.density_plan import RaySpacings

# least number of bounces of the reference
LEAST_DEPTH = 6
# swept numbers of bounces, as far as they are below the reference's; steps of about 2^(1/2) from 4 on
DEPTHS = (1, 2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512, 724)
# ray spacings relative to the automatic one, which is always measured; finer steps for method image because its runs
# are short; coarser ones follow while they are better than wanted
SPACINGS = (1.0, 0.71, 1.41, 2.0, 2.83)
IMAGE_SPACINGS = (1.0, 1.19, 1.41, 1.68, 2.0, 2.38, 2.83, 3.36, 4.0, 4.76, 5.66)
COARSEST = 16.0
# factor of the reference's seconds of a stage beyond which a sample is repeated; s of a stage too short for timing
SAME, TIMED = 1.15, 0.01
# error of a number of bounces below which more are not run, dB
NO_MORE_DB = -60.0
# wanted errors of factorised backprojection beside its own
_FACTORISED = ("factorised,error=-35", "factorised,error=-65")
# effects that a scene has only with certain contents, and that take time
_COSTLY = (
    "diffuse_pairs",
    "slabs",
    "transmission",
    "edge_diffraction",
    "line_scatterers",
    "vegetation",
    "water_motion",
    "wideband",
)


@dataclass
class Sweeps:
    """Sweeps of one parameter each, for the table and the model.

    Parameters
    ----------
    scene : the swept piece
    grid : of its image
    base : the plain setting
    depth : bounces of the reference
    plain, whole : runs of it on the piece and on the whole scene
    n_pulses : of the whole scene
    launch_seconds : of one launch, independent of its rays
    deadline : of the sweeps, on the clock
    model : to which the trials are added
    target_error_db : wanted error
    trials : of the study
    rows : of the table
    now : latest run of the plain setting, reference of the ratios
    skipped : sweeps without time, or cut short
    """

    scene: Scene
    grid: ImageGrid
    base: TrialSetting
    depth: int
    plain: Trial
    whole: Trial
    n_pulses: int
    launch_seconds: float
    deadline: float
    model: CostModel
    target_error_db: float
    trials: Trials
    rows: list[Row] = field(default_factory=list)
    now: Trial | None = None
    skipped: list[str] = field(default_factory=list)

    def left(self) -> float:
        """Seconds until the deadline."""
        return self.deadline - self.trials.clock.now()

    def late(self, name: str) -> bool:
        """Whether the deadline is over; the sweep is then noted as left out, or as cut short."""
        if self.left() >= 0.0:
            return False
        if name not in self.skipped:
            self.skipped.append(name)
        return True

    def run(self, **changes: Value) -> Trial:
        """Run the plain setting with changes, on the piece."""
        return self.trials.run(self.scene, self.setting(changes), self.grid)

    def setting(self, changes: Mapping[str, Value]) -> TrialSetting:
        """The plain setting with changes."""
        same = {k: v for k, v in changes.items() if self.base.changes.get(k, self.model.plain.get(k)) != v}
        return self.base.but(**same)

    def use_timer(self, parameter: str, **changes: Value) -> Trial:
        """Run it, and again where the seconds that the parameter decides on are not those of the reference.

        A sample that is as the reference's does no harm; any other may be the parameter's or a disturbance.
        """
        trial, then = self.run(**changes), self.now or self.plain
        stages = {"trace" if s in ("launches", "rays") else s for s in AFFECTS.get(parameter, ())}
        if not any(_deviates(trial.stages.get(s, 0.0), then.stages.get(s, 0.0)) for s in stages):
            return trial
        setting = self.setting(changes)
        return self.trials.steady(self.scene, setting, self.grid, refocus=parameter == "focuser")

    def refresh(self, **changes: Value) -> None:
        """Setting to which ratios refer from here on."""
        self.now = self.trials.steady(self.scene, self.setting(changes), self.grid)

    def extend(self, factors: list[float], factor: float, error_db: float) -> None:
        """Continue with coarser rays while the coarsest are better than wanted."""
        coarser = 2.0**0.5 * factor
        if factor == factors[-1] and error_db < self.target_error_db - SPARE_DB and coarser < COARSEST:
            factors.append(coarser)

    def ratios(self, trial: Trial, parameter: str, value: Value) -> dict[str, float]:
        """Ratio of the seconds by stage to those of the plain setting."""
        now = _stages_of(trial, self.launch_seconds)
        then = _stages_of(self.now or self.plain, self.launch_seconds)
        # a stage too short for timing is assumed not to change
        out = {s: now.get(s, 0.0) / t if t > 1e-3 else 1.0 for s, t in then.items()}
        if parameter == "key_pulse_interval":  # not measurable with the few pulses of the piece
            before = self.whole.key_pulse_interval
            launches = -(-self.n_pulses // int(value)) / -(-self.n_pulses // before)
            out["launches"] = out["rays"] = launches
        return out

    def note(
        self,
        parameter: str,
        value: Value,
        trial: Trial,
        error_db: float,
        remark: str = "",
        on_whole: Mapping[str, float] | None = None,
    ) -> None:
        """Add a trial to the table and the model; ``on_whole``: factors of the ratios by stage on the whole scene."""
        error_db = max(error_db, FLOOR_DB)
        ratios = self.ratios(trial, parameter, value)
        ratios |= {stage: ratios.get(stage, 1.0) * factor for stage, factor in (on_whole or {}).items()}
        self.model.errors[parameter, value] = error_db
        self.model.ratios[parameter, value] = ratios
        kept = AFFECTS.get(parameter, tuple(ratios))
        full = sum(
            t * (ratios.get(s, 1.0) if s in kept else 1.0) for s, t in self.model.full["hybrid"].items()
        )
        self.row(parameter, value, trial, error_db, full, remark)

    def row(
        self, parameter: str, value: Value, trial: Trial, error_db: float, full: float, remark: str = ""
    ) -> None:
        """Add a trial to the table."""
        shown = f"{value:.3g}" if isinstance(value, float) else str(value)
        megabytes = trial.peak_bytes / 1e6 if trial.peak_bytes >= 0 else float("nan")
        self.rows.append(Row(parameter, shown, error_db, trial.seconds, full, megabytes, remark))

    def sweep_pairs(self, parameter: str, values: Iterable[Value], best: Value) -> None:
        """Sweep a parameter with the same rays; errors are against its best value."""
        if self.late(parameter):
            return
        self.refresh()
        reference = self.use_timer(parameter, **{parameter: best})
        self.note(parameter, best, reference, FLOOR_DB, "reference of its sweep")
        for value in values:
            if self.late(parameter):
                break
            trial = self.use_timer(parameter, **{parameter: value})
            error = trial.error_db(reference.image)
            self.note(parameter, value, trial, error)
            if parameter == "max_depth" and error < NO_MORE_DB:
                break


def sweep_all(study: Sweeps, scene: Scene, plan: EffectsPlan, converged: Reference) -> None:
    """Sweep all parameters until the deadline, those that decide most first."""
    _spacings(study, converged)
    _focusers(study, scene)
    study.sweep_pairs("max_depth", depths(study.depth, plan.max_depth), study.depth)
    _intervals(study)
    study.sweep_pairs("gridding_width", [2, 3, 4], 6)
    _methods(study, scene, converged)
    _effects(study, plan)
    _cells(study, plan)
    study.sweep_pairs("phase_precision", ["single"], "double")
    _raw_row(study)


def depths(deepest: int, planned: int) -> list[int]:
    """Swept numbers of bounces below the reference's ``deepest``; the plain setting's is one of them or the deepest."""
    return sorted(d for d in {*DEPTHS, planned} if d < deepest)


def _spacings(study: Sweeps, converged: Reference) -> None:
    """Sweep ray spacings with the blocks of the plain setting."""
    interval = study.plain.key_pulse_interval
    blocks = {"key_pulse_interval": interval} if interval > 1 else {}
    study.refresh(max_depth=study.depth, **blocks)
    factors = list(SPACINGS)
    for factor in factors:
        if factor != factors[0] and study.late("ray_spacing"):
            return
        spacing = factor * study.model.spacings.coherent
        trial = study.run(**study.model.spacings.at(factor), max_depth=study.depth, **blocks)
        error = converged.error_db(trial.image)
        study.note("ray_spacing", spacing, trial, error)
        study.extend(factors, factor, error)


def _intervals(study: Sweeps) -> None:
    """Sweep key-pulse intervals against four times the launches; more of them would cost as much as everything else."""
    interval, n = study.plain.key_pulse_interval, study.scene.radar.track.n_pulses
    best = max(8, interval // 4)
    if interval > 1 and n >= 16:
        others = [k for k in (256, 128, 64, 32, 16) if best < k <= n and k != interval]
        study.sweep_pairs("key_pulse_interval", [interval, *others] if interval > best else others, best)


def _focusers(study: Sweeps, scene: Scene) -> None:
    """Sweep interpolations of backprojection, all other focusers, and the wanted error of factorised backprojection.

    All focus the same echoes. Times and errors are carried to the whole scene by each focuser's model of them.
    """
    if study.late("focuser"):
        return
    study.refresh()
    exact = study.run(interpolation="kernel:8")
    study.note("interpolation", "kernel:8", exact, FLOOR_DB, "reference of its sweep")
    for name in ("kernel", "kernel:4", "linear"):
        trial = study.run(interpolation=name)
        study.note("interpolation", name, trial, trial.error_db(exact.image))
    plain = study.run()
    study.note("focuser", "backprojection", plain, max(FLOOR_DB, plain.error_db(exact.image)))
    parts = [(s.radar.start_stop(), default_grid(s.radar, s.image)) for s in (study.scene, scene)]
    exact_seconds = [FOCUSERS["backprojection"].cpu_seconds(*part) for part in parts]
    for name in (*(f.name for f in FOCUSERS if f.name != "backprojection"), *_FACTORISED):
        if study.late("focuser"):
            return
        focuser = parse_focuser(name)
        if any(focuser.objection(*part) for part in parts):
            continue  # the focuser does not support the grid or the track
        trial = study.use_timer("focuser", focuser=name)
        stated = [focuser.error_db(*part) for part in parts]
        remark = f"states at most {stated[1]:.1f} dB for the whole" if np.isfinite(stated[1]) else ""
        grows = stated[1] - stated[0] if np.isfinite(stated).all() else 0.0
        slower = [
            focuser.cpu_seconds(*part) / exact for part, exact in zip(parts, exact_seconds, strict=True)
        ]
        error = trial.error_db(exact.image) + max(0.0, grows)
        study.note("focuser", name, trial, error, remark, {"focus": slower[1] / slower[0]})


def _effects(study: Sweeps, plan: EffectsPlan) -> None:
    """Switch off, in turn, the effects whose cost a scene with panes, pairs, edges, water or volumes decides on."""
    for name in _COSTLY:
        decision = next((d for d in plan.decisions if d.name == name), None)
        if decision is None or not decision.on or study.late(name):
            continue
        study.refresh()
        trial = study.run(**{name: "off"})
        study.note(name, "off", trial, trial.error_db(study.run().image), "against the effect on")


def _cells(study: Sweeps, plan: EffectsPlan) -> None:
    """Sweep the scatterer cell: other cells are other random surfaces, so that levels are compared, not pixels."""
    if not plan.flags.diffuse or study.late("scatterer_cell"):
        return
    cell = float(study.base.changes["scatterer_cell"])
    study.refresh()
    reference = study.run(scatterer_cell=cell)
    level = float(np.mean(np.abs(reference.image) ** 2))
    for factor in (0.5, 1.0, 2.0):
        if study.late("scatterer_cell"):
            return
        trial = reference if factor == 1.0 else study.run(scatterer_cell=factor * cell)
        change = db_from_power(float(np.mean(np.abs(trial.image) ** 2)) / level)
        study.note("scatterer_cell", factor * cell, trial, FLOOR_DB, f"mean level {change:+.2f} dB")


def _methods(study: Sweeps, scene: Scene, converged: Reference) -> None:
    """Measure the two image-domain methods, timed on the whole scene since they are fast; spacings of ``image``."""
    model = study.model
    for name in ("raster", "image"):
        if study.late(f"method {name}"):
            return
        try:
            study.now = trial = study.run(method=name)
            whole = study.trials.steady(scene, study.base.but(method=name))
        except SarmitsubaError:
            continue  # ideal points only, or a scene that the method does not support
        if name == "raster":
            study.row("method", name, trial, converged.error_db(trial.image), whole.seconds)
            continue
        method = study.base.but(method=name)
        model.full = {**model.full, name: whole_stages(scene, method, model.spacings, whole, study.trials)}
        factors = list(IMAGE_SPACINGS)
        for factor in factors:
            if study.late("method image"):
                return
            spacing = factor * model.spacings.coherent
            trial = study.run(method=name, **model.spacings.at(factor))
            error = converged.error_db(trial.image)
            model.errors[name, spacing] = error
            picks = {"ray_spacing": spacing}
            shown = name if factor == 1.0 else f"image, ray_spacing {spacing:.4g}"
            study.row("method", shown, trial, error, model.seconds(name, picks))
            study.extend(factors, factor, error)


def _raw_row(study: Sweeps) -> None:
    """Add method raw: its time follows from that of a key pulse; its error is not measured."""
    plain = study.plain
    factor = study.scene.radar.track.n_pulses / max(1, plain.statistics.key_pulses)
    seconds = sum(t * (factor if s == "trace" else 1.0) for s, t in plain.stages.items())
    remark = "time predicted from the key pulses'"
    study.rows.append(Row("method", "raw", FLOOR_DB, seconds, raw_seconds(study), float("nan"), remark))


def raw_seconds(study: Sweeps) -> float:
    """Seconds of method raw for the whole scene, as those of its key pulses."""
    factor = study.n_pulses / max(1, study.whole.statistics.key_pulses)
    return sum(
        t * (factor if s in ("launches", "rays") else 1.0) for s, t in study.model.full["hybrid"].items()
    )


def whole_stages(
    scene: Scene, setting: TrialSetting, spacings: RaySpacings, full: Trial, trials: Trials
) -> dict[str, float]:
    """Seconds by stage of a setting on the whole scene: fixed, proportional to launches and proportional to rays.

    They are separated by a second run with an eighth of the rays; of the common time the smaller one counts.
    """
    sparse = trials.steady(scene, hold_blocks(setting, full).but(**spacings.at(8.0**0.5)))
    same = {
        k: min(v, sparse.stages.get(k, v))
        for k, v in full.stages.items()
        if k not in ("trace", "launch grid")
    }
    return split_trace({**full.stages, **same}, sparse.stages, 8.0)


def hold_blocks(setting: TrialSetting, trial: Trial) -> TrialSetting:
    """Setting with the blocks of a trial: automatic ones are shorter for wider rays."""
    interval = trial.key_pulse_interval
    return setting.but(key_pulse_interval=interval) if interval > 1 else setting


def _deviates(seconds: float, reference: float) -> bool:
    """Whether a stage long enough to be timed takes another time than that of the reference."""
    low, high = sorted((seconds, reference))
    return high > TIMED and high > SAME * low


def _stages_of(trial: Trial, launch_seconds: float) -> dict[str, float]:
    """Seconds by stage, tracing split into parts proportional to launches and to rays."""
    out = {k: v for k, v in trial.stages.items() if k != "trace"}
    seconds = trial.stages.get("trace", 0.0)
    launches = min(launch_seconds * trial.statistics.key_pulses, 0.95 * seconds)
    return {**out, "launches": launches, "rays": seconds - launches}
