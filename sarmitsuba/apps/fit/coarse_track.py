"""Coarse start of a track: range errors of whole pulses, from the change of the phase over the band."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.least_squares import Prior
from sarmitsuba.apps.fit.radar_parameters import AntennaTrack, knot_weights
from sarmitsuba.core.arrays import C64, C128, F64, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT

# weight of a track's displacement across the line of sight, relative to the range error
ACROSS = 1e-3
# rounds by which range errors are found
ROUNDS = 3
# other cycles of the whole track that are looked at on either side
CYCLES = 3
# share of the energy of the strongest pulse from which a pulse counts
LIT = 1e-4
# standard deviations of a prior within which a range error is sought
WITHIN = 4.0
# pulses that are added up in phase: a quarter of those from knot to knot, between these limits
FEWEST, MOST = 4, 64
# samples by which the range error changes at most over half of such a group
DRIFT = 2
# what a change of the path by one column costs, of a row's largest score
STIFF = 1.0
# rounds by which the common range is found: parts of a sample, a quarter of those before
FINER = 7


def coarse_track(model: ForwardModel, measured: C64, start: F64, known: Mapping[int, Prior]) -> F64:
    """Values with those of a track moved by the range errors of whole pulses; others stay.

    ``known`` are the priors by number of their value: where every value of the track has one, they bound the search.
    """
    number = next((k for k, p in enumerate(model.parameters) if isinstance(p, AntennaTrack)), None)
    if number is None:
        return start
    track = model.parameters[number]
    assert isinstance(track, AntennaTrack)
    sizes = [len(part) for part in model.split(start)]
    own = range(sum(sizes[:number]), sum(sizes[: number + 1]))
    reach = np.inf
    if all(k in known for k in own):
        far = [abs(known[k].mean - start[k]) + WITHIN * known[k].sigma for k in own]
        reach = float(np.sqrt(len(track.axes)) * max(far))
    together = model.scene.radar.track.n_pulses // (4 * track.knots)
    farther, lit = range_errors(model, measured, model.data(start), together, reach)
    return farther_track(model, start, farther, lit)


def track_cycles(model: ForwardModel, measured: C64, values: F64, known: Mapping[int, Prior]) -> list[F64]:
    """Values with the whole track some cycles of phase farther or nearer, and where its range errors say now."""
    if not any(isinstance(p, AntennaTrack) for p in model.parameters):
        return []
    radar = model.scene.radar
    every = np.ones(radar.track.n_pulses, dtype=np.bool_)
    steps = [0.5 * radar.waveform.wavelength * n for n in range(-CYCLES, CYCLES + 1) if n]
    found = [farther_track(model, values, np.full(len(every), step), every) for step in steps]
    return [coarse_track(model, measured, values, known), *found]


def farther_track(model: ForwardModel, start: F64, farther: F64, lit: NDArray[np.bool_]) -> F64:
    """Values with those of a track moved so that its lit pulses are farther, m."""
    number = next(k for k, p in enumerate(model.parameters) if isinstance(p, AntennaTrack))
    track = model.parameters[number]
    assert isinstance(track, AntennaTrack)
    radar = model.scene.radar
    away = radar.track.position - model.sampling.window.center
    away = unit_rows(away)
    weights = np.mean([knot_weights(radar.track.time, track.knots, at) for at in radar.times], axis=0)
    rows = np.concatenate([weights * away[:, "xyz".index(axis), None] for axis in track.axes], axis=1)
    rows, farther = rows[lit], farther[lit]
    small = ACROSS * np.eye(rows.shape[1])
    found = np.linalg.lstsq(
        np.concatenate([rows, small]), np.concatenate([farther, np.zeros(len(small))]), rcond=None
    )[0]
    split = model.split(start)
    split[number] = split[number] + found
    return np.concatenate(split)


def range_errors(
    model: ForwardModel, measured: C64, expected: C64, together: int = 0, reach: float = np.inf
) -> tuple[F64, NDArray[np.bool_]]:
    r"""Slant range by which the echoes of every pulse are farther than expected, m, and the pulses that have echoes.

    With the spectra D and M of measured and expected profiles over the band, the correlation of a pulse,
    :math:`\sum D M^* e^{j 4 \pi f r / c}` at the r where it is largest, has the phase
    :math:`-4 \pi f_c \Delta R / c`, unwrapped from pulse to pulse; the change of the phase over the band, common
    to all pulses once these are in phase, tells which multiple of half a wavelength is left. As the spectrum of speckle
    is uneven, both depend on r, which was found before.

    Measured scenes hold echoes that the model does not know, often brighter than those that it knows in a single pulse.
    So ``together`` pulses are added up, at the range and the phase per pulse at which their sum is largest, along the
    path over the pulses that has the most of it in all; below ``FEWEST`` each pulse stands alone. Range errors beyond
    ``reach``, m, are not sought.
    """
    radar = model.scene.radar
    n = measured.shape[-1]
    spectra = [np.fft.fft(x.astype(np.complex128), axis=-1) for x in (measured, expected)]
    cross = (spectra[0] * spectra[1].conj()).sum(axis=0)  # pulses, frequencies
    wavelength, spacing = radar.waveform.wavelength, radar.window.sample_spacing
    frequency = np.asarray(np.fft.fftfreq(n, d=2.0 * spacing / SPEED_OF_LIGHT), dtype=np.float64)
    length = min(together, MOST) if together >= FEWEST else 1

    def ramped(farther: F64) -> C128:
        return np.asarray(cross * np.exp(4j * np.pi * np.outer(farther, frequency) / SPEED_OF_LIGHT))

    most = n // 2 if reach > spacing * (n // 2) else max(1, int(np.ceil(reach / spacing)))
    lags = np.arange(-most, n - n // 2 if most == n // 2 else most + 1)
    known: F64 = spacing * lags[0] + spacing * _ridge(np.fft.ifft(cross, axis=1)[:, lags], length)
    for _ in range(ROUNDS):
        total = ramped(known).sum(axis=1)
        lit = np.abs(total) > LIT * np.abs(total).max()
        phase = np.zeros(len(total))
        phase[lit] = unwrap_phase(total[lit], length)
        farther = -phase * wavelength / (4.0 * np.pi)
        # all pulses in phase, and without the range errors known so far: what is left is common to all
        summed = (ramped(farther) * np.exp(-1j * phase)[:, None])[lit].sum(axis=0)
        left = _largest(summed, spacing, lags + np.round(-np.mean(farther[lit]) / spacing))
        known = farther + left
    return farther + np.round(left / (0.5 * wavelength)) * 0.5 * wavelength, lit


def _ridge(profiles: C128, length: int) -> F64:
    """Column (rows,) at which each row is largest; of groups of ``length`` rows in phase, between their middles."""
    if length == 1:
        return np.asarray(np.abs(profiles).argmax(axis=1), dtype=np.float64)
    starts = np.unique(np.append(np.arange(0, len(profiles) - length, length // 2), len(profiles) - length))
    taper = np.hanning(length + 2)[1:-1, None]
    power = [
        np.abs(np.fft.fft(taper * profiles[k : k + length], 2 * length, axis=0)).max(axis=0) for k in starts
    ]
    shares = np.square(power)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    middles = starts + 0.5 * (length - 1)
    return np.asarray(np.interp(np.arange(len(profiles)), middles, _path(shares, DRIFT, wraps=False)))


def _path(scores: F64, drift: int, wraps: bool) -> NDArray[np.intp]:
    """Columns (rows,) with the largest sum of scores (rows, columns), at most ``drift`` apart from row to row.

    Each column farther costs ``STIFF`` of a row's largest score, in the mean: a path does not leave for what is
    brighter for a while. With ``wraps``, the last column is next to the first one. Dynamic programming.
    """
    n, best = scores.shape[1], scores[0]
    steps, froms = np.arange(-drift, drift + 1), []
    cost = STIFF * np.abs(steps) * scores.max(axis=1).mean()
    for row in scores[1:]:
        padded = np.pad(best, drift, mode="wrap") if wraps else np.pad(best, drift, constant_values=-np.inf)
        earlier = sliding_window_view(padded, len(steps)) - cost
        choice = earlier.argmax(axis=1)
        froms.append(steps[choice])
        best = row + np.take_along_axis(earlier, choice[:, None], axis=1)[:, 0]
    columns = [int(best.argmax())]
    for moved in reversed(froms):
        at = columns[-1] + int(moved[columns[-1]])
        columns.append(at % n if wraps else at)
    return np.array(columns[::-1])


def unwrap_phase(values: C128, length: int) -> F64:
    """Phase (n,), rad, of a sequence, continuous by the phases and slopes of ``length`` values around each one.

    The phase changes by less than pi from value to value; the slope by at most a quarter of 2 pi / ``length``.
    """
    if length == 1 or len(values) < length:
        return np.asarray(np.unwrap(np.angle(values)))
    half = length // 2
    taper = np.hanning(2 * half + 3)[1:-1]
    around = sliding_window_view(np.pad(values, half), 2 * half + 1) * taper
    n = 4 * (2 * half + 1)
    spectra = np.fft.fft(around, n, axis=1)
    shares = np.abs(spectra) ** 2
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    found = _path(shares, 1, wraps=True)
    slope = 2.0 * np.pi * np.where(found > n // 2, found - n, found) / n
    smooth = np.angle(np.take_along_axis(spectra, found[:, None], axis=1)[:, 0]) + slope * half
    # the slope is of use from value to value: it may itself step from pi to -pi
    ahead = slope[:-1] + 0.5 * _wrap_phase(np.diff(slope))
    steps = ahead + _wrap_phase(np.diff(smooth) - ahead)
    phase = smooth[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray(phase + _wrap_phase(np.angle(values) - phase))


def _wrap_phase(phase: F64) -> F64:
    """Phases between -pi and pi."""
    return np.asarray(np.angle(np.exp(1j * phase)))


def _largest(spectrum: C128, spacing: float, lags: NDArray[np.float64]) -> float:
    """Range, m, at which a profile is largest in modulus, of those within half a sample of ``lags`` samples."""
    n = len(spectrum)
    folded = (np.fft.fftfreq(n) * n).astype(
        np.int64
    )  # of whole numbers of frequency steps, negative ones too
    found, step = 0.0, 1.0
    offsets = lags
    for _ in range(FINER):
        phase = np.exp(2j * np.pi * np.outer(offsets, folded) / n)
        found = float(offsets[np.abs(phase @ spectrum).argmax()])
        offsets = found + step * np.linspace(-0.5, 0.5, 9)
        step /= 4.0
    return found * spacing
