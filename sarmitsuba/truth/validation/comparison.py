"""Comparison of a closed form with the simulation: curves, deviation and tolerance.

A case is one physical effect with one plot; its comparisons are the curves in it. Every comparison holds the closed
form, the simulated values and the tolerance with its reason, common to tests, table and plots.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64

# topics in the order of the page, with their headings
# Kolmogorov's critical distance at 99.9 %, times the square root of the number of samples
CONFIDENCE, CRITICAL_DISTANCE = 0.999, 1.9495
# dB by which an rms deviation may exceed the stated error
STATED_MARGIN = 2.0

TOPICS = {
    "canonical": "Canonical radar cross sections",
    "materials": "Materials",
    "rough": "Rough surfaces",
    "geometry": "Geometry of the image",
    "radiometry": "Radiometry end to end",
    "vegetation": "Vegetation",
    "modes": "Radar modes",
    "orbits": "Orbits",
    "antenna": "Antenna, ambiguities and pulse timing",
    "polarimetry": "Polarimetry",
    "interferometry": "Interferometry",
    "statistics": "Statistics",
    "full_wave": "Against exact solutions: where physical optics ends",
    "measured": "Against chamber measurements and a full-wave solver",
}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of one closed form with the simulation.

    Parameters
    ----------
    label : of the curve, e.g. ``X band, HH``
    x : (n,) float64, in the case's ``x_label``
    theory, simulated : (n,) float64, in ``unit``
    tolerance : largest accepted deviation, in ``unit``
    reason : cause of a deviation of this size
    unit : ``dB``, ``dBsm``, ``m``, ``deg`` or empty
    floor : points are compared where the theory lies within this of its peak, in ``unit``; a closed form's
        nulls are finer than any sampling and mean nothing in dB
    canonical : whether it counts in the summary over the canonical radar cross sections, where the theory holds
    shown : index of the point in the table; None: the peak of the theory
    drawn : range of the plot below the theory's peak, in ``unit``; None: that of the compared points
    judged : statistic of the deviation that the tolerance bounds: its largest modulus, or its root mean square
    reference : name of the theory in the plot
    measured : (n,) float64, in ``unit``, measurements beside the theory, NaN where there are none; None: no measurement
    stated : rms error in dB that the simulation itself states, exceeded by at most ``STATED_MARGIN``; NaN: none
    """

    label: str
    x: F64
    theory: F64
    simulated: F64
    tolerance: float
    reason: str
    unit: str = "dBsm"
    floor: float = np.inf
    canonical: bool = False
    shown: int | None = None
    drawn: float | None = None
    judged: Literal["worst", "rms"] = "worst"
    reference: str = "theory"
    measured: F64 | None = None
    stated: float = float("nan")

    @property
    def compared(self) -> NDArray[np.bool_]:
        """Points that are compared, (n,) bool."""
        finite = np.isfinite(self.theory)
        if not finite.any():
            return finite
        return finite & (self.theory >= np.max(self.theory[finite]) - self.floor)

    @property
    def deviation(self) -> F64:
        """Deviation, simulated minus theory, (n,) float64; nan where not compared."""
        out = np.full(self.theory.shape, np.nan)
        keep = self.compared
        out[keep] = self.simulated[keep] - self.theory[keep]
        return out

    @property
    def worst(self) -> float:
        """Largest modulus of the deviation; infinite when a compared value is not a number."""
        d = np.abs(self.deviation[self.compared])
        return float(np.max(d)) if d.size and np.isfinite(d).all() else float("inf")

    @property
    def median(self) -> float:
        """Median modulus of the deviation."""
        d = np.abs(self.deviation[self.compared])
        return float(np.median(d)) if d.size and np.isfinite(d).all() else float("inf")

    @property
    def rms(self) -> float:
        """Root mean square of the deviation; infinite when a compared value is not a number."""
        d = self.deviation[self.compared]
        return float(np.sqrt(np.mean(d**2))) if d.size and np.isfinite(d).all() else float("inf")

    @property
    def measured_rms(self) -> float:
        """Root mean square of measurement minus theory at the compared points; NaN without measurements."""
        if self.measured is None:
            return float("nan")
        return float(np.sqrt(np.mean((self.measured - self.theory)[self.compared] ** 2)))

    @property
    def figure(self) -> float:
        """Statistic of the deviation that the tolerance bounds."""
        return self.rms if self.judged == "rms" else self.worst

    @property
    def passed(self) -> bool:
        """Whether that statistic stays within the tolerance, and the error is as stated."""
        return self.figure <= self.tolerance and not self.understated

    @property
    def understated(self) -> bool:
        """Whether the rms deviation exceeds the stated error by more than ``STATED_MARGIN``."""
        return self.rms > self.stated + STATED_MARGIN

    @property
    def index(self) -> int:
        """Index of the point in the table."""
        if self.shown is not None:
            return self.shown
        return int(np.argmax(np.where(self.compared, self.theory, -np.inf)))


@dataclass(frozen=True, eq=False)
class Case:
    """Validation case: a closed form with its source, and comparisons that share one plot.

    Parameters
    ----------
    name : of the plot's file and of the command line
    topic : one of ``TOPICS``, or another word, which adds a section at the end of the page
    title : one line
    formula : the closed form in plain text
    source : publication of the closed form or value
    x_label, y_label : with units
    comparisons : one curve each
    note : description of the set-up: target, ray spacing, cut
    """

    name: str
    topic: str
    title: str
    formula: str
    source: str
    x_label: str
    y_label: str
    comparisons: tuple[Comparison, ...]
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether every comparison is within its tolerance."""
        return all(c.passed for c in self.comparisons)

    def failures(self) -> str:
        """One line per comparison that is out of tolerance; empty when all are within."""
        return "; ".join(
            f"{self.name} [{c.label}]: {c.judged} deviation {c.figure:.3g} {c.unit} "
            + (f"where {c.stated:.3g} dB are stated" if c.understated else f"> {c.tolerance:g}")
            for c in self.comparisons
            if not c.passed
        )


@dataclass(frozen=True)
class Summary:
    """Deviation over all compared points of the canonical cases, dB.

    Parameters
    ----------
    median, worst : of the modulus of the deviation
    n_points, n_comparisons : numbers included
    n_failed : comparisons of any case out of tolerance
    """

    median: float
    worst: float
    n_points: int
    n_comparisons: int
    n_failed: int


def summarise(cases: Sequence[Case]) -> Summary:
    """Median and worst deviation over every compared point of the canonical cases."""
    canonical = [c for case in cases for c in case.comparisons if c.canonical]
    deviations = [np.abs(c.deviation[c.compared]) for c in canonical]
    d = np.concatenate(deviations) if deviations else np.zeros(0)
    failed = sum(not c.passed for case in cases for c in case.comparisons)
    return Summary(
        median=float(np.median(d)) if d.size else float("nan"),
        worst=float(np.max(d)) if d.size else float("nan"),
        n_points=int(d.size),
        n_comparisons=len(canonical),
        n_failed=failed,
    )
