"""Mesh files, one or a folder of them: glTF, obj, ply, stl, off."""

import os
from dataclasses import replace
from pathlib import Path

from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.from_mesh import SUFFIXES, MeshOptions, upright
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.source_format import SOURCES, CitySource, SourceFormat
from sarmitsuba.loading.mesh_files import MeshPart, read_parts


def read_meshes(path: Path, options: ImportOptions) -> CitySource:
    """Read the parts of all files, converted to metres and z up.

    A part without a material is named after its file, which is the object where it names none and is one of several.

    Raises
    ------
    SceneError : a file cannot be read, or the coordinates cannot be metres
    """
    files = (
        sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if os.path.isdir(path) else [path]
    )
    parts: list[MeshPart] = []
    for file in files:
        for part in read_parts(file, file.name):
            whole = part.whole or (file.stem if len(files) > 1 else "")
            parts.append(replace(part, material=part.material or file.stem, whole=whole))
    source = CitySource(path.name)
    kinds = {p.suffix.lower() in (".glb", ".gltf") for p in files}
    if len(kinds) > 1 and options.up == "auto":
        raise SceneError(
            f"{path.name}: glTF, which has y up, beside other meshes; give --up y or --up z, or separate them"
        )
    matrix, said = upright(path.name, files[0].suffix, parts, MeshOptions(up=options.up, unit=options.unit))
    source.notes.append(said)
    if wholes := {part.whole for part in parts if part.whole}:
        source.notes.append(
            f"{path.name}: {len(wholes)} objects in {len(parts)} parts, one for each material"
        )
    source.meshes = [replace(part, vertices=part.vertices @ matrix.T) for part in parts]
    return source


SOURCES.register(SourceFormat("mesh", "meshes, materials by name", SUFFIXES, read_meshes, folders=True))
