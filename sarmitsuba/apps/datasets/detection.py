"""COCO annotations of a data set, one document for each part."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.analysis.labels.ground_shapes import GROUND_CLASSES
from sarmitsuba.apps.datasets.recipe import PART_NAMES, Recipe
from sarmitsuba.apps.datasets.record import JsonTable, SampleRecord
from sarmitsuba.apps.datasets.sample_labels import SHAPES
from sarmitsuba.files.coco import run_lengths
from sarmitsuba.version import __version__


def picture_name(number: int, tile: int) -> str:
    """File name of the picture of a tile."""
    return f"picture_{number:07d}_{tile:04d}.png"


class DetectionDocuments:
    """COCO documents, filled sample by sample.

    Parameters
    ----------
    recipe : of the samples
    classes : semantic classes

    Notes
    -----
    Shapes are annotated by their pixels in the layer ``shape``, or else ``instance``, where the recipe asks for it;
    without, by the bounds of their vertices within the image. Shapes of scene files are annotated where [classes] gives
    them a class that is no ground. ``iscrowd`` is 0: each annotation is one shape, also
    those whose masks are run lengths, which pycocotools reads either way and detectors drop where it is 1.
    """

    def __init__(self, recipe: Recipe, classes: Sequence[str]) -> None:
        self._recipe, self._category = recipe, {name: i for i, name in enumerate(classes, 1)}
        self.documents: dict[str, dict[str, Any]] = {
            part: {
                "info": {
                    "description": recipe.text("dataset", "title") or recipe.path.stem,
                    "version": __version__,
                },
                "licenses": [{"id": 1, "name": recipe.text("dataset", "licence"), "url": ""}],
                "images": [],
                "categories": [{"id": i, "name": name} for name, i in self._category.items()],
                "annotations": [],
            }
            for part in PART_NAMES
        }

    def add(self, record: SampleRecord, first_row: int) -> None:
        """Add the tiles of a sample, whose first one is the stored image ``first_row``."""
        document = self.documents[record.label["part"]]
        rows, columns = self._recipe.tile
        for tile, (top, left) in enumerate(self._recipe.corners):
            number = first_row + tile
            document["images"].append(
                {
                    "id": number,
                    "file_name": picture_name(record.label["number"], tile),
                    "height": rows,
                    "width": columns,
                    "license": 1,
                }
            )
            shown = next((record.layers[name] for name in SHAPES if name in record.layers), None)
            window = None if shown is None else shown[top : top + rows, left : left + columns]
            drawn = {one["name"] for one in record.objects}
            others = [
                {"name": name, "semantic_class": kind, "code": code}
                for code, name, kind in record.label["named_shapes"]
                if kind and kind not in GROUND_CLASSES and name not in drawn
            ]
            for one in (*record.objects, *others):
                found = (
                    _outline_box(one["box"], (top, left), (rows, columns))
                    if window is None and "box" in one
                    else _outline_mask(window == one["code"])
                    if window is not None and one["code"]
                    else None
                )
                if found is not None:
                    document["annotations"].append(
                        {
                            "id": len(document["annotations"]) + 1,
                            "image_id": number,
                            "category_id": self._category[one["semantic_class"]],
                            "iscrowd": 0,
                            "name": one["name"],
                            **({"aspect_deg": one["aspect_deg"]} if "aspect_deg" in one else {}),
                            **found,
                        }
                    )


def _outline_mask(mask: NDArray[np.bool_]) -> JsonTable | None:
    """Box, area and run lengths of a mask; None where it is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    box = [columns[0], rows[0], columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1]
    return {"bbox": [int(v) for v in box], "area": int(mask.sum()), "segmentation": run_lengths(mask)}


def _outline_box(
    box: Sequence[float | None], corner: tuple[int, int], size: tuple[int, int]
) -> JsonTable | None:
    """Box of vertices within a tile, from the corner of its first pixel; None where it lies outside."""
    if any(value is None for value in box):
        return None
    bounds = np.array(box, dtype=np.float64) - np.array([*corner, *corner]) + np.array([0.0, 0.0, 1.0, 1.0])
    top, left = np.maximum(bounds[:2], 0.0)
    bottom, right = np.minimum(bounds[2:], size)
    if bottom <= top or right <= left:
        return None
    x, y, width, height = (round(float(v), 3) for v in (left, top, right - left, bottom - top))
    corners = [x, y, x + width, y, x + width, y + height, x, y + height]
    return {"bbox": [x, y, width, height], "area": round(width * height, 3), "segmentation": [corners]}
