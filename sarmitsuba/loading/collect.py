"""Shapes of a scene collected one after the other: surfaces with their materials, ideal points and scatterers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import GuessWarning, SceneError
from sarmitsuba.core.parameters import Value, printable
from sarmitsuba.core.units import power_from_db
from sarmitsuba.loading import tables
from sarmitsuba.loading.assemble import MeshSurface, assemble
from sarmitsuba.loading.describe import Described
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.material_book import MaterialBook
from sarmitsuba.loading.mesh_files import MeshPart, obj_materials, read_parts
from sarmitsuba.loading.names_of_materials import DEFAULT, is_doubtful, kind_of
from sarmitsuba.loading.notes import warn_once
from sarmitsuba.loading.overrides import Overrides
from sarmitsuba.loading.radar_ground import PLUGIN, LevelGround, ground_element, read_ground
from sarmitsuba.loading.scatterer_shapes import Reading, read_targets
from sarmitsuba.loading.shapes import MeshReader, Placed, mesh_path, sphere_center
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.materials.map_materials import map_attributes
from sarmitsuba.scene.mesh.cleaning import single_precision_step
from sarmitsuba.scene.mesh.model_units import doubtful_size
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.scene.mesh.smooth_surface import facet_sagitta, smooth_surface
from sarmitsuba.scene.motion import STILL, Motion
from sarmitsuba.scene.scatterers import SCATTERERS, Target
from sarmitsuba.scene.scene import Scene

# sagitta of facets over the wavelength: at 1/32 facets act as a grating whose lobes change a sphere's return by up to 1
# dB with the direction, a cylinder's by as much; at 1/512 by 0.1 dB
SAGITTA_OVER_WAVELENGTH = 1.0 / 512.0
# bytes that cleaning and joining need per triangle, beyond the triangle itself; triangles between two checks of the
# free memory
BYTES_PER_FACE, COUNTED = 300, 1_000_000
# deg: bend up to which facets are fitted as one smooth surface
SMOOTH_ANGLE_DEG = 40.0
# distance of their new facets from it, over the wavelength: the phase of the curvature within a facet is the kernel's
SMOOTH_SAGITTA = 1.0 / 100.0
# start of the note on bodies of a mesh file without ground
NO_GROUND = "no ground below the bodies"
# share of the height of a scene that counts as its lowest level
LOWEST = 0.1
# step of coordinates in single precision, over the wavelength, from which on it is warned of
LARGEST_ROUNDING = 1.0 / 32.0


@dataclass
class Collector:
    """Collects shapes and assembles the scene.

    Parameters
    ----------
    name, path : of the scene and its file
    described : radar and settings
    overrides : of plugin parameters
    """

    name: str
    path: Path | None
    described: Described
    overrides: Overrides = field(default_factory=Overrides)
    notes: list[str] = field(default_factory=list)
    surfaces: list[MeshSurface] = field(default_factory=list)
    points: list[PointTarget] = field(default_factory=list)
    scatterers: list[Target] = field(default_factory=list)
    grounds: list[LevelGround] = field(default_factory=list)
    n_faces: int = 0

    def __post_init__(self) -> None:
        frequency = self.described.radar.sensor.center_frequency
        self.book = MaterialBook(
            frequency, self.overrides, self.notes, self.described.settings.default_rms_height
        )
        self.reader = MeshReader(SAGITTA_OVER_WAVELENGTH * SPEED_OF_LIGHT / frequency, self.notes)
        self.reading = Reading(frequency, self.overrides, self.notes, self.reader)

    def add_shape(self, placed: Placed, bsdf: Element | None) -> None:
        """Add a shape element: a surface, or by its bsdf an ideal point or scatterers.

        Raises
        ------
        SceneError : mesh, material or point cannot be read
        """
        if bsdf is not None and bsdf.plugin == tables.POINT_SCATTERER.plugin:
            self.points.append(self._point(placed, bsdf))
            return
        if bsdf is not None and bsdf.plugin in SCATTERERS:
            self.scatterers.extend(read_targets(placed, bsdf, self.reading))
            return
        if placed.element.plugin == PLUGIN:
            bsdf, level, extent = read_ground(placed, bsdf)
            self.add_ground(placed.name, placed.element.where, bsdf, level, extent)
            return
        if placed.element.plugin == "linearcurve":
            raise SceneError(
                f"{placed.element.where}: a linearcurve has no surface for rays; give it the bsdf radar_wire"
            )
        if placed.element.plugin == "obj" and self._named_parts(placed, bsdf):
            return
        material = self.book.index(bsdf, placed.element.where)
        vertices, faces = self.reader.triangles(placed)
        self._check_faces(placed.element.where, len(faces))
        file = placed.element.values.get("filename")
        self._check_size((placed.name, Path(file).stem if isinstance(file, str) else ""), vertices)
        names = map_attributes(self.book.materials[material])
        self.surfaces.append(
            MeshSurface(
                placed.name,
                vertices,
                faces,
                material,
                placed.is_curved,
                placed.is_convex,
                placed.motion,
                self.reader.corner_values(placed, faces, names) if names else {},
            )
        )

    def add_ground(
        self, name: str, where: str, bsdf: Element, level: float | None = None, extent: float | None = None
    ) -> None:
        """Add level ground with a bsdf; see :class:`sarmitsuba.loading.radar_ground.LevelGround`."""
        self.grounds.append(LevelGround(name, where, self.book.index(bsdf, where), level, extent))

    def add_ground_of(
        self, material: str | Mapping[str, Value] | None, level: float | None = None, *, hint: bool = False
    ) -> None:
        """Add level ground of a material, by default at the lowest level of the scene; None: note if it lacks some.

        ``hint`` : whether that note is wanted
        """
        if material is None:
            if hint:
                self._note_missing_ground()
            return
        label = printable(self.path.name if self.path else self.name)
        taken = {known.name for known in self.book.materials}
        self.add_ground("ground", f"{label}: ground", ground_element(material, label, taken), level)

    def _note_missing_ground(self) -> None:
        """Note where nothing at the lowest level faces upwards: bodies without ground, shadow and double bounce."""
        if self.grounds or not self.surfaces:
            return
        corners = np.concatenate([surface.vertices[surface.faces] for surface in self.surfaces])
        if not np.isfinite(corners).all() or not len(corners):
            return
        up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
        low, high = corners[..., 2].min(), corners[..., 2].max()
        on_floor = corners[..., 2].max(axis=1) < low + LOWEST * (high - low)
        if high > low and not np.any(on_floor & (up > 0.0)):
            self.notes.append(
                f"{printable(self.name)}: {NO_GROUND}: no shadow, and no double bounce with it; "
                "--ground soil adds some"
            )

    def add_parts(
        self,
        label: str,
        parts: Sequence[MeshPart],
        vertices: Sequence[F64],
        chosen: Mapping[str, str],
        motion: Motion = STILL,
    ) -> None:
        """Add parts of a mesh file, with materials by their names in the file.

        Parameters
        ----------
        label : start of notes and warnings
        parts : with the file's names
        vertices : of every part, (n, 3) float64 m, file frame of the scene
        chosen : material of the library by the file's name of it, in place of the guess from that name
        motion : of all parts

        Warns
        -----
        GuessWarning : a name matches no material, or only a word in it does
        """
        kinds = {name: kind_of(name, chosen) for name in dict.fromkeys(part.material for part in parts)}
        said = {name: f'"{printable(name)}" {kind}' if name else kind for name, kind in kinds.items() if kind}
        guesses = [text for name, text in said.items() if is_doubtful(name, chosen)]
        if known := [text for text in said.values() if text not in guesses]:
            self.notes.append(f"{label}: materials by their names: {', '.join(known)}")
        if guesses:
            warn_once(
                self.notes,
                f"{label}: materials guessed from a word in their names: {', '.join(guesses)}; choose with --material "
                "NAME=MATERIAL",
                GuessWarning,
            )
        unknown = [f'"{printable(name)}"' if name else "no name" for name, kind in kinds.items() if not kind]
        if unknown:
            warn_once(
                self.notes,
                f"{label}: materials with unknown names are read as {DEFAULT}: {', '.join(unknown)}; name them "
                "brick, glass, metal, ... in the file, or choose with --material MATERIAL or NAME=MATERIAL",
                GuessWarning,
            )
        for part, corners in zip(parts, vertices, strict=True):
            kind = kinds[part.material] or DEFAULT
            index = self.book.find_named(part.material or kind, kind, label)
            self._check_faces(label, len(part.faces))
            file = Path(label.rpartition(": ")[2]).stem if len(parts) == 1 else ""
            self._check_size((part.name, part.material, file), corners)
            self.surfaces.append(MeshSurface(part.name, corners, part.faces, index, motion=motion))

    def _named_parts(self, placed: Placed, bsdf: Element | None) -> bool:
        """Add an obj file with its own materials where the shape has none; note where the shape's bsdf replaces any."""
        path, where = mesh_path(placed.element), placed.element.where
        names = obj_materials(path)
        if not names:
            return False
        label = where.partition(":")[0]
        if bsdf is not None:
            self.notes.append(
                f'{where}: the bsdf "{bsdf.id or bsdf.plugin}" replaces the materials of {path.name}: '
                f"{', '.join(names)}; leave the bsdf out to use these by their names"
            )
            return False
        parts = read_parts(path, where)
        vertices = [placed.moved(part.vertices) for part in parts]
        self.add_parts(f"{label}: {path.name}", parts, vertices, {}, placed.motion)
        return True

    def scene(self) -> Scene:
        """The assembled scene, see `sarmitsuba.loading.assemble.assemble`."""
        if self.described.settings.smooth:
            self.surfaces = [self._smooth_surface(surface) for surface in self.surfaces]
        self._check_rounding()
        return assemble(
            self.name,
            self.path,
            self.surfaces,
            self.book.materials,
            self.points,
            self.described.radar,
            self.described.settings,
            self.notes,
            self.scatterers,
            self.grounds,
        )

    def _smooth_surface(self, surface: MeshSurface) -> MeshSurface:
        """Mesh with finer facets on its smooth surface; shapes without facets, and with values at corners, stay."""
        if surface.smooth or surface.corner_values or not np.isfinite(surface.vertices).all():
            return surface
        name, wavelength = surface.name, SPEED_OF_LIGHT / self.book.frequency
        group = smooth_groups(surface.vertices, surface.faces, SMOOTH_ANGLE_DEG)
        before = facet_sagitta(surface.vertices[surface.faces], group)
        vertices, faces, _ = smooth_surface(
            surface.vertices, surface.faces, group, SMOOTH_SAGITTA * wavelength
        )
        if len(faces) == len(surface.faces):
            return surface
        self.notes.append(
            f'mesh "{name}": a smooth surface is fitted as asked, {len(surface.faces)} facets become {len(faces)}, and '
            f"it lies up to {before.max() / wavelength:.2g} wavelengths off the given ones"
        )
        return replace(surface, vertices=vertices, faces=faces)

    def _check_rounding(self) -> None:
        """Warn of meshes whose coordinates are rounded by single precision to a good part of the wavelength."""
        wavelength = SPEED_OF_LIGHT / self.book.frequency
        for surface in self.surfaces:
            step = single_precision_step(surface.vertices)
            if step > LARGEST_ROUNDING * wavelength:
                warn_once(
                    self.notes,
                    f'mesh "{surface.name}": coordinates of up to {np.abs(surface.vertices).max():.7g} m are in single '
                    f"precision, rounded to {step:.2g} m, {step / wavelength:.2g} wavelengths: phases are wrong; "
                    "export it about an origin nearby, or in double precision",
                )

    def _check_size(self, names: tuple[str, ...], vertices: F64) -> None:
        """Warn where something by the name of a known thing has the size of none, as in another unit."""
        label = printable(self.path.name if self.path else self.name)
        length = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
        if doubt := next(filter(None, (doubtful_size(printable(name), length) for name in names)), ""):
            warn_once(self.notes, f"{label}: {doubt}")

    def _check_faces(self, where: str, more: int) -> None:
        """Count triangles; raise a SceneError for more than fit into the memory."""
        before, self.n_faces = self.n_faces, self.n_faces + more
        if before // COUNTED != self.n_faces // COUNTED:
            check_fits(
                f"{where}: {self.n_faces / 1e6:.0f} million triangles up to here: joining them",
                BYTES_PER_FACE * self.n_faces,
                "make curved shapes smaller or fewer, or take a mesh of fewer faces",
            )

    def _point(self, placed: Placed, bsdf: Element) -> PointTarget:
        """Ideal scatterer at the centre of a sphere element."""
        values, _ = self.overrides.read(bsdf, tables.POINT_SCATTERER)
        shape = placed.element
        if shape.plugin != "sphere":
            raise SceneError(f"{shape.where}: point_scatterer is on a {shape.plugin}; put it on a sphere")
        position = placed.to_world[:3, :3] @ sphere_center(shape) + placed.to_world[:3, 3]
        rcs, phase = float(values["rcs_dbsm"] or 0.0), float(values["phase_deg"] or 0.0)
        return PointTarget(
            placed.name, position, float(power_from_db(rcs)), float(np.radians(phase)), placed.motion
        )
