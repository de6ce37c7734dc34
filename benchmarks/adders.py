"""What adding known paths to pulses costs, and how exact it is: direct and block adders, by block length.

Run ``python benchmarks/adders.py [--quick] [--out FOLDER]``. Prints a table; with ``--out`` writes
``adders.json`` and ``adders.md``.

The paths are random points (the worst order for the caches) whose half lengths are computed in float64 inside the
kernel, as the tracing kernel does; the adders are the ones of the tracing kernel. ``fill`` is that kernel,
``finish`` the NumPy part. The error is that of the profiles of a few pulses against a direct sum 7 cells wide.
"""

import argparse
import json
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.echo import block, direct
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.trace.backend import ensure_backend

SLANT_RANGE = 10e3  # m: airborne
EXTENT = 400.0  # m: a city quarter
HEIGHT = 30.0  # m: its houses
FREQUENCY, BANDWIDTH = 9.65e9, 300e6  # Hz: X band, 0.5 m
N_PULSES = 512  # over the aperture that gives 0.5 m in azimuth
N_PATHS = 2_560_000  # 4 rays a metre
DIRECT_PULSES = 8  # pulses the direct adder is timed on: the cost a pulse does not change


def make_radar() -> tuple[Radar, np.ndarray]:
    """Return the radar and the box of phase centres."""
    aperture = SPEED_OF_LIGHT / FREQUENCY * SLANT_RANGE
    center = SLANT_RANGE * np.sqrt(0.5) * np.array([-1.0, 0.0, 1.0])
    track = Track.straight(center, [0.0, 100.0, 0.0], 100.0 * N_PULSES / aperture, N_PULSES)
    box = np.array([[-0.5 * EXTENT, -0.5 * EXTENT, 0.0], [0.5 * EXTENT, 0.5 * EXTENT, HEIGHT]])
    near, far = direct.box_distance(box, track.position)
    spacing = SPEED_OF_LIGHT / (2.4 * BANDWIDTH)
    window = ReceiveWindow(near - 10.0, spacing, int(np.ceil(((far - near).max() + 20.0) / spacing)))
    zero = np.zeros_like(track.position)
    waveform = Waveform(FREQUENCY, BANDWIDTH, 2e-6)
    return Radar("spotlight", track, waveform, Antenna(), Pointing(zero, zero, zero), window), box


class Paths:
    """Random paths in the box on the device."""

    def __init__(self, box: np.ndarray, n: int) -> None:
        import drjit as dr
        import mitsuba as mi

        rng = np.random.default_rng(1)
        self.n = n
        self.position = [mi.Float64(rng.uniform(box[0, i], box[1, i], n)) for i in range(3)]
        re, im = (rng.standard_normal(n, dtype=np.float32) for _ in range(2))
        self.amplitude = mi.Complex2f(mi.Float(re), mi.Float(im))
        dr.eval(self.position, self.amplitude)

    def add(self, adder: Any, position: np.ndarray, velocity: np.ndarray) -> None:
        """Add every path as seen from each of the antenna positions (m, 3)."""
        import drjit as dr
        import mitsuba as mi

        index = dr.arange(mi.UInt32, self.n * len(position))
        pulse = index // dr.opaque(mi.UInt32, self.n)
        path = index - pulse * dr.opaque(mi.UInt32, self.n)
        antenna = [dr.gather(mi.Float64, mi.Float64(position[:, i]), pulse) for i in range(3)]
        motion = [dr.gather(mi.Float64, mi.Float64(velocity[:, i]), pulse) for i in range(3)]
        d = [a - dr.gather(mi.Float64, p, path) for a, p in zip(antenna, self.position, strict=True)]
        half = dr.sqrt(dr.fma(d[0], d[0], dr.fma(d[1], d[1], d[2] * d[2])))
        rate = (d[0] * motion[0] + d[1] * motion[1] + d[2] * motion[2]) / half
        amplitude = dr.gather(mi.Complex2f, self.amplitude, path)
        state = adder.add(adder.begin(), mi.UInt32(1), pulse, half, rate, [amplitude], mi.Bool(True))
        dr.eval(state, adder.memory)
        dr.sync_thread()


def run_direct(
    radar: Radar, box: np.ndarray, paths: Paths, start: int, stop: int, width: int
) -> tuple[Any, ...]:
    """Seconds to fill, seconds to finish, profiles (K, n_samples)."""
    from sarmitsuba.trace.adders import DirectAdder

    t0 = time.perf_counter()
    plan = direct.plan_direct(radar, start, stop, box, width)
    adder = DirectAdder(plan, 1, 1, 0, radar.waveform.wavelength)
    paths.add(adder, radar.track.position[start:stop], radar.track.velocity[start:stop])
    t1 = time.perf_counter()
    profiles = direct.finish(adder.grid(), plan, radar)[0]
    return t1 - t0, time.perf_counter() - t1, profiles


def run_block(
    radar: Radar, box: np.ndarray, paths: Paths, start: int, stop: int, width: int
) -> tuple[Any, ...]:
    """Seconds to fill, seconds to synthesise, profiles (K, n_samples)."""
    from sarmitsuba.trace.adders import BlockAdder

    t0 = time.perf_counter()
    plan = block.plan_block(radar, start, stop, np.zeros(3), box, width)
    adder = BlockAdder(plan, 1, 1, 0, radar.waveform.wavelength)
    paths.add(adder, plan.position[None], plan.velocity[None])
    t1 = time.perf_counter()
    profiles = block.synthesise(adder.grid(), plan, radar)[0]
    return t1 - t0, time.perf_counter() - t1, profiles


def measure(n_paths: int, rounds: int) -> list[dict[str, Any]]:
    """Interleaved rounds of all adders; medians and spreads."""
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
                "adder": kind,
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


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown table; the ratio is to the direct adder 4 cells wide."""
    base = next(r for r in rows if r["adder"] == "direct" and r["width"] == 4)["path_pulses_per_s"]
    lines = [
        "| adder | pulses | width | fill ms | finish ms | M path-pulses/s | ratio | error dB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        rate = r["path_pulses_per_s"]
        lines.append(
            f"| {r['adder']} | {r['pulses_per_launch']} | {r['width']} | {1e3 * r['fill_s']:.0f} "
            f"| {1e3 * r['finish_s']:.0f} | {rate / 1e6:.0f} | {rate / base:.1f} | {r['error_db']:.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a quarter of the paths, two rounds")
    parser.add_argument("--out", type=Path, help="folder for adders.json and adders.md")
    args = parser.parse_args()
    backend = ensure_backend()
    n_paths = N_PATHS // 4 if args.quick else N_PATHS
    rows = measure(n_paths, 2 if args.quick else 5)
    machine = f"{backend.variant}, {backend.threads} threads, {platform.processor() or platform.machine()}"
    title = f"{n_paths} random paths over {EXTENT:g} m, {N_PULSES} pulses, X band at 10 km; {machine}"
    text = f"{title}\n\n{table(rows)}\n"
    print(text)
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "adders.md").write_text(text, encoding="utf-8")
        facts = {"machine": machine, "n_paths": n_paths, "rows": rows}
        (args.out / "adders.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
