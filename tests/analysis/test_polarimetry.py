"""Polarimetric decompositions against the closed forms of canonical targets, on arrays as they come from anywhere."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.analysis.polarimetry import (
    QuadPol,
    automatic_looks,
    cloude_pottier,
    coherency,
    coherency4,
    coherency_of_covariance,
    colours,
    covariance,
    covariance_of_coherency,
    m_chi,
    m_delta,
    orientation_angle,
    pauli_rgb,
    polarimetry_report,
    quad_pol,
    span,
    stokes,
)
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.radar.polarisation import read_channels
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.truth import theory
from sarmitsuba.view.polarimetric_maps import feasible_bounds

polar = theory.polarimetry
ROLLS = np.radians([-40.0, -17.3, 0.0, 8.1, 31.7])  # fixed; any in between would do


def random_quad(seed: int, shape: tuple[int, int] = (12, 15)) -> QuadPol:
    """Channels that have nothing to do with each other."""
    rng = np.random.default_rng(seed)
    parts = rng.standard_normal((4, 2, *shape)).astype(np.float32)
    hh, hv, vh, vv = parts[:, 0] + 1j * parts[:, 1]
    return QuadPol(hh, hv, vh, vv)


def of_matrices(matrices: C128) -> QuadPol:
    """Scattering matrices (rows, columns, 2, 2) as channels."""
    s = matrices.astype(np.complex64)
    return QuadPol(s[..., 0, 0], s[..., 0, 1], s[..., 1, 0], s[..., 1, 1])


def image_of(**channels: C64) -> SarImage:
    """An image on a slant grid of pixels of 0.5 m x 0.25 m, cells of 1 m x 1 m."""
    shape = next(iter(channels.values())).shape
    grid = ImageGrid(
        "slant",
        0.5 * np.arange(shape[0]),
        1000.0 + 0.25 * np.arange(shape[1]),
        np.array([0.0, 0.0, 700.0]),
        np.array([0.0, 1.0, 0.0]),
        np.array([1.0, 0.0, 0.0]),
    )
    return SarImage(
        np.stack(list(channels.values())).astype(np.complex64),
        tuple(Layer(name) for name in channels),
        grid,
        0.03,
        1.0,
        1.0,
        np.full(shape[1], 0.7),
    )


# ---- targets


@pytest.mark.parametrize(
    ("matrix", "alpha"), [(polar.SPHERE, 0.0), (polar.DIHEDRAL, 90.0), (polar.DIPOLE, 45.0)]
)
def test_a_turned_target_keeps_its_alpha_and_has_no_entropy(matrix: C128, alpha: float) -> None:
    turned = polar.rotate_target(matrix, ROLLS)[None] * np.exp(1j * 0.7)
    found = cloude_pottier(coherency(of_matrices(turned)))
    # tol: complex64 channels
    assert np.degrees(found.alpha_1) == pytest.approx(np.full((1, ROLLS.size), alpha), abs=1e-3)
    assert np.degrees(found.alpha) == pytest.approx(np.full((1, ROLLS.size), alpha), abs=1e-3)
    assert found.entropy == pytest.approx(np.zeros((1, ROLLS.size)), abs=1e-6)
    assert (found.zone == {0.0: 9, 45.0: 8, 90.0: 7}[alpha]).all()


def test_the_roll_of_a_dihedral_is_recovered_and_its_cross_polar_part_is_that_of_theory() -> None:
    t = coherency(of_matrices(polar.rotate_target(polar.DIHEDRAL, ROLLS)[None]))
    assert orientation_angle(t)[0] == pytest.approx(ROLLS, abs=1e-6)
    assert t[0] == pytest.approx(polar.coherency_of(polar.rotate_target(polar.DIHEDRAL, ROLLS)), abs=1e-6)
    assert (t[0, :, 2, 2] / span(t)[0]).real == pytest.approx(np.sin(2.0 * ROLLS) ** 2, abs=1e-6)


def test_a_cloud_of_dipoles() -> None:
    """Evenly turned dipoles, 360 of them, are the integral exactly; H = 0.946, alpha = 45 degrees."""
    roll = np.pi * np.arange(360).reshape(18, 20) / 360.0
    t = coherency(of_matrices(polar.rotate_target(polar.DIPOLE, roll)), (18, 20))
    # tol: complex64
    assert t[0, 0] == pytest.approx(polar.random_dipoles(), abs=1e-6)
    found = cloude_pottier(t)
    share = np.array([0.5, 0.25, 0.25])
    assert found.entropy[0, 0] == pytest.approx(-np.sum(share * np.log(share)) / np.log(3.0), abs=1e-5)
    assert found.entropy[0, 0] == pytest.approx(0.946, abs=1e-3)  # as published
    assert np.degrees(found.alpha[0, 0]) == pytest.approx(45.0, abs=1e-3)
    assert found.zone[0, 0] == 2
    assert found.anisotropy[0, 0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("ratio", [0.0, 0.02, 0.2])
def test_rough_ground_against_its_closed_form(ratio: float) -> None:
    closed = polar.rough_surface_coherency(0.01, 0.03, ratio)
    assert span(closed) == pytest.approx(0.04 * (1.0 - ratio) + 4.0 * ratio * np.sqrt(0.0003))
    found = cloude_pottier(closed)
    entropy, alpha = polar.entropy_alpha(closed)
    assert found.entropy == pytest.approx(entropy, abs=1e-9)
    assert found.alpha == pytest.approx(alpha, abs=1e-9)
    if ratio == 0.0:
        assert found.alpha_1 == pytest.approx(float(polar.bragg_alpha(0.01, 0.03)))
        assert found.alpha_1 < np.radians(42.5)


def test_few_looks_hide_entropy() -> None:
    """What docs/analysis.md says of blocks of 25 looks: a volume's H is 0.05 too low."""
    rng = np.random.default_rng(25)
    k = rng.standard_normal((2000, 25, 3, 2)) @ np.array([1.0, 1j]) * np.sqrt([0.25, 0.125, 0.125])
    found = cloude_pottier(np.einsum("nli,nlj->nij", k, np.conj(k)) / 25.0)
    # tol: 2000 draws of 0.02 each are 0.0005
    assert 0.946 - found.entropy.mean() == pytest.approx(0.05, abs=0.01)
    single = np.einsum("ni,nj->nij", k[:, 0], np.conj(k[:, 0]))
    assert cloude_pottier(single).entropy.max() < 1e-6


