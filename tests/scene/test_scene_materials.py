import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.tables import RADAR_MATERIAL, RADIO_MATERIAL
from sarmitsuba.scene.materials.bsdfs import (
    ORDINARY_BSDFS,
    ordinary_material,
    radar_material,
    sionna_itu_name,
    sionna_material,
)
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.scene.materials.typical import typical_surface

X_BAND = 9.6e9
WHERE = 'scene.xml: bsdf "m"'


def build(frequency: float = X_BAND, **given: object):
    values = RADAR_MATERIAL.read(given, WHERE)
    return radar_material("m", values, frozenset(given), frequency, WHERE)[0]


def test_concrete_at_10_ghz() -> None:
    # ITU-R P.2040-3: eps' = 5.24, sigma = 0.0462 * 10^0.7822 = 0.27980 S/m
    concrete = MATERIALS["concrete"]
    eps, note = concrete.permittivity(10e9), concrete.note(10e9)
    sigma = 0.0462 * 10**0.7822
    assert eps.real == 5.24
    assert eps.imag == pytest.approx(
        -sigma / (2 * np.pi * 10e9 * VACUUM_PERMITTIVITY), rel=1e-12
    )  # tol: rounding
    assert eps.imag == pytest.approx(-0.503, abs=5e-4)  # tol: three printed digits
    assert note == ""


def test_medium_dry_ground_has_a_falling_permittivity() -> None:
    eps = MATERIALS["medium_dry_ground"].permittivity(5e9)
    assert eps.real == pytest.approx(15 * 5**-0.1, rel=1e-12)  # tol: rounding


def test_outside_its_bands_the_nearest_is_used_and_said() -> None:
    brick = MATERIALS["brick"]
    eps, note = brick.permittivity(94e9), brick.note(94e9)
    assert "brick" in note and "94 GHz" in note
    assert eps.real == 4.15  # the band from 110 GHz is nearer than the one to 40 GHz


@pytest.mark.parametrize("name", MATERIALS.names)
def test_every_material_is_passive(name: str) -> None:
    for frequency in (1e9, 10e9, 94e9, 300e9):
        eps = MATERIALS[name].permittivity(frequency)
        assert eps.real >= 1.0 and eps.imag <= 0.0


def test_permittivity_one_is_invisible_and_vacuum_too() -> None:
    assert build(permittivity_real=1.0).invisible
    assert build(material="vacuum").invisible
    assert not build(permittivity_real=1.0, diffuse_law="constant").invisible
    assert not build(material="pec").invisible


def test_conductivity_and_loss_are_the_same_thing() -> None:
    sigma = 0.5
    loss = sigma / (2 * np.pi * X_BAND * VACUUM_PERMITTIVITY)
    a, b = (
        build(permittivity_real=4.0, conductivity=sigma),
        build(permittivity_real=4.0, permittivity_imag=loss),
    )
    assert a.permittivity == pytest.approx(b.permittivity, rel=1e-14)  # tol: rounding


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "neither material nor permittivity_real"),
        ({"material": "pec", "permittivity_real": 3.0}, "exclude each other"),
        ({"permittivity_real": 3.0, "permittivity_imag": 1.0, "conductivity": 1.0}, "exclude each other"),
        (
            {"material": "pec", "diffuse_law": "iem", "rms_height": 0.01},
            "needs rms_height and correlation_length",
        ),
        ({"material": "pec", "diffuse_level_db": -3.0}, "has no effect with diffuse_law = none"),
        (
            {"material": "pec", "temporal_coherence": 0.5},
            "temporal_coherence has no effect with diffuse_law = none",
        ),
        (
            {"permittivity_real": 3.0, "diffuse_law": "lambert", "decorrelation_days": 5.0},
            "decorrelation_days = 5 days has no effect with temporal_coherence = 1",
        ),
    ],
)
def test_contradictions_are_refused(given: dict, text: str) -> None:
    with pytest.raises(SceneError, match=text):
        build(**given)


