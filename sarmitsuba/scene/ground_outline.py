"""Outline of level ground: the sides at which the level faces of a scene, of one mesh or of several, end outwards."""

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.mesh.connected import connected
from sarmitsuba.scene.mesh.welding import weld

# points of meshes that meet, and heights of a level face, are equal within this share of the scene's size, and at
# least this, m: rounding of float32 files
LEVEL, LEAST_LEVEL = 1e-6, 1e-4
# heights between which all level faces at the outline lie, m: kerbs, slabs; walls of buildings begin below their ground
DEPTH = 2.0
# largest height of a closed body, in widths of the outline, that is a slab
SLAB = 0.05
# most pairs of a side and a point that may lie on it
_MOST_PAIRS = 20_000_000

NOT_LEVEL = "is not level"
BELOW = f"lies more than {DEPTH:g} m above the lowest shape"
APART = "is in parts that lie apart or overlap"
BEYOND = "does not surround all shapes"
WALL = "has a wall or a body on it"
THICK = "is that of a body, not of a sheet or a thin slab"
HIDDEN = "is not seen whole from one place inside"


class Rim:
    """Outline of level ground, counter-clockwise from above, in sides of one face each.

    Parameters
    ----------
    face : (n,) face that ends at each side
    points : (n, 3) m, where each side starts, at the height of its face
    part : (n,) number of the part of each face: parts have no side in common but such as lie on each other
    slab : whether faces lead down from it
    """

    def __init__(self, face: I64, points: F64, part: I64, *, slab: bool = False) -> None:
        self.face, self.points, self.part, self.slab = face, points, part, slab
        x, y = points[:, :2].T
        x_next, y_next = np.roll(x, -1), np.roll(y, -1)
        cross = x * y_next - x_next * y
        self.area = 0.5 * float(cross.sum())
        moment = np.array([(x + x_next) @ cross, (y + y_next) @ cross])
        self.center: F64 = moment / (6.0 * self.area) if self.area > 0.0 else points[:, :2].mean(axis=0)
        if self.area > 0.0 and not self.seen_whole:
            self.center = self._kernel()

    @property
    def height(self) -> float:
        """Its lowest level, m."""
        return float(self.points[:, 2].min())

    @property
    def width(self) -> float:
        """Smaller side of its bounds, m."""
        return float(np.ptp(self.points[:, :2], axis=0).min())

    @property
    def ends(self) -> F64:
        """(n, 3) m, where each side ends, at the height of its face."""
        return np.column_stack([np.roll(self.points[:, :2], -1, axis=0), self.points[:, 2]])

    @property
    def seen_whole(self) -> bool:
        """Whether all sides are seen from ``center``."""
        return bool((self.distances(self.center) > 0.0).all())

    def distances(self, center: F64) -> F64:
        """Distances (n,) of the lines of its sides from a point (2,), m, positive inside."""
        normal, offset = self._lines()
        return np.asarray(normal @ center - offset)

    def _lines(self) -> tuple[F64, F64]:
        """Unit normals (n, 2) of the sides, inwards, and their products with the points of the sides (n,), m."""
        a = self.points[:, :2]
        along = self.ends[:, :2] - a
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        return normal, np.einsum("ni,ni->n", normal, a)

    def _kernel(self) -> F64:
        """Point (2,) inside the lines of all sides and as far from them as can be; the middle where there is none."""
        normal, offset = self._lines()
        middle = self.points[:, :2].mean(axis=0)
        rows = np.column_stack([-normal, np.ones(len(normal))])
        bounds = [(None, None), (None, None), (0.0, None)]
        found = scipy.optimize.linprog(
            [0.0, 0.0, -1.0], A_ub=rows, b_ub=normal @ middle - offset, bounds=bounds
        )
        return np.asarray(middle + found.x[:2] if found.success else middle)


@dataclass(frozen=True, eq=False)
class _LevelSides:
    """Sides of level faces, directed counter-clockwise about their face.

    Parameters
    ----------
    start, end : (n, 3) m
    face, part : (n,) its face, and the number of the faces that have sides in common
    rising, hanging : (n,) whether a face leads up, or down, from it
    """

    start: F64
    end: F64
    face: I64
    part: I64
    rising: NDArray[np.bool_]
    hanging: NDArray[np.bool_]

    def __getitem__(self, rows: I64 | NDArray[np.bool_]) -> "_LevelSides":
        return _LevelSides(*(getattr(self, each.name)[rows] for each in fields(self)))


