"""Echoes through a receive chain: distortion, thermal noise, oscillator, gain, interference, converter, coding.

In this order, as in a receiver. Factors of whole pulses act on range-compressed echoes; what acts on samples, on
chirped ones, which are compressed again by the inverse of the chirp.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.constants import BOLTZMANN, SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import power_from_db
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.receive_chain import ReceiveChain
from sarmitsuba.signal.chirp import n_fast_chirped, to_chirped
from sarmitsuba.signal.focusing.range_compression import RangeCompression
from sarmitsuba.signal.interference import draw_interference
from sarmitsuba.signal.noise import add_noise, draw_white, noise_generator, noise_power
from sarmitsuba.signal.quantiser import quantise_blocks, quantise_flexibly, quantise_uniform
from sarmitsuba.signal.raw_data import Layer, RawData

# random streams, apart from each other and from that of the noise
_OSCILLATOR, _GAIN, _DEAD = 0x6F7363, 0x6761696E, 0x64656164
_BATCH = 2**22  # complex samples of chirped echoes at once, 32 MB


def receive(raw: RawData, seed: int = 0, days: float = 0.0) -> RawData:
    """Echoes with thermal noise, as the radar's receive chain records them.

    Parameters
    ----------
    raw : domain ``compressed``; ``radar.chain`` None and ``radar.noise_temperature`` 0 return ``raw`` itself
    seed : the same seed gives the same draws of the same pass
    days : of the pass, since the first one

    Returns
    -------
    RawData, domain ``compressed``, with ``receive_chain`` in its metadata

    Raises
    ------
    DataError
        Chirped data and a chain.

    Notes
    -----
    The planes of a channel (bounce orders, subsets) add up to what is received; what acts on samples changes the plane
    of the lowest order, in two subsets by their shares, as noise does. Ignores the fast phase noise within a pulse, the
    rounding of scales of blocks, and echoes from outside the receive window: both ends of the record are weaker there.
    """
    if raw.radar.chain is None and raw.radar.emitters is None:
        return add_noise(raw, seed, days)
    chain = raw.radar.chain or ReceiveChain()
    if raw.domain != "compressed":
        raise DataError(f"receive needs range-compressed raw data, but these are {raw.domain}")
    if chain.distorts:
        raw = distort(raw, chain)
    # other filters than the inverse of the pulse shape noise as well, which then comes before them
    if chain.pulse_filter == "flat":
        raw = add_noise(raw, seed, days)
    factors, facts = pulse_factors(raw.radar, seed, days)
    alive = factors != 0.0
    data = raw.data * np.where(alive, factors, 1.0).astype(np.complex64)[:, None]
    if chain.changes_samples or raw.radar.emitters is not None:
        facts |= _record(data, raw.layers, raw.radar, (seed, days))
    data[:, ~alive] = 0.0
    return replace(raw, data=data, metadata={**raw.metadata, "receive_chain": facts})


def distort(raw: RawData, chain: ReceiveChain) -> RawData:
    r"""Echoes with imbalance and cross-talk of the polarisations, :math:`M = R S T`.

    See :meth:`sarmitsuba.radar.receive_chain.ReceiveChain.distortion`. Planes are mixed with those of the same order
    and subset.
    """
    sides = chain.distortion("transmit"), chain.distortion("receive")
    index = {layer: i for i, layer in enumerate(raw.layers)}
    data = np.zeros_like(raw.data)
    for layer, row in index.items():
        sent, received = layer.channel[0], layer.channel[1]
        for other, factor in _sources(sent, received, *sides):
            column = index.get(replace(layer, channel=other))
            if column is not None and factor:
                data[row] += np.complex64(factor) * raw.data[column]
    return replace(raw, data=data)


def _sources(sent: str, received: str, transmit: C128, receive_: C128) -> Iterator[tuple[str, complex]]:
    """Channels of which one channel is a mixture, with their factors."""
    linear = "HV"
    column = linear.find(sent)
    for j, at_receiver in enumerate(linear):
        if column < 0:  # a circular or slanted wave: the transmitter is ideal
            yield sent + at_receiver, complex(receive_[linear.index(received), j])
            continue
        for k, at_transmitter in enumerate(linear):
            factor = receive_[linear.index(received), j] * transmit[k, column]
            yield at_transmitter + at_receiver, complex(factor)


def pulse_factors(radar: Radar, seed: int, days: float = 0.0) -> tuple[C128, dict[str, object]]:
    """Factor (n_pulses,) of every pulse's echo, 0 where it is lost, and facts for the metadata.

    Gain over the track, phase of the oscillator, and dead pulses. The same for all channels.
    """
    chain, time = radar.chain or ReceiveChain(), radar.track.time
    share = (time - time[0]) / (time[-1] - time[0]) - 0.5 if time.size > 1 else np.zeros(1)
    gain_db = chain.gain_drift_db * share
    if chain.gain_jitter_db:
        rng = noise_generator(radar, seed, 0, days, _GAIN)
        gain_db = gain_db + chain.gain_jitter_db * rng.standard_normal(time.size)
    factors = np.sqrt(power_from_db(gain_db)).astype(np.complex128)
    facts: dict[str, object] = {}
    if chain.phase_spectrum.size and time.size > 1:
        phase = oscillator_phase(radar, noise_generator(radar, seed, 0, days, _OSCILLATOR))
        facts["phase_noise_rms_rad"] = float(np.std(phase))
        factors *= np.exp(1j * phase)
    if chain.dead_pulses:
        lost = round(chain.dead_pulses * time.size)
        picked = noise_generator(radar, seed, 0, days, _DEAD).permutation(time.size)[:lost]
        factors[picked] = 0.0
        facts["dead_pulses"] = lost
    return factors, facts


def oscillator_phase(radar: Radar, rng: np.random.Generator) -> F64:
    """Random phase (n_pulses,), rad, of every pulse's echo by the oscillator's spectrum.

    A Gaussian series of the spectrum of :meth:`sarmitsuba.radar.receive_chain.ReceiveChain.folded_phase_density` at the
    mean pulse repetition frequency, with the delay of the aim point.

    Notes
    -----
    Ignores frequencies below the inverse of twice the track's duration, which shift the image, and uneven intervals.
    """
    assert radar.chain is not None
    n, time = radar.track.n_pulses, radar.track.time
    prf = (n - 1) / float(time[-1] - time[0])
    density = radar.chain.folded_phase_density(n, prf, echo_delay(radar), radar.waveform.pulse_width)
    # 2 n samples, so that both ends are not correlated
    drawn = rng.standard_normal((2, n))
    bins = np.zeros(n + 1, dtype=np.complex128)
    bins[1:] = n * np.sqrt(density * 0.5 * prf / n) * (drawn[0] + 1j * drawn[1])
    bins[-1] = bins[-1].real * np.sqrt(2.0)
    return np.asarray(np.fft.irfft(bins, 2 * n)[:n])


def echo_delay(radar: Radar) -> float | None:
    """Delay of the aim point's echo at mid-aperture, s; None where transmitter and receiver are apart."""
    if radar.receiver is not None and not radar.receives_itself:
        return None
    distance = float(radar.slant_range(radar.aim_point)[radar.track.center_index])
    return 2.0 * distance / SPEED_OF_LIGHT


