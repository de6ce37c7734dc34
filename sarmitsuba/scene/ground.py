"""Ground that goes on beyond the rim of its mesh, so that the rim returns no echo.

The outline of level ground is the sides at which level faces end outwards, of one mesh or of several.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64, unit_rows
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.topology import label_connected, weld
from sarmitsuba.scene.motion import STILL
from sarmitsuba.scene.scene import Scene

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
    parts, whole = _part_sides(sides, slack)
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
    part = label_connected(n_faces + edge.max(initial=-1) + 1, shared // 3, n_faces + edge.reshape(-1))
    return _LevelSides(
        start=v[start[rows]],
        end=v[end[rows]],
        face=number[rows // 3],
        part=part[rows // 3],
        rising=np.isin(both[rows], both[wall & (rise > slack)]),
        hanging=np.isin(both[rows], both[wall & (rise < -slack)]),
    )


def _part_sides(sides: _LevelSides, slack: float) -> tuple[_LevelSides, I64]:
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


# name of the mesh that continues the ground
ENDLESS_GROUND = "endless ground"
# smallest width of a rim that is taken as that of ground, m, and in resolution cells: smaller level sheets are targets
LEAST_WIDTH, LEAST_CELLS = 10.0, 10.0
# share of the scene's bounds, seen from above, that a sheet covers with faces inclined by less than 45 degrees if it is
# taken as ground
LEAST_SHARE = 0.5
# largest sine of the angle between neighbouring sides of one straight rim
_STRAIGHT = 1e-3
# width of the gap at the outer end of the frame between two parts, m
_GAP = 1e-5
# smallest cosine of the incidence angle for lengths on the ground
_GRAZING = 0.05


def continue_ground(scene: Scene) -> Scene:
    """The scene with level ground continued beyond its rim, without clutter, and a note; the scene itself without any.

    Coherent ray tubes on a plane cancel with their neighbours, except at its rim: there the sum has the return of a
    plate's edge, and on metal its fringe currents. A rim is taken as that of ground where it is a closed level outline
    around the whole scene, at its lowest level, and at least ``LEAST_WIDTH`` and ``LEAST_CELLS`` wide; of metal, or of
    a slab, where a mesh stands on it. Triangles of the same surface continue it, without its diffuse return, to beyond
    the rays' launch window, where these fade out. Walls near the rim are mirrored by that ground, too. Ground of
    several parts, which meet there at any corners and at heights that differ by kerbs, continues with the material and
    the height of each part; steps between them are open.

    Notes
    -----
    Sloping rims, ground with maps of its properties, moving meshes, parts that do not meet and outlines that are not
    seen whole from a point inside end where they end, and a note says that their echo is in the image. So does, without
    a note, ground in method ``raster``, which has no coherent return, and ground too rough for one: less than
    ``tolerance_db`` of a smooth one's. ``endless_ground`` of the settings is ``off``, or ``on`` for lone metal, lone
    slabs and small level sheets.
    """
    switch, geometry = scene.settings.endless_ground, scene.geometry
    if switch == "off" or scene.settings.method == "raster" or geometry.n_faces == 0:
        return scene
    rim = outline(geometry)
    if isinstance(rim, str):
        return _add_note(scene, _open_rim(scene, rim))
    if _encloses(rim.distances(_center(scene)), scene):
        return scene
    of = geometry.face_material[rim.face]
    used = [scene.materials[i] for i in np.unique(of)]
    if switch == "auto" and not _is_ground(scene, rim, used):
        return scene
    if any(m.invisible or m.thickness or m.maps is not None for m in used):
        return _add_note(scene, _open_rim(scene, "has a material with maps or a thickness"))
    return _frame_rim(scene, rim, of)


def reach_of(image: ImageRequest, radar: Radar, geometry: Geometry) -> float:
    """Radius about the image's centre within which rays meet level ground, with their fade-out, twice, m."""
    look = np.array([image.center_x, image.center_y, image.height]) - radar.track.center_position
    cosine = max(float(-look[2] / np.linalg.norm(look)), _GRAZING)
    tangent = float(np.sqrt(1.0 - min(cosine, 1.0) ** 2)) / cosine
    tall = float(np.abs(geometry.bounds[:, 2] - image.height).max()) if geometry.n_faces else 0.0
    lit = float(np.hypot(image.extent_azimuth, image.extent_range)) / 2.0
    lit += tall * (tangent + min(10.0, 1.0 / max(tangent, 0.1)))  # double bounces, and layover
    fade = max(0.05 * lit, 10.0 * radar.waveform.range_cell) / cosine
    return 2.0 * (lit + fade)


