"""Edge diffraction: fringe currents along the sharp edges of metal."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import C128, F64
from sarmitsuba.effects.context import CELL_BELOW_CLUTTER_DB, SceneContext
from sarmitsuba.effects.edge_bound import Aperture, edge_bounds
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length
from sarmitsuba.materials.diffuse import diffuse_tables
from sarmitsuba.materials.fresnel import fresnel
from sarmitsuba.materials.map_materials import with_parts
from sarmitsuba.materials.material import Material
from sarmitsuba.mesh.sharp_edges import SharpEdges, sharp_edges

# antenna positions and edges used in the estimate, distributed over all
POSITIONS, EDGES = 9, 2000
# most metal faces searched for edges while planning: a quarter of a second
MOST_FACES = 100_000
# cosine of the slope of ground that counts as level
LEVEL = 0.98


class EdgeDiffraction(Effect):
    r"""Edge diffraction; on where the strongest sharp metal edge is above the tolerance.

    What an edge adds to physical optics in a resolution cell is at most the bound of
    :func:`sarmitsuba.effects.edge_bound.edge_bounds`: by the fringe coefficients of its wedge and its least lean out of
    the plane across the line of sight over the whole aperture, straight, and with one or both legs mirrored in level
    ground, times the reflection coefficient of the ground for each. The strongest edge is compared with the clutter or
    the strongest cell found by a pilot; without a pilot, with a cell of the roughest material, or, where nothing is
    rough, with the strongest single-bounce return of a metal plane to any antenna position (multiple bounces are
    unknown without a pilot, and count as none). Edges of moving shapes are left out, as the reason says.

    Of paths between edges and mirrors only those over the ground below an edge are simulated; here any level face below
    it counts as its ground.
    """

    name = "edge_diffraction"
    title = "fringe currents of metal edges"
    documentation = "diffraction by the sharp edges of metal beyond physical optics"
    off_when = "no sharp metal edge, or the return of the strongest is below the tolerance"
    off_means = "physical optics alone: HH = VV, no echo of a thin plate seen edge-on"
    rank = 105
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "edge_diffraction": "a separate launch: one lane for each piece of an edge and pulse",
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
        found = _Metal.of(context)
        if found.metal.sum() > MOST_FACES:
            return Assessment(
                False, f"{found.metal.sum()} metal faces are too many to look for edges", float("nan")
            )
        edges = _edges(found)
        if not edges.n:
            return Assessment(False, "no sharp metal edge", -np.inf)
        bounces = decided["max_depth"].on and decided["max_depth"].value != 1
        strongest, longest = _strongest(edges, context, bounces=bounces), float(edges.length.max())
        reference, limit, over = _reference(found, context, decided)
        if strongest <= 0.0:
            return Assessment(False, "no metal edge is visible", -np.inf)
        error = 10.0 * float(np.log10(strongest / reference)) if reference > 0.0 else 0.0
        what = f"metal edges up to {length(longest)} add {error:.0f} dB, {over}"
        if any(
            context.scene.materials[m].metallic
            for _, faces in context.scene.geometry.moving_meshes()
            for m in np.unique(context.scene.geometry.face_material[faces])
        ):
            what += "; edges of moving metal are left out"
        return Assessment(error > limit, what, min(error, 0.0))

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of the separate launch of edges."""
        return {"edge_diffraction": on}


@dataclass(frozen=True, eq=False)
class _Metal:
    """Corners (n, 3, 3) of all visible triangles, m, and which of them are metal."""

    corners: F64
    metal: NDArray[np.bool_]

    @staticmethod
    def of(context: SceneContext) -> "_Metal":
        geometry, materials = context.scene.geometry, context.scene.materials
        visible = ~np.array([m.invisible for m in materials], dtype=bool)[geometry.face_material]
        metal = np.array([m.metallic for m in materials], dtype=bool)[geometry.face_material[visible]]
        return _Metal(np.asarray(geometry.vertices[geometry.faces[visible]], dtype=np.float64), metal)


def _edges(found: _Metal) -> SharpEdges:
    """Sharp metal edges of a scene, thinned where there are many; edges that touch other objects included."""
    edges = sharp_edges(found.corners, found.metal)
    return edges.of(np.unique(np.linspace(0, edges.n - 1, min(edges.n, EDGES)).astype(np.int64)))


def _strongest(edges: SharpEdges, context: SceneContext, *, bounces: bool) -> float:
    """Upper bound of the RCS added by an edge in a resolution cell, m^2; with paths over the ground."""
    aperture = _aperture(context)
    best = float(edge_bounds(edges, aperture).max(initial=0.0))
    ground, lowest = _ground(context) if bounces else ((), np.inf)
    raised = edges.of(edges.middle[:, 2] + 0.5 * edges.length * np.abs(edges.along[:, 2]) > lowest + 1e-3)
    if not raised.n:
        return best
    look = aperture.places - raised.middle.mean(axis=0)
    mirror = _mirror(context, ground, float((np.abs(look[:, 2]) / np.linalg.norm(look, axis=1)).mean()))
    # one antenna: the path over the ground and its reverse add up
    ways = [((True, False), 2.0 * mirror), ((True, True), mirror**2)]
    if context.scene.radar.receiver is not None:
        ways.append(((False, True), 2.0 * mirror))
    for mirrors, factor in ways:
        best = max(best, factor**2 * float(edge_bounds(raised, aperture, mirrors).max()))
    return best


