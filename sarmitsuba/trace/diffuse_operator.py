"""Scattering tensor of one diffuse cell: level from the material's law, texture from the cell's hash."""

from typing import Any

import numpy as np

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.trace import field, scatterers
from sarmitsuba.trace.geometry import DIFFUSE_NODES, TraceScene


class DiffuseOperator:
    """Symmetric scattering tensor of one cell between an incoming and an outgoing direction.

    Symmetric, so that exchanging antenna and mirror chain gives the transposed channel (reciprocity). The level at
    a pair of angles is the geometric mean of the law at each.
    """

    def __init__(
        self,
        scene: TraceScene,
        material: Any,
        cross_ratio: Any,
        cos_i: Any,
        cos_s: Any,
        n: Any,
        d: Any,
        s: Any,
        key: Any,
        flags: KernelFlags,
        mi: Any,
        dr: Any,
    ) -> None:
        self.flags, self.mi, self.dr = flags, mi, dr
        self.n = n
        co = scatterers.gaussian(key, 0, dr, mi) if flags.speckle else scatterers.unit_phase(key, 0, dr, mi)
        table_i = _diffuse_lookup(scene, material, cos_i, mi, dr)
        table_s = _diffuse_lookup(scene, material, cos_s, mi, dr)
        self.amp_h = dr.sqrt(table_i.x * table_s.x)
        self.amp_v = dr.sqrt(table_i.y * table_s.y)
        if flags.polarised_diffuse:
            self.h_i = field.incidence_basis(d, n, dr, mi)
            self.h_s = field.incidence_basis(-s, n, dr, mi)
            self.v_i, self.v_s = dr.cross(self.h_i, d), dr.cross(self.h_s, -s)
        if flags.depolarisation:
            # azimuthal symmetry: <|S_hv|^2> = <|S_hh - S_vv|^2> / 4 = ratio of the total co-polar power
            root = dr.sqrt(cross_ratio)
            self.co = co * dr.sqrt(dr.maximum(1.0 - cross_ratio, 0.0))
            self.difference = scatterers.gaussian(key, 1, dr, mi) * root
            self.cross = scatterers.gaussian(key, 2, dr, mi) * root
            self.t1, self.t2 = mi.coordinate_system(n)
        else:
            self.co = co

    def _bilinear(self, q: Any, x: Any) -> Any:
        """``q . D x`` for real vectors ``q`` (outgoing) and ``x`` (incoming)."""
        dr = self.dr
        if self.flags.polarised_diffuse:
            value = self.co * (
                self.amp_h * dr.dot(q, self.h_s) * dr.dot(self.h_i, x)
                + self.amp_v * dr.dot(q, self.v_s) * dr.dot(self.v_i, x)
            )
        else:
            value = self.co * (self.amp_h * dr.dot(q, x))
        if self.flags.depolarisation:
            q1, q2, x1, x2 = dr.dot(q, self.t1), dr.dot(q, self.t2), dr.dot(x, self.t1), dr.dot(x, self.t2)
            amp = dr.sqrt(self.amp_h * self.amp_v)
            value = (
                value
                + self.difference * (amp * (q1 * x1 - q2 * x2))
                + self.cross * (amp * (q1 * x2 + q2 * x1))
            )
        return value

    def between(self, q: Any, e: field.ComplexVector) -> Any:
        """``q . D E`` for a real receiving vector and a complex field."""
        j = self.mi.Complex2f(0.0, 1.0)
        return self._bilinear(q, e[0]) + j * self._bilinear(q, e[1])

    def between_fields(self, q: field.ComplexVector, e: field.ComplexVector) -> Any:
        """``Q . D E`` (no conjugate) for two complex fields, incoming and retracing."""
        j = self.mi.Complex2f(0.0, 1.0)
        return self.between(q[0], e) + j * self.between(q[1], e)


def _diffuse_lookup(scene: TraceScene, material: Any, cos_theta: Any, mi: Any, dr: Any) -> Any:
    """sqrt(sigma0) for h and v at an incidence angle, linear between table nodes uniform in angle."""
    theta = dr.acos(dr.clip(cos_theta, 0.0, 1.0)) * ((DIFFUSE_NODES - 1) / (0.5 * np.pi))
    node = dr.minimum(mi.UInt32(theta), DIFFUSE_NODES - 2)
    t = theta - mi.Float(node)
    row = material * DIFFUSE_NODES + node
    low = dr.gather(mi.Vector2f, scene.diffuse_table, row)
    high = dr.gather(mi.Vector2f, scene.diffuse_table, row + 1)
    return low + (high - low) * t


__all__ = ["DiffuseOperator"]
