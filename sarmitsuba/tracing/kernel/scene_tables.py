"""Traced scene: one Embree/OptiX mesh in float32, and tables of its faces and materials for the kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F32, F64, I64, U32, unit_rows
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.units import power_from_db
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.diffuse import diffuse_tables, spectrum_table
from sarmitsuba.scene.materials.diffuse_law import LAWS, Bistatic
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.boundary_edges import N_EDGES, facets
from sarmitsuba.scene.mesh.flattening import flatten_facets
from sarmitsuba.scene.mesh.metal_corners import corner_needs
from sarmitsuba.scene.mesh.pieces import (
    part_sizes,
    piece_of,
    piece_sizes,
    ray_needs,
    round_needs,
    slant_factor,
)
from sarmitsuba.scene.mesh.smooth_surface import facet_curvature
from sarmitsuba.scene.mesh.topology import copies_apart, edge_pairs, weld
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.intersector import clearance_of, intersector
from sarmitsuba.tracing.kernel.movement import Movers
from sarmitsuba.tracing.kernel.passage import Passage
from sarmitsuba.tracing.kernel.speckle import SurfacePlace
from sarmitsuba.tracing.kernel.surface_tables import SurfaceTables
from sarmitsuba.tracing.kernel.table_rows import FaceRow
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import SlabTables
from sarmitsuba.tracing.scatterers.water.wind_waves import WaterTables

DIFFUSE_NODES = 256
# number of nodes of the height-spectrum tables, uniform in the mean cosine and in the root of the sine
SPECTRUM_COSINES, SPECTRUM_SINES = 33, 129
# least diffuse scatterers on a piece of surface: its mean power then follows its area to a few per cent
LEAST_SCATTERERS = 36


@dataclass(frozen=True, eq=False)
class TraceScene:
    """Intersection structure and tables of a scene, one row for each face or material.

    Parameters
    ----------
    mi_scene : ``mi.Scene`` holding one mesh
    face_table : (12 n_faces,) float64: vertex 0, edge 1, edge 2, unit normal, packed as three rows of four:
        ``v0.xyz n.x | e1.xyz n.y | e2.xyz n.z``
    edge_table : (16 n_faces,) float32: four edges of each face's facet, see :mod:`sarmitsuba.scene.mesh.boundary_edges`
    piece_table : the same without creases, for diffuse patches, which do not end at them; None without creases
    face_info : (4 n_faces,) uint32: material (the two highest bits: place of its law in ``FORMS``; the next: the edges
        bound a convex part of a flat facet all around; the next four: those of its edges where the facet goes on in
        its plane), then the bits of float32 lengths in m: largest cell of a diffuse scatterer on the face's piece of
        surface, and ``needs``
    material_table : (4 n_materials,) float32: Re, Im of eps - 1, rms height (m), cross-polar power ratio
    diffuse_table : (2 n_nodes n_materials,) float32: sqrt(sigma0) for h and v over the incidence angle, nodes
        uniform in angle from 0 to 90 degrees
    curvature_table : (8 n_faces,) float32, curvature of the smooth surfaces, see
        :func:`sarmitsuba.scene.mesh.smooth_surface.facet_curvature`; None in a flat scene
    needs : (n_faces,) m, largest permitted ray spacing on each face, for coherent and for diffuse returns
    corner_needs : (n_faces,) m, ray spacing that double bounces between metal facets need, also where the rays for
        them do not suffice and ``needs`` is coarser; infinite without
    triangles : (n_faces, 3, 3) float64, m
    piece : (n_faces,) number of the piece of surface of each face, see :func:`sarmitsuba.scene.mesh.pieces.piece_of`
    geometry_faces : (n_faces,) rows of these faces in ``Geometry.faces``
    surfaces : maps and textures of the materials; None where all are uniform
    movers : faces that move, and the time at which all tables hold them; None where all are at rest
    forms : forms of bistatic scattering in the scene other than the mean of both angles
    spectrum_table : (n_materials SPECTRUM_COSINES SPECTRUM_SINES,) float32, amplitude of height spectra, see
        :class:`sarmitsuba.scene.materials.diffuse.SpectrumTable`; None without such a law
    correction_table : as ``diffuse_table``, the ``correction`` of a `SpectrumTable`; None where it is one everywhere
    water : tables of the materials that are water under wind; None without them
    passages : objects that attenuate waves that pass through them (volumes)
    slabs : the materials that are slabs; None without them
    beside : (2, 3) float64 bounds of scatterers that are not part of the mesh, m; None without them
    bounds : (2, 3) float64 lower and upper corner of everything traced, m, scene frame
    change_table : (2 n_materials,) float32: coherence between passes that never decays, and time constant (days) of
        the rest; None where nothing changes
    """

    mi_scene: mi.Scene
    face_table: mi.Float64
    edge_table: mi.Float
    piece_table: mi.Float | None
    face_info: mi.UInt32
    material_table: mi.Float
    diffuse_table: mi.Float
    forms: frozenset[Bistatic]
    spectrum_table: mi.Float | None
    correction_table: mi.Float | None
    bounds: F64
    n_faces: int
    curvature_table: mi.Float | None
    needs: tuple[F64, F64]
    corner_needs: F64
    triangles: F64
    piece: I64
    geometry_faces: NDArray[np.intp]
    surfaces: SurfaceTables | None = None
    movers: Movers | None = None
    change_table: mi.Float | None = None
    passages: tuple[Passage, ...] = ()
    water: WaterTables | None = None
    slabs: SlabTables | None = None
    beside: F64 | None = None

    @property
    def extent(self) -> float:
        """Largest coordinate modulus, m; bounds the float32 rounding of positions."""
        return float(np.abs(self.bounds).max())

    def material_at(self, face: mi.UInt32, own: mi.UInt32, offset: mi.Vector3f, active: mi.Bool) -> mi.UInt32:
        """Material (bits) at a point of a face, in a kernel: the face's ``own`` unless a map of classes gives another.

        Parameters
        ----------
        own : material of the face, as in ``face_info``
        offset : m, from the face's vertex 0
        """
        if self.surfaces is None or self.surfaces.classes is None:
            return own
        there = self.surfaces.classes.nearest(face, own & MATERIAL_MASK, offset, active)
        return (own & FACE_BITS) | there

    def at_place(
        self,
        face: mi.UInt32,
        own: mi.UInt32,
        point: mi.Vector3d,
        normal: mi.Vector3d,
        seed: mi.UInt32,
        active: mi.Bool,
    ) -> tuple[mi.UInt32, mi.Float]:
        """Bits of the material at a point of a face at rest, and the factor on its diffuse amplitude.

        Parameters
        ----------
        own : material of the face, as in ``face_info``
        point, normal : float64, m and unit vector
        seed : of the scene
        """
        if self.surfaces is None:
            return own, mi.Float(1.0)
        corner = dr.gather(mi.Vector4d, self.face_table, face * 3, active)
        offset = mi.Vector3f(point - mi.Vector3d(corner.x, corner.y, corner.z))
        bits = self.material_at(face, own, offset, active)
        place = SurfacePlace.of(point, normal)
        factor = self.surfaces.amplitude(
            face, own & MATERIAL_MASK, bits & MATERIAL_MASK, offset, place, seed, active
        )
        return bits, factor

    def material_of(self, face: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Row of the material table for each face, in a kernel."""
        return FaceRow.of(self.face_info, face, active).material_bits & MATERIAL_MASK

    def with_tables(self, *, surfaces: bool, movers: bool, slabs: bool) -> TraceScene:
        """The scene with the tables that are wanted: a kernel does not record tables that its scene lacks."""
        return replace(
            self,
            surfaces=self.surfaces if surfaces else None,
            movers=self.movers if movers else None,
            slabs=self.slabs if slabs else None,
        )

    def at(self, time: float) -> TraceScene:
        """The scene with all moving faces at their positions at a time, s; itself where nothing moves."""
        if self.movers is None or self.movers.deformations is not None or time == self.movers.time:
            return self
        movers = self.movers.at(time)
        triangles = movers.corners()
        corners = triangles.astype(np.float32)
        return replace(
            self,
            mi_scene=intersector(corners),
            face_table=device_array(mi.Float64, _pack_faces(triangles)),
            bounds=_join_bounds(_bounds(corners), self.beside),
            triangles=triangles,
            movers=movers,
            slabs=self.slabs and self.slabs.at(triangles),
        )

    def at_frequency(self, materials: tuple[Material, ...], wavelength: float) -> TraceScene:
        """The scene with the tables of its materials at another frequency.

        Parameters
        ----------
        materials : of the scene, at that frequency
        wavelength : m

        Notes
        -----
        Facets, curvature, ray spacings and the waves of water under wind stay as they are: the same points scatter at
        all frequencies.
        """
        if not self.n_faces:
            return self
        materials = list_with_parts(materials)
        spectrum, correction = _spectra(materials, wavelength)
        tables = _material_tables(materials, wavelength)
        slabs = self.slabs and self.slabs.at_frequency(materials, wavelength)
        return replace(
            self,
            material_table=tables[0],
            diffuse_table=tables[1],
            spectrum_table=spectrum,
            correction_table=correction,
            slabs=slabs,
        )

    def displaced_from(self, other: TraceScene, number: U32, matrices: F64, offsets: F64) -> TraceScene:
        """The scene with the diffuse scatterers and ray spacings of another, from which its shapes were displaced.

        Parameters
        ----------
        other : of the same faces at their old places
        number : (n_faces,) uint32, of each face's row of the others
        matrices, offsets : see `Movers.displaced`
        """
        rows = np.argsort(other.geometry_faces)[
            np.searchsorted(np.sort(other.geometry_faces), self.geometry_faces)
        ]
        info, old = (np.array(scene.face_info).reshape(-1, 4) for scene in (self, other))
        info[:, 1:] = old[rows, 1:]  # cells and spacings are those of the faces, not of their new sizes
        return replace(
            self,
            face_info=device_array(mi.UInt32, info),
            movers=Movers.displaced(self.triangles, number, matrices, offsets),
        )

    @property
    def clearance(self) -> float:
        """Distance off a facet at which rays that leave it start, m; see :func:`clearance_of`."""
        return clearance_of(self.extent)


