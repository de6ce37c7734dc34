"""Pilot trace: echo power by bounce order, from a few per cent of the rays at a few pulses of the aperture.

Rays are launched in square patches about as large as a resolution cell and as dense as in the full run, so that every
patch has the coherent sum of one pixel. Most patches are at random positions; the others are on small features of the
geometry (separate pieces, concave edges) that random ones would miss. Patches are tapered towards their edge, else the
edge of a patch on a smooth plane would give an echo that the plane does not have.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.timing import Clock
from sarmitsuba.effects.context import KINDS, PilotResult, SceneContext
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan, plan_effects
from sarmitsuba.effects.shape import ShapeAnalysis
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.polarisation import linear_letters
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.in_phase import PatchReturns, azimuth_bin, measure_in_phase
from sarmitsuba.simulation.execution.tracing import AntennaStates, polarisation_up, pulse_batch
from sarmitsuba.simulation.planning.prediction.speed import run_seconds
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.kernel.accumulators import phase_factor
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.kernel import KernelSettings, trace
from sarmitsuba.tracing.kernel.launch import LATTICE_TURN, LaunchFrame, LaunchGrid, project
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.kernel.stage import KernelRecording
from sarmitsuba.tracing.kernel.state import COHERENT, RECIPROCAL, Contribution, Hit, Kernel, RayState
from sarmitsuba.tracing.scatterers.sources import SOURCES, measure_sources

CHANNELS = ("HH", "VV")
# rays on a side of a patch: enough for the taper to suppress its edge by 30 dB
SIDE = 8
# a feature hit by this many random patches needs no patch of its own
ENOUGH_PATCHES = 8.0


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches of rays of one pulse: ``grid`` holds SIDE^2 rays of each in turn; the first ``n_random`` are random."""

    grid: LaunchGrid
    n_random: int
    n_features: int


def features_of(shape: ShapeAnalysis, sampling: SamplingPlan, n_patches: int) -> tuple[F64, F64]:
    """Small features that random patches would not hit often enough, strongest first: points, sizes."""
    points, sizes = shape.features
    if not len(points):
        return points, sizes
    window, spacing = sampling.window, sampling.spacings.coherent
    middle = sampling.scene.radar.track.center_position
    met = n_patches * sizes**2 / (4.0 * window.half_x * window.half_y)
    xy = project(points, middle, window.frame)
    inside = (np.abs(xy) <= [window.half_x, window.half_y]).all(axis=1)
    keep = inside & (met < ENOUGH_PATCHES) & (sizes > 0.5 * spacing)
    points, sizes = points[keep], sizes[keep]
    # features larger than a patch get several
    repeat = np.clip(np.ceil(sizes / (0.5 * SIDE * spacing)), 1, 4).astype(int)
    return np.repeat(points, repeat, axis=0), np.repeat(sizes, repeat)


