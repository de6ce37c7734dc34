"""Persistent diffuse scatterers: nodes of a lattice on every surface, each with its own fixed complex Gaussian.

The lattice is fixed to the scene, so the same piece of surface has the same complex reflectivity and the same phase
centre in every pulse, whichever rays find it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi

if TYPE_CHECKING:
    from sarmitsuba.trace.tubes.tube import Patch

TWO_PI = 6.283185307179586


def mix(x: mi.UInt32) -> mi.UInt32:
    """One round of a 32-bit finaliser (two multiplications, three shifts): every input bit reaches every output bit."""
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


@dataclass(frozen=True, eq=False)
class SurfacePlace:
    """A place in the two lattice axes that span its surface best (float64, m), and which axis is left out (0: z)."""

    a: mi.Float64
    b: mi.Float64
    axis: mi.UInt32

    @classmethod
    def of(cls, point: mi.Vector3d, normal: mi.Vector3d) -> SurfacePlace:
        """Place of a point on a surface of that unit normal."""
        take_z, take_y = _left_out(normal)
        a, b, _ = _lattice_axes(point, take_z, take_y)
        return cls(a, b, _axis(take_z, take_y))


@dataclass  # not frozen: part of a loop's state, which Dr.Jit writes to
class Node:
    """A node of a patch, and those left in its row.

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
    """The scatterers that one ray stands for: nodes fixed to the scene that lie in its patch of the facet.

    Every node has a square cell in the two axes that span the surface best (the normal's largest component ``nc`` is
    left out), turned by a fixed angle. It stands for ``cell^2 / |nc|`` of surface wherever the facet is. Patches tile
    the facet, so each node that is lit belongs to one ray, and what a surface returns goes with the area that is lit,
    however the mesh is cut.

    Parameters
    ----------
    cell : m, distance between nodes
    a, b, c : m, of the hit point, along both axes and the one left out
    slope_a, slope_b : of the facet
    first_a, first_b : numbers of the first row and column of the patch's bounds
    rows : of the bounds, 0 in lanes without nodes
    last_column : number of columns less one
    sides : of the patch: a side crosses row r at column ``at + slope r``, and its nodes lie from there on (``lower``)
        or up to there
    area : m^2, of the facet for each node
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
        # a node stands within its cell
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
        return self._found(self._row(mi.Int32(0)))

    def after(self, node: Node, step: mi.Int32) -> Node:
        """The next node of the patch, or, in lanes with a ``step`` of 0 rather than 1, the same."""
        return self._found(replace(node, column=node.column + step))

    def _row(self, row: mi.Int32) -> Node:
        """The first node of a row."""
        number = mi.Float(row)
        low, high = mi.Float(0.0), dr.select(row < self.rows, self.last_column, -1.0)
        for at, slope, lower in self.sides:
            crossing = dr.fma(slope, number, at)
            low = dr.select(lower, dr.maximum(low, crossing), low)
            high = dr.select(lower, high, dr.minimum(high, crossing))
        # below the first there is none, whatever the bound: keeps the conversion within whole numbers
        return Node(
            row, mi.Int32(dr.ceil(dr.minimum(low, MOST_NODES))), mi.Int32(dr.floor(dr.maximum(high, -1.0)))
        )

    def _found(self, node: Node) -> Node:
        """The node itself, or the first one of the rows after it where its own has none left."""
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
        """Where a scatterer stands on the lattice."""
        a, b, _ = _lattice_axes(point, self.take_z, self.take_y)
        return SurfacePlace(a, b, _axis(self.take_z, self.take_y))

    def scatterer(self, node: Node, seed: mi.UInt32) -> tuple[mi.Vector3d, mi.UInt32]:
        """Where a node stands (float64, m) and its hash: the same whichever ray, facet, pulse or look finds it."""
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
        # layers of a few cells tell surfaces apart that lie over one another
        layer = dr.floor(cc / (self.cell * LAYER_CELLS) + 0.4142)
        u32, i32 = mi.UInt32, mi.Int32
        axis = _axis(self.take_z, self.take_y)
        size = dr.reinterpret_array(u32, mi.Float(self.cell))
        key = mix(u32(i32(ia)) * 0x9E3779B1 + seed)
        key = mix(key ^ (u32(i32(ib)) * 0x85EBCA77 + 0x27D4EB2F))
        key = mix(key ^ (u32(i32(layer)) * 0xC2B2AE3D + axis * 0x165667B1 + size * 0xD3A2646C))
        return point, key


# the lattice is turned by the angle whose tangent is the golden mean: strips along the scene's axes, however narrow,
# then hold their share of nodes; its rows stay regular, so that its spectrum has nothing below one per cell
TURN_COS, TURN_SIN = 0.8506508083520400, 0.5257311121191336
# most nodes along one axis of a patch: bounds the loop where a patch is degenerate
MOST_NODES = 64.0
# scatterers that stand for all those of a patch which a curved mirror has spread
WIDE_NODES = 16.0
# thickness of a layer, cells
LAYER_CELLS = 4.0


def cell_on(cell: mi.Float64, largest: mi.Float) -> mi.Float64:
    """The scene's cell, or on a small piece of surface the largest of ``cell / sqrt(2)^n`` up to ``largest``, m."""
    steps = dr.ceil(2.0 * dr.log2(mi.Float(cell) / dr.maximum(largest, 1e-6)) - 1e-4)
    return cell * mi.Float64(dr.exp2(-0.5 * dr.clip(steps, 0.0, 40.0)))


