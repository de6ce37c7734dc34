"""Currents of a metal edge in a kernel: Michaeli's strips of a wedge, waves along a sheet, rims of thin plates.

A sheet has waves between its rims, with the electric field across it. A thin plate adds to the rim of a half plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

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


# m, width used for a sheet of unknown width
FAR = 1e6


@dataclass(frozen=True, eq=False)
class SheetWave:
    """Wave between an antenna and a rim that passes the sheet's other rim, electric field across the sheet.

    Parameters
    ----------
    lost : T - 1, T the transition factor of :func:`sarmitsuba.truth.theory.sheet_transition`; 0 for wedges. From 76 to
        104 degrees off the sheet the wave passes from one of its rims to the other
    cosine, sine : of half the angle between direction and sheet in the plane across the rim, 0 along the sheet
    """

    lost: mi.Complex2f
    cosine: mi.Float
    sine: mi.Float

    @staticmethod
    def of(
        face: WedgeFace,
        n: mi.Float,
        to: mi.Vector3f,
        wavenumber: mi.Float,
        width: Callable[[mi.Float], mi.Float],
    ) -> SheetWave:
        """Wave to or from the direction ``to``."""
        across, off = dr.dot(to, face.inward), dr.dot(to, face.normal)
        sine = dr.maximum(dr.sqrt(dr.square(across) + dr.square(off)), LEAST)
        part = dr.clip(across / sine, -1.0, 1.0)
        # the ray between the rims makes the angle of the wave with the rim
        a = width(dr.atan2(dr.dot(to, face.along), sine))
        # 1 - part without cancellation
        beside = dr.select(part > 0.0, dr.square(off / sine) / (1.0 + part), 1.0 - part)
        t = _transition(sine * dr.sqrt(wavenumber * a * beside))
        share = 0.5 + 0.5 * dr.clip(4.0 * part, -1.0, 1.0)
        sheet = (n > 2.0 - LEAST) & (share > 0.0) & (a < 0.5 * FAR)
        lost = dr.select(sheet, (t - 1.0) * share, mi.Complex2f(0.0))
        return SheetWave(lost, dr.sqrt(0.5 + 0.5 * part), dr.sqrt(0.5 * beside))

    def with_other(self, other: SheetWave) -> mi.Complex2f:
        """Factor Q of :class:`FringeCurrents` for this wave's way there, and the other's way back."""
        none = (dr.squared_norm(self.lost) == 0.0) & (dr.squared_norm(other.lost) == 0.0)
        c, d = dr.maximum(self.cosine, LEAST), dr.maximum(other.cosine, LEAST)
        fringe = 0.5 * (d / (c + other.sine) + c / (d + self.sine))
        double = self.lost * dr.rcp(d) + other.lost * dr.rcp(c) + self.lost * other.lost
        return dr.select(none, mi.Complex2f(1.0), 1.0 + double * dr.rcp(fringe))


def _transition(w: mi.Float) -> mi.Complex2f:
    """Fresnel transition function ``(2 e^(j pi / 4) / sqrt(pi)) int_0^w e^(-j t^2) dt``, error below 3e-5.

    By rational functions fitted to the auxiliary functions f and g of Abramowitz and Stegun 7.3.5 and 7.3.6, errors
    below 1.2e-5, with their limits at 0 and at infinity.
    """
    x = w * float(np.sqrt(2.0 / np.pi))
    f = (1.0 + x * (1.2494 + x * (0.4691 + x * 0.6528))) / (
        2.0 + x * (2.5016 + x * (4.0201 + x * (1.4725 + x * (0.6528 * np.pi))))
    )
    g = (1.0 + x * (0.2303 + x * 0.2777)) / (
        2.0 + x * (4.4631 + x * (6.2820 + x * (6.0061 + x * (2.9358 + x * (0.2777 * np.pi**2)))))
    )
    s, c = dr.sincos(dr.square(w))
    cosine, sine = 0.5 + f * s - g * c, 0.5 - f * c - g * s
    return mi.Complex2f(cosine + sine, cosine - sine)


# 1 less Euler's constant: of the logarithm in the displacement of a thick rim
OFFSET = 1.0 - float(np.euler_gamma)


@dataclass(frozen=True, eq=False)
class PlateRim:
    r"""Currents of the rim of a thin plate beyond those of a half plane in its middle, per metre and unit field.

    For the electric field along the edge a rim of thickness t is that of a half plane displaced outwards by

    .. math:: \delta = \frac{t}{2 \pi} \left( 1 - \gamma + \ln\frac{\lambda}{t \sin\beta} - j \frac\pi2 \right)

    with Euler's constant :math:`\gamma`, to the first order in t
    (:func:`sarmitsuba.truth.theory.thick_rim_displacement`).
    The physical-optics return of the narrow face, which is not part of a half plane, is taken off.

    Parameters
    ----------
    face : of the rim
    to : unit vectors to the source and to the observer
    shifted : factor of the displacement
    narrow : factor of physical optics on the narrow face: k t, with the phase integral across it
    """

    face: WedgeFace
    to: tuple[mi.Vector3f, mi.Vector3f]
    shifted: mi.Complex2f
    narrow: mi.Float

    @staticmethod
    def of(
        face: WedgeFace,
        thickness: mi.Float,
        wavenumber: mi.Float,
        to: tuple[mi.Vector3f, mi.Vector3f],
        sines: tuple[mi.Float, mi.Float],
    ) -> PlateRim:
        """Rim of a plate; ``sines``: of half the angles between both directions and the sheet, across the rim."""
        across = [dr.sqrt(dr.maximum(1.0 - dr.square(dr.dot(x, face.along)), LEAST**2)) for x in to]
        b = dr.sqrt(across[0] * across[1])
        t, thick = wavenumber * thickness, thickness > 0.0
        logarithm = dr.log(2.0 * dr.pi * dr.rcp(dr.select(thick, t * b, 1.0)))
        # -2 j k delta for both orders
        factor = (2.0 / dr.pi) * t * sines[0] * sines[1] / b
        shifted = mi.Complex2f(-0.5 * dr.pi * factor, -(OFFSET + logarithm) * factor)
        narrow = t * sinc(0.5 * t * dr.dot(to[0] + to[1], face.normal))
        lit = (dr.dot(to[0], face.inward) < 0.0) & (dr.dot(to[1], face.inward) < 0.0)
        return PlateRim(
            face,
            to,
            dr.select(thick, shifted, mi.Complex2f(0.0)),
            dr.select(lit, narrow, 0.0),
        )

    @property
    def reversed(self) -> PlateRim:
        """The same rim for the reversed path."""
        return replace(self, to=(self.to[1], self.to[0]))

    def current(
        self, e: field.ComplexVector, q: field.ComplexVector, electric: mi.Float, magnetic: mi.Float
    ) -> mi.Complex2f:
        """Currents along q for an incident field e and along e for q, with factors of both parts."""
        total = self.shifted * (field.dot(e, self.face.along) * field.dot(q, self.face.along)) * electric
        # j: of the phase of surfaces against that of edges
        optics = self._optics(e, q, self.to[0], electric, magnetic)
        optics += self._optics(q, e, self.to[1], electric, magnetic)
        return total + mi.Complex2f(0.0, 1.0) * optics * self.narrow

    def _optics(
        self,
        e: field.ComplexVector,
        q: field.ComplexVector,
        to: mi.Vector3f,
        electric: mi.Float,
        magnetic: mi.Float,
    ) -> mi.Complex2f:
        """Physical-optics current of the narrow face along q, its normal against the inward vector."""
        h = field.cross_left(-to, e)
        along = field.dot(h, self.face.normal) * field.dot(q, self.face.along) * electric
        across = field.dot(h, self.face.along) * field.dot(q, self.face.normal) * magnetic
        return across - along


def sinc(x: mi.Float) -> mi.Float:
    """``sin(x) / x``."""
    small = dr.abs(x) < 1e-2
    return dr.select(small, 1.0 - dr.square(x) / 6.0, dr.sin(x) / dr.select(small, 1.0, x))
