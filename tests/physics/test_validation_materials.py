"""Fresnel coefficients through the kernel and rough surfaces: quick runs of the validation page's cases."""

import numpy as np
import pytest

from sarmitsuba import theory
from sarmitsuba.validation.cases import diffuse as validation_diffuse
from sarmitsuba.validation.cases import materials as validation_materials
from sarmitsuba.validation.cases import rough as validation_rough
from sarmitsuba.validation.comparison import CaseEntry

CASES = validation_materials.CASES + validation_diffuse.CASES + validation_rough.CASES


@pytest.mark.parametrize("entry", CASES, ids=lambda e: e.name)
def test_case(entry: CaseEntry) -> None:
    """Every comparison within its own tolerance, whose reason the case states."""
    case = entry.build(True)
    assert case.passed, case.failures()


def test_brewster_angle_and_perfect_limits() -> None:
    """A lossless medium has an exact zero of TM; grazing waves turn over; metal is nearly perfect."""
    brewster = np.cos(np.arctan(2.0))
    te, tm = validation_materials.kernel_fresnel(np.array([brewster]), 4.0 + 0j)
    assert abs(tm[0]) < 1e-6 < abs(te[0])  # tol: float32 cosine
    grazing = np.cos(np.radians(np.array([89.99])))
    for eps in validation_materials.PERMITTIVITY.values():
        te, tm = validation_materials.kernel_fresnel(grazing, eps)
        want = theory.fresnel(grazing, eps)
        assert abs(te[0] - want[0][0]) < 1e-5 and abs(tm[0] - want[1][0]) < 1e-5  # asked for
    te, tm = validation_materials.kernel_fresnel(np.array([1.0]), validation_materials.PERMITTIVITY["metal"])
    # 1 - |R|^2 = 4 R_s / eta of a real metal
    np.testing.assert_allclose(
        1.0 - abs(te[0]) ** 2, 6.669e-4, rtol=2e-3
    )  # tol: float32 rounding of 1 - |R|^2
    np.testing.assert_allclose(te[0], -tm[0], rtol=1e-6)
