"""Coarse start of a track: range errors of whole pulses, from the change of the phase over the band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import C64, C128, F64
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.gradients.forward_model import ForwardModel
from sarmitsuba.gradients.radar_parameters import AntennaTrack, knot_weights

# weight of a track's displacement across the line of sight, relative to the range error
ACROSS = 1e-3
# rounds by which range errors are found
ROUNDS = 3
# other cycles of the whole track that are looked at on either side
CYCLES = 3
# share of the energy of the strongest pulse from which a pulse counts
LIT = 1e-4


def coarse_track(model: ForwardModel, measured: C64, start: F64) -> F64:
    """Values with those of a track moved by the range errors of whole pulses; others stay."""
    if not any(isinstance(p, AntennaTrack) for p in model.parameters):
        return start
    farther, lit = range_errors(model, measured, model.data(start))
    return farther_track(model, start, farther, lit)


def track_cycles(model: ForwardModel, measured: C64, values: F64) -> list[F64]:
    """Values with the whole track some cycles of phase farther or nearer, and where its range errors say now."""
    if not any(isinstance(p, AntennaTrack) for p in model.parameters):
        return []
    radar = model.scene.radar
    every = np.ones(radar.track.n_pulses, dtype=np.bool_)
    steps = [0.5 * radar.waveform.wavelength * n for n in range(-CYCLES, CYCLES + 1) if n]
    found = [farther_track(model, values, np.full(len(every), step), every) for step in steps]
    return [coarse_track(model, measured, values), *found]


def farther_track(model: ForwardModel, start: F64, farther: F64, lit: NDArray[np.bool_]) -> F64:
    """Values with those of a track moved so that its lit pulses are farther, m."""
    number = next(k for k, p in enumerate(model.parameters) if isinstance(p, AntennaTrack))
    track = model.parameters[number]
    assert isinstance(track, AntennaTrack)
    radar, time = model.scene.radar, model.scene.radar.track.time
    away = radar.track.position - model.sampling.window.center
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    weights = knot_weights(time, track.knots)
    rows = np.concatenate([weights * away[:, "xyz".index(axis), None] for axis in track.axes], axis=1)
    rows, farther = rows[lit], farther[lit]
    small = ACROSS * np.eye(rows.shape[1])
    own = np.linalg.lstsq(
        np.concatenate([rows, small]), np.concatenate([farther, np.zeros(len(small))]), rcond=None
    )[0]
    split = model.split(start)
    split[number] = split[number] + own
    return np.concatenate(split)


def range_errors(model: ForwardModel, measured: C64, expected: C64) -> tuple[F64, NDArray[np.bool_]]:
    r"""Slant range by which the echoes of every pulse are farther than expected, m, and the pulses that have echoes.

    With the spectra D and M of measured and expected profiles over the band, the correlation of a pulse,
    :math:`\sum D M^* e^{j 4 \pi f r / c}` at the r where it is largest, has the phase
    :math:`-4 \pi f_c \Delta R / c`, unwrapped from pulse to pulse; the change of the phase over the band, common
    to all pulses once these are in phase, tells which multiple of half a wavelength is left. As the spectrum of speckle
    is uneven, both depend on r, which is what was found before.
    """
    radar = model.scene.radar
    n = measured.shape[-1]
    spectra = [np.fft.fft(x.astype(np.complex128), axis=-1) for x in (measured, expected)]
    cross = (spectra[0] * spectra[1].conj()).sum(axis=0)  # pulses, frequencies
    wavelength, spacing = radar.waveform.wavelength, radar.window.sample_spacing
    frequency = np.asarray(np.fft.fftfreq(n, d=2.0 * spacing / SPEED_OF_LIGHT), dtype=np.float64)
    order = np.argsort(frequency)

    def ramped(farther: F64) -> C128:
        return np.asarray(cross * np.exp(4j * np.pi * np.outer(farther, frequency) / SPEED_OF_LIGHT))

    largest = np.abs(np.fft.ifft(cross, axis=1)).argmax(axis=1)
    known: F64 = spacing * np.where(largest > n // 2, largest - n, largest)
    for _ in range(ROUNDS):
        total = ramped(known).sum(axis=1)
        lit = np.abs(total) > LIT * np.abs(total).max()
        phase = np.zeros(len(total))
        phase[lit] = np.unwrap(np.angle(total[lit]))
        farther = -phase * wavelength / (4.0 * np.pi)
        # all pulses in phase, and without the range errors known so far: what is left is common to all
        together = (ramped(farther) * np.exp(-1j * phase)[:, None])[lit].sum(axis=0)
        left = -_slope(together[order], frequency[order]) * SPEED_OF_LIGHT / (4.0 * np.pi)
        known = farther + left
    return farther + np.round(left / (0.5 * wavelength)) * 0.5 * wavelength, lit


def _slope(values: C128, at: F64) -> float:
    """Slope of a phase over equally spaced positions, weighted by the moduli; from short distances to long ones."""
    slope, lag = 0.0, max(1, len(values) // 32)
    while lag <= len(values) // 2:
        flat = values * np.exp(-1j * slope * at)
        slope += float(np.angle(np.sum(flat[lag:] * flat[:-lag].conj())) / (at[lag] - at[0]))
        lag *= 2
    return slope
