"""Range profiles of blocks and planes in a slant-range image, and positions of edges and lines."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.chain import Parameter, make_scene, track_distance

# meshes and the material of each
Part = tuple[list[targets.Mesh], list[int]]
HEIGHT, WIDTH, LENGTH = 12.0, 9.0, 64.0
AZIMUTH_CELL, BANDWIDTH = 1.5, 400e6
RANGE_CELL = SPEED_OF_LIGHT / (2.0 * BANDWIDTH)
# the wave front's sagitta over the scene, x^2 / 2R, is then below 5 mm
SLANT_RANGE = 50e3
# half a range cell: a scatterer that is lit in part still returns from its own centre
SCATTERER_CELL = 0.2
HALF_CELL = 0.5 * RANGE_CELL
WHERE = "half a range cell: edges of speckle averaged over the object's length"
BLACK = targets.BLACK
MIRROR = Material("mirror", pec=True)
BRIGHT = Material(
    "bright", permittivity=5.0 - 0.5j, diffuse_law="constant", diffuse_level_db=-5.0, rms_height=0.1
)


def diffuse_only(settings: TraceSettings) -> TraceSettings:
    """Settings without the coherent returns of smooth faces, whose rims appear as bright lines."""
    return replace(settings, effects={**settings.effects, "coherent": "off"})


def box(low: tuple[float, float, float], high: tuple[float, float, float], material: int) -> Part:
    """Six faces of a box as meshes, all of one material."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    dx, dy, dz = [x1 - x0, 0, 0], [0, y1 - y0, 0], [0, 0, z1 - z0]
    faces = [
        targets.parallelogram([x0, y0, z0], dy, dz),
        targets.parallelogram([x1, y0, z0], dy, dz),
        targets.parallelogram([x0, y0, z0], dx, dz),
        targets.parallelogram([x0, y1, z0], dx, dz),
        targets.parallelogram([x0, y0, z0], dx, dy),
        targets.parallelogram([x0, y0, z1], dx, dy),
    ]
    return faces, [material] * 6


def plane(x0: float, x1: float, material: int, z: float = 0.0, length: float = 2.0 * LENGTH) -> Part:
    """Level rectangle about y = 0."""
    return [targets.parallelogram([x0, -length / 2, z], [x1 - x0, 0, 0], [0, length, 0])], [material]


def scene_of(
    parts: list[Part],
    materials: tuple[Material, ...],
    theta: float,
    settings: TraceSettings,
    **sensor: Parameter,
) -> Scene:
    """Scene of meshes at a look angle (deg); the near side of everything faces -x, so left looks mirror x."""
    meshes = [mesh for part in parts for mesh in part[0]]
    geometry = targets.geometry(meshes, [i for part in parts for i in part[1]])
    if sensor.get("look_side") == "left":
        flip = geometry.vertices * np.array([-1.0, 1.0, 1.0])
        geometry = Geometry(
            flip,
            geometry.faces[:, ::-1].copy(),
            geometry.face_material,
            geometry.face_group,
            geometry.mesh_names,
            geometry.mesh_face_offset,
        )
    parameters: dict[str, Parameter] = {
        "slant_range": SLANT_RANGE,
        "look_angle_deg": theta,
        "azimuth_resolution": AZIMUTH_CELL,
        "bandwidth": BANDWIDTH,
        "center_frequency": 9.65e9,
        "speed": 150.0,
        "image_extent_azimuth": LENGTH - 8.0,
        "image_extent_range": 110.0,
        **sensor,
    }
    return make_scene(geometry, materials, parameters, settings=settings)


def profile(image: SarImage, scene: Scene, order: int = 0) -> tuple[F64, F64]:
    """Mean power over azimuth against slant range relative to the scene's origin, m."""
    picks = [i for i, layer in enumerate(image.layers) if order == 0 or layer.order == order]
    power = np.mean(np.abs(image.data[picks].sum(axis=0)) ** 2, axis=0)
    origin = float(track_distance(scene.radar, np.zeros(3)))
    return image.grid.range - origin, power.astype(np.float64)


def edge(axis: F64, power: F64, expected: float, rising: bool, reach: float = 3.0) -> float:
    """Position at which a step crosses half its height, m; the plateaus are within ``reach`` of ``expected``."""
    lit = (
        (axis > expected) & (axis < expected + reach)
        if rising
        else (axis < expected) & (axis > expected - reach)
    )
    dark = (
        (axis < expected) & (axis > expected - reach)
        if rising
        else (axis > expected) & (axis < expected + reach)
    )
    half = 0.5 * (power[lit].mean() + np.median(power[dark]))
    # cumulative sum of the excess: its extremum marks the step, robust against speckle
    near = np.abs(axis - expected) < reach
    x, p = axis[near], power[near]
    score = np.cumsum(p - half)
    i = int(np.argmin(score) if rising else np.argmax(score))
    a, b = p[i] - half, p[min(i + 1, p.size - 1)] - half
    t = a / (a - b) if a != b else 0.5
    return float(x[i] + np.clip(t, 0.0, 1.0) * (x[1] - x[0]))


def line(axis: F64, power: F64, expected: float, reach: float = 2.0) -> float:
    """Centre of a bright line near a place: of the samples above a quarter of its peak."""
    near = np.abs(axis - expected) < reach
    weight = np.where(power > 0.25 * power[near].max(), power, 0.0) * near
    return float((weight * axis).sum() / weight.sum())


def setups(quick: bool) -> dict[str, tuple[F64, dict[str, Parameter]]]:
    """Look angles and sensor parameters of each series."""
    if quick:
        return {
            "right": (np.array([35.0]), {}),
            "left, squint 10 deg": (np.array([45.0]), {"look_side": "left", "squint_angle_deg": 10.0}),
        }
    angles = np.array([20.0, 35.0, 50.0, 60.0])
    return {
        "right": (angles, {}),
        "left": (np.array([25.0, 45.0]), {"look_side": "left"}),
        "right, squint 12 deg": (np.array([40.0]), {"squint_angle_deg": 12.0}),
        "left, squint -12 deg": (np.array([30.0, 50.0]), {"look_side": "left", "squint_angle_deg": -12.0}),
    }


def incidence(scene: Scene) -> float:
    """Angle of incidence at zero Doppler on level ground at the origin, rad."""
    antenna = scene.radar.track.center_position
    return float(np.arccos(antenna[2] / track_distance(scene.radar, np.zeros(3))))
