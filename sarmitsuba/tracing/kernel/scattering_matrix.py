"""Scattering matrix of one diffuse cell: mean power from the material's law, random factors from the cell's hash.

Polarisation is that of first-order perturbation theory, or of tilted facets. Dyads are given by their values ``(hh,
hv, vh, vv)``, first letter received, second incoming, between the vectors of :class:`Planes`. Both are symmetric:
exchanging the two directions transposes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.scene_tables import (
    DIFFUSE_NODES,
    FORM_SHIFT,
    FORMS,
    MATERIAL_MASK,
    SPECTRUM_COSINES,
    SPECTRUM_SINES,
    TraceScene,
)
from sarmitsuba.tracing.kernel.speckle import gaussian, unit_phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.tracing.kernel.table_rows import MaterialRow
    from sarmitsuba.tracing.kernel.temporal import Age


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


# random number of a scatterer from its hash and the number of an independent stream
Drawn: TypeAlias = "Callable[[mi.UInt32, int], mi.Complex2f]"


class Struck(Protocol):
    """Illuminated point of a surface; see :class:`sarmitsuba.tracing.kernel.state.Hit`."""

    @property
    def material(self) -> mi.UInt32:
        """Bits of the face's material."""

    @property
    def normal(self) -> mi.Vector3f:
        """Unit normal facing the wave."""

    @property
    def direction(self) -> mi.Vector3f:
        """Unit direction of the incident wave."""

    @property
    def properties(self) -> MaterialRow:
        """Row of the scene's material table."""


class ScatteringMatrix:
    """Symmetric scattering tensor of a diffuse cell between two directions, without its random (speckle) factors.

    Polarisations refer to the two planes of incidence, as on a slightly rough plane. The tensor is symmetric, so that
    exchanging antenna and mirror chain gives the transposed channel (reciprocity). The bistatic form of a law is in
    :class:`sarmitsuba.scene.materials.diffuse_law.DiffuseLaw`; in backscatter every law equals its table, so that the
    level does not depend on the number of traced bounces.
    The tensor is a sum of up to three fixed ones, each times a random number of the cell
    (:func:`speckle_coefficients`).

    Parameters
    ----------
    hit : gives the material, the normal facing the ray and its direction
    s : outgoing unit direction
    backscatter : lanes in which both directions are opposite; None: all
    """

    def __init__(
        self, scene: TraceScene, hit: Struck, s: mi.Vector3f, flags: KernelFlags, backscatter: mi.Bool | None
    ) -> None:
        self.flags = flags
        n, d = hit.normal, hit.direction
        material, form = hit.material & MATERIAL_MASK, hit.material >> FORM_SHIFT
        cos_i, cos_s = -dr.dot(d, n), dr.dot(s, n)
        lanes = {}  # of each bistatic form in the scene, without backscatter
        if backscatter is not None:
            lanes = {name: (form == FORMS.index(name)) & ~backscatter for name in scene.forms}
        if "facets" in lanes:
            half = dr.dot(dr.normalize(s - d), n)
            cos_i, cos_s = (dr.select(lanes["facets"], half, c) for c in (cos_i, cos_s))
        table_i = diffuse_lookup(scene.diffuse_table, material, cos_i)
        # without mirrors every diffuse return is backscatter: both angles are equal
        table_s = table_i if backscatter is None else diffuse_lookup(scene.diffuse_table, material, cos_s)
        self.amp_h = dr.sqrt(table_i.x * table_s.x)
        self.amp_v = dr.sqrt(table_i.y * table_s.y)
        if scene.water is not None:
            theta = dr.acos(dr.clip(0.5 * (cos_i + cos_s), 0.0, 1.0))
            level = scene.water.level(material, theta, s - d)
            self.amp_h, self.amp_v = self.amp_h * level.x, self.amp_v * level.y
        self.amp_cross = dr.sqrt(self.amp_h * self.amp_v)
        self.dyad: Dyad | None = None
        self.planes: Planes | None = None
        if flags.polarised_diffuse or flags.multi_bounce or flags.depolarisation:
            self.planes = Planes.of(n, d, s)
        if not lanes or self.planes is None:
            return
        none = mi.Complex2f(0.0)
        self.dyad = (mi.Complex2f(self.amp_h), none, none, mi.Complex2f(self.amp_v))
        chi = hit.properties.susceptibility
        if "facets" in lanes:
            self.dyad = _choose_dyad(lanes["facets"], facet_dyad(self.planes, chi), self.amp_h, self.dyad)
        if "spectrum" in lanes:
            waves = lanes["spectrum"]
            dyad, co_polar = bragg_dyad(self.planes, chi)
            level = _spectrum_lookup(scene, material, s - d, n)
            if scene.correction_table is not None:
                toward = dr.square(dr.maximum(-dr.dot(s, d), 0.0))
                c_i, c_s = (
                    1.0 + (diffuse_lookup(scene.correction_table, material, c) - 1.0) * toward
                    for c in (cos_i, cos_s)
                )
                hh, hv, vh, vv = dyad
                dyad = (hh * c_s.x * c_i.x, hv * c_s.x * c_i.y, vh * c_s.y * c_i.x, vv * c_s.y * c_i.y)
                co_polar *= dr.sqrt(c_s.x * c_i.x * c_s.y * c_i.y)
            self.dyad = _choose_dyad(waves, dyad, level, self.dyad)
            self.amp_cross = dr.select(waves, level * co_polar, self.amp_cross)

    def between(self, q: mi.Vector3f, e: field.ComplexVector) -> list[mi.Complex2f]:
        """Fixed tensors ``q . D_k E`` between a real receiving vector and a complex incident field."""
        planes = self.planes
        if planes is None:
            return [field.dot(e, q) * self.amp_h]
        qh, qv, eh, ev = (
            dr.dot(q, planes.h_s),
            dr.dot(q, planes.v_s),
            field.dot(e, planes.h_i),
            field.dot(e, planes.v_i),
        )
        if self.dyad is None:
            values = [eh * (self.amp_h * qh) + ev * (self.amp_v * qv)]
        else:
            hh, hv, vh, vv = self.dyad
            values = [(hh * eh + hv * ev) * qh + (vh * eh + vv * ev) * qv]
        if self.flags.depolarisation:
            values += [(eh * qh - ev * qv) * self.amp_cross, (ev * qh + eh * qv) * self.amp_cross]
        return values

    def between_fields(self, q: field.ComplexVector, e: field.ComplexVector) -> list[mi.Complex2f]:
        """Fixed tensors ``Q . D_k E`` (no conjugate) between two complex fields, incident and reciprocal."""
        j = mi.Complex2f(0.0, 1.0)
        return [a + j * b for a, b in zip(*(self.between(part, e) for part in q), strict=True)]


