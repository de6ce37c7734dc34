"""Load a scene from any source as one frozen, validated `Scene`."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import ExtensionError, SceneError
from sarmitsuba.loading.collect import Collector
from sarmitsuba.loading.describe import describe
from sarmitsuba.loading.elements import Element, walk
from sarmitsuba.loading.from_mesh import (
    MeshOptions,
    add_mesh_file,
    describe_frame,
    find_frame,
    has_radar,
    is_mesh_file,
)
from sarmitsuba.loading.from_mitsuba import scene_from_mitsuba
from sarmitsuba.loading.library import resolve, resolve_radar
from sarmitsuba.loading.notes import warn_once
from sarmitsuba.loading.overrides import check_used, split_parameters
from sarmitsuba.loading.plugins import register_plugins
from sarmitsuba.loading.references import check_meshes
from sarmitsuba.loading.shapes import SHAPE_PARAMETERS, placed_shapes
from sarmitsuba.loading.tables import TABLES, plugin_tables
from sarmitsuba.loading.xml import check_dict, parse_dict, parse_file, read_text
from sarmitsuba.machine.backend import mi
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.materials.bsdfs import ADAPTER_BSDFS, ORDINARY_BSDFS
from sarmitsuba.scene.scatterers import SCATTERERS
from sarmitsuba.scene.scene import Scene

_DICT = "dict"


# elements of scene files, and parameters of every shape
_ELEMENTS = (
    *("scene", "sensor", "film", "integrator", "shape", "bsdf", "texture", "emitter", "medium", "transform"),
    *(
        "ref",
        "default",
        "include",
        "alias",
        "path",
        "float",
        "integer",
        "boolean",
        "string",
        "vector",
        "to_world",
    ),
)
# names that kinds of scatterers cannot have
_TAKEN = frozenset({*TABLES, *ORDINARY_BSDFS, *ADAPTER_BSDFS, *SHAPE_PARAMETERS, *_ELEMENTS})


@exclusive
def load_scene(
    scene: "Path | str | Mapping[str, object] | mi.Scene",
    *,
    radar: Path | str | None = None,
    parameters: Mapping[str, str] | None = None,
    mesh: MeshOptions | None = None,
    ground: str | None = None,
    allow_outside: bool = False,
) -> Scene:
    """Load a scene file, a shipped scene, a dict as for ``mi.load_dict``, or a scene that Mitsuba has loaded.

    Parameters
    ----------
    scene : XML file, mesh file (glTF, obj, ply, stl, off; needs a ``radar``), a name such as ``dihedral``, a dict, or
        an ``mi.Scene``
    radar : XML file (or shipped name) whose sensor, film and integrator replace the scene's
    parameters : values of the file's ``$name`` parameters, and ``plugin.parameter`` to override a plugin's
    mesh : unit, up axis and materials of a mesh file; unit and up axis of the shapes of a scene file
    ground : material of level ground to add at the scene's lowest level, such as ``soil``, as by ``radar_ground``
    allow_outside : a file may include others, and name meshes, from outside its own folder

    Returns
    -------
    the scene; its frame is shifted by ``Scene.offset`` when the geometry lies far from the file's origin

    Raises
    ------
    SceneError, RadarError : one line: file, element, value with unit, bound, remedy

    Warns
    -----
    SarmitsubaWarning : ambiguities; and once for every kind of BSDF that has no radar parameters

    Notes
    -----
    Files and dicts keep positions in float64. An ``mi.Scene``, and a dict that holds objects made by Mitsuba, has
    vertices in float32, good to 1e-7 of their distance from the origin, and meshes merged by material.
    """
    known = plugin_tables()
    for name in SCATTERERS.names:
        if name in _TAKEN:
            raise ExtensionError(
                f"kind of scatterer {name!r}: that is a name of the scene format or a plugin of Mitsuba; take another"
            )
    plain, overrides = split_parameters(parameters or {}, known)
    file = resolve(scene) if isinstance(scene, Path | str) else None
    scene = check_dict(scene, _DICT) if isinstance(scene, Mapping) else scene
    radar_file = None if radar is None else resolve_radar(radar)
    radar_root = None if radar_file is None else parse_file(radar_file, plain, allow_outside=allow_outside)
    loaded, root = None, None
    from_mesh = file is not None and is_mesh_file(file)
    if mesh is not None and not from_mesh:
        _check_options(mesh, scene, "scene" if file is None else file.name)
    if file is not None and from_mesh:
        root = Element("scene", "scene", "", file.name, file.parent, {})
    elif file is not None:
        root = parse_file(file, plain, allow_outside=allow_outside)
    elif not _holds_objects(scene) and isinstance(scene, dict):
        root = parse_dict(scene, _DICT)
    else:
        loaded = _load_once(scene)
    elements = [e for tree in (root, radar_root) if tree is not None for e in walk(tree)]
    label = file.name if file is not None else _DICT if root is not None else "scene"
    texts = [read_text(path) for path in (file, radar_file) if path is not None and not is_mesh_file(path)]
    check_used(plain, overrides, label, texts, {e.id: e.plugin for e in elements if e.id}, known)
    if root is None:
        return scene_from_mitsuba(loaded, radar_root=radar_root, overrides=overrides, ground=ground)

    if file is not None and not allow_outside:
        check_meshes(walk(root))
    described = describe(root, radar_root, overrides, label)
    collector = Collector("scene" if file is None else file.stem, file, described, overrides)
    if file is not None and from_mesh:
        add_mesh_file(collector, file, mesh or MeshOptions())
    else:
        _add_shapes(collector, root, label, mesh)
    collector.add_ground_of(ground, hint=from_mesh)
    return collector.scene()


def _check_options(mesh: MeshOptions, scene: object, label: str) -> None:
    """Raise a SceneError for options that a scene file, a dict or an ``mi.Scene`` cannot have."""
    if mesh.materials:
        raise SceneError(
            f"{label}: materials by name are given to mesh files only; name the bsdfs so, or use radar_material"
        )
    if not isinstance(scene, Path | str | Mapping) or _holds_objects(scene):
        raise SceneError(
            f"{label}: unit and up axis are given to files and dicts, not to what Mitsuba has loaded"
        )


def _add_shapes(collector: Collector, root: Element, label: str, mesh: MeshOptions | None) -> None:
    """Add every shape of a scene in metres with z up, and note assumptions for files without a radar."""
    shapes, options = list(placed_shapes(root)), mesh or MeshOptions()
    frame = find_frame(label, root, shapes, collector.reader, options)
    if frame.doubt:
        warn_once(collector.notes, frame.doubt)
    as_it_is = np.array_equal(frame.matrix, np.eye(4))
    for placed in shapes:
        collector.add_shape(
            placed if as_it_is else placed.in_frame(frame.matrix), placed.element.child("bsdf")
        )
    if collector.surfaces and (mesh is not None or not has_radar(root)):
        note, doubt = describe_frame(label, frame, collector.surfaces, options)
        collector.notes.append(note)
        if doubt:
            warn_once(collector.notes, doubt)


def _holds_objects(value: object) -> bool:
    """True when a dict holds objects that Mitsuba has made."""
    if isinstance(value, Mapping):
        return any([_holds_objects(item) for item in value.values()])
    if not isinstance(value, mi.Object):
        return False
    made = value.variant_name()  # empty for objects that are the same in all variants
    if made not in ("", mi.variant()):
        raise SceneError(
            f"{type(value).__name__}: made by Mitsuba under the variant {made}, not {mi.variant()}; create it again "
            "after sarmitsuba.register_plugins()"
        )
    return True


def _load_once(scene: object) -> "mi.Scene":
    register_plugins()

    if isinstance(scene, dict):
        try:
            scene = mi.load_dict(scene)
        except RuntimeError as error:
            raise SceneError(f"{_DICT}: {' '.join(str(error).split())}") from None
    if not isinstance(scene, mi.Scene):
        raise SceneError(
            f"{type(scene).__name__}: not a scene; give a file, a shipped name, a dict or an mi.Scene"
        )
    return scene
