"""What adding known paths to pulses costs, and how exact it is: direct and block accumulators, by block length.

Run ``python -m benchmarks.suite.accumulators [--quick] [-o FOLDER]``.

The paths are random points (the worst order for the caches) whose slant ranges are computed in float64 inside the
kernel, as the tracing kernel does; the accumulators are the ones of the tracing kernel. ``fill`` is that kernel,
``finish`` the NumPy part. The error is that of the profiles of a few pulses against a direct sum 7 cells wide.

The second table is of the setting that a scene gets without being asked: width and tolerance of ``TraceSettings``, the
block length that the simulation chooses, and direct adding where it finds none. There a third of the paths are
multiple reflections, seen as images behind the box.
"""

import platform
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.support import harness
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal import block, direct

SLANT_RANGE = 10e3  # m: airborne
EXTENT = 400.0  # m: a city quarter
HEIGHT = 30.0  # m: its houses
FREQUENCY, BANDWIDTH = 9.65e9, 300e6  # Hz: X band, 0.5 m
N_PULSES = 512  # over the aperture that gives 0.5 m in azimuth
N_PATHS = 2_560_000  # 4 rays per metre
DIRECT_PULSES = 8  # pulses the direct accumulator is timed on: the cost a pulse does not change
SWAY = 0.3, 3.0  # m: of the curved tracks, one smooth wave over the aperture sideways and up
JITTER = (
    0.01  # m: of the rough track from pulse to pulse, a third of a wavelength; blocks of 8 do not hold -40 dB
)
WIDE = 3000.0, 6000.0  # m: swaths of a third of the slant range and more
REFLECTED = 3  # every so-manieth path is a multiple reflection
PROMISED_RATE, PROMISED_DB = (
    400e6,
    -40.0,
)  # path-pulses per second on two cores, error of the default accumulator


def make_radar(extent: float = EXTENT, sway: float = 0.0, jitter: float = 0.0) -> tuple[Radar, np.ndarray]:
    """Return the radar and the box of phase centres."""
    aperture = SPEED_OF_LIGHT / FREQUENCY * SLANT_RANGE
    center = SLANT_RANGE * np.sqrt(0.5) * np.array([-1.0, 0.0, 1.0])
    track = Track.straight(center, [0.0, 100.0, 0.0], 100.0 * N_PULSES / aperture, N_PULSES)
    if sway or jitter:
        wave = 2.0 * np.pi / N_PULSES * np.arange(N_PULSES)
        position = track.position + sway * np.stack([np.sin(wave), 0.0 * wave, np.cos(wave)], axis=1)
        position += jitter * np.random.default_rng(2).standard_normal(position.shape)
        step = track.time[1] - track.time[0]
        track = replace(track, position=position, velocity=np.gradient(position, step, axis=0))
    box = np.array([[-0.5 * extent, -0.5 * extent, 0.0], [0.5 * extent, 0.5 * extent, HEIGHT]])
    near, far = direct.box_distance(box, track.position)
    spacing = SPEED_OF_LIGHT / (2.4 * BANDWIDTH)
    window = ReceiveWindow(near - 10.0, spacing, int(np.ceil(((far - near).max() + 20.0) / spacing)))
    zero = np.zeros_like(track.position)
    waveform = Waveform(FREQUENCY, BANDWIDTH, 2e-6)
    return Radar("spotlight", track, waveform, Antenna(), Pointing(zero, zero, zero), window), box


class Paths:
    """Random paths in the box on the device."""

    def __init__(
        self, box: np.ndarray, n: int, antenna: np.ndarray | None = None, extra: float = 0.0
    ) -> None:
        import drjit as dr
        import mitsuba as mi

        rng = np.random.default_rng(1)
        self.n = n
        points = rng.uniform(box[0], box[1], (n, 3))
        if (
            antenna is not None and extra > 0.0
        ):  # images up to ``extra`` behind the box, as seen from the antenna
            own = points[::REFLECTED]
            sight = own - antenna
            sight /= np.linalg.norm(sight, axis=1, keepdims=True)
            own += rng.uniform(0.0, extra, (len(own), 1)) * sight
            far = np.linalg.norm(box[:, None] * [1, 0, 0] + box[None] * [0, 1, 1] - antenna, axis=-1).max()
            beyond = np.linalg.norm(own - antenna, axis=1) - far - extra
            own -= np.maximum(beyond, 0.0)[:, None] * sight
        self.position = [mi.Float64(np.ascontiguousarray(points[:, i])) for i in range(3)]
        re, im = (rng.standard_normal(n, dtype=np.float32) for _ in range(2))
        self.amplitude = mi.Complex2f(mi.Float(re), mi.Float(im))
        dr.eval(self.position, self.amplitude)

    def add(self, accumulator: Any, position: np.ndarray, velocity: np.ndarray) -> None:
        """Add every path as seen from each of the antenna positions (m, 3)."""
        import drjit as dr
        import mitsuba as mi

        from sarmitsuba.tracing.kernel.state import DIFFUSE, Contribution

        index = dr.arange(mi.UInt32, self.n * len(position))
        pulse = index // dr.opaque(mi.UInt32, self.n)
        path = index - pulse * dr.opaque(mi.UInt32, self.n)
        antenna = [dr.gather(mi.Float64, mi.Float64(position[:, i]), pulse) for i in range(3)]
        motion = [dr.gather(mi.Float64, mi.Float64(velocity[:, i]), pulse) for i in range(3)]
        d = [a - dr.gather(mi.Float64, p, path) for a, p in zip(antenna, self.position, strict=True)]
        half = dr.sqrt(dr.fma(d[0], d[0], dr.fma(d[1], d[1], d[2] * d[2])))
        rate = (d[0] * motion[0] + d[1] * motion[1] + d[2] * motion[2]) / half
        amplitude = dr.gather(mi.Complex2f, self.amplitude, path)
        path_contribution = Contribution(
            mi.UInt32(DIFFUSE), mi.UInt32(1), pulse, half, rate, (amplitude,), mi.Bool(True), mi.Vector3d(0)
        )
        state = accumulator.add(accumulator.begin(), path_contribution)
        dr.eval(state, accumulator.memory)
        dr.sync_thread()


