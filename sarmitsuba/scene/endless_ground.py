"""Ground that goes on beyond the rim of its mesh, so that the rim returns no echo."""

from dataclasses import replace

import numpy as np

from sarmitsuba.arrays import F64, I32, I64
from sarmitsuba.materials.material import Material
from sarmitsuba.mesh.welding import weld
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.motion import STILL
from sarmitsuba.scene.scene import Scene
from sarmitsuba.units import db_from_power

# smallest width of a rim that is taken as that of ground, m, and in resolution cells: smaller level sheets are targets
LEAST_WIDTH, LEAST_CELLS = 10.0, 10.0
# a rim is level and outermost within this share of its size, and at least this, m: rounding of float32 files
LEVEL, LEAST_LEVEL = 1e-6, 1e-4
# depth below the rim up to which it is the lowest level, m: walls of buildings begin below their ground
DEPTH = 2.0
# smallest cosine of the incidence angle for lengths on the ground
_GRAZING = 0.05


def with_endless_ground(scene: Scene) -> Scene:
    """The scene with level ground continued beyond its rim, without clutter, and a note; the scene itself without any.

    Coherent ray tubes on a plane cancel with their neighbours, except at its rim: there the sum has the return of a
    plate's edge, and on metal its fringe currents. A rim is taken as that of ground where it is a closed level outline
    around the whole scene, at its lowest level, and at least ``LEAST_WIDTH`` and ``LEAST_CELLS`` wide; of metal, where
    a mesh stands on it. Triangles of the same surface continue it, without its diffuse return, to beyond the rays'
    launch window, where these fade out. Walls near the rim are mirrored by that ground, too.

    Notes
    -----
    Ground with maps of its properties, slabs, moving meshes, rims in several parts and outlines that are not seen whole
    from their centroid end where they end. So does ground in method ``raster``, which has no coherent return, and
    ground too rough for one: less than ``tolerance_db`` of a smooth one's. ``endless_ground`` of the settings is
    ``off``, or ``on`` for lone metal and small level sheets.
    """
    switch, geometry = scene.settings.endless_ground, scene.geometry
    if switch == "off" or scene.settings.method == "raster" or geometry.n_faces == 0:
        return scene
    rim = level_rim(geometry)
    if rim is None or _encloses(rim, geometry, scene):
        return scene
    of = geometry.face_material[rim.face]
    used = [scene.materials[i] for i in np.unique(of)]
    if any(m.invisible or m.thickness or m.maps is not None for m in used):
        return scene
    if switch == "auto" and not _is_ground(scene, rim, used):
        return scene
    return _continued(scene, rim, of)


