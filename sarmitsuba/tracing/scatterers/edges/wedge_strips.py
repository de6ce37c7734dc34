"""Fringe currents of the strips on both faces of a wedge, in a kernel: Michaeli's coefficients in float32."""

from __future__ import annotations

from dataclasses import dataclass

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel import field

# least sine of the angle between wave and edge, and least angle in a wedge, rad: the formulas are held there
LEAST = 1e-3
# modulus below which the series of a difference of cotangents is used
SERIES = 0.2


@dataclass(frozen=True, eq=False)
class WedgeFace:
    """Frame of one face of a wedge: unit vectors into the face across the edge, normal to it, and along the edge."""

    inward: mi.Vector3f
    normal: mi.Vector3f
    along: mi.Vector3f

    @staticmethod
    def of(inward: mi.Vector3f, normal: mi.Vector3f) -> WedgeFace:
        """Frame from two of its vectors."""
        return WedgeFace(inward, normal, dr.cross(inward, normal))


@dataclass(frozen=True, eq=False)
class FringeStrip:
    """Fringe current of a strip of one face, per metre of edge and unit field.

    Parameters
    ----------
    face : of the wedge
    outside : share in which the wave comes through the exterior: of a wedge one half where it grazes a face, and
        between 0 and 1 within ``LEAST`` of that, so that of the far edges of two opposite faces that a wave passes
        from one to the other the one fades as the other rises
    to_source : where the wave comes from
    cosine, sine : of the angle between the wave and the edge
    soft, hard, charge : D_s, D_h and mu D_h - 1 / N + U
    grazing : unit vector of the diffracted ray along the face
    lifted : across it, to the source's side of a sheet: there the observer is taken to be if it lies along that ray
    """

    face: WedgeFace
    outside: mi.Float
    to_source: mi.Vector3f
    cosine: mi.Float
    sine: mi.Float
    soft: mi.Float
    hard: mi.Float
    charge: mi.Float
    grazing: mi.Vector3f
    lifted: mi.Vector3f

    @staticmethod
    def of(face: WedgeFace, n: mi.Float, to_source: mi.Vector3f, to_observer: mi.Vector3f) -> FringeStrip:
        """Strip of a face of a wedge of exterior angle n pi for two directions, unit vectors."""
        across, off = dr.dot(to_source, face.inward), dr.dot(to_source, face.normal)
        cosine = -dr.dot(to_source, face.along)
        sine = dr.maximum(dr.sqrt(dr.square(across) + dr.square(off)), LEAST)
        phi = dr.atan2(off, across)
        # the middle of the interior separates exterior angles from angles slightly below face a
        phi = dr.select(phi < -(1.0 - 0.5 * n) * dr.pi, phi + 2.0 * dr.pi, phi)
        inside = dr.minimum(phi, n * dr.pi - phi) * float(0.5 / LEAST)
        outside = dr.select(n > 2.0 - LEAST, mi.Float(1.0), dr.clip(0.5 + inside, 0.0, 1.0))
        phi = dr.clip(phi, 0.0, n * dr.pi)
        # sin(alpha / 2): half the length of the difference of the unit vectors
        grazing = face.inward * sine + face.along * cosine
        w = 0.5 * dr.norm(to_observer - grazing) / sine
        real = _spectra(n, phi, w)
        imaginary = _evanescent(n, phi, w)
        soft, hard = (dr.select(w <= 1.0, a, b) for a, b in zip(real, imaginary, strict=True))
        lit = dr.select(phi < dr.pi, mi.Float(1.0), 0.0)
        mu = 1.0 - 2.0 * dr.square(w)
        # along that ray D_h diverges while the current component across it vanishes: the limit depends on the side
        side = dr.select((phi < dr.pi) | (n < 2.0 - LEAST), mi.Float(1.0), -1.0)
        lifted = dr.select(w < 0.5 * LEAST, face.normal * (side * LEAST * sine), mi.Vector3f(0.0))
        charge = mu * hard - dr.rcp(n) + lit
        return FringeStrip(face, outside, to_source, cosine, sine, soft, hard, charge, grazing, lifted)

    def current(
        self,
        e: field.ComplexVector,
        q: field.ComplexVector,
        electric: mi.Float,
        magnetic: mi.Complex2f | mi.Float,
    ) -> mi.Complex2f:
        """Fringe current along q for an incident field e, with factors of its components along the edge."""
        at = dr.squared_norm(self.lifted) > 0.0
        off = field.dot(q, dr.select(at, self.grazing + self.lifted, mi.Vector3f(0.0)))
        q = field.add(q, field.scale(-off, self.grazing))
        h = field.cross_left(-self.to_source, e)
        e_z, h_z = field.dot(e, self.face.along) * electric, field.dot(h, self.face.along) * magnetic
        along = (e_z * self.soft + h_z * (self.cosine * self.charge)) * dr.rcp(dr.square(self.sine))
        across = h_z * (self.hard / self.sine)
        return along * field.dot(q, self.face.along) + across * field.dot(q, self.face.inward)


