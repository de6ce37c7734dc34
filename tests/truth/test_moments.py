"""The two-dimensional method of moments against closed forms."""

import numpy as np
import pytest

from sarmitsuba.truth import theory


@pytest.mark.parametrize("seed", range(3))
def test_a_circular_cylinder_has_its_series(seed: int) -> None:
    """Off the resonances of its inside, both polarisations, any wavelength."""
    rng = np.random.default_rng(seed)
    wavelength, n = rng.uniform(0.01, 3.0), 160
    ka = (4.1, 9.6, 12.9)[seed]  # zeros of J_n and J_n' are 0.05 and more away
    radius = ka / (2.0 * np.pi) * wavelength
    turn = 2.0 * np.pi * (np.arange(n + 1) + rng.uniform()) / n
    # a polygon of the circle's area
    corners = (
        radius * np.sqrt(2.0 * np.pi / n / np.sin(2.0 * np.pi / n)) * np.array([np.cos(turn), np.sin(turn)]).T
    )
    got = theory.strips_by_moments([corners], wavelength, [rng.uniform(0.0, 6.0)], step=0.2)
    for value, want in zip(got, theory.circular_cylinder(radius, wavelength), strict=True):
        # tol: chords of 1/12 wavelength and less
        assert abs(value[0] - want) < 2e-3 * abs(want)


def test_a_flat_strip_is_a_plate() -> None:
    """Squarely: 4 pi A^2 / lambda^2 of a plate of any length; edge-on: one edge along the field, nothing across it."""
    wavelength, width, length = 0.03, 0.12, 0.5
    strip = [[[0.0, -width / 2], [0.0, width / 2]]]
    along, across = theory.strips_by_moments(strip, wavelength, [0.0, np.pi / 2], step=1 / 40)
    scale = length * np.sqrt(2.0 / wavelength)
    plate = np.sqrt(theory.plate_rcs(width, length, wavelength, 0.0))
    # tol: edges of a strip of 4 wavelengths
    assert np.abs(scale * along[0]) == pytest.approx(plate, rel=0.01)
    assert np.abs(scale * across[0]) == pytest.approx(plate, rel=0.02)
    # tol: the far edge's second diffraction; rounding
    assert np.abs(scale * along[1]) == pytest.approx(np.sqrt(theory.edge_on_rcs(length)), rel=0.1)
    assert np.abs(across[1]) < 1e-6 * np.abs(along[1])


def test_two_strips_in_line_are_one() -> None:
    """Where strips of one line meet the current goes on; where they do not touch it ends."""
    parts = [[0.0, 0.0], [0.05, 0.02], [0.125, 0.05]]
    azimuth = np.linspace(0.1, 3.0, 7)
    whole = theory.strips_by_moments([[parts[0], parts[2]]], 0.03, azimuth)
    bent = theory.strips_by_moments([parts], 0.03, azimuth)
    apart = theory.strips_by_moments([parts[:2], parts[1:]], 0.03, azimuth)
    for a, b in zip(whole, bent, strict=True):
        # tol: segments of 1/20 wavelength, elsewhere
        np.testing.assert_allclose(a, b, atol=3e-3 * np.abs(a).max())
    # a gap without width parts the current across it
    assert np.abs(whole[1] - apart[1]).max() > 0.05 * np.abs(whole[1]).max()
