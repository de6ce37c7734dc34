"""Where the image shows a building, a slope and a bridge: layover, shadow, dihedral line, multiple bounces."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba import theory
from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.materials.material import Material
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.validation import targets
from sarmitsuba.validation.chain import chain, make_scene, track_distance
from sarmitsuba.validation.comparison import Case, CaseEntry, Comparison

F64 = NDArray[np.float64]

HEIGHT, WIDTH, LENGTH = 12.0, 9.0, 64.0
AZIMUTH_CELL, BANDWIDTH = 1.5, 400e6
RANGE_CELL = 299792458.0 / (2.0 * BANDWIDTH)
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


def diffuse_only(**settings: Any) -> TraceSettings:
    """Settings without the coherent returns of smooth faces, whose rims draw bright lines of their own."""
    return TraceSettings(effects={"coherent": "off"}, **settings)


def box(
    low: tuple[float, float, float], high: tuple[float, float, float], material: int
) -> tuple[list[Any], list[int]]:
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


def plane(
    x0: float, x1: float, material: int, z: float = 0.0, length: float = 2.0 * LENGTH
) -> tuple[list[Any], list[int]]:
    """Level rectangle about y = 0."""
    return [targets.parallelogram([x0, -length / 2, z], [x1 - x0, 0, 0], [0, length, 0])], [material]


def scene_of(
    parts: list[tuple[list[Any], list[int]]],
    materials: tuple[Material, ...],
    theta: float,
    settings: TraceSettings,
    **sensor: Any,
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
    parameters: dict[str, Any] = {
        "slant_range": SLANT_RANGE,
        "look_angle_deg": theta,
        "azimuth_resolution": AZIMUTH_CELL,
        "bandwidth": BANDWIDTH,
        "center_frequency": 9.65e9,
        "speed": 150.0,
        "image_extent_azimuth": LENGTH - 8.0,
        "image_extent_range": 110.0,
    } | sensor
    return make_scene(geometry, materials, settings=settings, **parameters)


def profile(image: SarImage, scene: Scene, order: int = 0) -> tuple[F64, F64]:
    """Mean power over azimuth against slant range relative to the scene's origin, m."""
    picks = [i for i, layer in enumerate(image.layers) if order == 0 or layer.order == order]
    power = np.mean(np.abs(image.data[picks].sum(axis=0)) ** 2, axis=0)
    origin = float(track_distance(scene.radar, np.zeros(3)))
    return image.grid.range - origin, power.astype(np.float64)


def edge(axis: F64, power: F64, expected: float, rising: bool, reach: float = 3.0) -> float:
    """Place where a step crosses half its height, m; the plateaus lie within ``reach`` of the expected place."""
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
    # running sum of the excess: its extreme marks the step whatever the speckle does
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


def setups(quick: bool) -> dict[str, tuple[F64, dict[str, Any]]]:
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


