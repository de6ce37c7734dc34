"""Semantic classes by a table of names and patterns; codes that all samples of a data set share."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.analysis.echo_labels import NO_CLASS
from sarmitsuba.analysis.label_classes import check_used, classes_of_shapes, read_classes
from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.apps.dataset_recipe import read_recipe
from sarmitsuba.apps.dataset_sample import _recode_layer, make_sample
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.pixel_labels import LabelLayer

NAMES = ("building_1", "building_2", "bridge", "road")


def test_a_name_goes_before_patterns_and_these_in_turn() -> None:
    table = {"b*": "solid", "building_?": "building", "building_2": "church"}
    assert classes_of_shapes(NAMES, table) == {
        "building_1": "solid",
        "building_2": "church",
        "bridge": "solid",
    }


def test_entries_for_no_shape_are_refused() -> None:
    check_used({"building*": "building", "road": "road"}, NAMES, "the scene has")
    with pytest.raises(DataError, match=r'no shape "raod"; did you mean "road"'):
        check_used({"raod": "road"}, NAMES, "the scene has")
    with pytest.raises(DataError, match=r'"road" has the class ""'):
        check_used({"road": ""}, NAMES, "the scene has")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("t.toml", "road = 3\n", "road = 3 is no class"),
        ("t.toml", 'road = ""\n', "is no class"),
        ("t.toml", "[road]\na = 'b'\n", "is no class"),
        ("t.toml", "road\n", "cannot be read as a table of classes"),
        ("t.json", "[1]", "this is a list"),
        ("t.json", '{"road": null}', "is no class"),
        ("t.json", '{"road": ["a"]}', "is no class"),
        ("t.json", "\ufeff" + "{" * 100_000, "cannot be read as a table of classes"),
    ],
)
def test_bad_tables_get_one_line(tmp_path: Path, name: str, text: str, said: str) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError) as caught:
        read_classes(path)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_table_gets_one_line(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot read the table of classes"):
        read_classes(tmp_path / "none.toml")


def test_codes_become_those_of_the_data_set() -> None:
    values = np.array([[0, 1, 2], [3, 2, 1]], dtype=np.uint8)
    layer = LabelLayer(values, "", "material", {0: "none", 1: "wood", 2: "brick_4", 3: "other"})
    found = _recode_layer(layer, ("asphalt", "brick", "wood", "other"))
    assert found.values.tolist() == [[0, 3, 2], [4, 2, 3]]
    assert found.codes == {0: "none", 1: "asphalt", 2: "brick", 3: "wood", 4: "other"}
    with pytest.raises(DataError, match='"wood" is not one of brick, other'):
        _recode_layer(layer, ("brick", "other"))


RECIPE = """
[dataset]
samples = 6
seed = 3
[images]
pixels_azimuth = 24
pixels_range = 24
[labels]
layers = "class, material, instance"
[objects]
heading_deg = { uniform = [0, 360] }
[ground]
material = { choice = ["soil", "asphalt"] }
[classes]
ground = "soil"
[radar]
bandwidth = 200e6
azimuth_resolution = 1.0
[tracing]
method = "image"
"""


@pytest.mark.slow
def test_classes_and_materials_have_the_same_codes_in_every_sample(tmp_path: Path) -> None:
    """Each sample's own numbering would give vehicles and boats, soil and asphalt the same number."""
    path = tmp_path / "r.toml"
    path.write_text(RECIPE, encoding="utf-8")
    drawer = Drawer.of(str(path))
    assert drawer.classes == ("boat", "soil", "vehicle")
    kinds, grounds = set(), set()
    for number in range(6):
        sample = make_sample(drawer, number)
        names = dict(sample.layer_facts["class"]["codes"])  # type: ignore[call-overload]
        assert names == {0: "none", 1: "boat", 2: "soil", 3: "vehicle", 4: NO_CLASS}
        kind = sample.objects[0].semantic_class
        code = {name: code for code, name, _ in sample.named_shapes}
        assert {name: kind for _, name, kind in sample.named_shapes} == {"objects_1": kind, "ground": "soil"}
        # pixels of a shape that takes nearly all of the power are of its class, and of its material
        for shape, wanted in (("objects_1", kind), ("ground", "soil")):
            where = sample.layers["instance"] == code[shape]
            assert {names[int(one)] for one in np.unique(sample.layers["class"][where])} == {wanted}
        materials = dict(sample.layer_facts["material"]["codes"])  # type: ignore[call-overload]
        ground = sample.layers["material"][sample.layers["instance"] == code["ground"]]
        found = {materials[int(one)] for one in np.unique(ground)}
        assert found == {sample.facts["ground.material"]}
        kinds.add(kind)
        grounds |= found
    assert kinds == {"boat", "vehicle"} and grounds == {"soil", "asphalt"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[scene]\nfile = "bridge"\n[classes]\nbrigde_deck = "bridge"\n', "no shape"),
        ('[classes]\nbuilding = "building"\n[ground]\n', 'the scenes have no shape "building"'),
    ],
)
def test_classes_of_no_shape_are_refused_before_any_sample(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "r.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=said):
        Drawer.of(str(path)).check_classes()


def test_a_class_in_a_recipe_is_a_text(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text("[classes]\nground = { choice = ['a', 'b'] }\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"r.toml: \[classes\]: ground = .* is no class"):
        read_recipe(path)


def test_a_sample_without_shapes_of_a_class_has_the_layer(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    text = RECIPE.replace("[objects]", "[objects]\ncount = 0").replace('[classes]\nground = "soil"\n', "")
    path.write_text(text, encoding="utf-8")
    sample = make_sample(Drawer.of(str(path)), 0)
    assert sample.attempt == 0
    names = dict(sample.layer_facts["class"]["codes"])  # type: ignore[call-overload]
    assert {names[int(one)] for one in np.unique(sample.layers["class"])} == {NO_CLASS}
