"""Recipes of data sets: distributions, one line for every bad file, sizes, tiles."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.apps.dataset_recipe import DRAWS, VALUES, read_drawn, read_recipe
from sarmitsuba.core.errors import DataError, SarmitsubaError
from sarmitsuba.core.parameters import Param

ANGLE = Param("angle_deg", "float", 0.0, "an angle", "deg", -180.0, 180.0)
COUNT = Param("count", "integer", 0, "a number", "", 0, 20)
WORD = Param("word", "string", "a", "a word", choices=("a", "b"))


def recipe_of(tmp_path: Path, text: str, name: str = "r.toml") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("value", "mean", "sigma"),
    [
        ({"uniform": [-90, 30]}, -30.0, 120.0 / np.sqrt(12.0)),
        ({"normal": [10, 5]}, 10.0, 5.0),
        # half a normal distribution, cut off at the bound of 180 deg that is its mean
        ({"normal": [180, 10]}, 180.0 - 10.0 * np.sqrt(2.0 / np.pi), 10.0 * np.sqrt(1.0 - 2.0 / np.pi)),
        ({"choice": [0, 10, 50]}, 20.0, np.std([0, 10, 50])),
    ],
)
def test_moments(value: object, mean: float, sigma: float) -> None:
    drawn, generator, n = read_drawn(value, ANGLE, "here"), np.random.default_rng(5), 20_000
    found = np.array([drawn.draw(generator, 0) for _ in range(n)])
    # tol: five standard deviations of the mean, and of the standard deviation, of n draws
    assert abs(found.mean() - mean) < 5.0 * sigma / np.sqrt(n)
    assert abs(found.std() - sigma) < 5.0 * sigma / np.sqrt(n)
    assert (np.abs(found) <= 180.0).all()


def test_integers_reach_both_ends() -> None:
    drawn, generator = read_drawn({"uniform": [2, 5]}, COUNT, "here"), np.random.default_rng(1)
    found = [drawn.draw(generator, 0) for _ in range(200)]
    assert set(found) == {2, 3, 4, 5} and all(type(v) is int for v in found)


def test_a_grid_gives_each_value_in_turn() -> None:
    drawn = read_drawn({"grid": [0, 90, 4]}, ANGLE, "here")
    generator = np.random.default_rng(0)
    assert [drawn.draw(generator, i) for i in range(drawn.levels)] == [0.0, 30.0, 60.0, 90.0]


def test_two_grids_give_all_pairs(tmp_path: Path) -> None:
    text = (
        "[dataset]\nsamples = 6\n[radar]\nlook_angle_deg = { grid = [30, 50, 3] }\n"
        "heading_deg = { grid = [0, 90, 2] }\n"
    )
    recipe = read_recipe(recipe_of(tmp_path, text))
    pairs = {tuple(sorted(recipe.levels(n).items())) for n in range(6)}
    assert len(pairs) == 6
    assert {recipe.levels(n)["radar.look_angle_deg"] for n in range(6)} == {0, 1, 2}


@pytest.mark.parametrize(
    ("value", "param", "said"),
    [
        ({"unifrom": [0, 1]}, ANGLE, 'did you mean "uniform"'),
        ({"uniform": [0, 360]}, ANGLE, "360 deg is above the bound 180 deg"),
        ({"uniform": [30, 10]}, ANGLE, "falls"),
        ({"uniform": [1]}, ANGLE, "is not of the form [low, high]"),
        ({"uniform": ["a", 1]}, ANGLE, "does not hold numbers alone"),
        ({"uniform": [0, float("nan")]}, ANGLE, "does not hold numbers alone"),
        ({"uniform": 3}, ANGLE, "is no list"),
        ({"uniform": [0, 1]}, WORD, "draw it by choice"),
        ({"normal": [0, -1]}, ANGLE, "standard deviation -1"),
        ({"choice": []}, ANGLE, "at least one"),
        ({"choice": ["a", "c"]}, WORD, "is not one of a, b"),
        ({"grid": [0, 90, 2.5]}, ANGLE, "give an integer"),
        ({"grid": [0, 90, 10**9]}, ANGLE, "give an integer"),
        ({"uniform": [0, 1], "normal": [0, 1]}, ANGLE, "give one of"),
        ("north", ANGLE, "is not of type float"),
        (1.5, COUNT, "is not of type integer"),
    ],
)
def test_bad_distributions(value: object, param: Param, said: str) -> None:
    with pytest.raises(DataError) as caught:
        read_drawn(value, param, "r.toml: [x]")
    assert said in str(caught.value) and str(caught.value).startswith("r.toml: [x]")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[datset]\n", 'unknown section "datset"; did you mean "dataset"?'),
        ("[dataset]\nsampels = 4\n", 'unknown parameter "sampels"; did you mean "samples"?'),
        ("[dataset]\nsamples = 0\n", "0 is below the bound 1"),
        ("[dataset]\nsamples = 7\nviews = 2\n", "no multiple of views"),
        ("samples = 4\n", 'unknown section "samples"'),
        ("dataset = 4\n", "is no section"),
        ("[radar]\nlook_angel_deg = 40\n", 'did you mean "look_angle_deg"?'),
        ("[radar]\nlook_angle_deg = 95\n", "look_angle_deg = 95 deg is"),
        ("[radar]\nfov = 3\n", "the beam is given by"),
        ("[film]\npixels_range = 64\n", "give it in [images]"),
        ("[tracing]\nseed = 4\n", "give seed in [dataset]"),
        ("[tracing]\nmethod = 'rastr'\n", 'did you mean "raster"?'),
        ("[objects]\nmeshes = { choice = ['a', 'b'] }\n", "is not drawn"),
        ("[parts]\ntrain = 0.9\n", "add up to 1.2, not 1"),
        ("[parts]\nby = 'meshes'\n", "is not one of instance, scene"),
        ("[images]\ntile_range = 300\n", "larger than pixels_range = 128"),
        ("[images]\ntile_range = 64\noverlap = 64\n", "not below tile_range = 64"),
        ("[scene]\nfile = 'tower'\n[ground]\n", "[ground] draws shapes"),
        ("[radar]\npolarisation = { choice = ['HH', 'HH,VV'] }\n", "give each the same number"),
        ("[dataset]\nsamples = 60000\n[output]\nraw = true\n", "takes 60000 files"),
        ("[scene]\n", "file is empty"),
        ("[scene]\nfile = 'tower'\n[parts]\nby = 'instance'\n", "needs [objects]"),
        ("[dataset]\nsamples = 4\nviews = 2\n[ground]\nrelief = { grid = [0, 1, 2] }\n", "draw it at random"),
        ("[dataset\n", "cannot be read as a recipe"),
        ("a = 1\na = 2\n", "cannot be read as a recipe"),
        ("x = " + "[" * 5000 + "]" * 5000, "cannot be read as a recipe"),
        ("[dataset]\nsamples = 99999999999999999999\n", "give an integer from 1 to"),
    ],
)
def test_bad_recipes_get_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(SarmitsubaError) as caught:
        read_recipe(recipe_of(tmp_path, text))
    line = str(caught.value)
    assert said in line and "\n" not in line and "r.toml" in line


def test_files_that_are_no_recipes(tmp_path: Path) -> None:
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "big.toml").write_bytes(b"#" * (2 << 20))
    for name in ("b.toml", "big.toml", "none.toml", "vehicles_and_boat"):
        with pytest.raises(DataError) as caught:
            read_recipe(tmp_path / name if name.endswith("toml") else name)
    assert 'did you mean "vehicles_and_boats"' in str(caught.value)


def test_json_is_the_same_recipe(tmp_path: Path) -> None:
    one = read_recipe(recipe_of(tmp_path, "[dataset]\nsamples = 3\n[radar]\nprf = 900.0\n"))
    two = read_recipe(recipe_of(tmp_path, '{"dataset": {"samples": 3}, "radar": {"prf": 900.0}}', "r.json"))
    assert one.values == two.values and one.drawn("radar", "prf") == two.drawn("radar", "prf")


def test_shipped_recipes_are_sound() -> None:
    recipe = read_recipe("vehicles_and_boats")
    assert recipe.samples == 5000 and recipe.shape == (128, 128)


@pytest.mark.parametrize(
    ("size", "tile", "overlap"), [(100, 40, 10), (128, 128, 0), (513, 256, 31), (64, 9, 8)]
)
def test_tiles_cover_the_image_and_overlap(tmp_path: Path, size: int, tile: int, overlap: int) -> None:
    text = (
        f"[images]\npixels_azimuth = {size}\ntile_azimuth = {tile}\ntile_range = 128\noverlap = {overlap}\n"
    )
    corners = read_recipe(recipe_of(tmp_path, text)).corners
    starts = sorted({row for row, _ in corners})
    assert starts[0] == 0 and starts[-1] == size - tile
    assert all(b - a <= tile - overlap for a, b in itertools.pairwise(starts))


def test_the_page_has_every_parameter() -> None:
    """A row of the recipe's table names the section and the parameter, its default and its meaning."""
    page = (Path(__file__).parents[2] / "docs" / "labels.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in page.splitlines()
        if line.startswith("| `")
    ]
    own = [table for name, table in DRAWS.items() if name not in ("radar", "film", "tracing")]
    listed = {
        (section, names[-1]): (default, meaning)
        for where, default, meaning in (row for row in rows if len(row) == 3)
        for names in [re.findall(r"`(\w+)`", where)]
        for section in names[:-1]
    }
    for table in (*VALUES.values(), *own):
        for param in table.rows:
            default, meaning = listed[table.plugin, param.name]
            told = f"{param.default:g}" if isinstance(param.default, float) else str(param.default)
            given = [words.split()[0] for words in default.split(",") if words.split()]
            assert (told.lower() in given) if told else not given, (table.plugin, param.name)
            assert meaning == param.doc, (table.plugin, param.name)
