r"""Motion of the antenna within the pulse: shift and phase of an echo of range r and range rate.

The receiver's position is that at the arrival of echoes of the range :math:`R_0`; others arrive
:math:`2 (r - R_0) / c` later. An echo whose range changes during the pulse has the Doppler frequency
:math:`f_D = -2 \dot r f_c / c`, which after the matched filter is a delay of :math:`-f_D / \gamma`, since a chirp of
rate :math:`\gamma = B / T_p` shifted in frequency equals one shifted in time. The echo appears at the range e with the
phase of the range h:

.. math:: e = r + \kappa \dot r, \quad h = r + \frac{\dot r}{c} (e - R_0), \quad \kappa = \frac{f_c T_p}{B}

The phase's part :math:`\kappa \dot r^2 / c` is :math:`\pi f_D^2 / \gamma`, the chirp's at the shifted instant.

This ignores that the chirp itself is stretched by :math:`2 \dot r / c`, which leaves a quadratic phase of at most
:math:`\pi B T_p \dot r / c` at its ends; that the band is shifted by f_D; and accelerations within the pulse.

References
----------
Cumming and Wong, Digital Processing of Synthetic Aperture Radar Data (2005), section 4.2 (start-stop); Prats-Iraola et
al., "On the processing of very high resolution spaceborne SAR data", IEEE Trans. Geosci. Remote Sens. 52 (2014) 6003,
section III (stop-and-go: delay and Doppler within the chirp).
"""

from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import C64, F64, LinearMap, Samples, box_corners
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.raw_data import RawData

# samples processed at a time
_BATCH = 1 << 20


@dataclass(frozen=True, eq=False)
class InPulse:
    """Motion within some pulses.

    Parameters
    ----------
    range_per_rate : kappa, s
    reference : (n_pulses,) float64, m; slant range of the echoes for which the receiver's position holds
    """

    range_per_rate: float
    reference: F64

    @staticmethod
    def of(radar: Radar, pulses: slice) -> "InPulse | None":
        """Motion within some pulses; None in the start-stop approximation."""
        if radar.delay is None:
            return None
        return InPulse(radar.range_per_rate, 0.5 * SPEED_OF_LIGHT * radar.delay[pulses])


def carrier_range(
    slant_range: Samples, range_rate: Samples, kappa: Samples | float, reference: Samples
) -> Samples:
    """Range h (m) whose phase an echo has, see the module: of NumPy's or Dr.Jit's numbers."""
    return slant_range + range_rate * (1.0 / SPEED_OF_LIGHT) * (slant_range + kappa * range_rate - reference)


@dataclass(frozen=True, eq=False)
class BoresightPhase(LinearMap):
    r"""Phase of the antenna's motion within the pulse, taken out of every sample as of an echo at the boresight.

    Multiplication by :math:`\exp(j \frac{4 \pi}{\lambda} \frac{\dot r}{c} (e - R_0))`, see :func:`standing_still`.

    Parameters
    ----------
    radar : not in the start-stop approximation
    """

    radar: Radar

    def forward(self, values: C64) -> C64:
        """Echoes (n_layers, n_pulses, n_samples) of the start-stop approximation."""
        return self._turn(values, 1.0)

    def adjoint(self, values: C64) -> C64:
        """Echoes with the phase again."""
        return self._turn(values, -1.0)

    def _turn(self, values: C64, sign: float) -> C64:
        radar, window = self.radar, self.radar.window
        moving = InPulse.of(radar, slice(None))
        assert moving is not None
        rate = np.zeros(radar.track.n_pulses)
        for track, pointing in zip(radar.tracks, (radar.pointings * 2)[: len(radar.tracks)], strict=True):
            rate -= np.einsum("ni,ni->n", track.velocity, pointing.boresight) / len(radar.tracks)
        turn = sign * 4.0 * np.pi / radar.waveform.wavelength / SPEED_OF_LIGHT * rate
        sample = window.sample_spacing * np.arange(window.n_samples)
        data = values.copy()
        step = max(1, _BATCH // window.n_samples)
        for start in range(0, len(turn), step):
            some = slice(start, start + step)
            beyond = (window.start_range - moving.reference)[some, None] + sample
            data[:, some] *= np.exp(1j * turn[some, None] * beyond).astype(np.complex64)
        return data


def standing_still(raw: RawData) -> RawData:
    r"""Echoes corrected for the antenna's motion within the pulse (start-stop approximation), along the boresight.

    The radar is that of `Radar.start_stop`, and every sample is corrected by the phase of an echo at the boresight's
    range rate, :math:`\frac{4 \pi}{\lambda} \frac{\dot r}{c} (e - R_0)`. The residual for other directions is a shift
    along the flight of :math:`v (e - R_0) / c`, a millimetre for a radar at 100 m/s, 3 km off the aim point.

    Parameters
    ----------
    raw : range-compressed data; returned unchanged if they are in the start-stop approximation
    """
    radar = raw.radar
    if radar.delay is None or raw.domain != "compressed":
        return replace(raw, radar=radar.start_stop())
    return replace(raw, data=BoresightPhase(radar).forward(raw.data), radar=radar.start_stop())


def widest_shift(radar: Radar, box: F64, pulses: slice) -> float:
    """Largest range shift of the echoes of a box (2, 3) m, m."""
    if radar.delay is None:
        return 0.0
    return (
        abs(radar.range_per_rate)
        * 1.1
        * max(float(np.abs(radar.range_rate(p, pulses)).max()) for p in box_corners(box))
    )