# ---- matrices


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_moments_of_any_channels(seed: int) -> None:
    quad = random_quad(seed)
    t, c = coherency(quad, (3, 5)), covariance(quad, (3, 5))
    assert t.shape == (4, 3, 3, 3)
    assert covariance_of_coherency(t) == pytest.approx(c, abs=1e-5)
    assert coherency_of_covariance(c) == pytest.approx(t, abs=1e-5)
    power = np.abs(quad.hh) ** 2 + 2.0 * np.abs(quad.cross) ** 2 + np.abs(quad.vv) ** 2
    blocks = power.reshape(4, 3, 3, 5).mean(axis=(1, 3))
    assert span(t) == pytest.approx(blocks, rel=1e-5)
    assert span(c) == pytest.approx(blocks, rel=1e-5)
    found = cloude_pottier(t)
    assert found.eigenvalues.sum(axis=-1) == pytest.approx(blocks, rel=1e-5)
    # T4 holds T3, and what HV and VH differ by
    t4 = coherency4(quad, (3, 5))
    assert t4[..., :3, :3] == pytest.approx(t, abs=1e-5)
    difference = (0.5 * np.abs(quad.hv - quad.vh) ** 2).reshape(4, 3, 3, 5).mean(axis=(1, 3))
    assert t4[..., 3, 3].real == pytest.approx(difference, rel=1e-5)
    # the sliding window is the block's mean in the middle of a block
    sliding = coherency(quad, (3, 5), sliding=True)
    assert sliding.shape == (12, 15, 3, 3)
    assert sliding[1::3, 2::5] == pytest.approx(t, abs=1e-5)


def test_no_matrix_leaves_the_feasible_region() -> None:
    """The bounds that the picture draws, against positive matrices at random, pure to chaotic."""
    rng = np.random.default_rng(5)
    k = rng.standard_normal((400, 3, 4, 2)) @ np.array([1.0, 1j])
    k *= 10.0 ** rng.uniform(-2.0, 0.0, (400, 1, 4))
    found = cloude_pottier(k @ np.conj(np.swapaxes(k, -1, -2)))
    (h_low, a_low), (h_up, a_up) = feasible_bounds()
    alpha = np.degrees(found.alpha)
    assert (alpha >= np.interp(found.entropy, h_low, a_low) - 0.1).all()
    assert (alpha <= np.interp(found.entropy, h_up, a_up) + 0.1).all()
    assert np.ptp(alpha) > 40.0 and np.ptp(found.entropy) > 0.6


