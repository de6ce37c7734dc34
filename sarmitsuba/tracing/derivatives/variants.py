r"""Derivatives of amplitudes by properties of materials and by turns of facets, as differences along the same paths.

The fields of a ray are carried three times: as the scene is, and for each parameter at both ends of a small step of it.
What they return differs by the coefficients of Fresnel, of the roughness, of the diffuse law and of the polarisation
alone, so that

.. math:: \partial a \approx \frac{a(p + h) - a(p - h)}{2 h}

is formed echo by echo, before anything is added; with h a hundredth of a property its error is of order 1e-4. Steps
of displacements turn normals by at most ``TURN``; what they change is a part :math:`1 / 2 k` over the arm of the whole.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.range_tangents import turned_hit
from sarmitsuba.tracing.kernel.propagation import mirror, reflect
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.table_rows import MaterialRow, SlabRow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.tracing.derivatives.tangents import TangentPlan
    from sarmitsuba.tracing.kernel.field import ComplexVector
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.state import Hit, Kernel, Lane, RayState, TubeFootprint


# turn of facets at either end of a step, rad: small at grazing incidence, and above the rounding of float32
TURN = 3e-4


def with_tangents(kernel: Kernel, tangents: TangentPlan | None) -> Kernel:
    """Kernel that carries derivatives; itself without any."""
    if tangents is None:
        return kernel
    variants = [_with_materials(kernel, scene) for p in tangents.properties for scene in (p.below, p.above)]
    per_unit = [p.per_unit for p in tangents.properties]
    for k, rate in tangents.turns:
        per_unit.append(0.5 * rate / TURN)
        variants += [
            replace(kernel, turn=(k, dr.opaque(mi.Float, sign * TURN / rate))) for sign in (-1.0, 1.0)
        ]
    return replace(
        kernel,
        tangents=tangents.carried(beside_edges=kernel.grid.edges is not None),
        variants=tuple(variants),
        per_unit=tuple(dr.opaque(mi.Float, x) for x in per_unit),
    )


def _with_materials(kernel: Kernel, scene: TraceScene) -> Kernel:
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


def variant_rays(ray: RayState) -> list[RayState]:
    """The ray with the fields of every variant."""
    return [replace(ray, fields=fields, variants=(), tangents=None) for fields in ray.variants]


def variant_hits(kernel: Kernel, ray: RayState, hit: Hit) -> list[Hit]:
    """The hit with the material's properties, or the normal and the direction, of every variant."""
    number = hit.material & MATERIAL_MASK
    found = []
    for variant in kernel.variants:
        if variant.turn is not None:
            assert kernel.tangents is not None
            k, step = variant.turn
            found.append(turned_hit(kernel.tangents, k, ray, hit, step))
            continue
        scene = variant.scene
        row = MaterialRow.of(scene.material_table, number, hit.met)
        slab = None if scene.slabs is None else SlabRow.of(scene.slabs.table, number, hit.met)
        found.append(replace(hit, properties=row, slab=slab))
    return found


def reflected_variants(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube_here: TubeFootprint
) -> tuple[tuple[ComplexVector, ...], ...]:
    """Fields of the reflected ray of every variant."""
    fields = []
    for variant, one, there in zip(
        kernel.variants, variant_rays(ray), variant_hits(kernel, ray, hit), strict=True
    ):
        reflection = mirror(variant, one, there, there.normal)
        fields.append(reflect(variant, lane, one, there, tube_here, reflection).fields)
    return tuple(fields)


def differences(
    kernel: Kernel, amplitudes: Sequence[Sequence[mi.Complex2f]]
) -> tuple[mi.Complex2f, ...] | None:
    """Derivatives of the channels from those of every variant, see ``Contribution.amplitude_tangents``."""
    if not kernel.variants:
        return None
    out: list[mi.Complex2f] = []
    for k, per_unit in enumerate(kernel.per_unit):
        below, above = amplitudes[2 * k : 2 * k + 2]
        changes = [(b - a) * per_unit for a, b in zip(below, above, strict=True)]
        if kernel.variants[2 * k].turn is not None:
            # as if the slant range changed: the factor -2 j k comes with the synthesis
            metres = mi.Complex2f(0.0, 0.5 / kernel.constants.wavenumber)
            changes = [change * metres for change in changes]
        out += changes
    return tuple(out)
