"""Load a scene: Mitsuba XML in, one frozen, validated `Scene` out."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.errors import RadarError, SceneError
from sarmitsuba.loader import tables
from sarmitsuba.loader.assemble import Surface, assemble, trace_settings, warn_once
from sarmitsuba.loader.library import resolve, resolve_radar
from sarmitsuba.loader.parameters import did_you_mean
from sarmitsuba.loader.properties import Element, Overrides, check_used, parse_scene, split_parameters, walk
from sarmitsuba.loader.radar_builder import RadarInput
from sarmitsuba.loader.shapes import MeshReader, placed_shapes, sphere_center
from sarmitsuba.materials.bsdfs import (
    ADAPTER_BSDFS,
    adapter_note,
    named_material,
    ordinary_material,
    radar_material,
    rough,
    sionna_itu_name,
    sionna_material,
)
from sarmitsuba.materials.diffuse import diffuse_tables
from sarmitsuba.materials.material import Material
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene

# facets of curved shapes: at 1/32 they act as a grating whose lobes move a sphere's return by up to 1 dB with
# the direction, a cylinder's by as much; at 1/512 by 0.1 dB
SAGITTA_OVER_WAVELENGTH = 1.0 / 512.0
_SIONNA = ("itu-radio-material", "radio-material", "absorber-radio-material")


def load_scene(
    path: Path | str, *, radar: Path | str | None = None, parameters: Mapping[str, str] | None = None
) -> Scene:
    """Load a scene file, or a shipped scene by its bare name.

    Parameters
    ----------
    path : XML file, or a name such as ``dihedral``
    radar : XML file (or shipped name) whose sensor, film and integrator replace the scene's
    parameters : values of the file's ``$name`` parameters, and ``plugin.parameter`` to override a plugin's

    Returns
    -------
    the scene, in a frame of its own when the geometry lies far from the file's origin (``Scene.offset``)

    Raises
    ------
    SceneError, RadarError : one line: file, element, value with unit, bound, remedy

    Warns
    -----
    SarmitsubaWarning : once for every kind of BSDF that has no radar parameters, and about ambiguities
    """
    file = resolve(path)
    radar_file = None if radar is None else resolve_radar(radar)
    plain, overrides = split_parameters(parameters or {}, tables.TABLES)
    root = parse_scene(file, plain)
    radar_root = None if radar_file is None else parse_scene(radar_file, plain)
    elements = [*walk(root), *(walk(radar_root) if radar_root else ())]
    files = [file] if radar_file is None else [file, radar_file]
    check_used(plain, overrides, files, {e.id for e in elements if e.id}, set(tables.TABLES))

    sensor, film = _sensor(root, file, radar_root, radar_file)
    described = radar_input(sensor, film, overrides)
    integrator = _integrator(root, radar_root)
    settings = trace_settings(overrides.read(integrator, tables.INTEGRATOR)[0], described.film)

    frequency = float(described.sensor["center_frequency"])
    notes: list[str] = []
    book = MaterialBook(frequency, overrides, notes, settings.default_rms_height)
    reader = MeshReader(SAGITTA_OVER_WAVELENGTH * SPEED_OF_LIGHT / frequency, notes)
    surfaces, points = [], []
    for placed in placed_shapes(root):
        bsdf = placed.element.child("bsdf")
        if bsdf is not None and bsdf.plugin == tables.POINT_SCATTERER.plugin:
            points.append(point_target(placed.element, placed.name, placed.to_world, bsdf, overrides))
            continue
        material = book.index(bsdf, placed.element.where)
        surfaces.append(
            Surface(placed.name, *reader.triangles(placed), material, placed.is_curved, placed.is_convex)
        )
    return assemble(file.stem, file, surfaces, book.materials, points, described, settings, notes)


@dataclass
class MaterialBook:
    """Materials of a scene, one for every BSDF element.

    Parameters
    ----------
    frequency : Hz, that permittivities are taken at
    overrides : from the command line
    notes : filled with one line for every assumption
    rms_height : m, of materials that state no roughness
    """

    frequency: float
    overrides: Overrides
    notes: list[str]
    rms_height: float
    materials: list[Material] = field(default_factory=list)
    _index: dict[int, int] = field(default_factory=dict)

    def index(self, bsdf: Element | None, where: str) -> int:
        """Index of the material of a BSDF element; None is Mitsuba's default, ``diffuse``."""
        key = id(bsdf)
        if key not in self._index:
            if bsdf is None:
                file = where.partition(":")[0]
                bsdf = Element("bsdf", "diffuse", "", f"{file}: default bsdf", Path(), {})
            material = self._material(bsdf, bsdf.id or f"{bsdf.plugin}_{len(self.materials) + 1}", 0)
            self._check_law(material, where.partition(":")[0])
            self._index[key] = len(self.materials)
            self.materials.append(material)
        return self._index[key]

    def _check_law(self, material: Material, file: str) -> None:
        """Say when a diffuse law is used outside its domain of validity."""
        try:
            table = diffuse_tables(material, SPEED_OF_LIGHT / self.frequency)
        except SceneError as error:
            raise SceneError(f"{file}: {error}") from None
        for note in table.notes:
            warn_once(self.notes, f"{file}: {note}")

    def _material(self, bsdf: Element, name: str, depth: int) -> Material:
        plugin, where = bsdf.plugin, bsdf.where
        if depth > 16:
            raise SceneError(f"{where}: BSDFs are nested more than 16 deep; flatten them")
        itu = sionna_itu_name(bsdf.id) if plugin not in tables.TABLES else ""
        if itu:
            material, note = named_material(name, itu, self.frequency, **rough(self.rms_height))
        elif plugin == tables.RADAR_MATERIAL.plugin:
            values, given = self.overrides.read(bsdf, tables.RADAR_MATERIAL)
            material, note = radar_material(name, values, given, self.frequency, where)
        elif plugin in _SIONNA:
            values, given = self.overrides.read(bsdf, tables.TABLES[plugin])
            if plugin == "itu-radio-material" and "type" not in given:
                raise SceneError(
                    f'{where}: no ITU material named; give <string name="type" value="concrete"/>'
                )
            material, note = sionna_material(name, plugin, values, given, self.frequency, self.rms_height)
        elif plugin == tables.POINT_SCATTERER.plugin:
            raise SceneError(f"{where}: point_scatterer cannot be nested; put it directly on a sphere")
        elif plugin in ADAPTER_BSDFS or plugin == tables.HOLDER.plugin:
            return self._nested(bsdf, name, depth)
        elif plugin in tables.TABLES:
            raise SceneError(f"{where}: {plugin} is no BSDF{did_you_mean(plugin, tables.TABLES)}")
        else:
            material, note = ordinary_material(name, plugin, bsdf.given(), self.frequency, self.rms_height)
        if note:
            warn_once(self.notes, f"{where.partition(':')[0]}: {note}")
        return material

    def _nested(self, bsdf: Element, name: str, depth: int) -> Material:
        if bsdf.plugin in ADAPTER_BSDFS:
            warn_once(self.notes, f"{bsdf.where.partition(':')[0]}: {adapter_note(bsdf.plugin)}")
        inner = list(bsdf.of_kind("bsdf"))
        if not inner:
            raise SceneError(f"{bsdf.where}: {bsdf.plugin} holds no BSDF; nest one in it")
        pick = inner[0]
        if bsdf.plugin == "mask":
            opacity = bsdf.given().get("opacity", 0.5)
            if isinstance(opacity, int | float) and opacity < 0.5:
                return Material(name, invisible=True)
        if bsdf.plugin == "blendbsdf" and len(inner) > 1:
            weight = bsdf.given().get("weight", 0.0)
            if isinstance(weight, int | float) and weight >= 0.5:
                pick = inner[1]
        return self._material(pick, name, depth + 1)


