"""Raw data of ideal points, and how they change with the radar: differences of their closed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track_errors import turn_axes
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw.raw_data import Layer
from sarmitsuba.simulation.execution.points import add_points

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene

# steps: of phase, rad; of the range, in range cells; of the beam, in half-power half-widths
PHASE_STEP, CELL_STEP, BEAM_STEP = 0.05, 0.02, 0.02


@dataclass(frozen=True, eq=False)
class PointChanges:
    """Echoes of the ideal points of a scene, which no other parameter than the radar's changes.

    Parameters
    ----------
    scene, flags, trace_scene, sub_bands : see :func:`sarmitsuba.simulation.execution.points.add_points`
    layers : labels of the data

    Notes
    -----
    Derivatives are differences of fourth order of closed forms, 1e-5 of the norm. They ignore that shapes which move
    may uncover points.
    """

    scene: Scene
    flags: KernelFlags
    trace_scene: TraceScene | None
    layers: Sequence[Layer]
    sub_bands: int

    def add(self, data: C64) -> None:
        """Add the echoes to data (channels, pulses, samples), in place."""
        if self.scene.points:
            add_points(self.scene, self.flags, self.trace_scene, data, self.layers, self.sub_bands)

    def _difference(self, changed: Callable[[float], Radar], step: float) -> C128:
        """Derivative by a number of which the radar is a function."""
        radar = self.scene.radar
        shape = len(self.layers), radar.track.n_pulses, radar.window.n_samples
        total = np.zeros(shape, dtype=np.complex128)
        for steps, weight in ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0)):
            data = np.zeros(shape, dtype=np.complex64)
            replace(self, scene=replace(self.scene, radar=changed(steps * step))).add(data)
            total += weight * data
        return np.asarray(total / (12.0 * step))

    def by_antenna(self, direction: F64, aside: F64) -> C128:
        """Derivative by a displacement of the antenna, (3,) m per unit, with the beam kept on the scene.

        ``aside`` : angle per m, see :class:`sarmitsuba.apps.fit.parameter.Derivatives`
        """
        radar = self.scene.radar
        angles, n = -(aside @ direction).T, len(radar.tracks)

        def changed(x: float) -> Radar:
            moved = radar.displaced(*[x * direction] * n)
            return replace(moved, pointing=turn_axes(radar.pointing, x * angles))

        step = PHASE_STEP * radar.waveform.wavelength / (4.0 * np.pi) / float(np.linalg.norm(direction))
        return self._difference(changed, step)

    def by_range(self, data: C64) -> C128:
        """Derivative by a slant range common to all points, per m; ``data``: of the points alone."""
        radar = self.scene.radar
        window = radar.window

        def changed(x: float) -> Radar:
            return replace(radar, window=replace(window, start_range=window.start_range - x))

        envelope = self._difference(changed, CELL_STEP * radar.waveform.range_cell)
        return np.asarray(
            envelope
            - 4j * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT * data.astype(np.complex128)
        )

    def by_pointing(self, axis: int) -> C128:
        """Derivative by the angle of the beam in azimuth (0) or elevation (1), per rad."""
        radar = self.scene.radar

        def changed(x: float) -> Radar:
            angles = np.zeros((radar.track.n_pulses, 2))
            angles[:, axis] = x
            return replace(radar, pointing=turn_axes(radar.pointing, angles))

        return self._difference(changed, BEAM_STEP / radar.antenna.per_width[axis])
