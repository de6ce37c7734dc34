"""Edge diffraction, fringe currents along the sharp edges of metal: when it is simulated."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64, unit_rows
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.bounds import Aperture, EdgeBounds, edge_bounds
from sarmitsuba.effects.context import CELL_BELOW_CLUTTER_DB, SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.omitted_waves import EDGES
from sarmitsuba.effects.text import length
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges, metal_edges
from sarmitsuba.scene.visible_faces import VisibleFaces

# antenna positions, distributed over all, and edges with the largest bounds whose fringe coefficients are computed
POSITIONS, MOST_EDGES = 9, 2000
# most metal faces searched for edges while planning: a quarter of a second
MOST_FACES = 100_000
# cosine of the slope of ground that counts as level
LEVEL = 0.98


class EdgeDiffraction(Effect):
    r"""Edge diffraction; on where the strongest sharp metal edge, or the energy of all, is above the tolerance.

    The contribution of an edge beyond physical optics in a resolution cell is at most the bound of
    :func:`sarmitsuba.effects.bounds.edge_bounds`: by the fringe coefficients of its wedge and its least lean out of
    the plane across the line of sight over the whole aperture, straight, and with one or both legs mirrored in level
    ground, times the reflection coefficient of the ground for each. The strongest edge is compared with the clutter or
    the strongest cell found by a pilot; without a pilot, with a cell of the roughest material, or, where nothing is
    rough, with the strongest single-bounce return of a metal plane to any antenna position (multiple bounces are
    unknown without a pilot, and count as none). The sum of the bounded energies of all edges that reach into the lit
    part is compared with the energy of the image, that of the pilot's patches or of the reference; ``rcs`` has none.
    Edges of moving shapes are left out, as the reason says.

    Of paths between edges and mirrors only those over the ground below an edge are simulated; here any level face below
    it counts as its ground.
    """

    name = EDGES
    title = "fringe currents of metal edges"
    documentation = "diffraction by the sharp edges of metal beyond physical optics"
    off_when = (
        "no sharp metal edge, or the return of the strongest and the energy of all are below the tolerance"
    )
    off_means = "physical optics alone: HH = VV, no echo of a thin plate seen edge-on"
    hidden = "edges"
    rank = 105
    kernel_flags: ClassVar[Mapping[str, str]] = {
        EDGES: "a separate launch: one lane for each piece of an edge and pulse",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        scene = context.scene
        if not any(m.metallic for m in context.materials):
            return Assessment(False, "no metal", -np.inf)
        if scene.settings.method == "raster":
            return Assessment(False, "method raster has no coherent return", -np.inf)
        if not decided["coherent"].on:
            return Assessment(False, "nothing coherent", -np.inf)
        found = VisibleFaces.of(context.scene.geometry, context.scene.materials)
        if found.metal.sum() > MOST_FACES:
            return Assessment(
                False, f"{found.metal.sum()} metal faces are too many to look for edges", float("nan")
            )
        if context.draft:
            return Assessment(True, "sharp edges of metal are possible", float("nan"))
        edges = metal_edges(found.corners, found.metal, scene.radar.waveform.wavelength, found.shape)
        if not edges.n:
            return Assessment(False, "no sharp metal edge", -np.inf)
        bounces = decided["max_depth"].on and decided["max_depth"].value != 1
        bound, reference = _bound_edges(edges, context, bounces=bounces), _reference(found, context, decided)
        if bound.cell <= 0.0:
            return Assessment(False, "no metal edge is visible", -np.inf)
        cell, energy = _ratio_db(bound.cell, reference.cell), _ratio_db(bound.energy, reference.energy)
        what = f"metal edges up to {length(float(edges.length.max()))} add {cell:.0f} dB, {reference.name}"
        if np.isfinite(energy):
            what += f", and at most {energy:.0f} dB of the image's energy"
        for note in (edges.joined_text, edges.thin_text):
            what += f"; {note}" if note else ""
        if any(
            context.scene.materials[m].metallic
            for _, faces in context.scene.geometry.moving_meshes()
            for m in np.unique(context.scene.geometry.face_material[faces])
        ):
            what += "; edges of moving metal are left out"
        on = cell > reference.limit_db or energy > context.tolerance_db
        return Assessment(on, what, min(max(cell, energy), 0.0))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the separate launch of edges."""
        return {EDGES: on}


@dataclass(frozen=True)
class _Added:
    """Upper bounds: RCS added by an edge in a resolution cell, m^2, and energy of all edges, in cells times m^2."""

    cell: float
    energy: float


@dataclass(frozen=True)
class _Compared:
    """RCS of a cell, m^2, its name, allowed level relative to it, dB, and the image's energy, in cells times m^2.

    The energy is NaN where there is no image.
    """

    cell: float
    name: str
    limit_db: float
    energy: float


