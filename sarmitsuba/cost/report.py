"""Report of a cost study: table rows, combinations, recommendations as options of ``render``."""

from collections.abc import Sequence
from dataclasses import dataclass

from sarmitsuba.cost.proof import Proof, ProofRun
from sarmitsuba.cost.trial import Changes
from sarmitsuba.simulation.sampling.density_plan import RaySpacings

# a smaller gain in error is not worth a line of its own, nor any time
STEP_DB = 0.5
# a recommendation better than wanted by more than this is explained
SPARE_DB = 3.0
# lattices of the check: no sweep and no estimate uses them
CHECK_PASS = 7


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Parameters
    ----------
    parameter, value : what was changed about the plain setting, and to what
    error_db : of that change alone, against the best value of the same parameter with the same rays; for ray spacing
        and methods against the converged reference
    seconds : on the piece of the scene that was swept, without compiling
    full_seconds : predicted for the whole scene
    megabytes : growth of the memory on the piece
    remark : what the error is measured as, where it is not the plain one
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
    """A combination of settings with its estimated error and time on the whole scene.

    Parameters
    ----------
    changes : about the scene's settings
    error_db, seconds : estimated
    measured : the estimate is from a run of this very combination, not from those of its neighbours
    """

    changes: Changes
    error_db: float
    seconds: float
    measured: bool = False

    def estimate(self) -> str:
        """Error and seconds, marked where nothing but the model says so."""
        return f"{self.error_db:.1f} dB in {self.seconds:.2f} s" + ("" if self.measured else " (predicted)")


@dataclass(frozen=True)
class Recommendation:
    """The cheapest setting for a wanted error.

    Parameters
    ----------
    target_error_db : wanted
    setting : the cheapest that estimates it, or the most accurate where none does
    met : whether the target is estimated
    remark : why the setting is much better than wanted, where it is
    """

    target_error_db: float
    setting: Candidate
    met: bool
    remark: str = ""

    def options(self) -> str:
        """As options of ``render``."""
        return options_of(self.setting.changes)


@dataclass(frozen=True, eq=False)
class CostReport:
    """Results of :func:`sarmitsuba.cost.study.study_cost`.

    Parameters
    ----------
    rows : the table
    candidates : every combination
    front : those that none beats in both error and time, by time
    recommendation : for the error that the study was asked for
    proof : where estimates were measured and are checked
    piece : which part of the scene was swept
    check : an independent run of the recommendation; None where the budget ended before
    full_seconds : measured seconds of the plain setting on the whole scene
    reference : what the sweeps' errors are against
    estimated_against : what the errors of the combinations are against
    seconds : of the whole study
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
    seconds: float

    def recommend(self, target_error_db: float) -> Recommendation:
        """The cheapest setting for another error, from what was measured: nothing is run."""
        return recommend(self.candidates, target_error_db)

    def verify(self, recommendation: Recommendation) -> ProofRun:
        """Run a recommendation with lattices that no estimate used."""
        return self.proof.measure(recommendation.setting.changes, CHECK_PASS)


def recommend(candidates: Sequence[Candidate], target_error_db: float) -> Recommendation:
    """The cheapest combination that estimates the target, or the most accurate one."""
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
        else:
            remark = "nothing cheaper was found: what is left is the time that every run takes"
    return Recommendation(target_error_db, chosen, True, remark)


def pareto(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that none beats in both by more than ``STEP_DB``, by time."""
    front: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: (c.seconds, c.error_db)):
        if not front or candidate.error_db < front[-1].error_db - STEP_DB:
            front.append(candidate)
    return front


def reference_text(spacings: RaySpacings, factor: float, depth: int) -> str:
    """What a reference is, whose rays are ``factor`` automatic distances apart."""
    return (
        f"the mean of 2 runs with lattices of their own, ray_spacing {factor * spacings.coherent:.3g} m ({factor:g} of "
        f"the automatic one), {depth} bounces, gridding_width 6"
    )


def options_of(changes: Changes) -> str:
    """Options of ``render`` that make these settings: ``-D sar_path.max_depth=3 ... --method hybrid``.

    One set of rays, as in the study: two subsets for error bars would take more launches and twice the focusing.
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