def thinned(cell: mi.Float64, wider: mi.Float, area: mi.Float) -> mi.Float64:
    """Edge of the cells in a patch that a curved mirror has spread: about ``WIDE_NODES`` of them serve.

    Parameters
    ----------
    cell : m, of the facet
    wider : area of the tube over one that no mirror has spread; cells grow by no more
    area : m^2, of the patch
    """
    nodes = area / mi.Float(cell * cell)
    steps = dr.ceil(dr.log2(dr.clip(dr.minimum(wider, nodes / WIDE_NODES), 1.0, 1e12)))
    return cell * mi.Float64(dr.exp2(0.5 * steps))


def _side(
    p: tuple[mi.Float, mi.Float], q: tuple[mi.Float, mi.Float], turned: mi.Float
) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Where the side from p to q, the patch to its left (``turned`` -1: to its right), crosses the lattice's rows."""
    along, rise = (q[0] - p[0]) * turned, (q[1] - p[1]) * turned
    # a side along the rows lies far to one end of each; one without length, where two corners meet, is none
    crosses, long = dr.abs(along) > 1e-9, dr.abs(along) + dr.abs(rise) > 1e-9
    inverse = dr.rcp(dr.select(crosses, along, dr.select(along >= 0.0, 1e-9, -1e-9)))
    slope = rise * inverse
    return dr.select(long, p[1] - p[0] * slope, -1e9), dr.select(long, slope, 0.0), (along >= 0.0) | ~long


def _left_out(normal: mi.Vector3d) -> tuple[mi.Bool, mi.Bool]:
    """Where the lattice leaves out z, and where y."""
    ax, ay, az = dr.abs(normal.x), dr.abs(normal.y), dr.abs(normal.z)
    # 1e-6: walls at exactly 45 degrees keep one axis whatever the rounding of their normal
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
    """Unit modulus and a hashed phase: a cell without speckle of its own."""
    k2 = mix(mix(key ^ ((0x68E31DA4 + 0x9E3779B9 * stream) & 0xFFFFFFFF)) ^ 0xB5297A4D)
    s, c = dr.sincos(mi.Float(k2 >> 8) * (TWO_PI / 16777216.0))
    return mi.Complex2f(c, s)


def unit_uniform(key: mi.UInt32, salt: int) -> mi.Float:
    """Uniform in 0 ... 1, both ends left out, from a hashed cell; ``salt`` picks independent ones."""
    return (mi.Float(mix(mix(key ^ salt)) >> 8) + 0.5) * (1.0 / 16777216.0)
