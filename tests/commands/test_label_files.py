"""Files of labels: HDF5 read back, hostile ones refused, COCO's run lengths, masks and maps."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from sarmitsuba import Labels
from sarmitsuba.core.errors import DataError
from sarmitsuba.files.coco import coco_document, run_lengths
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import LabelLayer, LabelledInstance
from sarmitsuba.view.labels_picture import write_mask


def made(rows: int = 7, columns: int = 5, *, kind: str = "ground") -> Labels:
    rng = np.random.default_rng([rows, columns])
    grid = ImageGrid(
        kind,  # type: ignore[arg-type]
        azimuth=0.5 * np.arange(rows),
        range=100.0 + 0.25 * np.arange(columns),
        origin=np.array([1.0, 2.0, 50.0]),
        along=np.array([0.0, 1.0, 0.0]),
        across=np.array([1.0, 0.0, 0.0]),
    )
    position = rng.normal(size=(rows, columns, 3))
    position[0, 0] = np.nan
    shape = rng.integers(0, 3, (rows, columns)).astype(np.int32)
    layers = {
        "mask": LabelLayer(
            rng.integers(0, 4, (rows, columns)).astype(np.uint8), "", "a mask", {0: "no", 3: "yes"}
        ),
        "position": LabelLayer(position, "m", "places", parts=("x", "y", "height")),
        "shape": LabelLayer(shape, "", "shapes", {0: "none", 1: "Häuschen", 2: "tree"}),
    }
    one = LabelledInstance(
        1, "Häuschen", "brick", "building", (0, 1, 2, 3), np.arange(8.0).reshape(4, 2), 4, 2, 0.5, 0.25
    )
    two = LabelledInstance(2, "tree", "wood", "", (-1, -1, -1, -1), np.full((4, 2), np.nan), 0, 0, 0.0, 0.0)
    return Labels(grid, layers, (one, two), ("a note", "another"))


@pytest.mark.parametrize("kind", ["ground", "slant"])
def test_labels_are_read_back(tmp_path: Path, kind: str) -> None:
    labels = made(kind=kind)
    labels.save(tmp_path / "labels.h5")
    back = Labels.load(tmp_path / "labels.h5")
    assert back.notes == labels.notes and back.layers.keys() == labels.layers.keys()
    for name, layer in labels.layers.items():
        found = back.layers[name]
        np.testing.assert_array_equal(found.values, layer.values)
        assert found.values.dtype == layer.values.dtype
        assert (found.unit, found.description, found.codes, found.parts) == (
            layer.unit,
            layer.description,
            layer.codes,
            layer.parts,
        )
    for one, two in zip(back.instances, labels.instances, strict=True):
        np.testing.assert_array_equal(one.oriented_box, two.oriented_box)
        fields = [name for name in one.__dataclass_fields__ if name != "oriented_box"]
        assert [getattr(one, name) for name in fields] == [getattr(two, name) for name in fields]
    np.testing.assert_array_equal(back.grid.positions(), labels.grid.positions())


def test_labels_without_instances_and_notes_are_read_back(tmp_path: Path) -> None:
    labels = Labels(made().grid, {})
    labels.save(tmp_path / "labels.h5")
    back = Labels.load(tmp_path / "labels.h5")
    assert back.layers == {} and back.instances == () and back.notes == ()


def _without(name: str) -> object:
    def change(file: h5py.File) -> None:
        del file[name]

    return change


def _with(name: str, value: object) -> object:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = value

    return change


DAMAGE = {
    "no grid": (_without("grid"), "/grid is missing"),
    "no labels": (_without("labels"), "/labels is missing"),
    "another size": (_with("labels/mask", np.zeros((2, 2), np.uint8)), "/labels/mask is uint8"),
    "complex": (_with("labels/mask", np.zeros((7, 5), np.complex64)), "/labels/mask is complex64"),
    "no unit": (_with("labels/mask", np.zeros((7, 5), np.uint8)), "no attribute unit"),
    "link": (_with("labels/mask", h5py.ExternalLink("other.h5", "/x")), "is a link"),
    "bad name": (_with("labels/a b", np.zeros((7, 5), np.uint8)), "no name of a layer"),
    "codes": (_with("codes/mask/value", np.arange(9)), "(9,) values and 2 names"),
    "columns": (_with("instances/pixels", np.arange(9)), "/instances/pixels"),
    "texts": (_with("instances/name", np.arange(2)), "cannot read labels"),
    "notes": (_with("notes", 3.0), "cannot read labels"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    change, text = DAMAGE[name]
    path = tmp_path / "labels.h5"
    made().save(path)
    with h5py.File(path, "r+") as file:
        change(file)  # type: ignore[operator]
    with pytest.raises(DataError) as error:
        Labels.load(path)
    assert text in str(error.value) and "\n" not in str(error.value)


def test_other_files_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        Labels.load(tmp_path / "none.h5")
    path = tmp_path / "labels.h5"
    made().save(path)
    whole = path.read_bytes()
    for size in np.random.default_rng(1).integers(0, len(whole), 12):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError) as error:
            Labels.load(path)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("seed", range(6))
def test_run_lengths_give_the_mask_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random(rng.integers(1, 9, 2)) < (0.0, 0.2, 0.5, 0.9, 1.0, 0.5)[seed]
    found = run_lengths(mask)
    values = np.repeat(np.arange(len(found["counts"])) % 2, found["counts"])
    np.testing.assert_array_equal(values.reshape(mask.shape, order="F").astype(bool), mask)
    assert found["size"] == list(mask.shape)


def test_coco_names_classes_and_encloses_masks() -> None:
    labels = made(9, 11)
    document = json.loads(json.dumps(coco_document(labels, "pixels.png", "shape")))
    assert document["images"] == [{"id": 1, "file_name": "pixels.png", "height": 9, "width": 11}]
    kinds = {entry["id"]: entry["name"] for entry in document["categories"]}
    assert sorted(kinds.values()) == ["building", "tree"]  # a class, and the name of a shape without one
    for entry in document["annotations"]:
        code = {"building": 1, "tree": 2}[kinds[entry["category_id"]]]
        mask = labels["shape"] == code
        rows, columns = np.nonzero(mask)
        x, y, width, height = entry["bbox"]
        assert (x, y, x + width - 1, y + height - 1) == (columns.min(), rows.min(), columns.max(), rows.max())
        assert entry["area"] == mask.sum() == sum(entry["segmentation"]["counts"][1::2])


def test_masks_are_pixels(tmp_path: Path) -> None:
    labels = made()
    write_mask(tmp_path / "mask.png", labels, "mask")
    with Image.open(tmp_path / "mask.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), labels["mask"])
        shown = np.asarray(picture.convert("RGB")).reshape(-1, 3)
        assert len(np.unique(shown, axis=0)) == len(np.unique(labels["mask"]))  # a colour for each code
    labels["shape"][2, 3] = 700
    write_mask(tmp_path / "shape.png", labels, "shape")
    with Image.open(tmp_path / "shape.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), labels["shape"])
    with pytest.raises(DataError, match='no layer of codes "masc"; did you mean "mask"'):
        write_mask(tmp_path / "none.png", labels, "masc")


def test_a_map_holds_the_codes_of_the_nearest_pixels(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from sarmitsuba.files.catalog.geotiff import write_layer

    labels = made(40, 60)
    write_layer(tmp_path / "mask.tif", labels, "mask")
    with rasterio.open(tmp_path / "mask.tif") as file:
        values = file.read(1)
        assert file.nodata == 255 and file.tags()["code_3"] == "yes"
        assert set(np.unique(values)) <= {0, 1, 2, 3, 255}
        # the finer spacing of the image is 0.25 m, of the map 0.5 m: every second column
        assert (values != 255).sum() == pytest.approx(40 * 60 / 2, rel=0.1)  # tol: the rim
