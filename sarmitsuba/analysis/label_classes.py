"""Semantic classes of shapes by a table of their names."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.files.table_file import read_table
from sarmitsuba.scene.scene import Scene

_MOST_BYTES = 10_000_000
# objects named where none fits
_NAMED = 8


def shape_names(scene: Scene) -> tuple[str, ...]:
    """Names of all shapes of a scene: objects of meshes, points, scatterers."""
    beside = (scene.points, scene.scatterers)
    return tuple(
        dict.fromkeys([*scene.geometry.object_names, *(thing.name for many in beside for thing in many)])
    )


def match_shapes(scene: Scene, name: str) -> tuple[str, ...]:
    """Names of the shapes of a scene that a name, or a pattern of names such as ``"house*"``, fits.

    Raises
    ------
    SceneError : it fits none
    """
    names = shape_names(scene)
    fitting = tuple(one for one in names if one == name or fnmatchcase(one, name))
    if not fitting:
        known = ", ".join(one_line(one, 40) for one in names[:_NAMED]) + ", ..." * (len(names) > _NAMED)
        guess = did_you_mean(name, names) or f"; it has {known or 'none'}"
        raise SceneError(f'{scene.name}: no object "{one_line(name)}"{guess}')
    return fitting


def pick_shapes(scene: Scene, name: str) -> Scene:
    """The scene of the shapes alone that a name or a pattern of names fits; raises as :func:`match_shapes`."""
    kept, geometry = set(match_shapes(scene, name)), scene.geometry
    meshes = [i for i, k in enumerate(geometry.mesh_object.tolist()) if geometry.object_names[k] in kept]
    return replace(
        scene,
        geometry=geometry.pick_meshes(meshes),
        points=tuple(point for point in scene.points if point.name in kept),
        scatterers=tuple(target for target in scene.scatterers if target.name in kept),
    )


def classes_of_shapes(names: Iterable[str], table: Mapping[str, str]) -> dict[str, str]:
    """Class of each shape that a table names.

    Parameters
    ----------
    names : of shapes
    table : class by a shape's name, or by a pattern of names: ``*`` stands for any text, ``?`` for any character. The
        name itself goes before patterns, of these the first one that fits
    """
    out = {}
    for name in names:
        if name in table:
            out[name] = table[name]
            continue
        for pattern, kind in table.items():
            if fnmatchcase(name, pattern):
                out[name] = kind
                break
    return out


def checked_classes(scene: Scene, table: Mapping[str, str]) -> dict[str, str]:
    """Class of each shape of a scene that a table names, as :func:`classes_of_shapes`.

    Raises
    ------
    DataError
        A name or pattern of the table fits no shape, or a class has no name.
    """
    names = shape_names(scene)
    check_used(table, names, "labels: classes: the scene has")
    return classes_of_shapes(names, table)


def check_used(table: Mapping[str, str], names: Iterable[str], where: str) -> None:
    """Raise a DataError for an entry that fits none of some names, or whose class has no name."""
    known = list(names)
    for name, kind in table.items():
        if not kind:
            raise DataError(f'labels: classes: "{one_line(name)}" has the class ""; give it a name')
        if not any(name == one or fnmatchcase(one, name) for one in known):
            raise DataError(
                f'{where} no shape "{one_line(name)}"{did_you_mean(name, known)}; name shapes by their id'
            )


def class_table(content: Mapping[str, object], where: str) -> dict[str, str]:
    """Table of classes from names and values of a file.

    Raises
    ------
    DataError
        A value is no text; ``where`` begins the line.
    """
    for name, kind in content.items():
        if not isinstance(kind, str) or not kind:
            raise DataError(
                f"{where}: {one_line(name)} = {one_line(kind) or chr(34) * 2} is no class; give a text, for example "
                '"building*" = "building"'
            )
    return {name: str(kind) for name, kind in content.items()}


def read_classes(path: Path | str) -> dict[str, str]:
    """Table of classes of a TOML or JSON file, such as ``"building*" = "building"``.

    Raises
    ------
    DataError
        One line: the file cannot be read, or a value is no text.
    """
    return class_table(read_table(Path(path), "a table of classes", _MOST_BYTES), str(path))
