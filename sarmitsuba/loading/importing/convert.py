"""Conversion of a city source into a scene file with meshes in a folder beside it."""

import os
import re
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from sarmitsuba.core.errors import OutputError
from sarmitsuba.core.parameters import one_line, printable
from sarmitsuba.loading.importing.city_model import Model, make_model
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.source_format import find_source
from sarmitsuba.machine.atomic import atomic_path, process_of_part, removed_if_stopped
from sarmitsuba.machine.output import OutputFile, OutputFolder, output_folder
from sarmitsuba.machine.regular_files import is_inside
from sarmitsuba.scene.materials.typical import typical_of
from sarmitsuba.scene.mesh.formats import write_ply

_SCENE = """<!--
{title}
{comment}
-->
<scene version="3.0.0">
{place}
    <integrator type="sar_path"/>

    <sensor type="sar_antenna">
        <float name="slant_range" value="10000"/>
        <float name="look_angle_deg" value="$look_angle_deg"/>
        <float name="heading_deg" value="$heading_deg"/>
        <float name="center_frequency" value="9.65e9"/>
        <float name="bandwidth" value="300e6"/>
        <float name="azimuth_resolution" value="0.5"/>
{anchor}        <film type="range_film">
            <string name="image_grid" value="ground"/>
            <float name="image_extent_limit" value="400"/>
        </film>
    </sensor>

{materials}{shapes}</scene>
"""
_PLACE = """    <default name="look_angle_deg" value="40"/>
    <default name="heading_deg" value="0"/>
"""
# names of meshes
_MESHES = re.compile(r"\d{2,}_[A-Za-z0-9_]+\.ply")


def import_scene(
    source: Path | str, output: Path | str, options: ImportOptions | None = None, *, force: bool = False
) -> Model:
    """Convert footprints, CityGML, meshes or an elevation raster into a scene file with meshes in a folder beside it.

    Parameters
    ----------
    source : file, or folder of meshes
    output : scene file to write, ``.xml``; meshes go to ``NAME_meshes``
    options : properties not contained in the source
    force : replace an existing scene of that name

    Returns
    -------
    files written, and lines that the command prints

    Raises
    ------
    SceneError : the source cannot be read or used
    OutputError : the scene exists already; it or its meshes would replace files that the program did not write; or it
        cannot be written
    """
    source, output = Path(source), Path(output)
    if output.suffix.lower() != ".xml":
        raise OutputError(f"{output}: a scene file ends in .xml; name it so")
    if not output.stem.isprintable():
        raise OutputError(f"{output}: the name has control characters; choose another -o")
    file, folder = OutputFile(output, force=force), output.with_name(f"{output.stem}_meshes")
    options = options or ImportOptions()
    for given in (source, options.dem):
        _check_apart(given, output, folder)
    if os.path.lexists(folder):
        _check_folder(folder, force)
    model = make_model(find_source(source).read(source, options), options)
    with output_folder(folder, _MESHES) as meshes, file.writing() as path:
        _check_folder(folder, force)
        _write(model, path, meshes)
    return model


def _check_apart(source: Path | None, output: Path, folder: Path) -> None:
    """Raise an OutputError where the scene or its meshes would replace their source."""
    if source is None:
        return
    if os.path.realpath(source) == os.path.realpath(output):
        raise OutputError(f"{output}: this is the source itself; choose another -o")
    if is_inside(os.path.abspath(source), folder):
        raise OutputError(
            f"{folder}: the meshes go into this folder, and {one_line(source)} lies in it; choose another -o"
        )


def _check_folder(folder: Path, force: bool) -> None:
    """Raise an OutputError if a folder for meshes was not made by the program, or its meshes may be in use."""
    if not os.path.isdir(folder) or os.path.islink(folder):
        raise OutputError(f"{folder}: the meshes go here, but this is not a folder; move it")
    meshes = OutputFolder(folder, _MESHES)
    if not meshes.listed and any(process_of_part(name) is None for name in os.listdir(folder)):
        raise OutputError(
            f"{folder}: the meshes go here, but the program did not make this folder; move it, or choose another -o"
        )
    if meshes.names and meshes.run_hash and not force:
        raise OutputError(
            f"{folder}: holds the meshes of a scene imported before; choose another -o, or replace them with --force"
        )


