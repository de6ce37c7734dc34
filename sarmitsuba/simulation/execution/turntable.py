"""Radar cross section of a target over aspect angles, and its inverse-SAR image from a sweep of azimuth.

Azimuth is counted from +x (east) towards +y (north) and elevation from the horizontal upwards, both of the direction
from the target to the radar. Phase is referred to the centre of all visible objects.
"""

import dataclasses
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.units import db_from_amplitude, db_from_power, power_from_db
from sarmitsuba.effects.catalog.full_wave import FULL_WAVE
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import plan_effects, remove_switch
from sarmitsuba.loading.assemble import seen_by
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.description import RadarDescription, RadarInput
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.round_facets import RoundFacets, smooth_geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.blame import check_traced
from sarmitsuba.simulation.execution.error_statement import SILENT_DB, ErrorStatement, say_sampling_error
from sarmitsuba.simulation.execution.points import PointEcho, PointLegs
from sarmitsuba.simulation.execution.rcs import (
    FAR,
    Aspects,
    BouncesLeft,
    FarSite,
    RcsResult,
    choose_probes,
    geometry_of,
    monostatic_rcs,
    outline_of,
    target_middle,
)
from sarmitsuba.simulation.execution.solved_currents import (
    WORTH_DB,
    FullWaveTarget,
    SolvedCurrents,
    solve_currents,
)
from sarmitsuba.simulation.planning.sampling.density_plan import FINE_RAYS, RAYS_PER_WAVELENGTH
from sarmitsuba.simulation.planning.sampling.rays import MOST_TRACED, finer_spacing, worst
from sarmitsuba.tracing.kernel.source import Source
from sarmitsuba.tracing.kernel.stage import STAGES
from sarmitsuba.tracing.scatterers.sources import measure_sources, notes_of, passages_of, sources_of

# cosine of the elevation below which H and V are defined by the azimuth, since the direction is nearly vertical
STEEP = 1e-3
# number of directions traced a second time, with other rays, for the sampling error
CHECKED = 24
# spacing of these rays relative to the first, and energy of the error relative to the difference, since a part of the
# error is common to both (benchmarks/suite/stated_errors.py --kind rcs)
OTHER_SPACING, ERROR_SHARE = 2.0**-0.5, 2.0
# wavelengths between facets and the smooth surface below which they change nothing, and most aspects that are traced on
# the smooth surface
NEGLIGIBLE_SAGITTA, SMOOTHED = 1.0 / 200.0, 16
# relative error energy of phases: sums of rays in float32, and wavefront curvature
ROUNDING = 10.0**-9.5


@dataclass(frozen=True, eq=False)
class RcsSweep:
    """Radar cross section of a scene over aspects.

    Parameters
    ----------
    aspects : directions to the radar
    frequency : Hz
    result : scattering amplitudes, bounce orders apart
    max_depth : bounces that were traced
    error_db : of every channel, energy of the sampling error relative to the echoes, dB; NaN where nothing is traced
    statement : of the error in dB by sampling, bounces left out and theory, or of the solved currents
    notes : one line each: assumptions
    currents : scattering amplitudes of solved surface currents, which the totals are then; None where they are the
        sums of the bounce orders, by ray optics
    """

    aspects: Aspects
    frequency: float
    result: RcsResult
    max_depth: int
    error_db: tuple[float, ...]
    statement: ErrorStatement
    notes: tuple[str, ...] = ()
    currents: SolvedCurrents | None = None

    @cached_property
    def total(self) -> C128:
        """Scattering amplitudes (n_directions, n_channels), m."""
        return self.result.amplitude.sum(axis=1) if self.currents is None else self.currents.amplitude

    @property
    def orders(self) -> tuple[int, ...]:
        """Bounce orders that have an echo."""
        power = np.abs(self.result.amplitude).max(axis=(0, 2))
        return tuple(int(i) + 1 for i in np.flatnonzero(power > 0.0))

    def dbsm(self, channel: str, order: int | None = None) -> F64:
        """RCS (n,), or that of one bounce order by ray optics, dB above 1 m^2; -inf without an echo."""
        i = self.result.channels.index(channel)
        return _level(self.total[:, i] if order is None else self.result.amplitude[:, order - 1, i])

    def ray_optics_dbsm(self, channel: str) -> F64:
        """RCS (n,) of all bounce orders by ray optics, also where currents are solved, dB above 1 m^2."""
        return _level(self.result.amplitude[:, :, self.result.channels.index(channel)].sum(axis=1))