def building(quick: bool = False) -> Case:
    """Layover of a wall, roof, shadow, dihedral line and wall-ground-wall return of a building."""
    comparisons = []
    settings = diffuse_only(max_depth=1, scatterer_cell=SCATTERER_CELL)
    bounces = diffuse_only(max_depth=3, keep_orders=True, scatterer_cell=SCATTERER_CELL)
    half = LENGTH / 2
    for label, (angles, sensor) in setups(quick).items():
        names = (
            "wall's top",
            "roof's far edge",
            "foot",
            "shadow's end",
            "dihedral line",
            "wall-ground-wall end",
        )
        want: dict[str, list[float]] = {n: [] for n in names}
        got: dict[str, list[float]] = {n: [] for n in names}
        for theta in angles:
            body = box((0, -half, 0), (WIDTH, half, HEIGHT), 0)
            own = scene_of([body, plane(-60, 60, 1)], (BRIGHT, BLACK), theta, settings, **sensor)
            axis, power = profile(chain(own, window="taylor:4:-35"), own)
            returns = theory.building_returns(HEIGHT, WIDTH, incidence(own))
            want["wall's top"].append(-returns.layover_slant)
            got["wall's top"].append(edge(axis, power, -returns.layover_slant, True))
            far = max(returns.roof_slant[1], 0.0)  # the later of roof and wall ends the building's own return
            want["roof's far edge"].append(far)
            got["roof's far edge"].append(edge(axis, power, far, False, 1.5))
            other = scene_of([body, plane(-60, 60, 1)], (MIRROR, BRIGHT), theta, bounces, **sensor)
            image = chain(other, window="taylor:4:-35")
            axis, power = profile(image, other, 1)
            want["foot"].append(0.0)
            got["foot"].append(edge(axis, power, 0.0, False))
            want["shadow's end"].append(returns.lit_ground_slant)
            got["shadow's end"].append(edge(axis, power, returns.lit_ground_slant, True))
            axis, power = profile(image, other, 2)
            want["dihedral line"].append(returns.dihedral_slant)
            got["dihedral line"].append(line(axis, power, 0.0))
            axis, power = profile(image, other, 3)
            end = returns.triple_ground * np.sin(incidence(other))
            want["wall-ground-wall end"].append(end)
            got["wall-ground-wall end"].append(edge(axis, power, end, False, min(3.0, 0.8 * end)))
        for name in names:
            comparisons.append(
                Comparison(
                    f"{name}, {label}",
                    angles,
                    np.asarray(want[name]),
                    np.asarray(got[name]),
                    tolerance=HALF_CELL,
                    reason=WHERE,
                    unit="m",
                    shown=0,
                )
            )
    return Case(
        name="building",
        topic="geometry",
        title="Layover, roof, shadow, dihedral line and triple bounce of a building",
        formula="top -h cos t, shadow's end (w + h tan t) sin t, dihedral 0, wall-ground-wall to h tan t sin t",
        source="plane-wave geometry; shared figures of a 20 m building reproduced by the closed forms",
        x_label="look angle (deg)",
        y_label="slant range from the wall's foot (m)",
        comparisons=tuple(comparisons),
        note=f"{HEIGHT:g} m high, {WIDTH:g} m deep, {LENGTH:g} m long; cell {RANGE_CELL:.3f} m; 50 km. "
        "Slant range at zero Doppler, so that squint must not move anything. Diffuse returns alone.",
    )


def slope(quick: bool = False) -> Case:
    """Foreshortening: slant-range length of a slope facing the radar, from flat to laid over."""
    comparisons = []
    settings = diffuse_only(max_depth=1, scatterer_cell=SCATTERER_CELL)
    size = 16.0
    slopes = np.array([0.0, 15.0] if quick else [-15.0, 0.0, 15.0, 30.0])
    for theta in (35.0,) if quick else (25.0, 40.0, 55.0):
        keep = np.abs(theta - slopes) > 8.0
        want, got = [], []
        for alpha in np.radians(slopes[keep]):
            dx, dz = size * np.cos(alpha), size * np.sin(alpha)
            ramp = ([targets.parallelogram([0, -LENGTH / 2, 0], [dx, 0, dz], [0, LENGTH, 0])], [0])
            scene = scene_of([ramp], (BRIGHT,), theta, settings)
            axis, power = profile(chain(scene, window="taylor:4:-35"), scene)
            ratio = theory.foreshortening(float(alpha), np.radians(theta))
            end = size * ratio
            want.append(end)
            first, last = min(0.0, end), max(0.0, end)
            reach = min(3.0, 0.8 * (last - first))
            length = edge(axis, power, last, False, reach) - edge(axis, power, first, True, reach)
            got.append(np.sign(end) * length)
        comparisons.append(
            Comparison(
                f"look angle {theta:g} deg",
                slopes[keep],
                np.asarray(want),
                np.asarray(got),
                tolerance=RANGE_CELL,
                reason="half a range cell at either end",
                unit="m",
            )
        )
    return Case(
        name="slope",
        topic="geometry",
        title="Foreshortening and layover of a slope",
        formula="l sin(t - a)",
        source="plane-wave geometry",
        x_label="slope towards the radar (deg)",
        y_label="slant-range length (m), negative when laid over",
        comparisons=tuple(comparisons),
        note=f"{size:g} m slope.",
    )


