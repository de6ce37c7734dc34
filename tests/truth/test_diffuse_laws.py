"""Diffuse laws: levels, limits, published values, energy and the domain notes."""

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import ExtensionError, SceneError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.diffuse import DiffuseTable, diffuse_tables
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, Sigma0
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.laws.effective_roughness import lobe_power
from sarmitsuba.scene.materials.laws.iem import iem_backscatter
from sarmitsuba.scene.materials.laws.kirchhoff import geometrical_optics_sigma0
from sarmitsuba.scene.materials.laws.roughness import shared_energy_sigma0
from sarmitsuba.scene.materials.laws.small_perturbation import small_perturbation_sigma0
from sarmitsuba.scene.materials.material import Material

WAVELENGTH = SPEED_OF_LIGHT / 9.65e9
C_BAND = SPEED_OF_LIGHT / 5.405e9
SOIL = 15.0 - 3.0j


def soil(law: str, **parameters: float) -> Material:
    return Material("soil", permittivity=SOIL, diffuse_law=law, **parameters)


def at_degrees(table: DiffuseTable, angle: float) -> tuple[float, float]:
    h, v = table.sigma0(np.radians(angle))
    return float(db_from_power(h)), float(db_from_power(v))


@pytest.mark.parametrize("angle", [0.0, 5.0, 30.0, 55.0, 70.0])
def test_levels_of_the_empirical_laws(angle: float) -> None:
    cosine = np.cos(np.radians(angle))
    expected = {
        "constant": -10.0,
        "constant_gamma": -10.0 + 10.0 * np.log10(cosine),
        "lambert": -10.0 + 20.0 * np.log10(cosine),
    }
    for law, level in expected.items():
        h, v = at_degrees(diffuse_tables(soil(law, diffuse_level_db=-10.0), WAVELENGTH), angle)
        # tol: linear interpolation between 256 nodes, step^2 / 8 of the amplitude's curvature
        assert h == pytest.approx(level, abs=2e-4)
        assert v == h


def test_a_law_that_is_not_there_is_one_line() -> None:
    with pytest.raises(SceneError, match='material "soil": diffuse_law = "lamber" is not one of constant, '):
        soil("lamber")
    with pytest.raises(SceneError, match="diffuse_law = lambert has no parameter fall; it has none"):
        Material("m", diffuse_law="lambert", law_parameters=(("fall", 1.0),))


def test_a_law_that_returns_no_power_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: DiffuseLaw, surface: object, wavelength: float, theta: np.ndarray) -> Sigma0:
        return Sigma0(-np.ones_like(theta), np.ones_like(theta))

    monkeypatch.setattr(type(LAWS["lambert"]), "sigma0", broken)
    with pytest.raises(ExtensionError, match="diffuse law 'lambert': sigma0 must return 256 finite values"):
        diffuse_tables(soil("lambert"), WAVELENGTH)


def test_every_law_says_what_it_takes() -> None:
    fields = {"rms_height", "correlation_length"}
    for law in LAWS:
        assert law.title and set(law.needs) <= fields
        assert not (law.level and law.needs)  # measured levels, or a model of the surface
    assert {law.name: law.bistatic for law in LAWS if law.bistatic != "mean"} == {
        "kirchhoff": "facets",
        "directive_roughness": "facets",
        "small_perturbation": "spectrum",
        "small_slope": "spectrum",
        "iem": "spectrum",
    }
    assert [law.name for law in LAWS if not law.scatters] == ["none"]


@pytest.mark.parametrize("law", LAWS.names)
@pytest.mark.parametrize("permittivity", [1.0, 1.0001, 3.0, SOIL, 80.0 - 40.0j, 1.0 - 1e9j])
def test_every_law_is_finite_and_never_negative(law: str, permittivity: complex) -> None:
    for s, length in ((0.0, 0.1), (1e-6, 0.1), (0.002, 0.06), (0.02, 0.05), (0.2, 1.0)):
        material = Material(
            "m",
            permittivity=permittivity,
            diffuse_law=law,
            rms_height=s,
            correlation_length=length,
            diffuse_level_db=-15.0,
        )
        table = diffuse_tables(material, WAVELENGTH)
        for amplitude in (table.amplitude_h, table.amplitude_v):
            assert amplitude.dtype == np.float64 and amplitude.shape == (256,)
            assert np.all(np.isfinite(amplitude)) and np.all(amplitude >= 0.0)
        assert 0.0 <= table.valid_from <= table.valid_to <= np.pi / 2
        if permittivity == 1.0:  # air over air: nothing there
            assert not table.amplitude_h.any() and not table.amplitude_v.any()


