"""Waves along a metal sheet between its rims, in a kernel: diffraction by two rims, electric field across the sheet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.scatterers.edges.wedge_strips import LEAST, WedgeFace

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
