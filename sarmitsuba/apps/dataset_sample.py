"""One sample of a data set, simulated and labelled; the same bits wherever and whenever it is made.

Labels are layers of the pixels, with codes that all samples share, and boxes of the shapes.
"""

import re
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.analysis.echo_labels import NO_CLASS
from sarmitsuba.analysis.label_classes import classes_of_shapes, shape_names
from sarmitsuba.analysis.labels import checked_layers, checked_mechanisms, labels
from sarmitsuba.apps.dataset_draw import Drawer, DrawnSample, PlacedShape, aspect_deg
from sarmitsuba.apps.dataset_recipe import RecipeError
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import (
    BackendError,
    DataError,
    ExtensionError,
    OutputError,
    RadarError,
    SarmitsubaError,
    SarmitsubaWarning,
)
from sarmitsuba.core.parameters import Value
from sarmitsuba.core.units import db_from_power
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.machine.exclusive import single_threaded
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.pixel_labels import LabelLayer, LabelledInstance
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.signal.threads import one_blas_thread
from sarmitsuba.simulation.execution.error_bars import estimate_pass_error
from sarmitsuba.simulation.execution.render import RenderOptions, execute

# layers of codes of shapes, for masks of instances; the first that there is
SHAPES = ("shape", "instance")
# layers whose codes are shapes: names belong to the sample, not to the data set
OF_SHAPES = (*SHAPES, "shadow_of", "second_instance")
# number that the loader adds to the second material of a name
_NUMBERED = re.compile(r"_\d+$")


@dataclass(frozen=True, eq=False)
class SampleLabels:
    """Labels of a sample.

    Parameters
    ----------
    layers : by name; codes of classes and materials are those of the data set
    shapes : code, name and class ("" without one) of the shapes in the layers :data:`OF_SHAPES`
    instances : by name
    """

    layers: Mapping[str, LabelLayer] = field(default_factory=dict)
    shapes: tuple[tuple[int, str, str], ...] = ()
    instances: Mapping[str, LabelledInstance] = field(default_factory=dict)


def sample_labels(
    drawer: Drawer, scene: Scene, grid: ImageGrid, shapes: Sequence[PlacedShape]
) -> SampleLabels:
    """Labels of a drawn scene, as its recipe asks for.

    Raises
    ------
    RecipeError
        There is no such layer.
    """
    names = drawer.recipe.layers
    if not names:
        return SampleLabels()
    try:
        checked_layers(names)
        mechanisms = checked_mechanisms(drawer.recipe.mechanisms) or None
    except DataError as error:
        raise RecipeError(f"[labels]: {error}") from None
    present = shape_names(scene)
    classes = classes_of_shapes(present, drawer.recipe.class_table)
    classes |= {shape.name: shape.semantic_class for shape in shapes if shape.name in present}
    found = labels(scene, grid, classes=classes, layers=names, mechanisms=mechanisms)
    shared = {"class": (*drawer.classes, NO_CLASS), "material": drawer.materials}
    layers = {
        name: _recode_layer(found.layers[name], shared[name]) if name in shared else found.layers[name]
        for name in names
    }
    codes: dict[int, str] = {}
    for name in OF_SHAPES:
        if name in layers:
            codes |= {code: shape for code, shape in layers[name].codes.items() if code}
            layers[name] = replace(layers[name], values=layers[name].values.astype(np.int32))
    return SampleLabels(
        layers,
        tuple((code, name, classes.get(name, "")) for code, name in sorted(codes.items())),
        {one.name: one for one in found.instances},
    )


def _recode_layer(layer: LabelLayer, names: Sequence[str]) -> LabelLayer:
    """A layer of codes with those of names of the data set, from 1; 0 stays.

    Raises
    ------
    DataError
        The layer has another name.
    """
    number = {name: i for i, name in enumerate(names, 1)}
    kind = np.uint8 if len(names) < 255 else np.int32
    table = np.zeros(max(layer.codes, default=0) + 1, dtype=kind)
    for code, name in layer.codes.items():
        own = name if name in number else _NUMBERED.sub("", name)
        if code and own not in number:
            if np.any(layer.values == code):
                raise DataError(f'labels: "{name}" is not one of {", ".join(names)}')
            continue
        if code:
            table[code] = number[own]
    codes = {0: layer.codes.get(0, "none"), **{i: name for name, i in number.items()}}
    return replace(layer, values=table[layer.values], codes=codes)


def corner_boxes(scene: Scene, grid: ImageGrid, shapes: Sequence[PlacedShape]) -> F64:
    """Bounds (n, 4) of every shape's vertices in the image: first row and column, last row and column, in pixels.

    Fractions of pixels from the centre of the first; they may lie outside the image. Hidden vertices count, echoes of
    several bounces do not; NaN where the image has no place for a vertex.
    """
    own = grid.in_frame(scene.offset)
    placement = ImagePlacement(own, scene.radar)
    out = np.full((len(shapes), 4), np.nan)
    for row, shape in zip(out, shapes, strict=True):
        azimuth, across = placement.locate(shape.vertices - scene.offset)
        if np.isfinite(azimuth).all():
            rows = (azimuth - own.azimuth[0]) / own.azimuth_spacing
            columns = (across - own.range[0]) / own.range_spacing
            row[:] = rows.min(), columns.min(), rows.max(), columns.max()
    return out