def _write(model: Model, output: Path, meshes: OutputFolder) -> None:
    """Write new meshes beside old ones, then the scene in place of the old one, then remove the old meshes.

    An interruption leaves either scene complete; unused meshes are removed by the next import.
    """
    parts = tuple(model.parts.shapes())
    names = _free_names(meshes.path, [part for part, *_ in parts])
    old = [name for name in meshes.listed if name not in names]
    made: os.stat_result | None = None

    def undo() -> None:
        try:
            in_place = made is not None and os.path.samestat(output.lstat(), made)
        except OSError:
            in_place = False
        if not in_place:
            meshes.drop(names)

    with removed_if_stopped(undo):
        try:
            meshes.announce(*names)
            for name, (_, _, vertices, faces) in zip(names, parts, strict=True):
                with atomic_path(meshes.path / name) as temporary:
                    write_ply(temporary, vertices, faces)
            files = [(part, material, name) for name, (part, material, *_) in zip(names, parts, strict=True)]
            with atomic_path(output, within=meshes.path) as temporary:
                temporary.write_text(_text(model, meshes.path.name, files), encoding="utf-8")
                made = temporary.lstat()
        finally:
            undo()
    meshes.run_hash = output.name
    meshes.enter(*names)
    meshes.drop(old)


def _free_names(folder: Path, parts: Sequence[str]) -> list[str]:
    """Names for the meshes of these parts that do not exist in the folder."""
    words = [re.sub(r"\W+", "_", part, flags=re.ASCII).strip("_")[:40] or "part" for part in parts]
    for time in count(1):
        suffix = f"_{time}" if time > 1 else ""
        names = [f"{number:02d}_{word}{suffix}.ply" for number, word in enumerate(words)]
        if not any(os.path.lexists(folder / name) for name in names):
            break
    return names


def _attribute(text: str) -> str:
    """Value of an attribute, in quotes, with ``$`` escaped, which else begins the name of a parameter in Mitsuba."""
    return quoteattr(text.replace("$", r"\$"))


def _comment(text: str) -> str:
    """Text of a comment without double hyphens, which XML forbids."""
    return re.sub("-(?=-)", "- ", escape(text))


def _text(model: Model, folder: str, files: list[tuple[str, str, str]]) -> str:
    """Text of the scene file."""
    bsdfs = "".join(_bsdf(material) for material in dict.fromkeys(material for _, material, _ in files))
    shapes = "".join(
        f'    <shape type="ply" id={_attribute(part)}>\n'
        f'        <string name="filename" value={_attribute(f"{folder}/{name}")}/>\n'
        f'        <ref id="{material}"/>\n    </shape>\n'
        for part, material, name in files
    )
    place, anchor = _PLACE, ""
    if model.anchor is not None:
        values = {
            "latitude_deg": np.degrees(model.anchor.latitude),
            "longitude_deg": np.degrees(model.anchor.longitude),
            "height": model.anchor.height,
        }
        anchor = "".join(f'        <float name="{k}" value="{float(v):.13g}"/>\n' for k, v in values.items())
    comment = _comment("\n".join(printable(note, 900) for note in model.notes))
    title = _comment(printable(model.name))
    return _SCENE.format(
        title=title, comment=comment, place=place, anchor=anchor, materials=bsdfs, shapes=shapes
    )


def _bsdf(material: str) -> str:
    """Element of a named material with its typical surface at 10 GHz, written out to be edited."""
    surface = typical_of(material)
    lines = (
        f'        <float name="rms_height" value="{surface.rms_height:g}"/>\n'
        f'        <string name="diffuse_law" value="{surface.law}"/>\n'
        f'        <float name="diffuse_level_db" value="{surface.level_db:g}"/>\n'
    )
    return (
        f'    <bsdf type="radar_material" id="{material}">\n'
        f'        <string name="material" value="{material}"/>\n'
        f"{'' if surface.smooth else lines}    </bsdf>\n\n"
    )
