"""Rows of the scene's tables in the kernel, with names for their columns."""

from __future__ import annotations

from dataclasses import dataclass

from sarmitsuba.machine.backend import dr, mi


@dataclass(frozen=True, eq=False)
class MaterialRow:
    """Row of ``TraceScene.material_table``.

    Parameters
    ----------
    values : Re, Im of eps - 1, rms height (m), cross-polar power ratio
    """

    values: mi.Vector4f

    @staticmethod
    def of(table: mi.Float, material: mi.UInt32, active: mi.Bool | bool = True) -> MaterialRow:
        """Row of a material, by its number."""
        return MaterialRow(dr.gather(mi.Vector4f, table, material, active))

    @property
    def susceptibility(self) -> mi.Complex2f:
        """Relative permittivity less one."""
        return mi.Complex2f(self.values.x, self.values.y)

    @property
    def rms_height(self) -> mi.Float:
        """Of the roughness, m."""
        return self.values.z

    @property
    def cross_polar_ratio(self) -> mi.Float:
        """Power of the diffuse return's cross-polar channels over that of the co-polar ones."""
        return self.values.w


@dataclass(frozen=True, eq=False)
class SlabRow:
    """Row of ``SlabTables.table``.

    Parameters
    ----------
    values : phase thickness, sheet admittance, 1 where the slab lets waves through, 0
    """

    values: mi.Vector4f

    @staticmethod
    def of(table: mi.Float, material: mi.UInt32, active: mi.Bool | bool = True) -> SlabRow:
        """Row of a material, by its number."""
        return SlabRow(dr.gather(mi.Vector4f, table, material, active))

    @property
    def phase_thickness(self) -> mi.Float:
        """Wavenumber in free space times thickness, rad; 0: a half space."""
        return self.values.x

    @property
    def sheet_admittance(self) -> mi.Float:
        """Impedance of free space over the resistance of the sheet on its face."""
        return self.values.y

    @property
    def has_thickness(self) -> mi.Bool:
        """Lanes in which it is no half space."""
        return self.values.x > 0.0

    @property
    def transmits(self) -> mi.Bool:
        """Lanes in which it lets waves through."""
        return self.values.z > 0.5


@dataclass(frozen=True, eq=False)
class FaceRow:
    """Row of ``TraceScene.face_info``.

    Parameters
    ----------
    values : bits of the material; float32 as bits: largest cell, farthest rays for the coherent and the diffuse return
    """

    values: mi.Vector4u

    @staticmethod
    def of(table: mi.UInt32, face: mi.UInt32, active: mi.Bool | bool = True) -> FaceRow:
        """Row of a face."""
        return FaceRow(dr.gather(mi.Vector4u, table, face, active))

    @property
    def material_bits(self) -> mi.UInt32:
        """Number of the material, and the boundary edges of the facet."""
        return self.values.x

    @property
    def largest_cell(self) -> mi.Float:
        """Of a diffuse scatterer on the face's piece of surface, m."""
        return dr.reinterpret_array(mi.Float, self.values.y)

    @property
    def needed_spacings(self) -> tuple[mi.Float, mi.Float]:
        """Farthest apart that rays may be for the coherent return and for the diffuse one, m."""
        coherent, diffuse = (dr.reinterpret_array(mi.Float, word) for word in (self.values.z, self.values.w))
        return coherent, diffuse
