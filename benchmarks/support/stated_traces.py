"""Traced scenes: what runs state of rays, passes, blocks of pulses, gridding and bounces left out, and the truth."""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.support import harness, random_scenes
from benchmarks.support.denser_runs import DENSER, DENSER_RUNS, MOST_PASSES, TARGETS, converged
from benchmarks.support.stated_row import Row
from sarmitsuba.analysis.error_budget import error_budget
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.block import plan_block, spread_reference
from sarmitsuba.signal.block_synthesis import synthesise
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.blocks import partition
from sarmitsuba.simulation.execution.error_bars import add_error_bars
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.path_table import PathTracer
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from tests.support.unweighted import focus, refine, render

# rays of a run's first pass over its key pulses; the truth takes many times that
MOST_RAYS = 3e5
# and over all pulses, where the truth traces every one
MOST_EVERY = 1e7
# times that rays are at most farther apart than the program would have them, to keep within these
COARSEST = 5.0
# pulses whose profiles are summed path by path, and how much coarser the rays are then
PULSES, COARSE = 3, 6.0
ATTEMPTS = 100
# directions of a sweep, and most rays of each
ASPECTS, RCS_RAYS = 12, 100_000
# rays of the reference over those of a sweep, along each axis
RCS_DENSER = 2.6, 3.0, 3.4


def draw(seed: int, most_rays: float, *, every: bool = False) -> tuple[Scene, str]:
    """Boxes on rough ground under a drawn radar, with squints, tracks, sides of the image and so on drawn too.

    Scenes whose truth would cost too much are drawn again.
    """
    for attempt in range(ATTEMPTS):
        own = seed * ATTEMPTS + attempt
        rng = np.random.default_rng([own, 0x7A])
        with tempfile.TemporaryDirectory() as folder:
            plain = load_scene(random_scenes.draw_boxes(own).write(Path(folder)))
        changes: dict[str, object] = {"polarisation": ("VV", "HH")[rng.integers(2)]}
        if rng.random() < 0.4:
            changes["squint_angle_deg"] = float(rng.uniform(-20.0, 20.0))
        if rng.random() < 0.3:
            away = 0.3 * plain.image.extent_range
            changes |= {f"image_center_{axis}": float(rng.uniform(-away, away)) for axis in "xy"}
        if rng.random() < 0.2:
            changes |= {"mode": "sliding_spotlight", "sliding_factor": float(rng.uniform(0.2, 0.8))}
        if rng.random() < 0.2:
            changes["prf_jitter"] = float(rng.uniform(0.0, 0.02))
        scene = plain.replace(**changes)
        wander = 10.0 ** rng.uniform(-3.0, 0.0) if rng.random() < 0.25 else 0.0
        if wander:
            scene = replace(scene, radar=_wandering(scene.radar, wander, rng))
        scene = harness.with_settings(scene, method="raw" if every else "hybrid")
        run = Run(scene)
        sampling = run.sampling
        if sampling is None:
            continue
        interval = 1 if every else sampling.key_pulse_interval
        taken = sampling.rays_per_pulse * scene.radar.track.n_pulses / interval
        if taken <= most_rays * COARSEST**2:
            coarser = run.at(max(1.0, float(np.sqrt(taken / most_rays))))
            return coarser.scene if taken > most_rays else scene, _label(scene, wander)
    raise AssertionError(f"seed {seed}: every scene drawn is too large")


def _label(scene: Scene, wander: float) -> str:
    radar = scene.radar
    band = f"{radar.waveform.center_frequency / 1e9:.4g} GHz"
    cell = radar.waveform.range_cell
    text = f"{band} {radar.mode} {radar.antenna.pattern} {'/'.join(radar.channels)}"
    text += f" {radar.track.n_pulses} pulses cell {cell:.2f} m image {scene.image.extent_range:.0f} m"
    return text + (f" wander {wander:.2g} m" if wander else "")


def _wandering(radar: Radar, wander: float, rng: np.random.Generator) -> Radar:
    track = radar.track
    phase = np.linspace(0.0, 2.0 * np.pi, track.n_pulses)[:, None]
    sway = sum(rng.normal(size=3) * np.sin(k * phase + rng.uniform(0.0, 6.28, 3)) / k for k in (1, 2, 3))
    position = track.position + wander * sway / np.abs(sway).max()
    moved = Track(track.time, position, np.gradient(position, track.time, axis=0))
    return replace(radar, track=moved)


def stated_of(image: SarImage, name: str) -> float:
    """Figure of the image's error budget, dB; -inf for none, NaN where it is not known."""
    return next(part.error_db for part in error_budget(image) if part.name == name)


# ---------------------------------------------------------------- rays and passes