def level_rim(geometry: Geometry) -> Rim | None:
    """Closed level outline around all shapes at their lowest level; None where there is none."""
    rim = outline(geometry)
    return rim if isinstance(rim, Rim) else None


def _center(scene: Scene) -> F64:
    """Middle (2,) of the image, m."""
    return np.array([scene.image.center_x, scene.image.center_y])


def _encloses(distances: F64, scene: Scene) -> bool:
    """Whether ground that ends at distances from the middle of the image, m, reaches beyond all rays."""
    return bool((distances >= reach_of(scene.image, scene.radar, scene.geometry) / 2.0).all())


def _is_ground(scene: Scene, rim: Rim, used: list[Material]) -> bool:
    """Whether a level sheet is ground by its size, with a coherent return; metal and slabs by the meshes on it."""
    if not _is_wide(rim.width, scene):
        return False
    top = float(rim.points[:, 2].max())
    above = scene.geometry.bounds[1, 2] > top + LEAST_WIDTH * LEVEL + LEAST_LEVEL
    if (rim.slab or any(m.metallic for m in used)) and not above:
        return False
    return _is_coherent(scene, used)


def _is_wide(width: float, scene: Scene) -> bool:
    return width >= max(LEAST_WIDTH, LEAST_CELLS * scene.radar.waveform.range_cell)


def _is_coherent(scene: Scene, used: list[Material]) -> bool:
    """Whether the smoothest of some materials has a coherent return as level ground."""
    radar, image = scene.radar, scene.image
    look = np.array([image.center_x, image.center_y, image.height]) - radar.track.center_position
    cosine = -look[2] / np.linalg.norm(look)
    k = 2.0 * np.pi / radar.waveform.wavelength
    loss = np.exp(-np.square(2.0 * k * cosine * min(m.rms_height for m in used)))
    return bool(db_from_power(loss) >= scene.settings.tolerance_db)


def _add_note(scene: Scene, note: str) -> Scene:
    return scene if not note or note in scene.notes else replace(scene, notes=(*scene.notes, note))


def _open_rim(scene: Scene, why: str) -> str:
    """Note on ground whose rim ends in the image, and why; empty where no sheet is ground by its size and its meshes.

    Such sheets are open meshes, or closed ones that are flat, which together cover ``LEAST_SHARE`` of the scene.
    """
    geometry = scene.geometry
    corner, mesh, n = geometry.vertices[geometry.faces], geometry.face_mesh, len(geometry.mesh_names)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    level = np.abs(normal[:, 2]) > np.hypot(normal[:, 0], normal[:, 1])
    plan = np.bincount(mesh, 0.5 * np.abs(normal[:, 2]) * level, n)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, mesh, corner.min(axis=1))
    np.maximum.at(high, mesh, corner.max(axis=1))
    size = high - low
    closed = geometry.closed_bodies() & (size[:, 2] > SLAB * size[:, :2].min(axis=1))
    sheet = ~closed & (plan >= LEAST_SHARE * np.bincount(mesh, 0.5 * np.linalg.norm(normal, axis=1), n))
    for _, rows in geometry.moving_meshes():
        sheet[mesh[rows]] = False
    if not sheet.any():
        return ""
    west_south, east_north = low[sheet, :2].min(axis=0), high[sheet, :2].max(axis=0)
    if plan[sheet].sum() < LEAST_SHARE * np.prod(np.ptp(geometry.bounds, axis=0)[:2]):
        return ""
    center, largest = _center(scene), int(np.argmax(np.where(sheet, plan, 0.0)))
    distances = np.concatenate([center - west_south, east_north - center])
    used = [scene.materials[i] for i in np.unique(geometry.face_material[sheet[mesh] & level])]
    lone = bool(sheet.all()) and (n == 1 or np.ptp(geometry.bounds[:, 2]) <= LEAST_LEVEL)
    if not _is_wide(float((east_north - west_south).min()), scene) or _encloses(distances, scene):
        return ""
    if (lone and any(m.metallic for m in used)) or not _is_coherent(scene, used):
        return ""
    if why == NOT_LEVEL and size[largest, 2] <= LEAST_LEVEL:
        why = BEYOND  # level itself, beside shapes that reach further out and deeper
    need = reach_of(scene.image, scene.radar, geometry) / 2.0
    return (
        f'{scene.name}: the rim of the ground "{geometry.mesh_names[largest]}" {why}, so that it ends there, and the '
        f"echo of this edge is in the image; give it one level rim around all shapes, or extend it to {need:.3g} m "
        "from the middle of the image"
    )


