"""Fresnel coefficients through the kernel at their limits; whole curves are the case ``fresnel_kernel``."""

import numpy as np

from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases.fresnel import kernel_fresnel
from sarmitsuba.truth.validation.targets import PERMITTIVITY


def test_brewster_angle_and_perfect_limits() -> None:
    """A lossless medium has an exact zero of TM; grazing waves turn over; metal is nearly perfect."""
    brewster = np.cos(np.arctan(2.0))
    te, tm = kernel_fresnel(np.array([brewster]), 4.0 + 0j)
    assert abs(tm[0]) < 1e-6 < abs(te[0])  # tol: float32 cosine
    grazing = np.cos(np.radians(np.array([89.99])))
    for eps in PERMITTIVITY.values():
        te, tm = kernel_fresnel(grazing, eps)
        want = theory.fresnel(grazing, eps)
        assert abs(te[0] - want[0][0]) < 1e-5 and abs(tm[0] - want[1][0]) < 1e-5  # asked for
    te, tm = kernel_fresnel(np.array([1.0]), PERMITTIVITY["metal"])
    # 1 - |R|^2 = 4 R_s / eta of a real metal
    np.testing.assert_allclose(
        1.0 - abs(te[0]) ** 2, 6.669e-4, rtol=2e-3
    )  # tol: float32 rounding of 1 - |R|^2
    np.testing.assert_allclose(te[0], -tm[0], rtol=1e-6)
