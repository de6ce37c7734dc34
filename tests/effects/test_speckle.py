"""Speckle of traced and focused ground: distributions, correlation, looks."""

import numpy as np
import pytest

from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CaseEntry
from sarmitsuba.truth.validation.cases.speckle import distributions
from sarmitsuba.truth.validation.run_cases import run_case, select


# correlation wants a second image, windowed; test_focus_windows holds the response that it follows
@pytest.mark.parametrize(
    "entry",
    [
        pytest.param(entry, marks=pytest.mark.slow if entry.name == "correlation" else ())
        for entry in select(topics=["statistics"])
    ],
    ids=lambda e: e.name,
)
def test_case(entry: CaseEntry) -> None:
    """Every comparison within its own tolerance, whose reason the case states."""
    case = run_case(entry, quick=True)
    assert case.passed, case.failures()


def test_enough_independent_pixels() -> None:
    case = distributions(True)
    assert "n = 1" in case.comparisons[0].label
    n = int(case.comparisons[0].label.rpartition(" ")[2])
    assert n >= 100_000


def test_the_tests_of_speckle_have_power() -> None:
    """What they accept is speckle: 2 % of a wrong mean or a coherent part of -20 dB is rejected."""
    rng = np.random.default_rng(3)
    z = (rng.standard_normal(100_000) + 1j * rng.standard_normal(100_000)) / np.sqrt(2.0)
    assert theory.intensity_test(np.abs(z) ** 2, mean=1.0).accepts(0.999)
    assert not theory.intensity_test(np.abs(z) ** 2, mean=1.03).accepts(0.999)
    assert not theory.phase_test(z + 0.1).accepts(0.999)
