"""Base class of the frequency-domain focusers: focusing, memory and processor time."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import CALL_SECONDS, WEIGHT_SECONDS, Focused, Focuser, FocusTask
from sarmitsuba.signal.focusing.frequency_domain.equivalent_track import EquivalentTrack
from sarmitsuba.signal.focusing.frequency_domain.rows import RowsImaging
from sarmitsuba.signal.focusing.frequency_domain.stated import spectrum_rows, spectrum_work
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import (
    own_apertures,
    rate_factor,
    slant_grid,
    track_geometry,
)
from sarmitsuba.signal.focusing.frequency_domain.turning import TurningBeam, hold_beam, range_blocks, turns
from sarmitsuba.signal.focusing.frequency_domain.weights import NODES
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid

# bytes of a slant pixel: while its calibration is made in float64, that calibration, and its product with a layer
_PLANNED, _CALIBRATION, _SCALED = 33, 8, 20
# of a pixel and layer, and of a sample of the spectrum before and after a transform
_COMPLEX, _TRANSFORMED = 8, 16
# of a slant and of a ground pixel and layer while one becomes the other: both, and both in the product's order
_RESAMPLED = 16
# of the threads' buffers, in use or not yet released, independent of the sizes
_THREADS = 70_000_000


class RowsFocuser(Focuser, ABC):
    """A focuser by :class:`sarmitsuba.signal.focusing.frequency_domain.rows.RowsImaging`.

    Attributes
    ----------
    sample_seconds : CPU seconds of a sample of the spectrum or of a pixel on its way, see benchmarks/suite/focusers.py
    """

    sample_seconds: ClassVar[float]

    @abstractmethod
    def imaging(self, task: FocusTask) -> RowsImaging:
        """Linear map from data to pixels."""

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        radar, window = task.raw.radar, task.azimuth_window
        if not turns(radar):
            imaging = self.imaging(task)
            return Focused(imaging.forward(task.raw.data), imaging.pulse_weights)
        beam = TurningBeam.of(radar, task.grid)
        parts = [self._sum_turning(replace(task, grid=grid)) for grid in range_blocks(radar, task.grid)]
        pixels = np.concatenate(parts, axis=2)
        pixels *= beam.scale(task.grid, window).astype(np.float32)
        return Focused(pixels, lambda point: beam.pulse_weights(point, window))

    def _sum_turning(self, task: FocusTask) -> C64:
        """Sums over the pulses, not divided by their weights, of a part of an image that is lit in turn.

        By a beam that turns, or from a curved track.
        """
        raw, radar, grid, window = task.raw, task.raw.radar, task.grid, task.azimuth_window
        track = None if radar.track.is_straight else EquivalentTrack.of(radar, grid)
        if track is not None:
            raw, grid = replace(raw, radar=track.straight), track.straight_grid
        dense = TurningBeam.of(raw.radar, grid)
        even = replace(
            task, grid=grid, raw=dense.unfold(raw, window), azimuth_window=parse_window("rectangular")
        )
        pixels = self.imaging(even).forward(even.raw.data)
        pixels *= np.float32(dense.dense.size / dense.factor)
        return pixels if track is None else track.resample(pixels, grid)

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Processor time: the algorithm's rate times the common work."""
        taken = CALL_SECONDS + self.sample_seconds * spectrum_work(radar, grid)
        if radar.antenna.directive and not own_apertures(radar):
            taken += WEIGHT_SECONDS * radar.track.n_pulses * NODES
        return taken

    def making_bytes(self, radar: Radar, grid: ImageGrid, n_layers: int) -> int:
        """Peak memory in bytes while the pixels are made, pixels included."""
        radar, slant = hold_beam(radar, slant_grid(radar, grid))
        geometry = track_geometry(radar, slant)
        dense = replace(geometry, spacing=geometry.spacing / rate_factor(radar, slant, geometry)[0])
        rows, mapped = (int(n) for n in spectrum_rows(radar, slant, dense))
        pixels = slant.azimuth.size * slant.range.size
        band = int(radar.window.n_samples * radar.waveform.bandwidth / radar.window.sampling_rate)
        made = (_CALIBRATION + _COMPLEX * n_layers) * pixels
        stages = [
            _PLANNED * pixels,
            made + _TRANSFORMED * rows * band + _COMPLEX * mapped * slant.range.size,
            made + _SCALED * pixels,
        ]
        if grid.kind == "ground":
            ground = grid.azimuth.size * grid.range.size
            stages.append(_CALIBRATION * pixels + _RESAMPLED * n_layers * (pixels + ground))
        return max(stages) + _THREADS