def _ratio_db(power: float, reference: float) -> float:
    """Level, dB; 0 where nothing is known to compare with, NaN for a reference NaN, -inf for no power."""
    if power <= 0.0:
        return -np.inf
    return 0.0 if reference <= 0.0 else db_from_power(power / reference)


def _bound_edges(edges: SharpEdges, context: SceneContext, *, bounces: bool) -> _Added:
    """Upper bounds of the contribution of edges, with paths over the ground; energies of different paths add up."""
    aperture = _aperture(context)
    lit = _find_lit(edges, context)
    ways = [(edges, lit, (False, False), 1.0)]
    ground, lowest = _ground(context) if bounces else ((), np.inf)
    above = edges.middle[:, 2] + 0.5 * edges.length * np.abs(edges.along[:, 2]) > lowest + 1e-3
    if above.any():
        raised = edges.of(above)
        look = aperture.places - raised.middle.mean(axis=0)
        mirror = _mirror(context, ground, float((np.abs(look[:, 2]) / np.linalg.norm(look, axis=1)).mean()))
        # one antenna: the path over the ground and its reverse add up
        mirrored = [((True, False), 2.0 * mirror), ((True, True), mirror**2)]
        if context.scene.radar.receiver is not None:
            mirrored.append(((False, True), 2.0 * mirror))
        ways += [(raised, lit[above], mirrors, factor) for mirrors, factor in mirrored]
    cell, energy = 0.0, 0.0
    for some, inside, mirrors, factor in ways:
        found: EdgeBounds = edge_bounds(some, aperture, mirrors, examined=MOST_EDGES)
        cell = max(cell, factor**2 * float(found.cell.max()))
        energy += factor**2 * float(found.energy[inside].sum())
    return _Added(cell, energy)


def _find_lit(edges: SharpEdges, context: SceneContext) -> NDArray[np.bool_]:
    """Edges whose bounds meet those of the lit part; all where that is not known."""
    half = 0.5 * edges.length[:, None] * np.abs(edges.along) + 1e-3
    if context.sampling is None:
        return np.ones(edges.n, dtype=bool)
    low, high = context.sampling.box
    return np.asarray(((edges.middle + half >= low) & (edges.middle - half <= high)).all(axis=1))


def _aperture(context: SceneContext) -> Aperture:
    """Antenna positions distributed over the aperture, and the resolution cell."""
    tracks, facts = context.scene.radar.tracks, context.sampling
    pulses = tracks[0].n_pulses
    pick = _distribute_positions(pulses)
    places = tracks[0].position[pick]
    flown = tracks[0].position[np.minimum(pick + 1, pulses - 1)] - tracks[0].position[np.maximum(pick - 1, 0)]
    flown = unit_rows(flown)
    receivers = places if len(tracks) == 1 else tracks[-1].position[pick]
    cells = (np.inf, np.inf) if facts is None else (facts.azimuth_cell, facts.range_cell)
    return Aperture(places, receivers, flown, context.wavenumber, *cells)


def _ground(context: SceneContext) -> tuple[tuple[Material, ...], float]:
    """Materials of visible level faces and the height of the lowest, m; none and infinite where there is none."""
    geometry, materials = context.scene.geometry, context.scene.materials
    visible = ~np.array([m.invisible for m in materials], dtype=bool)[geometry.face_material]
    corners = geometry.vertices[geometry.faces[visible]]
    normal = _doubled_normals(corners)
    level = np.abs(normal[:, 2]) > LEVEL * np.linalg.norm(normal, axis=1)
    if not level.any():
        return (), np.inf
    found = list_with_parts([materials[i] for i in np.unique(geometry.face_material[visible][level])])
    return tuple(found), float(corners[level, :, 2].max(axis=1).min())


def _mirror(context: SceneContext, ground: tuple[Material, ...], cosine: float) -> float:
    """Largest reflection coefficient of the ground's materials at an incidence, roughness included."""
    found = 0.0
    for material in ground:
        known = not material.pec and material.thickness == 0.0
        reflected = max(float(np.abs(r)) for r in fresnel(cosine, material.permittivity)) if known else 1.0
        loss = np.exp(-2.0 * np.square(context.wavenumber * material.rms_height * cosine))
        found = max(found, reflected * float(loss))
    return found


def _distribute_positions(count: int) -> NDArray[np.intp]:
    """Indices of at most ``POSITIONS`` of so many antenna positions, distributed over all."""
    return np.unique(np.linspace(0, count - 1, min(count, POSITIONS)).astype(int))