# errors of the machine or the recipe, which another draw would not cure
_FATAL = (RecipeError, BackendError, ExtensionError, OutputError)
# the mean of two passes has half the error energy of one of them, dB
_OF_ONE_DB = db_from_power(2.0)


@dataclass(frozen=True, eq=False)
class SampleObject:
    """One shape of a sample.

    Parameters
    ----------
    name, semantic_class, instance : as drawn; the instance is "" without a mesh of the folder
    code : in the layer ``shape``, or else ``instance``; 0 without such a layer
    position : (3,) m, middle of its bounds
    heading_deg : of its x axis, from east to north
    aspect_deg : of the radar from its x axis
    scale : factor of its lengths
    box : (4,) first row and column, last row and column of its vertices, pixels
    visible_share : share of its surface that the antenna sees, by area; NaN without a layer of echoes
    energy_share : share of the energy of one look's image that is its echoes; NaN without a layer of echoes
    """

    name: str
    semantic_class: str
    instance: str
    code: int
    position: F64
    heading_deg: float
    aspect_deg: float
    scale: float
    box: F64
    visible_share: float
    energy_share: float


@dataclass(frozen=True, eq=False)
class Sample:
    """A finished sample.

    Parameters
    ----------
    number, part : of the sample
    attempt : draw that succeeded, from 0
    failures : reasons of those before
    image : (channels, rows, columns) complex64, square root of RCS, m
    channels : of the image
    layers : labels by name, (rows, columns) or with parts
    layer_facts : unit, description, parts and codes of each layer
    named_shapes : code, name and class of the shapes in layers whose codes are shapes
    objects : shapes
    facts : drawn values by ``section.parameter``, and of the image
    notes : assumptions and warnings of the program
    physics : effects and their state
    sampling_error_db : of the image, by channel; empty where not measured
    omitted_db : energy of waves that metal sends and the program does not follow, over the image's energy, by channel
    raw : echoes, where asked for
    seconds : of processor time
    """

    number: int
    part: str
    attempt: int
    failures: tuple[str, ...]
    image: C64
    channels: tuple[str, ...]
    layers: Mapping[str, NDArray[np.generic]]
    layer_facts: Mapping[str, Mapping[str, object]]
    named_shapes: tuple[tuple[int, str, str], ...]
    objects: tuple[SampleObject, ...]
    facts: Mapping[str, Value | None]
    notes: tuple[str, ...]
    physics: Mapping[str, object]
    sampling_error_db: Mapping[str, float]
    omitted_db: Mapping[str, float]
    raw: RawData | None
    seconds: float


def make_sample(drawer: Drawer, number: int) -> Sample:
    """Sample of a number; draws that fail are replaced.

    Raises
    ------
    DataError
        All attempts failed, or the recipe asks for something that does not exist.
    BackendError, OutputError, ExtensionError
        Not caused by the draw.

    Notes
    -----
    A draw that does not fit into the memory that is free is replaced, too: its reason names the machine's memory, and
    a machine with more of it keeps that draw.
    """
    ensure_backend()
    failures: list[str] = []
    begin = time.process_time()
    with single_threaded(), one_blas_thread():
        for attempt in range(drawer.recipe.whole("dataset", "attempts")):
            try:
                sample = _attempt_sample(drawer, number, attempt)
            except _FATAL:
                raise
            except MemoryError:  # a check that was too low; what it held is free again
                failures.append("the draw did not fit into the memory of the machine")
                continue
            except SarmitsubaError as error:
                failures.append(str(error))
                continue
            seconds = time.process_time() - begin
            return replace(sample, failures=tuple(failures), seconds=seconds)
    raise DataError(
        f"{drawer.recipe.path.name}: sample {number}: {len(failures)} draws failed, the last with: {failures[-1]}"
    )


