"""Labels of an image from the scene that it shows."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from sarmitsuba.errors import DataError
from sarmitsuba.exclusive import exclusive
from sarmitsuba.focusing.grid import default_grid
from sarmitsuba.image.labels import LabelLayer, LabelledInstance, Labels
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.labelling.geometric_layers import geometric_layers, geometric_notes, surface_points
from sarmitsuba.memory import check_fits
from sarmitsuba.parameters import did_you_mean
from sarmitsuba.scene.scene import Scene

# bytes of a pixel while labels are made: 520 with 1.3 points of surfaces in each, measured on buildings16
_BYTES = 700


@dataclass(frozen=True, eq=False)
class MadeLabels:
    """Labels of one maker.

    Parameters
    ----------
    layers : by name, on the image's grid
    instances : shapes in the image; of one maker only
    notes : what they leave out
    """

    layers: Mapping[str, LabelLayer]
    instances: tuple[LabelledInstance, ...] = ()
    notes: tuple[str, ...] = ()


Maker = Callable[[Scene, ImageGrid, Mapping[str, str]], MadeLabels]


def geometric_labels(scene: Scene, grid: ImageGrid, classes: Mapping[str, str]) -> MadeLabels:
    """Labels by geometry; ``classes`` have no part in them."""
    return MadeLabels(
        geometric_layers(scene, grid, surface_points(scene, grid)), notes=geometric_notes(scene)
    )


# every maker's layers are in the labels, in this order; an entry is called with scene, grid and classes by shape
MAKERS: tuple[Maker, ...] = (geometric_labels,)


@exclusive
def labels(
    scene: Scene | Path | str,
    grid: ImageGrid | None = None,
    *,
    image: SarImage | None = None,
    classes: Mapping[str, str] | None = None,
) -> Labels:
    """Labels of every pixel of an image: layover, shadow, incidence angle, positions, shapes.

    Parameters
    ----------
    scene : of the image; a scene file or the name of a shipped scene is loaded
    grid : of the image, in any frame; None: that of ``image``, else the scene's own
    image : whose pixels are labelled, for its grid
    classes : semantic class of each shape, by its name

    Returns
    -------
    Labels on that grid; layers in docs/labels.md

    Raises
    ------
    DataError
        Both a grid and an image are given; classes name a shape that the scene does not have; the track goes round the
        scene, so that an image has no one direction of range.
    SceneError
        The scene cannot be loaded.
    ResourceError
        The labels do not fit into memory.
    """
    scene = Scene.of(scene)
    if image is not None and grid is not None:
        raise DataError("labels: both a grid and an image are given; leave out one of them")
    if image is not None:
        grid = image.grid
    if grid is None:
        grid = default_grid(scene.radar.as_recorded(), scene.image)
    grid = grid.in_frame(scene.offset)
    rows, columns = grid.shape
    check_fits(
        f"labels: {rows} x {columns} pixels", _BYTES * rows * columns, "label an image of fewer pixels"
    )
    given = checked_classes(scene, classes or {})
    made = [maker(scene, grid, given) for maker in MAKERS]
    return Labels(
        grid,
        {name: layer for one in made for name, layer in one.layers.items()},
        tuple(instance for one in made for instance in one.instances),
        tuple(note for one in made for note in one.notes),
    )


def checked_classes(scene: Scene, classes: Mapping[str, str]) -> dict[str, str]:
    """Classes by shape, after a check of the shapes' names."""
    known = [
        *scene.geometry.mesh_names,
        *(thing.name for many in (scene.points, scene.wires, scene.volumes) for thing in many),
    ]
    for name in classes:
        if name not in known:
            raise DataError(
                f'labels: classes: the scene has no shape "{name}"{did_you_mean(name, known)}; name shapes by their id'
            )
    return dict(classes)
