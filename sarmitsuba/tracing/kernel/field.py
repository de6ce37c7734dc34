"""The polarised field along a ray: a complex 3-vector in the scene frame, Fresnel reflection and PO currents.

A complex vector is the pair ``(re, im)`` of real 3-vectors. All functions are pure functions of Dr.Jit arrays.
Time convention exp(+j w t): a lossy medium has ``eps = eps' - j eps''``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.polarisation import TRANSMITTED, linear_parts

ComplexVector: TypeAlias = "tuple[mi.Vector3f, mi.Vector3f]"


def scale(z: mi.Complex2f, v: mi.Vector3f) -> ComplexVector:
    """Complex scalar times real vector."""
    return (v * z.real, v * z.imag)


def add(x: ComplexVector, y: ComplexVector) -> ComplexVector:
    """Sum of two complex vectors."""
    return (x[0] + y[0], x[1] + y[1])


def dot(x: ComplexVector, v: mi.Vector3f) -> mi.Complex2f:
    """Complex vector dotted (no conjugate) with a real one."""
    return mi.Complex2f(dr.dot(x[0], v), dr.dot(x[1], v))


def cross_left(v: mi.Vector3f, x: ComplexVector) -> ComplexVector:
    """Real vector cross complex vector, ``v x x``."""
    return (dr.cross(v, x[0]), dr.cross(v, x[1]))


def polarisation_basis(u: mi.Vector3f, up: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Horizontal and vertical unit vectors of the antenna for the look direction ``u`` (antenna to scene).

    ``h = u x up / |u x up|``, ``v = h x u``: backscatter alignment, the same pair on transmit and receive. For a ray
    exactly along ``up``, where both are undefined, another axis replaces ``up``.
    """
    spare = dr.normalize(dr.cross(u, type(u)(up.z, up.x, up.y)))
    h = _unit_or(dr.cross(u, up), spare)
    return h, dr.cross(h, u)


def transmit_field(letter: str, h: mi.Vector3f, v: mi.Vector3f, amplitude: mi.Float) -> ComplexVector:
    """Transmitted field in a polarisation of :data:`sarmitsuba.radar.polarisation.TRANSMITTED`."""
    if letter in "HV":
        return ((h if letter == "H" else v) * amplitude, dr.zeros(mi.Vector3f))
    z_h, z_v = TRANSMITTED[letter]
    return (h * z_h.real + v * z_v.real) * amplitude, (h * z_h.imag + v * z_v.imag) * amplitude


def pick_recorded(
    closed: Sequence[str], values: Sequence[mi.Complex2f], channels: Sequence[str]
) -> list[mi.Complex2f]:
    """Values of the recorded channels, from those of the channels that are computed (`KernelFlags.closed`)."""
    known = dict(zip(closed, values, strict=True))
    return [known[c] if c in known else _sum_of(known, c) for c in channels]


def _sum_of(known: Mapping[str, mi.Complex2f], channel: str) -> mi.Complex2f:
    parts = [known[part] * mi.Complex2f(factor) for factor, part in linear_parts(channel)]
    return sum(parts[1:], parts[0])


def incidence_basis(d: mi.Vector3f, n: mi.Vector3f) -> mi.Vector3f:
    """Unit vector perpendicular to the plane of incidence of direction ``d`` on normal ``n``.

    At normal incidence there is no such plane; any direction across ``d`` serves, because there
    ``r_te = -r_tm`` and the reflected field does not depend on it.
    """
    return _unit_or(dr.cross(d, n), mi.coordinate_system(d)[0])


