"""Pilot trace: echo power by bounce order, from a few per cent of the rays at a few pulses of the aperture.

Rays are launched in square patches about as large as a resolution cell and as dense as in the full run, so that every
patch has the coherent sum of one pixel. Most patches are at random positions; the others are on small features of the
geometry (separate pieces, concave edges) that random ones would miss. Patches are tapered towards their edge, else
the edge of a patch on a smooth plane would give an echo that the plane does not have.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.timing import Clock
from sarmitsuba.effects.context import PilotResult, SceneContext
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan, plan_effects
from sarmitsuba.effects.shape import ShapeAnalysis
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.in_phase import measure_in_phase
from sarmitsuba.simulation.planning.pilot_patches import (
    CHANNELS,
    SIDE,
    fade_of_patch,
    features_of,
    patch_echoes,
    place_patches,
)
from sarmitsuba.simulation.planning.prediction.speed import run_seconds
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.scatterers.pairs.pair_estimate import pair_level

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
        pairs=context.pairs,
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
    # a realisation of pairs is cheap enough for every run
    paired = draft.flags.diffuse and pilot is not False and _may_pair(scene)
    traced = wanted or not (pilot is False or not _may_ring(scene, shape))
    known = SceneContext(scene, sampling.for_effects(), known_shape=shape)
    if not paired and not traced:
        return known
    draft = plan_effects(scene, shape=shape, warn=False, draft=True)
    if paired:
        trace_scene = trace_scene or build_trace_scene(
            scene.geometry, scene.materials, scene.radar.waveform.wavelength
        )
        site = RunSite(sampling.obeying(scene, draft.flags), None, trace_scene)
        known = replace(known, pairs=pair_level(site))
    if not traced:
        return known
    result = run_pilot(draft, sampling, trace_scene, shape=shape, clock=clock)
    if not result.settled(scene.settings.tolerance_db):
        result = run_pilot(draft, sampling, trace_scene, shape=shape, clock=clock, orders=MOST_ORDERS)
    return replace(known, pilot=result)


def _may_pair(scene: Scene) -> bool:
    """Whether pairs of diffuse scatterers are requested, or left to the plan, in a run of several bounces."""
    settings = scene.settings
    return settings.effects.get("diffuse_pairs") != "off" and settings.max_depth != 1


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
