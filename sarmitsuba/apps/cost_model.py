"""Cost model of all combinations of swept values: errors add, stage times multiply, both corrected by runs."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sarmitsuba.apps.cost_report import Candidate, ProofRun
from sarmitsuba.apps.cost_trials import Changes, Value
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.simulation.planning.sampling.density_plan import RaySpacings

# error that counts as zero: float32 rounding and the error of the reference
FLOOR_DB = -80.0
# ratio of measured over modelled seconds, over the median of its method's, beyond which it is an outlier; at least, and
# in mean deviations from the median
OUTLIER, DEVIATIONS = 1.5, 4.0
# stages whose time depends on a parameter; other differences between two runs are disturbances
AFFECTS = {
    "ray_spacing": ("rays", "launch grid"),
    "max_depth": ("rays",),
    "gridding_width": ("launches", "rays", "synthesise"),
    "key_pulse_interval": ("launches", "rays", "synthesise"),
    "focuser": ("focus",),
}


@dataclass
class CostModel:
    """Results of the sweeps, and predictions for combinations.

    Parameters
    ----------
    spacings : automatic ray spacings
    full : seconds by stage of the plain setting on the whole scene, for ``hybrid`` and ``image``
    plain : values of the plain setting
    errors : of every (parameter, value), dB
    ratios : seconds by stage of every (parameter, value) over those of the plain setting; for ray spacings from the
        number of rays
    """

    spacings: RaySpacings
    full: Mapping[str, Mapping[str, float]]
    plain: Changes
    errors: dict[tuple[str, Value], float] = field(default_factory=dict)
    ratios: dict[tuple[str, Value], dict[str, float]] = field(default_factory=dict)

    def values(self, parameter: str) -> list[Value]:
        """Swept values of a parameter; the plain value if it was not swept, and always for key pulses."""
        swept = [v for p, v in self.errors if p == parameter]
        missing = not swept or (parameter == "key_pulse_interval" and self.plain[parameter] not in swept)
        return [*swept, self.plain[parameter]] if missing else swept

    def energy(self, parameter: str, value: Value) -> float:
        """Energy of the error, relative to the image."""
        return power_from_db(self.errors.get((parameter, value), FLOOR_DB))

    def seconds(self, method: str, picks: Changes) -> float:
        """Seconds for the whole scene: those of each stage times the ratios of its parameters."""
        total = 0.0
        for stage, seconds in self.full[method].items():
            for key, value in picks.items():
                if stage in AFFECTS[key]:
                    seconds *= self._ratio(key, value, stage)
            total += seconds
        return total

    def _ratio(self, parameter: str, value: Value, stage: str) -> float:
        """Ratio of the seconds of a stage with this value and with the plain value."""
        if parameter == "ray_spacing":  # as the number of rays
            return (float(self.plain[parameter]) / float(value)) ** 2
        own = self.ratios.get((parameter, value), {}).get(stage, 1.0)
        plain = self.ratios.get((parameter, self.plain[parameter]), {}).get(stage, 1.0)
        # key pulses are already relative to those of the whole scene
        return own / plain if plain > 0.0 and parameter != "key_pulse_interval" else own

    def combine(self) -> list[Candidate]:
        """All combinations with their predictions."""
        out = []
        names = ("ray_spacing", "max_depth", "gridding_width", "key_pulse_interval", "focuser")
        for values in itertools.product(*(self.values(name) for name in names)):
            picks = dict(zip(names, values, strict=True))
            # errors of the spacing sweep hold the reference's depth, the plain width and interval already
            total = sum(self.energy(k, picks[k]) for k in ("ray_spacing", "max_depth", "focuser"))
            for key in ("gridding_width", "key_pulse_interval"):
                total += max(0.0, self.energy(key, picks[key]) - self.energy(key, self.plain[key]))
            changes = {
                **picks,
                **self.spacings.at(float(picks["ray_spacing"]) / self.spacings.coherent),
                "method": "hybrid",
            }
            out.append(self._candidate("hybrid", picks, changes, total))
        spacings = [v for p, v in self.errors if p == "image"]
        for spacing, depth in itertools.product(spacings, self.values("max_depth")):
            picks = {"ray_spacing": spacing, "max_depth": depth}
            total = self.energy("image", spacing) + self.energy("max_depth", depth)
            changes = {
                **picks,
                **self.spacings.at(float(spacing) / self.spacings.coherent),
                "method": "image",
            }
            out.append(self._candidate("image", picks, changes, total))
        return out

    def _candidate(self, method: str, picks: Changes, changes: Changes, energy: float) -> Candidate:
        return Candidate(changes, db_from_power(energy), self.seconds(method, picks))


def correct_predictions(predicted: Sequence[Candidate], measured: Mapping[int, ProofRun]) -> list[Candidate]:
    """Candidates with measured values, or predictions corrected by the nearest measured candidate of their method.

    The seconds of measured candidates that are outliers among those of their method correct none. If none of the method
    was measured, the error is corrected by the median of all corrections.

    Parameters
    ----------
    predicted : all candidates
    measured : runs by index into ``predicted``
    """
    out = []
    odd = _outliers(predicted, measured)
    for i, candidate in enumerate(predicted):
        if i in measured:
            check = measured[i]
            out.append(Candidate(candidate.changes, check.error_db, check.seconds, True))
            continue
        same = [j for j in measured if predicted[j].changes["method"] == candidate.changes["method"]]
        error, seconds = candidate.error_db, candidate.seconds
        if same:
            j = min(same, key=lambda k: _distance(candidate.changes, predicted[k].changes))
            error += measured[j].error_db - predicted[j].error_db
            j = min(
                (k for k in same if k not in odd),
                key=lambda k: _distance(candidate.changes, predicted[k].changes),
            )
            seconds *= measured[j].seconds / predicted[j].seconds
        elif measured:
            error += float(np.median([m.error_db - predicted[k].error_db for k, m in measured.items()]))
        out.append(Candidate(candidate.changes, error, seconds))
    return out


def _outliers(predicted: Sequence[Candidate], measured: Mapping[int, ProofRun]) -> set[int]:
    """Measured candidates whose seconds no other one of at least three of their method confirms."""
    by_method: dict[Value, list[int]] = {}
    for j in measured:
        by_method.setdefault(predicted[j].changes["method"], []).append(j)
    out: set[int] = set()
    for same in by_method.values():
        if len(same) < 3:
            continue
        ratios = np.log([measured[j].seconds / predicted[j].seconds for j in same])
        off = np.abs(ratios - np.median(ratios))
        most = max(float(np.log(OUTLIER)), DEVIATIONS * float(np.median(off)))
        out |= {j for j, far in zip(same, off, strict=True) if far > most}
    return out


def _distance(a: Changes, b: Changes) -> float:
    """Distance of two settings: octaves of ray spacing and interval, steps of counted values, one for the focuser."""
    total = 0.0
    for key, value in a.items():
        if key not in b:
            continue  # the scene's own setting leaves it automatic
        if key in ("ray_spacing", "key_pulse_interval"):
            total += abs(float(np.log2(float(value) / float(b[key]))))
        elif key in ("max_depth", "gridding_width"):
            total += abs(float(value) - float(b[key]))
        elif key == "focuser":
            total += value != b[key]
    return total
