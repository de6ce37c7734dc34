"""What the effects plan saves and costs: kernels, planned against everything on, predicted against measured.

Run ``python -m benchmarks.studies.effects [SCENE ...] [--quick] [--out FOLDER] [--page]``. Prints Markdown tables and
writes ``effects.json``, in which scenes and parts that are not run keep their results; ``--page`` makes a page of the
site.

Every time is the least of interleaved rounds with compiled kernels: the machine may be busy with other things, and
what disturbs a run only makes it longer. Ratios and shares are of processor seconds, summed over all threads, which
other jobs disturb least. Predictions and the runs they are compared with are made in processes of their own.
"""

import argparse
import importlib.util
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import harness
from benchmarks.support.corrections import block_of, correction_lines, correction_table, one_batch
from benchmarks.support.effect_pairs import pair_lines, pair_table
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.loading.library import list_scenes, resolve, resolve_radar
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.machine.memory import peak_memory
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TOLERANCE_DB
from sarmitsuba.signal.block import BlockPlan
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.tracing import Tracer
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.prediction.prediction import predict
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.launch import lattice
from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene
from tests.support.unweighted import focus

DEPTH = 8  # "everything on": where the pilot stops looking, too
# of the predictions, each in a process of its own
ROUNDS, QUICK_ROUNDS = 3, 1
# rounds of a plan against everything on: enough that five per cent can be told from chance in runs of milliseconds
LEAST_ROUNDS, MOST_ROUNDS, SPENT = 3, 30, 2.0
# processor seconds up to which every pulse is traced, not predicted
RUN_AT_MOST = 60.0
SHORT, SHORT_ROUNDS = 0.1, 6  # s; so short a first run of a process varies more
COST_SPACING = 0.4  # m between rays of the kernel table: a quarter of a million, 0.1 s of one thread
COST_ROUNDS = 8  # so short a time is disturbed often, and the least of many is not

# kernel switches, and the effect of the plan that each belongs to
SWITCHES = {
    "max_depth": {"multi_bounce": False},
    "diffuse": {"diffuse": False, "diffuse_double": False},
    "coherent": {"coherent": False},
    "fresnel": {"fresnel": False},
    "roughness": {"roughness": False},
    "speckle": {"speckle": False},
    "diffuse_double": {"diffuse_double": False},
    "cross_polarisation": {"channels": ("HH", "VV")},
    "depolarisation": {"depolarisation": False},
    "antenna_pattern": {"antenna_pattern": False},
    "spreading": {"spreading": False},
    "visibility": {"visibility": False},
    "tube_phase": {"tube_phase": False},
}
# arithmetic in LLVM's intermediate code, and ray queries; gathers vary with where tables lie in memory
ARITHMETIC = re.compile(r"= (?:f\w+ |xor |lshr |[su]itofp |call [^@]*@llvm\.(?!masked))|call void %")


def munich() -> Path | None:
    """Scene file of the city that the package sionna-rt brings, None without it."""
    spec = importlib.util.find_spec("sionna")
    folders = list(spec.submodule_search_locations or []) if spec else []
    path = Path(folders[0]) / "rt/scenes/munich/munich.xml" if folders else None
    return path if path is not None and path.exists() else None


def load(name: str) -> Scene:
    """A shipped scene by name, or ``munich`` under the airborne X-band radar."""
    if name == "munich":
        path = munich()
        assert path is not None, "the package sionna-rt is missing"
        fixed = {
            "n_pulses": "512",
            "aim_x": "0",
            "aim_y": "0",
            "aim_z": "0",
        }  # the same from version to version
        return load_scene(path, radar=resolve_radar("airborne_x"), parameters=fixed)
    return load_scene(resolve(name))


def everything_on(scene: Scene, planned: EffectsPlan) -> EffectsPlan:
    """All switches on; a law without polarisation stays one."""
    return EffectsPlan(
        KernelFlags(channels=scene.radar.channels, polarised_diffuse=planned.flags.polarised_diffuse), DEPTH
    )


# ---- kernels


