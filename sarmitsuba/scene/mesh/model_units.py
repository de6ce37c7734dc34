"""Estimate of the unit and the up axis of a model that does not state them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64

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


@dataclass(frozen=True, eq=False)
class ShapeExtent:
    """Size and level area of a shape.

    Parameters
    ----------
    bounds : (2, 3) float64, lowest and highest corner
    level : (3,) float64, area of the triangles that face an axis, on the more covered side, projected along it
    """

    bounds: F64
    level: F64

    @staticmethod
    def of(triangles: F64) -> "ShapeExtent":
        """Extent of triangles (n, 3, 3) float64, at least one."""
        normal = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        facing = np.where(np.abs(normal) > _LEVEL * np.linalg.norm(normal, axis=1)[:, None], normal, 0.0)
        areas = [np.maximum(side * facing, 0.0).sum(axis=0) for side in (1.0, -1.0)]
        corners = triangles.reshape(-1, 3)
        return ShapeExtent(np.stack([corners.min(axis=0), corners.max(axis=0)]), np.maximum(*areas))

    def is_thin(self, axis: int) -> bool:
        """Whether it is flat across an axis, as ground is."""
        span = self.bounds[1] - self.bounds[0]
        return bool(span[axis] <= _THIN * np.delete(span, axis).min())


def ground_shape(shapes: Sequence[ShapeExtent], axis: int) -> int:
    """Index of the shape that is the ground of all others where an axis points up; -1 where there is none.

    Ground is thin along the axis, covers most of the plan, and others stand on it, none of them below it.

    Parameters
    ----------
    shapes : of a scene
    axis : 0 to 2
    """
    if len(shapes) < 2:
        return -1
    span, plan = _span_and_plan(shapes, axis)
    found = int(np.argmax([shape.level[axis] for shape in shapes]))
    ground = shapes[found]
    others = np.array([shape.bounds[:, axis] for i, shape in enumerate(shapes) if i != found])
    return (
        found
        if ground.level[axis] > _COVERS * plan > 0.0
        and ground.is_thin(axis)
        and others[:, 0].min() >= ground.bounds[0, axis] - _THIN * span[axis]
        and others[:, 1].max() > ground.bounds[1, axis]
        else -1
    )


def y_ground(shapes: Sequence[ShapeExtent]) -> int:
    """Index of the ground of shapes, as in `ground_shape`, where y is up and z cannot be; -1 otherwise."""
    ground = ground_shape(shapes, 1)
    if ground < 0 or ground_shape(shapes, 2) >= 0:
        return -1
    _, plan = _span_and_plan(shapes, 2)
    return ground if sum(shape.level[2] for shape in shapes if shape.is_thin(2)) <= _BARE * plan else -1


def _span_and_plan(shapes: Sequence[ShapeExtent], axis: int) -> tuple[F64, float]:
    """Size (3,) of all shapes together, and the area that its bounds cover across an axis."""
    bounds = np.array([shape.bounds for shape in shapes])
    span = bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)
    return span, float(np.prod(np.delete(span, axis)))


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
