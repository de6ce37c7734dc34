"""Needles and twigs against a volume integral equation along the axis, which shares no code with them."""

import numpy as np
import pytest

from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.vegetation.canopy import plant_permittivity
from sarmitsuba.scene.materials.vegetation.plant_pieces import OverGround, Stick
from sarmitsuba.truth import theory
from tests.support.draws import few_of

# k a |sqrt(eps)| up to which the reference holds, 0.1 dB
THICKEST = 0.5


# V is 0.72 dB above the reference in extinction: not yet known which of the two errs
WORST = pytest.param(
    39, marks=[pytest.mark.slow, pytest.mark.xfail(strict=True, reason="0.72 dB of extinction")]
)


def drawn(seed: int) -> tuple[Stick, float, complex]:
    """A stick from needle to twig, its wavelength and permittivity."""
    rng = np.random.default_rng([seed, 24])
    frequency = 10.0 ** rng.uniform(9.0, 10.2)
    wavelength = 299792458.0 / frequency
    eps = plant_permittivity(rng.uniform(0.3, 0.7), frequency)
    k = 2.0 * np.pi / wavelength
    radius = rng.uniform(0.05, THICKEST) / (k * np.sqrt(abs(eps)))
    shortest, longest = max(6.0 * radius, 0.3 / k), 58.0 / k
    return Stick(radius, shortest * (longest / shortest) ** rng.random()), wavelength, eps


@pytest.mark.parametrize("seed", [*few_of(range(39), 2), WORST])
def test_levels_of_drawn_sticks_are_those_of_the_integral_equation(seed: int) -> None:
    """HH and VV, extinction and backscatter of sticks that stand about a drawn tilt."""
    stick, wavelength, eps = drawn(seed)
    rng = np.random.default_rng([seed, 25])
    tilt = rng.uniform(0.0, 0.5 * np.pi)
    look = rng.uniform(np.radians(20.0), np.radians(70.0))
    wave = np.array([np.sin(look), 0.0, -np.cos(look)])
    h, v = np.array([0.0, 1.0, 0.0]), np.array([np.cos(look), 0.0, np.sin(look)])
    want, got = np.zeros(4), np.zeros(4)
    # a quarter of the azimuths for the others, and tilts that blur the lobes of a long one
    for turn in (np.arange(9) + 0.5) * np.pi / 9:
        for one in tilt + np.radians([-6.0, 0.0, 6.0]):
            axis = np.array([np.sin(one) * np.cos(turn), np.sin(one) * np.sin(turn), np.cos(one)])
            angle = float(np.arccos(np.clip(wave @ axis, -1.0, 1.0)))
            share = (axis @ h) ** 2 / max(
                (axis @ h) ** 2 + (axis @ v) ** 2, 1e-12
            )  # of the parallel wave in H
            taken, back = theory.thin_rod(angle, stick.radius, stick.length, eps, wavelength)
            at = np.array([angle])
            ours = (
                [float(x[0]) for x in stick.extinction(at, wavelength, eps)],
                [complex(x[0]) for x in stick.backscatter(at, wavelength, eps)],
            )
            for levels, (lost, returned) in ((want, (taken, back)), (got, ours)):
                for i, part in enumerate((share, 1.0 - share)):
                    levels[i] += part * lost[0] + (1.0 - part) * lost[1]
                    levels[2 + i] += abs(part * returned[0] + (1.0 - part) * returned[1]) ** 2
    error = np.asarray(db_from_power(got / want))
    # tol: 0.3 dB asked for; segments of the reference 0.1 dB, fields uneven over the cross-section 0.1 dB
    assert np.abs(error).max() < 0.3, error


@pytest.mark.parametrize(
    ("size", "way"),
    [(0.2, 8.0), *(pytest.param(x, 8.0, marks=pytest.mark.slow) for x in (0.1, 0.5, 1.0, 2.0))]
    + [pytest.param(0.3, x, marks=pytest.mark.slow) for x in (40.0, 60.0)],
)
def test_levels_do_not_jump_with_thickness_and_length(size: float, way: float) -> None:
    """On both sides of every value of k a sqrt(eps), and of k l, at which something changes."""
    eps, wavelength, rng = 20.0 - 7.0j, 0.031, np.random.default_rng(3)
    k = 2.0 * np.pi / wavelength
    axis = rng.normal(size=(3, 60))
    axis /= np.linalg.norm(axis, axis=0)
    angle, view = np.radians([35.0, 60.0, 90.0]), OverGround(0.7, *axis)
    found = []
    for step in (-1e-4, 1e-4):
        stick = Stick(size / (k * np.sqrt(abs(eps))) * (1.0 + step), way / k * (1.0 + step))
        back, lost = stick.backscatter(angle, wavelength, eps), stick.extinction(angle, wavelength, eps)
        ground = np.stack(stick.over_ground(view, wavelength, eps))
        powers = [*lost[0], *lost[1], *(np.mean(np.abs(s) ** 2) for s in (*back, *ground))]
        found.append(np.asarray(db_from_power(np.array(powers))))
    # tol: 0.1 dB asked for; what the step itself changes, lobes of a long stick
    assert np.abs(found[1] - found[0]).max() < 0.1


def test_needles_without_loss_take_what_they_scatter() -> None:
    """The optical theorem: extinction against the power over all directions, by the response between directions."""
    from sarmitsuba.scene.materials.vegetation.plant_pieces import thin_rod

    wavelength, eps, radius, length = 0.05, 12.0 + 0.0j, 4e-4, 0.03
    k, volume = 2.0 * np.pi / wavelength, np.pi * radius**2 * length
    rod = thin_rod(radius, length, k, eps)
    cosine, weight = np.polynomial.legendre.leggauss(60)
    for angle in (0.6, 1.2, 0.5 * np.pi):
        incident = np.full(cosine.size, np.cos(angle))
        along, across = (k**2 * volume * (eps - 1.0) * q for q in rod.response(incident, cosine))
        # dipoles along the axis and across it, in the plane of axis and wave; their cross term has no mean
        lost = np.sum(
            weight
            * (
                np.abs(along * np.sin(angle)) ** 2 * (1.0 - cosine**2)
                + np.abs(across * np.cos(angle)) ** 2 * 0.5 * (1.0 + cosine**2)
            )
        ) / (8.0 * np.pi)
        here = np.array([np.cos(angle)])
        q = [complex(x[0]) for x in rod.response(here, here)]
        taken = -k * volume * ((eps - 1.0) * (q[0] * np.sin(angle) ** 2 + q[1] * np.cos(angle) ** 2)).imag
        assert taken == pytest.approx(lost, rel=0.01)  # tol: cubic splines of the tables, quadrature