def kernel_table(rounds: int) -> list[dict[str, Any]]:
    """Arithmetic instructions and time of the trace kernel with each effect left out, on the urban block."""
    import drjit as dr

    scene = load("urban_block")
    antenna = Antenna("gaussian", 1.0, 0.02, 0.05)
    channels = ("HH", "HV", "VH", "VV")
    materials = tuple(replace(m, cross_polar_ratio_db=-12.0) for m in scene.materials)
    scene = replace(
        scene, radar=replace(scene.radar, antenna=antenna, channels=channels), materials=materials
    )
    window = SamplingPlan.of(scene).window
    grid = lattice(window.half_x, window.half_y, COST_SPACING, taper=window.taper)
    built = build_trace_scene(scene.geometry, scene.materials, scene.radar.waveform.wavelength)
    full = KernelFlags(channels=channels, polarised_diffuse=False)
    rows: list[dict[str, Any]] = []
    block: BlockPlan | None = None
    for name, off in {"everything on": {}, **SWITCHES}.items():
        flags = replace(full, **off)  # type: ignore[arg-type]
        radar = replace(scene.radar, channels=flags.channels)
        sampling = SamplingPlan.of(replace(scene, radar=radar), flags)
        depth = 3 if flags.multi_bounce else 1
        job = Tracer(sampling, flags, built, depth, StageTimer(time.process_time))
        block = block or block_of(sampling)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            one_batch(job, block, grid)
            codes = [k["ir"].getvalue() for k in dr.kernel_history() if "ir" in k]
            dr.kernel_history_clear()
        count = max(len(ARITHMETIC.findall(code)) for code in codes)
        rows.append({"effect": name, "instructions": count, "job": job, "seconds": np.inf})
    for _ in range(rounds):
        for row in rows:
            row["seconds"] = min(row["seconds"], one_batch(row["job"], block, grid))
    for row in rows:
        del row["job"]
        row["cost"] = 1.0 - row["seconds"] / rows[0]["seconds"]
        row["instructions_less"] = rows[0]["instructions"] - row["instructions"]
    return rows


# ---- planned against everything on


def error_db(image: Any, reference: Any) -> float:
    """Energy of the difference over that of the reference, dB."""
    share = np.square(np.abs(image - reference)).sum() / np.square(np.abs(reference)).sum()
    return 10.0 * float(np.log10(max(float(share), 1e-30)))


def planned_row(name: str, quick: bool) -> dict[str, Any]:
    """Image error and time ratios of one scene."""
    scene = load(name)
    decided = plan_scene(scene)
    full = everything_on(scene, decided)
    wall: dict[str, list[float]] = {"plan": [], "all": []}
    cpu: dict[str, list[float]] = {"plan": [], "all": []}
    images: dict[str, Any] = {}
    planning, stages = np.inf, {}
    rounds, spent = 0, 0.0
    while rounds <= (1 if quick else LEAST_ROUNDS) or (not quick and spent < SPENT and rounds <= MOST_ROUNDS):
        for key, plan in (("plan", None), ("all", full)):
            start, before = time.perf_counter(), time.process_time()
            raw = simulate(scene, plan=plan, clock=time.process_time)
            taken, used = time.perf_counter() - start, time.process_time() - before
            if rounds == 0:
                images[key] = focus(raw).data  # the first round compiles
                continue
            spent += taken
            wall[key].append(taken)
            cpu[key].append(used)
            if key == "plan":
                planning = min(planning, raw.metadata["seconds"]["plan"])
                stages = raw.metadata["seconds"]
        rounds += 1
    focusing = np.inf
    for _ in range(3):
        before = time.process_time()
        focus(raw)
        focusing = min(focusing, time.process_time() - before)
    reference = images["all"]
    a = images["plan"]
    cell = float(np.abs(a - reference).max() / np.sqrt(np.mean(np.square(np.abs(reference)))))
    row: dict[str, Any] = {
        "scene": name,
        "mesh": scene.geometry.n_faces > 0,
        "plan": decided.summary(),
        "max_depth": decided.max_depth,
        "why": decided.decisions[0].why,
        "off": [d.name for d in decided.decisions if not d.on and d.value is None],
        "on": [d.name for d in decided.decisions if d.on and d.value is None],
        "error_db": error_db(a, reference),
        "worst_pixel_db": 20 * float(np.log10(max(cell, 1e-15))),
        "seconds_plan": min(wall["plan"]),
        "seconds_all": min(wall["all"]),
        "ratio": min(cpu["all"]) / min(cpu["plan"]),
        "cpu_plan": min(cpu["plan"]),
        "cpu_all": min(cpu["all"]),
        "cpu_focus": focusing,
        "slower": (min(cpu["plan"]) + focusing) / (min(cpu["all"]) + focusing),
        "rounds": rounds - 1,
        "pilot": bool(decided.pilot),
        "plan_seconds": planning,
        "plan_share": planning / (min(cpu["plan"]) + focusing),
        "stages": {k: round(v, 4) for k, v in stages.items()},
    }
    if scene.geometry.n_faces and not quick:
        row |= every_pulse(scene, decided, full, images, min(cpu["plan"]))
    return row


