"""Bistatic polarimetric scattering by rough surfaces: first-order perturbation theory, and tilted facets.

Dyads are given by their values ``(hh, hv, vh, vv)``, first letter received, second incoming, between the vectors of
:class:`Planes`. Both are symmetric: exchanging the two directions transposes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel import field

if TYPE_CHECKING:
    from collections.abc import Iterator

Dyad: TypeAlias = "tuple[mi.Complex2f, mi.Complex2f, mi.Complex2f, mi.Complex2f]"


@dataclass(frozen=True, eq=False)
class Planes:
    """Incident and scattered direction at a surface, with the polarisation vectors of both planes of incidence.

    Parameters
    ----------
    n, d, s : normal facing the ray, incoming and outgoing unit directions
    h_i, v_i : perpendicular to and in the plane of incidence of ``d``
    h_s, v_s : the same of a ray along ``-s``, so that both pairs are one in backscatter
    """

    n: mi.Vector3f
    d: mi.Vector3f
    s: mi.Vector3f
    h_i: mi.Vector3f
    v_i: mi.Vector3f
    h_s: mi.Vector3f
    v_s: mi.Vector3f

    @classmethod
    def of(cls, n: mi.Vector3f, d: mi.Vector3f, s: mi.Vector3f) -> Planes:
        """Planes of incidence of the incident and the scattered direction."""
        h_i, h_s = field.incidence_basis_pair(d, s, n)
        return cls(n, d, s, h_i, dr.cross(h_i, d), h_s, dr.cross(h_s, -s))


def bragg_dyad(planes: Planes, chi: mi.Complex2f) -> tuple[Dyad, mi.Float]:
    r"""Bistatic polarisation coefficients ``cos_i cos_s alpha`` of first-order perturbation theory.

    .. math::
        D = \chi\,(A_i \cdot A_s + \varepsilon N_i N_s), \quad
        A = \frac{c}{c + q} E_h\, \hat h + \frac{c\,q}{\varepsilon c + q} E_v\, \hat t, \quad
        N = \frac{c \sin\theta}{\varepsilon c + q} E_v

    with the field of a wave from each direction at the flat boundary: ``2 A`` tangential to it and ``2 N`` normal to
    it, inside. That is the published set ``alpha_hh = (eps - 1) cos(phi) / ((c_i + q_i)(c_s + q_s))``, ... as one
    bilinear form, manifestly reciprocal, which needs no plane of incidence where a direction is along the normal.
    Source: Tsang, Kong and Ding, Scattering of Electromagnetic Waves (2000), chapter 9; Ulaby, Moore and Fung,
    volume II (1982), chapter 12.

    Returns
    -------
    dyad : values between ``planes``
    co_polar : root of hh times vv (co-polar power) of the same angles with both directions in one plane of incidence
    """
    waves = []
    for ray, h in ((planes.d, planes.h_i), (-planes.s, planes.h_s)):
        c = dr.clip(-dr.dot(ray, planes.n), 1e-6, 1.0)
        q = dr.sqrt(chi + c * c)
        q = dr.select(q.imag > 0, -q, q)  # decaying branch, as in `field.fresnel`
        tm = c / ((chi + 1.0) * c + q)
        sine = dr.sqrt(dr.maximum(1.0 - c * c, 0.0))
        waves.append((h, dr.cross(planes.n, h), c / (c + q), tm * q, tm * sine))
    (h_i, t_i, te_i, tm_i, normal_i), (h_s, t_s, te_s, tm_s, normal_s) = waves
    # chi goes to one factor and eps to the other: for a conductor each product stays within float32
    te_i, tm_i, across = te_i * chi, tm_i * chi, (normal_i * chi) * (normal_s * (chi + 1.0))
    dyad = (
        te_s * te_i * dr.dot(h_s, h_i),
        te_s * tm_i * dr.dot(h_s, t_i),
        tm_s * te_i * dr.dot(t_s, h_i),
        tm_s * tm_i * dr.dot(t_s, t_i) + across,
    )
    return dyad, dr.sqrt(dr.abs(te_s * te_i) * dr.abs(tm_s * tm_i + across))


def facet_dyad(planes: Planes, chi: mi.Complex2f) -> Dyad:
    """Fresnel coefficients of the facet that mirrors ``d`` into ``s``, relative to normal incidence.

    The facet's normal bisects ``-d`` and ``s``. Perpendicular and parallel refer to the plane of incidence of this
    facet, not of the mean surface, so that a tilt across the ray rotates the polarisation.
    """
    normal = dr.normalize(planes.s - planes.d)
    r_te, r_tm = field.fresnel(dr.maximum(dr.dot(planes.s, normal), 1e-7), chi)
    level = dr.rcp(dr.maximum(dr.abs(field.fresnel(mi.Float(1.0), chi)[0]), 1e-20))
    r_te, r_tm = r_te * level, r_tm * level
    h = field.incidence_basis(planes.d, normal)
    v_in, v_out = dr.cross(h, planes.d), dr.cross(h, planes.s)

    def values() -> Iterator[mi.Complex2f]:
        for out in (planes.h_s, planes.v_s):
            for into in (planes.h_i, planes.v_i):
                yield r_te * (dr.dot(out, h) * dr.dot(into, h)) + r_tm * (
                    dr.dot(out, v_out) * dr.dot(into, v_in)
                )

    hh, hv, vh, vv = values()
    return hh, hv, vh, vv
