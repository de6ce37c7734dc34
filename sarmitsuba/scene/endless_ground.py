"""Ground that goes on beyond the rim of its mesh, so that the rim returns no echo."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.ground_outline import BEYOND, LEAST_LEVEL, LEVEL, NOT_LEVEL, SLAB, Rim, outline
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.motion import STILL
from sarmitsuba.scene.scene import Scene

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


def with_endless_ground(scene: Scene) -> Scene:
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
        return _said(scene, _open_rim(scene, rim))
    if _encloses(rim.distances(_center(scene)), scene):
        return scene
    of = geometry.face_material[rim.face]
    used = [scene.materials[i] for i in np.unique(of)]
    if switch == "auto" and not _is_ground(scene, rim, used):
        return scene
    if any(m.invisible or m.thickness or m.maps is not None for m in used):
        return _said(scene, _open_rim(scene, "has a material with maps or a thickness"))
    return _continued(scene, rim, of)


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


def _said(scene: Scene, note: str) -> Scene:
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
    along /= np.linalg.norm(along, axis=1)[:, None]
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
