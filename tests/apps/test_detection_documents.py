"""COCO annotations of drawn samples: masks come back from their run lengths, boxes bound them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sarmitsuba.apps.dataset_generate import DetectionDocuments
from sarmitsuba.apps.dataset_recipe import read_recipe
from sarmitsuba.apps.dataset_store import SampleRecord


def decoded(found: dict[str, Any]) -> NDArray[np.bool_]:
    """Mask of run lengths, run by run: columns one after the other, beginning with a run of zeros."""
    rows, columns = found["size"]
    flat: list[bool] = []
    for i, count in enumerate(found["counts"]):
        flat += [i % 2 == 1] * count
    assert len(flat) == rows * columns
    return np.array(flat).reshape(columns, rows).T


@pytest.mark.parametrize("seed", range(12))
def test_masks_of_tiles_come_back(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = (int(v) for v in rng.integers(16, 40, 2))
    tile = int(rng.integers(8, 16))
    path = tmp_path / "r.toml"
    path.write_text(
        f"[images]\npixels_azimuth = {rows}\npixels_range = {columns}\ntile_azimuth = {tile}\ntile_range = {tile}\n"
        "overlap = 3\n"
    )
    recipe = read_recipe(path)
    shape = rng.integers(0, 4, (rows // 4 + 1, columns // 4 + 1)).repeat(4, axis=0).repeat(4, axis=1)
    shape = shape[:rows, :columns] * (rng.uniform(size=(rows, columns)) < 0.9)
    objects = [
        {
            "name": f"objects_{k}",
            "semantic_class": "ab"[k % 2],
            "code": k,
            "aspect_deg": 0.0,
            "box": [None] * 4,
        }
        for k in (1, 2, 3)
    ]
    label = {"part": "test", "number": 5, "objects": objects, "named_shapes": []}
    documents = DetectionDocuments(recipe, ("a", "b"))
    documents.add(SampleRecord(label, {"image": np.zeros((1, rows, columns)), "shape": shape}), 7)
    document = documents.documents["test"]
    assert [one["id"] for one in document["images"]] == list(range(7, 7 + len(recipe.corners)))
    found = {(one["image_id"], one["name"]): one for one in document["annotations"]}
    assert len(found) == len(document["annotations"])
    for i, (top, left) in enumerate(recipe.corners):
        window = shape[top : top + tile, left : left + tile]
        for k in (1, 2, 3):
            mask, one = window == k, found.get((7 + i, f"objects_{k}"))
            if one is None:
                assert not mask.any()
                continue
            np.testing.assert_array_equal(decoded(one["segmentation"]), mask)
            x, y, width, height = one["bbox"]
            outside = mask.copy()
            outside[y : y + height, x : x + width] = False
            assert not outside.any() and one["area"] == mask.sum() and one["iscrowd"] == 0
            for edge in (mask[y], mask[y + height - 1], mask[:, x], mask[:, x + width - 1]):
                assert edge.any()  # the box is the smallest
    assert not documents.documents["train"]["images"]


def test_boxes_of_echoes_and_the_bright_energy_outside(tmp_path: Path) -> None:
    """A body of 16 pixels whose corner shines four columns behind it: a quarter or none of the energy is outside."""
    shape = np.zeros((20, 20), dtype=np.int32)
    shape[4:8, 4:8] = 1
    instance, here = shape.copy(), (shape > 0).astype(np.uint8)
    instance[5, 3:13] = 1  # side lobes, and the echo itself
    here[5, 11] = 1
    image = np.where(shape, 1.0, 0.0)[None]
    image[0, 5, 11] = np.sqrt(16.0 / 3.0)  # a quarter of the energy, and the brightest
    label = {
        "part": "train",
        "number": 0,
        "objects": [{"name": "o", "semantic_class": "a", "code": 1, "aspect_deg": 0.0, "box": [None] * 4}],
        "named_shapes": [],
    }
    arrays = {"image": image, "shape": shape, "instance": instance, "instance_here": here}
    for kind, box, outside in (("shapes", [4, 4, 4, 4], 0.25), ("echoes", [4, 4, 8, 4], 0.0)):
        path = tmp_path / f"{kind}.toml"
        path.write_text(f"[images]\npixels_azimuth = 20\npixels_range = 20\n[labels]\nboxes = '{kind}'\n")
        recipe = read_recipe(path)
        assert recipe.layers == (("instance", "instance_here") if kind == "echoes" else ())
        documents = DetectionDocuments(recipe, ("a",))
        documents.add(SampleRecord(label, arrays), 0)
        (one,) = documents.documents["train"]["annotations"]
        assert one["bbox"] == box and one["area"] == (17 if kind == "echoes" else 16)
        assert documents.outside == [pytest.approx(outside)]
        assert documents.brightest_outside == (kind == "shapes")


def test_boxes_are_cut_at_the_tile(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text("[images]\npixels_azimuth = 20\npixels_range = 20\n")
    documents = DetectionDocuments(read_recipe(path), ("a",))
    boxes = [[2.0, 3.0, 5.5, 7.0], [-4.0, 15.0, 3.0, 30.0], [25.0, 0.0, 30.0, 4.0], [None] * 4]
    objects = [
        {"name": f"o{i}", "semantic_class": "a", "aspect_deg": 0.0, "box": b} for i, b in enumerate(boxes)
    ]
    label = {"part": "train", "number": 0, "objects": objects, "named_shapes": []}
    documents.add(SampleRecord(label, {"image": np.zeros((1, 20, 20))}), 0)
    found = {one["name"]: one["bbox"] for one in documents.documents["train"]["annotations"]}
    # x, y, width, height from the corner of the first pixel
    assert found == {"o0": [3.0, 2.0, 5.0, 4.5], "o1": [15.0, 0.0, 5.0, 4.0]}
