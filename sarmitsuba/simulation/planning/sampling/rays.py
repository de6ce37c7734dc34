"""Ray lattices of a run, with finer ones over small parts at their positions at each pulse.

The automatic ray spacing is refined by the measured sampling error, in place of a fixed number per wavelength;
spacings that are too large are warned of.
"""

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.simulation.execution.statistics import LatticeSpacings
from sarmitsuba.simulation.planning.sampling.chains import divide_cells, halve_spacing
from sarmitsuba.simulation.planning.sampling.density_plan import FINE_RAYS, SamplingPlan
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
                for _ in range(self.sampling.halvings):
                    grid = halve_spacing(grid)
                finer.append(grid)
            made.append(tuple(grid for grid in finer if grid.n_rays))
        self.shortfalls = tuple(short)
        return made


# dB, sampling error (energy over that of the echoes) up to which the automatic ray spacing is refined, and above which
# a result is doubtful
FINE_DB, POOR_DB = -30.0, -15.0
# dB below the first for which a spacing is chosen, since errors of single lattices vary by about that
MARGIN_DB = 2.0
# dB per decade of the ray spacing: the error's energy falls with its cube for almonds, ogives, spheres and cylinders of
# 3 to 6 wavelengths (`tests/scene/test_ray_density.py`)
SLOPE_DB = 30.0
# least and greatest refinement in one step
LEAST_STEP, MOST_STEP = 2.0**0.5, 6.0
# most rays of a refined sweep, over all directions: about 20 CPU seconds
MOST_TRACED = 1e8


def fitting_spacing(error_db: float, spacing: float) -> float:
    """Ray spacing, m, at which the sampling error should be below ``FINE_DB``, from the error at another spacing."""
    return float(spacing * 10.0 ** ((FINE_DB - MARGIN_DB - error_db) / SLOPE_DB))


def finer_spacing(error_db: float, spacing: float, least: float) -> float:
    """Next ray spacing, m, on the way to ``FINE_DB``; ``spacing`` itself where the error is low or ``least`` too near.

    Parameters
    ----------
    error_db : sampling error at ``spacing``, dB
    spacing : m
    least : m, that the bound on rays allows
    """
    if error_db <= FINE_DB:
        return spacing
    wanted = min(max(fitting_spacing(error_db, spacing), spacing / MOST_STEP), spacing / LEAST_STEP)
    finer = max(wanted, least)
    # a smaller step changes the error by less than its own uncertainty
    return finer if finer * LEAST_STEP <= spacing * 1.001 else spacing


def worst(errors_db: Iterable[float]) -> float:
    """Largest sampling error of the channels with echoes, dB; -inf without echoes."""
    return max((error for error in errors_db if not math.isnan(error)), default=-math.inf)


def error_text(name: str, error_db: float, spacing: float, wavelength: float, given: bool) -> str:
    """Note on a sampling error above ``FINE_DB`` with its remedy; empty below.

    Parameters
    ----------
    name : of the scene
    error_db : sampling error at ``spacing``, dB
    spacing, wavelength : m
    given : whether the user has set the spacing
    """
    if error_db <= FINE_DB:
        return ""
    wanted = fitting_spacing(error_db, spacing)
    said = f"{name}: the sampling error is {error_db:.1f} dB with rays {spacing / wavelength:.2g} wavelengths apart"
    remedy = f"the bound on rays; set ray_spacing to about {wanted:.2g} m for {FINE_DB:g} dB"
    if given:
        remedy = "as set; leave ray_spacing out, and rays are as dense as the target needs"
    doubt = "; single directions are several dB off" if error_db > POOR_DB else ""
    return f"{said}, {remedy}{doubt}"


# share of the surface that is too coarsely sampled, and bias of its coherent return, that give a warning
SMALL_SHARE = 0.01
SMALL_BIAS_DB = 1.0
# ray spacing in wavelengths from which shadows and reflections of small objects may be wrong by dB (of 53 random
# scenes all with an error above 0.5 dB had a spacing of 1.7 wavelengths or more)
WIDE_TUBE = 1.5
# ray spacing in wavelengths below which no run is advised: the rays would be more than any machine traces
_FINEST = 0.05


