"""Profiles of a block's pulses from its grid over range and range rate, and the adjoint of this map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.signal.block import azimuth_gain
from sarmitsuba.signal.gridding import gridding_kernel, phase_ramp, to_window, to_window_adjoint, unit_phasor
from sarmitsuba.signal.threads import parallel_map

if TYPE_CHECKING:
    from sarmitsuba.radar.radar import Radar
    from sarmitsuba.signal.block import BlockPlan
    from sarmitsuba.signal.sub_bands import RangeFilter


# cycles per cell: flat to just past the band's edge at 1/4, then down: the inner response stays within 40 cells
_ROLL = (0.256, 0.32)
_GROUP = 2**24  # complex cells of the layers synthesised together: 128 MB a buffer
# terms of the Taylor series in the frequency
_TERMS = 4


def synthesise(
    grid: NDArray[np.complexfloating],
    plan: BlockPlan,
    radar: Radar,
    *,
    beam: bool = False,
    share: RangeFilter | None = None,
) -> C64:
    r"""Range-compressed profiles of a block's pulses from a filled grid.

    .. math:: S(f, t) = e^{-j 4 \pi f_c R_{ref}(t) / c} \sum_j G(f, \dot R_j) \,
              e^{-j 4 \pi (f_c + f) \dot R_j \tau / c} \, e^{-j 4 \pi f_c b(\dot R_j, t) / c} / \hat\phi

    then, along range, the factor ``exp(-j 4 pi fc a(R, t) / c)`` and the shift by a; a and b are the range and
    range-rate parts of the curvature.

    Parameters
    ----------
    grid : (n_layers, n_range, n_range_rate) complex, any strides
    beam : whether to apply every pulse's azimuth pattern, which the grid then does not contain
    share : factor on the spectrum, of one of several traced frequencies; None: one

    Returns
    -------
    (n_layers, K, n_samples) complex64 on ``radar.window``, see :class:`sarmitsuba.signal.raw_data.RawData`
    """
    group = max(1, _GROUP // (plan.n_inner * max(plan.n_range_rate, plan.n_pulses)))
    if len(grid) > group:
        groups = (grid[i : i + group] for i in range(0, len(grid), group))
        return np.concatenate([synthesise(part, plan, radar, beam=beam, share=share) for part in groups])
    spectrum = RangeRateMatrices.of(plan, radar, beam=beam).pulses(grid)
    bent = Bending.of(plan, radar)
    slope = spectrum * bent.slope
    inner = scipy.fft.ifft(spectrum, axis=-1, workers=-1, overwrite_x=True)
    inner -= bent.shift * scipy.fft.ifft(slope, axis=-1, workers=-1, overwrite_x=True)
    inner *= bent.turn
    cell, n_samples = radar.waveform.range_cell, radar.window.n_samples
    return to_window(inner, bent.offset, plan.fine, cell, n_samples, share=share)


def synthesise_adjoint(
    profiles: C64, plan: BlockPlan, radar: Radar, *, beam: bool = False, share: RangeFilter | None = None
) -> C64:
    """Adjoint of :func:`synthesise`: grids (n_layers, n_range, n_range_rate) from profiles (n_layers, K, n_samples)."""
    bent = Bending.of(plan, radar)
    inner = to_window_adjoint(
        profiles, bent.offset, plan.fine, radar.waveform.range_cell, plan.n_inner, share=share
    )
    inner *= bent.turn.conj()
    spectrum = scipy.fft.fft(inner, axis=-1, norm="forward", workers=-1)
    inner *= bent.shift
    spectrum -= bent.slope.conj() * scipy.fft.fft(
        inner, axis=-1, norm="forward", workers=-1, overwrite_x=True
    )
    return RangeRateMatrices.of(plan, radar, beam=beam).adjoint(spectrum)


@dataclass(frozen=True, eq=False)
class Bending:
    """Curvature of the slant ranges in the profiles of a block, as the synthesis applies it.

    Parameters
    ----------
    shift : (K, n_inner) float32, m, by which profiles are shifted to first order: p(r - a) = p - a dp/dr
    slope : (n_inner,) complex64, factor on the spectrum that gives dp/dr
    turn : (K, n_inner) complex64, factor on the shifted profiles
    offset : (K,) float64, m, range of the window's first sample less that of the profiles' first
    """

    shift: NDArray[np.float32]
    slope: C64
    turn: C64
    offset: F64

    @staticmethod
    def of(plan: BlockPlan, radar: Radar) -> Bending:
        """Curvature of a block."""
        wavenumber = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
        first = plan.range0 - plan.guard * plan.range_step
        bins = first + plan.range_step * np.arange(plan.n_inner)
        reference = radar.slant_range(plan.reference, slice(plan.start, plan.stop))
        reference_phase = np.mod(wavenumber * reference, 2.0 * np.pi)
        bend = plan.curvature.of_range(bins)
        return Bending(
            bend.astype(np.float32),
            (2j * np.pi / plan.range_step * scipy.fft.fftfreq(plan.n_inner)).astype(np.complex64),
            unit_phasor(-wavenumber * bend - reference_phase[:, None]),
            radar.window.start_range[plan.start : plan.stop] - reference - first,
        )


@dataclass(frozen=True, eq=False)
class RangeRateMatrices:
    r"""Matrices from range rates to pulses, for batches of neighbouring frequencies of the grid's range axis.

    .. math:: S(f, t) = w(f, t) \sum_j G(f, \dot R_j) \, e^{-j 4 \pi (f_c + f) \dot R_j \tau / c} \,
              e^{-j 4 \pi f_c b(\dot R_j, t) / c}

    Within a batch of frequencies exp(-j q walk) is a short Taylor series in q, so that the matrices of all its
    frequencies come from one: \|q walk\| < 0.25 and four terms leave 1.6e-4 at the outermost corner.

    Parameters
    ----------
    plan, radar : of the block
    gain : (n_range_rate, K) two-way azimuth pattern; None: not applied
    drift, shift : m, (n_range_rate, K) and (n_range_rate, K), change of the range to each pulse, and range shift of a
        path by its Doppler frequency within the pulse
    steps : orders of the Taylor series, from one to the next
    middle : m/s, of the range rates
    lever : (K,) s, factor of the range rate at each pulse: its time, for a straight track
    half : frequencies of a batch on either side of its middle
    """

    plan: BlockPlan
    radar: Radar
    gain: F64 | None
    drift: F64
    shift: F64
    steps: tuple[C64, ...]
    middle: float
    lever: F64
    half: int

    @staticmethod
    def of(plan: BlockPlan, radar: Radar, *, beam: bool) -> RangeRateMatrices:
        """Matrices of a block; ``beam``: with every pulse's azimuth pattern."""
        pulses = slice(plan.start, plan.stop)
        range_rate = plan.range_rate0 + plan.range_rate_step * np.arange(plan.n_range_rate)
        gain = None
        if beam:
            gain = azimuth_gain(radar, pulses, plan.reference, np.asarray(range_rate, dtype=np.float64))
        # the range part of the curvature is evaluated at the path's range at time t: correct for its slope here
        bend = (
            plan.curvature.of_range_rate(range_rate).T - plan.curvature.slope * range_rate[:, None] * plan.tau
        )
        drift = range_rate[:, None] * plan.tau + bend
        shift = radar.range_per_rate * (range_rate[:, None] + radar.range_rate(plan.reference, pulses))
        middle = float(0.5 * (range_rate[0] + range_rate[-1]))
        walk = _phase_per_bin(plan) * (drift - middle * plan.tau + shift)  # rad per bin
        lever = plan.tau
        if plan.n_range_rate > 1:
            lever = (drift[-1] - drift[0]) / (range_rate[-1] - range_rate[0])
        half = min(max(1, int(0.25 / max(float(np.abs(walk).max()), 1e-9))), 128)
        steps = tuple((walk * (-1j / order)).astype(np.complex64) for order in range(1, _TERMS))
        return RangeRateMatrices(plan, radar, gain, drift, shift, steps, middle, lever, half)

    @property
    def count(self) -> int:
        """Frequencies on either side of zero that are not zero."""
        return int(_ROLL[1] * self.plan.n_inner)

    @property
    def starts(self) -> range:
        """First frequencies of the batches."""
        return range(-self.count, self.count + 1, 2 * self.half + 1)

    def at(self, m0: int) -> tuple[I64, NDArray[np.float32], C64, C64]:
        """Frequencies of the batch from ``m0`` on, in bins: absolute (n,), and from its middle (n, 1).

        Returns
        -------
        m, q, matrix, weight : with the matrices (n_range_rate, 4 K) of all orders side by side, and weights (n, K)
        """
        plan, radar, per_bin = self.plan, self.radar, _phase_per_bin(self.plan)
        m = np.arange(m0, min(m0 + 2 * self.half + 1, self.count + 1))
        center = int(m[len(m) // 2])
        wavenumber = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
        terms = [unit_phasor(-(wavenumber + center * per_bin) * self.drift - center * per_bin * self.shift)]
        if self.gain is not None:
            terms[0] *= self.gain.astype(np.float32)
        for step in self.steps:
            terms.append(terms[-1] * step)
        weight = _pulse_weight(m, center, self.middle, self.lever, plan, radar)
        q = (m - center).astype(np.float32)[:, None]
        return m, q, np.concatenate(terms, axis=1), weight

    @property
    def by_range(self) -> C64:
        """Weight by frequency alone, -count ... count."""
        return _range_weight(self.plan.width, self.plan.n_inner, self.count, self.plan.guard)

    def pulses(self, grid: NDArray[np.complexfloating]) -> C64:
        """Spectra (n_layers, K, n_inner) of the pulses from a grid (n_layers, n_range, n_range_rate)."""
        n, n_pulses = self.plan.n_inner, self.plan.n_pulses
        spectrum = scipy.fft.fft(grid, n=n, axis=1, workers=-1)
        out = np.zeros((len(grid), n_pulses, n), dtype=spectrum.dtype)
        by_range, count = self.by_range, self.count

        def batch(m0: int) -> None:
            m, q, matrix, weight = self.at(m0)
            rows = spectrum[:, m % n] if m[0] < 0 <= m[-1] else spectrum[:, m[0] % n : m[-1] % n + 1]
            product = rows @ matrix
            value = product[..., (_TERMS - 1) * n_pulses :]
            for order in range(_TERMS - 2, -1, -1):
                value = value * q + product[..., order * n_pulses : (order + 1) * n_pulses]
            value *= weight
            value *= by_range[m + count, None]
            out[:, :, m % n] = np.swapaxes(value, 1, 2)

        parallel_map(batch, self.starts)
        return out

    def adjoint(self, spectra: C64) -> C64:
        """Adjoint of :meth:`pulses`: grid (n_layers, n_range, n_range_rate) from spectra (n_layers, K, n_inner)."""
        plan, n = self.plan, self.plan.n_inner
        rows = np.zeros((len(spectra), n, plan.n_range_rate), dtype=np.complex64)
        by_range, count = self.by_range, self.count

        def batch(m0: int) -> None:
            m, q, matrix, weight = self.at(m0)
            value = np.swapaxes(spectra[:, :, m % n], 1, 2) * (weight * by_range[m + count, None]).conj()
            orders = [value]
            for _ in range(_TERMS - 1):
                orders.append(orders[-1] * q)
            rows[:, m % n] = np.concatenate(orders, axis=-1) @ matrix.conj().T

        parallel_map(batch, self.starts)
        # without a factor: the adjoint of the forward transform
        grid = scipy.fft.ifft(rows, axis=1, norm="forward", workers=-1, overwrite_x=True)
        return np.ascontiguousarray(grid[:, : plan.n_range])


def _phase_per_bin(plan: BlockPlan) -> float:
    """Phase per metre and bin, rad."""
    return 2.0 * np.pi / (plan.n_inner * plan.range_step)


@lru_cache(maxsize=16)
def _range_weight(width: int, n: int, count: int, guard: int) -> C64:
    """Factor by frequency alone, -count ... count: kernel along range, roll-off, guard."""
    nu = np.arange(-count, count + 1) / n
    edge = np.clip((np.abs(nu) - _ROLL[0]) / (_ROLL[1] - _ROLL[0]), 0.0, 1.0)
    roll = np.cos(0.5 * np.pi * np.sin(0.5 * np.pi * edge) ** 2) ** 2
    weight = roll / gridding_kernel(width).transform(nu) * np.exp(-2j * np.pi * nu * guard)
    return np.asarray(weight, dtype=np.complex64)


def _pulse_weight(m: I64, center: int, middle: float, lever: F64, plan: BlockPlan, radar: Radar) -> C64:
    """Factor by frequency and pulse, (n_m, K): kernel along the range rate, mean walk."""
    per_bin = _phase_per_bin(plan)
    carrier_bins = radar.waveform.center_frequency * 2.0 * plan.n_inner * plan.range_step / SPEED_OF_LIGHT
    # cycles per range-rate cell: nearly the same for all m, so three Chebyshev points and a parabola
    span = max(float(np.abs(m - center).max()), 1.0)
    nodes = np.array([-0.8660254, 0.0, 0.8660254]) * span
    per_lever = per_bin * plan.range_rate_step / (2.0 * np.pi)
    cycles = per_lever * lever
    at_nodes = plan.range_rate_kernel.inverse_transform(
        (carrier_bins + center + nodes)[:, None] * cycles
        + (center + nodes)[:, None] * (per_lever * radar.range_per_rate)
    )
    u = (m - center)[:, None] / nodes[2]
    parabola = np.concatenate([0.5 * u * (u - 1.0), 1.0 - u * u, 0.5 * u * (u + 1.0)], axis=1)
    mean_walk = phase_ramp(-per_bin * middle * plan.tau, int(m[0]) - center, len(m))
    return np.asarray(mean_walk.T * (parabola.astype(np.float32) @ at_nodes.astype(np.float32)))
