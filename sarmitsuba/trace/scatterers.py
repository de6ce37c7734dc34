"""Persistent diffuse scatterers: surface-anchored cells, each with its own fixed complex Gaussian.

A hit is snapped to the centre of a square cell of a grid fixed to the scene, so that the same piece of surface
has the same complex reflectivity and the same phase centre in every pulse, whichever rays find it.
"""

from typing import Any

TWO_PI = 6.283185307179586


def mix(x: Any) -> Any:
    """One round of a 32-bit finaliser (two multiplications, three shifts): every input bit reaches every output bit."""
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


def anchor(p: Any, n: Any, group: Any, cell: Any, seed: Any, dr: Any, mi: Any) -> tuple[Any, Any, Any]:
    """Snap a hit to its cell.

    The cell is square in the two axes that span the surface best (the normal's largest component is left out), so
    that its area on the surface is ``cell^2 / |n_max|`` whatever the facet's position; the third coordinate only
    separates layers of one smooth surface.

    Parameters
    ----------
    p : hit point, float64 3-vector, m, scene frame
    n : unit normal, float64 3-vector
    group : uint32, smooth surface the face belongs to
    cell : cell edge, m
    seed : uint32

    Returns
    -------
    centre : float64 3-vector, the cell's centre projected along the left-out axis onto the tangent plane
    area : float32, the cell's area on the surface, m^2
    key : uint32 hash of the cell
    """
    i32 = dr.int32_array_t(type(p.x))
    u32 = dr.uint32_array_t(type(p.x))
    ax, ay, az = dr.abs(n.x), dr.abs(n.y), dr.abs(n.z)
    # 1e-6: walls at exactly 45 degrees keep one axis whatever the rounding of their normal
    take_z = (az >= ax - 1e-6) & (az >= ay - 1e-6)
    take_y = ~take_z & (ay >= ax - 1e-6)
    a = dr.select(take_z | take_y, p.x, p.y)
    b = dr.select(take_z, p.y, p.z)
    c = dr.select(take_z, p.z, dr.select(take_y, p.y, p.x))
    na = dr.select(take_z | take_y, n.x, n.y)
    nb = dr.select(take_z, n.y, n.z)
    nc = dr.select(take_z, n.z, dr.select(take_y, n.y, n.x))
    inverse = 1.0 / cell
    ia, ib = dr.floor(a * inverse), dr.floor(b * inverse)
    ca, cb = (ia + 0.5) * cell, (ib + 0.5) * cell
    cc = c - ((ca - a) * na + (cb - b) * nb) / nc
    # layers 64 cells apart: far enough that a tilted face rarely crosses one
    ic = dr.floor(c * (inverse / 64.0) + 0.4142)
    axis = dr.select(take_z, u32(0), dr.select(take_y, u32(1), u32(2)))
    key = mix(u32(i32(ia)) * 0x9E3779B1 + seed)
    key = mix(key ^ (u32(i32(ib)) * 0x85EBCA77 + 0x27D4EB2F))
    key = mix(key ^ (u32(i32(ic)) * 0xC2B2AE3D + axis * 0x165667B1 + group * 0xD3A2646C))
    centre = type(p)(
        dr.select(take_z | take_y, ca, cc),
        dr.select(take_z, cb, dr.select(take_y, cc, ca)),
        dr.select(take_z, cc, cb),
    )
    area = mi.Float(cell * cell / dr.abs(nc))
    return centre, area, key


def gaussian(key: Any, stream: int, dr: Any, mi: Any) -> Any:
    """Circular complex Gaussian of unit mean power from a hashed cell; ``stream`` picks independent ones."""
    k1 = mix(key ^ ((0x68E31DA4 + 0x9E3779B9 * stream) & 0xFFFFFFFF))
    k2 = mix(k1 ^ 0xB5297A4D)
    u1 = (mi.Float(k1 >> 8) + 0.5) * (1.0 / 16777216.0)
    u2 = mi.Float(k2 >> 8) * (TWO_PI / 16777216.0)
    s, c = dr.sincos(u2)
    r = dr.sqrt(-dr.log(u1))
    return mi.Complex2f(r * c, r * s)


def count_bias(rays_per_cell: Any, dr: Any) -> Any:
    """Mean square over squared mean of the number of rays that fall into a cell.

    A cell's amplitude grows with the rays that find it, so its power is too high by this factor. Fitted to
    turned lattices over level ground at 35 and 55 degrees (1 to 16 rays a cell, within 0.05 dB from 4 rays on);
    below one ray a cell the count is 0 or 1.
    """
    m = rays_per_cell
    return dr.select(m >= 1.0, 1.0 + 0.23 * dr.power(dr.maximum(m, 1.0), -1.7), 1.23 / m)


def unit_phase(key: Any, stream: int, dr: Any, mi: Any) -> Any:
    """Unit modulus and a hashed phase: a cell without texture of its own."""
    k2 = mix(mix(key ^ ((0x68E31DA4 + 0x9E3779B9 * stream) & 0xFFFFFFFF)) ^ 0xB5297A4D)
    s, c = dr.sincos(mi.Float(k2 >> 8) * (TWO_PI / 16777216.0))
    return mi.Complex2f(c, s)


__all__ = ["anchor", "count_bias", "gaussian", "mix", "unit_phase"]