def test_water_keeps_no_coherence_unless_told() -> None:
    sea = {"permittivity_real": 60.0, "permittivity_imag": 35.0, "diffuse_law": "sea"}
    assert build(**sea).temporal_coherence == 0.0
    assert build(**sea, decorrelation_days=1e-6).coherence_after(1.0) == 0.0
    assert build(**sea, temporal_coherence=0.3).temporal_coherence == 0.3
    assert build(permittivity_real=4.0, diffuse_law="lambert").temporal_coherence == 1.0


def test_sionna_scattering_shares_the_power() -> None:
    values = RADIO_MATERIAL.read({"relative_permittivity": 4.0, "scattering_coefficient": 0.6}, WHERE)
    material, _ = sionna_material("m", "radio-material", values, frozenset(values), X_BAND)
    k = 2 * np.pi * X_BAND / SPEED_OF_LIGHT
    coherent = np.exp(-2 * (k * material.rms_height) ** 2) ** 2
    assert coherent == pytest.approx(1 - 0.36, rel=1e-12)  # tol: rounding
    # sigma0 at normal incidence is 4 S^2 |R(0)|^2 with |R(0)|^2 = (1/3)^2 for eps = 4; at the Brewster angle vv is none
    table = diffuse_tables(material, SPEED_OF_LIGHT / X_BAND)
    assert table.sigma0(0.0)[0] == pytest.approx(4 * 0.36 / 9, rel=1e-12)  # tol: rounding
    h, v = table.sigma0(np.arctan(2.0))
    # hh: R = (1 - eps) / (1 + eps) there; tol: linear interpolation of 256 nodes
    assert h == pytest.approx(4 * 0.36 * 0.36 * 0.2, rel=1e-3) and v < 1e-4 * h


def test_cross_polar_power_is_taken_from_the_scattered() -> None:
    given = {"relative_permittivity": 4.0, "scattering_coefficient": 0.6, "xpd_coefficient": 0.2}
    given |= {"scattering_pattern": "directive", "alpha_r": 5}
    material, _ = sionna_material(
        "m", "radio-material", RADIO_MATERIAL.read(given, WHERE), frozenset(given), X_BAND
    )
    assert material.diffuse_law == "directive_roughness" and material.law_parameter("lobe_exponent") == 5.0
    co, cross = 10 ** (material.diffuse_level_db / 10), 10 ** (material.cross_polar_ratio_db / 10)
    assert co * (1.0 + cross) == pytest.approx(0.36) and cross == pytest.approx(0.25)
    given["xpd_coefficient"] = 0.7
    values = RADIO_MATERIAL.read(given, WHERE)
    _, note = sionna_material("m", "radio-material", values, frozenset(given), X_BAND)
    assert "xpd_coefficient above 0.5 is read as that" in note


SIONNA_FORMULA = """
import json, sys
import numpy as np
import sionna.rt as rt, mitsuba as mi, drjit as dr
from sionna.rt.utils import fresnel_reflection_coefficients_simplified as fresnel
out = []
for name, options, eps, theta in json.loads(sys.argv[1]):
    theta = np.array(theta)
    pattern = {"lambertian": rt.LambertianPattern, "directive": rt.DirectivePattern,
               "backscattering": rt.BackscatteringPattern}[name](**options)
    ki = mi.Vector3f(np.sin(theta), 0 * theta, -np.cos(theta))
    f = np.array(pattern(ki, -ki))
    te, tm = fresnel(mi.Float(np.cos(theta)), mi.Complex2f(*eps))
    out.append([(4 * np.pi * np.abs(np.array(r.real) + 1j * np.array(r.imag)) ** 2 * np.cos(theta) * f).tolist()
                for r in (te, tm)])
print(json.dumps(out))
"""


