"""Losses of a radar's receive chain and its interference, as closed forms for the link budget."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.constants import BOLTZMANN, SPEED_OF_LIGHT
from sarmitsuba.core.units import power_from_db
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.receive_chain import ReceiveChain
from sarmitsuba.signal.focusing.aperture_weights import direction_gain, incidence_angle
from sarmitsuba.signal.focusing.range_compression import RangeCompression
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.interference import interference_temperature
from sarmitsuba.signal.quantiser import (
    FDBAQ_BITS,
    Quantiser,
    clipping_distortion,
    lloyd_max_quantiser,
    uniform_quantiser,
)
from sarmitsuba.signal.receive import echo_delay


@dataclass(frozen=True)
class ReceiverBudget:
    """Losses of the receive chain on Gaussian echoes, at the middle of the swath.

    Parameters
    ----------
    echo_temperature : K, noise of the power of the ground's echoes in the band
    interference_temperature : K, as noise of the mean power of all emitters in one channel
    added_temperature : K, quantisation and clipping noise and the demodulator's mirrored echoes, before the losses
    gain : of the level of echoes in the image, power; 1: as without a chain
    quantisation_ratio : power of raw data over that of the error by clipping and quantisation; infinite: none
    pulse_loss : of the signal-to-noise ratio by lost pulses, phase noise and gain, power of at least 1
    phase_noise : rad, rms within the aperture
    added_islr : energy of side lobes that lost pulses, phase noise and gain add, over that of the peak
    filter_loss : of the signal-to-noise ratio by the filter of range compression, power
    bits : of block-adaptive quantisation, for I and for Q; 0: none
    """

    echo_temperature: float
    interference_temperature: float
    added_temperature: float
    gain: float
    quantisation_ratio: float
    pulse_loss: float
    phase_noise: float
    added_islr: float
    filter_loss: float
    bits: int

    def raise_noise(self, temperature: float) -> float:
        """Factor of NESZ, and of noise over a point's echo, over that of an ideal receiver of this temperature, K."""
        noise = temperature + self.interference_temperature + self.added_temperature
        return noise / temperature * self.pulse_loss * self.filter_loss if temperature > 0.0 else float("nan")


def receiver_budget(radar: Radar, grid: ImageGrid, sigma0: float, aperture_time: float) -> ReceiverBudget:
    r"""Losses of a radar's receive chain.

    Quantisers and clipping turn a Gaussian x into :math:`\alpha x` and noise that is uncorrelated with it (Bussgang),
    white over the sampling rate f_s, of which the band holds :math:`B / f_s`. With lost pulses of share p, phase
    noise of variance :math:`\sigma^2` and gains g

    .. math:: L = \frac{e^{\sigma^2}}{1 - p} \frac{\langle g^2 \rangle}{\langle g \rangle^2}, \qquad
              \mathrm{ISLR}_{added} = L - 1

    Parameters
    ----------
    radar : with chain, emitters, or none
    grid : of the image, whose ground returns the echoes
    sigma0 : of that ground, linear
    aperture_time : s, of a pixel; slower phase noise shifts the image

    Notes
    -----
    Ignores the weaker ends of records, offsets of I and Q, and gaps while other pulses are sent.
    """
    chain = radar.chain or ReceiveChain()
    wave, fs = radar.waveform, radar.window.sampling_rate
    echoes = echo_power(radar, grid, sigma0)
    thermal = BOLTZMANN * radar.noise_temperature * wave.bandwidth
    interference = BOLTZMANN * interference_temperature(radar) * wave.bandwidth
    power = echoes + thermal + interference
    bits = _coded_bits(chain, power, thermal)
    # amplitude of the signal, its white noise and its mirrored echoes after every stage, over the input
    k1, k2 = (abs(k) ** 2 for k in chain.quadrature)
    level, white, mirrored = k1, 0.0, k2
    kept, received = 1.0, k1 + k2
    for alpha, noise in _stages(chain, bits):
        kept *= alpha
        total = level + white + mirrored
        level, white, mirrored = alpha**2 * level, alpha**2 * white + noise * total, alpha**2 * mirrored
    added = (white * wave.bandwidth / fs + mirrored) / level * power
    share = chain.dead_pulses
    variance = chain.phase_variance(1.0 / max(aperture_time, 1e-9), echo_delay(radar), wave.pulse_width)
    mean, square = _gain_moments(chain)
    loss = float(np.exp(variance) / (1.0 - share) * square / mean**2)
    peak = np.exp(-variance) * (1.0 - share) ** 2 * mean**2
    per_kelvin = BOLTZMANN * wave.bandwidth
    return ReceiverBudget(
        echo_temperature=echoes / per_kelvin,
        interference_temperature=interference / per_kelvin,
        added_temperature=added / per_kelvin,
        gain=float(level * peak),
        quantisation_ratio=1.0 / ((1.0 - kept) ** 2 + white / received) if white > 0.0 else float("inf"),
        pulse_loss=loss,
        phase_noise=float(np.sqrt(variance)),
        added_islr=loss - 1.0,
        filter_loss=filter_loss(radar),
        bits=bits,
    )


