r"""Signals of emitters on the ground in chirped echoes, and their mean power.

.. math:: P_r = \mathrm{EIRP} \, g_e \, \frac{G g_r \lambda^2}{(4 \pi R)^2 \sqrt L}

with the gains of the emitter's and the radar's beams towards each other, one way, and the losses of one way, the
root of those of both.
"""

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import BOLTZMANN, SPEED_OF_LIGHT
from sarmitsuba.radar.interference import KINDS, Emitters
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.chirp import n_fast_chirped
from sarmitsuba.signal.focusing.aperture_weights import direction_gain
from sarmitsuba.signal.noise import noise_generator

_STREAM = 0x656D6974  # of the random phases
# tones of random frequency and phase that make a narrow-band signal
_TONES = 32


def interference_power(radar: Radar, row: int, pulses: slice = slice(None)) -> F64:
    """Power (n_pulses,), W, of an emitter at the receiver in every pulse, while it is on.

    Half of it is received in each of two polarisations: the emitter's wave is slanted by 45 degrees.
    """
    emitters = radar.emitters
    assert emitters is not None
    position = radar.tracks[-1].position[pulses]
    line = emitters.position[row] - position
    distance = np.linalg.norm(line, axis=1)
    direction = line / distance[:, None]
    antenna = radar.antenna.gain * direction_gain(radar, pulses, direction, radar.pointings[-1])
    wavelength = SPEED_OF_LIGHT / emitters.frequency[row]
    spread = (wavelength / (4.0 * np.pi * distance)) ** 2 / np.sqrt(radar.losses)
    return np.asarray(emitters.eirp[row] * emitters.gain(row, -direction) * antenna * spread)


def interference_temperature(radar: Radar) -> float:
    """Noise temperature, K, of the same mean power in the band of one channel, over the whole track."""
    emitters = radar.emitters
    if emitters is None:
        return 0.0
    band = radar.waveform.bandwidth
    total = 0.0
    for row in range(emitters.kind.size):
        total += (
            0.5
            * float(interference_power(radar, row).mean())
            * emitters.duty(row)
            * _share(emitters, row, radar)
        )
    return total / (BOLTZMANN * band)


def _share(emitters: Emitters, row: int, radar: Radar) -> float:
    """Share of an emitter's band in that of the radar."""
    width = float(emitters.bandwidth[row]) if KINDS[int(emitters.kind[row])] != "pulse" else 0.0
    middle = float(emitters.frequency[row]) - radar.waveform.center_frequency
    half = 0.5 * radar.waveform.bandwidth
    if width == 0.0:
        return 1.0
    overlap = min(middle + 0.5 * width, half) - max(middle - 0.5 * width, -half)
    return max(0.0, overlap) / width


def draw_interference(radar: Radar, seed: int, days: float, pick: slice) -> C64:
    r"""Signals of all emitters (n_pulses, n_fast) complex64, sqrt(W), in one channel of the chirped echoes.

    .. math:: s(t) = \sqrt{P_r / 2} \, u(t - R / c) \, e^{-j 2 \pi f_c R / c}

    with the emitter's complex baseband u about the radar's carrier, of power 1 while it is on.

    Parameters
    ----------
    seed, days : of the run; the same emitters have the same phases in all channels and pulses
    pick : pulses

    Notes
    -----
    Signals outside the band are removed, by an ideal filter of the instantaneous frequency. Ignores multipath, and
    shadow by the scene; the emitter is seen by the recorded antenna positions.
    """
    emitters = radar.emitters
    assert emitters is not None
    wave, window, track = radar.waveform, radar.window, radar.tracks[-1]
    begin = radar.track.time[pick] + 2.0 * window.start_range[pick] / SPEED_OF_LIGHT - 0.5 * wave.pulse_width
    at = begin[:, None] + np.arange(n_fast_chirped(radar)) / window.sampling_rate
    out = np.zeros(at.shape, dtype=np.complex128)
    for row in range(emitters.kind.size):
        rng = noise_generator(radar, seed, row, days, _STREAM)
        distance = np.linalg.norm(track.position[pick] - emitters.position[row], axis=1)
        time = at - distance[:, None] / SPEED_OF_LIGHT
        turn = np.exp(-2j * np.pi * wave.center_frequency / SPEED_OF_LIGHT * distance)
        level = np.sqrt(0.5 * interference_power(radar, row, pick)) * turn
        out += level[:, None] * _baseband(emitters, row, time, radar, rng)
    return out.astype(np.complex64)


def _baseband(emitters: Emitters, row: int, time: F64, radar: Radar, rng: np.random.Generator) -> C64:
    """Complex baseband of an emitter at its own times (...), s, of power 1 while it is on."""
    kind, width = KINDS[int(emitters.kind[row])], float(emitters.bandwidth[row])
    middle = float(emitters.frequency[row]) - radar.waveform.center_frequency
    half = 0.5 * radar.waveform.bandwidth
    turn = 2.0 * np.pi * rng.random()
    if kind == "narrow":
        tones = middle + (width * (rng.random(_TONES) - 0.5) if width > 0.0 else np.zeros(1))
        phases = 2.0 * np.pi * rng.random(tones.size)
        out = np.zeros(time.shape, dtype=np.complex128)
        for tone, phase in zip(tones, phases, strict=True):
            if abs(tone) <= half:
                out += np.exp(1j * (2.0 * np.pi * np.remainder(tone * time, 1.0) + phase))
        return np.asarray(out / np.sqrt(tones.size))
    interval, length = 1.0 / float(emitters.repetition[row]), float(emitters.pulse_width[row])
    since = np.remainder(time + interval * rng.random(), interval) - 0.5 * length
    rate = width / length if kind == "chirp" else 0.0
    on = (np.abs(since) <= 0.5 * length) & (np.abs(middle + rate * since) <= half)
    phase = 2.0 * np.pi * np.remainder(middle * time, 1.0) + np.pi * rate * since**2 + turn
    return np.asarray(np.where(on, np.exp(1j * phase), 0.0))
