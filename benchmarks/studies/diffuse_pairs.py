"""What two diffuse scatterers in a row return in shipped scenes, and what they cost.

Run ``python -m benchmarks.studies.diffuse_pairs [SCENE ...] [--page]``; prints Markdown tables, ``--page`` makes a page
of the site. Times are processor seconds, the least of some rounds with compiled kernels.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.studies.effects import load
from benchmarks.support import harness
from benchmarks.support.corrections import block_of
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.core.units import db_from_power
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import AntennaStates
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator
from sarmitsuba.tracing.scatterers.pairs.diffuse_pairs import PairSource
from sarmitsuba.tracing.scatterers.pairs.pair_estimate import (
    PILOT_POINTS,
    estimate_pairs,
    pair_level,
    pilot_cell,
)
from sarmitsuba.tracing.scatterers.sources import SOURCES

SCENES = ("courtyard", "urban_block", "buildings16", "tower", "bridge")
ROUNDS = 5
# independent draws whose spread is compared with the stated error
DRAWS = 8


def seconds(job: Callable[[], Any]) -> float:
    """Processor seconds of a job."""
    start = time.process_time()
    job()
    return time.process_time() - start


def spread(run: Run) -> tuple[float, float]:
    """Standard deviation of the pairs' power over independent draws, and the stated one, both over the mean."""
    assert run.sampling is not None and run.trace_scene is not None
    powers, stated = [], []
    for seed in range(DRAWS):
        settings = replace(run.scene.settings, seed=seed)
        sampling = replace(run.sampling, scene=replace(run.scene, settings=settings))
        site = RunSite(sampling, None, run.trace_scene)
        power = estimate_pairs(site, pilot_cell(site, PILOT_POINTS)).power
        powers.append(power.sum())
        stated.append(np.sqrt(np.square(power).sum()))
    return float(np.std(powers, ddof=1) / np.mean(powers)), float(np.mean(stated) / np.mean(powers))


def measured(name: str) -> dict[str, Any]:
    """Level and processor seconds of a scene."""
    scene = load(name)
    run = Run(scene.replace(diffuse_pairs="on"))
    sampling, built = run.sampling, run.trace_scene
    assert sampling is not None and built is not None
    decision = plan_scene(scene).decision("diffuse_pairs")
    assert decision is not None
    site = RunSite(sampling, None, built)
    level = pair_level(site)
    tracer = run.tracer(sampling)
    grids = [g for g in run.lattices(sampling, 0)[0] if g.serves(scene.radar.track.center_index)]
    block = block_of(sampling)
    pick = slice(block.key, block.key + 1)

    def key_pulse(*, rays: bool) -> float:
        radar = scene.radar
        tracer.timer = StageTimer(time.process_time)
        accumulator = BlockAccumulator(block, 1, len(radar.channels), 0, radar.waveform.wavelength)
        states = AntennaStates(block.state.position[:1], block.state.velocity[:1], pick)
        for launch in tracer.launches(grids, 1):
            if bool(launch.part.rays) == rays:
                tracer.launch(launch, states, accumulator, block.n_pulses)
        return tracer.timer.seconds["trace"]

    jobs = {
        "pilot": lambda: seconds(lambda: pair_level(site)),
        "draw": lambda: seconds(lambda: SOURCES["pairs"].make_source(site)),
        "rays": lambda: key_pulse(rays=True),
        "pairs": lambda: key_pulse(rays=False),
    }
    times = {job: min([measure() for _ in range(ROUNDS)][1:]) for job, measure in jobs.items()}
    (source,) = (one for one in tracer.sources if isinstance(one, PairSource))
    found, stated = spread(run)
    return {
        "scene": name,
        "on": bool(decision.on),
        "share_db": float(db_from_power(level.share)),
        "share_error": float(level.error / level.share),
        "strongest_db": float(db_from_power(level.strongest)),
        "square": float(level.square),
        "draw_db": float(db_from_power(level.realisation_error)),
        "n": int(source.n),
        "found": found,
        "stated": stated,
        "times": times,
        "keys": -(-scene.radar.track.n_pulses // sampling.key_pulse_interval),
    }


HEAD = """# Pairs of diffuse scatterers

`python -m benchmarks.studies.diffuse_pairs --page` makes this page. Column `auto`: the decision of the plan. Last
column of the first table: the spread over draws with the pilot's cells, and its stated standard error, which is the
larger one because points are spread evenly. Last column of the second: share of the draw and of all key pulses, in
processor seconds.

"""


def markdown(rows: list[dict[str, Any]]) -> str:
    """Both tables."""
    out = [
        "| scene | pairs over clutter | strongest square | `auto` | pairs of a run | error of the draw | spread of "
        f"{DRAWS} draws of the pilot, stated |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        out.append(
            f"| {r['scene']} | {r['share_db']:.1f} dB ± {100 * r['share_error']:.0f} % | {r['strongest_db']:.0f} dB in "
            f"{r['square']:.0f} m | {'on' if r['on'] else 'off'} | {r['n']} | {r['draw_db']:.0f} dB | "
            f"{100 * r['found']:.1f} %, {100 * r['stated']:.1f} % |"
        )
    out += [
        "",
        "| scene | pilot's estimate | draw | key pulse, rays | key pulse, pairs | key pulses | of tracing with pairs |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        t = r["times"]
        pairs, rays = t["draw"] + r["keys"] * t["pairs"], r["keys"] * t["rays"]
        out.append(
            f"| {r['scene']} | {t['pilot']:.2f} s | {t['draw']:.2f} s | {t['rays']:.2f} s | {t['pairs']:.2f} s | "
            f"{r['keys']} | {100 * pairs / (pairs + rays):.0f} % |"
        )
    return "\n".join(out) + "\n"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES, metavar="SCENE")
    parser.add_argument("--page", action="store_true", help="make a page in docs/generated")
    args = parser.parse_args()
    ensure_backend()
    text = markdown([measured(name) for name in args.scenes])
    print(text)
    if args.page:
        harness.write_page(harness.PAGES / "diffuse_pairs.md", f"{HEAD}{text}")


if __name__ == "__main__":
    main()