def outline(geometry: Geometry) -> Rim | str:
    """Level outline around all shapes that do not move, at their lowest level; why there is none, without any.

    Level faces of several meshes may meet there with different corners, at heights that differ by up to ``DEPTH``, or
    lie on each other: the highest counts. Closed bodies count as slabs up to ``SLAB`` of the width.
    """
    still = np.ones(geometry.n_faces, dtype=bool)
    for _, rows in geometry.moving_meshes():
        still[rows] = False
    if not still.any():
        return NOT_LEVEL
    used = geometry.vertices[geometry.faces[still].reshape(-1)]
    low, high = used.min(axis=0), used.max(axis=0)
    slack = max(LEVEL * float((high - low)[:2].max()), LEAST_LEVEL)
    level = float(used[[*used[:, :2].argmin(axis=0), *used[:, :2].argmax(axis=0)], 2].min())
    if low[2] < level - DEPTH:
        return BELOW
    sides = _level_sides(geometry, np.flatnonzero(still), level, slack)
    if not len(sides.face):
        return NOT_LEVEL
    parts, whole = _parted(sides, slack)
    walk = _outermost(parts, slack)
    lying = sides[~sides.rising]  # without undersides of bodies
    around = np.concatenate([lying.start, lying.end])[:, :2]
    if not len(around) or np.prod(np.ptp(around, axis=0)) < 0.5 * np.prod((high - low)[:2]):
        return NOT_LEVEL
    beyond = not _same_bounds(around, low, high, slack)
    if walk is None:
        return BEYOND if beyond else APART
    # parts of one side that follow each other are one
    source = whole[walk]
    change = np.flatnonzero(source != np.roll(source, 1))
    walk = walk[change] if change.size else walk[:1]
    rim_sides = parts[walk]
    slab = bool(rim_sides.hanging.any())
    rim = Rim(rim_sides.face, rim_sides.start, rim_sides.part, slab=slab)
    if len(walk) < 3 or rim.area <= 0.0 or not _same_bounds(rim.points, low, high, slack):
        return BEYOND if beyond else APART
    if rim_sides.rising.any():
        return WALL
    if slab and float(rim.points[:, 2].max() - low[2]) > SLAB * rim.width:
        return THICK
    return rim if rim.seen_whole else HIDDEN


def _same_bounds(points: F64, low: F64, high: F64, slack: float) -> bool:
    beyond = np.concatenate([points[:, :2].min(axis=0) - low[:2], high[:2] - points[:, :2].max(axis=0)])
    return bool((beyond <= slack).all())