def _doubled_normals(corners: F64) -> F64:
    """Normals (n, 3) of triangles (n, 3, 3), twice as long as their areas."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _reference(found: VisibleFaces, context: SceneContext, decided: Mapping[str, Decision]) -> _Compared:
    """Clutter of a cell, or the peak of the image, and the energy of the image."""
    pilot, tolerance = context.pilot, context.tolerance_db
    if pilot is not None and pilot.total > 0.0:
        if pilot.clutter > 0.0:
            name = "of the clutter of a cell"
            return _Compared(pilot.clutter, name, CELL_BELOW_CLUTTER_DB, pilot.least_energy)
        peak = float(pilot.peak[3].max())
        return _Compared(peak, "of the strongest cell", tolerance, pilot.least_energy)
    if context.sampling is not None and decided["diffuse"].on:
        return _Compared(*_clutter(context))
    strongest, energy = _facets(found, context)
    if context.sampling is None:
        energy = float("nan")
    return _Compared(strongest, "of the metal's facets", tolerance, energy)


def _clutter(context: SceneContext) -> tuple[float, str, float, float]:
    """RCS of a cell of the roughest material at 45 degrees, and energy of the one with the most: see _Compared."""
    sampling = context.sampling
    assert sampling is not None
    geometry, wavelength = context.scene.geometry, context.scene.radar.waveform.wavelength
    corners = geometry.vertices[geometry.faces]
    normal = _doubled_normals(corners)
    area = np.bincount(geometry.face_material, 0.5 * np.linalg.norm(normal, axis=1))
    # faces of a body that are turned away or hidden: what lies in the lit part counts once
    largest = float(np.ptp(sampling.box, axis=0)[:2].prod())
    best, energy = 0.0, 0.0
    for index in np.flatnonzero(area):
        for material in list_with_parts([context.scene.materials[index]]):
            if material.scatters and not material.invisible:
                table = diffuse_tables(material, wavelength, 3)
                level = max(float(table.amplitude_h[1]) ** 2, float(table.amplitude_v[1]) ** 2)
                best, energy = max(best, level), max(energy, level * min(float(area[index]), largest))
    return best * sampling.cell**2, "of the clutter of a cell", CELL_BELOW_CLUTTER_DB, energy


def _facets(found: VisibleFaces, context: SceneContext) -> tuple[float, float]:
    """Largest physical-optics RCS of a metal plane, or of a cell of it, m^2: at any position, and in the mean."""
    corners = found.corners[found.metal]
    normal = _doubled_normals(corners)
    size = np.linalg.norm(normal, axis=1)
    corners, normal, size = (x[size > 0.0] for x in (corners, normal, size))
    if not size.size:
        return 0.0, 0.0
    normal /= size[:, None]
    offset = np.einsum("ni,ni->n", corners[:, 0], normal)
    # the terms of common sides of coplanar triangles cancel
    alike = np.round(np.column_stack([normal, offset / max(float(np.ptp(corners)), 1e-9)]), 4)
    _, plane = np.unique(alike, axis=0, return_inverse=True)
    cell = context.sampling.cell if context.sampling is not None else np.inf
    power = []
    for place in context.antenna[_distribute_positions(len(context.antenna))]:
        look = place - corners.mean(axis=1)
        distance = np.linalg.norm(place - corners, axis=2)
        cosine = np.abs(np.einsum("ni,ni->n", look, normal)) / np.linalg.norm(look, axis=1)
        # integral of a linear phase over a triangle, from its three corners
        phase = 2.0 * context.wavenumber * (distance - distance.min())
        share = 0.5 * size * np.exp(-1j * phase[:, 0]) * _average_over_triangle(phase - phase[:, :1]) * cosine
        total = np.abs(_sums(plane.reshape(-1), share))
        power.append(np.square(np.minimum(total, cell**2)))
    factor = context.wavenumber**2 / np.pi
    return factor * float(np.max(power)), factor * float(np.mean(power, axis=0).max())


def _average_over_triangle(phase: F64) -> C128:
    r"""Mean of :math:`e^{-j \phi}` over triangles whose corners have these phases (n, 3), the first of them 0."""
    b, c = phase[:, 1], phase[:, 2]

    def first(x: F64) -> C128:  # (1 - exp(-jx)) / jx
        small = np.abs(x) < 1e-4
        safe = np.where(small, 1.0, x)
        return np.asarray(np.where(small, 1.0 - 0.5j * x, (1.0 - np.exp(-1j * safe)) / (1j * safe)))

    # 2 int_0^1 int_0^{1-u} exp(-j (b u + c v)) dv du, by the divided difference of `first`
    apart = b - c
    near = np.abs(apart) < 1e-3
    middle, step = 0.5 * (b + c), 1e-3
    slope = (first(middle - step) - first(middle + step)) / (2.0 * step)
    safe = np.where(near, 1.0, apart)
    return np.asarray(-2j * np.where(near, slope, (first(c) - first(b)) / safe))


def _sums(index: NDArray[np.intp], values: C128) -> C128:
    """Sums of values by their index."""
    return np.asarray(np.bincount(index, values.real) + 1j * np.bincount(index, values.imag))


EFFECTS.register(EdgeDiffraction())
