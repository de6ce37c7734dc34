"""What notebooks and scripts do with scenes, raw data, images and path tables: show, save, change, pickle."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba import DataError, SarmitsubaError, SarmitsubaWarning
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from tests.support.unweighted import focus, refine

FEW = {"sar_antenna.n_pulses": "12"}


@pytest.fixture(scope="module")
def scene() -> sarmitsuba.Scene:
    return sarmitsuba.load_scene("dihedral", parameters=FEW)


@pytest.fixture(scope="module")
def results(scene: sarmitsuba.Scene) -> dict[str, object]:
    raw = sarmitsuba.simulate(scene)
    image = focus(raw)
    built = sarmitsuba.build_scene(points=[sarmitsuba.PointTarget("p", np.zeros(3))])
    refined = refine(scene, target_error_db=-10.0, max_passes=1)
    return {
        "scene": scene,
        "raw": raw,
        "image": image,
        "multilook": image.multilook(2, 2),
        "paths": sarmitsuba.trace_paths(scene, strongest=0.5),
        "explanation": sarmitsuba.explain(built),  # of a scene with few effects to try both ways
        "refined": refined,
        "built": built,
    }


def arrays_of(value: object, found: list[np.ndarray], depth: int = 0) -> list[np.ndarray]:
    """Every array inside."""
    if isinstance(value, np.ndarray):
        found.append(value)
    elif isinstance(value, dict):
        for item in value.values():
            arrays_of(item, found, depth + 1)
    elif isinstance(value, tuple | list):
        for item in value:
            arrays_of(item, found, depth + 1)
    elif hasattr(value, "__dict__") and depth < 8:
        arrays_of(vars(value), found, depth + 1)
    return found


NAMES = ("scene", "raw", "image", "multilook", "paths", "explanation", "refined", "built")


@pytest.mark.parametrize("name", NAMES)
def test_results_pickle(results: dict[str, object], name: str) -> None:
    value = results[name]
    copy = pickle.loads(pickle.dumps(value))
    assert type(copy) is type(value)
    ours, theirs = arrays_of(value, []), arrays_of(copy, [])
    assert len(ours) == len(theirs) > 0
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", [*NAMES, "grid", "radar", "track", "geometry"])
def test_text_is_short(results: dict[str, object], scene: sarmitsuba.Scene, name: str) -> None:
    image = results["image"]
    assert isinstance(image, SarImage)
    parts = {"grid": image.grid, "radar": scene.radar, "track": scene.radar.track, "geometry": scene.geometry}
    text = repr({**results, **parts}[name])
    assert "\n" not in text and "array(" not in text and len(text) < 400


def test_text_says_what_it_is(results: dict[str, object]) -> None:
    assert repr(results["scene"]).startswith("Scene('dihedral': 4 faces in 2 meshes, ")
    assert repr(results["raw"]).startswith("RawData(HH/VV: 12 pulses x ")
    assert repr(results["image"]).startswith("SarImage(HH/VV: ")


def size_of_png(data: bytes) -> tuple[int, int]:
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


@pytest.mark.parametrize("name", ["scene", "image", "built"])
def test_notebooks_show_a_picture(results: dict[str, object], name: str) -> None:
    value = results[name]
    assert isinstance(value, SarImage | sarmitsuba.Scene)
    assert min(size_of_png(value._repr_png_())) > 100


def known_image() -> SarImage:
    """Two channels, powers known, a dark pixel."""
    power = np.arange(35.0).reshape(5, 7)
    data = np.stack([np.sqrt(power), 2.0 * np.sqrt(power)]).astype(np.complex64)
    x, y, _ = np.eye(3)
    grid = ImageGrid("ground", np.arange(5.0), 2.0 * np.arange(7.0), np.zeros(3), y, x)
    layers = (Layer("HH"), Layer("VV"))
    return SarImage(data, layers, grid, 0.03, 2.0, 3.0, np.full(7, np.pi / 2), {"scene": "known"})


def test_decibels() -> None:
    image, power = known_image(), np.arange(35.0).reshape(5, 7)
    rcs = image.to_db(quantity="rcs", floor=-60.0)
    assert rcs[0, 0] == -60.0 and np.isneginf(image.to_db(quantity="rcs")[0, 0])
    # tol: float32 pixels
    np.testing.assert_allclose(rcs.ravel()[1:], 10.0 * np.log10(power.ravel()[1:]), atol=1e-5)
    sigma0 = image.to_db("VV")
    np.testing.assert_allclose(sigma0.ravel()[1:], 10.0 * np.log10(4.0 / 6.0 * power.ravel()[1:]), atol=1e-5)
    with pytest.raises(DataError, match="quantity 'gamma0' is unknown"):
        image.to_db(quantity="gamma0")  # type: ignore[arg-type]


def test_multilook_is_the_mean_power_of_blocks() -> None:
    image, power = known_image(), np.arange(35.0).reshape(5, 7)
    looks = image.multilook(2, 3, quantity="rcs")
    expected = [[power[2 * i : 2 * i + 2, 3 * j : 3 * j + 3].mean() for j in range(2)] for i in range(2)]
    np.testing.assert_allclose(looks.power, expected, rtol=1e-6)  # tol: float32 pixels
    np.testing.assert_allclose(looks.azimuth, [0.5, 2.5])
    np.testing.assert_allclose(looks.range, [2.0, 8.0])
    np.testing.assert_allclose(looks.to_db(), 10.0 * np.log10(expected), atol=1e-5)
    assert image.multilook(1, 1).power.shape == (5, 7)
    for bad in ((0, 1), (6, 1), (1, 8)):
        with pytest.raises(DataError, match="give 1 or more, up to its size"):
            image.multilook(*bad)


@pytest.mark.parametrize(
    ("suffix", "start"),
    [
        ("", b"\x89PNG"),
        (".png", b"\x89PNG"),
        (".JPG", b"\xff\xd8\xff"),
        (".pdf", b"%PDF"),
        (".svg", b"<?xml"),
    ],
)
def test_pictures_are_what_their_suffixes_say(
    results: dict[str, object], tmp_path: Path, suffix: str, start: bytes
) -> None:
    """``plot("x.jpg")`` wrote a PNG file of that name."""
    image = results["image"]
    assert isinstance(image, SarImage)
    image.plot(tmp_path / f"first{suffix}")
    image.plot(tmp_path / f"second{suffix}")
    first, second = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("first", "second"))
    assert first.startswith(start)
    if suffix != ".svg":  # ids of its clip paths are drawn anew
        assert first == second
    with pytest.raises(
        DataError, match=r'x\.bmp: no picture has the suffix "\.bmp"; take \.png, \.jpg, \.pdf or \.svg'
    ):
        image.plot(tmp_path / "x.bmp")


def test_save_load_and_plot(results: dict[str, object], tmp_path: Path) -> None:
    image, raw = results["image"], results["raw"]
    assert isinstance(image, SarImage) and isinstance(raw, sarmitsuba.RawData)
    image.save(tmp_path / "i.h5")
    raw.save(tmp_path / "r.h5")
    np.testing.assert_array_equal(SarImage.load(tmp_path / "i.h5").total("VV"), image.total("VV"))
    np.testing.assert_array_equal(sarmitsuba.RawData.load(tmp_path / "r.h5").total(), raw.total())
    np.testing.assert_array_equal(sarmitsuba.read_image(tmp_path / "i.h5").total(), image.total())
    figure = image.plot(tmp_path / "i.png", channel="VV")
    assert type(figure).__name__ == "Figure" and min(size_of_png((tmp_path / "i.png").read_bytes())) > 100


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("name", ["dihedral", "tower"])
def test_a_changed_scene_is_the_scene_loaded_so(name: str) -> None:
    """By parameters of the file; the random changes are those of a loop over looks."""
    rng = np.random.default_rng(5)
    base = sarmitsuba.load_scene(name, parameters=FEW)
    for _ in range(3):
        changes = {
            "look_angle_deg": float(rng.uniform(25.0, 60.0)),
            "heading_deg": float(rng.uniform(0.0, 360.0)),
            "bandwidth": float(rng.uniform(1e8, 3e8)),
            "image_extent_range": float(rng.uniform(10.0, 20.0)),
        }
        named = {
            ("range_film." if k.startswith("image") else "sar_antenna.") + k: repr(v)
            for k, v in changes.items()
        }
        ours, theirs = base.replace(**changes), sarmitsuba.load_scene(name, parameters=FEW | named)
        assert ours.image == theirs.image and ours.notes == theirs.notes
        np.testing.assert_array_equal(ours.radar.track.position, theirs.radar.track.position)
        np.testing.assert_array_equal(ours.radar.window.start_range, theirs.radar.window.start_range)
        assert ours.radar.waveform == theirs.radar.waveform
        assert ours.geometry is base.geometry


def test_settings_effects_and_name_are_changed_too(scene: sarmitsuba.Scene) -> None:
    other = scene.replace(max_depth=3, seed=7, speckle="off", name="other", image_grid="ground")
    assert (other.settings.max_depth, other.settings.seed, other.name) == (3, 7, "other")
    assert other.settings.effects["speckle"] == "off" and other.image.grid == "ground"
    assert scene.settings.seed == 0 and scene.replace(seed=1).radar is scene.radar


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"look_angel_deg": 30.0}, 'no parameter "look_angel_deg"; did you mean "look_angle_deg"'),
        ({"look_angle_deg": -3.0}, "look_angle_deg = -3 deg is not above the bound 0 deg"),
        ({"prf": "fast"}, 'prf = "fast" is not of type float'),
        ({"method": "exact"}, 'method = "exact" is not one of raw'),
        ({"center_frequency": 1e9}, r"load the scene again with parameters=\{'sar_antenna.center_frequency'"),
    ],
)
def test_changes_that_cannot_be_are_one_line(
    scene: sarmitsuba.Scene, changes: dict[str, object], text: str
) -> None:
    with pytest.raises(SarmitsubaError, match=text) as caught:
        scene.replace(**changes)
    assert "\n" not in str(caught.value)


def test_a_scene_whose_radar_aims_by_itself_can_be_changed() -> None:
    """A parameter given as "auto" stays automatic."""
    base = sarmitsuba.load_scene("tower", radar="airborne_x")
    steeper = base.replace(look_angle_deg=25.0)
    loaded = sarmitsuba.load_scene("tower", radar="airborne_x", parameters={"look_angle_deg": "25"})
    np.testing.assert_allclose(steeper.radar.aim_point, loaded.radar.aim_point, atol=1e-9)
    np.testing.assert_allclose(steeper.radar.track.position, loaded.radar.track.position, atol=1e-6)


def test_a_scene_put_together_by_hand_says_so(scene: sarmitsuba.Scene) -> None:
    import dataclasses

    bare = dataclasses.replace(scene, description=None)
    with pytest.raises(SarmitsubaError, match="holds no description of its radar; load or build it again"):
        bare.replace(look_angle_deg=40.0)
    assert bare.replace(seed=4).settings.seed == 4


def test_errors_are_public() -> None:
    assert issubclass(sarmitsuba.SceneError, SarmitsubaError) and issubclass(SarmitsubaWarning, UserWarning)
    with pytest.raises(sarmitsuba.SceneError):
        sarmitsuba.load_scene("no such scene")