def _attempt_sample(drawer: Drawer, number: int, attempt: int) -> Sample:
    recipe = drawer.recipe
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", SarmitsubaWarning)
        drawn = drawer.draw(number, attempt)
        image, raw = _image(drawn, 0)
        if image.grid.shape != recipe.shape:
            raise RadarError(f"the image has {image.grid.shape} pixels, not {recipe.shape}")
        error = _sampling_error(recipe.whole("dataset", "error_every"), drawn, image)
        labels = sample_labels(drawer, drawn.scene, image.grid, drawn.shapes)
    said = [str(w.message) for w in caught if issubclass(w.category, SarmitsubaWarning)]
    if not np.isfinite(image.data).all() or not np.any(image.data):
        raise RadarError("the image is empty or holds numbers that are not finite")
    notes = dict.fromkeys([*said, *(str(note) for note in image.metadata.get("notes", []))])
    planes = [image.total(name) for name in image.channels]
    return Sample(
        number=number,
        part=drawn.part,
        attempt=attempt,
        failures=(),
        image=np.stack(planes).astype(np.complex64),
        channels=image.channels,
        layers={name: layer.values for name, layer in labels.layers.items()},
        layer_facts=_layer_facts(labels),
        named_shapes=labels.shapes,
        objects=_objects(drawn, image, labels),
        facts={**drawn.facts, **_facts_of(image)},
        notes=tuple(notes),
        physics=dict(image.metadata.get("effects", {})),
        sampling_error_db=error,
        omitted_db=_sum_omitted_energy(image),
        raw=raw if recipe.flag("output", "raw") else None,
        seconds=0.0,
    )


def _image(drawn: DrawnSample, pass_index: int) -> tuple[SarImage, RawData | None]:
    """Image of a drawn scene, and the echoes that it was focused from."""
    scene, how = drawn.scene, drawn.focusing
    if scene.settings.one_look and how["autofocus"] != "none":
        raise RecipeError(
            f"[focusing]: autofocus = {how['autofocus']} needs echoes, and method {scene.settings.method} makes none"
        )
    options = RenderOptions(
        focuser=how["focuser"],
        range_window=how["window"],
        azimuth_window=how["window"],
        autofocus=how["autofocus"],
        pass_index=pass_index,
    )
    done = execute(scene, options)
    assert done.image is not None
    return done.image, done.raw


def _sampling_error(every: int, drawn: DrawnSample, image: SarImage) -> dict[str, float]:
    """Error by ray sampling of an image, dB of its energy, from a second one with other rays."""
    if not every or drawn.number % every or drawn.scene.settings.method == "raster":
        return {}
    other, _ = _image(drawn, 1)
    first, second = (np.stack([one.total(name) for name in image.channels]) for one in (image, other))
    bars = estimate_pass_error(second - first, 0.5 * (first + second), image.channels, 0.5)
    return {name: value + _OF_ONE_DB for name, value in zip(bars.channels, bars.error_db, strict=True)}


def _sum_omitted_energy(image: SarImage) -> dict[str, float]:
    """Energy of waves left out over that of the image, dB; both in resolution cells times m^2."""
    energy = dict(image.metadata.get("theory", {})).get("energy_m2", {})
    grid = image.grid
    slant = float(np.sin(image.incidence_angle[grid.shape[1] // 2])) if grid.kind == "ground" else 1.0
    cell = image.azimuth_resolution_cell * image.range_resolution_cell
    pixel = grid.azimuth_spacing * grid.range_spacing * slant / cell
    out = {}
    for name, left_out in energy.items():
        power = np.abs(image.total(name).astype(np.complex128)) ** 2
        out[name] = db_from_power(max(left_out, 1e-60) / max(float(power.sum()) * pixel, 1e-60))
    return out


def _facts_of(image: SarImage) -> dict[str, Value | None]:
    grid = image.grid
    return {
        "image.azimuth_spacing": grid.azimuth_spacing,
        "image.range_spacing": grid.range_spacing,
        "image.azimuth_resolution_cell": image.azimuth_resolution_cell,
        "image.range_resolution_cell": image.range_resolution_cell,
        "image.incidence_angle_deg": float(np.rad2deg(image.incidence_angle[grid.shape[1] // 2])),
        "image.wavelength": image.wavelength,
    }


def _layer_facts(labels: SampleLabels) -> dict[str, dict[str, object]]:
    """Unit, description, parts and codes of each layer; without codes where they are the sample's shapes."""
    return {
        name: {
            "unit": layer.unit,
            "description": layer.description,
            "parts": layer.parts,
            "codes": [] if name in OF_SHAPES else sorted(layer.codes.items()),
        }
        for name, layer in labels.layers.items()
    }


def _objects(drawn: DrawnSample, image: SarImage, labels: SampleLabels) -> tuple[SampleObject, ...]:
    boxes = corner_boxes(drawn.scene, image.grid, drawn.shapes)
    code = {name: number for number, name, _ in labels.shapes}
    seen = {name: (one.visible_share, one.energy_share) for name, one in labels.instances.items()}
    return tuple(
        SampleObject(
            name=shape.name,
            semantic_class=shape.semantic_class,
            instance=shape.instance,
            code=code.get(shape.name, 0),
            position=0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)),
            heading_deg=float(np.rad2deg(shape.heading)),
            aspect_deg=aspect_deg(shape, drawn.scene),
            scale=shape.scale,
            box=box,
            visible_share=seen.get(shape.name, (np.nan, np.nan))[0],
            energy_share=seen.get(shape.name, (np.nan, np.nan))[1],
        )
        for shape, box in zip(drawn.shapes, boxes, strict=True)
    )
