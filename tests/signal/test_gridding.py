"""Spreading kernels: cell convention, transform, error, NumPy and Dr.Jit alike; fine grid to samples."""

import numpy as np
import pytest
from scipy.integrate import quad

from sarmitsuba.core.errors import RadarError
from sarmitsuba.signal.gridding import (
    GriddingKernel,
    fine_grid,
    gridding_kernel,
    phase_ramp,
    to_window,
    unit_phasor,
)

WIDTHS = range(1, 9)


@pytest.mark.parametrize("width", WIDTHS)
def test_taps_follow_the_kernel_and_the_cell_convention(width):
    kernel = GriddingKernel(width)
    x = np.linspace(10.0, 12.0, 101)[:-1]
    base = np.floor(x + kernel.shift)
    first = base - kernel.lead
    taps = np.array(kernel.taps(x + kernel.shift - base))
    exact = np.array([kernel.evaluate(first + k - x) for k in range(width)])
    assert len(taps) == width
    # tol: the polynomials stay near the kernel's own rms error; transform() divides them out, not the kernel
    assert np.abs(taps - exact).max() < max(2.0 * 10.0 ** (kernel.error_db / 20.0), 1e-12)
    # the cells next to the chosen ones are out of the kernel's reach
    rim = 1.01 * np.exp(-kernel.beta) if width > 2 else 1e-8
    if width != 1:  # the box's two rims both belong to it
        assert (kernel.evaluate(first - 1.0 - x + 1e-9) < rim).all()
        assert (kernel.evaluate(first + width - x) < rim).all()
    assert kernel.margin >= kernel.lead + 1


@pytest.mark.parametrize("width", WIDTHS)
def test_inverse_transform(width):
    kernel = gridding_kernel(width)
    nu = np.linspace(-0.5, 0.5, 301)
    # tol: of the polynomial
    assert np.abs(kernel.inverse_transform(nu) * kernel.transform(nu) - 1.0).max() < 1e-9
    beyond = np.array([0.1, 0.6])
    np.testing.assert_allclose(kernel.inverse_transform(beyond) * kernel.transform(beyond), 1.0, rtol=1e-12)


def test_phasors_are_exponentials():
    rng = np.random.default_rng(5)
    phase = rng.uniform(-1e6, 1e6, (7, 300))
    # tol: float32 rounding of an angle up to pi, and of the cosine
    assert np.abs(unit_phasor(phase) - np.exp(1j * phase)).max() < 5e-7
    step = rng.uniform(-3.0, 3.0, 9)
    for first, count in ((-300, 601), (5, 1), (0, 32), (-7, 33)):
        exact = np.exp(1j * np.multiply.outer(step, np.arange(first, first + count)))
        assert np.abs(phase_ramp(step, first, count) - exact).max() < 5e-7


@pytest.mark.parametrize("width", WIDTHS)
def test_transform_is_that_of_the_kernel(width):
    kernel = gridding_kernel(width)
    for nu in (0.0, 0.1, 0.25, 0.4):
        value, _ = quad(
            lambda x, nu=nu: float(kernel.evaluate(np.array(x))) * np.cos(2.0 * np.pi * nu * x),
            -0.5 * width, 0.5 * width, limit=200, points=[-0.5, 0.5],
        )  # fmt: skip
        # tol: the polynomials' departure from the kernel
        assert abs(float(kernel.transform(nu)) - value) < max(10.0 ** (kernel.error_db / 20.0), 1e-9)


@pytest.mark.parametrize("width", WIDTHS)
def test_stated_error_is_the_measured_one(width):
    kernel = gridding_kernel(width)
    rng = np.random.default_rng(width)
    x = rng.uniform(20.0, 30.0, 2000)
    nu = rng.uniform(-0.25, 0.25, 2000)
    base = np.floor(x + kernel.shift)
    taps = kernel.taps(x + kernel.shift - base)
    tone = sum(t * np.exp(-2j * np.pi * nu * (base - kernel.lead + k)) for k, t in enumerate(taps))
    error = tone / kernel.transform(nu) * np.exp(2j * np.pi * nu * x) - 1.0
    measured = 10.0 * np.log10(np.mean(np.abs(error) ** 2))
    # tol: 1 dB, 2000 random positions and frequencies
    assert abs(measured - kernel.error_db) < 1.0


def test_error_table():
    """Nearest 0.3, linear 0.05, then a factor of about 9 for each cell more."""
    errors = [gridding_kernel(w).error_db for w in WIDTHS]
    # tol: 1 dB around the table of docs: these figures decide which width a user picks
    assert np.allclose(errors, [-11.3, -26.0, -47.1, -64.3, -84.4, -102.9, -121.9, -141.2], atol=1.0)


@pytest.mark.parametrize("width", WIDTHS)
def test_drjit_arrays_give_the_same(width):
    dr = pytest.importorskip("drjit")
    kernel = gridding_kernel(width)
    frac = np.linspace(0.0, 1.0, 33)[:-1].astype(np.float32)
    x = np.linspace(-0.6 * width, 0.6 * width, 41).astype(np.float32)
    there = np.array([np.array(t) for t in kernel.taps(dr.llvm.Float(frac), dr)])
    # tol: 3e-7, a few roundings of float32
    np.testing.assert_allclose(there, np.array(kernel.taps(frac)), atol=3e-7)
    np.testing.assert_allclose(np.array(kernel.evaluate(dr.llvm.Float(x), dr)), kernel.evaluate(x), atol=3e-7)


def test_width_out_of_bounds_is_refused():
    for width in (0, 9):
        with pytest.raises(RadarError, match="gridding_width"):
            GriddingKernel(width)


@pytest.mark.parametrize("ratio", [1.0, 1.2, 1.37, 2.5])
def test_cells_become_exact_sinc_samples(ratio):
    """One contribution on a cell: np.sinc on every sample, near and far, at any sampling rate."""
    cell = 0.5
    spacing = cell / ratio
    n_samples = 900
    low, high = -150.0, n_samples * spacing + 100.0
    grid = fine_grid(cell, spacing, low, high)
    assert np.isclose(grid.n_fine * grid.range_step, grid.n_out * spacing, rtol=1e-12)
    assert grid.range_step <= 0.5 * cell
    fine = np.zeros((1, 2, 500), dtype=np.complex64)
    fine[0, 0, 3] = 1.0
    fine[0, 1, 480] = 2.0 - 1.0j
    offset = np.array([-7.123, 20.0])
    samples = to_window(fine, offset, grid, cell, n_samples)
    r = spacing * np.arange(n_samples)
    expected = np.sinc((r + offset[:, None] - grid.range_step * np.array([[3], [480]])) / cell)
    expected = expected * np.array([[1.0], [2.0 - 1.0j]])
    # tol: 2e-6 of a peak of 2.2, complex64 transforms
    np.testing.assert_allclose(samples[0], expected, atol=5e-6)