def test_zones_are_those_of_the_publication() -> None:
    """Medians of every zone, from diagonal matrices (lambda 1 and its alpha chosen)."""
    base = cloude_pottier(np.eye(3)[None])
    places = {9: (0.2, 10), 8: (0.2, 45), 7: (0.2, 70), 6: (0.7, 20), 5: (0.7, 45), 4: (0.7, 70)} | {
        3: (0.95, 30),
        2: (0.95, 45),
        1: (0.95, 60),
    }
    for zone, (entropy, alpha) in places.items():
        one = replace(base, entropy=np.array([entropy]), alpha=np.radians([alpha]))
        assert one.zone.tolist() == [zone]
    assert replace(base, entropy=np.array([np.nan])).zone.tolist() == [0]


def test_empty_pixels_have_no_class() -> None:
    t = np.zeros((2, 3, 3, 3))
    t[0, 0] = np.diag([1.0, 0.0, 0.0])
    found = cloude_pottier(t)
    assert np.isfinite(found.alpha[0, 0]) and np.isnan(found.alpha[1]).all() and np.isnan(found.entropy[0, 1])
    assert found.zone.tolist() == [[9, 0, 0], [0, 0, 0]]


# ---- compact polarimetry


@pytest.mark.parametrize("sent", ["R", "L"])
def test_m_chi_tells_odd_from_even_bounces_whatever_the_sense(sent: str) -> None:
    """Trihedral: blue. Dihedral at any roll: red. Dipole: both. A cloud of dipoles: half of it is not polarised."""
    wave = np.array([1.0, 1j if sent == "R" else -1j]) / np.sqrt(2.0)

    def powers(matrices: C128, looks: tuple[int, int]) -> F64:
        echo = np.einsum("...ij,i->...j", matrices, wave)  # transmit index first
        image = image_of(**{sent + "H": echo[..., 0], sent + "V": echo[..., 1]})
        vector = stokes(image, looks)
        for split in (m_chi, m_delta):
            assert split(vector).sum(axis=-1) == pytest.approx(vector.s1, rel=1e-5)
        return m_chi(vector)[0] / vector.s1[0][:, None]

    one = (1, 1)
    assert powers(polar.SPHERE[None, None], one)[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-5)
    rolled = powers(polar.rotate_target(polar.DIHEDRAL, ROLLS)[None], one)
    assert rolled == pytest.approx(np.tile([1.0, 0.0, 0.0], (ROLLS.size, 1)), abs=1e-5)
    dipoles = powers(polar.rotate_target(polar.DIPOLE, ROLLS)[None], one)
    assert dipoles == pytest.approx(np.tile([0.5, 0.0, 0.5], (ROLLS.size, 1)), abs=1e-5)
    roll = np.pi * np.arange(360).reshape(18, 20) / 360.0
    assert powers(polar.rotate_target(polar.DIPOLE, roll), (18, 20))[0] == pytest.approx(
        [0.0, 1.0, 0.0], abs=1e-5
    )


def test_m_delta_is_m_chi_where_the_wave_leans_to_no_axis() -> None:
    rng = np.random.default_rng(4)
    h = rng.standard_normal((1, 8)) + 1j * rng.standard_normal((1, 8))
    vector = stokes(image_of(RH=h, RV=np.abs(h) * np.exp(1j * rng.uniform(0.0, 6.0, (1, 8)))))
    assert vector.s2 == pytest.approx(np.zeros((1, 8)), abs=1e-5)
    assert m_delta(vector) == pytest.approx(m_chi(vector), rel=1e-4, abs=1e-5)
    trihedral = stokes(image_of(RH=np.ones((1, 1)), RV=np.full((1, 1), 1j)))
    assert np.degrees(trihedral.delta[0, 0]) == pytest.approx(-90.0)
    assert np.degrees(trihedral.chi[0, 0]) == pytest.approx(-45.0)
    assert trihedral.s4[0, 0] > 0.0  # left-handed, from a right-handed wave


# ---- colours