def run_direct(
    radar: Radar, box: np.ndarray, paths: Paths, start: int, stop: int, width: int, extra: float = 0.0
) -> tuple[Any, ...]:
    """Seconds to fill, seconds to finish, profiles (K, n_samples)."""
    from sarmitsuba.tracing.kernel.accumulators import DirectAccumulator

    t0 = time.perf_counter()
    plan = direct.plan_direct(radar, start, stop, box, width, extra)
    accumulator = DirectAccumulator(plan, 1, 1, 0, radar.waveform.wavelength)
    paths.add(accumulator, radar.track.position[start:stop], radar.track.velocity[start:stop])
    t1 = time.perf_counter()
    profiles = direct.finish(accumulator.grid(), plan, radar)[0]
    return t1 - t0, time.perf_counter() - t1, profiles


def run_block(
    radar: Radar, box: np.ndarray, paths: Paths, start: int, stop: int, width: int, extra: float = 0.0
) -> tuple[Any, ...]:
    """Seconds to fill, seconds to synthesise, profiles (K, n_samples)."""
    from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator

    t0 = time.perf_counter()
    plan = block.plan_block(radar, start, stop, np.zeros(3), box, width, extra_slant_range=extra)
    accumulator = BlockAccumulator(plan, 1, 1, 0, radar.waveform.wavelength)
    paths.add(accumulator, plan.state.position, plan.state.velocity)
    t1 = time.perf_counter()
    profiles = block.synthesise(accumulator.grid(), plan, radar)[0]
    return t1 - t0, time.perf_counter() - t1, profiles


