"""Propagation of rays in the kernel: launch, intersection (with the tube's footprint on the facet), reflection."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.mesh.boundary_edges import N_EDGES
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.antenna_weight import fade
from sarmitsuba.tracing.kernel.device_arrays import device_array, vector_rows
from sarmitsuba.tracing.kernel.intersector import leave_surface, query_ray
from sarmitsuba.tracing.kernel.leg import Surroundings, beam_patterns
from sarmitsuba.tracing.kernel.movement import ShadowBoundary
from sarmitsuba.tracing.kernel.passage import pass_all
from sarmitsuba.tracing.kernel.scene_tables import CLOSED_BIT, INNER_BIT, MATERIAL_MASK
from sarmitsuba.tracing.kernel.stage import apply_at_launch, apply_at_mirror
from sarmitsuba.tracing.kernel.state import (
    Hit,
    Kernel,
    Lane,
    LaunchPlace,
    Mirror,
    RayState,
    Reflection,
    TubeFootprint,
    TubeSpread,
)
from sarmitsuba.tracing.kernel.table_rows import FaceRow, MaterialRow, SlabRow
from sarmitsuba.tracing.kernel.tubes import polygon, tube
from sarmitsuba.tracing.kernel.tubes import tube as curved_mirror
from sarmitsuba.tracing.scatterers.corners.metal_corners import mirror_at
from sarmitsuba.tracing.scatterers.slabs.slab_passage import slab_factors

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.field import ComplexVector
    from sarmitsuba.tracing.kernel.launch import LaunchGrid, PulseBatch, Purpose
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene

    # face, barycentric coordinates, and the lanes that hit something
    Found = tuple[mi.UInt32, mi.Vector2f, mi.Bool]


# displacement of a ray that missed at a vertex, over the largest coordinate: float32 rounding of its origin and of the
# triangle. Rays beside a facet that hit it by more would add their cells to it
NUDGE = 2.0**-21


def launch(kernel: Kernel, antenna: Antenna) -> tuple[Lane, RayState]:
    """Start every ray of the grid from every pulse: lane = pulse * n_rays + ray."""
    f32, f64, u32, v32, v64 = mi.Float, mi.Float64, mi.UInt32, mi.Vector3f, mi.Vector3d
    grid, pulses, flags, constants = kernel.grid, kernel.pulses, kernel.flags, kernel.constants
    number = dr.arange(u32, grid.n_rays * pulses.n_pulses)
    n_rays = dr.opaque(u32, grid.n_rays)
    pulse = number // n_rays
    ray = number - pulse * n_rays
    row = number if grid.n_own > 1 else ray
    gx, gy = (dr.gather(f32, device_array(f32, x), row) for x in (grid.x, grid.y))
    plane = pulse if pulses.frame.center.shape[0] > 1 else dr.zeros(u32, 1)
    center, axis_x, axis_y = (
        dr.gather(v64, vector_rows(rows), plane)
        for rows in (pulses.frame.center, pulses.frame.axis_x, pulses.frame.axis_y)
    )
    position, velocity = antenna_of(pulses, pulse)

    start = center + axis_x * f64(gx) + axis_y * f64(gy)
    leg = start - position
    distance = dr.norm(leg)
    d64 = leg / distance
    d = v32(d64)
    origin = v32(start - d64 * dr.minimum(distance, measure_to_bounds(start, d64, kernel.scene)))

    spacing, needs, serves, level_weight = _level(grid, ray)
    edge_a, edge_b = _lattice_edges(spacing, constants.turn, axis_x, axis_y, d)
    inverse_start = f32(1.0 / distance)
    weight = _launch_weight(kernel, gx, gy)
    beams = beam_patterns(kernel, antenna, pulse, d if flags.multi_bounce else None)
    if beams is not None:
        weight *= beams[0].one_way(d)
    receiver, receiver_velocity = position, velocity
    if pulses.receiver is not None:
        receiver, receiver_velocity = antenna_of(pulses.receiver, pulse)
    apart = kernel.bistatic and (kernel.reciprocal_diffuse or kernel.reversible)
    h, v = field.polarisation_basis(d, constants.up)

    lane = Lane(
        pulse=pulse,
        antenna=receiver,
        velocity=receiver_velocity,
        transmitter=position,
        transmitter_velocity=velocity,
        tube_area=dr.norm(dr.cross(edge_a, edge_b)),
        inverse_start=inverse_start,
        tube_rate_a=dr.dot(edge_a, v32(velocity)) * inverse_start,
        tube_rate_b=dr.dot(edge_b, v32(velocity)) * inverse_start,
        nudge=dr.normalize(edge_a) * dr.opaque(f32, NUDGE * kernel.scene.extent),
        needs=needs,
        serves=serves,
        weight=level_weight,
        pattern=None if beams is None else beams[1],
        time=None if pulses.time is None else dr.gather(f64, device_array(f64, pulses.time), pulse),
    )
    state = RayState(
        active=dr.full(mi.Bool, True, grid.n_rays * pulses.n_pulses),
        hits=u32(0),
        origin=origin,
        direction=d64,
        virtual_antenna=position,
        virtual_velocity=velocity,
        virtual_receiver=receiver if apart else None,
        virtual_receiver_velocity=receiver_velocity if apart else None,
        edge_a=edge_a,
        edge_b=edge_b,
        spread=TubeSpread(edge_a * inverse_start, edge_b * inverse_start, distance)
        if kernel.curved
        else None,
        extent=tube.make_unlimited(),
        shadow_boundary=None if kernel.scene.movers is None else ShadowBoundary.open(),
        fields=tuple(field.transmit_field(letter, h, v, weight) for letter in flags.tracked),
        contributions=u32(0),
        crossed=u32(0) if kernel.transmits else None,
        mirror=Mirror.none() if kernel.reversible else None,
    )
    state = apply_at_launch(kernel, lane, state)
    return derivatives_of(kernel).at_launch(
        kernel, lane, state, LaunchPlace(row, distance, (axis_x, axis_y), None if beams is None else beams[0])
    )


def _level(
    grid: LaunchGrid, ray: mi.UInt32
) -> tuple[mi.Float64, tuple[mi.Float, mi.Float], tuple[mi.Bool, mi.Bool], mi.Float]:
    """Spacing and bounds on the needs of a lane's level, m; bounces that it serves; factor on its amplitudes."""
    # also with one level: the same kernel serves lattices with and without denser parts
    bounces = {"all": 0.0, "first": 1.0, "later": 2.0}
    table = np.array([[level.spacing, *level.needs, bounces[level.serves]] for level in grid.every_level])
    row = dr.gather(mi.UInt32, device_array(mi.UInt32, grid.level), ray)
    weights = np.array([level.weight for level in grid.every_level], dtype=np.float32)
    spacing, low, high, serves = dr.gather(mi.Vector4d, device_array(mi.Float64, table), row)
    weight = dr.gather(mi.Float, device_array(mi.Float, weights), row)
    return spacing, (mi.Float(low), mi.Float(high)), (serves < 1.5, (serves < 0.5) | (serves > 1.5)), weight


