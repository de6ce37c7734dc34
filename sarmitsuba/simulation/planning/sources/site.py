"""Input for making sources: a scene with its sampling and antenna positions."""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.effects.context import PairLevel
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.fold_sections import Folds
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.error_statement import followed_folds
from sarmitsuba.simulation.planning.sampling.cropping import shares
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.launch_window import LaunchWindow
from sarmitsuba.tracing.kernel.launch import project
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.scatterers.edges.fold_waves import FoldWaves
from sarmitsuba.tracing.scatterers.wires.wire_nodes import longest_step

# antenna positions from which folds are examined
MOST_LOOKS = 1000
# least number of antenna positions for the visibility of pairs, and rad of rotation of the line of sight per position
LEAST_VIEWS, VIEW_TURN = 3, np.radians(5.0)


class Site(ABC):
    """Scene with the quantities from which sources are made.

    Parameters
    ----------
    scene : with the effects plan applied
    flags : of the trace kernel
    trace_scene : geometry on the device; None: sources that need it are left out
    pairs : level of pairs of diffuse scatterers, where it is known
    """

    def __init__(
        self,
        scene: Scene,
        flags: KernelFlags,
        trace_scene: TraceScene | None = None,
        pairs: PairLevel | None = None,
    ) -> None:
        self.scene, self.flags, self.trace_scene, self.pairs = scene, flags, trace_scene, pairs

    @property
    def wavelength(self) -> float:
        """Wavelength of the carrier, m."""
        return self.scene.radar.waveform.wavelength

    @property
    @abstractmethod
    def wire_step(self) -> float:
        """Largest distance between the nodes of wires, m."""

    @property
    @abstractmethod
    def cell_area(self) -> float:
        """Area of the resolution cell perpendicular to the elevation direction, m^2."""

    @property
    @abstractmethod
    def edges(self) -> SharpEdges:
        """Sharp metal edges of the scene, in pieces."""

    @cached_property
    def folds(self) -> Folds:
        """Folds whose waves are followed beyond rays; none without edges' waves, or with a receiver apart."""
        return followed_folds(self.scene, self.flags, self.wavelength)

    @cached_property
    def fold_waves(self) -> FoldWaves | None:
        """Waves of the folds, which several tracings share; None without any."""
        if not self.folds.n:
            return None
        towards = self.towards(self.folds.middle.mean(axis=0))
        waves = FoldWaves(self.folds, self.wavelength, towards, 0.5 * self.resolution)
        return waves if waves.n else None

    def towards(self, point: F64) -> F64:
        """Unit vectors (n, 3) from a point to the antenna along the track, at most ``MOST_LOOKS``."""
        position = self.scene.radar.track.position
        step = -(-len(position) // MOST_LOOKS)
        away = np.concatenate([position[::step], position[-1:]]) - point
        return unit_rows(away)

    @property
    @abstractmethod
    def box(self) -> F64:
        """Bounds of the lit part of the scene, (2, 3) m."""

    @property
    @abstractmethod
    def center(self) -> F64:
        """Centre of the lit part of the scene, (3,) m."""

    @property
    @abstractmethod
    def views(self) -> F64:
        """Antenna positions (n, 3) m, in turn, the middle one in the middle."""

    @property
    @abstractmethod
    def scatterer_cell(self) -> float:
        """Edge of the cells that carry one diffuse scatterer, m."""

    @property
    @abstractmethod
    def resolution(self) -> float:
        """Edge of a resolution cell on the ground, m."""

    @property
    @abstractmethod
    def block(self) -> int:
        """Most pulses that share one tracing; 1 where every pulse or aspect is traced."""

    @abstractmethod
    def shares(self, points: F64) -> F64:
        """Amplitude factor (n,) of scatterers at points (n, 3) m, tapered beyond a cropped image."""

    @abstractmethod
    def light(self, points: F64) -> F64:
        """Amplitude (n,) of the launch window at points (n, 3) m."""


class RunSite(Site):
    """The site of a run.

    Parameters
    ----------
    sampling : plan of the run
    flags : of the trace kernel; None: those of the plan
    trace_scene, pairs : see :class:`Site`
    """

    def __init__(
        self,
        sampling: SamplingPlan,
        flags: KernelFlags | None = None,
        trace_scene: TraceScene | None = None,
        pairs: PairLevel | None = None,
    ) -> None:
        super().__init__(sampling.scene, flags or sampling.flags, trace_scene, pairs)
        self.sampling = sampling

    @property
    def wire_step(self) -> float:
        """See :class:`Site`."""
        sampling, radar = self.sampling, self.scene.radar
        distance = min(
            float(np.linalg.norm(track.position - self.center, axis=1).min()) for track in radar.tracks
        )
        return longest_step(sampling.range_cell, sampling.azimuth_cell, distance, self.wavelength)

    @property
    def cell_area(self) -> float:
        """See :class:`Site`."""
        return self.sampling.azimuth_cell * self.sampling.range_cell

    @property
    def edges(self) -> SharpEdges:
        """See :class:`Site`."""
        return self.sampling.sharp_edges

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
            found.append(_faded(window, project(points, antenna, window.frame)))
        return np.asarray(np.max(found, axis=0))


def _faded(window: LaunchWindow, places: F64) -> F64:
    """Taper of the launch window at points (n, 2) of its plane.

    See :func:`sarmitsuba.tracing.kernel.antenna_weight.fade`.
    """
    if not window.taper:  # all of the scene lies within it
        return np.ones(len(places))
    beyond = np.abs(places) - [window.half_x, window.half_y]
    t = np.clip(beyond / window.taper, 0.0, 1.0)
    return np.asarray((0.5 + 0.5 * np.cos(np.pi * t)).prod(axis=1))
