"""Outlines of bodies in an image: their footprints, and their upper rims where layover shows them."""

import importlib.util
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.scene.mesh.topology import label_connected
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid, ShownAxes

if TYPE_CHECKING:
    import shapely

_FOOT, _TOP = "tab:orange", "tab:cyan"
# corners closer than this in the plan are one place, m
_SAME = 1e-3
# least distance of corners of a drawn ring, m, and part of the image that a surface without walls may cover
_DETAIL, _GROUND = 0.05, 0.25
# height of pavements, relative to what stands on them, below which they are ground
_FLAT = 0.1


@dataclass(frozen=True, eq=False)
class Outline:
    """Outline of a body in the plan.

    Parameters
    ----------
    foot : (n, 3) float64, m, scene frame: closed ring around its vertical projection, each corner at the lowest height
        of the body there, but not below the ground; without walls, at the lowest height of the body
    top : (n, 3) float64: the same ring at the greatest heights
    """

    foot: F64
    top: F64


def check_installed() -> None:
    """Raise a DataError where the package shapely is missing."""
    if importlib.util.find_spec("shapely") is None:
        raise DataError("picture: outlines need the package shapely; pip install 'sarmitsuba[importing]'")


def outlines(scene: Scene) -> tuple[Outline, ...]:
    """Outlines of the connected bodies of a scene, at time zero, holes included as rings of their own.

    Surfaces without overhanging or vertical parts that cover more than a quarter of the image are ground and have none,
    like pavements under other bodies; balconies and the like, which touch a body that begins lower and ends higher, are
    part of it.

    Raises
    ------
    DataError
        The package shapely is missing.
    """
    check_installed()
    import shapely

    geometry, request = scene.geometry, scene.image
    if not geometry.n_faces:
        return ()
    # corners at one place are one node, so that meshes that share walls and roofs are one body
    key = np.round(geometry.vertices / _SAME).astype(np.int64)
    _, first, node = np.unique(key, axis=0, return_index=True, return_inverse=True)
    faces = node.reshape(-1)[geometry.faces]
    part = label_connected(len(first), faces[:, (0, 1)].reshape(-1), faces[:, (1, 2)].reshape(-1))[
        faces[:, 0]
    ]
    corner = geometry.vertices[geometry.faces]
    sides = corner[:, 1:, :2] - corner[:, :1, :2]
    area = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    least = 1e-9 * np.square(np.abs(sides).max(axis=(1, 2)))
    order = np.argsort(part, kind="stable")
    bodies: list[_PlanBody] = []
    grounds: list[F64] = []
    for pick in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        seen = pick[np.abs(area[pick]) > least[pick]]  # walls project to lines
        if not seen.size:
            continue
        plan = shapely.union_all(shapely.polygons(corner[seen][:, :, :2]), grid_size=_SAME)
        height_field = len(seen) == len(pick) and np.abs(area[seen]).sum() < 1.001 * plan.area
        if height_field and plan.area > _GROUND * request.extent_azimuth * request.extent_range:
            grounds.append(np.unique(corner[pick].reshape(-1, 3), axis=0))
            continue
        bodies.append(_PlanBody(plan, _Heights.of(corner[pick].reshape(-1, 3))))
    found: list[Outline] = []
    for body in _standing(bodies):
        plan, heights = body.plan.simplify(_DETAIL), body.heights
        for polygon in getattr(plan, "geoms", [plan]):
            for ring in (polygon.exterior, *polygon.interiors):
                xy = np.asarray(ring.coords)[:, :2]
                if len(xy) > 3:
                    foot, top = heights.at(xy)
                    if (
                        top[:, 2] - foot[:, 2]
                    ).max() < _DETAIL:  # a rim over nothing, as of the crown of a tree
                        foot[:, 2] = heights.low.min()
                    foot[:, 2] = np.maximum(foot[:, 2], _sunk(top, grounds))
                    found.append(Outline(foot, top))
    return tuple(found)


