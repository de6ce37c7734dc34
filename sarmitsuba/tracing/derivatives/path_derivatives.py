r"""Hooks of a kernel with parameters: derivatives of slant ranges and amplitudes along the paths that it traces.

Slant ranges and range rates are differentiated in closed form (:mod:`.range_tangents`). Derivatives of amplitudes by
properties of materials and by turns of facets are differences along the same paths. The fields of a ray are carried
three times: as the scene is, and for each parameter at both ends of a small step of it. Their returns differ by
the coefficients of Fresnel, of the roughness, of the diffuse law and of the polarisation alone, so that

.. math:: \partial a \approx \frac{a(p + h) - a(p - h)}{2 h}

is formed echo by echo, before anything is added; with h a hundredth of a property its error is of order 1e-4. Steps
of displacements turn normals by at most ``TURN``; their effect is a part :math:`1 / 2 k` over the arm of the whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives import edge_tangents
from sarmitsuba.tracing.derivatives.echo_derivatives import recording
from sarmitsuba.tracing.derivatives.edge_state import EdgeLane
from sarmitsuba.tracing.derivatives.hooks import Derivatives
from sarmitsuba.tracing.derivatives.leg_tangents import differentiate_legs
from sarmitsuba.tracing.derivatives.range_tangents import (
    deformation_rates,
    differentiate_scatterer,
    differentiate_tube,
    mirrored_tangents,
    turned_hit,
)
from sarmitsuba.tracing.derivatives.tangents import NO_MATERIAL, LaneDerivative, PatchDerivative
from sarmitsuba.tracing.kernel.closing import coherent_amplitudes
from sarmitsuba.tracing.kernel.diffuse_return import diffuse_terms, mix_terms
from sarmitsuba.tracing.kernel.propagation import mirror, pass_foci, reflect, through_passages
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.stage import coherent_loss
from sarmitsuba.tracing.kernel.table_rows import MaterialRow, SlabRow

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.derivatives.leg_tangents import Shift
    from sarmitsuba.tracing.derivatives.tangents import Carried, EchoDerivative, TangentPlan, Terms
    from sarmitsuba.tracing.kernel.accumulators import GridAccumulator
    from sarmitsuba.tracing.kernel.kernel import Accumulator
    from sarmitsuba.tracing.kernel.leg import Leg
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.state import (
        Closing,
        Contribution,
        Hit,
        Kernel,
        Lane,
        LaunchPlace,
        RayState,
        Receiver,
        TubeFootprint,
        TubeReturn,
    )
    from sarmitsuba.tracing.kernel.tubes.integral_rates import Rate

# turn of facets at either end of a step, rad: small at grazing incidence, and above the rounding of float32
TURN = 3e-4


def differentiate(kernel: Kernel, plan: TangentPlan | None) -> Kernel:
    """Kernel that carries the derivatives of a plan; itself without any."""
    if plan is None:
        return kernel
    variants = [
        Variant(_add_materials(kernel, scene)) for p in plan.properties for scene in (p.below, p.above)
    ]
    per_unit = [p.per_unit for p in plan.properties]
    for k, rate in plan.turns:
        per_unit.append(0.5 * rate / TURN)
        variants += [Variant(kernel, (k, dr.opaque(mi.Float, sign * TURN / rate))) for sign in (-1.0, 1.0)]
    derivatives = PathDerivatives(
        plan.carried(beside_edges=kernel.grid.edges is not None),
        tuple(variants),
        tuple(dr.opaque(mi.Float, x) for x in per_unit),
    )
    return replace(kernel, derivatives=derivatives)


def _add_materials(kernel: Kernel, scene: TraceScene) -> Kernel:
    own = kernel.scene
    slabs = own.slabs
    if slabs is not None and scene.slabs is not None:
        slabs = replace(slabs, table=scene.slabs.table)
        slabs.prepare()
    tables = replace(
        own,
        material_table=scene.material_table,
        diffuse_table=scene.diffuse_table,
        spectrum_table=scene.spectrum_table,
        correction_table=scene.correction_table,
        slabs=slabs,
    )
    return replace(kernel, scene=tables)


@dataclass(frozen=True, eq=False)
class Variant:
    """Kernel without derivatives at one end of a step of a parameter.

    Parameters
    ----------
    kernel : with the tables of materials at that end
    turn : number of the displacement that turns facets, and the step; None for a property of a material
    """

    kernel: Kernel
    turn: tuple[int, mi.Float] | None = None


@dataclass(frozen=True, eq=False)
class PathDerivatives(Derivatives):
    """Derivatives along the paths of a kernel; hooks as in :class:`Derivatives`.

    Parameters
    ----------
    carried : displacements, and other recorded derivatives; at a hit, those of the shapes that the path met
    variants : both ends of the step of each property of a material, then of each displacement that turns facets
    per_unit : one over the length of each step
    """

    carried: Carried
    variants: tuple[Variant, ...]
    per_unit: tuple[mi.Float, ...]

    @property
    def per_amplitude(self) -> int:  # type: ignore[override]
        """See the base class."""
        return 1 + len(self.per_unit)

    @property
    def displacements(self) -> Carried:
        """See the base class."""
        return self.carried

    def at_launch(
        self, kernel: Kernel, lane: Lane, ray: RayState, place: LaunchPlace
    ) -> tuple[Lane, RayState]:
        """Virtual antenna at the antenna, and equal fields of all variants."""
        edges, derivative = kernel.grid.edges, self.carried.launched()
        edge = beam_rates = None
        if edges is not None:
            edge = EdgeLane.of(edges, place.row, place.distance)
            derivative = edge_tangents.begin_edge(derivative, edges, place.row, ray.direction, place.axes)
        if self.carried.pointing and place.beam is not None:
            beam_rates = place.beam.rates(mi.Vector3f(ray.direction))
        derivative = replace(derivative, fields=(ray.fields,) * len(self.variants))
        return replace(lane, derivative=LaneDerivative(edge, beam_rates)), replace(ray, derivative=derivative)

    def at_hit(self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> tuple[Kernel, RayState, Hit]:
        """Displacements of the shape that was hit, and the fields of all variants there."""
        assert ray.derivative is not None
        here = replace(self, carried=self.carried.at(ray.derivative, hit.face, hit.active))
        if kernel.grid.edges is not None:
            hit = edge_tangents.find_shadowed(lane, ray, hit)
        fields = tuple(pass_foci(through_passages(kernel, one, hit), hit).fields for one in self._rays(ray))
        ray = replace(ray, derivative=replace(ray.derivative, fields=fields))
        return replace(kernel, derivatives=here), ray, hit

    def at_mirror(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        tube: TubeFootprint,
        n: mi.Vector3d,
        reflected: RayState,
    ) -> RayState:
        """Virtual antenna and lit area mirrored, and the fields of all variants reflected."""
        derivative = mirrored_tangents(self.carried, lane, ray, hit, tube, n)
        fields = []
        for variant, one, there in self._variants(ray, hit):
            reflection = mirror(variant, one, there, there.normal)
            fields.append(reflect(variant, lane, one, there, tube, reflection).fields)
        return replace(reflected, derivative=replace(derivative, fields=tuple(fields)))

    def at_integral(self, kernel: Kernel, ray: RayState, hit: Hit, tube: TubeFootprint) -> list[Rate]:
        """Changes of the tube by the displacements that stretch or turn shapes."""
        return deformation_rates(self.carried, kernel, ray, hit, tube)

    def at_closing(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube: TubeFootprint, closing: Closing
    ) -> EchoDerivative:
        """By displacements; beside edges the weight of the ray."""
        if self.carried.beside_edges:
            return edge_tangents.weigh_tube(self.carried, lane, ray, hit)
        return differentiate_tube(self.carried, kernel, lane, ray, hit, tube, closing)

    def without_return(self) -> EchoDerivative:
        """See the base class."""
        return self.carried.without_return()

    def at_coherent_echo(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        receive: Receiver,
        returned: TubeReturn,
        echo: Contribution,
    ) -> Contribution:
        """By properties of materials, turns of facets and angles of the beam too."""
        assert returned.derivative is not None
        own, amplitudes = coherent_loss(kernel, hit), []
        for variant, one, there in self._variants(ray, hit):
            reflection = mirror(variant, one, there, there.normal)
            ratio = dr.select(own > 0.0, coherent_loss(variant, there) / dr.maximum(own, 1e-30), 0.0)
            weight = returned.weight * ratio
            amplitudes.append(coherent_amplitudes(variant, one, there, reflection, receive, weight))
        derivative = replace(
            returned.derivative,
            amplitudes=self._differences(kernel, amplitudes),
            gains=_straight_gains(lane, hit),
            material=mi.UInt32(NO_MATERIAL),
            slots=self.carried.slots,
        )
        return replace(echo, derivative=derivative)

    def at_patch(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, receive: Receiver
    ) -> PatchDerivative:
        """Terms of every variant."""
        return PatchDerivative(
            tuple(
                diffuse_terms(variant, lane, one, there, receive)[:2]
                for variant, one, there in self._variants(ray, hit)
            )
        )

    def at_place(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        receive: Receiver,
        patch: PatchDerivative | None,
        offset: mi.Vector3f,
        active: mi.Bool,
    ) -> PatchDerivative:
        """With the shares of the texels, and the terms of the material at the scatterer."""
        surfaces, found = kernel.scene.surfaces, patch
        assert surfaces is not None and found is not None
        if surfaces.classes is not None:
            found = self.at_patch(kernel, lane, ray, hit, receive)
        if self.carried.mapped and surfaces.levels is not None:
            own = hit.own_material & MATERIAL_MASK
            found = replace(found, texels=surfaces.levels.shares(hit.face, own, offset, active))
        return found

    def at_scatterer(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        patch: PatchDerivative | None,
        weights: tuple[mi.Float, mi.Float | None],
        centre: mi.Vector3d,
        random: list[mi.Complex2f],
    ) -> tuple[EchoDerivative, EchoDerivative]:
        """By all parameters."""
        assert patch is not None
        if self.carried.beside_edges:
            straight, back = edge_tangents.weigh_scatterer(self.carried, lane, ray, hit, centre)
        else:
            straight, back = differentiate_scatterer(self.carried, kernel, lane, ray, hit, centre)

        def amplitudes(variants: Iterator[Terms], weight: mi.Float) -> tuple[mi.Complex2f, ...] | None:
            found = [[mix_terms(terms, random) * weight for terms in variant] for variant in variants]
            return self._differences(kernel, found)

        out_rates = None if lane.derivative is None else lane.derivative.beam_rates
        straight = replace(
            straight,
            amplitudes=amplitudes((terms for terms, _ in patch.terms), weights[0]),
            gains=_straight_gains(lane, hit),
            material=hit.material & MATERIAL_MASK,
            slots=self.carried.slots,
            texels=patch.texels,
        )
        if weights[1] is None:
            return straight, straight
        return straight, replace(
            straight,
            ranges=back.ranges,
            rates=back.rates,
            amplitudes=amplitudes((terms or [] for _, terms in patch.terms), weights[1]),
            gains=None if out_rates is None else tuple(2.0 * x for x in out_rates),
        )

    def at_echo(
        self,
        kernel: Kernel,
        antenna: Antenna,
        echo: Contribution,
        legs: tuple[Leg, Leg],
        shifts: Callable[[], Sequence[Shift | None]] | None = None,
        materials: tuple[mi.UInt32, mi.UInt32] | None = None,
    ) -> Contribution:
        """By displacements and angles of the beam; by properties of materials zero."""
        moved = () if shifts is None else shifts()
        derivative = differentiate_legs(self.carried, kernel, antenna, echo.pulse, legs, moved, materials)
        none = (mi.Complex2f(0.0),) * (len(self.per_unit) * len(echo.amplitudes))
        return replace(echo, derivative=replace(derivative, amplitudes=none or None))

    def _rays(self, ray: RayState) -> list[RayState]:
        """The ray with the fields of every variant."""
        assert ray.derivative is not None
        return [replace(ray, fields=fields, derivative=None) for fields in ray.derivative.fields]

    def _variants(self, ray: RayState, hit: Hit) -> Iterator[tuple[Kernel, RayState, Hit]]:
        """Kernel, ray and hit of every variant: with its material's properties, or its normal and direction."""
        number = hit.material & MATERIAL_MASK
        for variant, one in zip(self.variants, self._rays(ray), strict=True):
            if variant.turn is not None:
                k, step = variant.turn
                yield variant.kernel, one, turned_hit(self.carried, k, ray, hit, step)
                continue
            scene = variant.kernel.scene
            row = MaterialRow.of(scene.material_table, number, hit.met)
            slab = None if scene.slabs is None else SlabRow.of(scene.slabs.table, number, hit.met)
            yield variant.kernel, one, replace(hit, properties=row, slab=slab)

    def _differences(
        self, kernel: Kernel, amplitudes: Sequence[Sequence[mi.Complex2f]]
    ) -> tuple[mi.Complex2f, ...] | None:
        """Derivatives of the channels from those of every variant, see ``EchoDerivative.amplitudes``."""
        out: list[mi.Complex2f] = []
        for k, per_unit in enumerate(self.per_unit):
            below, above = amplitudes[2 * k : 2 * k + 2]
            changes = [(b - a) * per_unit for a, b in zip(below, above, strict=True)]
            if self.variants[2 * k].turn is not None:
                # as if the slant range changed: the factor -2 j k comes with the synthesis
                metres = mi.Complex2f(0.0, 0.5 / kernel.constants.wavenumber)
                changes = [change * metres for change in changes]
            out += changes
        return tuple(out) or None


def record_beside(kernel: Kernel, accumulator: GridAccumulator) -> Accumulator:
    """Accumulator that adds the derivatives of echoes beside them, or to a gradient; itself without parameters."""
    found = kernel.derivatives
    if not isinstance(found, PathDerivatives):
        return accumulator
    return recording(found.carried, accumulator, accumulator.adjoint)


def _straight_gains(lane: Lane, hit: Hit) -> tuple[mi.Float, ...] | None:
    """Relative derivatives by the angles of the beam of a path that ends straight at the antenna, 1/rad."""
    if lane.derivative is None or lane.derivative.beam_rates is None:
        return None
    assert lane.pattern is not None
    back = lane.pattern.received_rates(-hit.to_antenna)
    return tuple(x + y for x, y in zip(lane.derivative.beam_rates, back, strict=True))
