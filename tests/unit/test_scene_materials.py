import numpy as np
import pytest

from sarmitsuba.constants import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from sarmitsuba.errors import SceneError
from sarmitsuba.loader.tables import RADAR_MATERIAL, RADIO_MATERIAL
from sarmitsuba.materials.bsdfs import (
    ORDINARY_BSDFS,
    ordinary_material,
    radar_material,
    sionna_itu_name,
    sionna_material,
)
from sarmitsuba.materials.named_materials import MATERIALS
from sarmitsuba.materials.typical import typical_surface

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
    # Lambert's law: sigma0 at normal incidence is 4 albedo; |R(0)|^2 = (1/3)^2 for eps = 4
    assert 10 ** (material.diffuse_level_db / 10) == pytest.approx(4 * 0.36 / 9, rel=1e-12)  # tol: rounding


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
