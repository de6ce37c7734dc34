"""What a scene is after loading: frozen, validated data without any Mitsuba object in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

DiffuseLaw = Literal[
    "none",
    "lambert",
    "constant",
    "constant_gamma",
    "kirchhoff",
    "small_perturbation",
    "iem",
    "roughness",
]
Method = Literal["raw", "hybrid", "image", "raster"]
Switch = Literal["auto", "on", "off"]

DIFFUSE_LAWS: tuple[DiffuseLaw, ...] = (
    "none",
    "lambert",
    "constant",
    "constant_gamma",
    "kirchhoff",
    "small_perturbation",
    "iem",
    "roughness",
)
METHODS: tuple[Method, ...] = ("raw", "hybrid", "image", "raster")
# an effect whose absence changes the image by less than this is left out, dB of the image's clutter or peak
TOLERANCE_DB = -40.0
EFFECT_NAMES: tuple[str, ...] = (
    "fresnel",
    "roughness",
    "coherent",
    "diffuse",
    "speckle",
    "cross_polarisation",
    "antenna_pattern",
    "spreading",
    "visibility",
    "tube_phase",
    "diffuse_double",
    "cell_sharing",
    "noise",
    "depolarisation",
    "trajectory",
)


@dataclass(frozen=True)
class Material:
    """Electromagnetic surface of a half space, at the carrier frequency.

    Parameters
    ----------
    name : unique in a scene
    pec : perfect electric conductor; ``permittivity`` is then ignored
    permittivity : relative, ``eps' - j eps''`` with ``eps'' >= 0`` (time convention exp(+j w t))
    rms_height : m; standard deviation of the surface height, reduces the coherent reflection
    diffuse_law : how the incoherent return depends on angle; ``roughness`` is Lambert's law with the power
        that the coherent wave lost to the rms height
    diffuse_level_db : sigma0 (``constant``), gamma (``constant_gamma``) or 4 * albedo (``lambert``, sigma0 at
        normal incidence), dB
    correlation_length : m; of the surface height, for the laws derived from a height spectrum
    cross_polar_ratio_db : cross- over co-polar diffuse power, dB; -inf for none
    invisible : neither reflects nor blocks (permittivity 1)

    Notes
    -----
    Ignores transmission through the surface, thickness, anisotropy and magnetic materials.
    """

    name: str
    pec: bool = False
    permittivity: complex = 1.0 + 0.0j
    rms_height: float = 0.0
    diffuse_law: DiffuseLaw = "none"
    diffuse_level_db: float = -np.inf
    correlation_length: float = 0.0
    cross_polar_ratio_db: float = -np.inf
    invisible: bool = False


@dataclass(frozen=True, eq=False)
class Geometry:
    """All triangles of a scene in one list, mesh after mesh.

    Parameters
    ----------
    vertices : (n_vertices, 3) float64, m, scene frame
    faces : (n_faces, 3) int32 vertex numbers
    face_material : (n_faces,) int32 index into ``Scene.materials``
    face_group : (n_faces,) int32; faces of one group form one smooth surface (they share diffuse anchors)
    mesh_names : n_meshes names
    mesh_face_offset : (n_meshes + 1,) int64; mesh i has the faces ``offset[i]:offset[i + 1]``
    mesh_convex : n_meshes, True where the mesh is known to be one closed convex body; empty: none is
    """

    vertices: F64
    faces: I32
    face_material: I32
    face_group: I32
    mesh_names: tuple[str, ...]
    mesh_face_offset: NDArray[np.int64]
    mesh_convex: tuple[bool, ...] = ()

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return int(self.faces.shape[0])

    @property
    def bounds(self) -> F64:
        """(2, 3) float64 lower and upper corner, m, scene frame; zeros when there are no vertices."""
        if self.vertices.shape[0] == 0:
            return np.zeros((2, 3))
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def diameter(self) -> float:
        """Diagonal of the bounds, m."""
        low, high = self.bounds
        return float(np.linalg.norm(high - low))

    @staticmethod
    def empty() -> "Geometry":
        """Geometry without a triangle, for scenes of ideal points only."""
        return Geometry(
            vertices=np.zeros((0, 3)),
            faces=np.zeros((0, 3), dtype=np.int32),
            face_material=np.zeros(0, dtype=np.int32),
            face_group=np.zeros(0, dtype=np.int32),
            mesh_names=(),
            mesh_face_offset=np.zeros(1, dtype=np.int64),
        )


@dataclass(frozen=True, eq=False)
class PointTarget:
    """Ideal isotropic scatterer, the same in every polarisation; hidden when a mesh stands before it.

    Parameters
    ----------
    name : of the shape it came from
    position : (3,) float64, m, scene frame
    rcs : m^2
    phase : rad, of its reflectivity
    """

    name: str
    position: F64
    rcs: float = 1.0
    phase: float = 0.0


@dataclass(frozen=True)
class TraceSettings:
    """How to trace; zero means automatic where the parameter says so.

    Parameters
    ----------
    method : ``raw`` (every pulse traced), ``hybrid`` (key pulses), ``image`` (one look),
        ``raster`` (one bounce)
    max_depth : most bounces; 0 = automatic
    ray_spacing : m, distance between rays in the launch plane; 0 = automatic
    diffuse_ray_spacing : m, of the rays that find diffuse scatterers; 0 = automatic, at least ``ray_spacing``
    key_pulse_interval : pulses that share one tracing; 0 = automatic
    scatterer_cell : m, side of the cells that carry one persistent diffuse scatterer; 0 = automatic
    gridding_width : samples that one contribution is spread over
    seed : of every random number
    keep_orders : keep contributions of different bounce numbers apart
    keep_halves : keep two independent halves of the rays apart
    phase_precision : arithmetic of path lengths and phases
    tolerance_db : an effect that changes the image by less is left out, dB of its clutter or peak; below 0
    target_error_db : dB of the image's clutter or peak; 0 = off
    time_limit : s; 0 = off
    default_rms_height : m, roughness of materials that state none; used while loading
    effects : every name of ``EFFECT_NAMES`` to ``auto``, ``on`` or ``off``
    """

    method: Method = "hybrid"
    max_depth: int = 0
    ray_spacing: float = 0.0
    diffuse_ray_spacing: float = 0.0
    key_pulse_interval: int = 0
    scatterer_cell: float = 0.0
    gridding_width: int = 4
    seed: int = 0
    keep_orders: bool = False
    keep_halves: bool = False
    phase_precision: Literal["double", "single"] = "double"
    tolerance_db: float = TOLERANCE_DB
    target_error_db: float = 0.0
    time_limit: float = 0.0
    default_rms_height: float = 1e-3
    effects: Mapping[str, Switch] = field(default_factory=lambda: dict.fromkeys(EFFECT_NAMES, "auto"))


@dataclass(frozen=True)
class ImageRequest:
    """Which image the scene file asks for.

    Parameters
    ----------
    grid : ``slant`` or ``ground``
    center_x, center_y : m, scene frame
    height : m, scene frame; of the horizontal plane the image stands on
    extent_azimuth, extent_range : m on the ground
    spacing_azimuth, spacing_range : m; 0 = half a resolution cell
    """

    grid: Literal["slant", "ground"] = "slant"
    center_x: float = 0.0
    center_y: float = 0.0
    height: float = 0.0
    extent_azimuth: float = 100.0
    extent_range: float = 100.0
    spacing_azimuth: float = 0.0
    spacing_range: float = 0.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a simulation needs to know.

    Parameters
    ----------
    name : of the file, without suffix
    path : scene file, or None when it was built in memory
    geometry, materials, points : what there is to see
    radar : what sees it
    settings, image : how to trace and what to focus
    offset : (3,) float64, m; scene frame = file frame - offset. Zero unless the geometry lies more than
        5 km from the file's origin, whole metres then
    notes : one line each; what was assumed or repaired while loading
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


__all__ = [
    "DIFFUSE_LAWS",
    "EFFECT_NAMES",
    "METHODS",
    "TOLERANCE_DB",
    "DiffuseLaw",
    "Geometry",
    "ImageRequest",
    "Material",
    "Method",
    "PointTarget",
    "Scene",
    "Switch",
    "TraceSettings",
]
