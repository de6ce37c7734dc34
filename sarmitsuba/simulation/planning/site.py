"""The site of a run, from which its sources are made."""

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.simulation.planning.sampling.cropping import shares
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.launch_window import LaunchWindow
from sarmitsuba.tracing.kernel.launch import project
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.scatterers.sources import Site

# least number of antenna positions for the visibility of pairs, and rad of rotation of the line of sight per position
LEAST_VIEWS, VIEW_TURN = 3, np.radians(5.0)


class RunSite(Site):
    """The site of a run.

    Parameters
    ----------
    sampling : plan of the run
    flags : of the trace kernel; None: those of the plan
    trace_scene, measured : see :class:`Site`
    """

    def __init__(
        self,
        sampling: SamplingPlan,
        flags: KernelFlags | None = None,
        trace_scene: TraceScene | None = None,
        measured: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(sampling.scene, flags or sampling.flags, trace_scene, measured)
        self.sampling = sampling

    @property
    def cells(self) -> tuple[float, float]:
        """See :class:`Site`."""
        return self.sampling.range_cell, self.sampling.azimuth_cell

    @property
    def distance(self) -> float:
        """See :class:`Site`."""
        tracks = self.scene.radar.tracks
        return min(float(np.linalg.norm(track.position - self.center, axis=1).min()) for track in tracks)

    @property
    def cell_area(self) -> float:
        """See :class:`Site`."""
        return self.sampling.azimuth_cell * self.sampling.range_cell

    @property
    def half_cell(self) -> float:
        """See :class:`Site`."""
        return self.sampling.half_cell

    @property
    def spacing(self) -> float:
        """See :class:`Site`."""
        return self.sampling.spacings.coherent

    @property
    def kept(self) -> dict[tuple[str, KernelFlags], object]:
        """See :class:`Site`; common to all sites of one sampling."""
        return self.sampling.kept

    @property
    def box(self) -> F64:
        """See :class:`Site`."""
        return self.sampling.box

    @property
    def center(self) -> F64:
        """See :class:`Site`."""
        return self.sampling.window.center

    @cached_property
    def views(self) -> F64:
        """See :class:`Site`; of both antennas where two fly."""
        views = []
        for track in self.scene.radar.tracks:
            line = self.center - track.position
            line = unit_rows(line)
            turn = float(np.arccos(np.clip(np.einsum("ij,ij->i", line[1:], line[:-1]), -1.0, 1.0)).sum())
            count = max(LEAST_VIEWS, int(np.ceil(turn / VIEW_TURN))) // 2
            n, middle = track.n_pulses, track.center_index
            before = np.linspace(0, middle, count + 1).round().astype(int)[:-1]
            after = np.linspace(middle, n - 1, count + 1).round().astype(int)[1:]
            views.append(track.position[[*before, middle, *after]])
        return np.stack(views, axis=1).reshape(-1, 3) if len(views) == 1 else np.concatenate(views)

    @property
    def scatterer_cell(self) -> float:
        """See :class:`Site`."""
        return self.sampling.scatterer_cell

    @property
    def resolution(self) -> float:
        """See :class:`Site`."""
        return self.sampling.for_effects().cell

    @property
    def block(self) -> int:
        """See :class:`Site`."""
        return 1 if self.scene.settings.method == "image" else self.sampling.key_pulse_interval

    def shares(self, points: F64) -> F64:
        """See :class:`Site`."""
        return shares(self.scene, points)

    def light(self, points: F64) -> F64:
        """See :class:`Site`: largest over the sectors."""
        if not self.flags.taper:
            return np.ones(len(points))
        track = self.scene.radar.track
        found = [np.zeros(len(points))]
        for window in self.sampling.windows:
            antenna = track.of_pulses(slice(*window.pulses)).center_position
            found.append(_taper_window(window, project(points, antenna, window.frame)))
        return np.asarray(np.max(found, axis=0))


def _taper_window(window: LaunchWindow, places: F64) -> F64:
    """Taper of the launch window at points (n, 2) of its plane.

    See :func:`sarmitsuba.tracing.kernel.antenna_weight.fade`.
    """
    if not window.taper:  # all of the scene lies within it
        return np.ones(len(places))
    beyond = np.abs(places) - [window.half_x, window.half_y]
    t = np.clip(beyond / window.taper, 0.0, 1.0)
    return np.asarray((0.5 + 0.5 * np.cos(np.pi * t)).prod(axis=1))
