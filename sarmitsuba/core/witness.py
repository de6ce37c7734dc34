"""Witness of a fast stage: its error, measured in the run on a drawn sample that is recomputed exactly."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power

# dB above what a law foretold from which a run says so
CONTRADICTION_DB = 3.0
# dB, error that changes no figure in use, whatever a law foretold
NEGLIGIBLE_DB = -60.0
# dB, error of a result above which it is of no use
USELESS_DB = -10.0
# probability that the error of the whole lies below the upper level
CONFIDENCE = 0.95
_DRAWS = 500


@dataclass(frozen=True)
class Witness:
    """Error of a stage relative to its result, measured on a sample.

    Parameters
    ----------
    error_db : energy of the error over that of the result, dB; -inf: none
    upper_db : level below which the error of the whole result lies with probability ``CONFIDENCE``, dB
    samples : number of values that were recomputed
    law_db : error that a law foretold before the run, dB; NaN: none did
    reference : exact way that the sample was recomputed by
    """

    error_db: float
    upper_db: float
    samples: int
    law_db: float = math.nan
    reference: str = ""

    @staticmethod
    def from_weighted(
        error: F64, energy: F64, seed: int, *, law_db: float = math.nan, reference: str = ""
    ) -> "Witness":
        """Witness from the energies of a sample.

        Parameters
        ----------
        error : (n,) float64, energy of the error of each value, weighted by the inverse of its chance to be drawn
        energy : (n,) float64 weighted alike, or (1,) float64, known energy of the whole result, in the same unit
        seed : of the bootstrap
        law_db, reference : see the class

        Notes
        -----
        The upper level is the 95 % quantile of a bootstrap over the sample, and once more the largest error drawn:
        where a few values hold the error, some like it were not drawn. Draw the strongest values and the edges with
        certainty.
        """
        error, energy = np.asarray(error, dtype=np.float64), np.asarray(energy, dtype=np.float64)
        picks = np.random.default_rng(seed).integers(0, max(error.size, 1), (_DRAWS, error.size))
        whole = (
            np.broadcast_to(energy.sum(), _DRAWS) if energy.size != error.size else energy[picks].sum(axis=1)
        )
        drawn = error[picks].sum(axis=1)
        shares = np.divide(drawn, whole, out=np.full(_DRAWS, np.inf), where=whole > 0.0)
        level = _db(float(error.sum()), float(energy.sum()))
        upper = math.nan
        if error.size:
            largest = _power(float(error.max()), float(energy.sum()))
            upper = _db(float(np.quantile(shares, CONFIDENCE, method="higher")) + largest, 1.0)
        return Witness(level, max(upper, level), int(error.size), law_db, reference)

    @property
    def contradicts(self) -> bool:
        """Whether the error lies more than ``CONTRADICTION_DB`` above the law's prediction, and is not negligible."""
        # without a law the maximum is NaN, and the comparison false
        return self.error_db > max(self.law_db + CONTRADICTION_DB, NEGLIGIBLE_DB)

    @property
    def useless(self) -> bool:
        """Whether the error is so large that the result is of no use."""
        return not self.error_db <= USELESS_DB

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; None for no error, or no law."""
        return {
            "error_db": _finite(self.error_db),
            "upper_db": _finite(self.upper_db),
            "samples": self.samples,
            "confidence": CONFIDENCE,
            "law_db": _finite(self.law_db),
            "reference": self.reference,
        }

    @staticmethod
    def read(facts: object) -> "Witness | None":
        """Witness from the metadata of a file; None where there is none, or where its values are not numbers."""
        if not isinstance(facts, Mapping) or not isinstance(facts.get("samples"), int):
            return None
        return Witness(
            _number(facts.get("error_db"), -math.inf),
            _number(facts.get("upper_db"), -math.inf),
            int(facts["samples"]),
            _number(facts.get("law_db"), math.nan),
            str(facts.get("reference", "")),
        )


def _power(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.inf


def _db(part: float, whole: float) -> float:
    if part <= 0.0:
        return -math.inf
    return db_from_power(part / whole) if whole > 0.0 else math.inf


def _finite(value: float) -> float | None:
    return round(value, 2) if math.isfinite(value) else None


def _number(value: object, none: float) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else none
