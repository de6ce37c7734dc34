"""Assemble a scene from surfaces, points and parameters: clean and centre the meshes, group faces, build the radar."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning, SceneError
from sarmitsuba.core.parameters import printable
from sarmitsuba.loading.notes import warn_once
from sarmitsuba.loading.radar_ground import LevelGround
from sarmitsuba.radar.builder import build_radar
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.image_request import Extent, ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.materials.diffuse import FEW_ANGLES, diffuse_tables
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.cleaning import JoinedMeshes, clean_meshes
from sarmitsuba.scene.mesh.convexity import is_convex_body
from sarmitsuba.scene.mesh.model_units import doubtful_unit
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.scene.motion import STILL, Motion
from sarmitsuba.scene.round_facets import RoundFacets
from sarmitsuba.scene.scatterers import SCATTERERS, Target, joined_rows
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings

# beyond this distance from the file's origin the scene gets an origin near the geometry: float32 positions stay exact
# to 1 mm
RECENTRE_DISTANCE = 5e3
# the same for small scenes, over the diagonal of their bounds
RECENTRE_SIZES = 20.0
# least distance, m: 3e-5 m of rounding
LEAST_RECENTRED = 500.0
# coordinates beyond this are taken as an error of units
MAX_COORDINATE = 1e9
_MAX_MESH_NOTES = 12
# most faces of a single mesh that is tested for convexity: about 0.2 s
MAX_PROVEN_FACES = 200_000


@dataclass(frozen=True, eq=False)
class MeshSurface:
    """Triangles of one mesh and their material.

    Parameters
    ----------
    name : of the mesh
    vertices : (n_v, 3) float64, m, file frame
    faces : (n_f, 3) int32
    material : index into the scene's materials
    smooth : all faces belong to one smooth surface, however much they bend
    convex : the shape is always one closed convex body
    motion : translation from that place
    corner_values : mesh attributes used by material maps, see `Geometry.corner_values`
    """

    name: str
    vertices: F64
    faces: I32
    material: int
    smooth: bool = False
    convex: bool = False
    motion: Motion = STILL
    corner_values: Mapping[str, F64] = field(default_factory=dict)


def assemble(
    name: str,
    path: Path | None,
    surfaces: Sequence[MeshSurface],
    materials: Sequence[Material],
    points: Sequence[PointTarget],
    radar: RadarInput,
    settings: TraceSettings,
    notes: Sequence[str] = (),
    scatterers: Sequence[Target] = (),
    grounds: Sequence[LevelGround] = (),
) -> Scene:
    """Scene of cleaned and centred geometry with its radar.

    Parameters
    ----------
    name, path : of the file
    surfaces, points : in the file frame
    materials : list that ``MeshSurface.material`` indexes
    radar : validated parameters of sensor and film
    settings : of the integrator
    notes : collected so far
    scatterers, grounds : in the file frame

    Raises
    ------
    SceneError : the scene has no scatterers, or a mesh cannot be repaired
    RadarError : the radar does not see the scene
    """
    label = printable(path.name if path else name)
    visible = any(
        not materials[i].invisible for i in [*(s.material for s in surfaces), *(g.material for g in grounds)]
    )
    scatterers = sorted(scatterers, key=lambda target: SCATTERERS[target.kind].rank)
    for target in scatterers:
        kind = SCATTERERS[target.kind]
        if kind.needs_surface and not visible:
            raise SceneError(
                f'{label}: no surface below the {kind.mechanism} "{target.name}"; add ground, a shape with a '
                "radar_material"
            )
    if not visible and not points and not scatterers:
        what = "every shape is invisible" if surfaces else "there is no shape"
        raise SceneError(
            f"{label}: the scene has no scatterers: {what}; add a shape with a bsdf, a point_scatterer or a radar_wire"
        )
    geometry, repairs = _geometry(label, surfaces)
    doubts: list[str] = []
    if doubt := doubtful_unit(geometry.vertices[geometry.faces]):
        warn_once(
            doubts, f"{label}: the geometry is not in metres, {doubt}; scale it by to_world (0.001 from mm)"
        )
    facets = RoundFacets.of(geometry, materials, SPEED_OF_LIGHT / radar.sensor.center_frequency)
    if facets.doubt:
        warn_once(doubts, f"{label}: {facets.doubt}")
    for point in points:
        _check_size(f'{label}: point_scatterer "{point.name}"', point.position)
    for target in scatterers:
        _check_size(f'{label}: {target.kind} "{target.name}"', target.places)
    places = joined_rows(
        [*(np.asarray(p.position, dtype=np.float64)[None] for p in points), *(t.places for t in scatterers)],
        (0, 3),
    )
    if geometry.n_faces or len(places):
        offset = _offset(geometry, places)
    else:
        offset = np.zeros(3)
    if grounds:
        grounds = sorted(grounds, key=lambda ground: ground.extent is None)
        laid, said = _ground_surfaces(label, grounds, geometry, places, radar, offset)
        notes, surfaces = (*notes, *said), (*surfaces, *laid)
        geometry, repairs = _geometry(label, surfaces)
        endless = [False] * (len(surfaces) - len(laid)) + [ground.extent is None for ground in grounds]
        geometry = replace(geometry, mesh_endless=tuple(endless) if any(endless) else ())
    geometry = replace(geometry, vertices=geometry.vertices - offset)
    moved = tuple(replace(p, position=p.position - offset) for p in points)
    if offset.any():
        materials = [m if m.maps is None else replace(m, maps=m.maps.moved(offset)) for m in materials]
    used = list(dict.fromkeys(list_with_parts([materials[s.material] for s in surfaces])))
    built, image, radar_notes = seen_by(label, geometry, places - offset, used, radar, offset)
    return Scene(
        name=printable(name),
        path=path,
        geometry=geometry,
        materials=tuple(materials),
        points=moved,
        radar=built,
        settings=settings,
        image=image,
        offset=offset,
        notes=(*notes, *repairs, *doubts, *radar_notes, *_black(label, surfaces, materials)),
        description=radar,
        scatterers=tuple(target.moved(-offset) for target in scatterers),
    )


def seen_by(
    label: str,
    geometry: Geometry,
    places: F64,
    materials: Sequence[Material],
    radar: RadarInput,
    offset: F64,
) -> tuple[Radar, ImageRequest, tuple[str, ...]]:
    """Radar and image request of a description over a geometry, and notes.

    Parameters
    ----------
    label : start of notes
    geometry : in the scene frame
    places : (n, 3) m, positions of scatterers that are not in the mesh
    materials : those that occur in the geometry
    radar : in the file frame
    offset : (3,) m, of the scene frame
    """
    built, image, notes = build_radar(radar, _extent(geometry, places), offset)
    angle_notes: list[str] = []
    for material in materials:
        _check_angle(label, material, built, image, angle_notes)
    return built, image, (*notes, *angle_notes)


def _ground_surfaces(
    label: str,
    grounds: Sequence[LevelGround],
    geometry: Geometry,
    places: F64,
    radar: RadarInput,
    offset: F64,
) -> tuple[list[MeshSurface], list[str]]:
    """Surfaces of ground, as large as the image of all else needs, in the file frame, and notes."""
    bare = replace(geometry, vertices=geometry.vertices - offset)
    seen = places - offset
    if not geometry.n_faces and not len(places):
        seen = np.array([[0.0, 0.0, min(ground.height(geometry, places) for ground in grounds)]])
    with warnings.catch_warnings():  # those of the radar follow when it sees the whole scene
        warnings.simplefilter("ignore", SarmitsubaWarning)
        built, image, _ = seen_by(label, bare, seen, (), radar, offset)
    laid, notes = [], []
    for ground in grounds:
        vertices, faces, note = ground.triangles(geometry, places, image, built, offset)
        laid.append(MeshSurface(ground.name, vertices, faces, ground.material))
        notes.append(note)
    return laid, notes


# start of the note on a scene without any diffuse return
NO_CLUTTER = "no material has a diffuse law: the image is black"


def _black(label: str, surfaces: Sequence[MeshSurface], materials: Sequence[Material]) -> list[str]:
    """Warn that a scene without any diffuse return gives a black image except for mirror reflections."""
    seen = list_with_parts([m for m in (materials[s.material] for s in surfaces) if not m.invisible])
    if not seen or any(material.diffuse_law != "none" for material in seen):
        return []
    return [
        f"{label}: {NO_CLUTTER} except for edges, corners and faces in specular direction; give diffuse_law, or "
        "rms_height and correlation_length, to materials that should show as clutter"
    ]


def _check_angle(label: str, material: Material, radar: Radar, image: ImageRequest, notes: list[str]) -> None:
    """Warn where level ground is seen at an incidence angle outside the validity of the material's diffuse law."""
    table = diffuse_tables(material, radar.waveform.wavelength, FEW_ANGLES)
    look = np.array([image.center_x, image.center_y, image.height]) - radar.track.center_position
    incidence = float(np.arccos(np.clip(-look[2] / np.linalg.norm(look), -1.0, 1.0)))
    if table.valid_from < table.valid_to and not table.valid_from <= incidence <= table.valid_to:
        first, last, seen = np.degrees([table.valid_from, table.valid_to, incidence])
        warn_once(
            notes,
            f'{label}: material "{material.name}": level ground is seen at {seen:.1f} deg, outside the {first:.0f} ... '
            f"{last:.0f} deg where diffuse_law = {material.diffuse_law} holds; take another law or look angle",
        )


