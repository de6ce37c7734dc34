"""Closed forms of ambiguities, mispointing and uneven pulses against brute force and known limits."""

import numpy as np
import pytest
from scipy.integrate import quad

from sarmitsuba.analysis.pulse_timing import azimuth_ambiguity_ratio, range_ambiguity_ratio
from sarmitsuba.truth import theory

LAM, V = 0.031, 150.0


def test_azimuth_ratio_is_the_textbooks_integral() -> None:
    # Rationale: D = 2 m; band and prf as in stripmap, against adaptive quadrature over Doppler frequency.
    gain = theory.uniform_aperture_gain(2.0, LAM)
    prf, band = 180.0, 120.0

    def power(f: float) -> float:
        return float(gain(np.array(0.5 * LAM * f / V)) ** 2)

    for weighting in ("uniform", "matched"):

        def energy(m: int, weighting: str = weighting) -> float:
            weight = power if weighting == "matched" else lambda f: 1.0
            return float(quad(lambda f: weight(f) * power(f + m * prf), -0.5 * band, 0.5 * band)[0])

        want = sum(energy(m) for m in range(-20, 21) if m) / energy(0)
        got = azimuth_ambiguity_ratio(gain, LAM, prf, V, band, weighting=weighting)  # type: ignore[arg-type]
        assert got == pytest.approx(want, rel=1e-3)  # tol: the rule of rectangles over 4001 nodes
    lower = [azimuth_ambiguity_ratio(gain, LAM, p, V, band) for p in (140.0, 180.0, 240.0)]
    assert lower[0] > lower[1] > lower[2]


def test_a_beam_off_by_the_wrong_angle_gains_ambiguity_and_loses_level() -> None:
    gain = theory.gaussian_gain(0.02)
    assert theory.mispointed_level(gain, 0.008, 0.0) == pytest.approx(1.0)
    # Rationale: Gaussian over an infinite band: g^2 of half the offset, exp(-ln2 (e / h)^2 / 2) in amplitude
    error, half = 0.004, np.sin(0.01)
    want = 2.0 ** (-((error / half) ** 2))
    assert theory.mispointed_level(gain, 0.05, error) == pytest.approx(
        want, rel=1e-3
    )  # tol: sines for angles
    at = [azimuth_ambiguity_ratio(gain, LAM, 200.0, V, 150.0, pointing_error=e) for e in (0.0, 0.004)]
    assert at[1] > 2.0 * at[0]
    assert theory.doppler_centroid(V, LAM, 0.01) == pytest.approx(2.0 * V * np.sin(0.01) / LAM)


def test_the_ghost_is_where_range_and_doppler_agree() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        R, prf = rng.uniform(5e3, 8e5), rng.uniform(50.0, 300.0)
        order, squint = int(rng.choice([-2, -1, 1, 2])), rng.uniform(-0.3, 0.3)
        along, closest = theory.azimuth_ghost(LAM, R, prf, V, order, np.sin(squint))
        assert along == pytest.approx(order * LAM * R * prf / (2.0 * V))
        # antenna at the origin, ghost in the beam's centre
        ghost = R * np.array([np.sin(squint), np.cos(squint)])
        point = ghost - np.array([along, closest])
        assert np.hypot(*point) == pytest.approx(R)
        doppler = 2.0 * V / LAM * (ghost[0] - point[0]) / R
        assert doppler == pytest.approx(order * prf)


def test_a_ghost_without_walk_is_the_ratio_of_patterns() -> None:
    gain = theory.uniform_aperture_gain(2.0, LAM)
    prf, band = 130.0, 100.0
    f = np.linspace(-0.5 * band, 0.5 * band, 20001)
    g = gain(0.5 * LAM * f / V)
    want = (np.sum(g * gain(0.5 * LAM * (f - prf) / V)) / np.sum(g * g)) ** 2
    got = theory.azimuth_ghost_level(gain, LAM, 1e4, prf, V, band)
    assert got == pytest.approx(want, rel=2e-3)  # tol: the ghost's own curvature, 0.03 rad
    assert theory.azimuth_ghost_level(gain, LAM, 1e4, prf, V, band, range_cell=0.3) < 0.5 * want


def test_range_ratio_of_a_known_case() -> None:
    # Rationale: an isotropic antenna on flat ground: only R^3 sin(theta) of the other ranges counts.
    height, R, prf = 500e3, 700e3, 2000.0
    got = range_ambiguity_ratio(lambda s: np.ones_like(s), R, height, prf, 0.0, orders=3)
    other = R + np.array([-2, -1, 1, 2, 3]) * 299792458.0 / (2.0 * prf)
    other = other[other > height]
    sine = np.sqrt(1.0 - (height / other) ** 2)
    assert got == pytest.approx(float(np.sum(R**3 * np.sqrt(1.0 - (height / R) ** 2) / (other**3 * sine))))
    # a sphere so large that it is flat, and a real one, whose horizon ends the sum
    flat = range_ambiguity_ratio(lambda s: np.ones_like(s), R, height, prf, 0.0, orders=3, earth_radius=1e13)
    assert flat == pytest.approx(got, rel=1e-5)
    beam = theory.uniform_aperture_gain(0.7, LAM)
    round_ = range_ambiguity_ratio(beam, R, height, prf, 0.7, earth_radius=6371e3)
    assert 0.0 < round_ < 1.0


def test_uneven_pulses_against_sums_over_them() -> None:
    rng = np.random.default_rng(1)
    n, sigma, turns = 64, 0.05, np.array([0.0, 0.13, 0.5, 1.0])
    times = np.cumsum(1.0 + sigma * rng.standard_normal((6000, n)), axis=1)
    power = np.abs(np.exp(-2j * np.pi * turns[:, None, None] * times).mean(axis=2)) ** 2
    want, scatter = power.mean(axis=1), power.std(axis=1) / np.sqrt(6000)
    assert np.all(np.abs(theory.jittered_response(turns, sigma, n) - want) < 5.0 * scatter + 1e-12)
    # far from the peaks and for many pulses, the renewal spectrum: a mean over the leakage of 2 / n
    many = 4096
    offsets = 0.3 + np.arange(64) / 64.0 / many
    whole = theory.jittered_response(offsets, 0.2, many).mean()
    even = (np.sin(np.pi * offsets * many) / (many * np.sin(np.pi * offsets))) ** 2
    assert theory.jitter_noise(np.array(0.3), 0.2, many) == pytest.approx(whole, rel=0.05)
    assert even.mean() < 0.05 * whole
    steps = np.array([0.8, 1.0, 1.2])
    t = np.cumsum(np.tile(steps, 100)) - steps[0]
    for k, line in enumerate(theory.staggered_lines(steps)):
        direct = abs(np.exp(-2j * np.pi * k / 3.0 * t).mean()) ** 2
        assert line == pytest.approx(direct, rel=1e-9)
