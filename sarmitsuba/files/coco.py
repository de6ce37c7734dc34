"""COCO files of an image's labelled shapes: boxes, and masks in run lengths."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.signal.pixel_labels import Labels
from sarmitsuba.version import __version__


def run_lengths(mask: NDArray[np.bool_]) -> dict[str, list[int]]:
    """Mask (rows, columns) in COCO's uncompressed form: runs of 0 and 1 in turn, column by column, 0 first."""
    flat = np.asarray(mask, dtype=bool).ravel(order="F")
    changes = np.flatnonzero(np.diff(flat.astype(np.int8), prepend=0))
    counts = np.diff(np.concatenate([[0], changes, [flat.size]]))
    return {"size": [int(n) for n in mask.shape], "counts": counts.tolist()}


def coco_document(labels: Labels, picture: str, layer: str) -> dict[str, object]:
    """COCO document of the shapes in an image.

    Parameters
    ----------
    labels : with a layer of codes of shapes
    picture : file name of the image that the pixels count in: rows are azimuth, from early to late, columns range
    layer : of codes, one for each shape; 0 is none. Pixels where the layer of that name and ``_here`` is 0, which only
        side lobes reach, belong to no mask

    Returns
    -------
    categories are the semantic classes, or the shapes' names where a shape has none; boxes are x, y, width and height
    in pixels from the corner of the first pixel. ``iscrowd`` is 0: each annotation is one shape; detectors drop those
    where it is 1, and pycocotools reads masks of run lengths either way.
    """
    codes, values = labels.layers[layer].codes, labels[layer]
    if f"{layer}_here" in labels.layers:
        values = np.where(labels[f"{layer}_here"] != 0, values, 0)
    classes = {one.name: one.semantic_class for one in labels.instances if one.semantic_class}
    present = [int(code) for code in np.unique(values) if code > 0]
    names = {code: codes.get(code, str(code)) for code in present}
    kinds = sorted({classes.get(name, name) for name in names.values()})
    number = {kind: i for i, kind in enumerate(kinds, 1)}
    annotations = [
        _annotation(i, number[classes.get(names[code], names[code])], names[code], values == code)
        for i, code in enumerate(present, 1)
    ]
    return {
        "info": {"description": f"labels by sarmitsuba {__version__}"},
        "images": [{"id": 1, "file_name": picture, "height": values.shape[0], "width": values.shape[1]}],
        "categories": [{"id": i, "name": kind} for kind, i in number.items()],
        "annotations": annotations,
    }


def _annotation(number: int, category: int, name: str, mask: NDArray[np.bool_]) -> Mapping[str, object]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = [columns[0], rows[0], columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1]
    return {
        "id": number,
        "image_id": 1,
        "category_id": category,
        "name": name,
        "bbox": [int(value) for value in box],
        "area": int(mask.sum()),
        "iscrowd": 0,
        "segmentation": run_lengths(mask),
    }


def write_coco(path: Path | str, labels: Labels, picture: str, layer: str) -> None:
    """Write :func:`coco_document` as JSON."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(coco_document(labels, picture, layer)), encoding="utf-8")
