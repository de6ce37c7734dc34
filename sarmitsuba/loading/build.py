"""Scenes made in Python: the same `Scene` as from a file, from meshes, points and a radar description."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Value, fill_description
from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.loading.assemble import MeshSurface
from sarmitsuba.loading.attributes import spread_to_corners
from sarmitsuba.loading.collect import Collector
from sarmitsuba.loading.describe import Described
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.scatterer_shapes import ShapeKind
from sarmitsuba.loading.tables import INTEGRATOR, RADAR_MATERIAL
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.description import RadarDescription, RadarInput
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.motion import STILL, Motion
from sarmitsuba.scene.scatterers import SCATTERERS, Medium, Target
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings

if TYPE_CHECKING:
    import trimesh

# a `Material`, the name of one (``pec`` or of ITU-R P.2040-3), or parameters of ``radar_material``
MaterialLike = Material | str | Mapping[str, Value]


@dataclass(frozen=True, eq=False)
class SceneMesh:
    """Triangles and their material.

    Parameters
    ----------
    vertices : (n_vertices, 3) float, m, converted to float64
    faces : (n_faces, 3) vertex numbers
    material : a `Material`; ``pec`` or the name of a material of ITU-R P.2040-3; or parameters of ``radar_material``
        by name, such as ``{"material": "concrete", "rms_height": 0.005}``
    name : for notes and errors
    smooth : all faces belong to one smooth surface, however much they bend
    to_world : (4, 4) affine matrix applied to the vertices; None leaves them
    motion : translation from that place, such as ``Motion(velocity=(0.0, 8.0, 0.0))``
    attributes : used by maps of the material: ``uv`` (n_vertices, 2), ``vertex_NAME`` (n_vertices,) or
        ``face_NAME`` (n_faces,), 0 to 1
    """

    vertices: ArrayLike
    faces: ArrayLike
    material: MaterialLike
    name: str = "mesh"
    smooth: bool = False
    to_world: ArrayLike | None = None
    motion: Motion = STILL
    attributes: Mapping[str, ArrayLike] = field(default_factory=dict)

    @staticmethod
    def of(
        mesh: "trimesh.Trimesh",
        material: MaterialLike,
        name: str = "mesh",
        *,
        smooth: bool = False,
        to_world: ArrayLike | None = None,
        motion: Motion = STILL,
    ) -> "SceneMesh":
        """Mesh from the triangles of a `trimesh.Trimesh`; the other arguments are those of the class."""
        return SceneMesh(mesh.vertices, mesh.faces, material, name, smooth, to_world, motion)


@dataclass(frozen=True, eq=False)
class SceneVolume:
    """A closed volume that waves go through, such as the crown of a tree.

    Parameters
    ----------
    vertices : (n_vertices, 3) float, m, of a closed mesh
    faces : (n_faces, 3) vertex numbers
    medium : a :class:`sarmitsuba.scene.materials.vegetation.canopy.VolumeMedium`; the name of a preset, such as
        ``"deciduous_summer"``; or parameters of ``radar_volume`` by name
    name : for notes and errors
    """

    vertices: ArrayLike
    faces: ArrayLike
    medium: Medium | str | Mapping[str, Value]
    name: str = "volume"


@exclusive
def build_scene(
    meshes: Sequence[SceneMesh] = (),
    points: Sequence[PointTarget] = (),
    wires: Sequence[Target] = (),
    *,
    volumes: Sequence[SceneVolume] = (),
    scatterers: Sequence[Target] = (),
    radar: RadarDescription | None = None,
    film: FilmDescription | None = None,
    settings: TraceSettings | None = None,
    track: Track | None = None,
    ground: str | Mapping[str, Value] | None = None,
    ground_level: float | None = None,
    name: str = "scene",
) -> Scene:
    """Build a scene without a file.

    Parameters
    ----------
    meshes, points, wires, volumes, scatterers : content of the scene, m; triangles of trimesh by ``SceneMesh.of``
    radar, film : the parameters of ``sar_antenna`` and ``range_film``; None takes their defaults
    settings : of the tracing; None takes the defaults and the film's ``gridding_width``
    track : antenna positions in the frame of the meshes, in place of the radar's slant range, angles, speed, prf,
        number of pulses and azimuth resolution
    ground : material of level ground to add, such as ``soil``, or parameters of ``radar_material`` by name
    ground_level : its height, m; None: the scene's lowest level
    name : of the scene

    Returns
    -------
    the scene; its frame is shifted by ``Scene.offset`` when the geometry lies far from the origin

    Raises
    ------
    SceneError, RadarError : one line: object, value with unit, bound, remedy

    Warns
    -----
    SarmitsubaWarning : ambiguities, or diffuse laws used outside their domain

    Notes
    -----
    Meshes that share one material object, or equal descriptions of one, share it in the scene.
    """
    _check_meshes(meshes, name)
    described = _describe_radar(radar or RadarDescription(), film or FilmDescription(), settings, track)
    collector = Collector(name, None, described)
    elements: list[tuple[MaterialLike, int]] = []
    for mesh in meshes:
        index = next((i for known, i in elements if known == mesh.material), None)
        if index is None:
            index = _material(collector, mesh, name)
            elements.append((mesh.material, index))
        collector.surfaces.append(_surface(mesh, index, name))
    for point in points:
        _check_point(point, name)
    collector.points.extend(points)
    collector.scatterers.extend([*wires, *scatterers])
    for volume in volumes:
        _add_volume(collector, volume, name)
    if ground is not None:
        collector.add_ground_of(ground, ground_level)
    return collector.scene()


def is_trimesh(value: object) -> bool:
    """Whether a value is of the package trimesh, which need not be imported."""
    return type(value).__module__.partition(".")[0] == "trimesh"


def _check_meshes(meshes: Sequence[SceneMesh], label: str) -> None:
    given = [meshes] if is_trimesh(meshes) else list(meshes)
    for mesh in given:
        if not isinstance(mesh, SceneMesh):
            parts = ".dump()" if is_trimesh(mesh) and type(mesh).__name__ == "Scene" else ""
            what = f"for mesh in scene{parts}" if parts else "for mesh in meshes"
            raise SceneError(
                f'{label}: {type(mesh).__name__} has no material; give build_scene([SceneMesh.of(mesh, "concrete") '
                f"{what}])"
            )


# largest radar cross section of an ideal point, m^2: 200 dBsm
_LARGEST_RCS = 1e20


def _check_point(point: PointTarget, label: str) -> None:
    if not isinstance(point, PointTarget):
        raise SceneError(f"{label}: {type(point).__name__} is no PointTarget")
    where = f'{label}: point "{point.name}"'
    try:
        place = np.asarray(point.position, dtype=np.float64)
        power, phase = float(point.rcs), float(point.phase)
    except (TypeError, ValueError):
        raise SceneError(f"{where}: position, rcs and phase must be numbers") from None
    if place.shape != (3,) or not np.isfinite(place).all():
        raise SceneError(f"{where}: position {place.tolist()} is not three finite numbers, m")
    if not 0.0 <= power <= _LARGEST_RCS or not np.isfinite(phase):
        raise SceneError(
            f"{where}: rcs = {power:g} m^2 is outside 0 to {_LARGEST_RCS:g}, or its phase is not finite"
        )


def _describe_radar(
    radar: RadarDescription, film: FilmDescription, settings: TraceSettings | None, track: Track | None
) -> Described:
    if settings is None:
        settings = TraceSettings(gridding_width=film.gridding_width)
    elif film.gridding_width not in (settings.gridding_width, FilmDescription().gridding_width):
        raise SceneError(
            f"FilmDescription: gridding_width = {film.gridding_width}, but the settings say "
            f"{settings.gridding_width}; give it to TraceSettings only"
        )
    given = {f.name: getattr(settings, f.name) for f in fields(settings) if f.name != "effects"}
    read = INTEGRATOR.read(given | dict(settings.effects), type(settings).__name__, python=True)
    effects = {effect.name: read[effect.name] for effect in switchable_effects()}
    return Described(RadarInput.of(radar, film, track), fill_description(settings, {"effects": effects}))


def _material(collector: Collector, mesh: SceneMesh, label: str) -> int:
    material = mesh.material
    taken = {known.name for known in collector.book.materials}
    if isinstance(material, Material):
        if material.name in taken:
            raise SceneError(f'{label}: two materials are named "{material.name}"; rename one')
        return collector.book.add(material, label)
    values: Mapping[str, Value] = {"material": material} if isinstance(material, str) else material
    where = f'{label}: material of mesh "{mesh.name}"'
    name = str(values.get("material", "")) or mesh.name
    if name in taken:
        name = f"{name}_{len(taken) + 1}"
    element = Element("bsdf", RADAR_MATERIAL.plugin, name, where, Path(), dict(values))
    return collector.book.index(element, where)


def _add_volume(collector: Collector, volume: SceneVolume, label: str) -> None:
    where = f'{label}: volume "{volume.name}"'
    vertices, faces = _triangles(volume.vertices, volume.faces, where)
    kind, content = SCATTERERS["radar_volume"], volume.medium
    assert isinstance(kind, ShapeKind)
    if isinstance(content, str | Mapping):
        values: Mapping[str, Value] = {"preset": content} if isinstance(content, str) else content
        name = str(values.get("preset", "")) or volume.name
        element = Element("bsdf", kind.name, name, where, Path(), dict(values))
        filling: Element | Medium = collector.reading.known(element)
    else:
        filling = content
    collector.scatterers += kind.read_mesh(volume.name, vertices, faces, filling, where, collector.reading)


def _triangles(vertices: ArrayLike, faces: ArrayLike, where: str) -> tuple[F64, I32]:
    """Vertices (n, 3) float64 and faces (n, 3) int32, checked."""
    try:
        v, f = np.array(vertices, dtype=np.float64), np.array(faces)
    except ValueError as error:
        raise SceneError(f"{where}: {error}; give vertices and faces as (n, 3) arrays") from None
    if v.ndim != 2 or v.shape[1] != 3:
        raise SceneError(f"{where}: vertices have the shape {v.shape}, not (n, 3); give one point per row")
    if f.ndim != 2 or f.shape[1] != 3 or not np.issubdtype(f.dtype, np.integer):
        raise SceneError(
            f"{where}: faces have the shape {f.shape} and type {f.dtype}, not (n, 3) integers; give three "
            "vertex numbers per row"
        )
    if f.size and not (0 <= f.min() and f.max() < v.shape[0]):
        raise SceneError(
            f"{where}: faces refer to vertices {f.min()} to {f.max()} of {v.shape[0]}; count from 0"
        )
    return v, f.astype(np.int32)


def _surface(mesh: SceneMesh, material: int, label: str) -> MeshSurface:
    where = f'{label}: mesh "{mesh.name}"'
    vertices, faces = _triangles(mesh.vertices, mesh.faces, where)
    if mesh.to_world is not None:
        matrix = np.array(mesh.to_world, dtype=np.float64)
        if matrix.shape != (4, 4) or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
            raise SceneError(f"{where}: to_world is not an affine (4, 4) matrix; its last row is 0, 0, 0, 1")
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    faces = faces.astype(np.int32)
    values = spread_to_corners(mesh.attributes, faces, where)
    return MeshSurface(
        mesh.name, vertices, faces, material, mesh.smooth, motion=mesh.motion, corner_values=values
    )
