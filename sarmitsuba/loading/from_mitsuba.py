"""`Scene` from an already loaded ``mi.Scene``, so that ``mi.load_file`` and ``mi.render`` work."""

from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.loading import tables
from sarmitsuba.loading.assemble import MeshSurface
from sarmitsuba.loading.collect import Collector
from sarmitsuba.loading.describe import describe
from sarmitsuba.loading.elements import Element, Property
from sarmitsuba.loading.notes import warn_once
from sarmitsuba.loading.overrides import Overrides
from sarmitsuba.loading.scatterer_shapes import ShapeKind
from sarmitsuba.loading.shapes import Placed
from sarmitsuba.machine.backend import mi
from sarmitsuba.scene.materials.bsdfs import ADAPTER_BSDFS
from sarmitsuba.scene.mesh.model_units import ShapeExtent, y_ground
from sarmitsuba.scene.scatterers import SCATTERERS
from sarmitsuba.scene.scene import Scene

_NAME = "scene"
# classes of Mitsuba's BSDFs whose name is not their plugin's in capitals
_BSDF_CLASSES = {
    "smoothdiffuse": "diffuse",
    "smoothconductor": "conductor",
    "smoothdielectric": "dielectric",
    "smoothplastic": "plastic",
    "twosidedbrdf": "twosided",
    "maskbsdf": "mask",
}
_SHAPES = ("sphere", "disk", "cylinder", "rectangle")


def scene_from_mitsuba(
    mi_scene: "mi.Scene",
    sensor: "int | mi.Sensor | None" = None,
    integrator: "mi.Integrator | None" = None,
    *,
    radar_root: Element | None = None,
    overrides: Overrides | None = None,
    ground: str | None = None,
) -> Scene:
    """Read geometry, materials and radar out of a loaded Mitsuba scene.

    Parameters
    ----------
    mi_scene : of ``mi.load_file`` or ``mi.load_dict``
    sensor : a sensor or its index in the scene; None takes the first ``sar_antenna``
    integrator : None takes the scene's
    radar_root : of a radar file that replaces sensor, film and integrator
    overrides : of plugin parameters
    ground : material of level ground to add

    Raises
    ------
    SceneError, RadarError : as `load_scene`, without file names

    Notes
    -----
    Mitsuba has merged meshes by material and holds vertices in float32, good to 1e-7 of their distance from
    the origin; a file or a dict given to `load_scene` keeps both. Instances give no access to their shape group and are
    refused.
    """
    overrides = overrides or Overrides()
    root = Element("scene", "scene", "", _NAME, Path(), {})
    if radar_root is None:
        root.children.append(("sensor", _sensor(mi_scene, sensor)))
    tracer = integrator if integrator is not None else mi_scene.integrator()
    if hasattr(tracer, "given"):
        root.children.append(("integrator", _own(tracer, tables.INTEGRATOR.plugin, "integrator")))
    collector = Collector(_NAME, None, describe(root, radar_root, overrides, _NAME), overrides)
    bsdfs: dict[int, Element] = {}
    for number, shape in enumerate(mi_scene.shapes()):
        bsdf = shape.bsdf()
        element = bsdfs.setdefault(id(bsdf), _bsdf(bsdf))
        name = shape.id() or f"shape_{number}"
        kind = SCATTERERS[element.plugin] if element.plugin in SCATTERERS else None
        if shape.is_mesh() and isinstance(kind, ShapeKind):
            where = f'{_NAME}: shape "{name}"'
            collector.scatterers += kind.read_mesh(name, *_mesh(shape), element, where, collector.reading)
        elif shape.is_mesh() and element.plugin != tables.POINT_SCATTERER.plugin:
            material = collector.book.index(element, f'{_NAME}: shape "{name}"')
            vertices, faces = _mesh(shape)
            collector.surfaces.append(MeshSurface(name, vertices, faces, material))
        else:
            collector.add_shape(_place_shape(shape, name), element)
    if radar_root is not None and not any(hasattr(own, "given") for own in mi_scene.sensors()):
        surfaces = [surface for surface in collector.surfaces if len(surface.faces)]
        lying = y_ground([ShapeExtent.of(s.vertices[s.faces]) for s in surfaces])
        if lying >= 0:
            warn_once(
                collector.notes,
                f'{_NAME}: is y up? "{surfaces[lying].name}" looks like ground below all else; give the file '
                "to load_scene, which turns it, or turn it by to_world",
            )
    if ground is not None:
        collector.add_ground_of(ground)
    return collector.scene()


