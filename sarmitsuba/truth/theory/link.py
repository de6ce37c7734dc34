"""Textbook forms of the radar equation of a synthetic aperture radar, and bounds on its pulses and antenna."""

import numpy as np
from scipy.integrate import quad

from sarmitsuba.core.constants import BOLTZMANN, SPEED_OF_LIGHT


def point_snr(
    transmit_power: float,
    gain: float,
    wavelength: float,
    rcs: float,
    slant_range: float,
    pulse_width: float,
    n_pulses: float,
    noise_temperature: float,
    losses: float = 1.0,
) -> float:
    r"""Return the signal-to-noise ratio of a point in the image, for equal pulses at boresight.

    .. math:: \mathrm{SNR} = \frac{P_t G^2 \lambda^2 \sigma}{(4 \pi)^3 R^4 L} \frac{\tau N}{k T}

    Parameters
    ----------
    transmit_power : W, peak
    gain : one-way, linear
    wavelength, slant_range : m
    rcs : m^2
    pulse_width : s
    n_pulses : in the aperture
    noise_temperature : K
    losses : linear, >= 1

    Notes
    -----
    Ignores the pattern, windows and the change of range over the aperture. Curlander and McDonough, *Synthetic
    Aperture Radar* (1991), ch. 2.
    """
    power = transmit_power * gain**2 * wavelength**2 * rcs / ((4.0 * np.pi) ** 3 * slant_range**4 * losses)
    return float(power * pulse_width * n_pulses / (BOLTZMANN * noise_temperature))


def nesz_of_cells(snr_of_1_m2: float, ground_range_resolution: float, azimuth_resolution: float) -> float:
    r"""Return the noise-equivalent sigma0, linear: a resolution cell of that sigma0 has an SNR of 1.

    .. math:: \sigma^0_{ne} = \frac{1}{\mathrm{SNR}(1\,\mathrm{m}^2) \, \delta_{gr} \, \delta_a}

    Parameters
    ----------
    snr_of_1_m2 : of :func:`point_snr`
    ground_range_resolution, azimuth_resolution : c / (2 B sin theta) and lambda R / (2 L), m

    Notes
    -----
    Has the limits of :func:`point_snr`.
    """
    return 1.0 / (snr_of_1_m2 * ground_range_resolution * azimuth_resolution)


def nesz_of_average_power(
    average_power: float,
    gain: float,
    wavelength: float,
    slant_range: float,
    ground_range_resolution: float,
    speed: float,
    noise_temperature: float,
    losses: float = 1.0,
) -> float:
    r"""Return the noise-equivalent sigma0, linear, from average power and speed: azimuth resolution drops out.

    .. math:: \sigma^0_{ne} = \frac{2 (4 \pi)^3 R^3 v k T L}{P_{av} G^2 \lambda^3 \delta_{gr}}

    The observation time :math:`T_o = \lambda R / (2 v \delta_a)` cancels the azimuth resolution.

    Parameters
    ----------
    average_power : W, peak power times duty cycle
    gain : one-way, linear
    wavelength, slant_range, ground_range_resolution : m
    speed : of the antenna, m/s
    noise_temperature : K
    losses : linear, >= 1

    Notes
    -----
    Ignores pattern and windows. Ulaby, Moore and Fung, *Microwave Remote Sensing* II (1982); Curlander and McDonough
    (1991), ch. 2.
    """
    noise = 2.0 * (4.0 * np.pi) ** 3 * slant_range**3 * speed * BOLTZMANN * noise_temperature * losses
    return float(noise / (average_power * gain**2 * wavelength**3 * ground_range_resolution))


def uniform_aperture_taper(null_sine: float, half_aperture: float) -> tuple[float, float]:
    r"""Return the losses by a uniform antenna's pattern over an aperture processed with matched weights, both >= 1.

    With the two-way amplitude :math:`g(s) = \mathrm{sinc}^2(\pi s / s_0)` and means over :math:`|s| \le s_a`

    .. math:: l_{point} = 1 / \overline{g^2}, \qquad l_{ground} = \overline{g^2} / \overline{g^4}

    the first divides the SNR of a point of N pulses at boresight, the second multiplies the NESZ.

    Parameters
    ----------
    null_sine : s_0, wavelength over length
    half_aperture : s_a, in sines

    Notes
    -----
    Ignores the change of range. Derived: matched weights g give the signal the sum of g^2, and the noise its root;
    the area of the response goes with the sum of g^4 over the square of the sum of g^2.
    """

    def mean(power: float) -> float:
        return float(
            quad(lambda s: np.sinc(s / null_sine) ** (2.0 * power), 0.0, half_aperture)[0] / half_aperture
        )

    return 1.0 / mean(2.0), mean(2.0) / mean(4.0)


def minimum_antenna_area(
    wavelength: float, slant_range: float, speed: float, incidence_angle: float
) -> float:
    r"""Return the minimum antenna area for an unambiguous swath and Doppler bandwidth of the beam, m^2.

    .. math:: A_{min} = 4 v \lambda R \tan\theta / c

    Parameters
    ----------
    wavelength, slant_range : m
    speed : m/s
    incidence_angle : theta, rad

    Notes
    -----
    Holds for a whole beam's swath at the full resolution of half the antenna's length: a smaller antenna does for less
    swath or less bandwidth (Freeman et al., IEEE TGRS 38 (1) 2000). Curlander and McDonough (1991), ch. 1.
    """
    return float(4.0 * speed * wavelength * slant_range * np.tan(incidence_angle) / SPEED_OF_LIGHT)
