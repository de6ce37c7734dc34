"""Strong targets beside weak clutter, and the same result whatever the machine does."""

import importlib

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.direct import plan_direct, spread_reference
from sarmitsuba.tracing.kernel.accumulators import DirectAccumulator
from sarmitsuba.tracing.kernel.state import Contribution


def radar_over_box() -> tuple[Radar, np.ndarray]:
    track = Track.straight([-7e3, 0.0, 7e3], [0.0, 100.0, 0.0], 100.0, 1)
    box = np.array([[-50.0, -50.0, 0.0], [50.0, 50.0, 10.0]])
    distance = np.linalg.norm(track.position[0])
    zero = np.zeros((1, 3))
    window = ReceiveWindow(np.array([distance - 60.0]), 0.4, 300)
    radar = Radar(
        "spotlight", track, Waveform(9.65e9, 300e6, 2e-6), Antenna(), Pointing(zero, zero, zero), window
    )
    return radar, box


class SingleAccumulator(DirectAccumulator):
    """Sums in float32, as Dr.Jit's default arrays would."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.memory = dr.zeros(mi.Float, len(self.memory))

    def scatter(self, cell, values, weight, active) -> None:
        packet = mi.Vector2f(values[0].real * weight, values[0].imag * weight)
        dr.scatter_add(self.memory, packet, cell, active, mode=dr.ReduceMode.Expand)

    def grid(self) -> np.ndarray:
        n = int(np.prod(self.shape))
        return self.memory.numpy()[: 2 * n].view(np.complex64).reshape(self.shape)


def test_sixty_dbsm_beside_clutter(row) -> None:
    """A plate of 60 dBsm at normal incidence, a million rays in phase, in clutter of -30 dBsm per ray pair.

    Naive way: sums in float32; adding a millionth to what has grown near one rounds the same way every time.
    """
    ensure_backend()
    radar, box = radar_over_box()
    plan = plan_direct(radar, 0, 1, box, 4)
    rng = np.random.default_rng(0)
    n = 1_000_000
    distance = np.linalg.norm(radar.track.position[0])
    half = np.concatenate([np.full(n, distance + 3.3), distance + rng.uniform(-30.0, 30.0, n)])
    amplitude = np.concatenate([np.full(n, 1e3 / n), 10**-1.5 / np.sqrt(n) * rng.standard_normal(n)])
    truth = spread_reference(plan, radar, half[:, None], amplitude[None].astype(complex))
    peak = np.abs(truth).max()

    def error(kind: type[DirectAccumulator]) -> np.ndarray:
        accumulator = kind(plan, 1, 1, 0, radar.waveform.wavelength)
        a = mi.Complex2f(mi.Float(amplitude.astype(np.float32)), mi.Float(0))
        pulse = dr.zeros(mi.UInt32, 2 * n)
        one = mi.UInt32(1)
        paths = Contribution(
            one, one, pulse, mi.Float64(half), mi.Float64(0), (a,), mi.Bool(True), mi.Vector3d(0)
        )
        state = accumulator.add(accumulator.begin(), paths)
        dr.eval(state, accumulator.memory)
        return np.abs(accumulator.grid() - truth)

    ours, naive = error(DirectAccumulator), error(SingleAccumulator)
    row(
        "60 dBsm in a million rays: error of the sum below its peak",
        20 * np.log10(ours.max() / peak),
        -100.0,
        "dB",
        naive=20 * np.log10(naive.max() / peak),
        remedy="grids in float64",
    )
    target = int(np.abs(truth).argmax())
    away = np.abs(np.arange(truth.size) - target).reshape(truth.shape) > 8
    clutter = np.sqrt(np.mean(np.abs(truth[away]) ** 2))
    row(
        "the same: error in the clutter, below the clutter",
        20 * np.log10(ours[away].max() / clutter),
        -40.0,
        "dB",
    )


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # few pulses, few rays
@pytest.mark.parametrize("method", ["hybrid", pytest.param("raw", marks=pytest.mark.slow)])
def test_same_result_for_any_threads_and_batches(row, monkeypatch, method: str) -> None:
    """Same seed: threads and batch sizes change only the order of float64 sums.

    Naive way: float32 sums, whose last digits hang on which thread adds first (test above).
    """
    ensure_backend()
    scene = sarmitsuba.load_scene(
        "tower",
        parameters={
            "sar_path.ray_spacing": "0.6",
            "sar_path.diffuse_ray_spacing": "0.6",
            "sar_antenna.n_pulses": "64",
            "sar_path.max_depth": "3",
            "sar_path.method": method,
            "sar_path.key_pulse_interval": "16" if method == "hybrid" else "0",
        },
    )
    first = sarmitsuba.simulate(scene).data
    peak = np.abs(first).max()
    changes = {}
    threads = dr.thread_count()
    try:
        for count in (1, 3):
            dr.set_thread_count(count)
            changes[f"{count} threads"] = float(np.abs(sarmitsuba.simulate(scene).data - first).max() / peak)
    finally:
        dr.set_thread_count(threads)
    changes["again"] = float(np.abs(sarmitsuba.simulate(scene).data - first).max() / peak)
    monkeypatch.setattr(
        importlib.import_module("sarmitsuba.simulation.execution.tracing"), "MAX_LANES", 20_000
    )
    changes["small batches"] = float(np.abs(sarmitsuba.simulate(scene).data - first).max() / peak)
    print(changes)
    row(
        f"method {method}: change with threads, batches and repetition, over the peak",
        max(changes.values()),
        1e-6,
        remedy="sums in float64, seeds by ray and cell",
    )