def rays(seed: int) -> Iterator[Row]:
    """One run's two sets of rays, of methods hybrid, raw and image, against runs of dense rays."""
    method = ("hybrid", "hybrid", "image", "raw")[seed % 4]
    scene, case = draw(seed, MOST_RAYS, every=method == "raw")
    scene = harness.with_settings(scene, method=method, keep_subsets=True)
    run = Run(scene)
    if method == "hybrid":  # blocks of pulses as in the truth: their error is not the rays'
        assert run.sampling is not None
        scene = harness.with_settings(scene, key_pulse_interval=run.sampling.key_pulse_interval)
        run = Run(scene)
    image = render(scene)
    dense = run.at(2.0 ** (-0.5 * DENSER))
    truth = _looks(dense, image) if method == "image" else converged(dense, image.grid)
    true = image_error_db(image.total(), truth)
    bar = next(iter(add_error_bars(image).metadata["sampling_error"].values()))
    yield Row(
        "rays",
        "two sets of rays",
        seed,
        f"{method} {case}",
        stated_of(image, "rays"),
        true,
        note=f"+- {bar['confidence_db']}",
    )


def _looks(run: Run, image: SarImage) -> C128:
    """The same of method image, whose own error is not the rays'."""
    some = [Imager(run, image.grid).image(1000 + i).total() for i in range(DENSER_RUNS)]
    return np.asarray(np.median(np.real(some), axis=0) + 1j * np.median(np.imag(some), axis=0))


def passes(seed: int) -> Iterator[Row]:
    """Passes until a drawn target, against runs of dense rays."""
    scene, case = draw(seed, MOST_RAYS)
    sampling = Run(scene).sampling
    assert sampling is not None
    scene = harness.with_settings(scene, key_pulse_interval=sampling.key_pulse_interval)
    target = float(np.random.default_rng([seed, 0xBA]).uniform(*TARGETS))
    done = refine(scene, target_error_db=target, max_passes=MOST_PASSES)
    dense = 2.0 ** (-0.5 * (done.passes - 1 + DENSER))
    true = image_error_db(done.image.total(), converged(Run(scene).at(dense), done.image.grid))
    bar = next(iter(done.image.metadata["sampling_error"].values()))
    note = f"+- {bar['confidence_db']}, {done.passes} passes, target {target:.1f}"
    yield Row("rays", "passes", seed, case, stated_of(done.image, "rays"), true, note=note)
    if "at_most_db" in bar:
        yield Row("rays", "passes, at most", seed, case, bar["at_most_db"], true, note=note)


# ---------------------------------------------------------------- blocks of pulses


def blocks(seed: int) -> Iterator[Row]:
    """Blocks of pulses, of automatic and of a drawn length, against tracing every pulse with the same rays."""
    scene, case = draw(seed, MOST_EVERY, every=True)
    grid = default_grid(scene.radar, scene.image)
    exact = focus(simulate(scene), grid).total()
    asked = int(np.random.default_rng([seed, 0xB1]).integers(4, 65))
    for kind, interval in (("automatic blocks", 0), ("given blocks", asked)):
        image = render(harness.with_settings(scene, method="hybrid", key_pulse_interval=interval), grid=grid)
        found = image.metadata["sampling"]["key_pulse_interval"]
        true = image_error_db(image.total(), exact)
        stated = stated_of(image, "blocks of pulses")
        yield Row("blocks", kind, seed, case, stated, true, note=f"{found} pulses")


def block_model(seed: int) -> Iterator[Row]:
    """Prediction of block synthesis, on which the block's length is chosen, against the exact sum of drawn paths."""
    scene, case = draw(seed, MOST_RAYS)
    run, rng = Run(scene), np.random.default_rng([seed, 0xB2])
    sampling, radar = run.sampling, run.scene.radar
    assert sampling is not None
    if radar.delay is not None:  # the sum's antenna stands still during a pulse
        return
    width = int(rng.integers(2, 9))
    n = radar.track.n_pulses
    length = int(rng.integers(min(8, n), min(n, 128) + 1))
    start = int(rng.integers(0, n - length + 1))
    box = sampling.phase_box
    plan = plan_block(radar, start, start + length, sampling.window.center, box, width)
    points = rng.uniform(box[0], box[1], (400, 3))
    amplitude = rng.normal(size=(1, 400)) + 1j * rng.normal(size=(1, 400))
    track, key = radar.track, plan.key
    # antennas of the key pulse with the velocity of the plan
    line = points - track.position[key]
    distance = np.linalg.norm(line, axis=1)
    rate = np.array([plan.state.rate(point) for point in points])
    data = synthesise(
        spread_reference(plan, radar, distance - plan.reference_range, rate - plan.reference_rate, amplitude),
        plan,
        radar,
    )
    exact = np.array(
        [
            _profile(radar, t, np.linalg.norm(points - track.position[t], axis=1), amplitude[0])
            for t in range(start, start + length)
        ]
    )
    yield Row(
        "blocks",
        "prediction",
        seed,
        f"{case} block of {length}, width {width}",
        plan.predicted_error_db,
        image_error_db(data[0], exact),
    )


