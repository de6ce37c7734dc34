"""Batches of pulses traced with the derivatives of every echo behind its channels."""

from __future__ import annotations

from functools import partial

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.signal.raw.sub_bands import RangeFilter
from sarmitsuba.simulation.execution.tracing import BatchTracer
from sarmitsuba.simulation.execution.tracing import KeyPulse, Pulses
from sarmitsuba.tracing.derivatives.tangents import Tangents


class TangentBatches(BatchTracer):
    """Tracing of batches with the derivatives of every echo behind its channels.

    The layers of a batch are the channels, their derivatives by a common slant range, by each displacement, by each
    level and by each property. In a block of pulses derivatives of range rates times the time from the key pulse belong
    to those by displacements.
    """

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: channels, and those of every derivative."""
        return super().amplitudes * self.tangents.recorded

    @property
    def tangents(self) -> Tangents:
        """Derivatives that are recorded."""
        assert isinstance(self.tracer.tangents, Tangents)
        return self.tracer.tangents

    def of_grid(self, pulses: Pulses, grid: C64, share: RangeFilter | None) -> C64:
        """See the base class."""
        tangents = self.tangents
        radar = self.tracer.sampling.scene.radar
        c = len(radar.channels)
        moved = c * (1 + len(tangents.displacements))
        carrier = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
        farther = pulses.profiles(grid[:moved], partial(make_range_derivative, carrier, share))
        parts = [pulses.profiles(grid[:c], share), farther]
        end = c * (1 + tangents.count)
        if end > moved:
            parts.append(pulses.profiles(grid[moved:end], share))
        if tangents.pointing and isinstance(pulses, KeyPulse) and pulses.beam:
            parts[-1][-2 * c : -c] += pulses.by_azimuth(grid[:c], share)
        if tangents.rates and isinstance(pulses, KeyPulse) and pulses.each > 1:
            # slant ranges within the block change by those of the key pulse and by the range rate's times the time
            turning = pulses.profiles(grid[end:], partial(make_range_derivative, carrier, share))
            farther[c:] += pulses.plan.tau.astype(np.float32)[:, None] * turning
        return np.concatenate(parts)


def make_range_derivative(carrier: float, share: RangeFilter | None, cycles_per_metre: F64) -> C128:
    """Factor on the spectrum of range profiles that differentiates by the slant range, rad/m."""
    factor = -1j * (carrier + 2.0 * np.pi * cycles_per_metre)
    return np.asarray(factor if share is None else factor * share(cycles_per_metre), dtype=np.complex128)