def check_sampling(sampling: SamplingPlan, spacings: LatticeSpacings) -> list[str]:
    """Warn of ray spacings too large for the resolution; returns the warnings' texts."""
    notes = [f"{sampling.scene.name}: {text}" for text in _too_wide(sampling, spacings)]
    for note in notes:
        warnings.warn(note, SarmitsubaWarning, stacklevel=4)
    return notes


def _too_wide(sampling: SamplingPlan, spacings: LatticeSpacings) -> Iterator[str]:
    coherent, half_cell = spacings.of_coherent, sampling.half_cell
    if coherent > 1.01 * half_cell:
        yield (
            f"ray_spacing = {coherent:g} m is coarser than half a resolution cell; "
            f"set it to {half_cell:.3g} m or less"
        )
    wavelength, scene = sampling.scene.radar.waveform.wavelength, sampling.scene
    affordable = sampling.window.area <= FINE_RAYS * sampling.fine_spacing**2
    several = len(scene.geometry.mesh_names) > 1
    if sampling.flags.coherent and several and affordable and coherent > WIDE_TUBE * wavelength:
        yield (
            f"ray_spacing = {coherent:g} m is {coherent / wavelength:.1f} wavelengths: echoes of objects that shadow "
            f"or mirror each other may be several dB off; leave it out, or set it to {sampling.fine_spacing:.2g} m, "
            "which needs few rays here"
        )
    wanted = sampling.footprint_spacing
    if spacings.diffuse > 1.5 * wanted:
        yield (
            f"diffuse_ray_spacing = {spacings.diffuse:g} m is coarser than a resolution cell: edges of shadows become "
            f"ragged; set it to {wanted:.3g} m or less"
        )


def check_small_parts(sampling: SamplingPlan, shortfalls: Sequence[Shortfall]) -> list[str]:
    """Warn of surface that is too coarsely sampled because of the bound on rays; returns the warnings' texts.

    Corners of metal facets that lack rays give a note without a warning: two lattices share a part of their error, so
    that the stated sampling error may be several dB too low, and the note says so.
    """
    notes = (
        [_coarse_corners(sampling, max(corners, key=lambda s: s.share))]
        if (corners := [s for s in shortfalls if s.corners])
        else []
    )
    notes += [_coarse_chains(sampling, s) for s in shortfalls if s.chains][:1]
    worst = max(shortfalls, key=lambda s: s.bias_db, default=None)
    if worst is None or worst.share < SMALL_SHARE or worst.bias_db < SMALL_BIAS_DB:
        return notes
    text = (
        f"{sampling.scene.name}: {100 * worst.share:.0f} % of the surface is too small or too curved for the rays that "
        f"fit the bound on rays, {worst.spacing:.3g} m apart: its coherent return is up to {worst.bias_db:.0f} "
        f"dB too strong; set ray_spacing to {worst.needed:.2g} m, or make the image smaller"
    )
    warnings.warn(text, SarmitsubaWarning, stacklevel=4)
    return [text, *notes]


def _coarse_chains(sampling: SamplingPlan, short: Shortfall) -> str:
    fine = short.needed >= _FINEST * sampling.scene.radar.waveform.wavelength
    remedy = f"set ray_spacing to {short.needed:.2g} m, or make" if fine else "make"
    return (
        f"{sampling.scene.name}: curved or small surfaces that rays meet after a reflection are too large for the "
        f"bound on rays: tubes there are {short.spacing:.3g} m wide; {remedy} the image smaller"
    )


def _coarse_corners(sampling: SamplingPlan, short: Shortfall) -> str:
    wavelength = sampling.scene.radar.waveform.wavelength
    return (
        f"{sampling.scene.name}: metal facets at right angles ({100 * short.share:.2g} % of the surface) are too large "
        f"for the bound on rays: their double bounces, with rays {short.spacing / wavelength:.1f} wavelengths apart, "
        f"may be several dB off, more than the stated sampling error says; set ray_spacing to {short.needed:.2g} m, or "
        "make the image smaller"
    )
