"""Files with the labels of an image, which ``render`` and ``focus`` write."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.machine.output import OutputFolder

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.signal.image import SarImage
    from sarmitsuba.signal.pixel_labels import Labels

LABELS, COCO, PIXELS = "labels.h5", "labels.json", "labels_pixels.png"
# pictures over the image, of a layer each
PICTURES = {"labels.png": "layover_shadow", "labels_echoes.png": "mechanism"}
# layers of codes; of a scene without labels of echoes the first three
_MASKS = (
    *("layover_shadow", "shape", "shadow_of"),
    *("mechanism", "instance", "second_instance", "instance_here", "material", "class"),
)
# layers that name the shape of each pixel, for COCO; the first that there is
_SHAPES = ("instance", "shape")


def label_names(*, geotiff: bool) -> tuple[str, ...]:
    """Names of the files with labels; ``geotiff``: masks on a map too."""
    kinds = ("png", "tif") if geotiff else ("png",)
    masks = [f"labels_{layer}.{kind}" for layer in _MASKS for kind in kinds]
    return (LABELS, COCO, PIXELS, *PICTURES, *masks)


def save_labels(
    folder: OutputFolder,
    image: "SarImage",
    scene: "Scene",
    console: Console,
    *,
    classes: Mapping[str, str] | None,
    geotiff: bool,
) -> "Labels":
    """Label the pixels of an image and write the labels: HDF5, COCO, masks as PNG, and on a map as GeoTIFF."""
    from sarmitsuba.analysis.labels import labels
    from sarmitsuba.files.catalog.geotiff import write_layer
    from sarmitsuba.files.coco import write_coco
    from sarmitsuba.files.labels_file import write_labels
    from sarmitsuba.view.labels_picture import write_mask, write_pixels

    found = labels(scene, image=image, classes=classes)
    for note in found.notes:
        console.note(f"labels: {note}")
    with folder.writing(LABELS) as path:
        write_labels(found, path)
    layer = next(name for name in _SHAPES if name in found.layers)
    with folder.writing(COCO) as path:
        write_coco(path, found, PIXELS, layer)
    with folder.writing(PIXELS) as path:
        write_pixels(path, image)
    for name, one in found.layers.items():
        if not one.codes or one.parts:
            continue
        with folder.writing(f"labels_{name}.png") as path:
            write_mask(path, found, name)
        if geotiff:
            with folder.writing(f"labels_{name}.tif") as path:
                write_layer(path, found, name)
    return found