def _spectra(n: mi.Float, phi: mi.Float, w: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Coefficients D_s and D_h where a is real: cos(a / 2) = w."""
    a = dr.clip(2.0 * dr.acos(dr.minimum(w, 1.0)), LEAST, dr.pi - LEAST)
    lit = phi < dr.pi
    plus, minus = _fringe(n, 0.5 * (phi + a), lit), _fringe(n, 0.5 * (phi - a), lit)
    return -0.5 * (plus + minus), 0.5 * (plus - minus) / dr.sin(a)


def _fringe(n: mi.Float, x: mi.Float, lit: mi.Bool) -> mi.Float:
    """Cotangent difference C(x); it has a pole at x = 0 where the face is not lit, and one at pi where it is."""
    x = dr.select(lit, dr.minimum(x, dr.pi - LEAST), dr.maximum(x, LEAST))
    small = lit & (dr.abs(x) < SERIES)
    safe = dr.select(small, 1.0, x)
    whole = _real_cot(safe / n) / n - dr.select(lit, _real_cot(safe), 0.0)
    first, third = _series(n)
    return dr.select(small, x * (first + third * dr.square(x)), whole)


def _real_cot(x: mi.Float) -> mi.Float:
    s, c = dr.sincos(x)
    return c / s


def _series(n: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Coefficients of x and x^3 in C(x)."""
    r2 = dr.square(dr.rcp(n))
    return (1.0 - r2) / 3.0, (1.0 - dr.square(r2)) / 45.0


def _evanescent(n: mi.Float, phi: mi.Float, w: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Coefficients D_s and D_h where a is imaginary: cosh(|a| / 2) = w; C(x) for both signs are complex conjugates."""
    w = dr.maximum(w, 1.0)
    eta = dr.maximum(2.0 * dr.log(w + dr.sqrt((w - 1.0) * (w + 1.0))), LEAST)
    lit = phi < dr.pi
    re, im = _cot(phi / n, eta / n)
    re_lit, im_lit = _cot(phi, eta)
    re = re / n - dr.select(lit, re_lit, 0.0)
    im = im / n - dr.select(lit, im_lit, 0.0)
    small = lit & (dr.square(phi) + dr.square(eta) < (2.0 * SERIES) ** 2)
    u, v = 0.5 * phi, 0.5 * eta
    first, third = _series(n)
    re = dr.select(small, u * (first + third * (dr.square(u) - 3.0 * dr.square(v))), re)
    im = dr.select(small, v * (first + third * (3.0 * dr.square(u) - dr.square(v))), im)
    return -re, im / dr.sinh(eta)


def _cot(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Real and imaginary part of cot((u + j v) / 2)."""
    bottom = 2.0 * (dr.square(dr.sinh(0.5 * v)) + dr.square(dr.sin(0.5 * u)))
    return dr.sin(u) / bottom, -dr.sinh(v) / bottom