def filter_loss(radar: Radar) -> float:
    r"""Noise behind the compression filter over that of the matched filter of a flat pulse, power.

    .. math:: L = T_p f_s \frac{1}{N} \sum_k |H_k|^2

    for filters H that give a point the peak of its echo; 1 for the inverse of a linear pulse.
    """
    if radar.chain is None or radar.chain.pulse_filter == "flat":
        return 1.0
    response = RangeCompression(radar, radar.chain.pulse_filter).response
    gain = radar.waveform.pulse_width * radar.window.sampling_rate
    return float(gain * np.mean(np.abs(response) ** 2))


def echo_power(radar: Radar, grid: ImageGrid, sigma0: float) -> float:
    r"""Power, W, of the ground's echoes in the middle of a chirped record, pulse at mid-aperture.

    .. math:: P = \sigma^0 K^2 \int \frac{g^2}{R^4} dA

    over the image's rows, and in range over as much as one pulse covers.
    """
    pulse = radar.track.center_index
    column = grid.range.size // 2
    place = grid.positions()[:, column]
    line = place - radar.track.position[pulse]
    distance = np.linalg.norm(line, axis=1)
    gain = direction_gain(radar, pulse, line / distance[:, None])
    sine = np.sin(incidence_angle(radar, place[len(place) // 2]))
    # m on the ground: the image, or a pulse
    covered = 0.5 * SPEED_OF_LIGHT * radar.waveform.pulse_width / sine
    across = abs(float(grid.across_distance()[-1] - grid.across_distance()[0])) + grid.range_spacing
    area = min(float(covered), across) * grid.azimuth_spacing
    return float(sigma0 * radar.amplitude_constant**2 * area * np.sum(gain**2 / distance**4))


def _coded_bits(chain: ReceiveChain, power: float, thermal: float) -> int:
    """Bits of the block-adaptive quantiser for blocks of a power; 0: none."""
    if chain.raw_coding == "baq":
        return chain.baq_bits
    if chain.raw_coding == "none":
        return 0
    allowed = thermal / power_from_db(chain.fdbaq_margin_db)
    enough = [bits for bits in FDBAQ_BITS if power / lloyd_max_quantiser(bits).sqnr <= allowed]
    return min(enough, default=FDBAQ_BITS[-1])


def _stages(chain: ReceiveChain, bits: int) -> list[tuple[float, float]]:
    """Amplitude and noise power, over the input's, of clipping, converter and coding."""
    stages = []
    if np.isfinite(chain.saturation_db):
        stages.append(clipping_distortion(float(np.sqrt(power_from_db(chain.saturation_db)))))
    if chain.adc_bits:
        stages.append(_split(uniform_quantiser(chain.adc_bits)))
    if bits:
        stages.append(_split(lloyd_max_quantiser(bits)))
    return stages


def _split(quantiser: Quantiser) -> tuple[float, float]:
    """Gain of a quantiser and its uncorrelated noise: E q^2 - gain^2, with E q^2 from the distortion."""
    gain = quantiser.gain
    return gain, quantiser.distortion - 1.0 + 2.0 * gain - gain**2


def _gain_moments(chain: ReceiveChain) -> tuple[float, float]:
    """Mean and mean square of the amplitudes of a drift that is even in dB and of a log-normal jitter."""
    drift = np.sqrt(power_from_db(chain.gain_drift_db * np.linspace(-0.5, 0.5, 257)))
    variance = (np.log(10.0) / 20.0 * chain.gain_jitter_db) ** 2
    mean, square = float(drift.mean()), float(np.mean(drift**2))
    return mean * float(np.exp(0.5 * variance)), square * float(np.exp(2.0 * variance))