def antenna_of(pulses: PulseBatch, pulse: mi.UInt32) -> tuple[mi.Vector3d, mi.Vector3d]:
    """Position and velocity of each lane's pulse."""
    return (
        dr.gather(mi.Vector3d, vector_rows(pulses.position), pulse),
        dr.gather(mi.Vector3d, vector_rows(pulses.velocity), pulse),
    )


def _lattice_edges(
    spacing: mi.Float64, turn: mi.Float64, axis_x: mi.Vector3d, axis_y: mi.Vector3d, d: mi.Vector3f
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Cross-section of a tube at the launch plane: the lattice's two steps, across the ray, m."""
    c, s = dr.cos(turn) * spacing, dr.sin(turn) * spacing
    a = mi.Vector3f(axis_x * c + axis_y * s)
    b = mi.Vector3f(axis_y * c - axis_x * s)
    return a - d * dr.dot(a, d), b - d * dr.dot(b, d)


def _launch_weight(kernel: Kernel, gx: mi.Float, gy: mi.Float) -> mi.Float:
    """Amplitude taper of a ray by its position in the launch window."""
    grid = kernel.grid
    if kernel.flags.taper:
        return fade(gx, grid.half_x, grid.taper) * fade(gy, grid.half_y, grid.taper)
    return mi.Float(1.0)


def _serves_face(purpose: Purpose, needs: tuple[mi.Float, mi.Float], info: FaceRow) -> mi.Bool:
    """Whether a ray samples a face: each face is sampled by the rays of one level, which is fine enough for it."""
    coherent, diffuse = info.needed_spacings
    need = {"coherent": coherent, "diffuse": diffuse, "all": dr.minimum(coherent, diffuse)}[purpose]
    return (need >= needs[0]) & (need < needs[1])


def measure_to_bounds(start: mi.Vector3d, d: mi.Vector3d, scene: TraceScene) -> mi.Float64:
    """Distance from ``start`` back to where the ray enters the scene's bounds, m: there float32 is most accurate."""
    low, high = (mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in corner)) for corner in scene.bounds)
    inverse = 1.0 / dr.select(dr.abs(d) > 1e-12, d, 1e-12)
    a, b = (low - start) * inverse, (high - start) * inverse
    near, far = dr.minimum(a, b), dr.maximum(a, b)
    entry = dr.maximum(dr.maximum(near.x, near.y), near.z)
    leaving = dr.minimum(dr.minimum(far.x, far.y), far.z)
    extent = dr.opaque(mi.Float64, scene.extent)
    return dr.select(entry < leaving, 0.01 * extent - entry, 4.0 * extent + dr.norm(start))