def _level_sides(geometry: Geometry, number: I64, level: float, slack: float) -> _LevelSides:
    """Sides of level faces near a level at which no level face of the same height is the neighbour."""
    v, faces = geometry.vertices, geometry.faces[number].astype(np.int64)
    at = np.abs(v[:, 2] - level) <= DEPTH + slack
    near = at[faces].sum(axis=1) >= 2
    faces, number = faces[near], number[near]
    corners = v[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    flat = at[faces].all(axis=1) & (np.ptp(corners[:, :, 2], axis=1) <= slack)
    longest = np.square(corners - np.roll(corners, -1, axis=1)).sum(axis=-1).max(axis=1)
    sheet = flat & (np.abs(across) > LEVEL * longest)  # not degenerate
    faces = np.where((sheet & (across < 0.0))[:, None], faces[:, ::-1], faces)
    label = np.full(len(v), -1, dtype=np.int64)
    named = np.unique(faces)
    label[named] = weld(np.round(v[named] / slack))
    n = int(label.max(initial=0)) + 1
    start, end, third = (np.roll(faces, -k, axis=1).reshape(-1) for k in range(3))
    key, back = label[start] * n + label[end], label[end] * n + label[start]
    both = np.minimum(key, back)
    rise = v[third, 2] - v[start, 2]
    wall = np.repeat(~flat, 3) & (np.abs(v[end, 2] - v[start, 2]) <= slack)
    own = np.repeat(sheet, 3) & (label[start] != label[end])
    alone = ~np.isin(key[own], back[own])
    rows, shared = np.flatnonzero(own)[alone], np.flatnonzero(own)[~alone]
    _, edge = np.unique(both[shared], return_inverse=True)
    n_faces = len(faces)
    part = connected(n_faces + edge.max(initial=-1) + 1, shared // 3, n_faces + edge.reshape(-1))
    return _LevelSides(
        start=v[start[rows]],
        end=v[end[rows]],
        face=number[rows // 3],
        part=part[rows // 3],
        rising=np.isin(both[rows], both[wall & (rise > slack)]),
        hanging=np.isin(both[rows], both[wall & (rise < -slack)]),
    )


def _parted(sides: _LevelSides, slack: float) -> tuple[_LevelSides, I64]:
    """Sides cut where the ends of others lie on them, seen from above, and the row of the whole of each."""
    a, along = sides.start[:, :2], (sides.end - sides.start)[:, :2]
    length = np.linalg.norm(along, axis=1)
    points = np.concatenate([a, sides.end[:, :2]])
    tree = scipy.spatial.cKDTree(points[np.unique(_plan_labels(points, slack), return_index=True)[1]])
    middle, radius = a + 0.5 * along, 0.5 * length + slack
    count = tree.query_ball_point(middle, radius, return_length=True)
    if int(count.sum()) > _MOST_PAIRS:
        return sides, np.arange(len(length))
    on = np.concatenate([np.asarray(row, dtype=np.int64) for row in tree.query_ball_point(middle, radius)])
    row = np.repeat(np.arange(len(length)), count)
    to, unit = tree.data[on] - a[row], (along / length[:, None])[row]
    place = np.einsum("ni,ni->n", to, unit)
    aside = np.abs(to[:, 0] * unit[:, 1] - to[:, 1] * unit[:, 0])
    cut = (aside <= 2.0 * slack) & (place > 2.0 * slack) & (place < length[row] - 2.0 * slack)
    row, place, on = row[cut], place[cut], on[cut]
    order = np.lexsort((place, row))
    row, on = row[order], on[order]
    between = np.column_stack([tree.data[on], sides.start[row, 2]])
    # a whole side is followed by its cuts; each part ends where the next of the same side starts
    whole = np.concatenate([np.arange(len(length)), row])
    start = np.concatenate([sides.start, between])
    order = np.argsort(whole, kind="stable")
    whole, start = whole[order], start[order]
    last = np.append(whole[1:] != whole[:-1], True)
    end = np.where(last[:, None], sides.end[whole], np.roll(start, -1, axis=0))
    return replace(sides[whole], start=start, end=end), whole


def _plan_labels(points: F64, slack: float) -> I64:
    """Labels (n,) of points (n, 2), m, equal for those at one place."""
    return weld(np.column_stack([np.round(points / slack), np.zeros(len(points))]))


def _outermost(parts: _LevelSides, slack: float) -> I64 | None:
    """Rows of the parts around all others, seen from above, in turn; None where they do not close.

    Of parts upon each other the highest counts, of equal heights one without a wall; opposite ones are no outline.
    """
    n = len(parts.face)
    points = np.concatenate([parts.start, parts.end])[:, :2]
    label = _plan_labels(points, slack)
    first, last = label[:n], label[n:]
    size = int(label.max()) + 1
    key, back = first * size + last, last * size + first
    rows = np.flatnonzero((first != last) & ~np.isin(key, back))
    height = np.round(parts.start[rows, 2] / slack)
    rows = rows[np.lexsort((rows, parts.rising[rows], -height))]
    rows = rows[np.unique(key[rows], return_index=True)[1]]
    if not rows.size:
        return None
    direction = np.arctan2(*(parts.end - parts.start)[rows, :2].T[::-1])
    leaving: dict[int, list[int]] = {}
    for i, label_of in enumerate(first[rows].tolist()):
        leaving.setdefault(label_of, []).append(i)
    start = np.round(parts.start[rows, :2] / slack)
    at = int(first[rows][np.lexsort((start[:, 1], start[:, 0]))[0]])  # southern end of the western side
    walk: list[int] = []
    angle = -0.5 * np.pi
    while len(walk) <= rows.size:
        ahead = leaving.get(at)
        if ahead is None:
            return None
        # the outermost turn, to the right; turning back comes last
        turn = (direction[ahead] - angle + np.pi - 1e-6) % (2.0 * np.pi)
        i = ahead[int(np.argmin(turn))]
        if walk and i == walk[0]:
            return np.asarray(rows[np.array(walk)])
        walk.append(i)
        at, angle = int(last[rows[i]]), float(direction[i])
    return None