@exclusive
def rcs_sweep(
    scene: Scene,
    aspects: Aspects,
    *,
    channels: tuple[str, ...] = (),
    checked: int = CHECKED,
    most_rays: int = FINE_RAYS,
    progress: Progress = silent,
) -> RcsSweep:
    """Radar cross section of a scene over aspects in the far field, with the effects that apply to the scene.

    Parameters
    ----------
    scene : geometry, materials, points, frequency, ``max_depth``, ``ray_spacing``, seed and switched effects are used;
        track, beam, power and noise are not
    aspects : directions to the radar
    channels : polarisations; empty: those of the scene's radar
    checked : approximate number of directions traced again for the sampling error; 0: none, the error is NaN, and the
        automatic ray spacing is not refined by it
    most_rays : of one direction, where the ray spacing is automatic
    progress : called after every launch

    Raises
    ------
    RadarError
        The direction is vertical: an azimuth sweep only rotates the polarisation; or ground is without end.

    Notes
    -----
    Small perfect conductors whose error by ray optics is above 0.5 dB have their surface currents solved
    (:mod:`.solved_currents`; effect ``full_wave``), where directions are checked. Others have the
    limitations of the kernel (no creeping waves, no waves between edges but those along sheets). Ground is part of the
    target, up to its edges. The automatic ray spacing is refined until the sampling error is below -30 dB,
    or until the rays of a direction (``most_rays``) or of the sweep (1e8) are spent; a larger error is noted, and
    warned of above -15 dB. Where directions are checked, a total error above 3 dB, with the theory's, is warned of.
    """
    if any(scene.geometry.mesh_endless):
        raise RadarError("rcs: ground without end has no cross section; leave radar_ground, or --ground, out")
    steep = np.cos(aspects.elevation) < STEEP
    if aspects.by_azimuth and steep.any():
        raise RadarError(
            f"rcs: from an elevation of {np.degrees(aspects.elevation[steep][0]):g} deg an azimuth sweep rotates only "
            "the polarisation; give an elevation between -89.9 and 89.9 deg"
        )
    ensure_backend()
    channels = channels or scene.radar.channels
    frequency = scene.radar.waveform.center_frequency
    switch = scene.settings.effects.get(FULL_WAVE, "auto")
    scene, flags, depth = _effects(remove_switch(scene, FULL_WAVE), aspects, channels)
    tracing = _AspectTracing(scene, flags, depth, most_rays, progress, FarSite(scene, flags, aspects))
    traced = tracing.first(aspects)
    currents: SolvedCurrents | str = "directions are not checked"
    if switch == "on" or checked:
        currents = _currents(scene, flags, aspects, switch, traced.result.amplitude, progress)
    if isinstance(currents, str) and scene.traced:
        traced = traced.checked(aspects, checked)
    result, errors, notes = traced.result, traced.errors, traced.notes
    points = _points(scene, flags, channels, aspects)
    result.amplitude[:, 0] += points
    check_traced(result.amplitude, 0.0, scene.name)
    statement = ErrorStatement.of(scene, flags, aspects.directions, result.amplitude, errors, traced.left_db)
    if isinstance(currents, str):
        statement, solved = statement.without_currents(currents), None
    else:
        solved = dataclasses.replace(currents, amplitude=currents.amplitude + points)
        check_traced(solved.amplitude, 0.0, scene.name)
        statement, errors = (
            statement.of_currents(solved.amplitude, solved.error, solved.text),
            solved.error_db,
        )
    if checked and scene.traced:
        statement = dataclasses.replace(statement, facets=traced.facet_error(aspects, solved))
    if checked and statement.warning:
        warnings.warn(f"{scene.name}: {statement.warning}", SarmitsubaWarning, stacklevel=2)
    return RcsSweep(aspects, frequency, result, result.max_depth, errors, statement, notes, solved)


def _level(amplitude: C128) -> F64:
    with np.errstate(divide="ignore"):
        return np.asarray(db_from_amplitude(np.abs(amplitude)))


