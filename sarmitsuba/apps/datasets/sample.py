"""One sample of a data set: drawn, simulated, labelled; the same bits wherever and whenever it is made."""

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.datasets.draw import Drawer, DrawnSample, aspect_deg
from sarmitsuba.apps.datasets.recipe import RecipeError
from sarmitsuba.apps.datasets.sample_labels import OF_SHAPES, SampleLabels, corner_boxes, sample_labels
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
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw.raw_data import RawData
from sarmitsuba.signal.raw.threads import one_blas_thread
from sarmitsuba.simulation.execution.error_bars import estimate_pass_error
from sarmitsuba.simulation.execution.render import RenderOptions, execute

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
    notes : what the program assumed or warned of
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
        All attempts failed, or the recipe asks for what there is not.
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
