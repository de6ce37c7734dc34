"""Echo with antenna motion during the pulse: exact form, and errors of the start-stop approximation."""

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT


def moving_echo(
    position: F64,
    velocity: F64,
    point: F64,
    delays: F64,
    *,
    center_frequency: float,
    bandwidth: float,
    pulse_width: float,
    n_samples: int = 16384,
) -> C128:
    r"""Compressed echo of a point at given delays, (n,) complex128; 1 at the peak for an antenna at rest.

    The delay D of the echo received at the time t solves

    .. math:: c D = |\mathbf p - \mathbf x(t)| + |\mathbf p - \mathbf x(t - D)|

    the received chirp is :math:`e^{j \pi \gamma (t - D)^2} e^{-j 2 \pi f_c D}`, and it is correlated with the chirp
    that was sent, sample by sample.

    Parameters
    ----------
    position, velocity : (3,) m and m/s, of the antenna when the middle of the pulse is sent
    point : (3,) m
    delays : (n,) s, from the middle of the pulse
    center_frequency, bandwidth : Hz
    pulse_width : s
    n_samples : of the received pulse
    """
    rate = bandwidth / pulse_width
    middle = 2.0 * float(np.linalg.norm(point - position)) / SPEED_OF_LIGHT
    t = middle + ((np.arange(n_samples) + 0.5) / n_samples - 0.5) * 1.2 * pulse_width

    def distance(time: F64) -> F64:
        return np.asarray(np.linalg.norm(point - position - time[:, None] * velocity, axis=1))

    back = distance(t)
    delay = 2.0 * back / SPEED_OF_LIGHT
    for _ in range(6):  # each step is better by the speed over that of light
        delay = (back + distance(t - delay)) / SPEED_OF_LIGHT
    sent = t - delay
    lit = np.abs(sent) <= 0.5 * pulse_width
    received = lit * np.exp(1j * np.pi * rate * sent**2 - 2j * np.pi * center_frequency * delay)
    out = np.empty(delays.shape, dtype=np.complex128)
    for i, shift in enumerate(delays):
        u = t - shift
        replica = (np.abs(u) <= 0.5 * pulse_width) * np.exp(-1j * np.pi * rate * u**2)
        out[i] = np.sum(received * replica)
    return np.asarray(out * (t[1] - t[0]) / pulse_width)


def chirp_range_shift(
    range_rate: float, center_frequency: float, bandwidth: float, pulse_width: float
) -> float:
    r"""Range displacement by range-Doppler coupling, m: :math:`-\frac{c}{2} f_D / \gamma = \dot R f_c T_p / B`.

    References
    ----------
    Cumming and Wong, Digital Processing of Synthetic Aperture Radar Data (2005), section 4.2; Stove, "Linear FMCW
    radar techniques", IEE Proc. F 139 (1992) 343, for continuous waves.
    """
    return range_rate * center_frequency * pulse_width / bandwidth


def start_stop_azimuth_shift(speed: float, slant_range: float) -> float:
    """Along-track displacement of an image by the stop-and-go approximation with positions at transmission, m.

    The way v 2 R / c until reception, half of it: the antenna is halfway on average.
    """
    return -speed * slant_range / SPEED_OF_LIGHT