def _sensor(
    root: Element, file: Path, radar_root: Element | None, radar_file: Path | None
) -> tuple[Element, Element | None]:
    """Sensor and film: the radar file's where it has them, else the scene's."""
    if radar_root is not None and radar_file is not None:
        for shape in radar_root.of_kind("shape"):
            raise SceneError(
                f"{shape.where}: a radar file holds sensor, film and integrator only; move the shape to the "
                "scene"
            )
    found = [_pick_sensor(tree) for tree in (radar_root, root) if tree is not None]
    sensor = next((s for s in found if s is not None), None)
    if sensor is None:
        others = [e.plugin for e in root.of_kind("sensor")]
        has = f"only {', '.join(others)}" if others else "none"
        raise RadarError(
            f"{file.name}: no sar_antenna sensor ({has}); add one, or lay a radar over the scene with "
            "--radar RADAR.xml"
        )
    film = sensor.child("film")
    if radar_root is not None:
        film = radar_root.child("film") or film
    if film is not None and film.plugin != tables.FILM.plugin:
        raise RadarError(f'{film.where}: film type "{film.plugin}" cannot record echoes; use range_film')
    return sensor, film


def _pick_sensor(root: Element) -> Element | None:
    return next((s for s in root.of_kind("sensor") if s.plugin == tables.SENSOR.plugin), None)


def radar_input(sensor: Element, film: Element | None, overrides: Overrides) -> RadarInput:
    """Validate the parameters of a sensor and its film (None: all defaults)."""
    nested = tuple(name for name, child in sensor.children if child.kind in ("film", "sampler", "medium"))
    values, given = overrides.read(sensor, tables.SENSOR, skip=nested)
    if film is None:
        file = sensor.where.partition(":")[0]
        film = Element("film", tables.FILM.plugin, "", f"{file}: film range_film", sensor.folder, {})
    filters = tuple(name for name, child in film.children if child.kind == "reconstructionfilter")
    film_values, film_given = overrides.read(film, tables.FILM, skip=filters)
    return RadarInput(values, film_values, given, film_given, sensor.where, film.where, sensor.folder)


def _integrator(root: Element, radar_root: Element | None) -> Element:
    """The ``sar_path`` element, or one with all defaults (integrators for images of light are ignored)."""
    for tree in (radar_root, root):
        for element in tree.of_kind("integrator") if tree is not None else ():
            if element.plugin == tables.INTEGRATOR.plugin:
                return element
    return Element("integrator", tables.INTEGRATOR.plugin, "", "integrator sar_path", root.folder, {})


def point_target(
    shape: Element, name: str, to_world: NDArray[np.float64], bsdf: Element, overrides: Overrides
) -> PointTarget:
    """Ideal scatterer at the centre of a sphere element."""
    values, _ = overrides.read(bsdf, tables.POINT_SCATTERER)
    if shape.plugin != "sphere":
        raise SceneError(f"{shape.where}: point_scatterer is on a {shape.plugin}; put it on a sphere")
    position = to_world[:3, :3] @ sphere_center(shape) + to_world[:3, 3]
    return PointTarget(name, position, 10.0 ** (values["rcs_dbsm"] / 10.0), math.radians(values["phase_deg"]))


__all__ = ["MaterialBook", "load_scene", "point_target", "radar_input"]
