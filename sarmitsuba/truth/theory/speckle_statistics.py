"""Speckle statistics and the radar equation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc
from scipy.stats import kstest

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import BOLTZMANN


def speckle_cdf(intensity: ArrayLike, mean: float, looks: float = 1.0) -> F64:
    r"""Return the probability that multi-look intensity stays below a value (gamma distribution).

    .. math:: P(I < x) = \gamma(L, L x / \bar I) / \Gamma(L); \quad 1 - e^{-x/\bar I} \text{ for } L = 1

    Notes
    -----
    Ignores texture and correlation: fully developed speckle, independent looks.

    References
    ----------
    Goodman, Speckle Phenomena in Optics (2007)
    """
    return np.asarray(
        gammainc(looks, looks * np.maximum(np.asarray(intensity, dtype=np.float64), 0.0) / mean)
    )


@dataclass(frozen=True)
class SpeckleTest:
    """Result of a Kolmogorov-Smirnov test of speckle.

    Parameters
    ----------
    statistic : largest distance between the empirical and the theoretical distribution
    p_value : probability of a distance at least as large if the theory holds
    n_samples : independent samples
    """

    statistic: float
    p_value: float
    n_samples: int

    def accepts(self, confidence: float = 0.99) -> bool:
        """Whether a test that rejects true speckle with probability 1 - confidence accepts the theory."""
        return self.p_value > 1.0 - confidence


def intensity_test(intensity: ArrayLike, mean: float | None = None, looks: float = 1.0) -> SpeckleTest:
    """Test intensities of independent pixels against fully developed speckle.

    Parameters
    ----------
    intensity : any shape, linear power, of independent pixels
    mean : known mean; None takes the sample's, which makes the test lenient (accepts more)
    looks : number of independent looks
    """
    x = np.asarray(intensity, dtype=np.float64).ravel()
    level = float(x.mean()) if mean is None else mean
    result = kstest(x, lambda value: speckle_cdf(value, level, looks))
    return SpeckleTest(float(result.statistic), float(result.pvalue), x.size)


def phase_test(values: ArrayLike) -> SpeckleTest:
    """Test the phase of complex pixels against the uniform distribution on a full turn."""
    x = np.angle(np.asarray(values)).astype(np.float64).ravel()
    result = kstest(x, lambda value: np.clip((np.asarray(value) + np.pi) / (2.0 * np.pi), 0.0, 1.0))
    return SpeckleTest(float(result.statistic), float(result.pvalue), x.size)


def equivalent_number_of_looks(intensity: ArrayLike) -> float:
    r"""Return the ENL of a homogeneous patch, :math:`\bar I^2 / \mathrm{var}(I)`."""
    x = np.asarray(intensity, dtype=np.float64)
    return float(x.mean() ** 2 / x.var())


def received_power(
    transmit_power: float, gain: float, wavelength: float, rcs: float, slant_range: float, losses: float = 1.0
) -> float:
    r"""Return the received power of a monostatic radar, W.

    .. math:: P_r = \frac{P_t G^2 \lambda^2 \sigma}{(4\pi)^3 R^4 L}

    Parameters
    ----------
    transmit_power : W
    gain : one-way, linear
    wavelength, slant_range : m
    rcs : m^2
    losses : linear, >= 1

    Notes
    -----
    Ignores the atmosphere and multipath. Skolnik, Introduction to Radar Systems, 3rd ed.
    """
    return float(
        transmit_power * gain**2 * wavelength**2 * rcs / ((4.0 * np.pi) ** 3 * slant_range**4 * losses)
    )


def single_pulse_snr(power: float, pulse_width: float, noise_temperature: float = 290.0) -> float:
    r"""Return the SNR of one matched-filtered pulse, :math:`P_r \tau / (k_B T)`, linear."""
    return power * pulse_width / (BOLTZMANN * noise_temperature)