def _record(
    data: C64, layers: tuple[Layer, ...], radar: Radar, drawn: tuple[int, float]
) -> dict[str, object]:
    """Change samples of compressed echoes (n_layers, n_pulses, n_samples) in place; returns facts.

    ``drawn`` : seed and days of the run.
    """
    chain = radar.chain or ReceiveChain()
    n_pulses = data.shape[1]
    compression = RangeCompression(radar, chain.pulse_filter)
    step = max(1, _BATCH // n_fast_chirped(radar))
    # echoes from a whole window rise and fall at both ends of the record: samples of the same energy at full level
    full = max(radar.window.n_samples, n_fast_chirped(radar) - radar.window.n_samples)
    parts = [slice(start, min(start + step, n_pulses)) for start in range(0, n_pulses, step)]
    facts: dict[str, object] = {}
    for index, channel in enumerate(dict.fromkeys(layer.channel for layer in layers)):
        own = [i for i, layer in enumerate(layers) if layer.channel == channel]
        lowest = min(layers[i].order for i in own)
        targets = [i for i in own if layers[i].order == lowest]

        def chirped(pick: slice, own: list[int] = own, channel: str = channel) -> C64:
            total = data[own, pick].sum(axis=0, dtype=np.complex64)[None]
            made = RawData(total, (Layer(channel),), "compressed", radar.of_pulses(pick))
            return np.asarray(to_chirped(made).data[0])

        def draw_beside(pick: slice, rng: np.random.Generator) -> C64 | float:
            """Thermal noise, where the filter is not the inverse of the pulse, and interference."""
            beside: C64 | float = 0.0
            if radar.emitters is not None:
                beside = draw_interference(radar, *drawn, pick)
            if chain.pulse_filter != "flat" and radar.noise_temperature > 0.0:
                shape = (pick.stop - pick.start, n_fast_chirped(radar))
                beside = beside + draw_white(rng, shape, noise_power(radar, "chirped"))
            return beside

        def noise(index: int = index) -> np.random.Generator:
            return noise_generator(radar, drawn[0], index, drawn[1])

        energy, rng = 0.0, noise()
        for pick in parts if chain.changes_samples else ():
            seen = chirped(pick) + draw_beside(pick, rng)
            energy += float(np.vdot(seen, seen).real)
        rms = float(np.sqrt(0.5 * energy / (n_pulses * full)))
        bits, rng = 0.0, noise()
        for pick in parts:
            before = chirped(pick)
            seen = (before + draw_beside(pick, rng)).astype(np.complex64)
            after, used = record_samples(seen, radar, pick, rms)
            bits += used
            if chain.pulse_filter != "flat":
                planes = RawData(
                    data[own, pick], tuple(layers[i] for i in own), "compressed", radar.of_pulses(pick)
                )
                data[own, pick] = compression.forward(to_chirped(planes).data)
            change = compression.forward((after - before)[None])[0]
            for i in targets:
                data[i, pick] += change * np.float32(SUBSET_SHARES[layers[i].subset])
        if chain.raw_coding == "fdbaq":
            facts.setdefault("fdbaq_mean_bits", {})[channel] = bits / n_pulses  # type: ignore[index]
    return facts


def record_samples(echoes: C64, radar: Radar, pick: slice, rms: float) -> tuple[C64, float]:
    """Chirped echoes (n_pulses, n_fast) as they are recorded, and the sum over pulses of their mean bits under FDBAQ.

    Parameters
    ----------
    echoes : of the pulses ``pick``
    rms : of I and of Q in the middle of the record, over all pulses
    """
    chain = radar.chain or ReceiveChain()
    out: C64 = echoes
    if chain.transmit_gaps:
        out = np.where(find_transmissions(radar, pick), np.complex64(0.0), out)
    k1, k2 = (np.complex64(k) for k in chain.quadrature)
    offset = np.complex64(rms * (chain.iq_offset_i + 1j * chain.iq_offset_q))
    if k1 != 1.0 or k2 or offset:
        out = np.asarray(k1 * out + k2 * out.conj() + offset, dtype=np.complex64)
    if np.isfinite(chain.saturation_db):
        level = np.float32(rms * np.sqrt(power_from_db(chain.saturation_db)))
        out = (np.clip(out.real, -level, level) + 1j * np.clip(out.imag, -level, level)).astype(np.complex64)
    if chain.adc_bits:
        out = quantise_uniform(out, rms, chain.adc_bits)
    if chain.raw_coding == "baq":
        out = quantise_blocks(out, chain.baq_block, chain.baq_bits)
    if chain.raw_coding == "fdbaq":
        margin = float(power_from_db(chain.fdbaq_margin_db))
        noise = BOLTZMANN * radar.noise_temperature * radar.waveform.bandwidth
        out, bits = quantise_flexibly(out, chain.baq_block, noise, margin)
        return out, float(bits.mean(axis=1).sum())
    return out, 0.0


def find_transmissions(radar: Radar, pick: slice) -> NDArray[np.bool_]:
    """Samples (n_pulses, n_fast) of chirped echoes during which another pulse is transmitted.

    The receiver is off from the start to the end of every pulse of the track, and of those that would precede and
    follow it at the intervals of its ends.
    """
    time, wave, window = radar.track.time, radar.waveform, radar.window
    n_fast = n_fast_chirped(radar)
    begin = time[pick] + 2.0 * window.start_range[pick] / SPEED_OF_LIGHT - 0.5 * wave.pulse_width
    at = begin[:, None] + np.arange(n_fast) / window.sampling_rate
    if time.size > 1:
        first, last = time[1] - time[0], time[-1] - time[-2]
        more = int(np.ceil((at.max() - time[-1]) / last)) + 1 if at.max() > time[-1] else 1
        time = np.concatenate([[time[0] - first], time, time[-1] + last * np.arange(1, more + 1)])
    after = np.searchsorted(time, at)
    nearest = np.minimum(
        np.abs(at - time[np.clip(after, 0, time.size - 1)]), np.abs(at - time[np.clip(after - 1, 0, None)])
    )
    return np.asarray(nearest <= 0.5 * wave.pulse_width)
