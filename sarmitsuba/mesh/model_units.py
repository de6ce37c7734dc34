"""Estimate of the unit and the up axis of a model that does not state them."""

import re
from collections.abc import Sequence

import numpy as np

from sarmitsuba.arrays import F64

# metres
UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "in": 0.0254}
# height well above the tallest building (828 m), m
TALLEST_WALL = 1200.0
# the same for a file that states no unit: few buildings are as high, and a house in centimetres is, m
LIKELY_WALL = 300.0
# a model of that height with the proportions of a building is not in metres: height over width, share of steep surface
_COMPACT, _STEEP_SHARE = 0.2, 0.05
# thickness of ground over its width at most, share of the scene's plan that it covers at least and other faces at most
_THIN, _COVERS, _BARE = 0.25, 0.6, 0.3
# longest side of things, m, by the last word of their name: beyond these by far the unit is another
THINGS: dict[tuple[str, ...], tuple[float, float]] = {
    ("car", "auto", "pkw", "voiture", "van", "taxi", "suv", "sedan"): (2.2, 8.0),
    ("truck", "lorry", "bus", "lkw", "camion"): (4.0, 26.0),
    ("person", "human", "pedestrian", "man", "woman", "mensch", "fussgaenger", "pieton"): (0.4, 2.7),
    ("bicycle", "bike", "motorcycle", "motorbike", "fahrrad", "velo"): (0.8, 3.0),
    ("door", "tuer", "porte"): (1.0, 6.0),
    ("chair", "stuhl", "chaise"): (0.3, 2.0),
    ("house", "haus", "maison"): (3.0, 80.0),
}
# least cosine of the tilt of a level surface, and the ratio of level areas that decides
_LEVEL, _MORE = 0.9, 1.5


def doubtful_unit(triangles: F64, tallest_wall: float = TALLEST_WALL) -> str:
    """Reason why a model's unit cannot be the metre; empty where it can.

    Signs are walls higher than the tallest building, and bodies of such a height that are compact and steep;
    mountains are wider and less steep.

    Parameters
    ----------
    triangles : (n, 3, 3) float64 corners in the model's unit, z up
    tallest_wall : height above which walls and bodies are in doubt, m
    """
    if not len(triangles):
        return ""
    span = np.ptp(triangles.reshape(-1, 3), axis=0)
    if span[2] <= tallest_wall:
        return ""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1)
    steep = np.abs(normal[:, 2]) < 0.2 * area
    tallest = float(np.ptp(triangles[steep, :, 2], axis=1).max()) if steep.any() else 0.0
    if tallest > tallest_wall:
        return f"it has walls of {tallest:.4g} m"
    if span[2] > _COMPACT * span[:2].max() and area[steep].sum() > _STEEP_SHARE * area.sum():
        return f"it is {span[0]:.4g} m x {span[1]:.4g} m wide and {span[2]:.4g} m high"
    return ""


def up_axis(triangles: F64) -> int:
    """Axis that points up, 1 (y) or 2 (z): y where the model is flattest there and most of its level surface faces it.

    Parameters
    ----------
    triangles : (n, 3, 3) float64 corners
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(normal, axis=1)
    level = [float(size[np.abs(normal[:, axis]) > _LEVEL * size].sum()) for axis in range(3)]
    span = np.ptp(triangles.reshape(-1, 3), axis=0)
    return 1 if level[1] > _MORE * level[2] and span[1] < span[2] else 2


def ground_shape(shapes: Sequence[F64], axis: int) -> int:
    """Index of the shape that is the ground of all others where an axis points up; -1 where there is none.

    Ground is thin along the axis, covers most of the plan, and others stand on it, none of them below it.

    Parameters
    ----------
    shapes : (n_i, 3, 3) float64 corners of each
    axis : 0 to 2
    """
    if len(shapes) < 2:
        return -1
    bounds = np.array([[t.reshape(-1, 3).min(axis=0), t.reshape(-1, 3).max(axis=0)] for t in shapes])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    plan = [i for i in range(3) if i != axis]
    covered = [_level_area(t, axis) / float(np.prod((high - low)[plan]) or np.inf) for t in shapes]
    ground = int(np.argmax(covered))
    spans = bounds[ground, 1] - bounds[ground, 0]
    others = np.delete(bounds, ground, axis=0)
    return (
        ground
        if covered[ground] > _COVERS
        and spans[axis] <= _THIN * spans[plan].min()
        and others[:, 0, axis].min() >= bounds[ground, 0, axis] - _THIN * (high - low)[axis]
        and others[:, 1, axis].max() > bounds[ground, 1, axis]
        else -1
    )


def y_ground(shapes: Sequence[F64]) -> int:
    """Index of the ground of shapes, as in `ground_shape`, where y is up and z cannot be; -1 otherwise."""
    ground = ground_shape(shapes, 1)
    if ground < 0 or ground_shape(shapes, 2) >= 0:
        return -1
    corners = np.concatenate([t.reshape(-1, 3) for t in shapes])
    plan = float(np.prod(np.ptp(corners[:, :2], axis=0)))
    thin = [t for t in shapes if np.ptp(t[..., 2]) <= _THIN * np.ptp(t.reshape(-1, 3)[:, :2], axis=0).min()]
    return ground if sum(_level_area(t, 2) for t in thin) <= _BARE * plan else -1


def _level_area(triangles: F64, axis: int) -> float:
    """Area of the level triangles on the more covered side of an axis, projected along it."""
    normal = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = normal[np.abs(normal[:, axis]) > _LEVEL * np.linalg.norm(normal, axis=1), axis]
    return float(max(level[level > 0.0].sum(), -level[level < 0.0].sum()))


def doubtful_size(name: str, length: float) -> str:
    """Reason why something of that name cannot be that long, with the units that would fit; empty where it can.

    Parameters
    ----------
    name : such as ``Car.001``; its last word counts, in English, German or French
    length : longest side of its bounds, m
    """
    words = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
    low, high = next((span for known, span in THINGS.items() if words and words[-1] in known), (0.0, np.inf))
    if not length > 0.0 or low <= length <= high:
        return ""
    fitting = [unit for unit, metres in UNITS.items() if low <= metres * length <= high]
    if not fitting:
        return ""
    return f'"{name}" is {length:.4g} m long; give --unit {" or --unit ".join(fitting)} if that is its unit'
