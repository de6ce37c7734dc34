"""Canonical targets over angle, frequency and polarisation: the quick runs of the validation page's cases."""

import numpy as np
import pytest

from sarmitsuba import theory
from sarmitsuba.validation.cases import canonical as validation_canonical
from sarmitsuba.validation.cases import corners as validation_corners
from sarmitsuba.validation.comparison import CaseEntry, summarise

FAST = validation_canonical.CASES + validation_corners.CASES


@pytest.mark.parametrize("entry", FAST, ids=lambda e: e.name)
def test_case(entry: CaseEntry) -> None:
    """Every comparison within its own tolerance, whose reason the case states."""
    case = entry.build(True)
    assert case.passed, case.failures()


@pytest.mark.slow
def test_all_bands() -> None:
    """L, C, X and Ka: median deviation below 0.1 dB, worst below 0.3 dB where the closed forms hold."""
    cases = [entry.build(False) for entry in FAST]
    total = summarise(cases)
    assert not [case.failures() for case in cases if not case.passed]
    assert total.median < 0.1  # asked for
    assert total.worst < 0.3  # asked for
    assert total.n_points > 2000


def test_the_summary_counts_what_it_says() -> None:
    case = validation_corners.tessellation(True)
    assert summarise([case]).n_points == 0  # compared with itself: not canonical
    plate = validation_canonical.plate(True)
    total = summarise([plate])
    compared = [c.compared for c in plate.comparisons]
    assert total.n_points == sum(int(c.sum()) for c in compared)
    assert all(0.2 < c.mean() < 1.0 for c in compared)  # nulls are left out, lobes are not
    assert total.worst == pytest.approx(max(c.worst for c in plate.comparisons))


def test_three_sidelobes_of_a_plate_are_compared() -> None:
    """The floor lets the peaks of three sidelobes through: -13.3, -17.8 and -20.8 dB."""
    comparison = validation_canonical.plate(True).comparisons[0]
    y = comparison.theory
    peaks = [i for i in range(1, y.size - 1) if y[i] > y[i - 1] and y[i] > y[i + 1]]
    assert len(peaks) == 3 and comparison.compared[peaks].all()


def test_sphere_series_against_miepython() -> None:
    miepython = pytest.importorskip("miepython")
    x = np.array([20.0, 60.0, 100.0])
    _, _, back, _ = (np.asarray(v) for v in miepython.efficiencies_mx(-10000j + 0.0, x))
    # tol: a refractive index of 10000 j is not infinite
    np.testing.assert_allclose(theory.sphere_mie(x), back, rtol=2e-3)
