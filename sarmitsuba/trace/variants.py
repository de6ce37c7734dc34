r"""Derivatives of amplitudes by properties of materials, as differences along the same paths.

The fields of a ray are carried three times: with the scene's materials, and for each property with its material at both
ends of a small step. What they return differs by the coefficients of Fresnel, of the roughness and of the diffuse law
alone, so that

.. math:: \partial a \approx \frac{a(p + h) - a(p - h)}{2 h}

is formed echo by echo, before anything is added; with h a hundredth of p its error is of order 1e-4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.field import ComplexVector  # at run time: Dr.Jit reads the types of the loop's state
from sarmitsuba.trace.scene_tables import MATERIAL_MASK
from sarmitsuba.trace.table_rows import MaterialRow, SlabRow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.trace.scene_tables import TraceScene
    from sarmitsuba.trace.state import Hit, Kernel, RayState

Fields = tuple[ComplexVector, ...]


@dataclass(frozen=True, eq=False)
class Property:
    """Property of a material: the scene's geometry with the tables of its materials at both ends of a step.

    Parameters
    ----------
    below, above : scenes that share everything but these tables
    per_unit : one over the difference of the property between them
    """

    below: TraceScene
    above: TraceScene
    per_unit: float


@dataclass(frozen=True, eq=False)
class Variants:
    """Kernels with other materials, two for each property.

    Parameters
    ----------
    kernels : without derivatives of their own
    per_unit : of each property
    """

    kernels: tuple[Kernel, ...]
    per_unit: tuple[mi.Float, ...]

    @staticmethod
    def of(kernel: Kernel, properties: Sequence[Property]) -> Variants:
        """Variants of a kernel."""
        return Variants(
            tuple(_with_materials(kernel, scene) for p in properties for scene in (p.below, p.above)),
            tuple(dr.opaque(mi.Float, p.per_unit) for p in properties),
        )

    def launched(self, fields: Fields) -> tuple[Fields, ...]:
        """Fields of all variants at launch."""
        return (fields,) * len(self.kernels)

    def rays(self, ray: RayState) -> list[RayState]:
        """The ray with the fields of every variant."""
        assert ray.variants is not None
        return [replace(ray, fields=fields, variants=None, tangents=None) for fields in ray.variants]

    def hits(self, hit: Hit) -> list[Hit]:
        """The hit with the material's properties of every variant."""
        number = hit.material & MATERIAL_MASK
        known = hit.met
        found = []
        for kernel in self.kernels:
            scene = kernel.scene
            row = MaterialRow.of(scene.material_table, number, known)
            slab = None if scene.slabs is None else SlabRow.of(scene.slabs.table, number, known)
            found.append(replace(hit, properties=row, slab=slab))
        return found

    def differences(self, amplitudes: Sequence[Sequence[mi.Complex2f]]) -> tuple[mi.Complex2f, ...]:
        """Derivatives of the channels by every property, from the channels of every variant."""
        out: list[mi.Complex2f] = []
        for k, per_unit in enumerate(self.per_unit):
            below, above = amplitudes[2 * k : 2 * k + 2]
            out += [(b - a) * per_unit for a, b in zip(below, above, strict=True)]
        return tuple(out)


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
    return replace(kernel, scene=tables, tangents=None, variants=None)