def _aperture(context: SceneContext) -> Aperture:
    """Antenna positions distributed over the aperture, and the resolution cell."""
    tracks, facts = context.scene.radar.tracks, context.sampling
    pulses = tracks[0].n_pulses
    pick = np.unique(np.linspace(0, pulses - 1, min(pulses, POSITIONS)).astype(int))
    places = tracks[0].position[pick]
    flown = tracks[0].position[np.minimum(pick + 1, pulses - 1)] - tracks[0].position[np.maximum(pick - 1, 0)]
    flown = flown / np.maximum(np.linalg.norm(flown, axis=1, keepdims=True), 1e-300)
    receivers = places if len(tracks) == 1 else tracks[-1].position[pick]
    cells = (np.inf, np.inf) if facts is None else (facts.azimuth_cell, facts.range_cell)
    return Aperture(places, receivers, flown, context.wavenumber, *cells)


def _ground(context: SceneContext) -> tuple[tuple[Material, ...], float]:
    """Materials of visible level faces and the height of the lowest, m; none and infinite where there is none."""
    geometry, materials = context.scene.geometry, context.scene.materials
    visible = ~np.array([m.invisible for m in materials], dtype=bool)[geometry.face_material]
    corners = geometry.vertices[geometry.faces[visible]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = np.abs(normal[:, 2]) > LEVEL * np.linalg.norm(normal, axis=1)
    if not level.any():
        return (), np.inf
    found = with_parts([materials[i] for i in np.unique(geometry.face_material[visible][level])])
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


def _places(context: SceneContext) -> F64:
    pick = np.unique(
        np.linspace(0, len(context.antenna) - 1, min(len(context.antenna), POSITIONS)).astype(int)
    )
    return np.asarray(context.antenna[pick])


def _reference(
    found: _Metal, context: SceneContext, decided: Mapping[str, Decision]
) -> tuple[float, float, str]:
    """Reference RCS (clutter or peak of the image), m^2, allowed level relative to it, dB, and its name."""
    pilot = context.pilot
    if pilot is not None and pilot.total > 0.0:
        if pilot.clutter > 0.0:
            return pilot.clutter, CELL_BELOW_CLUTTER_DB, "of the clutter of a cell"
        return float(pilot.peak[3].max()), context.tolerance_db, "of the strongest cell"
    if context.sampling is not None and decided["diffuse"].on:
        return _clutter(context), CELL_BELOW_CLUTTER_DB, "of the clutter of a cell"
    return _facets(found, context), context.tolerance_db, "of the metal's facets"


def _clutter(context: SceneContext) -> float:
    """RCS of a cell of the roughest material at 45 degrees, m^2."""
    assert context.sampling is not None
    wavelength, best = context.scene.radar.waveform.wavelength, 0.0
    for material in context.unlike_materials:
        if material.scatters:
            table = diffuse_tables(material, wavelength, 3)
            best = max(best, float(table.amplitude_h[1]) ** 2, float(table.amplitude_v[1]) ** 2)
    return best * context.sampling.cell**2


def _facets(found: _Metal, context: SceneContext) -> float:
    """Largest physical-optics RCS of a metal plane, or of a cell of it, at any antenna position, m^2."""
    corners = found.corners[found.metal]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    corners, normal, size = (x[size > 0.0] for x in (corners, normal, size))
    if not size.size:
        return 0.0
    normal /= size[:, None]
    offset = np.einsum("ni,ni->n", corners[:, 0], normal)
    # the terms of common sides of coplanar triangles cancel
    alike = np.round(np.column_stack([normal, offset / max(float(np.ptp(corners)), 1e-9)]), 4)
    _, plane = np.unique(alike, axis=0, return_inverse=True)
    cell = context.sampling.cell if context.sampling is not None else np.inf
    best = 0.0
    for place in _places(context):
        look = place - corners.mean(axis=1)
        distance = np.linalg.norm(place - corners, axis=2)
        cosine = np.abs(np.einsum("ni,ni->n", look, normal)) / np.linalg.norm(look, axis=1)
        # integral of a linear phase over a triangle, from its three corners
        phase = 2.0 * context.wavenumber * (distance - distance.min())
        share = 0.5 * size * np.exp(-1j * phase[:, 0]) * _over_triangle(phase - phase[:, :1]) * cosine
        total = np.abs(_sums(plane.reshape(-1), share))
        best = max(best, float(np.square(np.minimum(total, cell**2)).max()))
    return best * context.wavenumber**2 / np.pi


def _over_triangle(phase: F64) -> C128:
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
