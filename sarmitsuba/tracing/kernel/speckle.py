"""Persistent diffuse scatterers: nodes of a lattice on every surface, each with a fixed complex Gaussian amplitude.

The lattice is fixed to the scene, so the same piece of surface has the same complex reflectivity and the same phase
centre in every pulse, whichever rays find it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.tubes.tube import Patch

TWO_PI = 6.283185307179586


def mix(x: mi.UInt32) -> mi.UInt32:
    """Hash of a 32-bit number: a finaliser in which every input bit affects every output bit."""
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


@dataclass(frozen=True, eq=False)
class SurfacePlace:
    """Coordinates of a surface point along the two lattice axes (float64, m), and the axis that is left out (0: z)."""

    a: mi.Float64
    b: mi.Float64
    axis: mi.UInt32

    @classmethod
    def of(cls, point: mi.Vector3d, normal: mi.Vector3d) -> SurfacePlace:
        """Lattice coordinates of a point on a surface with this unit normal."""
        take_z, take_y = _left_out(normal)
        a, b, _ = _lattice_axes(point, take_z, take_y)
        return cls(a, b, _axis(take_z, take_y))


@dataclass  # not frozen: part of a loop's state, which Dr.Jit writes to
class Node:
    """Current node in the loop over the nodes of a patch, and the end of its row.

    Parameters
    ----------
    row, column : counted from the first node of the patch's bounds
    last : column of the last one in this row; less than ``column`` when no node is left
    """

    row: mi.Int32
    column: mi.Int32
    last: mi.Int32


@dataclass(frozen=True, eq=False)
class ScattererLattice:
    """Diffuse scatterers in the patch of a facet that one ray represents: lattice nodes fixed to the scene.

    Every node has a square cell in two axes (that of the normal's largest component ``nc`` is left out), rotated by a
    fixed angle, and represents the area ``cell^2 / |nc|`` of the surface. Patches tile the facet, so each lit node
    belongs to one ray, and the mean power is proportional to the lit area, independent of the tessellation.

    Parameters
    ----------
    cell : m, distance between nodes
    a, b, c : m, of the hit point, along both axes and the one left out
    slope_a, slope_b : of the facet
    first_a, first_b : numbers of the first row and column of the patch's bounds
    rows : of the bounds, 0 in lanes without nodes
    last_column : number of columns less one
    sides : of the patch: a side crosses row r at column ``at + slope r``, and is the lower (``lower``) or the upper
        bound of the patch's columns
    area : m^2, area of the facet per node
    """

    take_z: mi.Bool
    take_y: mi.Bool
    cell: mi.Float64
    a: mi.Float64
    b: mi.Float64
    c: mi.Float64
    slope_a: mi.Float64
    slope_b: mi.Float64
    first_a: mi.Float64
    first_b: mi.Float64
    rows: mi.Int32
    last_column: mi.Float
    sides: tuple[tuple[mi.Float, mi.Float, mi.Bool], ...]
    area: mi.Float

    @classmethod
    def of(
        cls,
        point: mi.Vector3d,
        normal: mi.Vector3d,
        u: mi.Vector3f,
        v: mi.Vector3f,
        patch: Patch,
        cell: mi.Float64,
        active: mi.Bool,
    ) -> ScattererLattice:
        """Lattice about a hit; lanes that are not active have no nodes.

        Parameters
        ----------
        point, normal : float64, m, hit point and unit normal of the facet
        u, v : m, edges of the whole tube's footprint
        patch : part of the facet, in units of u and v
        cell : m, distance between nodes
        """
        take_z, take_y = _left_out(normal)
        a, b, c = _lattice_axes(point, take_z, take_y)
        na, nb, nc = _lattice_axes(normal, take_z, take_y)
        ua, ub, _ = _lattice_axes(u, take_z, take_y)
        va, vb, _ = _lattice_axes(v, take_z, take_y)
        scale = mi.Float(1.0 / cell)
        corners = [
            ((alpha * ua + beta * va) * scale, (alpha * ub + beta * vb) * scale)
            for alpha, beta in patch.corners
        ]
        # a node lies within its cell
        place_a, place_b = a / cell, b / cell
        bounds_a, bounds_b = ([corner[axis] for corner in corners] for axis in (0, 1))
        first_a = dr.floor(place_a + mi.Float64(_least(bounds_a)))
        first_b = dr.floor(place_b + mi.Float64(_least(bounds_b)))
        last_a = dr.floor(place_a + mi.Float64(_most(bounds_a)))
        last_b = dr.floor(place_b + mi.Float64(_most(bounds_b)))
        determinant = ua * vb - ub * va
        usable = active & (dr.abs(determinant) > 1e-30)
        rows = mi.Int32(dr.clip(last_a - first_a + 1.0, 0.0, MOST_NODES))
        # corners from the first node, in cells
        to_a, to_b = mi.Float(place_a - first_a - 0.5), mi.Float(place_b - first_b - 0.5)
        around = [(to_a + x, to_b + y) for x, y in corners]
        turned = dr.select(determinant < 0.0, -1.0, 1.0)
        return cls(
            take_z=take_z,
            take_y=take_y,
            cell=cell,
            a=a,
            b=b,
            c=c,
            slope_a=na / nc,
            slope_b=nb / nc,
            first_a=first_a,
            first_b=first_b,
            rows=dr.select(usable, rows, 0),
            last_column=mi.Float(dr.clip(last_b - first_b, -1.0, MOST_NODES - 1.0)),
            sides=tuple(_side(p, q, turned) for p, q in zip(around, (*around[1:], around[0]), strict=True)),
            area=mi.Float(cell * cell / dr.abs(nc)),
        )

    def first(self) -> Node:
        """The first node of the patch."""
        return self._find_node(self._row(mi.Int32(0)))

    def after(self, node: Node, step: mi.Int32) -> Node:
        """The next node of the patch, or, in lanes with a ``step`` of 0 rather than 1, the same."""
        return self._find_node(replace(node, column=node.column + step))

    def _row(self, row: mi.Int32) -> Node:
        """The first node of a row."""
        number = mi.Float(row)
        low, high = mi.Float(0.0), dr.select(row < self.rows, self.last_column, -1.0)
        for at, slope, lower in self.sides:
            crossing = dr.fma(slope, number, at)
            low = dr.select(lower, dr.maximum(low, crossing), low)
            high = dr.select(lower, high, dr.minimum(high, crossing))
        # there is no column below the first: keeps the conversion within the range of integers
        return Node(
            row, mi.Int32(dr.ceil(dr.minimum(low, MOST_NODES))), mi.Int32(dr.floor(dr.maximum(high, -1.0)))
        )

    def _find_node(self, node: Node) -> Node:
        """The node itself, or the first node of the following rows if its own row is finished."""
        found: tuple[Node] = dr.while_loop(
            (node,),
            lambda node: (node.column > node.last) & (node.row < self.rows),
            lambda node: (self._row(node.row + 1),),
            labels=("node",),
            label="rows",
            mode="symbolic",
        )
        return found[0]

    def place(self, point: mi.Vector3d) -> SurfacePlace:
        """Lattice coordinates of a scatterer."""
        a, b, _ = _lattice_axes(point, self.take_z, self.take_y)
        return SurfacePlace(a, b, _axis(self.take_z, self.take_y))

    def scatterer(self, node: Node, seed: mi.UInt32) -> tuple[mi.Vector3d, mi.UInt32]:
        """Position of a node (float64, m) and its hash, independent of ray, facet, pulse and look."""
        ia, ib = self.first_a + mi.Float64(node.row), self.first_b + mi.Float64(node.column)
        ca, cb = (ia + 0.5) * self.cell, (ib + 0.5) * self.cell
        # along the left-out axis onto the tangent plane
        cc = self.c - (ca - self.a) * self.slope_a - (cb - self.b) * self.slope_b
        ca, cb = TURN_COS * ca - TURN_SIN * cb, TURN_SIN * ca + TURN_COS * cb
        point = mi.Vector3d(
            dr.select(self.take_z | self.take_y, ca, cc),
            dr.select(self.take_z, cb, dr.select(self.take_y, cc, ca)),
            dr.select(self.take_z, cc, cb),
        )
        # layers of a few cells distinguish surfaces that lie over one another
        layer = dr.floor(cc / (self.cell * LAYER_CELLS) + 0.4142)
        u32, i32 = mi.UInt32, mi.Int32
        axis = _axis(self.take_z, self.take_y)
        size = dr.reinterpret_array(u32, mi.Float(self.cell))
        key = mix(u32(i32(ia)) * 0x9E3779B1 + seed)
        key = mix(key ^ (u32(i32(ib)) * 0x85EBCA77 + 0x27D4EB2F))
        key = mix(key ^ (u32(i32(layer)) * 0xC2B2AE3D + axis * 0x165667B1 + size * 0xD3A2646C))
        return point, key


# the lattice is rotated by the angle whose tangent is the golden mean: narrow strips along the scene's axes then
# contain their share of nodes; rows stay regular, so that the lattice has no spatial frequency below one per cell
TURN_COS, TURN_SIN = 0.8506508083520400, 0.5257311121191336
# most nodes along one axis of a patch: bounds the loop where a patch is degenerate
MOST_NODES = 64.0
# number of scatterers that represent all those of a patch spread by a curved mirror
WIDE_NODES = 16.0
# thickness of a layer, cells
LAYER_CELLS = 4.0


def cell_on(cell: mi.Float64, largest: mi.Float) -> mi.Float64:
    """Cell of the diffuse scatterers on a piece of surface, m: the largest ``cell / sqrt(2)^n`` up to ``largest``."""
    steps = dr.ceil(2.0 * dr.log2(mi.Float(cell) / dr.maximum(largest, 1e-6)) - 1e-4)
    return cell * mi.Float64(dr.exp2(-0.5 * dr.clip(steps, 0.0, 40.0)))


def widen_cells(cell: mi.Float64, wider: mi.Float, area: mi.Float) -> mi.Float64:
    """Edge of the cells in a patch spread by a curved mirror, m: so large that it has about ``WIDE_NODES`` nodes.

    Parameters
    ----------
    cell : m, of the facet
    wider : area of the tube relative to one without curved mirrors; cells grow at most by this factor
    area : m^2, of the patch
    """
    nodes = area / mi.Float(cell * cell)
    steps = dr.ceil(dr.log2(dr.clip(dr.minimum(wider, nodes / WIDE_NODES), 1.0, 1e12)))
    return cell * mi.Float64(dr.exp2(0.5 * steps))


def _side(
    p: tuple[mi.Float, mi.Float], q: tuple[mi.Float, mi.Float], turned: mi.Float
) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Bound on the columns of each row by the side from p to q, the patch to its left (``turned`` -1: to its right)."""
    along, rise = (q[0] - p[0]) * turned, (q[1] - p[1]) * turned
    # a side parallel to the rows bounds them far outside; a side without length bounds nothing
    crosses, long = dr.abs(along) > 1e-9, dr.abs(along) + dr.abs(rise) > 1e-9
    inverse = dr.rcp(dr.select(crosses, along, dr.select(along >= 0.0, 1e-9, -1e-9)))
    slope = rise * inverse
    return dr.select(long, p[1] - p[0] * slope, -1e9), dr.select(long, slope, 0.0), (along >= 0.0) | ~long


def _left_out(normal: mi.Vector3d) -> tuple[mi.Bool, mi.Bool]:
    """Lanes in which the lattice leaves out z, and in which y."""
    ax, ay, az = dr.abs(normal.x), dr.abs(normal.y), dr.abs(normal.z)
    # 1e-6: walls at exactly 45 degrees keep one axis, independent of the rounding of their normal
    take_z = (az >= ax - 1e-6) & (az >= ay - 1e-6)
    return take_z, ~take_z & (ay >= ax - 1e-6)


def _axis(take_z: mi.Bool, take_y: mi.Bool) -> mi.UInt32:
    u32 = mi.UInt32
    return dr.select(take_z, u32(0), dr.select(take_y, u32(1), u32(2)))


def _lattice_axes(
    w: mi.Vector3d | mi.Vector3f, take_z: mi.Bool, take_y: mi.Bool
) -> tuple[mi.Float64 | mi.Float, mi.Float64 | mi.Float, mi.Float64 | mi.Float]:
    """Components along the two lattice axes and the scene's axis that is left out."""
    s = dr.select
    a, b = s(take_z | take_y, w.x, w.y), s(take_z, w.y, w.z)
    c = s(take_z, w.z, s(take_y, w.y, w.x))
    return TURN_COS * a + TURN_SIN * b, TURN_COS * b - TURN_SIN * a, c


def _least(values: list[mi.Float]) -> mi.Float:
    return dr.minimum(dr.minimum(values[0], values[1]), dr.minimum(values[2], values[3]))


def _most(values: list[mi.Float]) -> mi.Float:
    return dr.maximum(dr.maximum(values[0], values[1]), dr.maximum(values[2], values[3]))


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
    """Phase factor of unit modulus and hashed phase: a cell without amplitude fluctuation."""
    k2 = mix(mix(key ^ ((0x68E31DA4 + 0x9E3779B9 * stream) & 0xFFFFFFFF)) ^ 0xB5297A4D)
    s, c = dr.sincos(mi.Float(k2 >> 8) * (TWO_PI / 16777216.0))
    return mi.Complex2f(c, s)


def unit_uniform(key: mi.UInt32, salt: int) -> mi.Float:
    """Uniform random number in 0 ... 1 (exclusive) from a hashed cell; ``salt`` picks independent ones."""
    return (mi.Float(mix(mix(key ^ salt)) >> 8) + 0.5) * (1.0 / 16777216.0)
