"""Radar equation: received power, signal-to-noise ratio and noise-equivalent sigma0."""

import numpy as np

from sarmitsuba.core.constants import BOLTZMANN
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.radar import Radar


def received_power(radar: Radar, rcs: float, slant_range: float) -> float:
    r"""Echo power of a point at boresight while the pulse lasts, W.

    .. math:: P_r = \frac{P_t G^2 \lambda^2 \sigma}{(4 \pi)^3 R^4 L}

    Parameters
    ----------
    rcs : m^2
    slant_range : m

    References
    ----------
    Skolnik, Introduction to Radar Systems, 3rd ed., eq. (1.7) with the gain on both legs.
    """
    return float(radar.amplitude_constant**2 * rcs / slant_range**4)


def snr(radar: Radar, rcs: float, slant_range: float, n_pulses: float = 1) -> float:
    r"""Peak signal-to-noise ratio after range compression and coherent sum of pulses, linear power.

    .. math:: \mathrm{SNR} = \frac{P_r T_p N}{k T}

    Parameters
    ----------
    rcs : m^2
    slant_range : m
    n_pulses : pulses focused into the point; 1 is the range profile

    Notes
    -----
    Ignores the loss of windows and the beam's taper over the aperture.
    """
    _need_temperature(radar)
    energy = received_power(radar, rcs, slant_range) * radar.waveform.pulse_width * n_pulses
    return float(energy / (BOLTZMANN * radar.noise_temperature))


def nesz(
    radar: Radar, slant_range: float, incidence_angle: float, azimuth_cell: float, n_pulses: float
) -> float:
    r"""Noise-equivalent sigma0 of the focused image, linear: the sigma0 whose pixels have an SNR of 1.

    .. math:: \sigma_{ne}^0 = \frac{k T}{P_r(1\,\mathrm{m}^2) \, T_p N} \cdot
              \frac{\sin\theta_i}{\delta_r \, \delta_a}

    Parameters
    ----------
    slant_range : m
    incidence_angle : from the vertical, rad
    azimuth_cell : lambda R / (2 L) for an aperture of length L, m
    n_pulses : pulses in the aperture

    Notes
    -----
    ``delta_r`` is the slant-range cell c / (2 B); sigma0 refers to ground area. Ignores azimuth ambiguities,
    windows and the beam's taper, for which see :mod:`sarmitsuba.analysis.link_budget`. A flat spectrum has the
    equivalent area of exactly one cell.
    """
    area = radar.waveform.range_cell * azimuth_cell / np.sin(incidence_angle)
    return float(1.0 / (snr(radar, 1.0, slant_range, n_pulses) * area))


def _need_temperature(radar: Radar) -> None:
    if radar.noise_temperature <= 0.0:
        raise RadarError(
            f"radar: noise_temperature = {radar.noise_temperature:g} K must be above 0 for a signal-to-noise "
            f"ratio; set noise_temperature (290 K times the receiver's noise factor)"
        )
