r"""Compact polarimetry: Stokes vector of the echo of a circular wave, and its decompositions.

Source: Raney, IEEE TGRS 45 (11) 2007 (hybrid polarity, m-delta); Raney, Cahill, Patterson, Bussey, JGR 117, E00H21,
2012 (m-chi).
"""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.analysis.polarimetry.multilook import averaged
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.sar_image import SarImage


@dataclass(frozen=True, eq=False)
class Stokes:
    r"""Stokes vector of the received wave.

    .. math::
        S_1 = \langle |E_H|^2 + |E_V|^2 \rangle, \; S_2 = \langle |E_H|^2 - |E_V|^2 \rangle, \;
        S_3 = 2\,\mathrm{Re} \langle E_H E_V^* \rangle, \; S_4 = -2\,\mathrm{Im} \langle E_H E_V^* \rangle

    With exp(+j w t) and equal h and v on transmit and receive, S4 is positive for a left-handed received wave, the echo
    of a right-handed wave after one bounce.

    Parameters
    ----------
    s1, s2, s3, s4 : (rows, columns) float64, in the square of the channels' unit
    sent : ``R`` or ``L``, the transmitted sense
    """

    s1: F64
    s2: F64
    s3: F64
    s4: F64
    sent: str

    @property
    def polarised(self) -> F64:
        """Degree of polarisation m, 0 to 1; NaN where the power is zero."""
        with np.errstate(divide="ignore", invalid="ignore"):
            m = np.sqrt(self.s2**2 + self.s3**2 + self.s4**2) / self.s1
        return np.asarray(np.minimum(m, 1.0))  # 1 for one look, except for rounding

    @property
    def chi(self) -> F64:
        r"""Ellipticity angle, rad: :math:`\sin 2\chi = \mp S_4 / (m S_1)`; -pi/4 for one bounce, pi/4 for two."""
        with np.errstate(divide="ignore", invalid="ignore"):
            sine = -self._sign * self.s4 / np.sqrt(self.s2**2 + self.s3**2 + self.s4**2)
        return np.asarray(0.5 * np.arcsin(np.clip(sine, -1.0, 1.0)))

    @property
    def delta(self) -> F64:
        r"""Relative phase, rad: :math:`\arctan_2(\mp S_4, S_3)`; -pi/2 for one bounce, pi/2 for two."""
        return np.asarray(np.arctan2(-self._sign * self.s4, self.s3))

    @property
    def _sign(self) -> float:
        return 1.0 if self.sent == "R" else -1.0


def stokes(
    image: SarImage, looks: tuple[int, int] = (1, 1), *, sent: str | None = None, sliding: bool = False
) -> Stokes:
    """Stokes vector of an image's channels RH and RV, or LH and LV.

    Parameters
    ----------
    image : with both channels
    looks : averaged pixels (azimuth, range)
    sent : ``R`` or ``L``; None: the sense in the image, R before L
    sliding : whether to use a window about every pixel instead of blocks

    Raises
    ------
    DataError
        The channels are missing, or ``looks`` do not fit.
    """
    senses = (sent,) if sent else ("R", "L")
    for sense in senses:
        if sense in ("R", "L") and {sense + "H", sense + "V"} <= set(image.channels):
            return stokes_of(
                image.total(sense + "H"), image.total(sense + "V"), sense, looks, sliding=sliding
            )
    raise DataError(
        f"polarimetry: the image has the channels {', '.join(image.channels)}; RH and RV (LH and LV) are needed: set "
        'polarisation to "RH,RV"'
    )


def stokes_of(
    horizontal: C64, vertical: C64, sent: str = "R", looks: tuple[int, int] = (1, 1), *, sliding: bool = False
) -> Stokes:
    """Stokes vector of two complex channels (n_azimuth, n_range), H and V received."""
    h, v = (channel.astype(np.complex128) for channel in (horizontal, vertical))
    p_h, p_v = (averaged(np.abs(x) ** 2 + 0j, looks, sliding).real for x in (h, v))
    product = averaged(h * np.conj(v), looks, sliding)
    return Stokes(p_h + p_v, p_h - p_v, 2.0 * product.real, -2.0 * product.imag, sent)


def m_chi(vector: Stokes) -> F64:
    r"""m-chi powers of even bounces, unpolarised and odd-bounce echoes (red, green, blue), (rows, columns, 3).

    .. math:: m S_1 (1 + \sin 2\chi) / 2, \quad S_1 (1 - m), \quad m S_1 (1 - \sin 2\chi) / 2
    """
    return _split(vector, np.sin(2.0 * vector.chi))


def m_delta(vector: Stokes) -> F64:
    r"""m-delta powers: as :func:`m_chi`, with :math:`\sin\delta` instead of :math:`\sin 2\chi`.

    Equal to m-chi where S2 = 0; only m-chi distinguishes dipoles, which polarise along their axis.
    """
    return _split(vector, np.sin(vector.delta))


def _split(vector: Stokes, even: F64) -> F64:
    m, lit = vector.polarised, vector.s1 > 0.0
    polarised = np.where(lit, 0.5 * m * vector.s1, 0.0)
    even = np.where(np.isfinite(even), even, 0.0)
    return np.stack(
        [polarised * (1.0 + even), np.where(lit, vector.s1 * (1.0 - m), 0.0), polarised * (1.0 - even)], -1
    )
