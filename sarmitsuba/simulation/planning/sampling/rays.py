"""Ray lattices of a run, with finer ones over small parts at their positions at each pulse."""

from dataclasses import replace

import numpy as np

from sarmitsuba.simulation.planning.sampling.chains import divide_cells, halve_spacing
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.launch_window import bounding_antennas
from sarmitsuba.simulation.planning.sampling.small_parts import Shortfall, add_small_parts, coarse_corners
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.scene_tables import TraceScene


class Rays:
    """Ray lattices of every subset of a run.

    Parameters
    ----------
    sampling : plan of the run
    trace_scene : traced geometry
    subsets : of the rays, by their numbers in ``SUBSET_SHARES``
    pass_index : other values shift the lattices only
    max_depth : most bounces

    Attributes
    ----------
    shortfalls : surface for which the most recent lattices are too coarse, mid-aperture
    """

    def __init__(
        self,
        sampling: SamplingPlan,
        trace_scene: TraceScene,
        subsets: tuple[int, ...],
        pass_index: int,
        max_depth: int,
    ) -> None:
        self.sampling, self.trace_scene, self.max_depth = sampling, trace_scene, max_depth
        self.realisations = [(subset, subset + 2 * pass_index) for subset in subsets]
        self.plain = [
            sampling.lattices(realisation=realisation, subset=subset)
            for subset, realisation in self.realisations
        ]
        self.shortfalls: tuple[Shortfall, ...] = ()
        self._made: tuple[float | None, list[tuple[LaunchGrid, ...]]] | None = None

    @property
    def n_subsets(self) -> int:
        """Number of ray subsets."""
        return len(self.realisations)

    def at(self, pulse: int) -> list[tuple[LaunchGrid, ...]]:
        """Lattices of every subset for a pulse: the same for all where nothing moves."""
        movers = self.trace_scene.movers
        time = None if movers is None else float(self.sampling.scene.radar.track.time[pulse])
        if self._made is None or self._made[0] != time:
            scene = self.trace_scene
            if movers is not None and time is not None:
                scene = replace(scene.at(time), triangles=movers.at(time).corners())
            self._made = (time, self._refine_lattices(scene))
        return self._made[1]

    def _refine_lattices(self, scene: TraceScene) -> list[tuple[LaunchGrid, ...]]:
        """Plain lattices with finer ones over small parts; the nodes do not depend on the positions of moving parts."""
        track, seed = self.sampling.scene.radar.track, self.sampling.scene.settings.seed & 0x7FFFFFFF
        made, short = [], []
        for (_, realisation), grids in zip(self.realisations, self.plain, strict=True):
            rng = np.random.default_rng([seed, realisation, 0x50A1])
            finer: list[LaunchGrid] = []
            for one in grids:
                pulses, frame = one.pulses or (0, track.n_pulses), one.frame or self.sampling.window.frame
                antennas = bounding_antennas(track, pulses)
                grid, missed = add_small_parts(one, scene, frame, antennas, rng)
                if one.serves(track.center_index):
                    short += [] if missed is None else [missed]
                    if self.sampling.flags.multi_bounce:
                        short += coarse_corners(grid, scene, frame, antennas)
                if self.sampling.flags.multi_bounce:
                    radar = self.sampling.scene.radar
                    wavelength = radar.waveform.wavelength
                    grid, missed = divide_cells(
                        grid, scene, frame, antennas, wavelength, self.max_depth, radar.antenna
                    )
                    if missed is not None and one.serves(track.center_index):
                        short.append(missed)
                for _ in range(self.sampling.halvings if grid.purpose != "diffuse" else 0):
                    grid = halve_spacing(grid)
                finer.append(grid)
            made.append(tuple(grid for grid in finer if grid.n_rays))
        self.shortfalls = tuple(short)
        return made