# eps - 1 of a perfect conductor in a scene that also has dielectrics, so that one formula serves both: r_tm is
# within 2e-6 of +1 down to 0.01 degrees of grazing, and |eps c + q|^2 = 1e36 still fits float32
PEC_CHI = (0.0, -1e18)

# forms of bistatic scattering; the index is stored in the two highest bits of a face's material
FORMS: tuple[Bistatic, ...] = ("mean", "facets", "spectrum")
FORM_SHIFT = 30
# marks faces whose boundary edges bound a convex part of a flat facet all around
CLOSED_BIT = 29
# the first of four bits that mark boundary edges of a face beyond which its facet continues in the same plane
INNER_BIT = 25
MATERIAL_MASK = (1 << INNER_BIT) - 1
# bits of a face that do not depend on its material
FACE_BITS = 0x3FFFFFFF & ~MATERIAL_MASK


def build_trace_scene(
    geometry: Geometry,
    materials: tuple[Material, ...],
    wavelength: float,
    antenna: F64 | None = None,
    places: F64 | None = None,
    seed: int = 0,
    aperture: F64 | None = None,
) -> TraceScene:
    """Build the intersection structure and the tables of a scene.

    Parameters
    ----------
    geometry, materials : as loaded; faces of invisible materials are left out
    wavelength : m
    antenna : (3,) m, position for which the density of diffuse rays is planned; None: normal incidence on each face
    places : (n, 3) m, scatterers that are not part of the mesh (which may then be empty); None or empty: none
    seed : of the random features of the scene, such as the waves of water
    aperture : (m, 3) m, positions of the antennas that see corners of metal facets; None: any position

    Raises
    ------
    SceneError
        When no visible face is left, and there are no other scatterers.
    """
    visible = ~np.array([m.invisible for m in materials], dtype=bool)[geometry.face_material]
    if places is not None and len(places):
        meshed = bool(visible.any())
        return _include_places(geometry, materials, wavelength, antenna, places, seed, meshed, aperture)
    if not visible.any():
        raise SceneError(
            "scene: nothing to trace: every mesh is empty or invisible; give a mesh a material that reflects"
        )
    rows_kept = np.flatnonzero(visible)[_canonical_order(geometry, visible)]
    triangles = geometry.vertices[geometry.faces[rows_kept]]
    corners = triangles.astype(np.float32)
    movers = Movers.of(geometry, rows_kept)

    materials = list_with_parts(materials)
    material_table, diffuse_table = _material_tables(materials, wavelength)
    form = np.array([FORMS.index(LAWS[m.diffuse_law].bistatic) for m in materials], dtype=np.uint32)
    material = geometry.face_material[rows_kept].astype(np.uint32)
    vertex = copies_apart(weld(triangles.reshape(-1, 3)))
    if movers is not None:  # surfaces with different motions share no edge
        vertex = movers.apart(vertex)
    pairs = edge_pairs(vertex)
    # `corners`, which rays are intersected with, keep the common vertices of facets
    triangles = flatten_facets(triangles, pairs, wavelength)
    if movers is not None:
        movers = replace(movers, triangles=triangles)
    piece = piece_of(triangles, vertex, pairs)
    area, width = piece_sizes(triangles, piece)
    largest = np.minimum(width, np.sqrt(area / LEAST_SCATTERERS)).astype(np.float32)
    group = geometry.face_group[rows_kept]
    bend = facet_curvature(triangles, group, wavelength, vertex)
    curved = None if bend is None else np.asarray((bend != 0.0).any(axis=1))
    flat = facets(triangles, vertex, curved, wavelength, pairs)
    sizes = part_sizes(triangles, flat.part, area, width, curved)
    round_need = None if curved is None else round_needs(triangles, vertex, flat.part, curved, wavelength)
    needs = ray_needs(area, width, sizes, bend, round_need, wavelength)
    metal = np.array([m.metallic for m in materials], dtype=bool)[material]
    shared = np.bincount(np.concatenate(pairs) // 3, minlength=len(triangles)) == 3
    flat_metal = metal if curved is None else metal & ~curved
    planned, wanted = corner_needs(triangles, flat.part, flat_metal, shared, wavelength, aperture)
    needs = (np.minimum(needs[0], planned), needs[1])
    if antenna is not None:
        needs = (needs[0], needs[1] * slant_factor(triangles, antenna))
    info = np.stack(
        [
            material
            | (form[material] << np.uint32(FORM_SHIFT))
            | (flat.closed.astype(np.uint32) << np.uint32(CLOSED_BIT))
            | (
                flat.inner.astype(np.uint32) << np.arange(INNER_BIT, INNER_BIT + N_EDGES, dtype=np.uint32)
            ).sum(axis=1, dtype=np.uint32),
            *(v.astype(np.float32).view(np.uint32) for v in (largest, *needs)),
        ],
        axis=1,
    )
    spectrum, correction = _spectra(materials, wavelength)
    bits = np.arange(len(materials), dtype=np.uint32) | (form << np.uint32(FORM_SHIFT))
    surfaces = SurfaceTables.of(geometry, rows_kept, materials, bits)
    occurring = form[material] if surfaces is None or surfaces.classes is None else form
    return TraceScene(
        mi_scene=intersector(corners),
        face_table=device_array(mi.Float64, _pack_faces(triangles)),
        edge_table=_table32(flat.edges),
        piece_table=None if flat.uncreased is None else _table32(flat.uncreased),
        face_info=device_array(mi.UInt32, info.astype(np.uint32)),
        material_table=material_table,
        diffuse_table=diffuse_table,
        forms=frozenset(FORMS[i] for i in np.unique(occurring) if i > 0),
        spectrum_table=spectrum,
        correction_table=correction,
        bounds=_bounds(corners),
        n_faces=len(triangles),
        curvature_table=None if bend is None else _table32(bend),
        needs=needs,
        corner_needs=wanted,
        triangles=triangles,
        piece=piece,
        geometry_faces=rows_kept,
        surfaces=surfaces,
        movers=movers,
        change_table=_table32([(m.temporal_coherence, m.decorrelation_days) for m in materials])
        if any(m.temporal_coherence < 1.0 for m in materials)
        else None,
        water=WaterTables.of(materials, wavelength, DIFFUSE_NODES, seed),
        slabs=SlabTables.of(materials, wavelength, material, triangles),
    )


def _join_bounds(bounds: F64, other: F64 | None) -> F64:
    """Common bounds (2, 3) of two boxes."""
    if other is None:
        return bounds
    return np.stack([np.minimum(bounds[0], other[0]), np.maximum(bounds[1], other[1])])


def _include_places(
    geometry: Geometry,
    materials: tuple[Material, ...],
    wavelength: float,
    antenna: F64 | None,
    places: F64,
    seed: int,
    visible: bool,
    aperture: F64 | None,
) -> TraceScene:
    """The scene with bounds that include scatterers beside its mesh; without a mesh, one in which rays hit nothing."""
    if visible:
        scene = build_trace_scene(geometry, materials, wavelength, antenna, seed=seed, aperture=aperture)
        beside = np.stack([places.min(axis=0), places.max(axis=0)])
        return replace(scene, bounds=_join_bounds(scene.bounds, beside), beside=beside)
    # tables need at least one row: a face that no ray can hit
    face = replace(
        Geometry.empty(),
        vertices=np.eye(3),
        faces=np.arange(3, dtype=np.int32)[None],
        face_material=np.zeros(1, dtype=np.int32),
        face_group=np.zeros(1, dtype=np.int32),
    )
    scene = build_trace_scene(face, (Material("nothing", pec=True),), wavelength)
    return replace(
        scene,
        mi_scene=mi.load_dict({"type": "scene"}),
        bounds=np.stack([places.min(axis=0), places.max(axis=0)]),
        n_faces=0,
        needs=(np.zeros(0), np.zeros(0)),
        corner_needs=np.zeros(0),
        triangles=np.zeros((0, 3, 3)),
        piece=np.zeros(0, dtype=np.int64),
        geometry_faces=np.zeros(0, dtype=np.intp),
    )


def _pack_faces(triangles: F64) -> F64:
    """Rows (n_faces, 3, 4) of the face table, from the corners (n_faces, 3, 3) of the triangles."""
    v0, v1, v2 = (triangles[:, i] for i in range(3))
    e1, e2 = v1 - v0, v2 - v0
    normal = np.cross(e1, e2)
    normal = unit_rows(normal)
    return np.stack([np.column_stack([a, normal[:, i]]) for i, a in enumerate((v0, e1, e2))], axis=1)


def _bounds(corners: F32) -> F64:
    return np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))]).astype(np.float64)


