"""Coarse start of a track: range errors of whole pulses, from the change of the phase over the band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import C64, C128, F64
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.gradients.forward_model import ForwardModel
from sarmitsuba.gradients.radar_parameters import AntennaTrack

# weight of a track's displacement across the line of sight, relative to the range error
ACROSS = 1e-3
# share of the energy of the strongest pulse from which a pulse counts
LIT = 1e-4


def coarse_track(model: ForwardModel, measured: C64, start: F64) -> F64:
    """Values with those of a track moved by the range errors of whole pulses; others stay."""
    tracks = [k for k, p in enumerate(model.parameters) if isinstance(p, AntennaTrack)]
    if not tracks:
        return start
    track = model.parameters[tracks[0]]
    assert isinstance(track, AntennaTrack)
    farther, lit = range_errors(model, measured, model.data(start))
    radar, time = model.scene.radar, model.scene.radar.track.time
    away = radar.track.position - model.sampling.window.center
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    weights = track.weights(time)
    rows = np.concatenate([weights * away[:, "xyz".index(axis), None] for axis in track.axes], axis=1)
    rows, farther = rows[lit], farther[lit]
    small = ACROSS * np.eye(rows.shape[1])
    own = np.linalg.lstsq(
        np.concatenate([rows, small]), np.concatenate([farther, np.zeros(len(small))]), rcond=None
    )[0]
    split = model.split(start)
    split[tracks[0]] = split[tracks[0]] + own
    return np.concatenate(split)


def range_errors(model: ForwardModel, measured: C64, expected: C64) -> tuple[F64, NDArray[np.bool_]]:
    r"""Slant range by which the echoes of every pulse are farther than expected, m, and the pulses that have echoes.

    With the spectra D and M of measured and expected profiles over the band, :math:`\sum D M^*` of a pulse has the
    phase :math:`-4 \pi f_c \Delta R / c`, unwrapped from pulse to pulse; the change of the phase over the band, common
    to all pulses once these are in phase, tells which multiple of half a wavelength is left.
    """
    radar = model.scene.radar
    n = measured.shape[-1]
    spectra = [np.fft.fft(x.astype(np.complex128), axis=-1) for x in (measured, expected)]
    cross = (spectra[0] * spectra[1].conj()).sum(axis=0)  # pulses, frequencies
    total = cross.sum(axis=1)
    lit = np.abs(total) > LIT * np.abs(total).max()
    wavelength = radar.waveform.wavelength
    phase = np.zeros(len(total))
    phase[lit] = np.unwrap(np.angle(total[lit]))
    farther = -phase * wavelength / (4.0 * np.pi)
    spacing = 2.0 * radar.window.sample_spacing / SPEED_OF_LIGHT
    frequency = np.asarray(np.fft.fftfreq(n, d=spacing), dtype=np.float64)
    # all pulses in phase, and without the range errors known so far: what is left is common to all
    ramp = np.exp(4j * np.pi * np.outer(farther, frequency) / SPEED_OF_LIGHT)
    together = ((cross * np.exp(-1j * phase)[:, None]) * ramp)[lit].sum(axis=0)
    order = np.argsort(frequency)
    together, frequency = together[order], frequency[order]
    slope = _slope(together, frequency)
    left = -slope * SPEED_OF_LIGHT / (4.0 * np.pi)
    return farther + np.round(left / (0.5 * wavelength)) * 0.5 * wavelength, lit


def _slope(values: C128, at: F64) -> float:
    """Slope of a phase over equally spaced positions, weighted by the moduli; from short distances to long ones."""
    slope, lag = 0.0, max(1, len(values) // 32)
    while lag <= len(values) // 2:
        flat = values * np.exp(-1j * slope * at)
        slope += float(np.angle(np.sum(flat[lag:] * flat[:-lag].conj())) / (at[lag] - at[0]))
        lag *= 2
    return slope