# ---------------------------------------------------------------- gridding


def _profile(radar: Radar, pulse: int, slant_range: F64, amplitude: NDArray[np.complexfloating]) -> C128:
    """Samples of one pulse, summed path by path; amplitudes without the phase of their path."""
    window, cell = radar.window, radar.waveform.range_cell
    samples = window.start_range[pulse] + window.sample_spacing * np.arange(window.n_samples)
    turns = np.mod(2.0 / radar.waveform.wavelength * slant_range, 1.0)
    value = amplitude * np.exp(-2j * np.pi * turns)
    total = np.zeros(samples.size, dtype=np.complex128)
    for i in range(0, value.size, 4096):
        part = slice(i, i + 4096)
        total += np.sinc((samples[:, None] - slant_range[part]) / cell) @ value[part]
    return total


def gridding(seed: int) -> Iterator[Row]:
    """Profiles of single pulses, gridded with a kernel of drawn width, against the exact sum over their paths."""
    rng = np.random.default_rng([seed, 0x61])
    scene, case = draw(seed, MOST_EVERY, every=True)
    width = int(rng.integers(2, 9))
    scene = Run(scene).at(COARSE).scene
    scene = harness.with_settings(
        scene.replace(wideband="off", max_depth=3), gridding_width=width, keep_subsets=False
    )
    n = scene.radar.track.n_pulses
    for method in ("raw", "hybrid"):
        some = harness.with_settings(scene, method=method, key_pulse_interval=0 if method == "raw" else 16)
        run = Run(some)
        if run.scene.radar.delay is not None:  # the sum's antenna stands still during a pulse
            return
        raw = echoes(run)
        if method == "raw":
            pulses = sorted({int(v) for v in rng.integers(0, n, PULSES)})
        else:
            interval = raw.metadata["sampling"]["key_pulse_interval"]
            # a beam's window is another for blocks, and with it the rays
            if interval == 1 or scene.radar.antenna.pattern != "isotropic":
                continue
            # a block reaches up to the first pulse of the next one
            pulses = [
                start + (min(stop + 1, n) - start) // 2 for start, stop in partition(n, interval)[:PULSES]
            ]
        tracer = PathTracer(some, plan=run.plan)
        got, exact = [], []
        for pulse in pulses:
            table = tracer.trace(pulse)
            phase = np.exp(2j * np.pi / scene.radar.waveform.wavelength * table.length)
            exact.append(_profile(scene.radar, pulse, table.slant_range, table.amplitude[:, 0] * phase))
            got.append(raw.data[0, pulse])
        image = focus(raw)
        image = replace(image, metadata={**image.metadata, "method": method})
        yield Row(
            "gridding",
            method,
            seed,
            f"{case} width {width}",
            stated_of(image, "gridding"),
            image_error_db(np.array(got), np.array(exact)),
        )


# ---------------------------------------------------------------- radar cross sections


def rcs(seed: int) -> Iterator[Row]:
    """Sampling error of a sweep over aspects of a drawn metal body, against rays about three times as dense.

    Of three lattices so dense the one in the middle counts: a ray beside a sharp corner may have a part of a tube too
    much, which in a side lobe is up to -35 dB of the return.
    """
    with tempfile.TemporaryDirectory() as folder:
        body = random_scenes.draw_metal(seed)
        scene = load_scene(body.write(Path(folder))).replace(full_wave="off")  # the error of rays
    # about the radar's own line of sight, which most bodies face: in the nulls of all lobes there is nothing to state
    sight = -random_scenes.look_direction(body.radar)
    azimuth = float(np.arctan2(sight[1], sight[0])) + np.linspace(-0.05, 0.05, ASPECTS)
    aspects = Aspects(azimuth, np.full(ASPECTS, float(np.arcsin(sight[2]))))
    found = rcs_sweep(scene, aspects, most_rays=RCS_RAYS)
    dense = [
        harness.with_settings(scene, ray_spacing=found.result.ray_spacing / times) for times in RCS_DENSER
    ]
    each = np.array([rcs_sweep(one, aspects, checked=0).result.amplitude.sum(axis=1)[:, 0] for one in dense])
    exact = np.median(each.real, axis=0) + 1j * np.median(each.imag, axis=0)
    true = image_error_db(found.result.amplitude.sum(axis=1)[:, 0], exact)
    yield Row("rcs", "sweep", seed, f"{body.bodies[0].kind} {body.radar.band}", found.error_db[0], true)


__all__ = ["block_model", "blocks", "gridding", "passes", "rays", "rcs"]
