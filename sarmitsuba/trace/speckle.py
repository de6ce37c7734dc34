"""Persistent diffuse scatterers: surface-anchored cells, each with its own fixed complex Gaussian.

A hit is snapped to the centre of a square cell of a grid fixed to the scene, so that the same piece of surface
has the same complex reflectivity and the same phase centre in every pulse, whichever rays find it.
"""

from __future__ import annotations

from sarmitsuba.backend import dr, mi

TWO_PI = 6.283185307179586

N_CELLS = 4  # that a tube can reach: its own and the nearer neighbour, along either axis


def mix(x: mi.UInt32) -> mi.UInt32:
    """One round of a 32-bit finaliser (two multiplications, three shifts): every input bit reaches every output bit."""
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


class CellFrame:
    """The cell grid as seen from one hit: its own cell and the neighbours that its tube's footprint reaches into.

    Cells are square in the two axes that span the surface best (the normal's largest component is left out), so
    that their area on the surface is ``cell^2 / |n_max|`` whatever the facet's position; the third coordinate only
    separates layers of one smooth surface. A ray's area is shared out among the cells that its patch of the facet
    overlaps, as a box of the patch's own second moments: patches tile the facet, so each cell receives its own
    area almost exactly, where counting whole tubes by their centres would scatter by the number that falls in.

    Parameters
    ----------
    p : middle of the patch that the ray stands for, float64 3-vector, m, scene frame
    n : unit normal, float64 3-vector
    tube, patch : edges of the whole tube's footprint and of the patch, pairs of float32 3-vectors, m
    group : uint32, smooth surface the face belongs to
    cell : cell edge, m, float64
    seed : uint32
    """

    def __init__(
        self,
        p: mi.Vector3d,
        n: mi.Vector3d,
        tube: tuple[mi.Vector3f, mi.Vector3f],
        patch: tuple[mi.Vector3f, mi.Vector3f],
        group: mi.UInt32,
        cell: mi.Float64,
        seed: mi.UInt32,
    ) -> None:
        self.edge, self.group, self.seed = cell, group, seed
        ax, ay, az = dr.abs(n.x), dr.abs(n.y), dr.abs(n.z)
        # 1e-6: walls at exactly 45 degrees keep one axis whatever the rounding of their normal
        self.take_z = (az >= ax - 1e-6) & (az >= ay - 1e-6)
        self.take_y = ~self.take_z & (ay >= ax - 1e-6)
        self.a, self.b, self.c = self._axes(p)
        self.na, self.nb, self.nc = self._axes(n)
        inverse = 1.0 / cell
        self.ia, self.ib = dr.floor(self.a * inverse), dr.floor(self.b * inverse)
        # layers 64 cells apart: far enough that a tilted face rarely crosses one
        self.ic = dr.floor(self.c * (inverse / 64.0) + 0.4142)
        scale = mi.Float(inverse)
        width_a, width_b = self._widths(*patch, scale)
        self.share_a, self.step_a = self._shares(mi.Float(self.a * inverse - self.ia), width_a)
        self.share_b, self.step_b = self._shares(mi.Float(self.b * inverse - self.ib), width_b)
        # tubes wider than a cell leave cells out, the rest gets their power: mean square over squared mean
        pitch_a, pitch_b = self._widths(*tube, scale)
        self.bias = _missed(pitch_a) * _missed(pitch_b)
        self.area = mi.Float(cell * cell / dr.abs(self.nc))

    def _axes(
        self, w: mi.Vector3d | mi.Vector3f
    ) -> tuple[mi.Float64 | mi.Float, mi.Float64 | mi.Float, mi.Float64 | mi.Float]:
        """Components along the two cell axes and the one left out."""
        s = dr.select
        return (
            s(self.take_z | self.take_y, w.x, w.y),
            s(self.take_z, w.y, w.z),
            s(self.take_z, w.z, s(self.take_y, w.y, w.x)),
        )

    def _widths(self, u: mi.Vector3f, v: mi.Vector3f, scale: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Box of a parallelogram's second moments along the two axes, cells."""
        ua, ub, _ = self._axes(u)
        va, vb, _ = self._axes(v)
        return dr.sqrt(ua * ua + va * va) * scale, dr.sqrt(ub * ub + vb * vb) * scale

    def _shares(self, fraction: mi.Float, width: mi.Float) -> tuple[tuple[mi.Float, mi.Float], mi.Float]:
        """Overlap of a box about ``fraction`` (0..1) with its cell and the nearer neighbour; step to the latter."""
        width = dr.clip(width, 1e-3, 1.0)
        low = fraction < 0.5
        other = dr.maximum(0.5 * width - dr.select(low, fraction, 1.0 - fraction), 0.0) / width
        return (1.0 - other, other), dr.select(low, -1.0, 1.0)

    def share(self, second_a: mi.Bool | bool, second_b: mi.Bool | bool) -> mi.Float:
        """Share of the tube that falls in its own cell or, along one axis or both, in the nearer neighbour."""
        a, b = (
            dr.select(second, shares[1], shares[0])
            for second, shares in ((second_a, self.share_a), (second_b, self.share_b))
        )
        return a * b

    def cell(self, second_a: mi.Bool, second_b: mi.Bool) -> tuple[mi.Vector3d, mi.UInt32]:
        """Phase centre (float64 m) and hash (uint32) of the hit's own cell or, along one axis or both, the next."""
        ia = self.ia + mi.Float64(dr.select(second_a, self.step_a, 0.0))
        ib = self.ib + mi.Float64(dr.select(second_b, self.step_b, 0.0))
        ca, cb = (ia + 0.5) * self.edge, (ib + 0.5) * self.edge
        # the cell's centre, along the left-out axis onto the tangent plane
        cc = self.c - ((ca - self.a) * self.na + (cb - self.b) * self.nb) / self.nc
        i32, u32 = mi.Int32, mi.UInt32
        axis = dr.select(self.take_z, u32(0), dr.select(self.take_y, u32(1), u32(2)))
        key = mix(u32(i32(ia)) * 0x9E3779B1 + self.seed)
        key = mix(key ^ (u32(i32(ib)) * 0x85EBCA77 + 0x27D4EB2F))
        key = mix(key ^ (u32(i32(self.ic)) * 0xC2B2AE3D + axis * 0x165667B1 + self.group * 0xD3A2646C))
        centre = mi.Vector3d(
            dr.select(self.take_z | self.take_y, ca, cc),
            dr.select(self.take_z, cb, dr.select(self.take_y, cc, ca)),
            dr.select(self.take_z, cc, cb),
        )
        return centre, key


def _missed(width: mi.Float) -> mi.Float:
    r"""Mean square over squared mean of what cells receive along one axis from tubes ``width`` cells apart.

    .. math:: w \left(\tfrac23 + \tfrac13 \max(2 - w, 0)^3\right), \quad w \ge 1

    Boxes of one cell at a pitch of w cells: their share in a cell is a triangle of half width one, whose square has
    the mean 2/3 and whose products of neighbours the mean ``(2 - w)^3 / 6``.
    """
    w = dr.maximum(width, 1.0)
    gap = dr.maximum(2.0 - w, 0.0)
    return w * (2.0 / 3.0 + gap * gap * gap * (1.0 / 3.0))


def gaussian(key: mi.UInt32, stream: int) -> mi.Complex2f:
    """Circular complex Gaussian of unit mean power from a hashed cell; ``stream`` picks independent ones."""
    k1 = mix(key ^ ((0x68E31DA4 + 0x9E3779B9 * stream) & 0xFFFFFFFF))
    k2 = mix(k1 ^ 0xB5297A4D)
    u1 = (mi.Float(k1 >> 8) + 0.5) * (1.0 / 16777216.0)
    u2 = mi.Float(k2 >> 8) * (TWO_PI / 16777216.0)
    s, c = dr.sincos(u2)
    r = dr.sqrt(-dr.log(u1))
    return mi.Complex2f(r * c, r * s)


def unit_phase(key: mi.UInt32, stream: int) -> mi.Complex2f:
    """Unit modulus and a hashed phase: a cell without speckle of its own."""
    k2 = mix(mix(key ^ ((0x68E31DA4 + 0x9E3779B9 * stream) & 0xFFFFFFFF)) ^ 0xB5297A4D)
    s, c = dr.sincos(mi.Float(k2 >> 8) * (TWO_PI / 16777216.0))
    return mi.Complex2f(c, s)


__all__ = ["N_CELLS", "CellFrame", "gaussian", "mix", "unit_phase"]
