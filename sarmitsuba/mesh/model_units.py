"""Estimate of the unit and the up axis of a model that does not state them."""

import numpy as np

from sarmitsuba.arrays import F64

# height well above the tallest building (828 m), m
TALLEST_WALL = 1200.0
# the same for a file that states no unit: few buildings are as high, and a house in centimetres is, m
LIKELY_WALL = 300.0
# a model of that height with the proportions of a building is not in metres: height over width, share of steep surface
_COMPACT, _STEEP_SHARE = 0.2, 0.05
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
