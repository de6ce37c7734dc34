"""The scene after loading: frozen, validated data without Mitsuba objects."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.registry import late, png_of
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.motion import STILL
from sarmitsuba.scene.scatterers import Target, joined_rows, targets_by_kind
from sarmitsuba.scene.settings import TraceSettings


@dataclass(frozen=True, eq=False)
class Scene:
    """All inputs of a simulation: geometry, materials, radar, settings and image request.

    Parameters
    ----------
    name : of the file, without suffix
    path : scene file, or None when it was built in memory
    geometry, materials, points : scatterers of the scene
    radar : sensor, with track and receive window
    settings, image : of the tracing; the image to focus
    offset : (3,) float64, m; scene frame = file frame - offset. Zero unless the geometry lies more than
        5 km, or 500 m and twenty times its own size, from the file's origin; whole metres then
    notes : one line each: assumptions and repairs made while loading
    description : parameters that radar and film were made from; None where they were not made from any
    scatterers : beside the meshes: wires, volumes that waves go through, and extensions' kinds, in the order of
        their kinds
    """

    name: str
    path: Path | None
    geometry: Geometry
    materials: tuple[Material, ...]
    points: tuple[PointTarget, ...]
    radar: Radar
    settings: TraceSettings
    image: ImageRequest
    offset: F64 = field(default_factory=lambda: np.zeros(3))
    notes: tuple[str, ...] = ()
    description: RadarInput | None = None
    scatterers: tuple[Target, ...] = ()

    @staticmethod
    def of(given: "SceneLike", **loading: object) -> "Scene":
        """A scene as it is; a scene file, or the name of a shipped scene, loaded.

        Parameters
        ----------
        given : scene, file or name
        loading : arguments of :func:`sarmitsuba.load_scene` for a file or a name; those that are None do not count

        Raises
        ------
        SceneError : anything else, a file that cannot be loaded, or arguments of loading for a scene that is loaded
        """
        wanted = {name: value for name, value in loading.items() if value is not None}
        if isinstance(given, Scene):
            if wanted:
                raise SceneError(
                    f"scene: {' and '.join(wanted)} belong to loading, and this scene is loaded already; give them to "
                    "load_scene, or here with the file"
                )
            return given
        if not isinstance(given, str | Path):
            remedy = "give a scene of load_scene or build_scene, a file, or the name of a shipped scene"
            if late("sarmitsuba.loading.build", "is_trimesh")(given):
                remedy = "give build_scene([SceneMesh.of(mesh, material)]), with a material for every mesh"
            raise SceneError(f"scene: {type(given).__name__} is no scene; {remedy}")
        scene = late("sarmitsuba.loading.load", "load_scene")(given, **wanted)
        assert isinstance(scene, Scene)
        return scene

    @property
    def anchor(self) -> Anchor:
        """Place on the Earth of the origin of the file's frame."""
        return self.radar.anchor

    @property
    def places(self) -> F64:
        """Positions of points and outlines of scatterers, (n, 3) float64, m, scene frame."""
        positions = np.array([p.position for p in self.points]).reshape(-1, 3)
        return np.concatenate([positions, self.source_places])

    @property
    def source_places(self) -> F64:
        """(n, 3) float64, m, scene frame: the same without ideal points."""
        return joined_rows((target.places for target in self.scatterers), (0, 3))

    @property
    def segments(self) -> F64:
        """(n, 2, 3) float64, m, scene frame: pieces of line of the scatterers, of points both ends the same."""
        return joined_rows((target.segments for target in self.scatterers), (0, 2, 3))

    @property
    def bodies(self) -> tuple[Target, ...]:
        """Scatterers that are bodies, outlined by their places."""
        return tuple(target for target in self.scatterers if not len(target.segments))

    def of_kind(self, kind: str) -> tuple[Target, ...]:
        """Scatterers with a bsdf, such as ``radar_wire``."""
        return tuple(target for target in self.scatterers if target.kind == kind)

    def without_kind(self, kind: str) -> "Scene":
        """The scene less the scatterers with a bsdf; itself where there are none."""
        left = tuple(target for target in self.scatterers if target.kind != kind)
        return self if len(left) == len(self.scatterers) else replace(self, scatterers=left)

    @property
    def wires(self) -> tuple[Target, ...]:
        """Wires of the scene."""
        return self.of_kind("radar_wire")

    @property
    def volumes(self) -> tuple[Target, ...]:
        """Volumes that waves go through."""
        return self.of_kind("radar_volume")

    @property
    def has_sources(self) -> bool:
        """True with scatterers that are not in the mesh and not ideal points."""
        return bool(self.scatterers)

    @property
    def traced(self) -> bool:
        """True with scatterers other than ideal points."""
        return self.geometry.n_faces > 0 or self.has_sources

    def same_shapes(self, other: "Scene") -> bool:
        """Whether another scene shares the same mesh and scatterers; ideal points are not compared."""
        return self.scatterers == other.scatterers and self.geometry.equals(other.geometry)

    def replace(self, **changes: object) -> "Scene":
        """Scene with other parameters and the same geometry: ``scene.replace(look_angle_deg=40.0, prf=900.0)``.

        Parameters
        ----------
        changes : parameters of ``sar_antenna``, ``range_film`` and ``sar_path`` by their names in the scene format,
            effects included; or ``name``

        Raises
        ------
        SceneError, RadarError : one line: an unknown name, a value out of bounds, or a parameter that materials and
            shapes depend on while loading
        """
        scene = late("sarmitsuba.loading.changes", "change_scene")(self, changes)
        assert isinstance(scene, Scene)
        return scene

    @property
    def moves(self) -> bool:
        """True where some mesh or point moves."""
        return self.geometry.moves or any(not point.motion.still for point in self.points)

    def frozen(self) -> "Scene":
        """The scene at rest in its position at time zero."""
        if not self.moves:
            return self
        points = tuple(replace(point, motion=STILL) for point in self.points)
        return replace(self, geometry=self.geometry.frozen(), points=points)

    def __repr__(self) -> str:
        radar, image = self.radar, self.image
        moving = len(self.geometry.moving_meshes()) + sum(not p.motion.still for p in self.points)
        parts = [
            f"{self.geometry.n_faces} faces in {len(self.geometry.mesh_names)} meshes",
            f"{len(self.points)} points" if self.points else "",
            *(f"{len(mine)} {kind.plural}" for kind, mine in targets_by_kind(self.scatterers).items()),
            f"{moving} moving" if moving else "",
            f"{radar.mode} {radar.waveform.center_frequency / 1e9:.4g} GHz {'/'.join(radar.channels)}",
            f"{radar.track.n_pulses} pulses",
            f"{image.grid} image of {image.extent_azimuth:.4g} m x {image.extent_range:.4g} m",
        ]
        return f"Scene({self.name!r}: {', '.join(part for part in parts if part)})"

    def _repr_png_(self) -> bytes:
        """Plan view of the scene, for notebooks."""
        return png_of(self.plot())

    def plot(self) -> object:
        """Plan view as a Matplotlib ``Figure``, which notebooks show: faces by height, image, flight, look and beam."""
        return late("sarmitsuba.view.notebook", "scene_plan")(self)


# a scene, its file, or the name of a shipped one
SceneLike = Scene | Path | str