def measure(n_paths: int, rounds: int) -> list[dict[str, Any]]:
    """Interleaved rounds of all accumulators; medians and spreads."""
    radar, box = make_radar()
    paths = Paths(box, n_paths)
    cases = [("direct", DIRECT_PULSES, w) for w in (2, 4, 6)]
    cases += [("block", k, w) for k in (32, 64, 128) for w in (3, 4)]
    truth: dict[int, Any] = {}
    seconds: dict[Any, list[tuple[float, float]]] = {case: [] for case in cases}
    errors: dict[Any, list[float]] = {case: [] for case in cases}
    for turn in range(rounds + 1):  # turn 0 compiles
        for case in cases:
            kind, length, width = case
            start = (N_PULSES - length) * turn // max(rounds, 1)  # from the edge of the aperture to the other
            run = run_direct if kind == "direct" else run_block
            fill, finish, profiles = run(radar, box, paths, start, start + length, width)
            if turn:
                seconds[case].append((fill, finish))
            for pulse in (start + length // 6, start + length // 2, start + 5 * length // 6):
                if pulse not in truth:
                    truth[pulse] = run_direct(radar, box, paths, pulse, pulse + 1, 7)[2][0]
                wrong = np.sum(np.abs(profiles[pulse - start] - truth[pulse]) ** 2)
                errors[case].append(float(wrong / np.sum(np.abs(truth[pulse]) ** 2)))
    rows = []
    for kind, length, width in cases:
        times = np.array(seconds[kind, length, width])
        total = times.sum(axis=1)
        rows.append(
            {
                "accumulator": kind,
                "pulses_per_launch": length,
                "width": width,
                "fill_s": float(np.median(times[:, 0])),
                "finish_s": float(np.median(times[:, 1])),
                "spread_s": float(np.ptp(total)),
                "path_pulses_per_s": float(n_paths * length / np.median(total)),
                "error_db": float(10.0 * np.log10(np.mean(errors[kind, length, width]))),
            }
        )
    return rows


@dataclass(frozen=True)
class Case:
    """A track and a swath for the default setting."""

    name: str
    extent: float = EXTENT
    sway: float = 0.0
    jitter: float = 0.0


CASES = (
    Case("straight track"),
    *(Case(f"smooth curve of {sway:g} m", sway=sway) for sway in SWAY),
    Case(f"rough track, {1e3 * JITTER:g} mm", jitter=JITTER),
    *(Case(f"swath of {1e-3 * extent:g} km", extent=extent) for extent in WIDE),
)


def measure_default(case: Case, n_paths: int, rounds: int) -> dict[str, Any]:
    """Rate and error of what the simulation would use for this track and swath."""
    settings = TraceSettings()
    width = settings.gridding_width
    radar, box = make_radar(case.extent, case.sway, case.jitter)
    end = float(radar.window.start_range.max()) + radar.window.extent
    extra = max(0.0, end - float(direct.box_distance(box, radar.track.position)[1].min()))
    begin = time.perf_counter()
    length = block.choose_block_length(
        radar, np.zeros(3), box, width, settings.tolerance_db, extra_slant_range=extra
    )
    choosing = time.perf_counter() - begin
    paths = Paths(box, n_paths, radar.track.center_position, extra)
    pulses = length if length > 1 else DIRECT_PULSES
    run = run_block if length > 1 else run_direct
    seconds, processor, errors = [], [], []
    for turn in range(rounds + 1):  # turn 0 compiles
        start = (N_PULSES - pulses) * turn // max(rounds, 1)
        before, t0 = time.process_time(), time.perf_counter()
        profiles = run(radar, box, paths, start, start + pulses, width, extra)[2]
        if turn:
            seconds.append(time.perf_counter() - t0)
            processor.append(time.process_time() - before)
        for pulse in (start + pulses // 6, start + 5 * pulses // 6):
            truth = run_direct(radar, box, paths, pulse, pulse + 1, 7, extra)[2][0]
            wrong = np.sum(np.abs(profiles[pulse - start] - truth) ** 2)
            errors.append(float(wrong / np.sum(np.abs(truth) ** 2)))
    return {
        "case": case.name,
        "accumulator": "block" if length > 1 else "direct (fallback)",
        "pulses_per_launch": length,
        "width": width,
        "extra_slant_range_m": extra,
        "choosing_s": choosing,
        "path_pulses_per_s": n_paths * pulses / float(np.median(seconds)),
        # two cores fully used; what other programs take does not count
        "path_pulses_per_2_core_s": 2.0 * n_paths * pulses / float(np.median(processor)),
        "error_db": float(10.0 * np.log10(np.mean(errors))),
        "worst_error_db": float(10.0 * np.log10(np.max(errors))),
    }


@harness.benchmark
def run(quick: bool) -> harness.Report:
    backend = ensure_backend()
    n_paths = N_PATHS // 4 if quick else N_PATHS
    rounds = 2 if quick else 5
    rows = measure(n_paths, rounds)
    defaults = [measure_default(case, n_paths, rounds) for case in CASES]
    machine = f"{backend.variant}, {backend.threads} threads, {platform.processor() or platform.machine()}"
    report = harness.Report(
        "accumulators",
        "Accumulators",
        f"{n_paths} random paths over {EXTENT:g} m, {N_PULSES} pulses, X band at 10 km; {machine}. Errors are of the "
        "profiles of a few pulses against a direct sum 7 cells wide.",
    )
    base = next(r for r in rows if r["accumulator"] == "direct" and r["width"] == 4)["path_pulses_per_s"]
    report.table(
        "By accumulator, block length and width",
        ["accumulator", "pulses", "width", "fill ms", "finish ms", "M path-pulses/s", "ratio", "error dB"],
        [
            [
                r["accumulator"],
                r["pulses_per_launch"],
                r["width"],
                f"{1e3 * r['fill_s']:.0f}",
                f"{1e3 * r['finish_s']:.0f}",
                f"{1e-6 * r['path_pulses_per_s']:.0f}",
                f"{r['path_pulses_per_s'] / base:.1f}",
                f"{r['error_db']:.1f}",
            ]
            for r in rows
        ],
    )
    report.table(
        f"The default: width {TraceSettings().gridding_width}, tolerance {TraceSettings().tolerance_db:g} dB, "
        "a third of the paths multiple reflections; direct adding where no block of 8 pulses holds it",
        [
            "track and swath",
            "accumulator",
            "pulses",
            "M path-pulses/s",
            "with both cores to itself (processor time)",
            "error dB",
            "worst pulse dB",
        ],
        [
            [
                r["case"],
                r["accumulator"],
                r["pulses_per_launch"],
                f"{1e-6 * r['path_pulses_per_s']:.0f}",
                f"{1e-6 * r['path_pulses_per_2_core_s']:.0f}",
                f"{r['error_db']:.1f}",
                f"{r['worst_error_db']:.1f}",
            ]
            for r in defaults
        ],
    )
    if not quick:
        for r in defaults[: 1 + len(SWAY)]:
            rate = 1e-6 * r["path_pulses_per_s"]
            report.claim(
                f"default accumulator, {r['case']}", rate, 1e-6 * PROMISED_RATE, at_least=True, unit="M/s"
            )
    for r in defaults:
        report.claim(f"its error, {r['case']}", r["worst_error_db"], PROMISED_DB, at_least=False, unit="dB")
    report.data |= {"machine": machine, "n_paths": n_paths, "rows": rows, "defaults": defaults}
    return report


if __name__ == "__main__":
    harness.main(run)
