"""Physical-optics return of a path's last facet to the antenna, and the antenna's receiving polarisation and gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.derivatives.tangents import EchoDerivative
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.leg import Surroundings, antenna_basis
from sarmitsuba.tracing.kernel.stage import apply_at_closing as by_stages
from sarmitsuba.tracing.kernel.state import (
    COHERENT,
    Closing,
    Contribution,
    Hit,
    Kernel,
    Lane,
    RayState,
    Receiver,
    Receiving,
    Reflection,
    TubeFootprint,
    TubeReturn,
)
from sarmitsuba.tracing.scatterers.corners.metal_corners import both_chains, corner_share

# amplitude of a tube's return relative to that of the whole tube in phase, down to which it is added
NEGLIGIBLE = 1e-10


def receiver(kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> tuple[Receiver, Lane, Hit]:
    """Receiving polarisations and gain of the antenna for a hit; lane and hit are adjusted for the delay in slabs."""
    around = Surroundings.within(kernel)
    gain = mi.Float(1.0)
    if lane.pattern is not None:
        gain = lane.pattern.received(-hit.to_antenna)
    if around.clear:
        h, v = field.polarisation_basis(-hit.to_antenna, around.up)
        return Receiver({"H": h, "V": v}, gain), lane, hit
    through = hit.sees
    if ray.crossed is not None and not kernel.bistatic:
        # a first leg that crossed no slab has a return leg that crosses none
        through = through & (~hit.first | (ray.crossed > 0))
    basis = antenna_basis(around, hit.to_antenna)
    vectors, shift = around.passed(
        hit.departure, hit.to_antenna, mi.Float(hit.length_back), hit.sees, basis, through
    )
    if shift is not None:
        step = mi.Vector3d(shift)
        lane = replace(lane, antenna=lane.antenna + step, transmitter=lane.transmitter + step)
        leg = lane.antenna - hit.p
        length = dr.norm(leg)
        hit = replace(hit, length_back=length, to_antenna64=leg / length)
    return Receiver({"H": vectors[0], "V": vectors[1]}, gain), lane, hit


def _project_along(q: Receiving, value: Callable[[mi.Vector3f], mi.Complex2f]) -> mi.Complex2f:
    """Value of a function linear in the receiving vector, for a real or a complex one."""
    if not isinstance(q, tuple):
        return value(q)
    return value(q[0]) + mi.Complex2f(0.0, 1.0) * value(q[1])


def tube_return(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube_here: TubeFootprint, receive: Receiver
) -> TubeReturn:
    """Coherent return of a ray tube before polarisation: weights of both chains of a corner, stages, phase integral.

    Negligible are returns below ``NEGLIGIBLE`` times that of the whole tube in phase: the sum of all of a launch is
    then less than that of one tube.
    """
    factor = kernel.constants.po_gain * tube_here.area * tube_here.loss * receive.gain
    whole, turned = factor, None
    if ray.mirror is not None:
        share, corner = corner_share(kernel, ray.mirror, hit)
        if ray.virtual_receiver is None:
            factor = factor * share
        else:
            turned = both_chains(kernel, lane, ray, hit, share, corner)
    # velocities of antenna and virtual antenna relative to the lit patch
    velocity, virtual_velocity = lane.velocity, ray.virtual_velocity
    if hit.movement is not None and ray.shadow_boundary is not None:
        patch = ray.shadow_boundary.at(hit.movement, hit.largest_cell).on(
            hit.movement, hit.direction64, hit.normal64
        )
        velocity, virtual_velocity = velocity - patch, virtual_velocity - patch
    range_rate = 0.5 * (
        dr.dot(hit.to_antenna64, velocity) - dr.dot(hit.direction64, virtual_velocity)
    )  # of the leg back and of the leg from the virtual antenna
    found = by_stages(
        kernel,
        lane,
        ray,
        hit,
        tube_here,
        Closing(
            factor=factor,
            integral=None,
            slant_range=_mean_leg(kernel, hit),
            range_rate=range_rate,
            point=hit.p,
            velocity=velocity,
            virtual_velocity=virtual_velocity,
        ),
    )
    weight = mi.Complex2f(tube_here.bounds.area() if found.integral is None else found.integral)
    weight *= found.factor
    if turned is not None:
        weight *= turned
    # a value that is not a number counts, so that it is found; a sum, as squares of weights below 1e-19 are zero
    counts = ~(dr.abs(weight.real) + dr.abs(weight.imag) <= NEGLIGIBLE * dr.abs(whole))
    derivative = derivatives_of(kernel).at_closing(kernel, lane, ray, hit, tube_here, found)
    return TubeReturn(counts, weight, found.slant_range, found.range_rate, found.point, derivative)


def close_coherent(
    kernel: Kernel,
    lane: Lane,
    ray: RayState,
    hit: Hit,
    reflection: Reflection,
    receive: Receiver,
    returned: TubeReturn,
) -> Contribution:
    r"""Coherent return of a ray tube by physical optics: electric and magnetic currents, phase integral over the patch.

    A chain over A that closes at B and the reversed one, over B to A, have equal length, and reciprocity demands
    ``S_HV(AB) = S_VH(BA)``. Both chains are traced, so that the mean of the two estimates,

    .. math:: \tfrac12 (S_{HV}(AB) + S_{VH}(BA)) + \tfrac12 (S_{HV}(BA) + S_{VH}(AB)),

    is the symmetric part of the scattering matrix at every closing: HV = VH in any basis. Co-polar channels hold both
    estimates already and are unchanged. Of the two chains of a corner the one whose last facet limits the beam is
    weighted higher, see :func:`sarmitsuba.tracing.scatterers.corners.metal_corners.corner_share`.
    """
    amplitudes = coherent_amplitudes(kernel, ray, hit, reflection, receive, returned.weight)
    echo = Contribution(
        kind=mi.UInt32(COHERENT),
        order=hit.order,
        pulse=lane.pulse,
        slant_range=returned.slant_range,
        range_rate=returned.range_rate,
        amplitudes=amplitudes,
        active=returned.counts,
        point=returned.point,
    )
    return derivatives_of(kernel).at_coherent_echo(kernel, lane, ray, hit, receive, returned, echo)


def coherent_amplitudes(
    kernel: Kernel, ray: RayState, hit: Hit, reflection: Reflection, receive: Receiver, weight: mi.Complex2f
) -> tuple[mi.Complex2f, ...]:
    """Recorded channels of a coherent return; see :func:`close_coherent`."""
    flags = kernel.flags
    closed = {}
    for channel in dict.fromkeys(c for pair in map(flags.reciprocal, flags.closed) for c in pair):
        i = flags.tracked.index(channel[0])
        closed[channel] = _project_along(
            receive.basis[channel[1]],
            partial(_radiate_facet, hit, reflection, ray.fields[i], reflection.fields[i]),
        )
    amplitudes = []
    for channel in flags.closed:
        a, b = flags.reciprocal(channel)
        c = closed[a] if a == b else (closed[a] + closed[b]) * 0.5
        amplitudes.append(c * weight)
    return tuple(field.pick_recorded(flags.closed, amplitudes, flags.channels))


def _radiate_facet(
    hit: Hit,
    reflection: Reflection,
    e: field.ComplexVector,
    e_out: field.ComplexVector,
    q: mi.Vector3f,
) -> mi.Complex2f:
    """Field radiated by a facet towards the antenna, component along ``q``; see :func:`close_coherent`."""
    n, s = hit.normal, hit.to_antenna
    if reflection.conductor:
        return field.dot(field.po_current_pec(e, hit.direction, n), q)
    return field.po_receive(e, e_out, hit.direction, reflection.direction, n, s, q)


def _mean_leg(kernel: Kernel, hit: Hit) -> mi.Float64:
    """Slant range of the hit itself, m."""
    if kernel.flags.double_phase:
        return 0.5 * (hit.length + hit.length_back)
    return mi.Float64(0.5 * (mi.Float(hit.length) + mi.Float(hit.length_back)))


def select_contribution(condition: mi.Bool, a: Contribution, b: Contribution) -> Contribution:
    """Contribution ``a`` in the lanes where the condition holds, else ``b``; pulse and activity of ``b``."""
    return replace(
        b,
        kind=dr.select(condition, a.kind, b.kind),
        order=dr.select(condition, a.order, b.order),
        slant_range=dr.select(condition, a.slant_range, b.slant_range),
        range_rate=dr.select(condition, a.range_rate, b.range_rate),
        amplitudes=tuple(dr.select(condition, x, y) for x, y in zip(a.amplitudes, b.amplitudes, strict=True)),
        point=dr.select(condition, a.point, b.point),
        derivative=EchoDerivative.selected(condition, a.derivative, b.derivative),
    )
