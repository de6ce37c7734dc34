"""Energy of returns in phase over a resolution cell against the double integral that it estimates."""

import numpy as np
import pytest

from sarmitsuba.simulation.execution.in_phase import PatchReturns, azimuth_bin, measure_in_phase

LENGTH, BIN = 12.0, 1.5


def line(rng: np.random.Generator, n: int, phases: float) -> PatchReturns:
    """Patches at random along a line at one range, of one strength, in phase or not; an empty second order."""
    field = np.zeros((n, 2, 1), dtype=np.complex128)
    field[:, 0, 0] = 3.0 * np.exp(1j * phases * rng.uniform(-np.pi, np.pi, n))
    place = np.zeros((n, 2))
    place[:, 0] = rng.uniform(0.0, LENGTH, n)
    return PatchReturns(field, np.full((n, 2), 0.3), place, 0.5, BIN, 7.0)


@pytest.mark.parametrize("phases", [0.0, 1.0])
def test_mean_and_error_over_draws(phases: float) -> None:
    rng = np.random.default_rng(5)
    draws = [measure_in_phase(line(rng, 60, phases)) for _ in range(400)]
    mean, error = np.array([m[0] for m, _ in draws]), np.sqrt([v[0] for _, v in draws])
    # of a triangle of half width b and its integral over a line of length L
    exact = 7.0 * 9.0 * (BIN / LENGTH - BIN**2 / (3.0 * LENGTH**2)) * (phases == 0.0)
    # tol: four standard errors of 400 draws, and 2 % for four places of the bins
    assert mean.mean() == pytest.approx(exact, rel=0.02, abs=4.0 * mean.std() / 20.0)
    # random phases cancel: the error is of the pairs without regard to their signs
    assert 0.8 * mean.std() < error.mean() < 3.0 * mean.std() + (phases > 0.0) * 7.0 * 9.0 * BIN / LENGTH
    assert all(m[1] == v[1] == 0.0 for m, v in draws)


def test_bins_apart_have_no_pairs() -> None:
    returns = line(np.random.default_rng(1), 2, 0.0)
    returns.range_rate[:, 0] = 0.0, 2.0 * BIN
    assert measure_in_phase(returns)[0][0] == 0.0
    returns.range_rate[:, 0] = 0.1, 0.1
    assert measure_in_phase(returns)[0][0] == pytest.approx(7.0 * 9.0)


def test_bins_along_azimuth() -> None:
    fade = np.cos(np.pi * (np.arange(8) - 3.5) / 8) ** 2
    width, factor = azimuth_bin(fade, 0.01, 1.0)  # a point in a cell: the aperture's own lobe
    assert width == 1.0
    assert factor == pytest.approx(
        1.0 / 0.7737, rel=2e-3
    )  # tol: integral of sinc^2 to four digits, narrow patch
    width, factor = azimuth_bin(fade, 1.0, 0.5)
    assert width == pytest.approx(16.0 / 3.0)
    u = np.linspace(-1.0, 1.0, 20001)
    lobe = np.square(np.abs(np.exp(2j * np.pi * np.outer(u, np.arange(8) - 3.5)) @ fade / 4.0))
    power = float((lobe * width * np.square(np.sinc(width * u))).sum()) * 1e-4
    assert factor == pytest.approx(1.0 / power, rel=0.02)  # tol: 400 samples of the aperture
