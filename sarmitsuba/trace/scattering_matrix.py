"""Scattering matrix of one diffuse cell: level from the material's law, speckle coefficients from the cell's hash."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace import field
from sarmitsuba.trace.geometry import DIFFUSE_NODES, HALF_VECTOR_BIT, MATERIAL_MASK, TraceScene
from sarmitsuba.trace.speckle import gaussian, unit_phase

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags


class ScatteringMatrix:
    """Symmetric scattering tensor of a diffuse cell between an incoming and an outgoing direction, less its speckle.

    Polarisations are taken in the two planes of incidence, as on a slightly rough plane. Symmetric, so that
    exchanging antenna and mirror chain gives the transposed channel (reciprocity). The level at a pair of angles is
    the geometric mean of the law at each or, for laws of tilted facets, the law at the angle of the half vector.
    The tensor is a sum of up to three fixed ones, each times a random number of the cell
    (:func:`speckle_coefficients`).

    Parameters
    ----------
    info : uint32, material in the low 31 bits, bit 31 set for laws of tilted facets
    n, d, s : normal facing the ray, incoming and outgoing unit directions
    """

    def __init__(
        self,
        scene: TraceScene,
        info: mi.UInt32,
        n: mi.Vector3f,
        d: mi.Vector3f,
        s: mi.Vector3f,
        flags: KernelFlags,
    ) -> None:
        self.flags = flags
        material = info & MATERIAL_MASK
        cos_i, cos_s = -dr.dot(d, n), dr.dot(s, n)
        if flags.multi_bounce:
            half = dr.dot(dr.normalize(s - d), n)
            facets = (info >> HALF_VECTOR_BIT) == 1
            cos_i, cos_s = dr.select(facets, half, cos_i), dr.select(facets, half, cos_s)
        table_i = _diffuse_lookup(scene, material, cos_i)
        # without mirrors every diffuse return is backscatter: both directions have the same angle
        table_s = _diffuse_lookup(scene, material, cos_s) if flags.multi_bounce else table_i
        self.amp_h = dr.sqrt(table_i.x * table_s.x)
        self.amp_v = dr.sqrt(table_i.y * table_s.y)
        self.in_planes = flags.polarised_diffuse or flags.multi_bounce or flags.depolarisation
        if self.in_planes:
            self.h_i, self.h_s = field.incidence_basis_pair(d, s, n)
            self.v_i, self.v_s = dr.cross(self.h_i, d), dr.cross(self.h_s, -s)

    def _bilinear(self, q: mi.Vector3f, x: mi.Vector3f) -> list[mi.Float]:
        """``q . D_k x`` of the fixed tensors for real vectors ``q`` (outgoing) and ``x`` (incoming)."""
        if not self.in_planes:
            return [self.amp_h * dr.dot(q, x)]
        pairs = ((q, self.h_s), (q, self.v_s), (x, self.h_i), (x, self.v_i))
        qh, qv, xh, xv = (dr.dot(a, b) for a, b in pairs)
        values = [self.amp_h * qh * xh + self.amp_v * qv * xv]
        if self.flags.depolarisation:
            amp = dr.sqrt(self.amp_h * self.amp_v)
            values += [amp * (qh * xh - qv * xv), amp * (qh * xv + qv * xh)]
        return values

    def between(self, q: mi.Vector3f, e: field.ComplexVector) -> list[mi.Complex2f]:
        """``q . D_k E`` for a real receiving vector and a complex field."""
        return [mi.Complex2f(re, im) for re, im in zip(*(self._bilinear(q, part) for part in e), strict=True)]

    def between_fields(self, q: field.ComplexVector, e: field.ComplexVector) -> list[mi.Complex2f]:
        """``Q . D_k E`` (no conjugate) for two complex fields, incoming and retracing."""
        j = mi.Complex2f(0.0, 1.0)
        return [a + j * b for a, b in zip(*(self.between(part, e) for part in q), strict=True)]


def speckle_coefficients(key: mi.UInt32, cross_ratio: mi.Float, flags: KernelFlags) -> list[mi.Complex2f]:
    """Random numbers of a cell, one for each fixed tensor of :class:`ScatteringMatrix`; mean total power one.

    Co-polar; then, with depolarisation, difference and cross terms of azimuthal symmetry
    (``<|S_hv|^2> = <|S_hh - S_vv|^2> / 4``), S_hh and S_vv keeping the law's power.
    """
    co = gaussian(key, 0) if flags.speckle else unit_phase(key, 0)
    if not flags.depolarisation:
        return [co]
    root = dr.sqrt(cross_ratio)
    return [
        co * dr.sqrt(dr.maximum(1.0 - cross_ratio, 0.0)),
        gaussian(key, 1) * root,
        gaussian(key, 2) * root,
    ]


def _diffuse_lookup(scene: TraceScene, material: mi.UInt32, cos_theta: mi.Float) -> mi.Vector2f:
    """sqrt(sigma0) for h and v at an incidence angle, linear between table nodes uniform in angle."""
    theta = dr.acos(dr.clip(cos_theta, 0.0, 1.0)) * ((DIFFUSE_NODES - 1) / (0.5 * np.pi))
    node = dr.minimum(mi.UInt32(theta), DIFFUSE_NODES - 2)
    t = theta - mi.Float(node)
    row = material * DIFFUSE_NODES + node
    low = dr.gather(mi.Vector2f, scene.diffuse_table, row)
    high = dr.gather(mi.Vector2f, scene.diffuse_table, row + 1)
    return low + (high - low) * t


__all__ = ["ScatteringMatrix", "speckle_coefficients"]
