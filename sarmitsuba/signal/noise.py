"""Thermal noise of the receiver, in chirped echoes or in range-compressed profiles."""

from dataclasses import replace

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.constants import BOLTZMANN, SUBSET_SHARES
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.raw_data import RawData

_STREAM = 0x6E6F697365  # keeps the noise's random stream apart from the others of the same seed
_BATCH = 2**20


def noise_power(radar: Radar, domain: str) -> float:
    r"""Mean power of the noise in one sample, W.

    .. math:: \sigma_{chirped}^2 = k T f_s, \qquad \sigma_{compressed}^2 = k T / T_p

    Parameters
    ----------
    domain : ``chirped``, where it is white over the complex sampling rate f_s, or ``compressed``, where it is
        flat over the band B and zero outside

    Notes
    -----
    The second follows from the first. The filter that turns a pulse g of flat spectrum,
    ``|G|^2 = T_p f_s^2 / B`` in the band, into a response of peak 1 and flat spectrum ``f_s / B`` is
    ``H = (f_s / B) / G``, so white noise of power k T f_s becomes
    ``k T f_s * (B / f_s) * |H|^2 = k T f_s / (T_p f_s)``.
    An LFM pulse is flat but for its Fresnel ripple, which moves this by about ``1 / sqrt(B T_p)``.
    """
    if domain == "chirped":
        return BOLTZMANN * radar.noise_temperature * radar.window.sampling_rate
    return BOLTZMANN * radar.noise_temperature / radar.waveform.pulse_width


def noise_generator(
    radar: Radar, seed: int, channel: int, days: float = 0.0, stream: int = _STREAM
) -> np.random.Generator:
    """Random generator of a receiver's noise, seeded by channel, antenna position and time.

    Two passes with one seed have the same scatterers but independent noise.

    Parameters
    ----------
    radar : its mid-aperture position to a centimetre, and that of a separate receiver, are part of the seed
    seed : the same seed gives the same noise
    channel : number of the channel
    days : since the first pass
    stream : number of the quantity that is drawn; default: thermal noise
    """
    tracks = [radar.track, *([radar.receiver] if radar.receiver is not None else [])]
    # the shift keeps round coordinates away from rounding boundaries
    place = np.round(
        100.0 * np.concatenate([t.center_position + radar.offset for t in tracks]) + 0.3718
    ).astype(np.int64)
    later = [int(np.float64(days).view(np.uint64))] if days else []
    return np.random.default_rng([seed, stream, channel, *(int(v) & 0xFFFFFFFF for v in place), *later])


def add_noise(raw: RawData, seed: int = 0, days: float = 0.0) -> RawData:
    """Raw data with one independent realisation of thermal noise per channel.

    Parameters
    ----------
    raw : either domain; ``radar.noise_temperature`` in K, 0 returns ``raw`` itself
    seed : the same seed gives the same noise of the same pass
    days : of the pass, since the first one

    Returns
    -------
    RawData of the same domain, with ``noise_temperature_K`` and ``noise_power_W`` in its metadata

    Notes
    -----
    The planes of a channel (bounce orders, subsets) add up to the channel, so its noise is added to the plane of the
    lowest order; of two subsets each gets the same noise by its share, so that their difference is free of noise.
    Quantisation and other errors of the receiver are those of :func:`sarmitsuba.signal.receive.receive`.
    """
    radar = raw.radar
    if radar.noise_temperature <= 0.0:
        return raw
    data = raw.data.copy()
    power = noise_power(radar, raw.domain)
    for index, channel in enumerate(raw.channels):
        own = [i for i, layer in enumerate(raw.layers) if layer.channel == channel]
        lowest = min(raw.layers[i].order for i in own)
        targets = [i for i in own if raw.layers[i].order == lowest]
        rng = noise_generator(radar, seed, index, days)
        n_pulses, n_fast = data.shape[1:]
        step = max(1, _BATCH // n_fast)
        for start in range(0, n_pulses, step):
            shape = (min(step, n_pulses - start), n_fast)
            noise = (
                draw_white(rng, shape, power)
                if raw.domain == "chirped"
                else _draw_in_band(rng, shape, power, radar)
            )
            for i in targets:
                data[i, start : start + shape[0]] += noise * np.float32(SUBSET_SHARES[raw.layers[i].subset])
    metadata = {**raw.metadata, "noise_temperature_K": radar.noise_temperature, "noise_power_W": power}
    return replace(raw, data=data, metadata=metadata)


def draw_white(rng: np.random.Generator, shape: tuple[int, int], power: float) -> C64:
    """Circular complex Gaussian of mean power ``power``."""
    pair = rng.standard_normal((*shape, 2), dtype=np.float32) * np.float32(np.sqrt(0.5 * power))
    return np.asarray(pair.view(np.complex64)[..., 0])


def _draw_in_band(rng: np.random.Generator, shape: tuple[int, int], power: float, radar: Radar) -> C64:
    """Circular complex Gaussian of mean power ``power``, flat over the band B and zero outside."""
    n_fft = int(scipy.fft.next_fast_len(shape[1] + 32))  # avoids correlation of both ends by periodicity
    share = radar.waveform.bandwidth / radar.window.sampling_rate
    bins = np.abs(scipy.fft.fftfreq(n_fft))
    gain = np.clip(
        (0.5 * share - bins) * n_fft + 0.5, 0.0, 1.0
    )  # an edge bin is weighted by its part within the band
    gain = np.sqrt(gain * (n_fft / gain.sum())).astype(np.float32)
    white = draw_white(rng, (shape[0], n_fft), power) * (gain * np.float32(np.sqrt(n_fft)))
    return np.asarray(scipy.fft.ifft(white, axis=-1, workers=-1, overwrite_x=True)[:, : shape[1]])
