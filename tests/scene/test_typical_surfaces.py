"""Surfaces that a scene does not state: typical ones by name, and the law of a stated rms height."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba import load_scene
from sarmitsuba.commands.console import Console
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import GuessWarning, SarmitsubaWarning, SceneError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.loading.names_of_materials import ALIASES, WORDS, exact_kind, kind_of
from sarmitsuba.loading.tables import RADAR_MATERIAL
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.materials.bsdfs import radar_material
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from tests.support.unweighted import render

X_BAND = 9.65e9
FILE = (
    '<scene version="3.0.0"><sensor type="sar_antenna"/><integrator type="sar_path"/>'
    '<shape type="rectangle">{}</shape></scene>'
)


def made(frequency: float = X_BAND, rms_default: float = 1e-3, **given: object) -> tuple[Material, str]:
    values = RADAR_MATERIAL.read(given, "m")
    material, _, note = radar_material("m", values, frozenset(given), frequency, "m", rms_default)
    return material, note


def sigma0(material: Material, incidence_deg: float, frequency: float = X_BAND) -> float:
    """Backscatter for hh, dB."""
    theta = np.linspace(0.0, 0.5 * np.pi, 181)
    table = LAWS[material.diffuse_law].sigma0(material, SPEED_OF_LIGHT / frequency, theta)
    return float(10.0 * np.log10(np.interp(np.radians(incidence_deg), theta, table.h)))


# bounds of sigma0 at 40 degrees in the X band, dB, rounded outwards: docs/materials.md
SPREAD = {
    "soil": (-20.0, -5.0),
    "grass": (-18.0, -7.0),
    "asphalt": (-28.0, -17.0),
    "leaf": (-15.0, -5.0),
    "snow": (-20.0, -5.0),
}


@pytest.mark.parametrize("name", SPREAD)
def test_levels_lie_within_the_published_spread(name: str) -> None:
    low, high = SPREAD[name]
    assert low <= sigma0(made(material=name)[0], 40.0) <= high


def test_order_of_the_ground() -> None:
    levels = [
        sigma0(made(material=n)[0], 40.0) for n in ("water", "asphalt", "gravel", "soil", "grass", "leaf")
    ]
    assert levels == sorted(levels) and min(np.diff(levels)) > 0.5


@pytest.mark.parametrize("name", sorted(set(MATERIALS.names) - {"vacuum", "pec"}))
def test_every_named_material_scatters_and_says_so(name: str) -> None:
    material, note = made(material=name)
    assert material.scatters and material.rms_height > 0.0
    assert f"{name} has its typical surface" in note


@pytest.mark.parametrize("name", ["metal", "metal_sheet", "car_paint"])
@pytest.mark.parametrize("frequency", [1.3e9, 5.4e9, X_BAND, 16.7e9, 35e9, 94e9])
def test_metal_returns_what_falls_on_it(name: str, frequency: float) -> None:
    """Mirror and scattered power at 40 degrees add up to all; the scattered part is never less than its level."""
    material = made(frequency, material=name)[0]
    g = 4.0 * np.pi * frequency / SPEED_OF_LIGHT * material.rms_height * np.cos(np.radians(40.0))
    albedo = 10.0 ** (sigma0(material, 0.0, frequency) / 10.0) / 4.0  # of Lambert's law
    # tol: a tenth is scattered by fittings, beside the mirror, at long waves
    assert 0.99 < np.exp(-(g**2)) + albedo < 1.1
    assert 4.0 * albedo >= 10.0**-0.4 - 1e-9


def test_a_metal_plate_is_bright_in_the_ku_band() -> None:
    """Peak of the image of a plate of 3 m seen squarely, beside that of a mirror: less by the roughness factor."""
    v = 1.5 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    tilt = np.radians(40.0)
    v = v @ np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    peaks = []
    for material in ("car_paint", "pec"):
        scene = build_scene(
            [SceneMesh(v, np.array([[0, 1, 2], [0, 2, 3]]), material)],
            radar=RadarDescription(
                center_frequency=16.7e9, slant_range=3000.0, look_angle_deg=40.0, bandwidth=300e6
            ),
            settings=TraceSettings(method="image"),
        )
        peaks.append(float(np.abs(render(scene).data).max()))
    loss = 20.0 * np.log10(peaks[0] / peaks[1])
    k = 2.0 * np.pi * 16.7e9 / SPEED_OF_LIGHT
    expected = -10.0 * np.log10(np.e) * (2.0 * k * 1e-3) ** 2
    # tol: clutter of the plate, a hundredth of its amplitude; with 4 mm the loss was 34 dB
    assert loss == pytest.approx(expected, abs=0.3) and expected > -3.0


def test_gamma_falls_with_the_wavelength_by_5_db_a_decade() -> None:
    low, high = (sigma0(made(f, material="soil")[0], 30.0, f) for f in (1e9, 1e10))
    assert high - low == pytest.approx(5.0, abs=1e-9)  # tol: rounding


@pytest.mark.parametrize(
    "given",
    [
        {"material": "concrete", "smooth": True},
        {"material": "concrete", "diffuse_law": "none"},
        {"material": "concrete", "rms_height": 0.0},
        {"material": "pec"},
        {"permittivity_real": 4.0, "smooth": True},
    ],
)
def test_a_mirror_where_asked_for(given: dict[str, object]) -> None:
    material, note = made(**given)
    assert not material.scatters and material.rms_height == 0.0 and note == ""


def test_a_scene_without_roughness_is_smooth() -> None:
    assert not made(rms_default=0.0, material="soil")[0].scatters


def test_a_permittivity_alone_stays_a_mirror_and_is_said() -> None:
    material, note = made(permittivity_real=4.0)
    assert not material.scatters and "a smooth mirror" in note


def test_what_is_given_is_kept() -> None:
    material, note = made(material="soil", rms_height=0.03, diffuse_law="constant", diffuse_level_db=-7.0)
    assert (material.rms_height, material.diffuse_law, material.diffuse_level_db, note) == (
        0.03,
        "constant",
        -7.0,
        "",
    )


@pytest.mark.parametrize(
    ("rms_height", "law"), [(0.0005, "small_slope"), (0.01, "iem"), (0.05, "constant_gamma")]
)
def test_an_rms_height_alone_scatters_without_a_warning(rms_height: float, law: str) -> None:
    material, note = made(material="soil", rms_height=rms_height)
    assert material.diffuse_law == law and material.rms_height == rms_height and law in note
    theta = np.linspace(0.0, 0.5 * np.pi, 181)
    assert LAWS[law].sigma0(material, SPEED_OF_LIGHT / X_BAND, theta).notes == ()


def test_a_given_correlation_length_is_kept() -> None:
    assert made(material="concrete", rms_height=0.001, correlation_length=0.02)[0].correlation_length == 0.02


def test_smooth_and_rough_exclude_each_other() -> None:
    with pytest.raises(SceneError, match=r"smooth and rms_height = 0\.01 m exclude each other"):
        made(material="soil", smooth=True, rms_height=0.01)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Car Paint", "car_paint"),
        ("Leaves_Mat", "leaf"),
        ("Concrete_Wall.001", "concrete"),
        ("steel", "metal"),
        ("Stahlträger", "metal"),
        ("Tôle", "metal"),
        ("béton", "concrete"),
        ("BÉTON armé", "concrete"),
        ("Straße", "asphalt"),
        ("Dachziegel", "brick"),
        ("eau", "water"),
        ("Schnee.002", "snow"),
        ("pelouse", "grass"),
        ("Kies", "gravel"),
        ("Schiffsstahl", "metal"),
        ("Sperrholzplatte", ""),
        ("Sperrholz", "plywood"),
        ("Kalksandstein", "marble"),
        ("Rheinwasser", "water"),
        ("topsoil", "soil"),
        ("textile", ""),
        ("glacier", ""),
        ("propane", ""),
        ("carpet", ""),
        ("terrasse", ""),
        ("mural", ""),
        ("plateau", ""),
        ("Feral", ""),
    ],
)
def test_names_as_people_write_them(name: str, kind: str) -> None:
    assert kind_of(name, {}) == kind


def test_every_word_names_a_material_of_the_library() -> None:
    assert set(WORDS) <= set(MATERIALS.names)
    for kind, words in WORDS.items():
        for word in words:
            assert kind_of(word.removeprefix("="), {}) == kind


def test_other_names_are_of_one_material_each() -> None:
    names = [name for each in ALIASES.values() for name in each]
    assert set(ALIASES) <= set(MATERIALS.names) and len(set(names)) == len(names)
    for kind, each in ALIASES.items():
        for name in each:
            assert exact_kind(name) == exact_kind(name.upper()) == exact_kind(f"mat-{name}.003") == kind
    for kind in MATERIALS.names:
        for spelling in (
            kind,
            kind.upper(),
            kind.title().replace("_", " "),
            kind.replace("_", ""),
            f"itu_{kind}",
        ):
            assert exact_kind(spelling) == kind
    assert exact_kind("Béton") == "concrete" and exact_kind("SeaWater") == "sea_water"


def test_words_inside_words_name_no_radar_material(tmp_path: Path) -> None:
    """Every word of the guesses with a drawn word before or behind it; and the materials of an extension left out."""
    rng = np.random.default_rng(4)
    others = ("wet", "my", "paint", "deep", "snowy", "hydro", "x", "plutonium")
    words = [word.removeprefix("=") for each in WORDS.values() for word in each]
    names = ["wet_snow", "saltyseawater", "my wall paint", "my_snow_model"]
    for word in words:
        other = rng.choice(others)
        names.append(
            f"{other}{rng.choice(['_', ' ', ''])}{word}" if rng.random() < 0.5 else f"{word} {other}"
        )
    for name in names:
        assert exact_kind(name) == ""
        with pytest.raises(
            SceneError, match=r"is not one of .*; an extension's are known with --extension FILE"
        ):
            RADAR_MATERIAL.read({"material": name}, "here")


def test_guesses_from_words_are_warned_of_even_when_quiet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faces = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\n"
    names = ("wet_snow", "my wall paint", "old brick wall", "Steel", "plutonium")
    faces += "".join(f"usemtl {name}\nf 1 2 {3 + i % 2}\n" for i, name in enumerate(names))
    (tmp_path / "a.obj").write_text(faces)
    console = Console(quiet=True)
    with console.reporting():
        scene = load_scene(tmp_path / "a.obj", radar="airborne_x")
        warnings.warn("an ordinary warning", SarmitsubaWarning, stacklevel=1)
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines == [
        'warning: a.obj: materials guessed from a word in their names: "my wall paint" concrete, "wet_snow" snow; '
        "choose with --material NAME=MATERIAL",
        'warning: a.obj: materials with unknown names are read as concrete: "plutonium"; name them brick, glass, '
        "metal, ... in the file, or choose with --material MATERIAL or NAME=MATERIAL",
    ]
    assert 'a.obj: materials by their names: "Steel" metal, "old brick wall" brick' in scene.notes
    text = '<bsdf type="diffuse" id="wet_snow"/>'
    (tmp_path / "scene.xml").write_text(FILE.format(text))
    with pytest.warns(
        GuessWarning, match='"wet_snow": .*is read as snow by its id.* a guess from a word in it'
    ):
        load_scene(tmp_path / "scene.xml", radar="airborne_x")


def loaded(tmp_path: Path, bsdf: str) -> Scene:
    (tmp_path / "scene.xml").write_text(FILE.format(bsdf), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # notes, no warnings
        return load_scene(tmp_path / "scene.xml", radar="airborne_x")


def test_a_scene_file_understands_names_and_says_it(tmp_path: Path) -> None:
    scene = loaded(
        tmp_path, '<bsdf type="radar_material" id="m"><string name="material" value="Stahl"/></bsdf>'
    )
    (material,) = scene.materials
    assert material.permittivity == MATERIALS["metal"].permittivity(scene.radar.waveform.center_frequency)
    assert material.scatters
    assert any('material "Stahl" is read as metal' in note for note in scene.notes)
    assert any("metal has its typical surface" in note for note in scene.notes)


PLAIN = """<scene version="3.0.0">
<bsdf type="diffuse" id="Ziegelwand"/><bsdf type="roughconductor" id="Blech"/><bsdf type="plastic" id="door"/>
<bsdf type="twosided" id="mat-Rasen"><bsdf type="diffuse"/></bsdf><bsdf type="diffuse" id="plain"/>
<shape type="cube"><ref id="Ziegelwand"/></shape><shape type="cube"><ref id="Blech"/></shape>
<shape type="cube"><ref id="door"/></shape><shape type="cube"><ref id="mat-Rasen"/></shape>
<shape type="cube"><ref id="plain"/></shape></scene>"""


def test_ids_of_a_mitsuba_scene_name_its_materials(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(PLAIN, encoding="utf-8")
    with pytest.warns(SarmitsubaWarning) as caught:
        scene = load_scene(tmp_path / "scene.xml", radar="airborne_x")
    by_name = {material.name: material for material in scene.materials}
    for name, kind in (
        ("Ziegelwand", "brick"),
        ("Blech", "metal"),
        ("mat-Rasen", "grass"),
        ("plain", "concrete"),
    ):
        assert sigma0(by_name[name], 40.0) == pytest.approx(sigma0(made(material=kind)[0], 40.0), abs=1e-9)
    for name, kind in (("Ziegelwand", "brick"), ("Blech", "metal"), ("mat-Rasen", "grass")):
        assert sum(f'"{name}"' in note and f"read as {kind} by its id" in note for note in scene.notes) == 1
    texts = [str(one.message) for one in caught]
    assert (
        sum('BSDF "diffuse" has no radar parameters and is read as: concrete' in text for text in texts) == 1
    )
    assert sum('BSDF "plastic"' in text for text in texts) == 1


def test_default_rms_height_0_makes_named_materials_mirrors(tmp_path: Path) -> None:
    text = '<bsdf type="radar_material" id="m"><string name="material" value="soil"/></bsdf>'
    (tmp_path / "scene.xml").write_text(FILE.format(text))
    scene = load_scene(
        tmp_path / "scene.xml", radar="airborne_x", parameters={"sar_path.default_rms_height": "0"}
    )
    assert not scene.materials[0].scatters
