"""Labels of an image from the scene that it shows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from sarmitsuba.analysis.echo_labels import ECHO_LAYERS, echo_labels
from sarmitsuba.analysis.geometric_labels import (
    GEOMETRIC_LAYERS,
    SurfacePoints,
    geometric_layers,
    geometric_notes,
    surface_points,
)
from sarmitsuba.analysis.label_classes import checked_classes
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.pixel_labels import LabelLayer, LabelledInstance, Labels
from sarmitsuba.tracing.kernel.path_groups import MECHANISMS


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """Object of labels.

    Parameters
    ----------
    scene, grid : of the image, in the frame of the scene
    classes : semantic class of shapes, by name; None: there are no classes
    windows : of range and azimuth, of the image
    mechanisms : of the echoes that instances are made of; None: all
    """

    scene: Scene
    grid: ImageGrid
    classes: Mapping[str, str] | None
    windows: tuple[str, str]
    mechanisms: tuple[str, ...] | None = None

    @cached_property
    def points(self) -> SurfacePoints:
        """Points of surfaces on the centres of pixels."""
        return surface_points(self.scene, self.grid)


@dataclass(frozen=True, eq=False)
class MadeLabels:
    """Labels of one maker.

    Parameters
    ----------
    layers : by name, on the image's grid
    instances : shapes in the image; of one maker only
    notes : parts that they leave out
    """

    layers: Mapping[str, LabelLayer]
    instances: tuple[LabelledInstance, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LabelMaker:
    """One source of labels.

    Parameters
    ----------
    layers : names of all that it can make
    make : called with the object of the labels
    pixel_bytes : memory of a pixel while they are made
    """

    layers: tuple[str, ...]
    make: Callable[[LabelledImage], MadeLabels]
    pixel_bytes: int


def _make_by_geometry(of: LabelledImage) -> MadeLabels:
    return MadeLabels(geometric_layers(of.scene, of.grid, of.points), notes=geometric_notes(of.scene))


def _make_by_echoes(of: LabelledImage) -> MadeLabels:
    # points are of no use where the radar's track has no one direction of range; echoes have no labels there either
    return MadeLabels(
        *echo_labels(
            of.scene,
            of.grid,
            of.classes,
            windows=of.windows,
            points=lambda: of.points,
            mechanisms=of.mechanisms,
        )
    )


# every maker's layers are in the labels, in this order. Bytes: geometry 420 to 540 in bridge, buildings16, urban_block;
# echoes 750 to 2100 there with the traced look
MAKERS = (
    LabelMaker(GEOMETRIC_LAYERS, _make_by_geometry, 700),
    LabelMaker(ECHO_LAYERS, _make_by_echoes, 1400),
)
LAYERS = tuple(name for maker in MAKERS for name in maker.layers)


@exclusive
def labels(
    scene: Scene | Path | str,
    grid: ImageGrid | None = None,
    *,
    image: SarImage | None = None,
    classes: Mapping[str, str] | None = None,
    layers: Sequence[str] | None = None,
    mechanisms: Sequence[str] | None = None,
) -> Labels:
    """Labels of every pixel of an image: layover, shadow, positions, and the origin of its echoes.

    Parameters
    ----------
    scene : of the image; a scene file or the name of a shipped scene is loaded
    grid : of the image, in any frame; None: that of ``image``, else that of the scene
    image : whose pixels are labelled, for its grid and windows
    classes : semantic class of each shape, by its name or by a pattern of names such as ``"building*"``; None: the
        scene has no classes
    layers : names of those wanted; None: all. Without one of echoes (docs/labels.md) nothing is traced, and there are
        no instances
    mechanisms : of the echoes that layers and boxes of instances are made of, such as ``["double bounce"]``; None: all

    Returns
    -------
    Labels on that grid; layers in docs/labels.md. Scenes that method ``image`` refuses have none of echoes, and a note
    with the reason.

    Raises
    ------
    DataError
        Both a grid and an image are given; a class is that of no shape of the scene; there is no layer of that
        name, or this scene cannot have it; the track goes round the scene, so that an image has no one direction of
        range.
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
    wanted = LAYERS if layers is None else checked_layers(layers)
    makers = [maker for maker in MAKERS if any(name in wanted for name in maker.layers)]
    rows, columns = grid.shape
    check_fits(
        f"labels: {rows} x {columns} pixels",
        sum(maker.pixel_bytes for maker in makers) * rows * columns,
        "label an image of fewer pixels, or ask for fewer layers",
    )
    table = None if classes is None else checked_classes(scene, classes)
    chosen = None if mechanisms is None else checked_mechanisms(mechanisms)
    of = LabelledImage(scene, grid, table, _windows(image), chosen)
    made = [maker.make(of) for maker in makers]
    found = {name: layer for one in made for name, layer in one.layers.items() if name in wanted}
    notes = tuple(note for one in made for note in one.notes)
    if layers is not None:
        for name in layers:
            if name not in found:
                cause = "; ".join(notes) if notes and name not in ("class", "class_share") else "name classes"
                raise DataError(f'labels: this scene has no layer "{name}": {cause}')
    return Labels(grid, found, tuple(instance for one in made for instance in one.instances), notes)


def _windows(image: SarImage | None) -> tuple[str, str]:
    """Windows of range and azimuth of an image, the default ones where it does not say."""
    said = {} if image is None else image.metadata.get("focus", {})
    found = [said.get(f"{axis}_window") for axis in ("range", "azimuth")]
    first, second = (one if isinstance(one, str) and one else DEFAULT_WINDOW for one in found)
    return first, second


def checked_mechanisms(names: Sequence[str]) -> tuple[str, ...]:
    """Names of mechanisms, after a check that there are such."""
    for name in names:
        if name not in MECHANISMS:
            guess = did_you_mean(name, MECHANISMS) or f"; there are {', '.join(MECHANISMS)}"
            raise DataError(f'labels: no mechanism "{name}"{guess}')
    return tuple(names)


def checked_layers(layers: Sequence[str]) -> tuple[str, ...]:
    """Names of layers, after a check that there are such."""
    for name in layers:
        if name not in LAYERS:
            guess = did_you_mean(name, LAYERS) or f"; there are {', '.join(LAYERS)}"
            raise DataError(f'labels: no layer "{name}"{guess}')
    return tuple(layers)
