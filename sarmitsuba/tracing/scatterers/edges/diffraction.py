"""Edge diffraction of metal: Michaeli's equivalent fringe currents along sharp edges, added to physical optics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.sharp_edges import DIRECTIONS, SharpEdges, metal_edges, sharp_edges
from sarmitsuba.scene.visible_faces import VisibleFaces
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.intersector import intersector, leave_surface, query_ray
from sarmitsuba.tracing.kernel.leg import Leg
from sarmitsuba.tracing.kernel.source import Scatterers
from sarmitsuba.tracing.kernel.stage import apply_at_mirror
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.kernel.table_rows import MaterialRow
from sarmitsuba.tracing.scatterers.edges.edge_currents import (
    FAR,
    FringeStrip,
    PlateRim,
    SheetWave,
    WedgeFace,
    sinc,
)

if TYPE_CHECKING:
    from sarmitsuba.tracing.derivatives.leg_tangents import Shift

# longest piece of an edge, wavelengths, unless the rays of surfaces are farther apart, or the resolution cell is
# smaller: visibility is decided piece by piece
LONGEST = 2.0
# distance from an edge (wavelengths, share of its piece) within which another object counts as touching it
REACH, REACH_SHARE = 0.02, 0.25
# corners of the closed path round an edge along which touching objects are searched
PROBES = 8
# radius of that path round the rim of a plate, thicknesses: outside of it from a tenth of the circle on
ROUND = 1.25
# bisection steps for the width of a sheet
BISECTIONS = 14
# phase integral of a piece, over its length, that counts as zero in its derivative
LEAST_SINC = 1e-2
# widths of the gap between two faces at which shadow rays from their edge start
GAPS = 2.0
# places along all edges at which the widths of sheets are found, or one on each piece where there are fewer
SPANS = 20_000


def edges_of(
    geometry: Geometry,
    materials: tuple[Material, ...],
    wavelength: float,
    cell: float = np.inf,
    spacing: float = 0.0,
) -> SharpEdges:
    """Sharp metal edges of a scene, cut into pieces, without edges that touch another object and edges that move.

    Parameters
    ----------
    geometry, materials : of the scene
    wavelength : m
    cell : m, bound on the length of a piece
    spacing : m between the rays of surfaces: pieces are as long, or ``LONGEST`` wavelengths where that is more
    """
    visible = VisibleFaces.of(geometry, materials)
    corners, still = visible.corners, np.ones(geometry.n_faces, dtype=bool)
    for _, faces in geometry.moving_meshes():
        still[faces] = False
    metal = visible.metal & still[visible.face]
    if not metal.any():
        return sharp_edges(np.zeros((0, 3, 3)), np.zeros(0, dtype=bool))
    edges = metal_edges(corners, metal, wavelength, visible.shape)
    longest = min(max(LONGEST * wavelength, spacing), cell)
    scene = intersector(corners.astype(np.float32))
    edges = edges.cut(max(longest, float(edges.length.sum()) / SPANS))
    edges = replace(edges, span=spans(edges, scene, geometry.diameter)).cut(longest)
    edges = edges.of(find_uncovered(edges, scene, wavelength))
    height = np.array([m.rms_height for m in materials])[geometry.face_material[visible.face]]
    if not height[metal].any():
        return edges
    return replace(edges, rms_height=_rms_heights(edges, scene, height, geometry.diameter))


def spans(edges: SharpEdges, scene: mi.Scene, largest: float) -> F64:
    """Widths (n, DIRECTIONS), m, of the metal sheets behind rims.

    See :class:`sarmitsuba.scene.mesh.sharp_edges.SharpEdges`.

    By bisection, with short rays across the sheet's plane: correct for sheets without holes.

    Parameters
    ----------
    edges : pieces of edges
    scene : intersection structure of everything that waves meet
    largest : m, upper bound of the width
    """
    out = np.full((edges.n, DIRECTIONS), np.inf)
    rims = np.flatnonzero(edges.angle == 2.0)
    if not rims.size:
        return out
    rim = edges.of(rims)
    turn = np.pi * ((np.arange(DIRECTIONS) + 0.5) / DIRECTIONS - 0.5)
    directions = np.cos(turn)[:, None] * rim.inward[:, None, 0] + np.sin(turn)[:, None] * rim.along[:, None]
    up = np.broadcast_to(rim.normal[:, None, 0], directions.shape)
    reach = max(1e-4 * largest, 16.0 * 2.0**-24 * float(np.abs(edges.middle).max()))
    # through both faces of a plate
    up = up * (reach + rim.thickness)[:, None, None]
    low, high = np.zeros(directions.shape[:2]), np.full(directions.shape[:2], largest)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        place = rim.middle[:, None] + middle[..., None] * directions - up
        there = _meets_triangle(scene, place.reshape(-1, 3), (2.0 * up).reshape(-1, 3)).reshape(middle.shape)
        low, high = np.where(there, middle, low), np.where(there, high, middle)
    out[rims] = 0.5 * (low + high)
    return out


def _rms_heights(edges: SharpEdges, scene: mi.Scene, height: F64, largest: float) -> F64:
    """Rms heights (n, 2), m, of both faces of edges, of which short rays find the triangles.

    Parameters
    ----------
    edges : pieces of edges
    scene : intersection structure of all triangles
    height : (n_triangles,) m
    largest : m, extent of the scene
    """
    reach = max(1e-4 * largest, 16.0 * 2.0**-24 * float(np.abs(edges.middle).max(initial=0.0)))
    inside = np.minimum(4.0 * reach, REACH_SHARE * edges.length)[:, None]
    out = np.zeros((edges.n, 2))
    for i in range(2):
        up = edges.normal[:, i] * (reach + edges.thickness)[:, None]
        found = scene.ray_intersect_preliminary(
            _steps(edges.middle + inside * edges.inward[:, i] + up, -2.0 * up),
            coherent=True,
            active=mi.Bool(True),
        )
        there = np.asarray(found.is_valid(), dtype=bool)
        out[there, i] = height[np.asarray(found.prim_index, dtype=np.int64)[there]]
    return out


def _steps(start: F64, step: F64) -> mi.Ray3f:
    """Rays along straight steps (n, 3) from points (n, 3), m."""
    origin, direction = (
        [device_array(mi.Float, np.ascontiguousarray(column, dtype=np.float32)) for column in rows.T]
        for rows in (start, step)
    )
    return query_ray(mi.Point3f(*origin), mi.Vector3f(*direction), mi.Float(1.0))


def _meets_triangle(scene: mi.Scene, start: F64, step: F64) -> NDArray[np.bool_]:
    """Whether (n,) straight steps (n, 3) from points (n, 3) meet a triangle."""
    return np.asarray(scene.ray_test(_steps(start, step)), dtype=bool)


def find_uncovered(edges: SharpEdges, scene: mi.Scene, wavelength: float) -> NDArray[np.bool_]:
    """Edges (n,) that touch no other object: a path round the middle of each, through its exterior, meets no triangle.

    Parameters
    ----------
    edges : pieces of edges
    scene : intersection structure of everything that waves meet
    wavelength : m
    """
    if not edges.n:
        return np.zeros(0, dtype=bool)
    rounding = 16.0 * 2.0**-24 * np.abs(edges.middle).max()
    reach = np.maximum(np.minimum(REACH * wavelength, REACH_SHARE * edges.length), rounding)
    reach = np.maximum(reach, GAPS * edges.gap)  # past a face that reaches over the other
    # from a sixteenth of the exterior off face a to as much off face b; round the face between the corners of a plate
    reach = np.maximum(reach, ROUND * edges.thickness)
    least = np.where(edges.thickness > 0.0, 1.0 / 10.0, 1.0 / 16.0)
    share = np.linspace(least, 1.0 - least, PROBES, axis=1)
    turn = np.pi * edges.angle[:, None] * share
    rim = (
        np.cos(turn)[..., None] * edges.inward[:, None, 0]
        + np.sin(turn)[..., None] * edges.normal[:, None, 0]
    )
    path = edges.middle[:, None] + reach[:, None, None] * rim
    start, step = path[:, :-1].reshape(-1, 3), np.diff(path, axis=1).reshape(-1, 3)
    met = _meets_triangle(scene, start, step).reshape(edges.n, PROBES - 1)
    return np.asarray(~met.any(axis=1))


class FringeCurrents(Scatterers):
    r"""Michaeli's equivalent fringe currents of short straight edges, with the phase integral over each.

    .. math::
        \sqrt\sigma = \frac{j}{\sqrt\pi} l\, \mathrm{sinc}\left(\tfrac12 k l (\hat d - \hat s) \cdot \hat z\right)
        \mathbf q \cdot \sum_{a, b} \left[ \hat z \frac{E_z D_s + \cos\beta' H_z (\mu D_h - \frac1N + U)}
        {\sin^2\beta'} + \hat x \frac{H_z D_h}{\sin\beta'} \right]

    with H in units of the field. The coefficients of a face, lit (U = 1) or not,

    .. math::
        D_s = -\tfrac12 [C(\tfrac{\phi' + a}2) + C(\tfrac{\phi' - a}2)], \quad
        D_h = \frac{C(\tfrac{\phi' + a}2) - C(\tfrac{\phi' - a}2)}{2 \sin a}, \quad
        C(x) = \tfrac1N \cot\tfrac xN - U \cot x

    are finite where the exact and the physical-optics current both diverge, since their poles at x = 0 cancel. Where
    :math:`\mu = -\cos a` is below -1, a is imaginary and x complex. :func:`sarmitsuba.truth.theory.fringe_strip` has
    the geometry. The mean of a path and of the reversed one is taken, so that ``S_HV = S_VH``.

    Parameters
    ----------
    edges : pieces

    Notes
    -----
    Of the interactions between edges the waves along a sheet from rim to rim are included, electric field across the
    sheet: from the source over the other rim, to the observer over the other rim, and both, see
    :func:`sarmitsuba.truth.theory.plate_along_its_sheet`. The magnetic part of the fringe counts

    .. math::
        Q = 1 + \frac1R \left[ \frac{T_s - 1}{\cos\frac{\phi_o}2} + \frac{T_o - 1}{\cos\frac{\phi_s}2}
        + (T_s - 1)(T_o - 1) \right]

    times, with R the modulus of the fringe coefficient of a rim, mean of both orders, and the angles of source and
    observer off the sheet in the plane across the rim.

    Rims of thin plates are those of half planes in their middle, see
    :class:`sarmitsuba.tracing.scatterers.edges.edge_currents.PlateRim`; the
    narrow face's optical return is taken off, as far as rays find it.

    Waves along a sheet are taken in the middles of pieces, also those over a rim that is not parallel: obliquely to the
    rims of a sheet a few wavelengths wide they depend on the length of the pieces. Pieces of an eighth of a wavelength
    are not nearer to the method of moments than those of two (drawn plates of ``benchmarks/studies/theory_error.py``).

    The waves of a rough face, of the rms height s and with the normal n, are less by its coherent loss as those of the
    face itself, :math:`e^{-(k (\hat s + \hat d) \cdot \hat n s)^2 / 2}` with the directions to both antennas.

    Ignores corners, other waves between edges and the curvature of edges. Within a
    thousandth of the forward direction of a grazing wave, where the theory diverges, the value at that distance is
    taken.
    """

    mechanism = "edge"

    def __init__(self, edges: SharpEdges) -> None:
        self.n, self.middle = edges.n, edges.middle
        self._wedge: _Wedge | None = None
        self._middle = device_array(mi.Float64, edges.middle)
        rows = [
            np.column_stack([edges.inward[:, 0], edges.angle]),
            np.column_stack([edges.normal[:, 0], edges.length]),
            np.column_stack([edges.inward[:, 1], edges.weight * edges.parts[:, 0]]),
            np.column_stack([edges.normal[:, 1], edges.weight * edges.parts[:, 1]]),
        ]
        self._table = device_array(mi.Float, np.stack(rows, axis=1).astype(np.float32))
        span = np.minimum(edges.span, FAR).astype(np.float32)
        self._span = self._thickness = self._gap = self._rough = None
        if edges.rms_height.any():
            self._rough = device_array(mi.Float, edges.rms_height.astype(np.float32))
        plates = bool(edges.thickness.any())
        if plates or (span < 0.5 * FAR).any():  # else no wave runs along a sheet, and the kernel has none
            self._span = device_array(mi.Float, span)
        if plates:
            self._thickness = device_array(mi.Float, edges.thickness.astype(np.float32))
        if (edges.gap > 0.0).any():
            self._gap = device_array(mi.Float, edges.gap.clip(0.0).astype(np.float32))

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """See :class:`sarmitsuba.tracing.kernel.source.Scatterers`."""
        return dr.gather(mi.Vector3d, self._middle, index)

    def departure(
        self, index: mi.UInt32, point: mi.Vector3f, direction: mi.Vector3f, clearance: mi.Float
    ) -> mi.Vector3f:
        """Start of a shadow ray, m: off both faces of the wedge and past the gap between them, along the direction."""
        first, second = self._row(index, 0), self._row(index, 2)
        if self._gap is not None:
            clearance = clearance + GAPS * dr.gather(mi.Float, self._gap, index)
        inward = mi.Vector3f(first.x + second.x, first.y + second.y, first.z + second.z)
        start = leave_surface(point, direction, dr.normalize(inward), clearance)
        if self._thickness is None:
            return start
        # off the plate's corner on the side of the leg
        up = self._row(index, 1)
        normal, thickness = mi.Vector3f(up.x, up.y, up.z), dr.gather(mi.Float, self._thickness, index)
        off = 0.5 * thickness + dr.select(thickness > 0.0, clearance, 0.0)
        return start + normal * dr.copysign(off, dr.dot(direction, normal))

    def shifts(
        self, kernel: Kernel, index: mi.UInt32, incident: Leg, scattered: Leg
    ) -> Sequence[Shift | None]:
        r"""Velocities of the edges of shapes that are displaced, and how their lengths and phase integrals grow.

        With the derivatives :math:`\dot l = l \, \hat z \cdot A \hat z` and :math:`\dot z = A \hat z` across the edge,
        and :math:`x = \tfrac12 k l w, w = (\hat d - \hat s) \cdot \hat z`, the factor :math:`l \, \mathrm{sinc} \, x`
        grows by :math:`\cos x \, \dot l + \tfrac12 k l^2 \, \mathrm{sinc}' x \, \dot w`.

        Notes
        -----
        Ignores that the angles of the waves to the faces change.
        """
        carried = derivatives_of(kernel).displacements
        if all(offset is None for offset in carried.offset):
            return ()
        first, second = (self._row(index, i) for i in range(2))
        inward, normal = (mi.Vector3f(row.x, row.y, row.z) for row in (first, second))
        middle, length = self.point(index), second.w
        step = 4.0 * kernel.constants.clearance
        if self._thickness is not None:
            step = step + 0.5 * dr.gather(mi.Float, self._thickness, index)
        down = query_ray(mi.Vector3f(middle) + (inward + normal) * step, -normal)
        found = kernel.scene.mi_scene.ray_intersect_preliminary(down, coherent=True, active=mi.Bool(True))
        there, face = found.is_valid(), found.prim_index
        along = mi.Vector3d(dr.cross(inward, normal))
        wave = mi.Vector3d(incident.to_antenna + scattered.to_antenna)
        half = 0.5 * kernel.constants.wavenumber * length
        x = half * mi.Float(dr.dot(wave, along))
        s, c = dr.sincos(x)
        value = dr.select(dr.abs(x) < 1e-3, 1.0, s / dr.select(x == 0.0, 1.0, x))
        slope = dr.select(dr.abs(x) < 1e-3, -x / 3.0, (c - value) / dr.select(x == 0.0, 1.0, x))
        kept = dr.abs(value) > LEAST_SINC
        shifts: list[Shift | None] = []
        for k, offset in enumerate(carried.offset):
            movement = carried.movement(k, face, middle, there)
            if offset is None or movement is None:
                shifts.append(None)
                continue
            turned = carried.turned(k, along)
            longer = dr.dot(turned, along)
            bend = mi.Float(dr.dot(wave, turned - along * longer))
            growth = (c * mi.Float(longer) + half * slope * bend) / dr.select(kept, value, 1.0)
            moves = carried.moves(k, face, there) & kept
            shifts.append((movement.velocity, dr.select(moves, growth, 0.0)))
        return shifts

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        """See the class."""
        if self._wedge is None or not self._wedge.sees(incident, scattered):
            # one wedge for all channels of two legs, and for the reversed path
            if self._wedge is not None and self._wedge.sees(scattered, incident):
                self._wedge = self._wedge.reversed
            else:
                rows = [self._row(index, i) for i in range(4)]
                thickness = None
                if self._thickness is not None:
                    thickness = dr.gather(mi.Float, self._thickness, index)
                width = None if self._span is None else partial(_width, self._span, index)
                rough = None
                if self._rough is not None:
                    rough = tuple(dr.gather(mi.Float, self._rough, index * 2 + i) for i in range(2))
                self._wedge = _Wedge.of(kernel, rows, incident, scattered, width, thickness, rough)
        return self._wedge.amplitude(e, q)

    def _row(self, index: mi.UInt32, i: int) -> mi.Vector4f:
        return dr.gather(mi.Vector4f, self._table, index * 4 + i)


def _width(span: mi.Float, index: mi.UInt32, turn: mi.Float) -> mi.Float:
    """Width of the sheet behind a rim, m, in a direction ``turn`` off its inward normal.

    Between two tabulated directions the other rim is straight.
    """
    place = dr.clip((turn / dr.pi + 0.5) * DIRECTIONS - 0.5, 0.0, DIRECTIONS - 1.0)
    low = dr.minimum(mi.UInt32(place), DIRECTIONS - 2)
    step = np.pi / DIRECTIONS
    share = (place - mi.Float(low)) * step
    near, far = (dr.gather(mi.Float, span, index * DIRECTIONS + low + i) for i in (0, 1))
    inverse = dr.sin(step - share) / near + dr.sin(share) / far
    return dr.select(dr.maximum(near, far) < 0.5 * FAR, float(np.sin(step)) / inverse, FAR)


def _coherent(kernel: Kernel, height: mi.Float, cosine: mi.Float) -> mi.Float:
    """Factor of all stages on waves of metal of an rms height, m, as on those mirrored at an angle of this cosine."""
    row, one = MaterialRow(mi.Vector4f(0.0, 0.0, height, 0.0)), mi.Vector3f(1.0, 0.0, 0.0)
    ((kept, _),) = apply_at_mirror(kernel, row, cosine, ((one, mi.Vector3f(0.0)),))
    return kept.x


@dataclass(frozen=True, eq=False)
class _Wedge:
    """Diffraction coefficients of a piece of edge for an incident and a scattered wave.

    Parameters
    ----------
    legs : of the incident and of the scattered wave
    strips : fringe currents of both faces, for the path and for the reversed one
    gain : m, length of the piece times its normalised phase integral over twice the root of pi; 0 where either
        direction lies inside the metal
    electric, magnetic : shares of the parts with the electric and the magnetic field along the edge
    along : factor of the magnetic part by waves along the sheet; None where no edge is the rim of one
    plate : contribution of the thickness of a plate to its rim
    losses : factors on the waves of both faces by their roughness; None where they are smooth
    """

    legs: tuple[Leg, Leg]
    strips: tuple[tuple[FringeStrip, FringeStrip], ...]
    gain: mi.Float
    electric: mi.Float
    magnetic: mi.Float
    along: mi.Complex2f | None
    plate: PlateRim | None = None
    losses: tuple[mi.Float, ...] | None = None

    @staticmethod
    def of(
        kernel: Kernel,
        rows: list[mi.Vector4f],
        incident: Leg,
        scattered: Leg,
        width: Callable[[mi.Float], mi.Float] | None,
        thickness: mi.Float | None,
        rough: tuple[mi.Float, ...] | None = None,
    ) -> _Wedge:
        """Wedge from the rows of the edge table; width by direction and thickness of a sheet, where there is one.

        ``rough`` : m, rms heights of both faces; None where they are smooth
        """
        n, length = rows[0].w, rows[1].w
        faces = [
            WedgeFace.of(mi.Vector3f(x.x, x.y, x.z), mi.Vector3f(y.x, y.y, y.z))
            for x, y in (rows[:2], rows[2:])
        ]
        source, observer = incident.to_antenna, scattered.to_antenna
        strips, outside = [], mi.Float(1.0)
        for face in faces:
            out = FringeStrip.of(face, n, source, observer)
            into = out if incident is scattered else FringeStrip.of(face, n, observer, source)
            outside = dr.minimum(outside, dr.minimum(out.outside, into.outside))
            strips.append((out, into))
        k = kernel.constants.wavenumber
        turn = dr.dot(source + observer, faces[0].along) * (0.5 * k) * length
        gain = (0.5 / float(np.sqrt(np.pi))) * length * sinc(turn) * outside
        losses = None
        if rough is not None:
            losses = tuple(
                _coherent(kernel, height, 0.5 * dr.dot(source + observer, face.normal))
                for height, face in zip(rough, faces, strict=True)
            )
        shares = rows[2].w, rows[3].w
        if width is None:
            return _Wedge((incident, scattered), tuple(strips), gain, *shares, None, losses=losses)
        there = SheetWave.of(faces[0], n, source, k, width)
        back = there if incident is scattered else SheetWave.of(faces[0], n, observer, k, width)
        plate = None
        if thickness is not None:
            plate = PlateRim.of(faces[0], thickness, k, (source, observer), (there.sine, back.sine))
        return _Wedge(
            (incident, scattered), tuple(strips), gain, *shares, there.with_other(back), plate, losses
        )

    @property
    def reversed(self) -> _Wedge:
        """The same wedge for the reversed path."""
        incident, scattered = self.legs
        strips = tuple((into, out) for out, into in self.strips)
        plate = None if self.plate is None else self.plate.reversed
        return replace(self, legs=(scattered, incident), strips=strips, plate=plate)

    def sees(self, incident: Leg, scattered: Leg) -> bool:
        """Whether the wedge was made for these two legs."""
        return self.legs[0] is incident and self.legs[1] is scattered

    def amplitude(self, e: field.ComplexVector, q: field.ComplexVector) -> mi.Complex2f:
        """Square root of the RCS with its phase, m: mean of the path and of the reversed one."""
        total = mi.Complex2f(0.0)
        magnetic = self.magnetic if self.along is None else self.along * self.magnetic
        for i, (out, into) in enumerate(self.strips):
            wave = out.current(e, q, self.electric, magnetic) + into.current(q, e, self.electric, magnetic)
            total += wave if self.losses is None else wave * self.losses[i]
        if self.plate is not None:
            wave = self.plate.current(e, q, self.electric, self.magnetic)
            total += wave if self.losses is None else wave * self.losses[0]
        return mi.Complex2f(-total.imag, total.real) * self.gain