@pytest.mark.parametrize("law", ["kirchhoff", "small_perturbation", "small_slope", "iem", "roughness"])
def test_a_smooth_surface_scatters_nothing(law: str) -> None:
    table = diffuse_tables(soil(law, correlation_length=0.1), WAVELENGTH)
    assert not table.amplitude_h.any() and not table.amplitude_v.any()
    assert table.notes == ()


@pytest.mark.parametrize("law", ["kirchhoff", "small_perturbation", "small_slope", "iem"])
def test_missing_correlation_length_is_one_line(law: str) -> None:
    with pytest.raises(SceneError, match='"soil": correlation_length = 0 m must be above 0') as caught:
        diffuse_tables(soil(law, rms_height=0.01), WAVELENGTH)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("exponent", [1, 2, 3, 4, 9, 20])
def test_lobes_hold_the_power_of_their_integral(exponent: int) -> None:
    theta = np.radians([0.0, 20.0, 50.0, 80.0, 90.0])
    u, v = ((np.arange(n) + 0.5) / n for n in (400, 400))
    cosine, azimuth = u[:, None], 2.0 * np.pi * v
    sine = np.sqrt(1.0 - cosine**2)
    for angle, power in zip(theta, lobe_power(theta, exponent), strict=True):
        psi = np.cos(angle) * cosine + np.sin(angle) * sine * np.cos(azimuth)
        # tol: midpoint rule of 400 x 400
        assert power == pytest.approx(2.0 * np.pi * np.mean((0.5 + 0.5 * psi) ** exponent), rel=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_effective_roughness_is_the_share_of_the_reflected_power(seed: int) -> None:
    """S^2 times the Fresnel power reflectivity at the angle, in each pattern; drawn materials."""
    rng = np.random.default_rng(seed)
    eps = complex(rng.uniform(1.5, 30.0), -rng.uniform(0.0, 8.0))
    share, ahead, back, forward = rng.uniform(0.05, 1.0), *rng.integers(1, 9, 2), rng.uniform()
    theta = np.linspace(0.0, np.pi / 2, 256)
    te, tm = fresnel(np.cos(theta), eps)
    lobes = forward * np.cos(theta) ** (2 * ahead) + 1.0 - forward
    both = forward * lobe_power(theta, int(ahead)) + (1.0 - forward) * lobe_power(theta, int(back))
    patterns = {
        ("effective_roughness", ()): np.cos(theta) / np.pi,
        ("directive_roughness", (("lobe_exponent", float(ahead)),)): np.cos(theta) ** (2 * ahead)
        / lobe_power(theta, int(ahead)),
        (
            "effective_roughness",
            (
                ("lobe_exponent", float(ahead)),
                ("back_lobe_exponent", float(back)),
                ("forward_share", float(forward)),
            ),
        ): lobes / both,
    }
    for (law, parameters), pattern in patterns.items():
        material = Material(
            "m",
            permittivity=eps,
            diffuse_law=law,
            diffuse_level_db=10.0 * np.log10(share),
            law_parameters=parameters,
        )
        table = diffuse_tables(material, WAVELENGTH)
        for amplitude, r in ((table.amplitude_h, te), (table.amplitude_v, tm)):
            want = 4.0 * np.pi * share * np.abs(r) ** 2 * np.cos(theta) * pattern
            np.testing.assert_allclose(amplitude**2, want, rtol=1e-12, atol=1e-15)  # tol: rounding
    with pytest.raises(SceneError, match=r"lobe_exponent = 2.5 is no whole number"):
        diffuse_tables(
            soil("directive_roughness", diffuse_level_db=-3.0, law_parameters=(("lobe_exponent", 2.5),)),
            WAVELENGTH,
        )
    over = diffuse_tables(soil("effective_roughness", diffuse_level_db=1.0), WAVELENGTH)
    assert "give at most 0 dB" in over.notes[0]


def test_geometrical_optics_values() -> None:
    # reference: |R(0)|^2 exp(-tan^2/(2 m^2)) / (2 m^2 cos^4), m = 0.2, eps = 15 - 3j
    reference = {
        0: 6.453047,
        5: 6.103752,
        10: 5.031146,
        15: 3.157678,
        20: 0.342006,
        25: -3.642259,
        30: -9.143782,
    }
    rms = 0.05
    material = soil("kirchhoff", rms_height=rms, correlation_length=np.sqrt(2.0) * rms / 0.2)
    table = diffuse_tables(material, WAVELENGTH)
    for angle, level in reference.items():
        h, v = at_degrees(table, angle)
        # tol: linear interpolation of a lobe 11 degrees wide on a 0.35 degree grid
        assert h == pytest.approx(level, abs=2e-3) and v == h
    assert table.notes == ()


def test_small_perturbation_values() -> None:
    # reference, dB at hh and vv: s = 2 mm, l = 6 cm, exponential, eps = 15 - 3j, 5.405 GHz
    reference = {
        20: (-12.865087, -11.360503),
        30: (-18.748235, -15.524147),
        40: (-23.650872, -18.211378),
        50: (-28.405358, -20.286688),
    }
    table = diffuse_tables(soil("small_perturbation", rms_height=0.002, correlation_length=0.06), C_BAND)
    for angle, levels in reference.items():
        # tol: linear interpolation of the amplitude on a 0.35 degree grid
        assert at_degrees(table, angle) == pytest.approx(levels, abs=2e-3)
    assert table.notes == ()


@pytest.mark.parametrize("permittivity", [3.0 + 0.0j, SOIL, 40.0 - 20.0j])
@pytest.mark.parametrize("correlation", ["exponential", "gaussian"])
def test_iem_becomes_small_perturbation_for_small_heights(permittivity: complex, correlation: str) -> None:
    theta = np.radians([5.0, 20.0, 40.0, 60.0, 80.0])
    # k = 1: k s = 1e-3, k l = 2
    iem = iem_backscatter(theta, permittivity, 1.0, 1e-3, 2.0, correlation)  # type: ignore[arg-type]
    spm = small_perturbation_sigma0(theta, permittivity, 1.0, 1e-3, 2.0, correlation)  # type: ignore[arg-type]
    # tol: the next term of the series is (2 k s)^2 = 4e-6 with a factor of order ten at 80 degrees
    np.testing.assert_allclose(iem[0], spm[0], rtol=2e-4)
    np.testing.assert_allclose(iem[1], spm[1], rtol=2e-4)


def test_iem_is_that_of_an_independent_program() -> None:
    # integral-equation model at 2.2 GHz, exponential correlation, hh and vv in dB; k s = 0.2
    reference = {30: (-22.103, -20.253), 50: (-28.694, -24.352), 60: (-32.530, -26.743)}
    surface = Material(
        "soil", permittivity=3.0 - 0.1j, rms_height=0.00429, correlation_length=0.03, diffuse_law="iem"
    )
    table = diffuse_tables(surface, SPEED_OF_LIGHT / 2.2e9)
    for angle, levels in reference.items():
        # tol: 0.0065 dB at 60 degrees vv, by the form of the transition reflectivity; the table interpolates to 2e-3
        assert at_degrees(table, angle) == pytest.approx(levels, abs=0.01)
    # first-order perturbation is 0.3 dB off: the values are of the series, not of its first term
    wavenumber = 2.0 * np.pi * 2.2e9 / SPEED_OF_LIGHT
    h, v = small_perturbation_sigma0(np.radians([30.0]), 3.0 - 0.1j, wavenumber, 0.00429, 0.03)
    assert db_from_power(h)[0] > -21.8 and db_from_power(v)[0] > -20.0


@pytest.mark.parametrize("permittivity", [4.0 + 0.0j, SOIL])
def test_iem_becomes_geometrical_optics_for_large_heights(permittivity: complex) -> None:
    # Gaussian correlation, k s = 40, rms slope 0.2: the exponential has no slope and so no such limit
    theta = np.radians([0.0, 5.0, 10.0, 20.0, 30.0])
    h, v = iem_backscatter(theta, permittivity, 1.0, 40.0, np.sqrt(2.0) * 40.0 / 0.2, "gaussian")
    normal = float(np.abs(fresnel(1.0, permittivity)[0]) ** 2)
    expected = geometrical_optics_sigma0(theta, normal, 0.2)
    # tol: what is left of order 1/(k s cos)^2 in the exponent
    np.testing.assert_allclose(db_from_power(h), db_from_power(expected), atol=0.02)
    np.testing.assert_allclose(db_from_power(v), db_from_power(expected), atol=0.02)


def test_iem_lies_between_its_limits_and_orders_the_polarisations() -> None:
    # C band soil, k s = 0.5: vv above hh, both below small perturbation, which overestimates rough surfaces
    theta = np.radians([20.0, 30.0, 40.0, 50.0])
    h, v = iem_backscatter(theta, SOIL, 1.0, 0.5, 5.0)
    spm_h, spm_v = small_perturbation_sigma0(theta, SOIL, 1.0, 0.5, 5.0)
    assert np.all(v > h) and np.all(v < spm_v)
    ratio = db_from_power(v / h)
    assert np.all(ratio < db_from_power(spm_v / spm_h)) and np.all(np.diff(ratio) > 0.0)


def test_roughness_law_scatters_exactly_what_the_coherent_wave_lost() -> None:
    """Rationale: scattered fraction = 1/(4 pi cos_i) of the integral of sigma0(i, s) over the hemisphere."""
    theta = np.linspace(0.0, np.pi / 2, 2001)
    reflectivity = np.abs(fresnel(np.cos(theta), SOIL)[0]) ** 2
    for rms_phase in (0.05, 0.5, 2.0, 10.0):
        amplitude = np.sqrt(shared_energy_sigma0(theta, reflectivity, rms_phase))
        lost = reflectivity * (1.0 - np.exp(-4.0 * (rms_phase * np.cos(theta)) ** 2))
        ring = amplitude * 2.0 * np.pi * np.sin(theta)
        integral = float(np.sum(0.5 * (ring[1:] + ring[:-1]) * np.diff(theta)))
        inside = theta < np.radians(89.0)
        scattered = amplitude * integral / (4.0 * np.pi * np.cos(theta))
        # tol: trapezoidal rule over 2000 steps
        np.testing.assert_allclose(scattered[inside], lost[inside], rtol=1e-4)


def test_notes_say_what_is_outside_and_by_how_much() -> None:
    rough = diffuse_tables(soil("small_perturbation", rms_height=0.01, correlation_length=0.06), WAVELENGTH)
    assert any("k s = 2.02 is above 0.3" in note for note in rough.notes)
    assert all(note.startswith('material "soil": diffuse_law = small_perturbation: ') for note in rough.notes)
    smooth = diffuse_tables(soil("kirchhoff", rms_height=0.001, correlation_length=0.06), WAVELENGTH)
    assert any("(2 k s)^2 = 0.164 is below 10" in note for note in smooth.notes)
    assert smooth.valid_from == smooth.valid_to == 0.0
    deep = diffuse_tables(soil("iem", rms_height=0.02, correlation_length=0.04), WAVELENGTH)
    assert len(deep.notes) == 2
    bright = diffuse_tables(soil("lambert", diffuse_level_db=8.0), WAVELENGTH)
    assert any("albedo of 1.58" in note for note in bright.notes)


def test_iem_refuses_absurd_heights() -> None:
    with pytest.raises(SceneError, match="set diffuse_law to kirchhoff or lambert"):
        diffuse_tables(soil("iem", rms_height=1.0, correlation_length=1.0), WAVELENGTH)


def test_conductor_is_the_limit_of_large_permittivity() -> None:
    for law in ("kirchhoff", "roughness", "small_perturbation", "iem"):
        parameters = dict(diffuse_law=law, rms_height=0.002, correlation_length=0.05)
        pec = diffuse_tables(Material("pec", pec=True, **parameters), WAVELENGTH)  # type: ignore[arg-type]
        metal = diffuse_tables(Material("metal", permittivity=1 - 1e11j, **parameters), WAVELENGTH)  # type: ignore[arg-type]
        inside = pec.theta < np.radians(85.0)
        # tol: 1 - |R|^2 of the metal near 85 degrees, 4 / (|sqrt(eps)| cos) = 1e-4
        np.testing.assert_allclose(metal.amplitude_h[inside], pec.amplitude_h[inside], rtol=3e-4)
        np.testing.assert_allclose(metal.amplitude_v[inside], pec.amplitude_v[inside], rtol=3e-4)