def _material_tables(materials: tuple[Material, ...], wavelength: float) -> tuple[mi.Float, mi.Float]:
    """Material table and diffuse table of a :class:`TraceScene`."""
    rows, tables = [], []
    for m in materials:
        chi = complex(*PEC_CHI) if m.pec else complex(m.permittivity) - 1.0
        rows.append([chi.real, chi.imag, m.rms_height, power_from_db(m.cross_polar_ratio_db)])
        table = diffuse_tables(m, wavelength, DIFFUSE_NODES)
        tables.append(np.stack([table.amplitude_h, table.amplitude_v], axis=1))
    return _table32(rows), _table32(tables)


def _spectra(materials: tuple[Material, ...], wavelength: float) -> tuple[mi.Float | None, mi.Float | None]:
    """Height-spectrum tables of the materials' diffuse laws, and their corrections; None where no law has one."""
    tables = [
        spectrum_table(m, wavelength, SPECTRUM_COSINES, SPECTRUM_SINES, DIFFUSE_NODES)
        if LAWS[m.diffuse_law].bistatic == "spectrum"
        else None
        for m in materials
    ]
    if not any(tables):
        return None, None
    none = np.zeros((SPECTRUM_COSINES, SPECTRUM_SINES))
    spectrum = _table32([none if t is None else t.amplitude for t in tables])
    if not any(t is not None and t.corrected for t in tables):
        return spectrum, None
    one = np.ones((DIFFUSE_NODES, 2))
    return spectrum, _table32([one if t is None else t.correction for t in tables])