def _frame_rim(scene: Scene, rim: Rim, of: I32) -> Scene:
    """The scene with a frame of triangles about the rim, one side of it after the other."""
    geometry = scene.geometry
    materials, row_of = list(scene.materials), {}
    for i in np.unique(of).tolist():
        m = scene.materials[i]
        row_of[i] = len(materials)
        materials.append(
            replace(
                m,
                name=f"{m.name} (continued)",
                diffuse_law="none",
                diffuse_level_db=-np.inf,
                cross_polar_ratio_db=-np.inf,
                correlation_length=0.0,
                law_parameters=(),
                texture_shape=0.0,
                texture_length=0.0,
            )
        )
    reach = reach_of(scene.image, scene.radar, geometry) + float(np.linalg.norm(_center(scene) - rim.center))
    # the outline grows about its center until all its sides are farther than the reach
    factor = max(reach / float(rim.distances(rim.center).min()), 1.0) + 1.0
    z = rim.points[:, 2]
    far = [np.column_stack([xy, z]) for xy in _outer(rim, of, factor)]
    corners = np.concatenate([rim.points, rim.ends, *far])
    n, first = len(z), len(geometry.vertices)
    a, b, a_out, b_out = np.arange(4 * n).reshape(4, n)
    faces = np.concatenate([np.stack([a, a_out, b_out], axis=1), np.stack([a, b_out, b], axis=1)])
    names = (*geometry.mesh_names, ENDLESS_GROUND)
    values = {
        name: np.concatenate([rows, np.full((2 * n, *rows.shape[1:]), np.nan)])
        for name, rows in geometry.corner_values.items()
    }
    grown = replace(
        geometry,
        vertices=np.concatenate([geometry.vertices, corners]),
        faces=np.concatenate([geometry.faces, (first + faces).astype(np.int32)]),
        face_material=np.append(geometry.face_material, np.tile([row_of[i] for i in of.tolist()], 2)).astype(
            np.int32
        ),
        face_group=np.append(
            geometry.face_group, np.full(2 * n, geometry.face_group.max() + 1, dtype=np.int32)
        ),
        mesh_names=names,
        mesh_face_offset=np.append(geometry.mesh_face_offset, geometry.n_faces + 2 * n),
        mesh_convex=(*geometry.mesh_convex, False) if geometry.mesh_convex else (),
        mesh_endless=(*geometry.mesh_endless, True) if geometry.mesh_endless else (),
        mesh_motion=(*geometry.mesh_motion, STILL) if geometry.mesh_motion else (),
        corner_values=values,
    )
    shapes = list(dict.fromkeys(geometry.mesh_names[i] for i in geometry.face_mesh[rim.face].tolist()))
    shape = f'"{shapes[0]}"' + (f" and {len(shapes) - 1} more" if len(shapes) > 1 else "")
    note = (
        f"{scene.name}: the ground goes on beyond the level rim of {shape} at z = "
        f"{rim.height + scene.offset[2]:.4g} m, without clutter, so that the rim returns no echo; set endless_ground = "
        "off of sar_path to let it end there"
    )
    return replace(scene, geometry=grown, materials=tuple(materials), notes=(*scene.notes, note))


def _outer(rim: Rim, of: I32, factor: float) -> tuple[F64, F64]:
    """Outer ends of a frame about a rim, (n, 2) each, m, at the start and at the end of each side.

    Corners move away from the center; where two parts, materials or heights meet on a straight side, the line between
    them goes on square to it. Frames of two parts, in which tubes end at the side between them, have no side in common.
    """
    p = rim.points[:, :2]
    outer = np.asarray(rim.center + factor * (p - rim.center))
    along = rim.ends[:, :2] - p
    along = unit_rows(along)
    before = np.roll(along, 1, axis=0)
    turn = np.abs(before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0])
    apart = rim.part != np.roll(rim.part, 1)
    other = apart | (of != np.roll(of, 1)) | (rim.points[:, 2] != np.roll(rim.points[:, 2], 1))
    cut = other & (turn < _STRAIGHT) & (np.einsum("ni,ni->n", before, along) > 0.0)
    corner = np.flatnonzero(~cut)
    for i in np.flatnonzero(cut).tolist() if corner.size else []:
        k = int(np.searchsorted(corner, i))
        first, last = outer[corner[k - 1]], outer[corner[k % corner.size]]
        side = last - first
        share = float((p[i] - first) @ side / (side @ side))
        outer[i] = first + np.clip(share, 0.0, 1.0) * side
    ends = outer - np.where(apart, _GAP, 0.0)[:, None] * before
    return outer, np.roll(ends, -1, axis=0)