def _choose_dyad(lanes: mi.Bool, dyad: Dyad, level: mi.Float, other: Dyad) -> Dyad:
    hh, hv, vh, vv = (dr.select(lanes, a * level, b) for a, b in zip(dyad, other, strict=True))
    return hh, hv, vh, vv


def speckle_coefficients(
    key: mi.UInt32,
    cross_ratio: mi.Float,
    flags: KernelFlags,
    age: Age | None,
    term: mi.UInt32 | None = None,
) -> list[mi.Complex2f]:
    """Random factors of a cell, one for each fixed tensor of :class:`ScatteringMatrix`; mean total power one.

    Co-polar; then, with depolarisation, difference and cross terms of azimuthal symmetry
    (``<|S_hv|^2> = <|S_hh - S_vv|^2> / 4``), S_hh and S_vv keeping the law's power. ``age``: change of the
    cell since the first pass; None where nothing changes. ``term``: see
    :class:`sarmitsuba.tracing.kernel.state.KernelSettings`.
    """
    normal: Drawn = gaussian if age is None else age.gaussian
    modulus_one: Drawn = unit_phase if age is None else age.unit_phase
    if term is not None:
        normal = modulus_one = one_term(term)
    co = normal(key, 0) if flags.speckle else modulus_one(key, 0)
    if not flags.depolarisation:
        return [co]
    root = dr.sqrt(cross_ratio)
    return [
        co * dr.sqrt(dr.maximum(1.0 - cross_ratio, 0.0)),
        normal(key, 1) * root,
        normal(key, 2) * root,
    ]


def one_term(term: mi.UInt32) -> Drawn:
    """Function like :func:`.speckle.gaussian` that is one for one stream, and zero for the others."""

    def number(key: mi.UInt32, stream: int) -> mi.Complex2f:
        return mi.Complex2f(dr.select(term == stream, mi.Float(1.0), 0.0))

    return number


def diffuse_lookup(table: mi.Float, material: mi.UInt32, cos_theta: mi.Float) -> mi.Vector2f:
    """Values for h and v at an incidence angle, linear between table nodes uniform in angle."""
    theta = dr.acos(dr.clip(cos_theta, 0.0, 1.0)) * ((DIFFUSE_NODES - 1) / (0.5 * np.pi))
    node = dr.minimum(mi.UInt32(theta), DIFFUSE_NODES - 2)
    t = theta - mi.Float(node)
    row = material * DIFFUSE_NODES + node
    low, high = (dr.gather(mi.Vector2f, table, row + i) for i in (0, 1))
    return low + (high - low) * t


def _spectrum_lookup(scene: TraceScene, material: mi.UInt32, change: mi.Vector3f, n: mi.Vector3f) -> mi.Float:
    """Amplitude of a height spectrum, bilinear, for a change ``s - d`` of direction."""
    along = dr.dot(change, n)
    # 0.5 |change| in the plane is the sine; its root is uniform in the table
    x = dr.sqrt(dr.clip(0.5 * dr.norm(change - n * along), 0.0, 1.0)) * (SPECTRUM_SINES - 1)
    y = dr.clip(0.5 * along, 0.0, 1.0) * (SPECTRUM_COSINES - 1)
    column, row = (
        dr.minimum(mi.UInt32(v), size - 2) for v, size in ((x, SPECTRUM_SINES), (y, SPECTRUM_COSINES))
    )
    first = (material * SPECTRUM_COSINES + row) * SPECTRUM_SINES + column
    t = x - mi.Float(column)
    low, high = (
        dr.lerp(*(dr.gather(mi.Float, scene.spectrum_table, first + step + i) for i in (0, 1)), t)
        for step in (0, SPECTRUM_SINES)
    )
    return dr.lerp(low, high, y - mi.Float(row))