def arrive(kernel: Kernel, lane: Lane, ray: RayState, found: Found) -> Hit:
    """Hit of a ray on the facet found, with the direction, distance and visibility of the antenna from it."""
    scene, clearance = kernel.scene, kernel.constants.clearance
    first = ray.hits == 0
    face, uv, active = found
    landed, n64, vertex0, centroid = hit_point(scene, face, uv, active)
    info = FaceRow.of(scene.face_info, face, active)
    met = active
    active = active & (~first | _serves_face(kernel.grid.purpose, lane.needs, info))
    # also rays that sample objects behind a slab go through it
    known = met if kernel.transmits else active

    # the float32 hit lies a few 1e-7 of the scene's size beside the ray: replace it by the float64 intersection
    p = _land_on_plane(landed, n64, ray.virtual_antenna, ray.direction, 1e3 * clearance)
    # the ray as the virtual antenna sees this hit
    length = dr.norm(p - ray.virtual_antenna)
    d64 = (p - ray.virtual_antenna) / length
    behind = dr.dot(d64, n64) > 0.0
    n64 = dr.select(behind, -n64, n64)
    n, d = mi.Vector3f(n64), mi.Vector3f(d64)
    before = None
    if scene.slabs is not None and scene.slabs.sheets:
        # the slab's face that the wave meets, with the facet's outline moved along the ray: tubes tile it as they
        # tile the facet
        before = scene.slabs.before(face, behind, met) / dr.maximum(-dr.dot(d, n), 1e-3)
        step = d64 * mi.Float64(-before)
        p, vertex0, centroid, length = p + step, vertex0 + step, centroid + step, length - before
        # no farther back than the origin of the ray, which may lie within the slab
        landed = landed - d64 * mi.Float64(dr.minimum(before, dr.norm(mi.Vector3f(landed) - ray.origin)))

    length_back = dr.norm(lane.antenna - p)
    to_antenna64 = (lane.antenna - p) / length_back
    to_antenna = mi.Vector3f(to_antenna64)
    departure = leave_surface(mi.Vector3f(landed), n, d, clearance)
    sees = active & (dr.dot(to_antenna, n) > 1e-7) & (~first | lane.serves[0])
    if kernel.flags.multi_bounce or kernel.bistatic:
        # the transmitting antenna sees the first hit; the shadow ray ends at the antenna, which may be within the scene
        lit = mi.Bool(False) if kernel.bistatic else first
        sees &= lit | Surroundings.within(kernel).free(
            departure, to_antenna, mi.Float(length_back), sees & ~lit
        )
    bits = scene.material_at(face, info.material_bits, mi.Vector3f(p - vertex0), known)
    material = bits & MATERIAL_MASK
    return Hit(
        active=active,
        first=first,
        order=dr.select(active, ray.hits + 1, ray.hits),
        face=face,
        material=bits,
        own_material=info.material_bits,
        largest_cell=info.largest_cell,
        p=p,
        vertex0=vertex0,
        centroid=centroid,
        departure=departure,
        direction64=d64,
        direction=d,
        normal64=n64,
        normal=n,
        behind=behind,
        cos_incidence=dr.maximum(-dr.dot(d, n), 1e-7),
        length=length,
        length_back=length_back,
        to_antenna64=to_antenna64,
        to_antenna=to_antenna,
        sees=sees,
        properties=MaterialRow.of(scene.material_table, material, known),
        movement=None if scene.movers is None else scene.movers.of_face(face, active),
        slab=None if scene.slabs is None else SlabRow.of(scene.slabs.table, material, known),
        met=met,
        before_facet=before,
    )