def _geometry(label: str, surfaces: Sequence[MeshSurface]) -> tuple[Geometry, list[str]]:
    if not surfaces:
        return Geometry.empty(), []
    if not (np.abs(np.concatenate([s.vertices for s in surfaces])) <= MAX_COORDINATE).all():
        for surface in surfaces:
            _check_size(f'{label}: mesh "{surface.name}"', surface.vertices)
    try:
        joined = clean_meshes(
            [s.name for s in surfaces], [s.vertices for s in surfaces], [s.faces for s in surfaces]
        )
    except SceneError as error:
        raise SceneError(f"{label}: {error}") from error
    v, f, notes = joined.vertices, joined.faces, joined.notes
    convex = [s.convex and not repaired for s, repaired in zip(surfaces, joined.repaired, strict=True)]
    if len(surfaces) == 1 and f.shape[0] <= MAX_PROVEN_FACES:
        # convexity is of no use with several bodies
        convex = [convex[0] or is_convex_body(v, f)]
    if len(notes) > _MAX_MESH_NOTES:
        notes = [
            *notes[:_MAX_MESH_NOTES],
            f"... and {len(notes) - _MAX_MESH_NOTES} more such repairs of meshes",
        ]
    counts = np.bincount(joined.mesh, minlength=len(surfaces))
    geometry = Geometry(
        vertices=v,
        faces=f,
        face_material=np.array([s.material for s in surfaces], dtype=np.int32)[joined.mesh],
        face_group=_groups(joined, np.array([s.smooth for s in surfaces])),
        mesh_names=tuple(s.name for s in surfaces),
        mesh_face_offset=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        mesh_convex=tuple(convex),
        mesh_motion=() if all(s.motion.still for s in surfaces) else tuple(s.motion for s in surfaces),
        corner_values=_corner_values(surfaces, joined),
    )
    return geometry, [f"{label}: {note}" for note in notes]


