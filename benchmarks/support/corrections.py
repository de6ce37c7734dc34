"""What the corrections of the tracing cost: a key pulse with each left out.

Run by ``python -m benchmarks.studies.effects --only corrections``. A correction is no effect that a plan may leave
out: without it some scenes are wrong.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from sarmitsuba.core.timing import StageTimer
from sarmitsuba.machine.backend import mi
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.block import BlockPlan, plan_block
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import AntennaStates, Tracer
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.source import launches
from sarmitsuba.tracing.kernel.surfaces import Surfaces
from sarmitsuba.tracing.kernel.tubes.polygon import Bounds

BLOCK = 64  # pulses


def block_of(sampling: SamplingPlan) -> BlockPlan:
    """The middle pulses."""
    radar = sampling.scene.radar
    start = max(0, radar.track.n_pulses // 2 - BLOCK // 2)
    stop = min(start + BLOCK, radar.track.n_pulses)
    extra, box = sampling.extra_slant_range, sampling.phase_box
    return plan_block(radar, start, stop, sampling.window.center, box, extra_slant_range=extra)


def one_batch(job: Tracer, block: BlockPlan, grid: LaunchGrid) -> float:
    """Trace one key pulse; processor seconds of the kernel, adding included, synthesis not."""
    radar = job.sampling.scene.radar
    accumulator = BlockAccumulator(block, 1, len(radar.channels), 0, radar.waveform.wavelength)
    job.timer = StageTimer(time.process_time)
    pick = slice(block.key, block.key + 1)
    (launch,) = launches([Surfaces()], [grid], 1)
    job.launch(
        launch, AntennaStates(block.state.position, block.state.velocity, pick), accumulator, block.n_pulses
    )
    return job.timer.seconds["trace"]


@contextmanager
def _cells_only() -> Iterator[None]:
    """Every ray has its own cell of the lattice, wherever the facet ends."""
    kept = Bounds.apart
    Bounds.apart = lambda self: mi.Bool(True)  # type: ignore[method-assign]
    try:
        yield
    finally:
        Bounds.apart = kept  # type: ignore[method-assign]


def _one_level(grid: LaunchGrid) -> LaunchGrid:
    n = grid.levels[1].first if len(grid.levels) > 1 else grid.n_rays
    return replace(grid, x=grid.x[:n], y=grid.y[:n], levels=())


def correction_table(scene: Scene, rounds: int) -> list[dict[str, Any]]:
    """Rays and processor seconds of a key pulse of a scene, with each correction left out."""
    run = Run(scene)
    assert run.sampling is not None and run.trace_scene is not None
    sampling, built = run.sampling, run.trace_scene
    grids = [g for g in run.lattices(sampling, 0)[0] if g.serves(scene.radar.track.center_index)]
    block = block_of(sampling)
    cases: list[tuple[str, Any, Sequence[LaunchGrid]]] = [
        ("everything", built, grids),
        ("rays of their own for small and bent parts", built, [_one_level(g) for g in grids]),
        ("tubes up to the facet's corners", built, grids),
        ("spreading and foci of bent mirrors", replace(built, curvature_table=None), grids),
        ("diffuse patches that run on over creases", replace(built, piece_table=None), grids),
        ("scattering about specular of rough surfaces", replace(built, forms=frozenset()), grids),
    ]
    rows: list[dict[str, Any]] = [
        {"correction": name, "rays": sum(g.n_rays for g in rays), "seconds": np.inf}
        for name, _, rays in cases
    ]
    for turn in range(rounds + 1):  # the first compiles
        for row, (name, table, rays) in zip(rows, cases, strict=True):
            job = Tracer(sampling, sampling.flags, table, run.plan.max_depth, StageTimer(time.process_time))
            if name.startswith("tubes"):
                with _cells_only():
                    seconds = sum(one_batch(job, block, g) for g in rays)
            else:
                seconds = sum(one_batch(job, block, g) for g in rays)
            if turn:
                row["seconds"] = min(row["seconds"], seconds)
    for row in rows:
        row["scene"] = scene.name
        row["cost"] = 1.0 - row["seconds"] / rows[0]["seconds"]
    return rows


def correction_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The table."""
    lines = [
        "",
        "## What corrections of the tracing cost",
        "",
        f"A key pulse of {rows[0]['scene']} with automatic rays. Left out, some scenes are wrong; the plan leaves out "
        "none. Processor seconds; what is not in the scene (bent mirrors, creases, lobes about specular) is not in the "
        "kernel either.",
        "",
        "| correction left out | rays | seconds | of the key pulse it takes |",
        "|---|---|---|---|",
    ]
    for i, r in enumerate(rows):
        cost = f"{round(100 * r['cost'])} %" if i else ""
        lines.append(f"| {r['correction'] if i else 'none'} | {r['rays']} | {r['seconds']:.2f} s | {cost} |")
    return lines


__all__ = ["block_of", "correction_lines", "correction_table", "one_batch"]