def _currents(
    scene: Scene, flags: KernelFlags, aspects: Aspects, switch: str, amplitude: C128, progress: Progress
) -> SolvedCurrents | str:
    """Amplitudes from solved currents, or the reason why ray optics (``amplitude``, by bounce order) is kept."""
    target = FullWaveTarget.of(scene, flags, target_middle(scene)[0])
    why = target.refused(switch)
    if why:
        return why
    if switch != "on":
        none = (np.nan,) * amplitude.shape[2]
        theory = ErrorStatement.of(scene, flags, aspects.directions, amplitude, none, -np.inf).theory
        if not theory.unknown and theory.worst_db <= WORTH_DB:
            return f"ray optics is good to {WORTH_DB:g} dB"
    up = np.empty((aspects.azimuth.size, 3))
    for pick, vector in _uprights(aspects):
        up[pick] = vector
    return solve_currents(target, aspects.directions, up, flags.channels, switch == "on", progress)


@dataclass(frozen=True, eq=False)
class _AspectTracing:
    """Tracing of one scene at given aspects."""

    scene: Scene
    flags: KernelFlags
    depth: int
    most_rays: int
    progress: Progress
    site: FarSite

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """Sources of the scene at known positions (wires, edges, volumes, pairs)."""
        return sources_of(self.site)

    def first(self, aspects: Aspects) -> "_TracedAspects":
        """Amplitudes of all aspects by the rays of the plan, with as many bounces as count; zero without surfaces."""
        if not self.scene.traced:
            n, channels = aspects.azimuth.size, self.flags.channels
            none = np.zeros((n, self.depth, len(channels)), dtype=np.complex128)
            nothing = RcsResult(none, channels, 0, 0.0, self.depth, np.zeros(n, dtype=bool))
            return _TracedAspects(self, nothing, -np.inf, (np.nan,) * len(channels), ())
        tracing, result = self, self.amplitudes(aspects, 0)
        left = tracing.left(aspects, result.unfinished)
        if left is not None and not self.scene.settings.max_depth and left.depth > self.depth:
            tracing = dataclasses.replace(self, depth=left.depth)
            result = tracing.amplitudes(aspects, 0)
        notes: tuple[str, ...] = ()
        left_db = -np.inf
        if left is not None:
            notes, left_db = left.notes(self.scene.name, tracing.depth), left.after(tracing.depth)
        notes += tuple(f"{self.scene.name}: {note}" for note in notes_of(self.site))
        return _TracedAspects(tracing, result, left_db, (np.nan,) * len(self.flags.channels), notes)

    def amplitudes(self, aspects: Aspects, realisation: int) -> RcsResult:
        """Scattering amplitudes (n, depth, n_channels); other realisations have other rays."""
        parts = [
            (pick, self._trace(aspects.directions[pick], up, realisation)) for pick, up in _uprights(aspects)
        ]
        first = parts[0][1]
        amplitude = np.empty((aspects.azimuth.size, *first.amplitude.shape[1:]), dtype=np.complex128)
        unfinished = np.zeros(aspects.azimuth.size, dtype=bool)
        for pick, part in parts:
            amplitude[pick], unfinished[pick] = part.amplitude, part.unfinished
        return dataclasses.replace(first, amplitude=amplitude, unfinished=unfinished)

    def left(self, aspects: Aspects, unfinished: NDArray[np.bool_]) -> BouncesLeft | None:
        """Truncation error by later bounces, from some aspects with rays still active; None without such aspects."""
        if not unfinished.any():
            return None
        pick = choose_probes(unfinished)
        some = Aspects(aspects.azimuth[pick], aspects.elevation[pick])
        quiet = dataclasses.replace(self, progress=silent)
        return BouncesLeft.of(
            lambda depth: dataclasses.replace(quiet, depth=depth).amplitudes(some, 0).amplitude,
            self.depth,
            self.scene.settings.tolerance_db,
        )

    def refine(self, aspects: Aspects, first: RcsResult, checked: int) -> tuple[RcsResult, tuple[float, ...]]:
        """Amplitudes with a sampling error low enough where rays are automatic and enough, and the error, dB.

        The spacing is searched with the checked aspects alone; then all are traced again.
        """
        n, total = aspects.azimuth.size, first.amplitude.sum(axis=1)
        pick = np.unique([*np.arange(0, n, max(1, n // checked)), *np.abs(total).argmax(axis=0)])
        some = Aspects(aspects.azimuth[pick], aspects.elevation[pick])
        quiet = dataclasses.replace(self, progress=silent)
        found, spacing = total[pick], first.ray_spacing
        errors = quiet.errors(some, found, spacing)
        if self.scene.settings.ray_spacing:
            return first, errors
        most = min(self.most_rays, MOST_TRACED / (n + 4.0 * pick.size))
        least = spacing * float(np.sqrt(first.rays_per_direction / most))
        while (finer := finer_spacing(worst(errors), spacing, least)) < spacing:
            found = quiet.at(finer).amplitudes(some, 0).amplitude.sum(axis=1)
            better = quiet.errors(some, found, finer, 2)
            if worst(better) >= worst(errors):
                break
            spacing, errors = finer, better
        if spacing == first.ray_spacing:
            return first, errors
        return self.at(spacing).amplitudes(aspects, 0), errors

    def at(self, spacing: float) -> "_AspectTracing":
        """The same tracing with another ray spacing, m."""
        settings = dataclasses.replace(self.scene.settings, ray_spacing=spacing)
        return dataclasses.replace(self, scene=dataclasses.replace(self.scene, settings=settings))

    def errors(self, some: Aspects, total: C128, spacing: float, others: int = 1) -> tuple[float, ...]:
        """Relative error energy of ``total`` (n, n_channels), the sum of all orders at some aspects, dB.

        These are traced again with ``OTHER_SPACING`` times the ray spacing, which reveals most of the error common to
        lattices of one density; ``others``: number of such lattices, whose errors are averaged.
        """
        finer = self.at(OTHER_SPACING * spacing)
        energy, error = np.square(np.abs(total)).sum(axis=0), np.zeros(total.shape[1])
        for realisation in range(1, others + 1):
            other = finer.amplitudes(some, realisation).amplitude.sum(axis=1)
            error += np.square(np.abs(other - total)).sum(axis=0)
        error = ERROR_SHARE / others * error + ROUNDING * energy
        # a channel at rounding of another one has no echo whose error could be measured
        error = np.where(energy > power_from_db(SILENT_DB) * energy.max(initial=0.0), error, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            return tuple(float(v) for v in db_from_power(error / energy))

    def _trace(self, directions: F64, up: tuple[float, float, float], realisation: int) -> RcsResult:
        scene = self.scene
        return monostatic_rcs(
            scene.geometry,
            scene.materials,
            directions,
            scene.radar.waveform.center_frequency,
            channels=self.flags.channels,
            ray_spacing=scene.settings.ray_spacing,
            max_depth=self.depth,
            keep_orders=True,
            flags=self.flags,
            seed=scene.settings.seed,
            realisation=realisation,
            cell=self.site.scatterer_cell,
            up=up,
            days=scene.settings.pass_days,
            most_rays=self.most_rays,
            sources=self.sources,
            places=scene.source_places,
            passages=passages_of(scene),
            progress=self.progress,
        )


@dataclass(frozen=True, eq=False)
class _TracedAspects:
    """Traced amplitudes: tracing, result, energy of the bounces left out (dB), sampling errors (dB), and notes."""

    tracing: _AspectTracing
    result: RcsResult
    left_db: float
    errors: tuple[float, ...]
    notes: tuple[str, ...]

    def checked(self, aspects: Aspects, checked: int) -> "_TracedAspects":
        """With the sampling error of about ``checked`` directions, and rays refined by it; 0: none."""
        result, errors = self.result, self.errors
        said: tuple[str, ...] = ()
        if checked:
            result, errors = self.tracing.refine(aspects, result, checked)
            said = say_sampling_error(self.tracing.scene, result.ray_spacing, errors)
        notes = _notes(self.tracing.scene, result.ray_spacing) + self.notes + said
        return dataclasses.replace(self, result=result, errors=errors, notes=notes)

    def facet_error(self, aspects: Aspects, solved: SolvedCurrents | None) -> F64 | None:
        """Energy (n_channels,) m^2 of the error by facets of round metal in a direction; None without such ones.

        Measured: some of the aspects are traced on the smooth surface through the corners of the facets. Of solved
        currents by law.
        """
        scene, tracing = self.tracing.scene, self.tracing
        wavelength = scene.radar.waveform.wavelength
        found = RoundFacets.of(scene.geometry, scene.materials, wavelength)
        if not (found.sagitta > NEGLIGIBLE_SAGITTA).any() or scene.geometry.corner_values:
            return None
        if solved is not None:
            return np.asarray(
                power_from_db(found.error_db) * np.square(np.abs(solved.amplitude)).mean(axis=0)
            )
        smooth = dataclasses.replace(
            scene, geometry=smooth_geometry(scene.geometry, 0.5 * NEGLIGIBLE_SAGITTA * wavelength)
        )
        n = aspects.azimuth.size
        pick = np.sort(np.random.default_rng(0).permutation(n)[:SMOOTHED])
        some = Aspects(aspects.azimuth[pick], aspects.elevation[pick])
        other = dataclasses.replace(
            tracing, scene=smooth, progress=silent, site=FarSite(smooth, tracing.flags, aspects)
        ).at(self.result.ray_spacing)
        total = self.result.amplitude[pick].sum(axis=1)
        return np.asarray(
            np.square(np.abs(other.amplitudes(some, 0).amplitude.sum(axis=1) - total)).mean(axis=0)
        )


def _effects(scene: Scene, aspects: Aspects, channels: tuple[str, ...]) -> tuple[Scene, KernelFlags, int]:
    """Scene, kernel flags and largest number of bounces, from the effects plan of a radar at these aspects."""
    center, radius = target_middle(scene)
    position = center + aspects.directions * max(FAR * radius, 1.0)
    # the target rotates, the antenna is at rest
    track = Track(np.arange(float(len(position))), position, np.zeros_like(position))
    geometry = AimGeometry(center, position[0], np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    radar = dataclasses.replace(
        scene.radar,
        track=track,
        pointing=MODES["spotlight"].pointing(track, geometry),
        window=dataclasses.replace(scene.radar.window, start_range=np.zeros(len(position))),
        antenna=Antenna(),
        channels=channels,
        noise_temperature=0.0,
        chain=None,
        emitters=None,
        recorded=None,
        receiver=None,
        receiver_pointing=None,
    )
    settings = dataclasses.replace(scene.settings, method="hybrid")
    turned = dataclasses.replace(scene, radar=radar, settings=settings)
    plan = plan_effects(turned, warn=False)
    plan = plan_effects(turned, measured=measure_sources(FarSite(scene, plan.flags, aspects)))
    near = {stage.name for stage in STAGES if not stage.in_far_field}
    flags = dataclasses.replace(
        plan.flags,
        channels=channels,
        taper=False,
        antenna_pattern=False,
        spreading=True,
        extra=plan.flags.extra - near,
    )
    kept = dataclasses.replace(scene, scatterers=plan.apply(scene).scatterers)
    return kept, flags, plan.max_depth


def _uprights(aspects: Aspects) -> Iterator[tuple[NDArray[np.intp], tuple[float, float, float]]]:
    """Groups of aspects with a common vertical reference of the polarisation: their indices, and the reference."""
    steep = np.sign(aspects.elevation) * (np.cos(aspects.elevation) < STEEP)
    for side in (0.0, 1.0, -1.0):
        pick = np.flatnonzero(steep == side)
        if not pick.size:
            continue
        azimuth = float(aspects.azimuth[pick[0]])
        up = (0.0, 0.0, 1.0)
        if side:
            up = (-side * float(np.cos(azimuth)), -side * float(np.sin(azimuth)), 0.0)
        yield pick, up


def _points(scene: Scene, flags: KernelFlags, channels: tuple[str, ...], aspects: Aspects) -> C128:
    """Amplitudes (n, n_channels) of the ideal points, with occlusion by meshes and transmission through slabs."""
    look = aspects.directions
    center, radius = target_middle(scene)
    wavelength = scene.radar.waveform.wavelength
    total = np.zeros((look.shape[0], len(channels)), dtype=np.complex128)
    trace_scene = geometry_of(scene) if scene.points else None
    far = max(FAR * radius, 1.0)
    for point in scene.points:
        phase = 4.0 * np.pi / wavelength * (look @ (point.position - center)) + point.phase
        for pick, up in _uprights(aspects):
            here = np.broadcast_to(point.position, (pick.size, 3))
            legs = PointLegs.of(trace_scene, flags, wavelength, here, center + far * look[pick], up)
            value = np.sqrt(point.rcs) * np.exp(1j * (phase[pick] - 4.0 * np.pi / wavelength * legs.delay))
            distance = far - look[pick] @ (point.position - center)
            echo = PointEcho(distance, np.zeros(pick.size), value, (legs, legs))
            echo = echo.through_stages(flags, wavelength, here)
            total[pick] += np.stack([echo.channel(c) for c in channels], axis=1)
    return total


def _notes(scene: Scene, spacing: float) -> tuple[str, ...]:
    """Notes on ray spacings larger than small and curved parts need."""
    wavelength = scene.radar.waveform.wavelength
    if spacing <= 1.001 * wavelength / RAYS_PER_WAVELENGTH:
        return ()
    return (
        f"{scene.name}: rays are {spacing / wavelength:.2g} wavelengths apart, where small and curved parts need "
        f"{1.0 / RAYS_PER_WAVELENGTH:.2g}; the stated sampling error includes this. Set ray_spacing for another value",
    )


__all__ = ["Aspects", "RcsSweep", "rcs_sweep"]


# resolution cells over the target's diameter, and bandwidth over frequency, where no bandwidth is given
CELLS_ACROSS, WIDEST_BAND = 48.0, 0.4
# aspects of an image relative to the number needed for the target's width, and the largest number
ASPECT_MARGIN, MOST_ASPECTS = 1.25, 4096
# pixel spacing over the Nyquist spacing
PIXEL_FILL = 0.5
# arbitrary speed along the arc
PULSES_PER_SECOND = 100.0
# rad; elevations for which images are made: not from below, nor from straight above, where the target only rotates
LOWEST, HIGHEST = 0.0, float(np.radians(80.0))
# rad; an antenna in the plane of the image is raised by this much
RAISED = 1e-4
# rad; least range of azimuth for an image
LEAST_TURN = float(np.radians(1.0))
# widest step of a turn: aspects farther apart are single ones, whose image takes hundreds of times their own rays
WIDEST_STEP = float(np.radians(5.001))
# steps of a sweep over the lobes of a body, from which on a note says so: some lobes are always missed at the limit
_STEPS_A_LOBE = 4.0


def undersampling(scene: Scene, aspects: Aspects) -> tuple[str, ...]:
    r"""Note on a sweep whose steps are wider than lobes of the body; empty where they are not.

    Lobes of a body of extent D across the line of sight repeat every :math:`\lambda / 2 D`; peaks between wider steps
    are missed.

    Parameters
    ----------
    scene : the target
    aspects : of the sweep
    """
    swept = aspects.azimuth if aspects.by_azimuth else aspects.elevation
    if swept.size < 2 or not scene.geometry.n_faces:
        return ()
    step = float(np.max(np.abs(np.diff(swept))))
    sides = np.ptp(scene.geometry.without_endless().bounds, axis=0)
    extent = float(np.hypot(sides[0], sides[1]) if aspects.by_azimuth else np.linalg.norm(sides))
    lobe = scene.radar.waveform.wavelength / (2.0 * max(extent, 1e-12))
    if step <= _STEPS_A_LOBE * lobe:
        return ()
    return (
        f"steps of {np.degrees(step):.3g} deg are wider than the lobes of a body of {extent:.3g} m, "
        f"{np.degrees(lobe):.2g} deg: the curve misses peaks between them; take steps of {np.degrees(lobe):.1g} deg",
    )


def image_refusal(aspects: Aspects) -> str:
    """Reason why the aspects give no image; empty where they do."""
    if not aspects.by_azimuth:
        return "only a sweep of azimuth gives an image"
    if np.ptp(aspects.azimuth) < LEAST_TURN:
        return f"the azimuth turns by less than {np.degrees(LEAST_TURN):g} deg"
    step = np.ptp(aspects.azimuth) / (aspects.azimuth.size - 1)
    if step > WIDEST_STEP:
        return f"aspects are {np.degrees(step):.3g} deg apart; steps of {np.degrees(WIDEST_STEP):.0f} deg give one"
    if not LOWEST <= aspects.elevation[0] <= HIGHEST:
        return f"the elevation is not within 0 to {np.degrees(HIGHEST):g} deg"
    return ""


def turntable_scene(
    scene: Scene, aspects: Aspects, *, channels: tuple[str, ...] = (), bandwidth: float = 0.0
) -> Scene:
    r"""Scene with a radar that flies the arc of an azimuth sweep: rendering it gives the target's inverse-SAR image.

    The arc is sampled without aliasing for a target of radius r, at the highest frequency:

    .. math:: \Delta \phi \le \frac{\lambda}{4 r \cos\epsilon}

    Parameters
    ----------
    scene : the target
    aspects : azimuth sweep, see :func:`image_refusal`
    channels : polarisations; empty: those of the scene's radar
    bandwidth : Hz; 0 = 48 cells over the target's diameter, at most 0.4 of the frequency

    Returns
    -------
    scene whose image plane is the horizontal plane through the target's middle; where the whole arc would need more
    than 4096 pulses, the pulses are those about the sweep's middle

    Notes
    -----
    The radar is a thousand radii away. If it lies in the image plane it is raised by 1e-4 rad.
    """
    scene = remove_switch(scene, FULL_WAVE)  # of the sweep alone
    center, radius = target_middle(scene)
    frequency = scene.radar.waveform.center_frequency
    width = float(np.linalg.norm((outline_of(scene) - center)[:, :2], axis=1).max())
    radius, width = max(radius, 1e-3), max(width, 1e-3)
    if not bandwidth:
        bandwidth = min(CELLS_ACROSS * SPEED_OF_LIGHT / (4.0 * radius), WIDEST_BAND * frequency)
    elevation = max(float(aspects.elevation[0]), RAISED)
    shortest = SPEED_OF_LIGHT / (frequency + 0.5 * bandwidth)
    margin = 1.0 + 32.0 / CELLS_ACROSS  # side lobes beside the target
    step = shortest / (4.0 * margin * width * np.cos(elevation)) / ASPECT_MARGIN
    first, last = float(aspects.azimuth.min()), float(aspects.azimuth.max())
    n = int(min(np.ceil((last - first) / step), MOST_ASPECTS - 1)) + 1
    middle, half = 0.5 * (first + last), 0.5 * min(last - first, (n - 1) * step)
    if aspects.whole_circle and n < MOST_ASPECTS:  # seen from the west in the middle, +x is right and +y up
        middle, half = np.pi, np.pi * (1.0 - 1.0 / n)
    azimuth = np.linspace(middle + half, middle - half, n)  # clockwise: the target lies to the right
    arc = Aspects(azimuth, np.full(n, elevation))
    position = center + scene.offset + FAR * radius * arc.directions
    track = Track.from_samples(np.arange(n) / PULSES_PER_SECOND, position)
    extent = 2.0 * margin * width
    longest = SPEED_OF_LIGHT / (frequency - 0.5 * bandwidth)
    spacing = _pixel_spacings(half, elevation, shortest, longest)
    description = RadarInput.of(
        RadarDescription(
            mode="spotlight",
            center_frequency=frequency,
            bandwidth=bandwidth,
            polarisation=",".join(channels or scene.radar.channels),
            aim_x=float(center[0] + scene.offset[0]),
            aim_y=float(center[1] + scene.offset[1]),
            aim_z=float(center[2] + scene.offset[2]),
        ),
        FilmDescription(
            image_grid="ground",
            image_center_x=float(center[0] + scene.offset[0]),
            image_center_y=float(center[1] + scene.offset[1]),
            image_height=float(center[2] + scene.offset[2]),
            image_extent_azimuth=extent,
            image_extent_range=extent,
            pixel_spacing_azimuth=spacing[0],
            pixel_spacing_range=spacing[1],
        ),
        track,
    )
    used = list_with_parts([scene.materials[i] for i in np.unique(scene.geometry.face_material)])
    radar, image, notes = seen_by(scene.name, scene.geometry, scene.places, used, description, scene.offset)
    return dataclasses.replace(scene, radar=radar, image=image, notes=notes, description=description)


def _pixel_spacings(half: float, elevation: float, shortest: float, longest: float) -> tuple[float, float]:
    r"""Pixel spacings (azimuth, range), m: ``PIXEL_FILL`` of the Nyquist spacing of the image's spectrum.

    Aspects :math:`|\phi| \le \phi_h` about the middle and wavelengths from the shortest to the longest fill

    .. math:: k_a = \pm \frac{4 \pi}{\lambda_s} \cos\epsilon \sin(\min(\phi_h, \pi / 2)), \quad
              \frac{4 \pi}{\lambda} \cos\epsilon \cos\phi_h \le k_r \le \frac{4 \pi}{\lambda_s} \cos\epsilon
    """
    unit = 2.0 * np.cos(elevation)  # cycles per metre times the wavelength
    along = 2.0 * unit / shortest * np.sin(min(half, 0.5 * np.pi))
    lowest = np.cos(min(half, np.pi))
    across = unit / shortest - unit * lowest / (longest if lowest > 0.0 else shortest)
    return float(PIXEL_FILL / along), float(PIXEL_FILL / across)