def _table32(rows: ArrayLike) -> mi.Float:
    """Rows of numbers as one flat float32 array."""
    return device_array(mi.Float, np.asarray(rows, dtype=np.float32))


def _canonical_order(geometry: Geometry, visible: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Order of the visible faces, independent of their order in the file: by centroid, then material.

    Where faces of different material overlap in one plane, which of them a ray hits depends on their order; a
    fixed order makes that choice, and with it the image, the same however the file lists its faces.
    """
    a, b, c = (geometry.vertices[corner] for corner in geometry.faces[visible].T)
    x, y, z = ((a + b + c) / 3.0).T
    order = np.argsort(x, kind="stable")
    repeated = np.zeros(order.size, dtype=bool)
    repeated[1:] = x[order[1:]] == x[order[:-1]]
    repeated[:-1] |= repeated[1:]
    rest = order[repeated]  # the other keys decide
    order[repeated] = rest[np.lexsort((geometry.face_material[visible][rest], z[rest], y[rest], x[rest]))]
    return order


__all__ = [
    "CLOSED_BIT",
    "DIFFUSE_NODES",
    "FACE_BITS",
    "FORMS",
    "FORM_SHIFT",
    "INNER_BIT",
    "MATERIAL_MASK",
    "SPECTRUM_COSINES",
    "SPECTRUM_SINES",
    "TraceScene",
    "build_trace_scene",
    "intersector",
]
