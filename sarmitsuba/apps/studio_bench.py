"""Slider state of the studio as a scene file, and its simulated view.

A state is written as a scene file and simulated from it, so that a saved file gives an identical image.
"""

import dataclasses
import os
import shlex
import time
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sarmitsuba.core.constants import DEFAULT_WINDOW, SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.timing import Clock
from sarmitsuba.loading.from_mesh import is_mesh_file
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.radar_ground import PLUGIN as RADAR_GROUND
from sarmitsuba.loading.references import check_document
from sarmitsuba.loading.tables import RADAR_MATERIAL
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Method
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.simulation.execution.turntable import Aspects, RcsSweep, rcs_sweep

# default window of the command `render`
# rays of the displayed RCS; `rcs` uses more
RCS_RAYS = 100_000
# radar of a scene whose file has none
RADAR = "airborne_x"
# parameters of a surface that are kept when its material changes: its roughness
_MADE_OF = ("material", "permittivity_real", "permittivity_imag", "conductivity")


@dataclass(frozen=True)
class BenchState:
    """Slider values of the studio.

    Parameters
    ----------
    source : scene file of the geometry
    look_angle_deg, heading_deg : of the radar, as in ``sar_antenna``
    look_side : of the flight direction
    mode : of the beam, as in ``sar_antenna``
    slant_range : m
    frequency : Hz
    resolution : m, slant-range and azimuth cell
    polarisation : one channel
    max_depth : most bounces; 0 = automatic
    size : scale factor of all coordinates of the file
    materials : of surfaces by the ids of their BSDFs; others are unchanged
    method : of simulation
    """

    source: Path
    look_angle_deg: float = 45.0
    heading_deg: float = 0.0
    look_side: str = "right"
    mode: str = "stripmap"
    slant_range: float = 10e3
    frequency: float = 9.65e9
    resolution: float = 1.0
    polarisation: str = "VV"
    max_depth: int = 0
    size: float = 1.0
    materials: Mapping[str, str] = field(default_factory=dict)
    method: Method = "image"


@dataclass(frozen=True, eq=False)
class View:
    """Simulated view of a state.

    Parameters
    ----------
    state, scene : simulated state and its scene
    image : on a ground grid
    rcs : of the whole scene from the middle of the aperture, by bounce order; None where its ground has no end
    seconds : time for loading and simulating
    """

    state: BenchState
    scene: Scene
    image: SarImage
    rcs: RcsSweep | None
    seconds: float


def first_state(source: str) -> BenchState:
    """Initial state of a scene with the radar of its file, or ``airborne_x`` if it has none.

    Raises
    ------
    SceneError, RadarError
        The scene cannot be read, or is a mesh file.
    """
    path = resolve(source)
    if is_mesh_file(path):
        raise SceneError(
            f"{path.name}: the studio needs a scene file; write one with the mesh as a shape, such as "
            f'<shape type="ply"><string name="filename" value="{path.name}"/></shape>'
        )
    has_radar = any(node.get("type") == "sar_antenna" for node in _parse_scene(path).iter("sensor"))
    radar = load_scene(path, radar=None if has_radar else RADAR).radar
    line = radar.aim_point - radar.track.center_position
    distance = float(np.linalg.norm(line))
    along = radar.track.along
    return BenchState(
        source=path.resolve(),
        look_angle_deg=round(float(np.degrees(np.arccos(-line[2] / distance))), 6),
        heading_deg=round(float(np.degrees(np.arctan2(along[0], along[1]))), 6),
        look_side=radar.look_side,
        mode=radar.mode,
        slant_range=round(distance, 3),
        frequency=radar.waveform.center_frequency,
        resolution=float(f"{radar.waveform.range_cell:.3g}"),
        polarisation=radar.channels[0],
    )


def surfaces(source: Path) -> tuple[str, ...]:
    """Ids of the BSDFs of a scene file whose materials can be changed."""
    return tuple(node.attrib["id"] for node in _parse_scene(source).findall("bsdf") if "id" in node.attrib)


def scene_xml(state: BenchState) -> str:
    """Text of the scene file of a state.

    Radar and integrator are those of the studio; shapes and BSDFs are those of the source, scaled about the origin,
    with the materials of the state. Paths of meshes are absolute.

    Raises
    ------
    SceneError
        The source is not well-formed XML, or a material is given for an unknown surface.
    """
    root = _parse_scene(state.source)
    for kind in ("sensor", "integrator", "film"):
        for node in root.findall(kind):
            root.remove(node)
    known = surfaces(state.source)
    for name, material in state.materials.items():
        if name not in known:
            raise SceneError(f'{state.source.name}: has no bsdf "{name}"; it has {", ".join(known)}')
        _made_of(next(node for node in root.findall("bsdf") if node.get("id") == name), material)
    for shape in root.findall("shape"):
        if state.size != 1.0:
            _scale_shape(shape, state.size)
    at = len(root.findall("default"))
    root.insert(at, _radar(state))
    root.insert(
        at, _element("integrator", "sar_path", {"method": state.method, "max_depth": state.max_depth})
    )
    ET.indent(root, "    ")
    return ET.tostring(root, encoding="unicode") + "\n"