def _corner_values(surfaces: Sequence[MeshSurface], joined: JoinedMeshes) -> dict[str, F64]:
    """Attributes of all meshes at the corners of the remaining faces; NaN where a mesh has none."""
    out = {}
    for name in sorted({name for s in surfaces for name in s.corner_values}):
        columns = 2 if name == "uv" else 1
        parts = [s.corner_values.get(name, np.full((len(s.faces), 3, columns), np.nan)) for s in surfaces]
        out[name] = np.concatenate(parts)[joined.kept]
    return out


def _groups(joined: JoinedMeshes, smooth: NDArray[np.bool_]) -> I32:
    """Smooth group of every face, (n_f,) int32; a mesh marked in ``smooth``, (n_meshes,), is one group."""
    whole = smooth[joined.mesh]
    facets = ~whole
    label = joined.mesh + joined.mesh.size  # numbers above those of all other groups
    label[facets] = smooth_groups(joined.vertices, joined.faces[facets], mesh=joined.mesh[facets])
    if not whole.any():
        return label.astype(np.int32)
    # numbered in the order of their first faces
    _, first, group = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(first.size, dtype=np.int32)
    rank[np.argsort(first)] = np.arange(first.size)
    return rank[group.reshape(-1)]


def _check_size(what: str, coordinates: F64) -> None:
    """Raise a SceneError for a finite coordinate beyond `MAX_COORDINATE`; the mesh check handles others."""
    size = np.abs(coordinates)
    if (
        not (size <= MAX_COORDINATE).all()
        and (size := size[np.isfinite(size)]).max(initial=0.0) > MAX_COORDINATE
    ):
        largest = float(size.max())
        raise SceneError(
            f"{what}: coordinate {largest:g} m lies beyond {MAX_COORDINATE:g} m; check units and to_world"
        )


def _bounds(geometry: Geometry, places: F64) -> F64:
    """(2, 3) bounds of triangles and places (n, 3) together, m."""
    cloud = np.concatenate([places, geometry.bounds]) if geometry.n_faces else places
    return np.stack([cloud.min(axis=0), cloud.max(axis=0)])


def _extent(geometry: Geometry, places: F64) -> Extent:
    """Extent of all scatterers; the default aim point is its middle, at the height of the ground."""
    bounded = geometry.without_endless()
    endless = geometry.vertices[geometry.faces[bounded.n_faces :].reshape(-1)]
    if not bounded.n_faces and not len(places):
        places = endless.mean(axis=0, keepdims=True)
    low, high = _bounds(bounded, places)
    height = bounded.ground_height if bounded.n_faces else float(np.median(places[:, 2]))
    if len(endless):
        height = float(endless[0, 2])
    middle = np.array([*(0.5 * (low + high)[:2]), height])
    return Extent(
        np.concatenate([bounded.vertices, places]), middle, bounded.faces, endless if len(endless) else None
    )


def _offset(geometry: Geometry, places: F64) -> F64:
    bounds = _bounds(geometry, places)
    center, size = bounds.mean(axis=0), float(np.linalg.norm(bounds[1] - bounds[0]))
    limit = min(RECENTRE_DISTANCE, max(RECENTRE_SIZES * size, LEAST_RECENTRED))
    if float(np.linalg.norm(center)) <= limit:
        return np.zeros(3)
    return np.asarray(np.round(center))