class Rim:
    """Level outline of a mesh, counter-clockwise from above.

    Parameters
    ----------
    vertex : (n,) corners in turn
    face : (n,) face at the side from each corner to the next
    points : (n, 3) m, places of the corners
    """

    def __init__(self, vertex: I64, face: I64, points: F64) -> None:
        self.vertex, self.face, self.points = vertex, face, points
        x, y = points[:, :2].T
        x_next, y_next = np.roll(x, -1), np.roll(y, -1)
        cross = x * y_next - x_next * y
        self.area = 0.5 * float(cross.sum())
        moment = np.array([(x + x_next) @ cross, (y + y_next) @ cross])
        self.centroid: F64 = moment / (6.0 * self.area) if self.area > 0.0 else points[:, :2].mean(axis=0)

    @property
    def height(self) -> float:
        """Its level, m."""
        return float(self.points[:, 2].mean())

    @property
    def width(self) -> float:
        """Smaller side of its bounds, m."""
        return float(np.ptp(self.points[:, :2], axis=0).min())

    def distances(self, center: F64) -> F64:
        """Distances (n,) of the lines of its sides from a point (2,), m, positive inside."""
        a = self.points[:, :2]
        along = np.roll(a, -1, axis=0) - a
        to = center - a
        return np.asarray((along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]) / np.linalg.norm(along, axis=1))


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
    still = np.ones(geometry.n_faces, dtype=bool)
    for _, rows in geometry.moving_meshes():
        still[rows] = False
    faces = geometry.faces[still].astype(np.int64)
    if not len(faces):
        return None
    number = np.flatnonzero(still)
    v = geometry.vertices
    used = v[faces.reshape(-1)]
    low, high = used.min(axis=0), used.max(axis=0)
    slack = max(LEVEL * float((high - low)[:2].max()), LEAST_LEVEL)
    extreme = used[[*used[:, :2].argmin(axis=0), *used[:, :2].argmax(axis=0)], 2]
    level = float(extreme.min())
    if low[2] < level - DEPTH:
        return None
    # faces with a side at that level; those in it, and others that may stand on its rim
    at = np.abs(v[:, 2] - level) <= slack
    near = at[faces].sum(axis=1) >= 2
    faces, number = faces[near], number[near]
    flat = at[faces].all(axis=1)
    if not flat.any():
        return None
    corners = v[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    faces = np.where((flat & (across < 0.0))[:, None], faces[:, ::-1], faces)
    label = np.full(len(v), -1, dtype=np.int64)
    named = np.unique(faces)
    label[named] = weld(np.round(v[named] / slack))
    start, end = label[faces].reshape(-1), label[np.roll(faces, -1, axis=1)].reshape(-1)
    here = at[faces].reshape(-1) & at[np.roll(faces, -1, axis=1)].reshape(-1)
    n = int(label.max()) + 1
    key = np.minimum(start, end) * n + np.maximum(start, end)
    _, inverse, count = np.unique(key[here], return_inverse=True, return_counts=True)
    alone = np.flatnonzero(here)[count[inverse.reshape(-1)] == 1]
    alone = alone[np.repeat(flat, 3)[alone]]
    loop = _loop(start[alone], end[alone], label, faces.reshape(-1)[alone], v)
    if loop is None:
        return None
    sides = alone[loop]
    vertex = faces.reshape(-1)[sides]
    rim = Rim(vertex, number[sides // 3], v[vertex])
    outer = np.concatenate(
        [rim.points[:, :2].min(axis=0) - low[:2], high[:2] - rim.points[:, :2].max(axis=0)]
    )
    if rim.area <= 0.0 or (np.abs(outer) > slack).any() or (rim.distances(rim.centroid) <= 0.0).any():
        return None
    return rim


def _loop(start: I64, end: I64, label: I64, vertex: I64, v: F64) -> I64 | None:
    """Rows of the sides of the outline that has the westernmost corner, in turn; None where it branches or is open."""
    if not start.size or np.unique(start).size < start.size:
        return None
    following = dict(zip(start.tolist(), range(start.size), strict=True))
    first = int(np.argmin(v[vertex, 0]))
    rows, row = [first], following.get(int(end[first]))
    while row is not None and row != first and len(rows) <= start.size:
        rows.append(row)
        row = following.get(int(end[row]))
    return np.array(rows) if row == first else None


def _encloses(rim: Rim, geometry: Geometry, scene: Scene) -> bool:
    """Whether the ground already reaches beyond all rays."""
    center = np.array([scene.image.center_x, scene.image.center_y])
    return bool((rim.distances(center) >= reach_of(scene.image, scene.radar, geometry) / 2.0).all())


def _is_ground(scene: Scene, rim: Rim, used: list[Material]) -> bool:
    """Whether a level sheet is ground by its size, with a coherent return; metal by the meshes on it."""
    radar, image = scene.radar, scene.image
    cell = radar.waveform.range_cell
    if rim.width < max(LEAST_WIDTH, LEAST_CELLS * cell):
        return False
    above = scene.geometry.bounds[1, 2] > rim.height + LEAST_WIDTH * LEVEL + LEAST_LEVEL
    if any(m.metallic for m in used) and not above:
        return False
    look = np.array([image.center_x, image.center_y, image.height]) - radar.track.center_position
    cosine = -look[2] / np.linalg.norm(look)
    k = 2.0 * np.pi / radar.waveform.wavelength
    loss = np.exp(-np.square(2.0 * k * cosine * min(m.rms_height for m in used)))
    return bool(db_from_power(loss) >= scene.settings.tolerance_db)


def _continued(scene: Scene, rim: Rim, of: I32) -> Scene:
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
    center = np.array([scene.image.center_x, scene.image.center_y])
    reach = reach_of(scene.image, scene.radar, geometry) + float(np.linalg.norm(center - rim.centroid))
    # the outline grows about its centroid until all its sides are farther than the reach
    factor = max(reach / float(rim.distances(rim.centroid).min()), 1.0) + 1.0
    outer = rim.points.copy()
    outer[:, :2] = rim.centroid + factor * (outer[:, :2] - rim.centroid)
    n, first = len(rim.vertex), len(geometry.vertices)
    a = np.arange(n)
    b = np.roll(a, -1)
    faces = np.concatenate([np.stack([a, n + a, n + b], axis=1), np.stack([a, n + b, b], axis=1)])
    names = (*geometry.mesh_names, "endless ground")
    values = {
        name: np.concatenate([rows, np.full((2 * n, *rows.shape[1:]), np.nan)])
        for name, rows in geometry.corner_values.items()
    }
    grown = replace(
        geometry,
        vertices=np.concatenate([geometry.vertices, rim.points, outer]),
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
    shape = geometry.mesh_names[int(geometry.face_mesh[rim.face[0]])]
    note = (
        f'{scene.name}: the ground goes on beyond the level rim of "{shape}" at z = '
        f"{rim.height + scene.offset[2]:.4g} m, without clutter, so that the rim returns no echo; set endless_ground = "
        "off of sar_path to let it end there"
    )
    return replace(scene, geometry=grown, materials=tuple(materials), notes=(*scene.notes, note))