def _sensor(mi_scene: "mi.Scene", sensor: "int | mi.Sensor | None") -> Element:
    """Element of the radar and its film."""
    there = mi_scene.sensors()
    if sensor is None:
        sensor = next((i for i, candidate in enumerate(there) if hasattr(candidate, "given")), 0)
    antenna = there[sensor] if isinstance(sensor, int) and sensor < len(there) else sensor
    if isinstance(antenna, int) or not hasattr(antenna, "given"):
        found = type(antenna).__name__ if not isinstance(antenna, int) else "none"
        raise RadarError(f"{_NAME}: the sensor is not a sar_antenna ({found}); add one, pass it to mi.render")
    element = _own(antenna, tables.SENSOR.plugin, "sensor")
    film = antenna.film()
    if hasattr(film, "given"):
        element.children.append(("film", _own(film, tables.FILM.plugin, "film")))
    return element


def _own(plugin: "mi.Object", name: str, kind: str) -> Element:
    """Element of an object of one of this package's plugins."""
    label = f'{kind} "{plugin.id()}"' if plugin.id() else f"{kind} {name}"
    return Element(kind, name, plugin.id(), f"{_NAME}: {label}", Path(), dict(plugin.given))


def _bsdf(bsdf: "mi.BSDF | None") -> Element:
    """Element of a BSDF: ours, Sionna RT's or Mitsuba's."""
    if bsdf is None:
        return Element("bsdf", "diffuse", "", _NAME, Path(), {})
    name = bsdf.id()
    if hasattr(bsdf, "given"):
        element = _own(bsdf, bsdf.table.plugin, "bsdf")
        if bsdf.maps:
            raise SceneError(
                f"{element.where}: its {', '.join(bsdf.maps)} cannot be read from a loaded scene; load the file with "
                "sarmitsuba.load_scene"
            )
        element.children.extend(("_arg_0", _bsdf(inner)) for inner in bsdf.nested)
        return element
    where = f'{_NAME}: bsdf "{name}"'
    if hasattr(bsdf, "scattering_coefficient"):
        values: dict[str, Property] = {"xpd_coefficient": _scalar(bsdf.xpd_coefficient)}
        scattering = _scalar(bsdf.scattering_coefficient)
        if scattering > 0.0:  # Sionna's default of 0 stands for "not given"
            values["scattering_coefficient"] = scattering
            values |= _pattern(bsdf.scattering_pattern)
        if hasattr(bsdf, "itu_type"):
            return Element(
                "bsdf", "itu-radio-material", name, where, Path(), {**values, "type": str(bsdf.itu_type)}
            )
        values["relative_permittivity"] = _scalar(bsdf.relative_permittivity)
        values["conductivity"] = _scalar(bsdf.conductivity)
        return Element("bsdf", "radio-material", name, where, Path(), values)
    plugin = _plugin(bsdf.class_name())
    switches: dict[str, Property] = {}
    element = Element("bsdf", plugin, name, where, Path(), switches)
    if plugin in ADAPTER_BSDFS:
        numbers = mi.traverse(bsdf)
        for key in ("opacity", "weight"):  # only where it is a number, not a texture
            if f"{key}.value" in numbers:
                switches[key] = _scalar(numbers[f"{key}.value"])
        element.children.extend(("_arg_0", _bsdf(inner)) for inner in _list_nested(bsdf))
    return element


def _pattern(pattern: object) -> dict[str, Property]:
    """Parameters of one of Sionna's scattering patterns."""
    numbers = {
        name: getattr(pattern, name) for name in ("alpha_r", "alpha_i", "lambda_") if hasattr(pattern, name)
    }
    if "lambda_" in numbers:
        numbers["lambda_"] = _scalar(numbers["lambda_"])
    return {"scattering_pattern": type(pattern).__name__.removesuffix("Pattern").lower(), **numbers}


def _list_nested(bsdf: "mi.BSDF") -> "list[mi.BSDF]":
    """BSDF objects nested inside another one, in order; only a traversal gives access to them."""
    found = []

    class Callback(mi.TraversalCallback):
        def put(self, name: str, value: object, *rest: object) -> None:
            if isinstance(value, mi.BSDF):
                found.append(value)

    bsdf.traverse(Callback())
    return found


def _plugin(class_name: str) -> str:
    lower = class_name.lower()
    return class_name if class_name in tables.plugin_tables() else _BSDF_CLASSES.get(lower, lower)


def _scalar(value: "mi.Float") -> float:
    return float(np.asarray(value).ravel()[0])


def _mesh(shape: "mi.Shape") -> tuple[F64, I32]:
    vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
    faces = np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3).astype(np.int32)
    return vertices, faces


def _place_shape(shape: "mi.Shape", name: str) -> Placed:
    """Shape without triangles (sphere, cylinder ...); its matrix maps the unit shape to the world."""
    plugin = shape.class_name().lower()
    where = f'{_NAME}: shape "{name}"'
    if plugin not in _SHAPES:
        raise SceneError(
            f"{where}: a {plugin} cannot be read from a loaded scene; load the file with "
            "sarmitsuba.load_scene"
        )
    parameters = mi.traverse(shape)
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4, -1)[:, :, 0]
    return Placed(Element("shape", plugin, name, where, Path(), {}), name, matrix)
