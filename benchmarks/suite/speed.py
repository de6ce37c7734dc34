"""Speed claims on Munich: hybrid against raw, its error, the kernel against bare ray queries, where the time goes."""

import time
from dataclasses import replace
from typing import Any

from benchmarks.support import harness

SPACING = 0.25  # m between rays: 4 per metre
DEPTH = 3
EVERY = 64  # raw is traced on every 64th pulse, 30 M rays: more would only repeat the same comparison
# pulses a quarter block off their key pulses, like the average one; the reference has four times the rays
CONVERGED_EVERY = 192


def thinned(scene: Any, every: int) -> Any:
    """The scene with every so-manieth pulse of its track."""
    return replace(scene, radar=scene.radar.of_pulses(slice(every // 2, None, every)))


def rough(scene: Any) -> Any:
    """The scene with Lambert's law on every material: the dearest kernel."""
    materials = tuple(replace(m, diffuse_law="lambert", diffuse_level_db=-10.0) for m in scene.materials)
    return replace(scene, materials=materials)


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.signal.metrics import image_error_db
    from sarmitsuba.simulation.planning.sampling.piece import crop

    report = harness.Report(
        "speed",
        "Speed",
        f"Munich (sionna-rt) under `airborne_x`: 400 m x 400 m, {1 / SPACING:g} rays per metre, 512 pulses, "
        f"{DEPTH} bounces, one "
        "polarisation. `as shipped`: its smooth materials; `rough`: Lambert's law of -10 dB on all. Raw "
        "is traced on every "
        f"{EVERY}th pulse with the same rays as hybrid; its time is scaled by that number. Warm runs, medians.",
    )
    munich = None if quick else harness.load_munich()
    scene = munich if munich is not None else crop(load_scene("buildings16"), 0.5, 0.25)
    if munich is None:
        report.notes.append(
            "Munich is not here (quick, or sionna-rt is not installed): a part of buildings16 instead."
        )
    scene = harness.with_settings(scene, max_depth=DEPTH, ray_spacing=SPACING, method="hybrid")
    cases = {"as shipped": scene}
    if munich is not None:
        cases["rough"] = rough(scene)
    rounds = harness.ROUNDS_QUICK if quick else harness.ROUNDS
    rows, shares = [], []
    for name, case in cases.items():
        best, few, hybrid, direct, timing = _raw_data(case, rounds)
        pick = slice(EVERY // 2, None, EVERY)
        error = image_error_db(hybrid.data[:, pick], direct.data)
        stats, seconds = hybrid.metadata["statistics"], hybrid.metadata["seconds"]
        raw_seconds = timing["raw"].median * case.radar.track.n_pulses / few.radar.track.n_pulses
        paths = stats["rays"] / seconds["trace"]
        added = stats["path_pulses"] / (seconds["trace"] + seconds["synthesise"])
        rows.append(
            [
                name,
                timing["hybrid"].median,
                raw_seconds,
                raw_seconds / timing["hybrid"].median,
                error,
                paths / 1e6,
                added / 1e6,
            ]
        )
        total = sum(seconds.values())
        shares.append([name, *[f"{100 * seconds.get(s, 0.0) / total:.0f}" for s in STAGES]])
        if name == "as shipped":
            report.claim("raw data of 512 pulses", timing["hybrid"].median, 8.0, at_least=False, unit="s")
            report.claim(
                "error against per-pulse tracing, same rays", error, -30.0, at_least=False, unit="dB"
            )
            report.claim(
                "path-pulses added a second over paths traced a second", added / paths, 10.0, at_least=True
            )
            report.data["timing"] = {k: vars(v) for k, v in timing.items()}
            if not quick:
                _equal_error(report, best, raw_seconds)
    report.table(
        "Raw data",
        ["materials", "hybrid s", "raw s (scaled)", "ratio", "error dB", "M paths/s", "M path-pulses/s"],
        [
            [r[0], f"{r[1]:.2f}", f"{r[2]:.0f}", f"{r[3]:.1f}", f"{r[4]:.1f}", f"{r[5]:.1f}", f"{r[6]:.0f}"]
            for r in rows
        ],
    )
    report.table("Where the time goes, %", ["materials", *STAGES], shares)
    report.data["rows"], report.data["shares"] = rows, shares
    _kernel(report, cases, rounds)
    return report


STAGES = ("build", "plan", "launch grid", "trace", "synthesise")


def _raw_data(scene: Any, rounds: int) -> tuple[Any, Any, Any, Any, dict[str, harness.Timing]]:
    from sarmitsuba.simulation.execution.render import simulate
    from sarmitsuba.simulation.planning.pilot import plan_scene

    plan = plan_scene(scene)
    # hybrid and raw must use the same scatterers and launch window, which follow from the whole aperture
    few = harness.with_settings(thinned(scene, EVERY), method="raw", scatterer_cell=_cell(scene))
    scene = harness.with_settings(scene, scatterer_cell=_cell(scene))
    kept: dict[str, Any] = {}

    def job(name: str, case: Any, **options: Any) -> None:
        kept[name] = simulate(case, **options)

    timing = harness.interleave({"hybrid": lambda: job("hybrid", scene)}, rounds)
    one = harness.with_settings(thinned(few, few.radar.track.n_pulses), method="raw")
    simulate(one, plan=plan)  # compiles; one round of raw is long enough to be steady
    start = time.perf_counter()
    job("raw", few, plan=plan)
    seconds = time.perf_counter() - start
    timing["raw"] = harness.Timing(0.0, seconds, seconds, seconds)
    return scene, few, kept["hybrid"], kept["raw"], timing


def _cell(scene: Any) -> float:
    from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan

    return SamplingPlan.of(scene).scatterer_cell


def _equal_error(report: harness.Report, scene: Any, raw_seconds: float) -> None:
    """Errors of raw and of hybrid with several block lengths against converged raw, and their times."""
    from sarmitsuba.signal.metrics import image_error_db
    from sarmitsuba.simulation.execution.render import simulate

    few = harness.with_settings(thinned(scene, CONVERGED_EVERY), method="raw")
    converged = simulate(harness.with_settings(few, **_denser(scene, 0.5)), pass_index=5).data
    exact = image_error_db(simulate(few).data, converged)
    pick = slice(CONVERGED_EVERY // 2, None, CONVERGED_EVERY)
    rows, best = [["raw", exact, raw_seconds, 1.0]], 0.0
    for interval in (0, 64, 32):
        case = harness.with_settings(scene, key_pulse_interval=interval)
        start = time.perf_counter()
        raw = simulate(case)
        seconds = time.perf_counter() - start
        error = image_error_db(raw.data[:, pick], converged)
        length = raw.metadata["sampling"]["key_pulse_interval"]
        rows.append([f"hybrid, K = {length}", error, seconds, raw_seconds / seconds])
        if abs(error - exact) <= 1.0:
            best = max(best, raw_seconds / seconds)
    report.table(
        f"Error against converged raw (four times the rays, its own lattice), every {CONVERGED_EVERY}th pulse",
        ["method", "error dB", "seconds", "faster"],
        [[r[0], f"{r[1]:.2f}", f"{r[2]:.1f}", f"{r[3]:.1f}"] for r in rows],
    )
    report.data["equal_error"] = rows
    report.claim("hybrid against raw, errors within 1 dB", best, 20.0, at_least=True, unit="x")


def _denser(scene: Any, factor: float) -> dict[str, float]:
    from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan

    own = SamplingPlan.of(scene).spacings.diffuse
    return {"ray_spacing": factor * SPACING, "diffuse_ray_spacing": factor * max(own, SPACING)}


class _Sink:
    """Uses every output of the kernel, in registers only; or none of them."""

    def __init__(self, wavelength: float, used: bool) -> None:
        self.wavelength, self.used = wavelength, used

    def begin(self) -> tuple[Any, ...]:
        from sarmitsuba.machine.backend import mi

        return (mi.Complex2f(0.0),)

    def add(self, state: tuple[Any, ...], contribution: Any) -> tuple[Any, ...]:
        from sarmitsuba.machine.backend import dr, mi
        from sarmitsuba.tracing.kernel.accumulators import phase_factor

        if not self.used:
            return state
        c = contribution
        value = mi.Complex2f(mi.Float(c.slant_range) * 1e-30, mi.Float(c.range_rate) * 1e-30)
        phase = phase_factor(c.slant_range, self.wavelength)
        for a in c.amplitudes:
            value = value + a * phase
        return (state[0] + dr.select(c.active, value, mi.Complex2f(0.0)),)


def _kernel(report: harness.Report, cases: dict[str, Any], rounds: int) -> None:
    """Ratio of path rates: bare queries, the whole field, the whole field with the block accumulator."""
    rows = []
    for name, scene in cases.items():
        timing, n_rays = _rates(scene, 2 * rounds)
        rate = {k: n_rays / t.low / 1e6 for k, t in timing.items()}
        rows.append(
            [
                name,
                *rate.values(),
                rate["field"] / rate["queries"],
                rate["field and accumulator"] / rate["queries"],
            ]
        )
        report.data[f"kernel {name}"] = {k: vars(t) for k, t in timing.items()}
    report.table(
        "Path rate of one launch, M paths/s (fastest of the rounds); queries: the same rays intersected only, with the "
        "same bounces and shadow rays",
        [
            "materials",
            "queries",
            "whole field",
            "with block accumulator",
            "field / queries",
            "accumulator / queries",
        ],
        [[r[0], *[f"{v:.2f}" for v in r[1:]]] for r in rows],
    )
    report.claim("whole field over bare queries, path rate", rows[0][4], 0.7, at_least=True)


def _rates(scene: Any, rounds: int) -> tuple[dict[str, harness.Timing], int]:
    """Seconds of one launch, for three accumulators; its number of rays."""
    from sarmitsuba.core.timing import StageTimer
    from sarmitsuba.machine.backend import dr
    from sarmitsuba.signal.block import plan_block
    from sarmitsuba.simulation.execution.tracing import Tracer
    from sarmitsuba.simulation.planning.pilot import plan_scene
    from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
    from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator
    from sarmitsuba.tracing.kernel.kernel import trace
    from sarmitsuba.tracing.kernel.launch import PulseBatch, lattice
    from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene
    from sarmitsuba.tracing.kernel.state import Kernel

    radar = scene.radar
    plan = plan_scene(scene)
    sampling = SamplingPlan.of(scene, plan.flags)
    window = sampling.window
    flags = replace(plan.flags, antenna_pattern=False)
    geometry = build_trace_scene(scene.geometry, scene.materials, radar.waveform.wavelength)
    tracer = Tracer(sampling, flags, geometry, plan.max_depth, StageTimer())
    grid = lattice(window.half_x, window.half_y, SPACING, taper=window.taper, seed=0)
    key = radar.track.center_index
    batch = PulseBatch(radar.track.position[key : key + 1], radar.track.velocity[key : key + 1], window.frame)
    n = radar.track.n_pulses
    start = max(0, n // 2 - 64)
    block = plan_block(radar, start, min(n, start + 128), window.center, sampling.phase_box, 4)

    def run(accumulator: Any) -> None:
        kernel = Kernel.of(geometry, grid, batch, flags, tracer.kernel)
        counts, state = trace(kernel, radar.antenna, accumulator)
        dr.eval(counts.hits, counts.contributions, state, getattr(accumulator, "memory", None))
        dr.sync_thread()

    wavelength, channels = radar.waveform.wavelength, len(flags.channels)
    timing = harness.interleave(
        {
            "queries": lambda: run(_Sink(wavelength, False)),
            "field": lambda: run(_Sink(wavelength, True)),
            "field and accumulator": lambda: run(BlockAccumulator(block, 1, channels, 0, wavelength)),
        },
        rounds,
    )
    return timing, grid.n_rays


if __name__ == "__main__":
    harness.main(run)
