"""What a cost study reports: table rows, combinations, the recommendation as options of ``render``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.spec import Scene
from sarmitsuba.trace.window import diffuse_spacing, launch_window, ray_spacing


@dataclass(frozen=True)
class Rays:
    """Automatic distances between rays, m; ``diffuse`` is 0 where nothing scatters diffusely."""

    coherent: float
    diffuse: float

    @staticmethod
    def of(scene: Scene, plan: EffectsPlan) -> "Rays":
        """What the whole scene would be sampled with."""
        window = launch_window(scene)
        diffuse = diffuse_spacing(scene, window) if plan.flags.diffuse else 0.0
        return Rays(ray_spacing(scene, window, not plan.flags.coherent, plan.flags.coherent), diffuse)

    def at(self, factor: float) -> dict[str, float]:
        """Settings of this many times the automatic distances."""
        out = {"ray_spacing": factor * self.coherent}
        return out | ({"diffuse_ray_spacing": factor * self.diffuse} if self.diffuse else {})


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
    """A combination of settings with its predicted error and time on the whole scene."""

    changes: Mapping[str, Any]
    error_db: float
    seconds: float


@dataclass(frozen=True, eq=False)
class CostReport:
    """What :func:`study_cost` found.

    Parameters
    ----------
    rows : the table
    candidates : every combination, predicted
    front : those that none beats in both error and time, by time
    recommended : the cheapest that meets the target, or the most accurate where none does
    target_error_db, met : what was wanted and whether the recommendation promises it
    piece : which part of the scene was swept
    check : measured error (piece) and seconds (whole scene) of the recommendation; NaN where the budget ended
    full_seconds : measured seconds of the plain setting on the whole scene
    reference : what errors are against
    seconds : of the whole study
    """

    rows: tuple[Row, ...]
    candidates: tuple[Candidate, ...]
    front: tuple[Candidate, ...]
    recommended: Candidate
    target_error_db: float
    met: bool
    piece: str
    check: Mapping[str, float]
    full_seconds: float
    reference: str
    seconds: float

    def options(self) -> str:
        """The recommendation as options of ``render``."""
        return options_of(self.recommended.changes)


def options_of(changes: Mapping[str, Any]) -> str:
    """Options of ``render`` that make these settings: ``-D sar_path.max_depth=3 ... --method hybrid``."""
    words = []
    for key, value in changes.items():
        if key in ("method", "focuser"):
            continue
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        words.append(f"-D sar_path.{key}={text}")
    words += [f"--{key} {changes[key]}" for key in ("method", "focuser") if key in changes]
    return " ".join(words)


__all__ = ["Candidate", "CostReport", "Rays", "Row", "options_of"]
