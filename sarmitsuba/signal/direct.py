"""Direct accumulation: every path is spread onto the range grid of its own pulse."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.gridding import (
    FineGrid,
    GriddingKernel,
    fine_grid,
    gridding_kernel,
    to_window,
    to_window_adjoint,
)
from sarmitsuba.signal.pulse_motion import InPulse, widest_shift
from sarmitsuba.signal.sub_bands import RangeFilter


@dataclass(frozen=True, eq=False)
class DirectPlan:
    r"""Range grids of the pulses ``start:stop``, one per pulse.

    A path of slant range h(t) and amplitude a is added at pulse t (k counts from ``start``) as::

        x = (h(t) - range0[k]) / range_step
        grid[layer, k, i] += a exp(-j 4 pi fc h(t) / c) phi(x - i)

    Parameters
    ----------
    start, stop : first pulse and one past the last
    range0 : (stop - start,) float64, slant range of cell 0 at each pulse, m
    n_range : cells per pulse
    width : of the gridding kernel
    fine : resampling of the grid to the window's samples
    pulse_motion : motion of the antenna within the pulses; None: start-stop approximation
    """

    start: int
    stop: int
    range0: F64
    n_range: int
    width: int
    fine: FineGrid
    in_pulse: InPulse | None = None

    @property
    def range_step(self) -> float:
        """Cell of the grid, m."""
        return self.fine.range_step

    @property
    def n_pulses(self) -> int:
        """Number of pulses."""
        return self.stop - self.start

    @property
    def kernel(self) -> GriddingKernel:
        """Gridding kernel."""
        return gridding_kernel(self.width)

    def shape(self, n_layers: int) -> tuple[int, int, int]:
        """Shape of the complex64 grid, (n_layers, n_pulses, n_range)."""
        return (n_layers, self.n_pulses, self.n_range)


def box_distance(box: F64, position: F64) -> tuple[F64, F64]:
    """Least and greatest distance from antenna positions to an axis-aligned box.

    Parameters
    ----------
    box : (2, 3) float64, m, lower and upper corner
    position : (n, 3) float64, m

    Returns
    -------
    two (n,) float64, m
    """
    nearest = np.clip(position, box[0], box[1])
    farthest = np.where(position < 0.5 * (box[0] + box[1]), box[1], box[0])
    return np.linalg.norm(position - nearest, axis=-1), np.linalg.norm(position - farthest, axis=-1)


def box_slant_range(box: F64, radar: Radar, pulses: slice) -> tuple[F64, F64]:
    """Bounds of the slant ranges of a box, two (n_pulses,) float64, m; of two antennas the mean of both bounds."""
    bounds = [box_distance(box, track.position[pulses]) for track in radar.tracks]
    if len(bounds) == 1:
        return bounds[0]
    (a_near, a_far), (b_near, b_far) = bounds
    return 0.5 * (a_near + b_near), 0.5 * (a_far + b_far)


def plan_direct(
    radar: Radar, start: int, stop: int, box: F64, width: int = 4, extra_slant_range: float = 0.0
) -> DirectPlan:
    """Plan of the range grids of the pulses ``start:stop``.

    Parameters
    ----------
    radar : track, waveform and window
    start, stop : pulse indices
    box : (2, 3) float64, m, scene frame; bounds of all phase centres
    width : of the gridding kernel, 1 to 8
    extra_slant_range : half the largest extra path length by multiple reflections, m
    """
    cell, window = radar.waveform.range_cell, radar.window
    near, far = box_slant_range(np.asarray(box, dtype=np.float64), radar, slice(start, stop))
    shift = widest_shift(radar, np.asarray(box, dtype=np.float64), slice(start, stop))
    near, far = near - shift, far + extra_slant_range + shift
    first = window.start_range[start:stop]
    low = float((first - far).min()) - cell
    high = float((first - near).max()) + window.extent + cell
    kernel = gridding_kernel(width)
    n_least = int(np.ceil((far - near).max() / (0.5 * cell) * 1.05)) + 2 * kernel.margin + 2
    fine = fine_grid(cell, window.sample_spacing, low, high, n_least)
    n_range = int(np.ceil((far - near).max() / fine.range_step)) + 2 * kernel.margin + 2
    range0 = near - (kernel.margin + 0.5) * fine.range_step
    return DirectPlan(start, stop, range0, n_range, width, fine, InPulse.of(radar, slice(start, stop)))


def spread_reference(
    plan: DirectPlan, radar: Radar, slant_range: F64, amplitude: NDArray[np.complexfloating]
) -> C64:
    """Spread paths in NumPy as the tracing kernel does, for tests and small jobs.

    Parameters
    ----------
    slant_range : (n_paths, n_pulses) float64, m
    amplitude : (n_layers, n_paths) complex, sqrt(W)

    Returns
    -------
    (n_layers, n_pulses, n_range) complex64
    """
    kernel = plan.kernel
    wavenumber = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
    x = (slant_range - plan.range0) / plan.range_step + kernel.shift
    base = np.floor(x)
    taps = kernel.taps(x - base)
    phase_factor = np.exp(-1j * np.mod(wavenumber * slant_range, 2.0 * np.pi))
    cell = base.astype(np.int64) - kernel.lead + np.arange(plan.n_pulses) * plan.n_range
    grid = np.zeros((amplitude.shape[0], plan.n_pulses * plan.n_range), dtype=np.complex128)
    for layer, a in enumerate(amplitude):
        value = a[:, None] * phase_factor
        for k in range(kernel.width):
            np.add.at(grid[layer], cell + k, value * taps[k])
    return grid.reshape(plan.shape(len(amplitude))).astype(np.complex64)


def finish(
    grid: NDArray[np.complexfloating], plan: DirectPlan, radar: Radar, *, share: RangeFilter | None = None
) -> C64:
    """Range-compressed profiles from filled grids.

    Parameters
    ----------
    grid : (n_layers, n_pulses, n_range) complex
    share : factor on the spectrum, of one of several traced frequencies; None: one

    Returns
    -------
    (n_layers, n_pulses, n_samples) complex64 on ``radar.window``, see :class:`sarmitsuba.signal.raw_data.RawData`
    """
    offset = radar.window.start_range[plan.start : plan.stop] - plan.range0
    cell, n_samples = radar.waveform.range_cell, radar.window.n_samples
    return to_window(grid, offset, plan.fine, cell, n_samples, plan.kernel, share)


def finish_adjoint(profiles: C64, plan: DirectPlan, radar: Radar, *, share: RangeFilter | None = None) -> C64:
    """Adjoint of :func:`finish`: grids (n_layers, n_pulses, n_range) from profiles (n_layers, n_pulses, n_samples)."""
    offset = radar.window.start_range[plan.start : plan.stop] - plan.range0
    cell = radar.waveform.range_cell
    return to_window_adjoint(profiles, offset, plan.fine, cell, plan.n_range, plan.kernel, share)