def _sunk(top: F64, grounds: list[F64]) -> F64:
    """Heights (n,) of the ground below the upper rim of a body, m; -inf where there is none.

    A body that is sunk into the ground, such as a quay into water, stands out of it from there on. Where it reaches
    beyond the ground, the lowest height of that below the rest of it counts.

    Parameters
    ----------
    top : (n, 3) m, upper rim
    grounds : (m, 3) m, corners of each ground
    """
    from scipy.interpolate import LinearNDInterpolator

    height = np.full(len(top), -np.inf)
    for corners in grounds:
        middle = corners[:, :2].mean(axis=0)
        found = LinearNDInterpolator(corners[:, :2] - middle, corners[:, 2])(top[:, :2] - middle)
        height = np.fmax(height, np.where(found <= top[:, 2], found, -np.inf))
    stands = np.isfinite(height)
    return np.where(stands, height, height[stands].min(initial=np.inf)) if stands.any() else height


def _standing(bodies: "list[_PlanBody]") -> "list[_PlanBody]":
    """Bodies without those hung on another one, such as balconies, and without flat ones on which others stand."""
    import shapely

    plans = np.array([body.plan for body in bodies], dtype=object)
    low, high = (np.array([f(b.heights) for b in bodies]) for f in (_Heights.lowest, _Heights.highest))
    own, other = shapely.STRtree(plans).query(plans, predicate="dwithin", distance=2.0 * _SAME)
    hung = (low[own] > low[other] + _DETAIL) & (high[own] < high[other])
    under = (own != other) & (high[own] - low[own] < _FLAT * (high[other] - low[own]))
    under[under] = shapely.covers(plans[own[under]], plans[other[under]])
    left_out = set(own[hung | under].tolist())
    return [body for i, body in enumerate(bodies) if i not in left_out]


@dataclass(frozen=True, eq=False)
class _PlanBody:
    """Connected faces: their plan and heights."""

    plan: "shapely.Geometry"
    heights: "_Heights"


@dataclass(frozen=True, eq=False)
class _Heights:
    """Lowest and greatest heights of a body's corners at each place of the plan."""

    place: F64
    low: F64
    high: F64

    def lowest(self) -> float:
        """Lowest of all."""
        return float(self.low.min())

    def highest(self) -> float:
        """Greatest of all."""
        return float(self.high.max())

    @staticmethod
    def of(corners: F64) -> "_Heights":
        key, inverse = np.unique(np.round(corners[:, :2] / _SAME), axis=0, return_inverse=True)
        low, high = np.full(len(key), np.inf), np.full(len(key), -np.inf)
        np.minimum.at(low, inverse.reshape(-1), corners[:, 2])
        np.maximum.at(high, inverse.reshape(-1), corners[:, 2])
        return _Heights(key * _SAME, low, high)

    def at(self, xy: F64) -> tuple[F64, F64]:
        """Places (n, 2) at the lowest and the greatest height of the nearest corner, (n, 3) each."""
        from scipy.spatial import cKDTree

        nearest = cKDTree(self.place).query(xy)[1]
        return np.column_stack([xy, self.low[nearest]]), np.column_stack([xy, self.high[nearest]])


def draw_outlines(axes: Axes, scene: Scene, grid: ImageGrid, shown: ShownAxes) -> int:
    """Draw footprints with solid lines, and upper rims, which layover moves towards the radar, with thin dashed ones.

    Parameters
    ----------
    axes : of the picture; its limits are kept
    scene : of the image
    grid : the image's, in any frame
    shown : coordinates of the axes

    Returns
    -------
    number of rings drawn

    Notes
    -----
    An aperture all around the scene has no layover to one side: footprints alone are drawn, in the image plane.
    """
    rings = outlines(scene)
    own = grid.in_frame(scene.radar.offset)
    corners = np.cumsum([0, *(len(ring.foot) for ring in rings)])
    for kind, style, colour, width in (("top", (0, (3, 2)), _TOP, 0.7), ("foot", "solid", _FOOT, 1.0)):
        if not rings:
            break
        points = np.concatenate([getattr(ring, kind) for ring in rings])
        if scene.radar.all_round:
            points[:, 2] = own.height
        places = np.stack(shown.shown(*ImagePlacement(own, scene.radar).locate(points)), axis=-1)
        lines = [places[a:b] for a, b in pairwise(corners)]
        if kind == "top":
            raised = [
                float(np.ptp([ring.foot[:, 2], ring.top[:, 2]], axis=0).max()) > _DETAIL for ring in rings
            ]
            lines = [line for line, high in zip(lines, raised, strict=True) if high]
        lines = [line[np.isfinite(line).all(axis=1)] for line in lines]
        axes.add_collection(
            LineCollection(lines, colors=colour, linewidths=width, linestyles=style), autolim=False
        )
    return len(rings)