@pytest.mark.slow
def test_scattering_is_that_of_sionna_itself() -> None:
    """Drawn materials and angles against the code of Sionna RT, in a process of its own: it sets a variant."""
    if importlib.util.find_spec("sionna") is None:
        pytest.skip("sionna-rt is not installed")
    rng = np.random.default_rng(0)
    cases, ours = [], []
    for name in ("lambertian", "directive", "backscattering") * 3:
        eps, conductivity, s = rng.uniform(2.0, 12.0), rng.uniform(0.0, 1.0), rng.uniform(0.1, 0.9)
        theta = np.sort(rng.uniform(0.0, 1.5, 12))
        options = {"alpha_r": int(rng.integers(1, 12))} if name != "lambertian" else {}
        if name == "backscattering":
            options |= {"alpha_i": int(rng.integers(1, 12)), "lambda_": float(rng.uniform())}
        given = {"relative_permittivity": eps, "conductivity": conductivity, "scattering_coefficient": s}
        given |= {"scattering_pattern": name, **options}
        values = RADIO_MATERIAL.read(given, WHERE)
        material, _ = sionna_material("m", "radio-material", values, frozenset(given), X_BAND)
        cases.append(
            (name, options, (material.permittivity.real, material.permittivity.imag), theta.tolist())
        )
        sigma0 = LAWS[material.diffuse_law].sigma0(material, SPEED_OF_LIGHT / X_BAND, theta)
        ours.append(np.stack([sigma0.h, sigma0.v]) / s**2)
    run = subprocess.run(
        [sys.executable, "-c", SIONNA_FORMULA, json.dumps(cases)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    theirs = json.loads(run.stdout.splitlines()[-1])
    for mine, other in zip(ours, theirs, strict=True):
        # tol: float32 of Sionna RT, whose R cancels near the Brewster angle
        np.testing.assert_allclose(mine, other, rtol=2e-4, atol=1e-6)


def test_sionna_names_in_ids() -> None:
    assert sionna_itu_name("mat-itu_concrete") == "concrete"
    assert sionna_itu_name("itu-wet_ground") == "wet_ground"
    assert sionna_itu_name("itu_cheese") == ""
    assert sionna_itu_name("concrete") == ""


@pytest.mark.parametrize("plugin", ORDINARY_BSDFS)
def test_every_ordinary_bsdf_has_a_meaning_and_a_warning(plugin: str) -> None:
    material, warning, note = ordinary_material("m", plugin, {}, X_BAND)
    assert f'"{plugin}"' in warning and "\n" not in warning and not note
    assert material.pec == (plugin in ("conductor", "roughconductor"))
    assert material.invisible == (ORDINARY_BSDFS[plugin][2] == "invisible")
    assert material.scatters == (
        not material.invisible and plugin not in ("conductor", "dielectric", "thindielectric")
    )


def test_principled_metal_is_a_conductor() -> None:
    assert ordinary_material("m", "principled", {"metallic": 1.0}, X_BAND)[0].pec
    assert ordinary_material("m", "principled", {}, X_BAND)[0].permittivity.real == 5.24


@pytest.mark.parametrize("frequency", [1.3e9, X_BAND, 35e9])
def test_plain_bsdfs_are_as_bright_as_the_same_material_by_name(frequency: float) -> None:
    """They were given an rms height of 1 mm: concrete lay 4 to 8 dB, in the L band 25 dB, below concrete by name."""
    for plugin, kind in (("diffuse", "concrete"), ("roughconductor", "metal"), ("roughdielectric", "glass")):
        material = ordinary_material("m", plugin, {}, frequency)[0]
        assert material.scatters
        typical = typical_surface(kind, frequency)
        for name in ("rms_height", "diffuse_law", "diffuse_level_db", "correlation_length"):
            assert getattr(material, name) == getattr(typical, name)


@pytest.mark.parametrize(
    ("plugin", "called", "values", "expected"),
    [
        ("diffuse", "brick", {}, "brick"),
        ("plastic", "grass", {}, "grass"),
        ("dielectric", "water", {}, "water"),
        ("conductor", "metal", {}, "metal"),
        ("conductor", "glass", {}, ""),  # a window's frame
        ("principled", "glass", {"metallic": 1.0}, ""),
        ("null", "leaf", {}, ""),
    ],
)
def test_an_id_that_names_a_material_decides(
    plugin: str, called: str, values: dict[str, float], expected: str
) -> None:
    material, warning, note = ordinary_material("m", plugin, values, X_BAND, called=called)
    assert bool(note) == bool(expected) and bool(warning) != bool(expected)
    if expected:
        assert f"read as {expected} by its id" in note
        typical = typical_surface(expected, X_BAND)
        assert (material.diffuse_law, material.diffuse_level_db) == (
            typical.diffuse_law,
            typical.diffuse_level_db,
        )
    else:
        assert material.pec or material.invisible
