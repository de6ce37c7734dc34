"""A city of 1 km x 1 km at 0.25 m with 8192 pulses on many machines, planned from rates measured on a piece of it."""

import dataclasses
import tempfile
import time

from benchmarks.support import harness
from sarmitsuba import load_scene
from sarmitsuba.apps.cluster import ClusterPlan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.prediction.needs import Needs
from sarmitsuba.simulation.planning.prediction.prediction import Prediction, predict
from tests.support.city import make_city

# m, and buildings on them: one every 20 m on both, so that what a ray meets is alike
CITY, PIECE, PLOT = 1000.0, 120.0, 20.0
PULSES = 8192
# error bars: two sets of rays
SUBSETS = 2
# cores of the workers planned with, and what one costs for an hour: a usual price of rented cores
CORES, CORE_HOUR = 16, 0.05
WORKERS = (1, 4, 16, 64)


def city(folder: str, extent: float, pulses: int = 0) -> Scene:
    path = make_city(round(extent / PLOT) ** 2, folder, extent=extent, resolution=0.25)
    scene = load_scene(path, parameters={"sar_antenna.n_pulses": str(pulses)} if pulses else {})
    return dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, keep_subsets=True))


def whole(measured: Prediction, piece: Needs, needs: Needs) -> Prediction:
    """The city's prediction: its own rays, samples and pixels at the rates of the piece."""
    per_ray = measured.seconds["trace"] / measured.rays
    per_sample = measured.seconds["synthesise"] / piece.raw_bytes
    interval = min(measured.key_pulse_interval, needs.key_pulse_interval)
    keys = -(-PULSES // interval)
    # finer lattices over small parts are in what was traced and not in what is planned
    finer = (measured.rays / measured.key_pulses) * SUBSETS / (piece.rays / piece.key_pulses)
    rays = finer * keys * needs.rays / needs.key_pulses
    seconds = {
        "trace": rays * per_ray,
        "synthesise": needs.raw_bytes * per_sample,
        "focus": needs.pixels * PULSES / measured.pixel_pulses_per_second,
    }
    return dataclasses.replace(
        measured,
        seconds={name: value / CORES for name, value in seconds.items()},
        rays=round(rays),
        key_pulses=keys * SUBSETS,
        key_pulse_interval=interval,
        pixels=needs.pixels,
        raw_bytes=needs.raw_bytes,
        memory=needs.memory,
    )


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "scale",
        "A city on many machines",
        f"{CITY:g} m x {CITY:g} m of buildings at 0.25 m, {PULSES} pulses, on paper: processor seconds per ray, sample "
        f"and pixel-pulse are measured on {PIECE:g} m of it, and its rays, samples and pixels counted by the program's "
        f"own plan. A worker has {CORES} cores that are taken to be as fast as those here; `ClusterPlan` has the "
        "formula.",
    )
    with tempfile.TemporaryDirectory() as folder:
        small = city(folder, PIECE / 2 if quick else PIECE)
        _, measured = predict(small, clock=time.process_time)
        large = city(folder, CITY, PULSES)
        needs = Run(large).needs()
        found = whole(measured, Run(small).needs(), needs)
    rate = measured.rays / measured.seconds["trace"]
    report.table(
        "What is measured, one core",
        ["rays/s", "samples/s", "pixel-pulses/s", "pulses per tracing"],
        [
            [
                f"{rate:.3g}",
                f"{measured.raw_bytes / 8 / measured.seconds['synthesise']:.3g}",
                f"{measured.pixel_pulses_per_second:.3g}",
                found.key_pulse_interval,
            ]
        ],
    )
    report.table(
        "What the city takes",
        ["rays", "tracings", "raw data, GB", "pixels, all layers", "core hours", "GB of the client"],
        [
            [
                f"{found.rays:.3g}",
                found.key_pulses,
                f"{1e-9 * found.raw_bytes:.3g}",
                f"{found.pixels:.3g}",
                f"{CORES * found.total / 3600:.3g}",
                f"{1e-9 * needs.memory:.3g}",
            ]
        ],
    )
    plans = [
        ClusterPlan.of(large, found, n, bytes_per_second=1.25e9, price_per_hour=CORES * CORE_HOUR)
        for n in WORKERS
    ]
    report.table(
        f"Plans: workers of {CORES} cores at {CORE_HOUR} an hour and core, a network of 10 Gbit/s",
        ["workers", "hours", "of it traffic", "GB traffic", "busy", "cost"],
        [
            [
                plan.workers,
                f"{plan.seconds / 3600:.3g}",
                f"{plan.moving_seconds / 3600:.3g}",
                f"{1e-9 * plan.moved_bytes:.3g}",
                f"{100 * plan.efficiency:.0f} %",
                f"{plan.price:.3g}",
            ]
            for plan in plans
        ],
    )
    report.data["plans"] = [plan.as_dict() for plan in plans]
    return report


if __name__ == "__main__":
    harness.main(run)