def bridge(quick: bool = False) -> Case:
    """Bridge over calm water: single, double and triple returns of its side, and the ghost from under the deck."""
    comparisons = []
    height, thick = 8.0, 0.2
    series: dict[str, tuple[F64, dict[str, Any]]] = {
        "right": (np.array([40.0] if quick else [25.0, 35.0, 50.0]), {})
    }
    if not quick:
        series["left, squint 10 deg"] = (np.array([40.0]), {"look_side": "left", "squint_angle_deg": 10.0})
    deck_material = Material("deck", pec=True, diffuse_law="constant", diffuse_level_db=-10.0)
    for label, (angles, sensor) in series.items():
        names = ("single", "double", "triple", "under the deck, first", "under the deck, ghost")
        want: dict[str, list[float]] = {n: [] for n in names}
        got: dict[str, list[float]] = {n: [] for n in names}
        for theta in angles:
            # the deck's side alone, a strip, for the three orders of its edge
            side = targets.parallelogram([0, -LENGTH / 2, height - thick / 2], [0, LENGTH, 0], [0, 0, thick])
            scene = scene_of(
                [([side], [0]), plane(-18, 18, 1)],
                (BRIGHT, MIRROR),
                theta,
                diffuse_only(max_depth=2, ray_spacing=0.09, scatterer_cell=0.5 * thick),
                **(sensor | {"image_extent_range": 60.0}),
            )
            axis, power = profile(chain(scene, window="taylor:4:-35"), scene)
            t = incidence(scene)
            returns = theory.bridge_returns(height, t)
            for name, place in (
                ("single", returns.single),
                ("double", returns.double),
                ("triple", returns.triple),
            ):
                want[name].append(place)
                got[name].append(line(axis, power, place))
            # a wide deck whose underside scatters and mirrors over water that mirrors: what the water shows of
            # it, 2 h tan t wide, and behind that the same once more through deck and water
            reach = 2.0 * height * np.tan(t)
            # the roadway is black: its own return would lie over the end of the first
            deck = plane(0.0, 2.5 * reach, 0, height, LENGTH)
            roadway = plane(0.0, 2.5 * reach, 2, height + 0.02, LENGTH)
            under = scene_of(
                [deck, roadway, plane(-20, 60, 1)],
                (deck_material, MIRROR, BLACK),
                theta,
                diffuse_only(max_depth=4, ray_spacing=0.18),
                **(sensor | {"image_extent_range": 160.0}),
            )
            axis, power = profile(chain(under, window="taylor:4:-35"), under)
            want["under the deck, first"].append(returns.triple + reach * np.sin(t))
            got["under the deck, first"].append(edge(axis, power, want["under the deck, first"][-1], False))
            want["under the deck, ghost"].append(returns.under_deck[0] + reach * np.sin(t))
            got["under the deck, ghost"].append(edge(axis, power, want["under the deck, ghost"][-1], True))
        for name in names:
            comparisons.append(
                Comparison(
                    f"{name}, {label}",
                    angles,
                    np.asarray(want[name]),
                    np.asarray(got[name]),
                    tolerance=HALF_CELL,
                    reason=WHERE,
                    unit="m",
                    shown=0,
                )
            )
    return Case(
        name="bridge",
        topic="geometry",
        title="Returns of a bridge over water",
        formula="single -h cos t, double 0, triple +h cos t; under the deck x sin t + h cos t, ghost + 2 h cos t",
        source="mirror images in the water (and in the deck)",
        x_label="look angle (deg)",
        y_label="slant range from the point below the edge (m)",
        comparisons=tuple(comparisons),
        note=f"Deck {height:g} m above the water.",
    )


CASES = (
    CaseEntry("building", "geometry", building),
    CaseEntry("slope", "geometry", slope),
    CaseEntry("bridge", "geometry", bridge),
)

__all__ = ["CASES", "bridge", "building", "slope"]