def next_facet(scene: TraceScene, lane: Lane, ray: RayState) -> Found:
    """Face and barycentric coordinates of the nearest hit, and the lanes that hit something.

    Neighbouring lanes are neighbouring rays, so that Embree traverses them in packets (``coherent``).
    """
    d, first = mi.Vector3f(ray.direction), ray.hits == 0
    query = query_ray(ray.origin, d)
    found = scene.mi_scene.ray_intersect_preliminary(query, coherent=True, active=ray.active)
    # rays aimed exactly at a vertex or a T-junction may miss: they are traced again, slightly displaced
    lost = ray.active & ~found.is_valid() & first
    query = query_ray(ray.origin + lane.nudge, d)
    found = dr.select(
        lost, scene.mi_scene.ray_intersect_preliminary(query, coherent=True, active=lost), found
    )
    return found.prim_index, found.prim_uv, ray.active & found.is_valid()


def hit_point(
    scene: TraceScene, face: mi.UInt32, uv: mi.Vector2f, active: mi.Bool
) -> tuple[mi.Vector3d, mi.Vector3d, mi.Vector3d, mi.Vector3d]:
    """Point from the barycentric coordinates on the float64 triangle, its unit normal, vertex 0 and centroid."""
    row = face * 3
    a, b, c = (dr.gather(mi.Vector4d, scene.face_table, row + i, active) for i in range(3))
    u, v = mi.Float64(uv.x), mi.Float64(uv.y)
    corner = mi.Vector3d(a[0], a[1], a[2])
    p = corner + mi.Vector3d(b[0], b[1], b[2]) * u + mi.Vector3d(c[0], c[1], c[2]) * v
    centroid = corner + (mi.Vector3d(b[0], b[1], b[2]) + mi.Vector3d(c[0], c[1], c[2])) / 3.0
    return p, mi.Vector3d(a[3], b[3], c[3]), corner, centroid


def _land_on_plane(
    landed: mi.Vector3d, n: mi.Vector3d, virtual_antenna: mi.Vector3d, d: mi.Vector3d, limit: mi.Float
) -> mi.Vector3d:
    """Point where the float64 ray from the virtual antenna along ``d`` meets the facet's plane.

    ``landed`` itself where the two are farther apart than ``limit``: so close to grazing the plane's point may lie
    far outside the facet.
    """
    along = dr.dot(landed - virtual_antenna, n) / dr.dot(d, n)
    p = virtual_antenna + d * along
    return dr.select(dr.squared_norm(p - landed) < dr.square(mi.Float64(limit)), p, landed)


