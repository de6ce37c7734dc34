"""Report of a cost study: table rows, combinations, recommended options of ``render``, and their verification.

A recommended setting is run: its error against a reference, and its seconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from sarmitsuba.apps.cost_trials import Changes, Trials, TrialSetting
from sarmitsuba.core.arrays import C64, C128, sum_energy
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.planning.sampling.density_plan import RaySpacings

Image = C64 | C128

# runs shorter than this are repeated, s
STEADY = 1.0
# factor of the expected seconds, either way, beyond which longer ones are repeated
DEVIATES = 1.25
# number of the first lattices of the reference, not used by any trial
REFERENCE_PASS = 1000


@dataclass(frozen=True, eq=False)
class Reference:
    """Converged reference image.

    Parameters
    ----------
    image : (n_azimuth, n_range) complex64, mean of two runs with different lattices
    noise : relative energy of the mean's error by ray sampling, from the difference of the two
    unseen : most relative energy of the bounces after its last one
    """

    image: C64
    noise: float
    unseen: float = 0.0

    @staticmethod
    def of(
        scene: Scene, setting: TrialSetting, grid: ImageGrid, trials: Trials, unseen: float = 0.0
    ) -> "Reference":
        """Trace it."""
        a, b = (trials.run(scene, setting, grid, pass_index=REFERENCE_PASS + i).image for i in range(2))
        mean = 0.5 * (a.astype(np.complex128) + b)
        return Reference(mean.astype(np.complex64), sum_energy(a - b) / (4.0 * sum_energy(mean)), unseen)

    def error_db(self, image: Image) -> float:
        """Energy of an image's error over that of the reference, dB, minus the reference's noise.

        At most half of the difference is attributed to the reference. Bounces that the reference lacks count as error.
        """
        ratio = sum_energy(image - self.image) / sum_energy(self.image)
        return db_from_power(max(ratio - self.noise, 0.5 * ratio, 1e-12) + self.unseen)


@dataclass(frozen=True)
class ProofRun:
    """Measured error (dB) and time (s) of a setting."""

    error_db: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Proof:
    """Measurement of the error and time of settings.

    Parameters
    ----------
    scene : whole scene, for the time
    field : part of the scene for the error: the whole scene if a reference of it fits the budget
    grid : of the field's image
    base : settings to be changed
    reference : image of the field
    factor : ray spacing of the reference, relative to the automatic one
    text : description of the field
    trials : of the study
    """

    scene: Scene
    field: Scene
    grid: ImageGrid
    base: TrialSetting
    reference: Reference
    factor: float
    text: str
    trials: Trials

    def cost(self, seconds: float) -> float:
        """Seconds for :meth:`measure` of a setting that takes ``seconds`` for the whole scene."""
        return seconds * ((2.0 if seconds < STEADY else 1.0) + (self.field is not self.scene))

    def measure(self, changes: Changes, pass_index: int = 0, expected: float | None = None) -> ProofRun:
        """Error on the field and seconds on the whole scene, with these lattices.

        Short runs, and those that deviate from the ``expected`` seconds, are repeated
        (:meth:`sarmitsuba.apps.cost_trials.Trials.steady`).
        """
        setting = self.base.but(**changes)
        trial = self.trials.run(self.field, setting, self.grid, pass_index=pass_index)
        error = self.reference.error_db(trial.image)
        if self.field is not self.scene:
            trial = self.trials.run(self.scene, setting, pass_index=pass_index)
        seconds = trial.seconds
        off = max(seconds / expected, expected / seconds) if expected and seconds > 0.0 else 1.0
        if seconds < STEADY or off > DEVIATES:
            seconds = self.trials.steady(self.scene, setting, pass_index=pass_index).seconds
        return ProofRun(error, seconds)


# least significant gain in error, dB
STEP_DB = 0.5
# margin above which a recommendation better than wanted is explained, dB
SPARE_DB = 3.0
# energy of bounces after a reference's last one, relative to the image, that is named
NAMED_UNSEEN = 1e-4
# lattices of the check, not used by any sweep or estimate
CHECK_PASS = 7


class _Rated(Protocol):
    """Something with an error, dB, and seconds."""

    @property
    def error_db(self) -> float: ...

    @property
    def seconds(self) -> float: ...


_R = TypeVar("_R", bound=_Rated)


@dataclass(frozen=True)
class Row:
    """Row of the table.

    Parameters
    ----------
    parameter, value : changed parameter of the plain setting, and its value
    error_db : of that change alone, against the best value of the same parameter with the same rays; for ray spacing
        and methods against the converged reference
    seconds : for the swept piece of the scene, without compiling
    full_seconds : predicted for the whole scene
    megabytes : growth of the memory for the piece
    remark : definition of the error, where it differs
    """

    parameter: str
    value: str
    error_db: float
    seconds: float
    full_seconds: float
    megabytes: float
    remark: str = ""


@dataclass(frozen=True)
class Candidate:
    """Combination of settings with its estimated error and time for the whole scene.

    Parameters
    ----------
    changes : of the scene's settings
    error_db, seconds : estimated
    measured : whether this combination was run; else the estimate is from its neighbours
    """

    changes: Changes
    error_db: float
    seconds: float
    measured: bool = False

    def estimate(self) -> str:
        """Text with error and seconds, marked if predicted by the model alone."""
        return f"{self.error_db:.1f} dB in {self.seconds:.2f} s" + ("" if self.measured else " (predicted)")


@dataclass(frozen=True)
class Recommendation:
    """Cheapest setting for a wanted error.

    Parameters
    ----------
    target_error_db : wanted error
    setting : the cheapest with this estimated error, or else the most accurate
    met : whether the estimate meets the target
    remark : reason for a setting much better than wanted
    """

    target_error_db: float
    setting: Candidate
    met: bool
    remark: str = ""

    def options(self) -> str:
        """Options of ``render`` for the setting."""
        return options_of(self.setting.changes)


@dataclass(frozen=True, eq=False)
class CostReport:
    """Results of :func:`sarmitsuba.apps.cost.study_cost`.

    Parameters
    ----------
    rows : of the table
    candidates : all combinations
    front : Pareto front of the candidates in error and time, by time
    recommendation : for the requested error
    proof : measurement of errors and times
    piece : description of the swept part of the scene
    check : independent run of the recommendation; None: the budget was exhausted
    full_seconds : measured seconds of the plain setting for the whole scene
    reference : description of the sweeps' reference
    estimated_against : description of the reference of the combinations
    budget : s, of the study
    skipped : sweeps that the budget left no time for, or cut short
    reused : trials of an earlier study that were not repeated
    own : the scene's setting
    seconds : of the whole study, without compiling
    compile_seconds : of compiling
    """

    rows: tuple[Row, ...]
    candidates: tuple[Candidate, ...]
    front: tuple[Candidate, ...]
    recommendation: Recommendation
    proof: Proof
    piece: str
    check: ProofRun | None
    full_seconds: float
    reference: str
    estimated_against: str
    budget: float
    skipped: tuple[str, ...]
    reused: int
    own: Candidate
    seconds: float
    compile_seconds: float

    @property
    def unseen_db(self) -> float:
        """Most energy of bounces that the references lack, relative to the image, dB: no smaller error is shown."""
        unseen = self.proof.reference.unseen
        return db_from_power(unseen)

    def recommend(self, target_error_db: float) -> Recommendation:
        """Cheapest setting for another error, from the existing measurements."""
        return recommend(self.candidates, target_error_db, self.skipped, self.own)

    def verify(self, recommendation: Recommendation) -> ProofRun:
        """Run a recommendation with lattices not used for any estimate."""
        return self.proof.measure(recommendation.setting.changes, CHECK_PASS)


def recommend(
    candidates: Sequence[Candidate],
    target_error_db: float,
    skipped: Sequence[str] = (),
    own: Candidate | None = None,
) -> Recommendation:
    """Cheapest combination that meets the target by its estimate, or the most accurate one.

    None that is slower than the scene's setting and no more accurate.

    Parameters
    ----------
    candidates : all combinations
    target_error_db : wanted error
    skipped : sweeps that were left out or cut short, for the remark
    own : the scene's setting, one of the combinations
    """
    if own is not None:
        candidates = [c for c in candidates if c is own or not beaten(c, own)]
    front = pareto(candidates)
    good = [c for c in front if c.error_db <= target_error_db]
    if not good:
        best = min(c.error_db for c in candidates)
        near = [c for c in candidates if c.error_db <= best + 2.0 * STEP_DB]
        return Recommendation(target_error_db, min(near, key=lambda c: c.seconds), False)
    chosen = good[0]
    remark = ""
    if chosen.error_db < target_error_db - SPARE_DB:
        cheaper = [c for c in front if c.seconds < chosen.seconds]
        if cheaper:
            next_best = cheaper[-1]
            remark = f"the next cheaper has {next_best.estimate()}"
        elif skipped:
            remark = (
                f"nothing cheaper was found, but not all was tried: no time was left for {', '.join(skipped)}"
            )
        else:
            remark = "nothing cheaper was found: the remaining time is common to all runs"
    return Recommendation(target_error_db, chosen, True, remark)


def beaten(candidate: _Rated, own: _Rated) -> bool:
    """Whether a setting is slower than another and no more accurate."""
    return candidate.seconds > own.seconds and candidate.error_db >= own.error_db


def pareto(candidates: Sequence[_R]) -> list[_R]:
    """Pareto front of the candidates, with steps of at least ``STEP_DB``, by time."""
    front: list[_R] = []
    for candidate in sorted(candidates, key=lambda c: (c.seconds, c.error_db)):
        if not front or candidate.error_db < front[-1].error_db - STEP_DB:
            front.append(candidate)
    return front


def reference_text(spacings: RaySpacings, factor: float, depth: int, unseen: float) -> str:
    """Description of a reference with ``factor`` times the automatic ray spacing and ``depth`` bounces.

    Named is the share of the energy of later bounces, ``unseen``, from ``NAMED_UNSEEN`` on.
    """
    later = f" (later ones hold at most {db_from_power(unseen):.0f} dB)" if unseen >= NAMED_UNSEEN else ""
    return (
        f"the mean of 2 runs with different lattices, ray_spacing {factor * spacings.coherent:.3g} m ({factor:g} of "
        f"the automatic one), {depth} bounces{later}, gridding_width 6"
    )


def options_of(changes: Changes) -> str:
    """Options of ``render`` for these settings: ``-D sar_path.max_depth=3 ... --method hybrid``.

    With one set of rays, as in the study: two subsets for error bars would need more launches and twice the focusing.
    """
    words = []
    for key, value in changes.items():
        if key in ("method", "focuser"):
            continue
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        text = text.lower() if isinstance(value, bool) else text
        words.append(f"-D sar_path.{key}={text}")
    words += [f"--{key} {changes[key]}" for key in ("method", "focuser") if key in changes]
    return " ".join([*words, "--no-error-bars"])
