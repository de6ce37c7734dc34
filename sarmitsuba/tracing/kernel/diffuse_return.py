"""Diffuse returns of a hit: echoes of the persistent diffuse scatterers in the ray's patch of a facet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.closing import select_contribution
from sarmitsuba.tracing.kernel.scattering_matrix import ScatteringMatrix, speckle_coefficients
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.speckle import Node, ScattererLattice, cell_on, widen_cells
from sarmitsuba.tracing.kernel.state import (
    DIFFUSE,
    RECIPROCAL,
    REVERSED,
    Contribution,
    Hit,
    Kernel,
    Lane,
    RayState,
    Receiver,
    Receiving,
    TubeFootprint,
)
from sarmitsuba.tracing.kernel.table_rows import MaterialRow
from sarmitsuba.tracing.kernel.temporal import Age
from sarmitsuba.tracing.scatterers.water.wind_waves import WaterTables

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.tracing.derivatives.tangents import PatchDerivative, Terms
    from sarmitsuba.tracing.kernel.movement import Movement


def seen_from(movement: Movement | None, velocity: mi.Vector3d) -> mi.Vector3d:
    r"""Velocity relative to the facet that was hit, or to the scatterer on it, m/s; ``movement`` None: at rest.

    With every mirror i of a chain moving at :math:`\mathbf w_i`, the virtual antenna moves at
    :math:`\mathbf V' = \mathbf V - 2 \mathbf n_i (\mathbf V - \mathbf w_i) \cdot \mathbf n_i`, mirror after mirror,
    and a point of a facet that moves at :math:`\mathbf w` sees the length from it change by
    :math:`\mathbf d \cdot (\mathbf w - \mathbf V')`: for the whole path that is

    .. math:: \dot L = \sum_i \mathbf w_i \cdot (\mathbf d_i - \mathbf d_{i+1})

    over all hits, in addition to the antenna's motion.
    """
    return velocity if movement is None else velocity - movement.velocity


@dataclass  # not frozen: part of a loop's state, which Dr.Jit writes to
class Slot:
    """One diffuse return: a node of the scatterer lattice, and the path of its echo.

    The path is straight to the antenna, reciprocal (back along the ray's chain of mirrors), or reversed
    (``other_way``: straight to the node, back through the chain; None where that is not a separate return).
    """

    node: Node
    back: mi.Bool
    other_way: mi.Bool | None

    @property
    def there(self) -> mi.Bool:
        """Whether the slot holds a return; false after the last."""
        return self.node.column <= self.node.last


@dataclass(frozen=True, eq=False)
class DiffuseReturns:
    """The diffuse returns of one hit, without the per-scatterer random factors.

    Parameters
    ----------
    lattice : scatterers in the patch of the facet
    straight : per channel, values of the fixed tensors for the straight leg to the antenna
    reciprocal : the same for the reciprocal path, back along the ray's chain; None without such paths
    reverse : the same for the reversed path, straight to a hit behind mirrors and through the chain to a separate
        receiver; None where it is as long as the straight one, which then counts for both
    straight_weight, reciprocal_weight : amplitude factors of the straight and of the reciprocal path
    receive : receiving polarisations and gain of the antenna for the hit
    age : change of the scatterers since the first pass; None where nothing changes
    derivative : of the returns' tensors; None without parameters
    """

    kernel: Kernel
    lane: Lane
    ray: RayState
    hit: Hit
    lattice: ScattererLattice
    straight: list[list[mi.Complex2f]]
    reciprocal: list[list[mi.Complex2f]] | None
    reverse: list[list[mi.Complex2f]] | None
    straight_weight: mi.Float
    reciprocal_weight: mi.Float
    receive: Receiver
    age: Age | None
    derivative: PatchDerivative | None = None

    def first(self) -> Slot:
        """The first return of the hit."""
        node, back = self.lattice.first(), mi.Bool(False)
        other_way = None if self.reverse is None else mi.Bool(False)
        return Slot(node, back if self.reciprocal is None else ~self.hit.sees, other_way)

    def after(self, slot: Slot, same: mi.Bool) -> Slot:
        """The next return: the next path of the same node, or the next node; in ``same`` lanes the slot itself."""
        stays, back, other_way = same, slot.back, slot.other_way
        if self.reciprocal is not None:
            # a node behind a mirror that the antenna sees has two returns
            turns = ~same & ~slot.back & ~self.hit.first
            if other_way is not None:
                # and three where the straight path and its reverse differ
                reverses, turns = turns & ~other_way, turns & other_way
                stays, other_way = same | reverses, dr.select(same, other_way, reverses)
            stays, back = stays | turns, dr.select(same, slot.back, turns | ~self.hit.sees)
        return Slot(self.lattice.after(slot.node, dr.select(stays, mi.Int32(0), 1)), back, other_way)

    def contribution(self, slot: Slot, active: mi.Bool) -> Contribution:
        """Echo of a slot, a different one in every lane."""
        centre, key = self.lattice.scatterer(slot.node, self.kernel.constants.seed)
        here = self
        if self.kernel.scene.surfaces is not None:
            here = self._at_place(centre, active)
        return here._drifting(slot, active, centre, key)

    def _drifting(self, slot: Slot, active: mi.Bool, centre: mi.Vector3d, key: mi.UInt32) -> Contribution:
        """Echo of a slot; ``centre``: position at rest (float64, m) of its scatterer; ``key``: hash."""
        hit = self.hit
        water, movement = self.kernel.scene.water, hit.movement
        if water is None:
            return self._drawn(slot, active, centre, key, movement)
        material = hit.material & MATERIAL_MASK
        drift = water.drift(centre, key, material, self.kernel.constants.wavenumber, self.lane.time)
        movement = drift.movement if movement is None else movement.plus(drift.movement)
        found = self._drawn(slot, active, centre, key, movement)
        if drift.bragg is None:
            return found
        twice, once = -2.0 * hit.direction, hit.to_antenna - hit.direction
        rate = drift.bragg.range_rate(dr.select(found.kind == RECIPROCAL, twice, once))
        return replace(
            found,
            slant_range=found.slant_range + rate * drift.bragg.time,
            range_rate=found.range_rate + rate,
        )

    def _drawn(
        self, slot: Slot, active: mi.Bool, centre: mi.Vector3d, key: mi.UInt32, movement: Movement | None
    ) -> Contribution:
        """Echo of a scatterer with its random factors; ``centre``: its position at rest, m."""
        flags, ray, hit, lane = self.kernel.flags, self.ray, self.hit, self.lane
        if movement is not None:  # the lattice moves with the shape
            centre = movement.displaced(centre)
        random = speckle_coefficients(
            key, hit.properties.cross_polar_ratio, flags, self.age, self.kernel.constants.term
        )
        leg, leg_back = centre - ray.virtual_antenna, lane.antenna - centre
        length, length_back = dr.norm(leg), dr.norm(leg_back)
        rate_out = -dr.dot(leg, seen_from(movement, ray.virtual_velocity)) / length
        rate_back = dr.dot(leg_back, seen_from(movement, lane.velocity)) / length_back
        weights = self.straight_weight, None if self.reciprocal is None else self.reciprocal_weight
        changes = derivatives_of(self.kernel).at_scatterer(
            self.kernel, lane, ray, hit, self.derivative, weights, centre, random
        )
        straight = Contribution(
            kind=mi.UInt32(DIFFUSE),
            order=hit.order,
            pulse=lane.pulse,
            slant_range=0.5 * (length + length_back),
            range_rate=0.5 * (rate_out + rate_back),
            amplitudes=tuple(mix_terms(terms, random) * self.straight_weight for terms in self.straight),
            active=active,
            point=centre,
            derivative=changes[0],
        )
        if self.reciprocal is None:
            return straight
        reciprocal = replace(
            straight,
            kind=mi.UInt32(RECIPROCAL),
            order=2 * hit.order - 1,  # out through the chain, back through it, the scatterer once
            slant_range=length,
            range_rate=rate_out,
            amplitudes=tuple(mix_terms(terms, random) * self.reciprocal_weight for terms in self.reciprocal),
            derivative=changes[1],
        )
        if self.reverse is None or slot.other_way is None:
            return select_contribution(slot.back, reciprocal, straight)
        home, rate_home = self._through_chain(centre, movement)
        reciprocal = replace(
            reciprocal, slant_range=0.5 * (length + home), range_rate=0.5 * (rate_out + rate_home)
        )
        return select_contribution(
            slot.other_way,
            self._reversed(straight, self.reverse, random, home, rate_home, movement),
            select_contribution(slot.back, reciprocal, straight),
        )

    def _at_place(self, centre: mi.Vector3d, active: mi.Bool) -> DiffuseReturns:
        """The same returns with the material, map value and texture at a scatterer (float64, m, at time zero).

        The hit of the ray is elsewhere on the facet and may lie in another material.
        """
        kernel, hit, scene = self.kernel, self.hit, self.kernel.scene
        surfaces = scene.surfaces
        assert surfaces is not None
        vertex = hit.vertex0 if hit.movement is None else hit.movement.at_rest(hit.vertex0)
        offset = mi.Vector3f(centre - vertex)
        own = hit.own_material & MATERIAL_MASK
        out = self
        if surfaces.classes is not None:
            bits = scene.material_at(hit.face, hit.own_material, offset, active)
            properties = MaterialRow.of(scene.material_table, bits & MATERIAL_MASK, active)
            hit = replace(hit, material=bits, properties=properties)
            terms = diffuse_terms(kernel, self.lane, self.ray, hit, self.receive)
            out = replace(out, hit=hit, straight=terms[0], reciprocal=terms[1], reverse=terms[2])
            if self.age is not None:
                out = replace(out, age=Age.of(kernel, scene.change_table, bits & MATERIAL_MASK))
        factor = surfaces.amplitude(
            hit.face,
            own,
            hit.material & MATERIAL_MASK,
            offset,
            self.lattice.place(centre),
            kernel.constants.seed,
            active,
        )
        return replace(
            out,
            straight_weight=self.straight_weight * factor,
            reciprocal_weight=self.reciprocal_weight * factor,
            derivative=derivatives_of(kernel).at_place(
                kernel, self.lane, self.ray, hit, self.receive, self.derivative, offset, active
            ),
        )

    def _reversed(
        self,
        straight: Contribution,
        reverse: list[list[mi.Complex2f]],
        random: list[mi.Complex2f],
        home: mi.Float64,
        rate_home: mi.Float64,
        movement: Movement | None,
    ) -> Contribution:
        """The reversed path of the straight return: transmitter, scatterer, chain of mirrors, receiver.

        Parameters
        ----------
        straight : the straight return
        reverse : per channel, values of the fixed tensors for the reversed path
        random : random numbers of the scatterer
        home, rate_home : m and m/s, length and range rate of the leg through the chain to the receiver
        movement : of the scatterer

        Notes
        -----
        Ignores that gain and visibility of the two antennas are exchanged: those of the straight return are used.
        """
        leg = straight.point - self.lane.transmitter
        length = dr.norm(leg)
        rate = dr.dot(leg, seen_from(movement, self.lane.transmitter_velocity)) / length
        return replace(
            straight,
            kind=mi.UInt32(REVERSED),
            slant_range=0.5 * (length + home),
            range_rate=0.5 * (rate_home - rate),
            amplitudes=tuple(mix_terms(terms, random) * self.straight_weight for terms in reverse),
        )

    def _through_chain(self, centre: mi.Vector3d, movement: Movement | None) -> tuple[mi.Float64, mi.Float64]:
        """Length (m) of the leg through the ray's chain of mirrors to the receiver, and its rate of change (m/s)."""
        receiver, velocity = self.ray.virtual_receiver, self.ray.virtual_receiver_velocity
        assert receiver is not None and velocity is not None
        leg = centre - receiver
        length = dr.norm(leg)
        return length, -dr.dot(leg, seen_from(movement, velocity)) / length


def _tilt_water(water: WaterTables, hit: Hit, material: mi.UInt32, time: mi.Float64 | None) -> Hit:
    """The hit with the normal of the water tilted by the long waves, for its diffuse law."""
    now = mi.Float(0.0) if time is None else mi.Float(time)
    # waves travel on water that moves as a whole, as in a current
    place = hit.p if hit.movement is None else hit.movement.at_rest(hit.p)
    return replace(hit, normal=water.tilt(hit.normal, mi.Vector3f(place), material, now))


def close_diffuse(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube_here: TubeFootprint, receive: Receiver
) -> DiffuseReturns:
    """Echoes of the persistent scatterers in the ray's patch: straight to the antenna, and reciprocal paths."""
    constants = kernel.constants
    straight, reciprocal, reverse = diffuse_terms(kernel, lane, ray, hit, receive)
    patch = tube_here.patch
    cell = cell_on(constants.cell, hit.largest_cell)
    if ray.spread is not None:
        plain = lane.tube_area * dr.square(mi.Float(hit.length) * lane.inverse_start) / hit.cos_incidence
        cell = widen_cells(cell, tube_here.area / plain, tube_here.area * patch.area() / patch.weight)
    returns = hit.sees if reciprocal is None else hit.sees | (hit.active & ~hit.first)
    # position on the facet at time zero: its scatterers move with it
    p, normal, u, v = hit.p, hit.normal64, tube_here.u, tube_here.v
    grown = patch.weight
    if hit.movement is not None:
        p, normal = hit.movement.at_rest(p), hit.movement.normal_at_rest(normal)
        if hit.movement.deformation is not None:
            now = dr.squared_norm(dr.cross(u, v))
            u, v = (mi.Vector3f(hit.movement.direction_at_rest(mi.Vector3d(x))) for x in (u, v))
            grown = grown * dr.sqrt(now * dr.rcp(dr.maximum(dr.squared_norm(dr.cross(u, v)), 1e-30)))
    lattice = ScattererLattice.of(p, normal, u, v, patch, cell, returns)
    # a facet narrower than the ray spacing is hit by chance: its power is weighted by one over that chance
    weight = constants.amplitude * dr.sqrt(lattice.area * grown)
    return DiffuseReturns(
        kernel=kernel,
        lane=lane,
        ray=ray,
        hit=hit,
        lattice=lattice,
        straight=straight,
        reciprocal=reciprocal,
        reverse=reverse,
        straight_weight=weight * tube_here.loss * receive.gain,
        reciprocal_weight=weight * tube_here.loss_reciprocal,
        receive=receive,
        age=Age.of(kernel, kernel.scene.change_table, hit.material & MATERIAL_MASK),
        derivative=derivatives_of(kernel).at_patch(kernel, lane, ray, hit, receive),
    )


def diffuse_terms(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, receive: Receiver
) -> tuple[Terms, Terms | None, Terms | None]:
    """Per channel, values of the fixed tensors for the straight, the reciprocal and the reversed path."""
    flags, reciprocal_diffuse = kernel.flags, kernel.reciprocal_diffuse
    fields = dict(zip(flags.tracked, ray.fields, strict=True))
    # only behind a mirror, or with two antennas, do the two directions differ
    backscatter = hit.first if flags.multi_bounce else None
    if kernel.bistatic:
        backscatter = mi.Bool(False)
    water = kernel.scene.water
    seen = hit if water is None else _tilt_water(water, hit, hit.material & MATERIAL_MASK, lane.time)
    matrix = ScatteringMatrix(kernel.scene, seen, hit.to_antenna, flags, backscatter)
    straight: list[list[mi.Complex2f]] = []
    reciprocal = None
    reverse: list[list[mi.Complex2f]] | None = [] if reciprocal_diffuse and kernel.bistatic else None
    for channel in flags.closed:
        sent, received = channel[0], channel[1]
        terms = _project_tensors(matrix, receive.basis[received], fields[sent])
        if reciprocal_diffuse:
            # behind mirrors the reversed path has the same length, and the transposed channel
            swapped = _project_tensors(matrix, receive.basis[sent], fields[received])
            if reverse is not None:
                reverse.append(swapped)
            else:
                none = mi.Complex2f(0.0)
                terms = [t + dr.select(hit.first, none, r) for t, r in zip(terms, swapped, strict=True)]
        straight.append(terms)
    if reciprocal_diffuse:
        matrix = ScatteringMatrix(kernel.scene, seen, -hit.direction, flags, None)
        reciprocal = [
            matrix.between_fields(fields[channel[1]], fields[channel[0]]) for channel in flags.closed
        ]
    return (
        _pick_terms(flags, straight),
        None if reciprocal is None else _pick_terms(flags, reciprocal),
        None if reverse is None else _pick_terms(flags, reverse),
    )


def _project_tensors(matrix: ScatteringMatrix, q: Receiving, e: field.ComplexVector) -> list[mi.Complex2f]:
    """Values of the fixed tensors between a receiving vector and an incident field."""
    return matrix.between_fields(q, e) if isinstance(q, tuple) else matrix.between(q, e)


def _pick_terms(flags: KernelFlags, terms: Terms) -> Terms:
    """Terms of the recorded channels, from those of the channels that are computed."""
    columns = [
        field.pick_recorded(flags.closed, column, flags.channels) for column in zip(*terms, strict=True)
    ]
    return [list(row) for row in zip(*columns, strict=True)]


def mix_terms(terms: list[mi.Complex2f], random: list[mi.Complex2f]) -> mi.Complex2f:
    """Sum of the fixed tensors' values times the cell's random numbers."""
    return sum((t * r for t, r in zip(terms[1:], random[1:], strict=True)), terms[0] * random[0])