def footprint(kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> TubeFootprint:
    """Footprint of the tube on the facet, ended at the facet's boundary edges, with the spreading loss."""
    growth = mi.Float(hit.length) * lane.inverse_start
    cross_a, cross_b = ray.edge_a * growth, ray.edge_b * growth
    if ray.spread is not None:
        path = mi.Float(hit.length - ray.spread.start)
        cross_a, cross_b = ray.edge_a + ray.spread.a * path, ray.edge_b + ray.spread.b * path
    u, v = (tube.footprint(x, hit.direction, hit.normal, hit.cos_incidence) for x in (cross_a, cross_b))
    point = mi.Vector3f(hit.p - hit.vertex0)
    edges = _edges(kernel.scene.edge_table, hit)
    extent = tube.limit_extent(ray.extent, edges, point, u, v)
    patch = tube.patch(extent)
    inner = [((hit.material >> (INNER_BIT + i)) & 1) == 1 for i in range(N_EDGES)]
    lines = polygon.facet_lines(edges, inner, point, u, v)
    if kernel.flags.multi_bounce:
        # behind mirrors the facets of the whole chain limit the tube
        lines = polygon.select_lines(hit.first, lines, polygon.extent_lines(extent))
    closed = ((hit.material >> CLOSED_BIT) & 1) == 1
    bounds = polygon.Bounds(lines, extent, patch.rim, hit.first & closed)
    if kernel.scene.piece_table is not None:
        patch = tube.patch(tube.limit_extent(ray.extent, _edges(kernel.scene.piece_table, hit), point, u, v))
    area = lane.tube_area * dr.square(growth) / hit.cos_incidence
    loss = lane.weight * kernel.constants.spreading_loss(hit.length, hit.length_back)
    loss_reciprocal = lane.weight * kernel.constants.spreading_loss(hit.length, hit.length)
    lost = None
    if ray.spread is not None:
        # a tube keeps its power: a wider tube has less field over more area
        wider = dr.norm(dr.cross(cross_a, cross_b)) / (lane.tube_area * dr.square(growth))
        area *= wider
        squeezed = dr.rsqrt(dr.maximum(wider, 1e-12))
        loss *= squeezed
        loss_reciprocal *= dr.square(squeezed)
        lost = ~(wider < curved_mirror.WIDEST_SPREAD)  # also where it is not a number
    return TubeFootprint(u, v, extent, patch, bounds, area, loss, loss_reciprocal, lost)


def _edges(table: mi.Float, hit: Hit) -> list[mi.Vector4f]:
    """Boundary edges of the facet that was hit."""
    return [dr.gather(mi.Vector4f, table, hit.face * N_EDGES + i, hit.active) for i in range(N_EDGES)]


def pass_foci(ray: RayState, hit: Hit) -> RayState:
    r"""Ray with the phase of its fields advanced by 90 degrees for each focus (caustic) that its tube passed.

    The tube's cross-section between two hits, signed, is

    .. math:: D(w) = ((\mathbf a + \mathbf a' w) \times (\mathbf b + \mathbf b' w)) \cdot \mathbf d

    and every root of it between the hits is a caustic. There the spreading factor :math:`D^{-1/2}` gains the phase
    factor :math:`e^{+j \pi / 2}` (time convention :math:`\exp(+j \omega t)`): compare the Hankel functions of a
    cylindrical wave towards its axis, :math:`e^{+j (k r - \pi / 4)}`, and from it, :math:`e^{-j (k r - \pi / 4)}`.

    Notes
    -----
    Ignores the field within a wavelength or two of the caustic, where ray optics does not hold.

    References
    ----------
    Kouyoumjian and Pathak, "A uniform geometrical theory of diffraction", Proc. IEEE 62 (1974), after equation 4.
    """
    if ray.spread is None:
        return ray
    d, path = hit.direction, mi.Float(hit.length - ray.spread.start)
    a, b = ray.spread.a * path, ray.spread.b * path  # growth over the whole path, on which w runs from 0 to 1
    constant = dr.dot(dr.cross(ray.edge_a, ray.edge_b), d)
    linear = dr.dot(dr.cross(ray.edge_a, b) + dr.cross(a, ray.edge_b), d)
    square = dr.dot(dr.cross(a, b), d)
    end = constant + linear + square
    once = constant * end < 0.0
    # between ends of equal sign there are two roots if the extremum lies on the leg with the other sign, else none
    at = linear * dr.rcp(dr.select(square == 0.0, 1.0, -2.0 * square))
    extreme = constant + 0.5 * linear * at
    twice = ~once & (square != 0.0) & (at > 0.0) & (at < 1.0) & (extreme * constant < 0.0)
    active = hit.active & ~hit.first
    once &= active
    sign = dr.select(twice & active, -1.0, 1.0)
    fields = tuple((dr.select(once, -im, re * sign), dr.select(once, re, im * sign)) for re, im in ray.fields)
    return replace(ray, fields=fields)


def mirror(kernel: Kernel, ray: RayState, hit: Hit, normal: mi.Vector3f) -> Reflection:
    """Direction and fields of a ray reflected by the material that it hits."""
    return reflect_fields(kernel, hit.direction, normal, hit.properties, hit.slab, hit.behind, ray.fields)


def reflect_fields(
    kernel: Kernel,
    d: mi.Vector3f,
    normal: mi.Vector3f,
    properties: MaterialRow,
    row: SlabRow | None,
    behind: mi.Bool,
    fields: tuple[ComplexVector, ...],
) -> Reflection:
    """Direction and fields after reflection by a smooth surface.

    Parameters
    ----------
    d, normal : direction of the wave and unit normal facing it
    properties, row, behind : ``properties``, ``slab`` and ``behind`` of a `Hit`
    fields : at the mirror
    """
    d_out = dr.normalize(d - normal * (2.0 * dr.dot(d, normal)))
    if not kernel.flags.fresnel:
        return Reflection(d_out, tuple(field.reflect_field_pec(e, normal) for e in fields), conductor=True)
    h = field.incidence_basis(d, normal)
    r_te, r_tm = field.fresnel(dr.maximum(-dr.dot(d, normal), 1e-7), properties.susceptibility)
    if row is not None:
        factors, thick = slab_factors(properties, row, d, normal, behind), row.has_thickness
        r_te, r_tm = dr.select(thick, factors.r_te, r_te), dr.select(thick, factors.r_tm, r_tm)
    return Reflection(d_out, tuple(field.reflect_field(e, d, d_out, h, r_te, r_tm) for e in fields))


def through_passages(kernel: Kernel, ray: RayState, hit: Hit) -> RayState:
    """Ray with its fields attenuated by the volumes between its origin and a hit."""
    passages = kernel.scene.passages
    if not passages:
        return ray
    path = dr.norm(mi.Vector3f(hit.p) - ray.origin)
    return replace(ray, fields=pass_all(passages, ray.origin, hit.direction, path, hit.active, ray.fields))


def reflect(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube_here: TubeFootprint, reflection: Reflection
) -> RayState:
    """Reflected ray, with its tube and the virtual antenna mirrored in the facet; not active after the last bounce."""
    n64, n, edge_a, edge_b, spread = hit.normal64, hit.normal, ray.edge_a, ray.edge_b, ray.spread
    if spread is not None:
        n64, n, reflection, spread = _curved_mirror(kernel, ray, hit, tube_here)
        d_out = reflection.direction
        edge_a, edge_b = (x - d_out * dr.dot(x, d_out) for x in (tube_here.u, tube_here.v))
    else:
        edge_a, edge_b = (x - n * (2.0 * dr.dot(x, n)) for x in (edge_a, edge_b))
    fields = apply_at_mirror(kernel, hit.properties, hit.cos_incidence, reflection.fields)
    antenna, d64 = ray.virtual_antenna, hit.direction64
    velocity = towards = ray.virtual_velocity
    shadow_boundary = ray.shadow_boundary
    receiver, receiver_velocity = ray.virtual_receiver, ray.virtual_receiver_velocity
    if (
        hit.movement is not None
    ):  # the image of a point at rest in a moving mirror moves at twice the mirror's velocity
        towards = velocity - hit.movement.velocity
        if shadow_boundary is not None:
            shadow_boundary = shadow_boundary.at(hit.movement, hit.largest_cell).mirrored(hit.movement, n64)
    if receiver is not None and receiver_velocity is not None:
        receiver = receiver - n64 * (2.0 * dr.dot(receiver - hit.p, n64))
        relative = receiver_velocity if hit.movement is None else receiver_velocity - hit.movement.velocity
        receiver_velocity = receiver_velocity - n64 * (2.0 * dr.dot(relative, n64))
    out = RayState(
        active=hit.active & (hit.order < kernel.constants.max_depth) & (~hit.first | lane.serves[1]),
        hits=hit.order,
        origin=hit.departure,
        direction=d64 - n64 * (2.0 * dr.dot(d64, n64)),
        virtual_antenna=antenna - n64 * (2.0 * dr.dot(antenna - hit.p, n64)),
        virtual_velocity=velocity - n64 * (2.0 * dr.dot(towards, n64)),
        virtual_receiver=receiver,
        virtual_receiver_velocity=receiver_velocity,
        edge_a=edge_a,
        edge_b=edge_b,
        spread=spread,
        extent=tube_here.extent,
        shadow_boundary=shadow_boundary,
        fields=fields,
        contributions=ray.contributions,
        crossed=ray.crossed,
        mirror=None if ray.mirror is None else mirror_at(kernel, hit),
    )
    return derivatives_of(kernel).at_mirror(kernel, lane, ray, hit, tube_here, n64, out)


def _curved_mirror(
    kernel: Kernel, ray: RayState, hit: Hit, tube_here: TubeFootprint
) -> tuple[mi.Vector3d, mi.Vector3f, Reflection, TubeSpread]:
    """Normals, reflection and growth of the tube on a curved surface."""
    assert ray.spread is not None
    d64, n64 = hit.direction64, hit.normal64
    sign = dr.select(hit.behind, -1.0, 1.0)
    bend = curved_mirror.normal_change(kernel.scene.curvature_table, hit.face, hit.active, sign)
    # the curved surface's normal at the hit, unless the ray reflected by it would enter the facet
    smooth = dr.normalize(n64 + mi.Vector3d(bend(mi.Vector3f(hit.p - hit.centroid))))
    over = d64 - smooth * (2.0 * dr.dot(d64, smooth))
    n64 = dr.select((dr.dot(d64, smooth) < 0.0) & (dr.dot(over, n64) > 1e-3), smooth, n64)
    n = mi.Vector3f(n64)
    spread = TubeSpread(
        _mirrored_step(ray.spread.a, bend(tube_here.u), hit.direction, n),
        _mirrored_step(ray.spread.b, bend(tube_here.v), hit.direction, n),
        hit.length,
    )
    return n64, n, mirror(kernel, ray, hit, n), spread


def _mirrored_step(step: mi.Vector3f, change: mi.Vector3f, d: mi.Vector3f, n: mi.Vector3f) -> mi.Vector3f:
    """Difference of directions across a tube (``step`` before) after a mirror whose normal differs by ``change``."""
    return step - n * (2.0 * (dr.dot(step, n) + dr.dot(d, change))) - change * (2.0 * dr.dot(d, n))