def incidence_basis_pair(d: mi.Vector3f, s: mi.Vector3f, n: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Unit vectors perpendicular to the planes of incidence of an incident ray ``d`` and a scattered ray ``s``.

    ``h_s`` belongs to the ray ``-s`` so that both coincide in backscatter. If only one ray is along the normal it takes
    the plane of the other, so that no arbitrary rotation enters between them.
    """
    c_i, c_s = dr.cross(d, n), dr.cross(n, s)
    spare = mi.coordinate_system(n)[0]
    return _unit_or(c_i, _unit_or(c_s, spare)), _unit_or(c_s, _unit_or(c_i, spare))


def _unit_or(c: mi.Vector3f, spare: mi.Vector3f) -> mi.Vector3f:
    length2 = dr.squared_norm(c)
    return dr.select(length2 > 1e-12, c * dr.rsqrt(dr.maximum(length2, 1e-12)), spare)


def fresnel(cos_theta: mi.Float, chi: mi.Complex2f) -> tuple[mi.Complex2f, mi.Complex2f]:
    r"""Fresnel coefficients of a half space of relative permittivity ``1 + chi``.

    .. math::
        r_{TE} = \frac{-\chi}{(c + q)^2}, \quad
        r_{TM} = \frac{\chi ((\epsilon + 1) c^2 - 1)}{(\epsilon c + q)^2}, \quad q = \sqrt{\chi + c^2}

    The usual quotients, rearranged without differences of nearly equal numbers: exactly zero for ``eps = 1`` and at the
    Brewster angle, accurate at grazing and for nearly perfect conductors. A perfect conductor is the limit -1, +1.

    Parameters
    ----------
    cos_theta : float32 array, cosine of the incidence angle, > 0
    chi : complex float32 array, ``eps - 1``

    Notes
    -----
    Ignores magnetic materials and slabs of finite thickness.
    """
    c = cos_theta
    q = dr.sqrt(chi + c * c)
    q = dr.select(q.imag > 0, -q, q)  # decaying branch for exp(+j w t): Im q <= 0
    eps = chi + 1.0
    s_te = q + c
    s_tm = eps * c + q
    r_te = -chi / s_te / s_te
    r_tm = chi / s_tm * (((eps + 1.0) * (c * c) - 1.0) / s_tm)
    return r_te, r_tm


def reflect_field(
    e: ComplexVector,
    d: mi.Vector3f,
    d_out: mi.Vector3f,
    h: mi.Vector3f,
    r_te: mi.Complex2f,
    r_tm: mi.Complex2f,
) -> ComplexVector:
    """Field after reflection: perpendicular part times ``r_te``, parallel part times ``r_tm`` along ``d_out``."""
    v_in = dr.cross(h, d)
    v_out = dr.cross(h, d_out)
    e_h = dot(e, h) * r_te
    e_v = dot(e, v_in) * r_tm
    return add(scale(e_h, h), scale(e_v, v_out))


def reflect_field_pec(e: ComplexVector, n: mi.Vector3f) -> ComplexVector:
    """Field reflected by a perfect conductor: ``-E + 2 (E . n) n``."""
    return (-e[0] + n * (2.0 * dr.dot(e[0], n)), -e[1] + n * (2.0 * dr.dot(e[1], n)))


def po_current_pec(e: ComplexVector, d: mi.Vector3f, n: mi.Vector3f) -> ComplexVector:
    """Physical-optics radiation vector ``n x (d x E)`` of a perfect conductor (half of eta J)."""
    return cross_left(n, cross_left(d, e))


def po_receive(
    e: ComplexVector,
    e_out: ComplexVector,
    d: mi.Vector3f,
    d_out: mi.Vector3f,
    n: mi.Vector3f,
    s: mi.Vector3f,
    q: mi.Vector3f,
) -> mi.Complex2f:
    r"""Physical-optics radiation vector of a dielectric surface, component along ``q`` (transverse to ``s``).

    .. math::
        C = \tfrac12 [\eta J + M \times s], \quad \eta J = n \times (d \times E_i + d' \times E_r),
        \quad M = (E_i + E_r) \times n

    the far field of both equivalent currents (Balanis, Advanced Engineering Electromagnetics, 6-122); for a
    perfect conductor it becomes ``n x (d x E)``.

    Parameters
    ----------
    e, e_out : incident and reflected field at the surface
    d, d_out : their directions
    n, s, q : normal facing the ray, direction to the antenna, receiving polarisation
    """
    j = cross_left(n, add(cross_left(d, e), cross_left(d_out, e_out)))
    m = cross_left(n, add(e, e_out))  # = -M
    sq = dr.cross(s, q)  # (M x s) . q = M . (s x q)
    return (dot(j, q) - dot(m, sq)) * 0.5
