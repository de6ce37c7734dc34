"""A source on disk to a scene file with its meshes beside it."""

import re
import shutil
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from sarmitsuba.errors import OutputError
from sarmitsuba.importing.model import Model, make_model
from sarmitsuba.importing.options import ImportOptions
from sarmitsuba.importing.source import find_source
from sarmitsuba.io.atomic import atomic_path, make_folder
from sarmitsuba.mesh.ply import write_ply

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
# rms height (m), law and level (dB) of X-band surfaces as in the shipped scenes: starting points, to be edited
_SURFACES: dict[str, tuple[float, str, float]] = {
    "concrete": (0.003, "lambert", -13.0),
    "brick": (0.008, "lambert", -8.0),
    "metal": (0.004, "lambert", -4.0),
    "glass": (0.0005, "lambert", -30.0),
    "wood": (0.005, "lambert", -12.0),
    "marble": (0.002, "lambert", -15.0),
    "asphalt_concrete": (0.003, "constant_gamma", -23.0),
    "medium_dry_ground": (0.02, "constant_gamma", -11.0),
    "very_dry_ground": (0.02, "constant_gamma", -13.0),
    "wet_ground": (0.02, "constant_gamma", -9.0),
}
_OTHER = (0.003, "lambert", -13.0)


def import_scene(
    source: Path | str, output: Path | str, options: ImportOptions | None = None, *, force: bool = False
) -> Model:
    """Turn footprints, CityGML, meshes or an elevation raster into a scene file with its meshes in a folder beside it.

    Parameters
    ----------
    source : file, or folder of meshes
    output : scene file to write, ``.xml``; meshes go to ``NAME_meshes``
    options : what the source does not say
    force : replace a scene of that name

    Returns
    -------
    what was written, with the lines that the command prints

    Raises
    ------
    SceneError : the source cannot be read or used
    OutputError : the scene is there already, or cannot be written
    """
    source, output = Path(source), Path(output)
    if output.suffix.lower() != ".xml":
        raise OutputError(f"{output}: a scene file ends in .xml; name it so")
    if output.exists() and not force:
        raise OutputError(f"{output}: already exists; choose another name, or --force replaces it")
    options = options or ImportOptions()
    model = make_model(find_source(source).read(source, options), options)
    _write(model, output)
    return model


def _write(model: Model, output: Path) -> None:
    folder = output.with_name(f"{output.stem}_meshes")
    make_folder(output.parent)
    fresh = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(fresh, ignore_errors=True)
    make_folder(fresh)
    try:
        files = []
        for number, (part, material, vertices, faces) in enumerate(model.parts):
            word = re.sub(r"\W+", "_", part, flags=re.ASCII).strip("_")[:40] or "part"
            name = f"{number:02d}_{word}.ply"
            with atomic_path(fresh / name) as temporary:
                write_ply(temporary, vertices, faces)
            files.append((part, material, name))
        text = _text(model, folder.name, files)
        with atomic_path(output) as temporary:
            temporary.write_text(text, encoding="utf-8")
            shutil.rmtree(folder, ignore_errors=True)
            fresh.rename(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _text(model: Model, folder: str, files: list[tuple[str, str, str]]) -> str:
    """The scene file."""
    bsdfs = "".join(_bsdf(material) for material in dict.fromkeys(material for _, material, _ in files))
    shapes = "".join(
        f'    <shape type="ply" id={quoteattr(f"{part} {number}")}>\n'
        f'        <string name="filename" value="{folder}/{name}"/>\n'
        f'        <ref id="{material}"/>\n    </shape>\n'
        for number, (part, material, name) in enumerate(files)
    )
    place, anchor = _PLACE, ""
    if model.anchor is not None:
        values = {
            "latitude_deg": np.degrees(model.anchor.latitude),
            "longitude_deg": np.degrees(model.anchor.longitude),
            "height": model.anchor.height,
        }
        anchor = "".join(f'        <float name="{k}" value="{float(v):.13g}"/>\n' for k, v in values.items())
    comment = escape("\n".join(model.notes)).replace("--", "- -")
    title = escape(model.name).replace("--", "- -")
    return _SCENE.format(
        title=title, comment=comment, place=place, anchor=anchor, materials=bsdfs, shapes=shapes
    )


def _bsdf(material: str) -> str:
    rms_height, law, level = _SURFACES.get(material, _OTHER)
    return (
        f'    <bsdf type="radar_material" id="{material}">\n'
        f'        <string name="material" value="{material}"/>\n'
        f'        <float name="rms_height" value="{rms_height:g}"/>\n'
        f'        <string name="diffuse_law" value="{law}"/>\n'
        f'        <float name="diffuse_level_db" value="{level:g}"/>\n    </bsdf>\n\n'
    )


__all__ = ["import_scene"]
