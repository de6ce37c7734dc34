"""Fourier sums off the FFT's samples, against the sums themselves."""

import numpy as np
import pytest

from sarmitsuba.signal.focusing.frequency_domain.chirp_z import (
    ChirpZ,
    VirtualChirp,
    interpolate,
    kernel_transform,
    spread,
)


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def error_db(value: np.ndarray, exact: np.ndarray) -> float:
    return float(20.0 * np.log10(np.linalg.norm(value - exact) / np.linalg.norm(exact)))


@pytest.mark.parametrize(
    ("n_in", "n_out", "first", "low"), [(50, 33, -25, -16), (31, 90, 400, 7), (8, 5, -3, -90)]
)
@pytest.mark.parametrize("axis", [0, -1])
def test_chirp_z_is_the_sum(n_in: int, n_out: int, first: int, low: int, axis: int) -> None:
    rng = np.random.default_rng(n_in)
    turn = rng.uniform(0.01, 0.2)
    lines = noise(rng, 3, n_in)
    exact = lines @ np.exp(1j * turn * np.outer(first + np.arange(n_in), low + np.arange(n_out)))
    got = ChirpZ(n_in, n_out, first, low, turn)(lines if axis else lines.T, axis=axis)
    assert error_db(got if axis else got.T, exact) < -110.0  # tol: float32


def test_spreading_is_the_sum_at_uneven_frequencies() -> None:
    rng = np.random.default_rng(1)
    values, position = noise(rng, 4, 60), rng.uniform(-300.0, 500.0, (4, 60))
    n = 128
    pixel = np.arange(-32, 33)
    exact = np.einsum("rm,rmp->rp", values, np.exp(2j * np.pi / n * position[:, :, None] * pixel))
    line = np.fft.ifft(spread(values, position, n), axis=1) * n
    got = line[:, pixel % n] / kernel_transform(pixel / n)
    assert error_db(got, exact) < -95.0  # tol: the kernel's -103 dB over the used half of the band


def test_interpolation_is_the_fourier_series_between_samples() -> None:
    rng = np.random.default_rng(2)
    coefficient, position = noise(rng, 4, 65), rng.uniform(-300.0, 500.0, (4, 70))
    n, m = 130, np.arange(-32, 33)
    exact = np.einsum("rm,rpm->rp", coefficient, np.exp(2j * np.pi / n * position[:, :, None] * m))
    spectrum = np.zeros((4, n), dtype=np.complex128)
    spectrum[:, m % n] = coefficient / kernel_transform(m / n)
    lines = (np.fft.ifft(spectrum, axis=1) * n).astype(np.complex64)
    assert error_db(interpolate(lines, position), exact) < -95.0  # tol: the kernel's -103 dB


@pytest.mark.parametrize("largest", [0.0, 0.003, 0.08])
def test_chirps_scale_lines(largest: float) -> None:
    """Lines of points inside the period come back at (1 + C) times the places asked for."""
    rng = np.random.default_rng(3)
    step, n_band, first = 0.01, 300, -150
    period = 2.0 * np.pi / step
    room = VirtualChirp.length(largest, 0.5 * period, period / n_band)
    place = rng.uniform(-0.5, 0.5, 6) * (0.5 * period - room)
    # a taper: an edge of the band has a tail over the whole period, which no periodic scaling keeps
    taper = np.hanning(n_band)
    q = step * (first + np.arange(n_band))
    spectrum = (np.exp(-1j * np.outer(place, q)) * taper).astype(np.complex64)
    factor = rng.uniform(-largest, largest, 6)
    chirp = VirtualChirp.of(largest, 0.5 * period, step, n_band)
    low, spacing = -40, period / 97.0
    points = ChirpZ(chirp.n_fft, 81, -(chirp.n_fft // 2), low, step * spacing)
    at = spacing * (low + np.arange(81))
    got = chirp(spectrum, first, step, factor, points, at)
    wanted = at * (1.0 + factor[:, None])
    exact = np.einsum("rm,rpm->rp", spectrum, np.exp(1j * wanted[:, :, None] * q))
    inside = np.abs(wanted) < 0.25 * period
    assert (
        error_db(got[inside], exact[inside]) < -75.0
    )  # tol: tails of the chirp's spectrum beyond the transforms' band