def every_pulse(
    scene: Scene, planned: EffectsPlan, full: EffectsPlan, images: dict[str, Any], cpu_plan: float
) -> dict[str, Any]:
    """No plan at all: every effect on and every pulse traced. Run where that takes less than a minute."""
    raw_scene = replace(scene, settings=replace(scene.settings, method="raw"))
    _, prediction = predict(raw_scene, plan=full, clock=time.process_time)
    total = sum(v for k, v in prediction.seconds.items() if k != "focus")
    row: dict[str, Any] = {"every_measured": total < RUN_AT_MOST, "predicted_every": total}
    if row["every_measured"]:
        before = time.process_time()
        raw = simulate(raw_scene, plan=full)
        total = time.process_time() - before
        reference = focus(raw).data
        row["every_error_db"] = error_db(images["plan"], reference)
    return row | {"cpu_every": total, "ratio_every": total / cpu_plan}


# ---- predicted against measured


def in_process(action: str, name: str) -> dict[str, Any]:
    """Run this file in a process of its own and read the JSON that it prints."""
    command = [sys.executable, "-m", "benchmarks.studies.effects", name, f"--{action}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def measured(name: str) -> dict[str, Any]:
    """Simulate and focus once, kernels compiled before; seconds and most memory."""
    scene = load(name)
    ensure_backend()
    start, before = time.perf_counter(), time.process_time()
    raw = simulate(scene)
    image = focus(raw)
    seconds, cpu = time.perf_counter() - start, time.process_time() - before
    assert np.isfinite(image.data).all()
    return {"seconds": seconds, "cpu": cpu, "memory": peak_memory(), "stages": raw.metadata["seconds"]}


def predicted(name: str) -> dict[str, Any]:
    """Seconds and memory of the same, before it is run."""
    scene = load(name)
    start = time.perf_counter()
    _, prediction = predict(scene)
    took = time.perf_counter() - start
    _, processor = predict(scene, clock=time.process_time)
    return {
        "seconds": prediction.total,
        "cpu": processor.total,
        "memory": prediction.memory,
        "stages": dict(prediction.seconds),
        "cpu_stages": dict(processor.seconds),
        "took": took,
    }


def prediction_row(name: str, rounds: int) -> dict[str, Any]:
    """Predicted and measured time and memory of one scene, in turn, processes of their own."""
    in_process("measure", name)  # compiles
    predictions, runs = [], []
    while len(runs) < rounds or (
        rounds > QUICK_ROUNDS and len(runs) < SHORT_ROUNDS and runs[0]["seconds"] < SHORT
    ):
        predictions.append(in_process("predict", name))
        runs.append(in_process("measure", name))

    def least(rows: list[dict[str, Any]], key: str) -> float:
        return float(min(row[key] for row in rows))

    row = {
        "scene": name,
        "predicted_seconds": least(predictions, "seconds"),
        "measured_seconds": least(runs, "seconds"),
        "predicted_cpu": least(predictions, "cpu"),
        "measured_cpu": least(runs, "cpu"),
        "predicted_memory": max(p["memory"] for p in predictions),
        "measured_memory": max(r["memory"] for r in runs),
        "explain_seconds": least(predictions, "took"),
    }
    row["time_factor"] = row["predicted_seconds"] / row["measured_seconds"]
    row["cpu_factor"] = row["predicted_cpu"] / row["measured_cpu"]
    row["memory_factor"] = row["predicted_memory"] / row["measured_memory"]
    return row


# ---- output


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms" if seconds < 0.1 else f"{seconds:.2f} s"


def claims(rows: list[dict[str, Any]]) -> list[tuple[str, float, float, bool, str]]:
    """What the plan promises, over the scenes measured: text, figure, bound, whether it is the least, unit."""
    found = [
        (f"{r['scene']}, one bounce: everything on over planned", r["ratio_every"], 3.0, True, "")
        for r in rows
        if r["mesh"] and r["max_depth"] == 1 and "ratio_every" in r
    ]

    def worst(text: str, key: str, bound: float, unit: str, factor: float = 1.0) -> None:
        measured = [r for r in rows if key in r]
        if measured:
            r = max(measured, key=lambda r: float(r[key]))
            found.append((f"{text}: {r['scene']}", factor * r[key], bound, False, unit))

    worst("simulated and focused, planned over same key pulses", "slower", 1.05, "")
    worst("planning, of simulating and focusing", "plan_share", 5.0, " %", 100.0)
    worst("error against everything on, same key pulses", "error_db", TOLERANCE_DB, " dB")
    worst("error against everything on, every pulse", "every_error_db", TOLERANCE_DB, " dB")
    return found


HEAD = """# Cost of effects

`python -m benchmarks.studies.effects --page` makes this page: what each effect costs, and what the plan of effects
saves. *Everything on* is no plan at all: every effect on, eight bounces, every pulse traced. *Same key pulses* keeps
the plan's key pulses, and shows what the effects alone save. All runs of a scene have equally dense rays. The error is
the energy of the difference of two focused images. Times are processor seconds.

"""


def markdown(results: dict[str, Any]) -> str:
    """The tables."""
    lines = [f"Machine: {results['machine']}."]
    if results["kernels"]:
        lines += [
            "",
            "## Kernel with each effect left out",
            "",
            "Urban block, four channels, Gaussian beam, three bounces.",
            "",
            "| effect left out | arithmetic instructions | fewer | time of the kernel it takes |",
            "|---|---|---|---|",
        ]
        for r in results["kernels"]:
            first = r["effect"] == "everything on"
            less = "" if first else f"{r['instructions_less']}"
            cost = f"{1e3 * r['seconds']:.0f} ms" if first else f"{100 * r['cost']:.0f} %"
            lines.append(f"| {r['effect']} | {r['instructions']} | {less} | {cost} |")
    if results["corrections"]:
        lines += correction_lines(results["corrections"])
    if results["pairs"]:
        lines += pair_lines(results["pairs"])
    if results["plans"]:
        lines += [
            "",
            "## Planned against everything on",
            "",
            f"Everything on is no plan at all: every switch, {DEPTH} bounces, every pulse traced; `same key pulses` "
            "keeps the plan's key pulses. Same density of rays. Times, ratios and shares are of processor seconds, "
            "without focusing; planning: share of simulating and focusing; `(p)`: predicted, it would take more than a "
            "minute. Error: energy of the difference of the focused images over that of the image, against everything "
            "on at the same key pulses and with every pulse; worst pixel: over the image's rms.",
            "",
            "| scene | bounces | effects left out | error | worst pixel | error, every pulse | planned | "
            "same key pulses | ratio | everything on | ratio | planning |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|",
        ]
        for r in results["plans"]:
            mark = "" if r.get("every_measured") else " (p)"
            every = (
                f"{r['cpu_every']:.2f} s{mark} | {r['ratio_every']:.2f}{mark}" if "cpu_every" in r else " | "
            )
            pulses = f"{r['every_error_db']:.0f} dB" if "every_error_db" in r else ""
            planning = f"{'pilot' if r['pilot'] else 'facts'}, {1e3 * r['plan_seconds']:.1f} ms"
            lines.append(
                f"| {r['scene']} | {r['max_depth']} | {', '.join(r['off'])} | {r['error_db']:.0f} dB | "
                f"{r['worst_pixel_db']:.0f} dB | {pulses} | {_time(r['cpu_plan'])} | {_time(r['cpu_all'])} | "
                f"{r['ratio']:.2f} | {every} | {planning}, {100 * r['plan_share']:.1f} % |"
            )
        lines += ["", "| promised | measured | bound | |", "|---|---|---|---|"]
        for text, value, bound, least, unit in claims(results["plans"]):
            met = value >= bound if least else value <= bound
            lines.append(
                f"| {text} | {value:.2f}{unit} | {'>=' if least else '<='} {bound:g}{unit} | "
                f"{'met' if met else '**not met**'} |"
            )
        lines += ["", "Why so many bounces:", ""]
        lines += [f"- {r['scene']}: {r['max_depth']}; {r['why']}" for r in results["plans"]]
    if results["predictions"]:
        lines += [
            "",
            "## Predicted against measured",
            "",
            "The first simulating and focusing of a process, kernels compiled before; memory is the most it held.",
            "",
            "| scene | predicted | measured | factor | processor time, factor | predicted | measured | factor | "
            "explain took |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for r in results["predictions"]:
            lines.append(
                f"| {r['scene']} | {_time(r['predicted_seconds'])} | {_time(r['measured_seconds'])} | "
                f"{r['time_factor']:.2f} | {r['cpu_factor']:.2f} | {r['predicted_memory'] / 2**20:.0f} MiB | "
                f"{r['measured_memory'] / 2**20:.0f} MiB | {r['memory_factor']:.2f} | {r['explain_seconds']:.1f} s |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help="names of shipped scenes, or munich (default: all)")
    parser.add_argument("--quick", action="store_true", help="one round, no prediction, no kernel table")
    parser.add_argument(
        "--only", choices=("kernels", "corrections", "pairs", "plans", "predictions"), help="one of the parts"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        default=harness.RESULTS,
        help="of effects.json, adding to the one there",
    )
    parser.add_argument("--page", action="store_true", help="make a page in docs/generated")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--predict", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    backend = ensure_backend()
    if args.measure or args.predict:
        print(json.dumps((measured if args.measure else predicted)(args.scenes[0])))
        return
    names = args.scenes or [e.name for e in list_scenes()] + (["munich"] if munich() else [])
    parts = (
        [args.only]
        if args.only
        else ["plans"]
        if args.quick
        else ["kernels", "corrections", "pairs", "plans", "predictions"]
    )
    results: dict[str, Any] = {"kernels": [], "corrections": [], "pairs": [], "plans": [], "predictions": []}
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "effects.json"
    if file.is_file():  # parts and scenes not run now stay
        results |= json.loads(file.read_text(encoding="utf-8"))

    def keep() -> None:
        file.write_text(json.dumps(results, indent=1), encoding="utf-8")

    results["machine"] = (
        f"{platform.machine()}, {os.cpu_count()} cores, {backend.variant}, Python {platform.python_version()}"
    )
    if "kernels" in parts:
        results["kernels"] = kernel_table(COST_ROUNDS)
        keep()
    if "corrections" in parts:
        results["corrections"] = correction_table(load("munich" if munich() else "urban_block"), ROUNDS)
        keep()
    if "pairs" in parts:
        made = pair_table(SWITCHES, args.scenes)
        rest = [row for row in results["pairs"] if row["effect"] not in {new["effect"] for new in made}]
        results["pairs"] = sorted([*rest, *made], key=lambda row: str(row["effect"]))
        keep()
    measures: dict[str, Callable[[str], dict[str, Any]]] = {
        "plans": lambda name: planned_row(name, args.quick),
        "predictions": lambda name: prediction_row(name, QUICK_ROUNDS if args.quick else ROUNDS),
    }
    for name in names:
        for part, measure in measures.items():
            if part in parts:
                row = measure(name)
                kept = [r for r in results[part] if r["scene"] != name]
                results[part] = sorted([*kept, row], key=lambda r: (r["scene"] == "munich", r["scene"]))
                keep()
    text = markdown(results)
    print(text)
    if args.page:
        harness.write_page(harness.PAGES / "effects.md", f"{HEAD}{text}")


if __name__ == "__main__":
    main()
