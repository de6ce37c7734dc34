"""Predicted thermal noise in a focused image, from the receiver noise and a pixel's weights."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.link_budget import snr
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import (
    direction_gain,
    ground_cell_area,
    look_directions,
    pulse_ranges,
)
from sarmitsuba.signal.focusing.windows import Window, parse_window


def noise_equivalent_rcs(radar: Radar, point: ArrayLike, weights: F64, range_window: str | Window) -> float:
    r"""Noise-equivalent radar cross section of a pixel, m^2: its peak power equals the mean noise power.

    A pulse with the weight w and the antenna's two-way amplitude g counts as W = w g^2 in the image, because its echo
    has the amplitude :math:`K g / R^2` and is multiplied by :math:`w g R^2 / K`; its noise, of the same power in every
    pulse, is multiplied too:

    .. math:: \sigma_n = \frac{\beta}{\mathrm{SNR}_1}
              \frac{\sum_t (W_t R_t^2 / g_t)^2}{R_0^4 \left(\sum_t W_t\right)^2}

    with SNR_1 that of 1 m^2 at boresight, at R_0, in one pulse, and beta the range window's noise-equivalent width in
    cells. The signal-to-noise ratio of a point of RCS sigma is :math:`\sigma / \sigma_n`.

    Parameters
    ----------
    radar : whose track, antenna, waveform and noise temperature count
    point : (3,) m, scene frame
    weights : (n_pulses,) W of every pulse at that point, as `Focused.pulse_weights` gives them
    range_window : over the band

    Raises
    ------
    RadarError
        The radar has no noise temperature.
    DataError
        No pulse illuminates the point.

    Notes
    -----
    Ignores the Fresnel ripple of the pulse's spectrum (about ``1 / sqrt(B T_p)``), quantisation and ambiguities.
    """
    distance = pulse_ranges(radar, point)
    gain = direction_gain(radar, slice(None), look_directions(radar, point))
    used = weights > 0.0
    if not used.any():
        raise DataError("link: no pulse illuminates the point; move it into the beam, or lengthen the track")
    near = float(distance[used].min())
    noise = float(np.sum((weights[used] / gain[used] * (distance[used] / near) ** 2) ** 2))
    one = snr(radar, 1.0, near, 1)
    return parse_window(range_window).broadening * noise / (one * float(weights.sum()) ** 2)


def noise_equivalent_sigma0(
    radar: Radar, point: ArrayLike, weights: F64, range_window: str | Window
) -> float:
    r"""Noise-equivalent sigma0 of flat ground, linear: its mean image power equals that of the noise.

    .. math:: \sigma^0_{ne} = \sigma_n / A

    with :func:`noise_equivalent_rcs` and the impulse response's area A on the ground,
    :func:`sarmitsuba.signal.focusing.aperture_weights.ground_cell_area`; arguments, errors and what is ignored are
    theirs.
    """
    area = ground_cell_area(radar, np.asarray(point, dtype=np.float64), weights, range_window)
    return noise_equivalent_rcs(radar, point, weights, range_window) / area