def test_the_colour_law() -> None:
    """Hue by amplitudes, brightness by the sum in dB; a factor on all turns brightness only."""
    rgb = colours([[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0025, 0.0, 0.01]]], white_db=0.0, span_db=50.0)
    assert rgb[0, 0].tolist() == [0, 0, 255] and rgb[0, 1].tolist() == [255, 0, 0]
    b = 1.0 + 10.0 * np.log10(0.0125) / 50.0
    assert rgb[0, 2].tolist() == [round(127.5 * b), 0, round(255.0 * b)]
    same = np.tile(rgb[0, :1] / 255.0, (1, 5, 1))
    assert colours(same).tolist() == colours(1e6 * same).tolist()
    assert not colours(np.zeros((2, 2, 3))).any()
    t = np.array([[polar.coherency_of(polar.DIHEDRAL), polar.coherency_of(polar.SPHERE)]])
    assert pauli_rgb(t).tolist() == [[[255, 0, 0], [0, 0, 255]]]


# ---- images


def test_the_report_of_an_image() -> None:
    rng = np.random.default_rng(6)
    odd = np.ones((20, 40), dtype=np.complex64)
    noise = (rng.standard_normal((2, 20, 40, 2)) @ np.array([1.0, 1j])).astype(np.complex64)
    image = image_of(HH=odd, HV=0.1 * noise[0], VH=0.1 * noise[1], VV=odd, RH=odd, RV=1j * odd)
    assert automatic_looks(image) == (10, 20)  # 5 cells of 1 m in pixels of 0.5 m x 0.25 m
    assert automatic_looks(image, 1.0) == (2, 4)
    report = polarimetry_report(image)
    assert report.cells == pytest.approx(25.0)
    assert report.asymmetry_db == pytest.approx(0.0, abs=0.5)  # tol: 800 draws, 0.15 dB each
    facts = report.as_dict()
    assert facts["quad"]["zones"][9]["area"] == 1.0  # type: ignore[index]
    assert facts["compact"]["m_chi_shares"]["odd_bounce"] == pytest.approx(1.0)  # type: ignore[index]
    assert "Pauli shares" in report.as_table() and "m-chi" in report.as_table()
    only = polarimetry_report(image_of(HH=odd, HV=noise[0], VV=odd), (20, 40))
    assert only.stokes is None and np.isnan(only.asymmetry_db)
    assert only.as_dict()["quad"]["hv_minus_vh_db"] is None  # type: ignore[index]
    compact = polarimetry_report(image_of(LH=odd, LV=1j * odd))
    assert compact.coherency is None and compact.as_dict()["quad"] is None


def test_wrong_input_is_said_in_one_line() -> None:
    plane = np.ones((4, 4), dtype=np.complex64)
    for image in (image_of(HH=plane, VV=plane), image_of(DH=plane, DV=plane)):
        with pytest.raises(DataError, match="are needed: set polarisation"):
            polarimetry_report(image)
        with pytest.raises(DataError, match="set polarisation"):
            quad_pol(image)
        with pytest.raises(DataError, match="set polarisation"):
            stokes(image)
    with pytest.raises(DataError, match="5 x 1 pixels of an image of 4 x 4"):
        coherency(QuadPol(plane, plane, plane, plane), (5, 1))
    with pytest.raises(DataError, match="5 x 1 pixels of an image of 4 x 4"):
        polarimetry_report(image_of(HH=plane, HV=plane, VV=plane), (5, 1))
    with pytest.raises(DataError, match="four arrays of one shape"):
        QuadPol(plane, plane, plane, plane[:2])
    with pytest.raises(DataError, match=r"\(\.\.\., 3, 3\) is needed"):
        cloude_pottier(np.eye(4))
    with pytest.raises(DataError, match="not Hermitian"):
        cloude_pottier(np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    with pytest.raises(DataError, match="span_db = 0 dB is not above 0"):
        colours(np.ones((1, 1, 3)), span_db=0.0)
    with pytest.raises(DataError, match="3\\) are needed"):
        colours(np.ones((1, 1, 2)))


def test_channel_names_are_read_in_any_case_and_refused_where_unknown() -> None:
    assert read_channels("hh, rv DH", "here") == ("HH", "RV", "DH")
    for bad in ("RL", "HH,HH", "", "XY"):
        with pytest.raises(RadarError, match="is not a list of channels from HH, HV, VH, VV, RH, RV"):
            read_channels(bad, "here")