def place_patches(
    sampling: SamplingPlan,
    pulse: int,
    per_pulse: int,
    points: F64,
    sizes: F64,
    rng: np.random.Generator,
) -> Patches:
    """Patches of a pulse: at most half of them on the first of the features, the others at random places."""
    window, spacing = sampling.window_at(pulse), sampling.spacings.coherent
    n_features = min(len(points), per_pulse // 2)
    n_random = per_pulse - n_features
    half = np.array([window.half_x, window.half_y])
    centre = rng.uniform(-half, half, (n_random, 2))
    if n_features:
        aim = project(points[:n_features], sampling.scene.radar.track.position[pulse], window.frame)
        # the first patch of a feature is centred on it; further patches of a larger one are spread over it
        first = np.ones(n_features, dtype=bool)
        first[1:] = (np.diff(points[:n_features], axis=0) != 0).any(axis=1)
        spread = np.where(first, 0.0, 0.5 * sizes[:n_features])[:, None]
        aim = np.clip(aim + rng.uniform(-1.0, 1.0, aim.shape) * spread, -half, half)
        centre = np.concatenate([centre, aim])
    turn = 0.15 + (LATTICE_TURN % (0.25 * np.pi - 0.3))
    step = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * spacing
    i, j = (a.ravel() for a in np.meshgrid(step, step, indexing="ij"))
    x = centre[:, :1] + (i * np.cos(turn) - j * np.sin(turn))
    y = centre[:, 1:] + (i * np.sin(turn) + j * np.cos(turn))
    grid = LaunchGrid(
        x.astype(np.float32).ravel(),
        y.astype(np.float32).ravel(),
        spacing,
        turn,
        window.half_x,
        window.half_y,
        window.taper,
    )
    return Patches(grid, n_random, n_features)


def fade_of_patch() -> F64:
    """Amplitude taper of a patch, (SIDE, SIDE)."""
    fade = np.cos(np.pi * (np.arange(SIDE) - 0.5 * (SIDE - 1)) / SIDE) ** 2
    return np.outer(fade, fade)


class _PatchAccumulator:
    """Accumulator of coherent sums by patch, kind of return and bounce order; two channels."""

    def __init__(self, n_patches: int, orders: int, wavelength: float, reference_range: float) -> None:
        self.n_lanes, self.orders = n_patches * SIDE**2, orders
        self.wavelength, self.reference_range = wavelength, reference_range
        self.memory = dr.zeros(mi.Float, 4 * n_patches * len(KINDS) * orders)
        self.moments = dr.zeros(mi.Float, 4 * n_patches * orders)
        self.incident = dr.zeros(mi.Float, n_patches * orders)
        self.fade = device_array(mi.Float, fade_of_patch().astype(np.float32))

    def begin(self) -> tuple[Any, ...]:
        """The lane's number."""
        return (dr.arange(mi.UInt32, self.n_lanes),)

    def visit(
        self, state: tuple[mi.UInt32, ...], ray: RayState, hit: Hit
    ) -> tuple[tuple[mi.UInt32, ...], mi.UInt32 | None]:
        """Add up the power incident at every bounce; see :class:`sarmitsuba.tracing.kernel.kernel.Follower`."""
        power = sum(dr.squared_norm(re) + dr.squared_norm(im) for re, im in ray.fields)
        share = power / (len(ray.fields) * SIDE**2)
        row = (state[0] // SIDE**2) * dr.opaque(mi.UInt32, self.orders) + hit.order - 1
        dr.scatter_add(self.incident, share, row, hit.active)
        return state, ray.trail

    def add(self, state: tuple[Any, ...], contribution: Contribution) -> tuple[Any, ...]:
        """Add to the sum of the lane's patch; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        (lane,), active = state, contribution.active
        patch = lane // SIDE**2
        weight = dr.gather(mi.Float, self.fade, lane - patch * SIDE**2, active)
        offset = contribution.slant_range - dr.opaque(mi.Float64, self.reference_range)
        phase = phase_factor(offset, self.wavelength)
        hh, vv = (a * phase * weight for a in contribution.amplitudes)
        orders = dr.opaque(mi.UInt32, self.orders)
        # of a path back along its chain: the bounce at which it turns, which is as deep as rays are followed for it
        turns = contribution.kind == RECIPROCAL
        order = dr.minimum(dr.select(turns, (contribution.order + 1) >> 1, contribution.order), orders)
        row = (patch * len(KINDS) + contribution.kind) * orders + order - 1
        dr.scatter_add(self.memory, mi.Vector4f(hh.real, hh.imag, vv.real, vv.imag), row, active)
        # place of the coherent return in the image: amplitude, and slant range and range rate weighted by it
        strength = dr.sqrt(dr.squared_norm(hh) + dr.squared_norm(vv))
        moments = mi.Vector4f(
            strength, strength * mi.Float(offset), strength * mi.Float(contribution.range_rate), 0.0
        )
        row = patch * orders + order - 1
        dr.scatter_add(self.moments, moments, row, active & (contribution.kind == COHERENT))
        return state


@dataclass(frozen=True, eq=False)
class Echoes:
    """Echoes of the patches of one pulse.

    Parameters
    ----------
    power : (4, n_patches, orders), m^2: coherent, diffuse, reciprocal, and their coherent sum
    incident : (n_patches, orders) share of a patch's launched power that is incident at each bounce
    returns : coherent returns of the random patches
    """

    power: F64
    incident: F64
    returns: PatchReturns


def patch_echoes(
    trace_scene: TraceScene,
    sampling: SamplingPlan,
    flags: KernelFlags,
    pulses: Sequence[int],
    patches: Sequence[Patches],
    orders: int,
) -> list[Echoes]:
    """Echoes of every pulse's patches, from one launch where all pulses have one vertical reference."""
    radar = sampling.scene.radar
    ups = [
        polarisation_up(radar, sampling.window_at(pulse).center, radar.track.position[pulse])
        for pulse in pulses
    ]
    found: dict[int, Echoes] = {}
    for up in dict.fromkeys(ups):
        of = [i for i, other in enumerate(ups) if other == up]
        some = _launch(
            trace_scene, sampling, flags, [pulses[i] for i in of], [patches[i] for i in of], orders, up
        )
        found |= dict(zip(of, some, strict=True))
    return [found[i] for i in range(len(pulses))]


def _launch(
    trace_scene: TraceScene,
    sampling: SamplingPlan,
    flags: KernelFlags,
    pulses: Sequence[int],
    patches: Sequence[Patches],
    orders: int,
    up: tuple[float, float, float],
) -> list[Echoes]:
    """Echoes of several pulses' patches, equally many each, from one launch."""
    radar, pick = sampling.scene.radar, np.array(pulses)
    windows = [sampling.window_at(pulse) for pulse in pulses]
    position, velocity = radar.track.position[pick], radar.track.velocity[pick]
    frames = [window.frame for window in windows]
    frame = LaunchFrame(
        *(np.concatenate([getattr(f, name) for f in frames]) for name in ("center", "axis_x", "axis_y"))
    )
    states = AntennaStates(position, velocity, pick)  # type: ignore[arg-type]  # numbers index as a slice does
    batch = pulse_batch(radar, states, frame, patterned=flags.antenna_pattern)
    distance = np.array(
        [np.linalg.norm(w.center - p) for w, p in zip(windows, position, strict=True)], dtype=np.float64
    )
    reference = float(distance[0])
    settings = KernelSettings(
        wavelength=radar.waveform.wavelength,
        max_depth=orders,
        cell=sampling.scatterer_cell,
        seed=sampling.scene.settings.seed,
        amplitude=reference**2,
        reference_range=reference,
        up=up,
    )
    n = patches[0].n_random + patches[0].n_features
    accumulator = _PatchAccumulator(n * len(pulses), orders, radar.waveform.wavelength, reference)
    grid = replace(
        patches[0].grid,
        x=np.concatenate([each.grid.x for each in patches]),
        y=np.concatenate([each.grid.y for each in patches]),
        n_own=len(pulses),
    )
    kernel = Kernel.of(trace_scene, grid, batch, flags, settings)
    with KernelRecording(kernel.flags):
        _, state = trace(kernel, radar.antenna, accumulator)
    dr.eval(state, accumulator.memory, accumulator.moments, accumulator.incident)
    shapes = (len(KINDS), orders, len(CHANNELS), 2), (orders, 4), (orders,)
    sums, moments, incident = (
        memory.numpy().reshape(len(pulses), n, *shape)
        for memory, shape in zip(
            (accumulator.memory, accumulator.moments, accumulator.incident), shapes, strict=True
        )
    )
    return [
        _echoes(
            sampling,
            pulse,
            patches[i].n_random,
            float(np.square(distance[i] / reference)) * sums[i].astype(np.float64),
            moments[i].astype(np.float64),
            incident[i].astype(np.float64),
            float(distance[i]) - reference,
        )
        for i, pulse in enumerate(pulses)
    ]


def _echoes(
    sampling: SamplingPlan,
    pulse: int,
    n_random: int,
    sums: F64,
    moments: F64,
    incident: F64,
    farther: float,
) -> Echoes:
    """Echoes of the patches of a pulse from the sums of an accumulator, ``farther``: its reference range's error, m."""
    radar, window = sampling.scene.radar, sampling.window_at(pulse)
    n, _, orders = sums.shape[:3]
    field = sums[..., 0] + 1j * sums[..., 1]  # (patches, kinds, orders, channels)
    letters = linear_letters(radar.channels)
    used = [i for i, c in enumerate(CHANNELS) if c[0] in letters]
    field = field[..., used]
    power = np.zeros((4, n, orders))
    power[:3] = np.square(np.abs(field)).mean(axis=-1).swapaxes(0, 1)
    power[3] = np.square(np.abs(field.sum(axis=1))).mean(axis=-1)
    moments = moments[:n_random]
    place = moments[..., 1:3] / np.maximum(moments[..., :1], np.finfo(np.float64).tiny)
    taper, spacing = fade_of_patch(), sampling.spacings.coherent
    width, correction = azimuth_bin(taper.sum(axis=0), spacing, sampling.azimuth_cell)
    returns = PatchReturns(
        field[:n_random, KINDS.index("coherent")],
        place[..., 0] - farther,
        place[..., 1],
        sampling.range_cell,
        width * _turn_rate(radar, window.center, pulse),
        correction * window.area / spacing**2 * float(np.square(taper).sum() / np.square(taper.sum())),
    )
    return Echoes(power, incident, returns)


def _turn_rate(radar: Radar, point: F64, pulse: int) -> float:
    """Angular rate of the line of sight, mean over the antennas, rad/s: range rate over distance along azimuth."""
    return float(
        np.mean(
            [
                np.linalg.norm(t.velocity[pulse]) / np.linalg.norm(t.position[pulse] - point)
                for t in radar.tracks
            ]
        )
    )


# bounces traced at first, and at most where the last of them still returns too much
ORDERS, MOST_ORDERS = 8, 128
# share of the full run's rays, and upper bound of the rays. A pilot's ray costs two to three of the run's: all
# effects, two polarisations, patches in random order
RAY_SHARE = 0.006
MAX_RAYS = 300_000
# least patches of a pulse: recording and launching take longer than tracing these
LEAST_PATCHES = 512
# a run shorter than this is not worth a pilot: recording and launching its kernels takes about 0.1 s
SHORTEST_RUN = 2.0
# share of a run that proofs from the geometry may take
PROOF_SHARE = 0.05
# effects up to this rank decide the kinds of return, on which the sampling depends
KINDS_RANK = 20


def plan_scene(
    scene: Scene,
    trace_scene: TraceScene | None = None,
    *,
    pilot: bool | None = None,
    sampling: SamplingPlan | None = None,
    clock: Clock = time.perf_counter,
) -> EffectsPlan:
    """Effects plan of a scene, from the static context and, where that is not enough, from a pilot trace.

    Parameters
    ----------
    scene : as loaded
    trace_scene : geometry on the device, or None to build it when a pilot needs it
    pilot : force or forbid the pilot; None: by the size of the run
    sampling : of this scene with all possible returns, None to compute it
    clock : for the pilot's time
    """
    return plan_in(examine(scene, trace_scene, pilot=pilot, sampling=sampling, clock=clock))


def plan_in(context: SceneContext, *, warn: bool = True) -> EffectsPlan:
    """Effects plan of a scene in a given context."""
    return plan_effects(
        context.scene,
        context.sampling,
        context.pilot,
        shape=context.known_shape,
        measured=context.measured,
        warn=warn,
    )


def examine(
    scene: Scene,
    trace_scene: TraceScene | None = None,
    *,
    pilot: bool | None = None,
    sampling: SamplingPlan | None = None,
    clock: Clock = time.perf_counter,
) -> SceneContext:
    """Context from which the effects of a scene are decided; parameters as for :func:`plan_scene`."""
    if scene.geometry.n_faces == 0:
        return SceneContext(scene)
    sampling = sampling or SamplingPlan.of(scene)
    shape = SceneContext(scene).shape_within(PROOF_SHARE * run_seconds(_use_key_pulses(sampling)))
    draft = plan_effects(scene, shape=shape, warn=False, up_to=KINDS_RANK)
    sampling = sampling.obeying(scene, draft.flags)
    depth = draft.decision("max_depth")
    decided = depth is not None and depth.source == "fact" and not depth.on
    wanted = pilot if pilot is not None else worth_a_pilot(sampling)
    returns = draft.flags.coherent or draft.flags.diffuse
    if decided or not returns:
        return SceneContext(scene, sampling.for_effects(), known_shape=shape)
    traced = wanted or not (pilot is False or not _may_ring(scene, shape))
    known = SceneContext(scene, sampling.for_effects(), known_shape=shape)
    if pilot is False:
        return known
    draft = plan_effects(scene, shape=shape, warn=False, draft=True)
    # measurements of sources are cheap enough for every run
    if any(kind.measures(draft.flags) for kind in SOURCES):
        trace_scene = trace_scene or build_trace_scene(
            scene.geometry, scene.materials, scene.radar.waveform.wavelength
        )
        site = RunSite(sampling.obeying(scene, draft.flags), None, trace_scene)
        known = replace(known, measured=measure_sources(site))
    if not traced:
        return known
    result = run_pilot(draft, sampling, trace_scene, shape=shape, clock=clock)
    if not result.settled(scene.settings.tolerance_db):
        result = run_pilot(draft, sampling, trace_scene, shape=shape, clock=clock, orders=MOST_ORDERS)
    return replace(known, pilot=result)


def _may_ring(scene: Scene, shape: ShapeAnalysis) -> bool:
    """Whether faces are opposite each other, so that a path between them may have any number of bounces."""
    return shape.facing(both_sides=bool(SceneContext(scene).seen_through))


def worth_a_pilot(sampling: SamplingPlan) -> bool:
    """Whether a pilot trace pays: the run is long enough, or keeps bounce orders separately, which costs memory.

    The length is that of a run by key pulses for every method: all methods of one scene have one plan.
    """
    return run_seconds(_use_key_pulses(sampling)) >= SHORTEST_RUN or sampling.scene.settings.keep_orders


def _use_key_pulses(sampling: SamplingPlan) -> SamplingPlan:
    """The sampling of the same scene by the method of key pulses."""
    scene = sampling.scene
    settings = replace(scene.settings, method="hybrid", key_pulse_interval=0)
    return replace(sampling, scene=replace(scene, settings=settings))


def run_pilot(
    draft: EffectsPlan,
    sampling: SamplingPlan,
    trace_scene: TraceScene | None = None,
    *,
    pulses: Sequence[int] | None = None,
    shape: ShapeAnalysis | None = None,
    clock: Clock = time.perf_counter,
    orders: int = ORDERS,
) -> PilotResult:
    """Result of a pilot trace: power by patch, kind of return and bounce order.

    Parameters
    ----------
    draft : plan from the static context; effects that the user switched off stay off
    sampling : of the full run, with the scene as loaded
    trace_scene : geometry on the device, or None
    pulses : numbers of the pulses; default first, quarter, middle, three quarters, last
    shape : analysis of the geometry, None to compute it
    clock : of the seconds in the result
    orders : bounces to trace. Of more than ``ORDERS``, the result has as few, doubled step by step, as settle it

    Notes
    -----
    Ignores mechanisms visible only at pulses between those chosen, unless a patch is so small that its lobe spans the
    gap, as for returns of single resolution cells.
    """
    ensure_backend()
    start = clock()
    scene = sampling.scene
    n = scene.radar.track.n_pulses
    chosen = (
        tuple(pulses)
        if pulses is not None
        else tuple(np.unique(np.linspace(0, n - 1, 5).round().astype(int)))
    )
    trace_scene = trace_scene or build_trace_scene(
        scene.geometry, scene.materials, scene.radar.waveform.wavelength
    )
    keys = _use_key_pulses(sampling).expected_key_pulses
    budget = min(MAX_RAYS, RAY_SHARE * sampling.rays_per_pulse * keys)
    per_pulse = int(np.clip(budget / (len(chosen) * SIDE**2), LEAST_PATCHES, 4096))
    rng = np.random.default_rng([scene.settings.seed & 0x7FFFFFFF, 0x9170])
    shape = shape or SceneContext(scene).shape
    points, sizes = features_of(shape, sampling, per_pulse * len(chosen))
    flags = _flags(scene, draft)
    patches = [place_patches(sampling, pulse, per_pulse, points, sizes, rng) for pulse in chosen]
    before = clock()
    echoes = patch_echoes(trace_scene, sampling, flags, chosen, patches, orders)
    seconds = clock() - before
    some = patches[0]
    random = np.tile(np.arange(some.n_random + some.n_features) < some.n_random, len(chosen))
    power = np.concatenate([echo.power for echo in echoes], axis=1)  # (4, patches, orders)
    incident = np.concatenate([echo.incident for echo in echoes])
    adding, spread = (
        np.sum(sums, axis=0)
        for sums in zip(*(measure_in_phase(echo.returns) for echo in echoes), strict=True)
    )
    rays, count = power.shape[1] * SIDE**2, int(random.sum())
    traced = PilotResult(
        pulses=tuple(int(p) for p in chosen),
        rays=rays,
        n_patches=count,
        n_features=some.n_features * len(chosen),
        n_skipped=max(0, len(points) - some.n_features),
        mean=power[:, random].mean(axis=1),
        deviation=power[:, random].std(axis=1) / np.sqrt(count),
        share=(power[3, random] > 0).mean(axis=0),
        peak=power.max(axis=1),
        rays_per_second=rays / seconds if seconds > 0 else 0.0,
        seconds=clock() - start,
        incident=incident[random].mean(axis=0),
        in_phase=adding / len(chosen),
        in_phase_deviation=np.sqrt(spread / len(chosen) ** 2),
        patch_area=float(np.square(fade_of_patch()).sum()) * sampling.spacings.coherent**2,
        lit_area=float(np.mean([4.0 * w.half_x * w.half_y for w in map(sampling.window_at, chosen)])),
    )
    most, kept = incident.max(axis=0), min(orders, 2 * ORDERS if orders > ORDERS else ORDERS)
    while kept < orders and not _up_to(traced, most, kept).settled(scene.settings.tolerance_db):
        kept = min(2 * kept, orders)
    return _up_to(traced, most, kept)


def _up_to(result: PilotResult, incident: F64, orders: int) -> PilotResult:
    """Result of a pilot up to some order; ``incident`` (all orders,), largest share of a patch's power."""
    return replace(
        result,
        mean=result.mean[:, :orders],
        deviation=result.deviation[:, :orders],
        share=result.share[:orders],
        peak=result.peak[:, :orders],
        incident=result.incident[:orders],
        in_phase=result.in_phase[:orders],
        in_phase_deviation=result.in_phase_deviation[:orders],
        going_on=float(incident[orders - 1]),
    )


def _flags(scene: Scene, draft: EffectsPlan) -> KernelFlags:
    """Kernel flags with all effects on except those switched off by the user: one kernel for nearly all scenes."""
    off = {name for name, switch in scene.settings.effects.items() if switch == "off"}
    return KernelFlags(
        channels=CHANNELS,
        fresnel="fresnel" not in off,
        roughness="roughness" not in off,
        coherent="coherent" not in off,
        diffuse="diffuse" not in off,
        diffuse_double="diffuse_double" not in off,
        speckle=True,
        depolarisation=False,
        polarised_diffuse=draft.flags.polarised_diffuse,
        antenna_pattern=draft.flags.antenna_pattern,
        visibility="visibility" not in off,
        tube_phase="tube_phase" not in off,
        taper=False,
        slabs=draft.flags.slabs,
        transmission=draft.flags.transmission,
    )
