"""The bounce loop: launch, intersect, close, add, reflect. One recorded kernel, one launch a batch.

Each ray stands for a tube of solid angle. At every hit the tube closes to the antenna by physical optics, and the
persistent diffuse scatterer it falls on closes as well. A path behind mirrors is measured from the mirrored
("unfolded") antenna, which is carried in float64 and mirrored exactly in each facet's plane: lengths depend on
where a ray hits, never on the rounding of how it got there.

What this does not do: transmission, edge and surface-wave diffraction, the phase shift at caustics of concave
mirrors, and diffuse-to-diffuse bounces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from sarmitsuba.backend import dr, mi
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.mesh.boundary_edges import N_EDGES
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.trace import curvature, field, tube
from sarmitsuba.trace import speckle as scatterers
from sarmitsuba.trace.beam import BeamPattern, fade
from sarmitsuba.trace.geometry import TraceScene
from sarmitsuba.trace.launch import LaunchGrid, PulseBatch, vector64
from sarmitsuba.trace.scattering_matrix import ScatteringMatrix, texture


class Accumulator(Protocol):
    """Takes the contributions of one hit; owns the memory they go to."""

    def begin(self) -> tuple[Any, ...]:
        """Loop state that the accumulator needs (arrays of the launch's width), often none."""

    def add(
        self,
        state: tuple[Any, ...],
        order: Any,
        pulse: Any,
        slant_range: Any,
        rate: Any,
        amplitudes: Sequence[Any],
        active: Any,
    ) -> tuple[Any, ...]:
        """Add one complex float32 amplitude per channel at a path's slant range (float64 m, absolute).

        ``rate`` is the derivative of the slant range (float64 m/s); ``order`` the number of bounces (uint32, from 1;
        the accumulator puts what is above its highest order into that one).
        """


@dataclass(frozen=True)
class KernelSettings:
    """Numbers of a launch that are not effects.

    Parameters
    ----------
    wavelength : m
    max_depth : most bounces
    cell : m, edge of a diffuse scatterer's cell
    seed : of the diffuse scatterers
    amplitude : factor on every contribution (the radar's amplitude constant, sqrt(W) m^2 per m)
    reference_range : m, stands for both legs where spreading is off
    up : (3,) vertical reference of the polarisation basis, scene frame
    """

    wavelength: float
    max_depth: int
    cell: float
    seed: int
    amplitude: float
    reference_range: float
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class TraceCounts:
    """Dr.Jit arrays of the launch's width, to be reduced by the caller: hits and contributions of each lane."""

    hits: Any
    contributions: Any


def trace(
    scene: TraceScene,
    grid: LaunchGrid,
    pulses: PulseBatch,
    flags: KernelFlags,
    settings: KernelSettings,
    antenna: Antenna,
    accumulator: Accumulator,
) -> tuple[TraceCounts, tuple[Any, ...]]:
    """Trace every ray of the grid from every pulse of the batch and hand all contributions to the accumulator.

    Nothing is evaluated here: the caller's ``dr.eval`` launches the one kernel that this records.

    Returns
    -------
    counts : per-lane hits and contributions
    state : the accumulator's loop state after the last bounce
    """
    f32, f64, u32, c32 = mi.Float, mi.Float64, mi.UInt32, mi.Complex2f
    v32, v64 = mi.Vector3f, mi.Vector3d

    # ---- constants of the launch, opaque so that another value does not compile another kernel
    wavelength = dr.opaque(f32, settings.wavelength)
    k = dr.opaque(f32, 2.0 * np.pi / settings.wavelength)
    max_depth = dr.opaque(u32, settings.max_depth)
    cell = dr.opaque(f64, settings.cell)
    seed = dr.opaque(u32, settings.seed & 0xFFFFFFFF)
    gain = dr.opaque(f32, settings.amplitude)
    n_rays = dr.opaque(u32, grid.n_rays)
    clearance = dr.opaque(f32, scene.clearance)
    up = v32(*(dr.opaque(f32, x) for x in settings.up))
    po_gain = (2.0 * float(np.sqrt(np.pi))) / wavelength * gain
    range2 = dr.opaque(f32, settings.reference_range**2)

    curved = flags.multi_bounce and scene.curvature_table is not None

    # ---- launch
    lane = dr.arange(u32, grid.n_rays * pulses.n_pulses)
    pulse = lane // n_rays
    ray = lane - pulse * n_rays
    gx, gy = dr.gather(f32, f32(grid.x), ray), dr.gather(f32, f32(grid.y), ray)
    plane = pulse if pulses.frame.center.shape[0] > 1 else dr.zeros(u32, 1)
    center = dr.gather(v64, vector64(mi, pulses.frame.center), plane)
    axis_x = dr.gather(v64, vector64(mi, pulses.frame.axis_x), plane)
    axis_y = dr.gather(v64, vector64(mi, pulses.frame.axis_y), plane)
    antenna_p = dr.gather(v64, vector64(mi, pulses.position), pulse)
    antenna_v = dr.gather(v64, vector64(mi, pulses.velocity), pulse)

    start = center + axis_x * f64(gx) + axis_y * f64(gy)
    leg = start - antenna_p
    distance = dr.norm(leg)
    d64 = leg / distance
    d = v32(d64)
    origin = v32(start - d64 * dr.minimum(distance, _before_bounds(start, d64, scene, mi, dr)))

    turn = dr.opaque(f64, grid.turn)
    spacing = dr.opaque(f64, grid.spacing)
    ct, st = dr.cos(turn) * spacing, dr.sin(turn) * spacing
    edge_a = v32(axis_x * ct + axis_y * st)
    edge_b = v32(axis_y * ct - axis_x * st)
    edge_a -= d * dr.dot(edge_a, d)
    edge_b -= d * dr.dot(edge_b, d)
    tube_area = dr.norm(dr.cross(edge_a, edge_b))
    inverse_start = f32(1.0 / distance)
    tube_rate_a = dr.dot(edge_a, v32(antenna_v)) * inverse_start  # of the rate, over one tube
    tube_rate_b = dr.dot(edge_b, v32(antenna_v)) * inverse_start
    nudge = dr.normalize(edge_a) * clearance

    weight = f32(1.0)
    if grid.weight is not None:
        weight = dr.gather(f32, f32(grid.weight), ray)
    elif flags.taper:
        weight = fade(gx, grid.half_x, grid.taper, dr, f32) * fade(gy, grid.half_y, grid.taper, dr, f32)
    pattern = BeamPattern(antenna, pulses, pulse, mi, dr) if flags.antenna_pattern else None
    if pattern is not None:
        weight *= pattern.one_way(d)

    h0, p0 = field.polarisation_basis(d, up, dr)
    zero = dr.zeros(v32)
    tracked = flags.tracked
    e0 = tuple(((h0 if letter == "H" else p0) * weight, zero) for letter in tracked)

    # fmt: off
    # ---- loop state                     meaning
    state: tuple[Any, ...] = (
        dr.full(mi.Bool, True, lane.shape[0] if hasattr(lane, "shape") else len(lane)),  # lane is alive
        u32(0),                         # hits so far
        origin,                         # ray origin, scene frame
        d64,                            # ray direction, mirrored exactly like the antenna
        antenna_p,                      # antenna, mirrored through the chain so far
        antenna_v,                      # its velocity, mirrored likewise
        edge_a, edge_b,                 # tube cross-section at the start, behind curved mirrors at the last hit
        (edge_a * inverse_start, edge_b * inverse_start, distance) if curved else (),  # its growth from there on
        tube.unlimited(f32).fields(),   # how far the facets hit so far let the tube reach
        e0,                             # field of each tracked transmit polarisation, unit at launch
        u32(0),                         # contributions so far
        accumulator.begin(),                  # whatever the accumulator keeps per lane
    )
    # fmt: on

    def cond(*s: Any) -> Any:
        return s[0]

    def body(
        active: Any,
        hits: Any,
        o: Any,
        d64: Any,
        image: Any,
        image_v: Any,
        ea: Any,
        eb: Any,
        spread: Any,
        reach: Any,
        e: Any,
        n_added: Any,
        added: Any,
    ) -> tuple[Any, ...]:
        # ---- intersect
        ray = mi.Ray3f(o, v32(d64))
        pi = scene.mi_scene.ray_intersect_preliminary(ray, coherent=False, active=active)
        # rays aimed exactly at a vertex or a T-junction may slip through: a second try just beside it
        lost = active & ~pi.is_valid() & (hits == 0)
        ray = mi.Ray3f(o + nudge, v32(d64))
        pi = dr.select(lost, scene.mi_scene.ray_intersect_preliminary(ray, coherent=False, active=lost), pi)
        active = active & pi.is_valid()
        face = pi.prim_index
        landed, n64, corner, centroid = _hit_point(scene, face, pi.prim_uv, active, mi, dr)
        info = dr.gather(mi.Vector2u, scene.face_info, face, active)

        # float32 tracing lands a few 1e-7 of the scene's size beside the ray: take the ray's own point of the facet
        p = _on_ray(landed, n64, image, d64, 1e3 * clearance, mi, dr)
        # the ray as the unfolded antenna sees this hit
        leg = p - image
        length = dr.norm(leg)
        d64 = leg / length
        behind = dr.dot(d64, n64) > 0.0
        n64 = dr.select(behind, -n64, n64)
        n = v32(n64)
        d = v32(d64)
        cos_i = dr.maximum(-dr.dot(d, n), 1e-7)

        leg_back = antenna_p - p
        length_back = dr.norm(leg_back)
        s64 = leg_back / length_back
        s = v32(s64)
        cos_s = dr.dot(s, n)
        first = hits == 0
        leave = _leave(v32(landed), n, d, clearance)
        sees = active & (cos_s > 1e-7)
        if flags.visibility and flags.multi_bounce:
            # no farther than the antenna, which may hang within the scene
            shadow_ray = mi.Ray3f(leave, s, f32(length_back), 0.0, [])
            blocked = scene.mi_scene.ray_test(shadow_ray, coherent=False, active=sees & ~first)
            sees &= first | ~blocked
        hits = dr.select(active, hits + 1, hits)

        # ---- the tube on this facet
        growth = f32(length) * inverse_start
        cross_a, cross_b = ea * growth, eb * growth
        if curved:
            way = f32(length - spread[2])
            cross_a, cross_b = ea + spread[0] * way, eb + spread[1] * way
        u = tube.footprint(cross_a, d, n, cos_i, dr)
        v = tube.footprint(cross_b, d, n, cos_i, dr)
        sides = [dr.gather(mi.Vector4f, scene.edge_table, face * N_EDGES + i, active) for i in range(N_EDGES)]
        extent = tube.limited(tube.Extent(*reach), sides, v32(p - corner), u, v, dr)
        piece = tube.patch(extent, dr)
        area = tube_area * dr.square(growth) / cos_i
        if flags.spreading:
            loss = f32(1.0 / (length * length_back))
            loss_retro = f32(1.0 / (length * length))
        else:
            loss = loss_retro = dr.rcp(range2)
        if curved:
            # a tube keeps its power: spread more than a sphere's it carries less field over more area
            wider = dr.norm(dr.cross(cross_a, cross_b)) / (tube_area * dr.square(growth))
            area *= wider
            squeezed = dr.rsqrt(dr.maximum(wider, 1e-12))
            loss *= squeezed
            loss_retro *= dr.square(squeezed)
        half = (
            0.5 * (length + length_back)
            if flags.double_phase
            else f64(0.5 * (f32(length) + f32(length_back)))
        )
        rate_out = -dr.dot(d64, image_v)  # d/dt of the leg from the mirrored antenna
        rate_back = dr.dot(s64, antenna_v)
        rate = 0.5 * (rate_out + rate_back)

        # ---- material and reflection
        material = info.x & 0x7FFFFFFF
        mat = dr.gather(mi.Vector4f, scene.material_table, material, active)
        d_out, e_out = _reflected(e, d, n, mat, flags, mi, dr)

        # ---- close: receiving polarisation of this direction home
        q_h, q_v = field.polarisation_basis(-s, up, dr)
        receive = {"H": q_h, "V": q_v}
        home = pattern.one_way(-s) if pattern is not None else f32(1.0)

        coherent: list[Any] = []
        if flags.coherent:
            wave = d - s
            factor = po_gain * area * loss * home
            half_c, rate_c = half, rate
            if flags.tube_phase:
                # what is left of a facet comes from its edges and stands at their range and rate
                filled = tube.phase_integral(-k * wave, u, v, piece, dr, c32)
                rim = u * piece.rim[0] + v * piece.rim[1]
                half_c = half + f64(0.5 * dr.dot(wave, rim))
                # a point of the tube is seen along another launch direction, whatever mirrors are in between
                turn_out = piece.rim[0] * tube_rate_a + piece.rim[1] * tube_rate_b
                turn_back = dr.dot(rim - s * dr.dot(rim, s), v32(antenna_v)) / f32(length_back)
                rate_c = rate - f64(0.5 * (turn_out + turn_back))
            else:
                filled = piece.area()
            if flags.roughness:
                factor *= dr.exp(-0.5 * dr.square(k * dr.dot(wave, n) * mat.z))
            for channel in flags.channels:
                i = tracked.index(channel[0])
                q = receive[channel[1]]
                if flags.fresnel:
                    c = field.po_receive(e[i], e_out[i], d, d_out, n, s, q, dr, c32)
                else:
                    c = field.dot(field.po_current_pec(e[i], d, n, dr), q, dr, c32)
                coherent.append(c * factor * filled)
            n_added = dr.select(sees, n_added + 1, n_added)
            added = accumulator.add(added, hits, pulse, half_c, rate_c, coherent, sees)

        # ---- diffuse scatterers of the cells that the footprint overlaps
        if flags.diffuse:
            double = flags.diffuse_double and flags.multi_bounce
            operator = ScatteringMatrix(scene, info.x, n, d, s, flags, mi, dr)
            straight = []
            for channel in flags.channels:
                terms = operator.between(receive[channel[1]], e[tracked.index(channel[0])])
                if double:
                    # behind mirrors the reversed path comes home with the same length: the transposed channel
                    reverse = operator.between(receive[channel[0]], e[tracked.index(channel[1])])
                    terms = [t + dr.select(first, c32(0.0), r) for t, r in zip(terms, reverse, strict=True)]
                straight.append(terms)
            retro = []
            if double:
                chain = active & ~first
                operator = ScatteringMatrix(scene, info.x, n, d, -d, flags, mi, dr)
                retro = [
                    operator.between_fields(e[tracked.index(c[1])], e[tracked.index(c[0])])
                    for c in flags.channels
                ]
            middle, wide_u, wide_v = piece.box(u, v)
            place = p + v64(middle) if flags.footprint_splitting else p
            frame = scatterers.CellFrame(place, n64, (u, v), (wide_u, wide_v), info.y, cell, seed, dr, mi)
            cells, bias = (frame.cells(), frame.bias) if flags.footprint_splitting else (frame.own(), 1.0)
            weight = gain * area * piece.area() * dr.rsqrt(frame.area * bias)
            for share, centre, key in cells:
                random = texture(key, mat.w, flags, mi, dr)
                leg_d, back_d = centre - image, antenna_p - centre
                length_d, length_back_d = dr.norm(leg_d), dr.norm(back_d)
                rate_d = -dr.dot(leg_d, image_v) / length_d
                rate_back_d = dr.dot(back_d, antenna_v) / length_back_d
                factor = weight * share * loss * home
                values = [_mixed(terms, random) * factor for terms in straight]
                reached = sees & (share > 0.0)
                n_added = dr.select(reached, n_added + 1, n_added)
                added = accumulator.add(
                    added,
                    hits,
                    pulse,
                    0.5 * (length_d + length_back_d),
                    0.5 * (rate_d + rate_back_d),
                    values,
                    reached,
                )
                if double:
                    factor = weight * share * loss_retro
                    values = [_mixed(terms, random) * factor for terms in retro]
                    reached = chain & (share > 0.0)
                    n_added = dr.select(reached, n_added + 1, n_added)
                    # out through the chain, back through it, the scatterer once: 2 n - 1 reflections
                    added = accumulator.add(added, 2 * hits - 1, pulse, length_d, rate_d, values, reached)

        # ---- reflect
        if not flags.multi_bounce:
            active = mi.Bool(False) & active
            return (active, hits, o, d64, image, image_v, ea, eb, spread, reach, e, n_added, added)
        if curved:
            # the surface's own normal at the hit, where it does not send the ray into the facet
            bend = curvature.turned(scene.curvature_table, face, active, dr.select(behind, -1.0, 1.0), dr, mi)
            smooth = dr.normalize(n64 + v64(bend(v32(p - centroid))))
            over = d64 - smooth * (2.0 * dr.dot(d64, smooth))
            n64 = dr.select((dr.dot(d64, smooth) < 0.0) & (dr.dot(over, n64) > 1e-3), smooth, n64)
            n = v32(n64)
            d_out, e_out = _reflected(e, d, n, mat, flags, mi, dr)
            turn_a, turn_b = bend(u), bend(v)
            spread = (
                _mirrored_step(spread[0], turn_a, d, n, dr),
                _mirrored_step(spread[1], turn_b, d, n, dr),
                length,
            )
            ea, eb = u - d_out * dr.dot(u, d_out), v - d_out * dr.dot(v, d_out)
        else:
            ea = ea - n * (2.0 * dr.dot(ea, n))
            eb = eb - n * (2.0 * dr.dot(eb, n))
        if flags.roughness:
            kept = dr.exp(-2.0 * dr.square(k * mat.z * cos_i))
            e_out = tuple((x[0] * kept, x[1] * kept) for x in e_out)
        image = image - n64 * (2.0 * dr.dot(image - p, n64))
        image_v = image_v - n64 * (2.0 * dr.dot(image_v, n64))
        d64 = d64 - n64 * (2.0 * dr.dot(d64, n64))
        active = active & (hits < max_depth)
        reach = extent.fields()
        return (active, hits, leave, d64, image, image_v, ea, eb, spread, reach, e_out, n_added, added)

    final = dr.while_loop(state, cond, body, label="bounces", mode="symbolic")
    return TraceCounts(final[1], final[11]), final[12]


def _reflected(
    e: Sequence[Any], d: Any, n: Any, mat: Any, flags: KernelFlags, mi: Any, dr: Any
) -> tuple[Any, Any]:
    """Direction and fields ``e`` after the mirror of normal ``n`` that the ray ``d`` hits; ``mat`` its table row."""
    d_out = dr.normalize(d - n * (2.0 * dr.dot(d, n)))
    if not flags.fresnel:
        return d_out, tuple(field.reflect_field_pec(x, n, dr) for x in e)
    h = field.incidence_basis(d, n, dr, mi)
    r_te, r_tm = field.fresnel(dr.maximum(-dr.dot(d, n), 1e-7), mi.Complex2f(mat.x, mat.y), dr)
    return d_out, tuple(field.reflect_field(x, d, d_out, h, r_te, r_tm, dr, mi.Complex2f) for x in e)


def _mirrored_step(step: Any, turn: Any, d: Any, n: Any, dr: Any) -> Any:
    """Difference ``step`` of a tube's directions after a mirror whose normal differs by ``turn`` over the tube."""
    return step - n * (2.0 * (dr.dot(step, n) + dr.dot(d, turn))) - turn * (2.0 * dr.dot(d, n))


def _mixed(terms: list[Any], random: list[Any]) -> Any:
    """Sum of the fixed tensors' values times the cell's random numbers."""
    return sum((t * r for t, r in zip(terms[1:], random[1:], strict=True)), terms[0] * random[0])


def _before_bounds(start: Any, d: Any, scene: TraceScene, mi: Any, dr: Any) -> Any:
    """How far back from ``start`` along the ray the scene's bounds begin, m: float32 is most exact next to them."""
    v64 = mi.Vector3d
    low, high = (v64(*(dr.opaque(mi.Float64, float(x)) for x in corner)) for corner in scene.bounds)
    inverse = 1.0 / dr.select(dr.abs(d) > 1e-12, d, 1e-12)
    a, b = (low - start) * inverse, (high - start) * inverse
    near, far = dr.minimum(a, b), dr.maximum(a, b)
    entry = dr.maximum(dr.maximum(near.x, near.y), near.z)
    leaving = dr.minimum(dr.minimum(far.x, far.y), far.z)
    extent = dr.opaque(mi.Float64, scene.extent)
    return dr.select(entry < leaving, 0.01 * extent - entry, 4.0 * extent + dr.norm(start))


def _leave(p: Any, n: Any, d: Any, clearance: Any) -> Any:
    """Where rays go on from a hit: off the facet, and back along ``d`` to be in front of a corner's other facets."""
    return p + (n - d) * clearance


def _on_ray(landed: Any, n: Any, image: Any, d: Any, limit: Any, mi: Any, dr: Any) -> Any:
    """Point where the float64 ray from ``image`` along ``d`` meets the facet's plane.

    ``landed`` itself where the two are farther apart than ``limit``: so close to grazing the plane's point may lie
    far outside the facet.
    """
    along = dr.dot(landed - image, n) / dr.dot(d, n)
    p = image + d * along
    return dr.select(dr.squared_norm(p - landed) < dr.square(mi.Float64(limit)), p, landed)


def _hit_point(scene: TraceScene, face: Any, uv: Any, active: Any, mi: Any, dr: Any) -> tuple[Any, ...]:
    """Point from the barycentric coordinates on the float64 triangle, its unit normal, vertex 0 and centroid."""
    row = face * 3
    array4 = dr.float64_array_t(mi.Vector4f)
    a = dr.gather(array4, scene.face_table, row, active)
    b = dr.gather(array4, scene.face_table, row + 1, active)
    c = dr.gather(array4, scene.face_table, row + 2, active)
    u, v = mi.Float64(uv.x), mi.Float64(uv.y)
    corner = mi.Vector3d(a[0], a[1], a[2])
    p = corner + mi.Vector3d(b[0], b[1], b[2]) * u + mi.Vector3d(c[0], c[1], c[2]) * v
    centroid = corner + (mi.Vector3d(b[0], b[1], b[2]) + mi.Vector3d(c[0], c[1], c[2])) / 3.0
    return p, mi.Vector3d(a[3], b[3], c[3]), corner, centroid


__all__ = ["Accumulator", "KernelSettings", "TraceCounts", "trace"]