def command(path: Path) -> str:
    """Command line that renders the studio's image from a saved state."""
    source, out = shlex.quote(str(path)), shlex.quote(str(path.with_suffix("")))
    return f"python -m sarmitsuba render {source} -o {out} --no-error-bars --window {DEFAULT_WINDOW}"


def save(state: BenchState, folder: Path, stem: str = "bench") -> Path:
    """Write the state's scene file under the next free name in a folder; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    number = next(n for n in range(1, 1_000_000) if not os.path.lexists(folder / f"{stem}_{n}.xml"))
    path = folder / f"{stem}_{number}.xml"
    _write(path, scene_xml(state))
    return path


def view_of(state: BenchState, folder: Path, *, clock: Clock = time.perf_counter) -> View:
    """Write the scene file of a state into a folder, and simulate it.

    Raises
    ------
    SceneError, RadarError, ResourceError
        The state cannot be simulated.
    """
    start = clock()
    path = folder / f"{state.source.stem}.xml"
    _write(path, scene_xml(state))
    scene = load_scene(path)
    # one set of rays: half the data, for a live picture
    image = render(scene, error_bars=False)
    return View(state, scene, image, _rcs_of(scene, state.resolution), clock() - start)


def _rcs_of(scene: Scene, resolution: float) -> RcsSweep | None:
    """Radar cross section of a whole scene from the middle of the aperture; None where its ground has no end."""
    if any(scene.geometry.mesh_endless):
        return None
    line = scene.radar.track.center_position - scene.radar.aim_point
    azimuth, elevation = np.arctan2(line[1], line[0]), np.arctan2(line[2], np.hypot(line[0], line[1]))
    # the scatterer cell of the image: a third of a wavelength, as for many aspects, would take most of the time
    settings = dataclasses.replace(scene.settings, scatterer_cell=0.5 * resolution)
    return rcs_sweep(
        dataclasses.replace(scene, settings=settings),
        Aspects(np.array([azimuth]), np.array([elevation])),
        checked=0,
        most_rays=RCS_RAYS,
    )


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")


def _parse_scene(path: Path) -> ET.Element:
    """Root of a scene file with the files that it includes in place; names of files are absolute.

    Includes whose name holds a parameter stay.
    """
    if os.path.isfile(path):
        check_document(path)
    return _splice_includes(path)


def _splice_includes(path: Path) -> ET.Element:
    try:
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise SceneError(f"{path}: not well-formed XML: {error}") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    for node in root.iter("string"):
        if node.get("name") == "filename":
            node.set("value", str(path.parent / node.attrib["value"]))
    for parent in list(root.iter()):
        for node in parent.findall("include"):
            name = node.attrib["filename"]
            if "$" in name:
                node.set("filename", str(path.parent / name))
                continue
            at = list(parent).index(node)
            parent[at : at + 1] = list(_splice_includes(path.parent / name))
    return root


def _radar(state: BenchState) -> ET.Element:
    sensor = _element(
        "sensor",
        "sar_antenna",
        {
            "mode": state.mode,
            "slant_range": state.slant_range,
            "look_angle_deg": state.look_angle_deg,
            "heading_deg": state.heading_deg,
            "look_side": state.look_side,
            "center_frequency": state.frequency,
            "bandwidth": SPEED_OF_LIGHT / (2.0 * state.resolution),
            "azimuth_resolution": state.resolution,
            "polarisation": state.polarisation,
        },
    )
    sensor.append(_element("film", "range_film", {"image_grid": "ground"}))
    return sensor


def _element(kind: str, plugin: str, values: Mapping[str, str | float | int]) -> ET.Element:
    node = ET.Element(kind, {"type": plugin})
    for name, value in values.items():
        tag = {str: "string", int: "integer", float: "float"}[type(value)]
        ET.SubElement(node, tag, {"name": name, "value": value if isinstance(value, str) else repr(value)})
    return node


def _made_of(node: ET.Element, material: str) -> None:
    """Change the material of a BSDF; its roughness is kept."""
    ours = node.get("type") == RADAR_MATERIAL.plugin
    for child in list(node):
        if not ours or child.get("name") in _MADE_OF:
            node.remove(child)
    node.set("type", RADAR_MATERIAL.plugin)
    node.insert(0, ET.Element("string", {"name": "material", "value": material}))


def _scale_shape(shape: ET.Element, size: float) -> None:
    """Scale a shape about the origin, after its other transforms; of ground without end its level and extent."""
    if shape.get("type") == RADAR_GROUND:
        for node in shape.findall("float"):
            try:
                node.set("value", repr(size * float(node.attrib["value"])))
            except ValueError:
                raise SceneError(
                    f"studio: the size cannot change {RADAR_GROUND}'s {node.get('name')} = {node.get('value')}; "
                    "write the number out"
                ) from None
        return
    transform = next((node for node in shape.findall("transform") if node.get("name") == "to_world"), None)
    if transform is None:
        transform = ET.SubElement(shape, "transform", {"name": "to_world"})
    ET.SubElement(transform, "scale", {"value": repr(float(size))})
