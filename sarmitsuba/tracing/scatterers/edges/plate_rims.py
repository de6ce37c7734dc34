"""What the thickness of a thin metal plate adds to its rim taken as that of a half plane, in a kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.scatterers.edges.wedge_strips import LEAST, WedgeFace

# 1 less Euler's constant: of the logarithm in the displacement of a thick rim
OFFSET = 1.0 - float(np.euler_gamma)


@dataclass(frozen=True, eq=False)
class PlateRim:
    r"""Currents of the rim of a thin plate beyond those of a half plane in its middle, per metre and unit field.

    For the electric field along the edge a rim of thickness t is that of a half plane displaced outwards by

    .. math:: \delta = \frac{t}{2 \pi} \left( 1 - \gamma + \ln\frac{\lambda}{t \sin\beta} - j \frac\pi2 \right)

    with Euler's constant :math:`\gamma`, to the first order in t
    (:func:`sarmitsuba.truth.theory.thick_rim_displacement`).
    What physical optics gives the narrow face, which is not part of a half plane, is taken off.

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
