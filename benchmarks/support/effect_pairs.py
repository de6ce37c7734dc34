"""What the effects cost that only some scenes have: such a scene as planned, and with the effect switched off.

Run by ``python -m benchmarks.studies.effects --only pairs``. Rounds alternate, the least of each counts: processor
seconds of simulating, without planning and focusing.
"""

import time
import warnings
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.library import list_scenes, resolve, resolve_radar
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.planning.pilot import plan_scene

# scenes that show an effect under another radar, in a later pass, or alone: without slabs nothing is seen through them
OTHERWISE: dict[str, tuple[str, str | None, dict[str, str]]] = {
    "slabs": ("glass_house", None, {"sar_path.transmission": "off"}),
    "motion_in_pulse": ("urban_block", "spaceborne_x", {"image_extent_limit": "60"}),
    "temporal_decorrelation": ("fields", None, {"sar_path.pass_days": "12"}),
}
# rounds of a pair, and processor seconds after which there are no more of them
ROUNDS, SPENT = 8, 12.0


def pair_table(apart: Collection[str], only: Collection[str] = ()) -> list[dict[str, Any]]:
    """One row for each effect that some shipped scene has on, but for those measured ``apart``.

    ``only``: of these scenes; none given: of all.
    """
    rows: dict[str, dict[str, Any]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)  # of what is switched off
        for scene, wanted in _scenes(only):
            plan = plan_scene(scene)
            for decision in plan.decisions:
                name = decision.name
                fits = name == wanted or (wanted is None and name not in OTHERWISE)
                if decision.on and decision.value is None and fits and name not in {*apart, *rows}:
                    rows[name] = _row(name, scene)
    return list(rows.values())


def _scenes(only: Collection[str]) -> Iterator[tuple[Scene, str | None]]:
    """Scenes, and the effect that each is for; None for any."""
    for effect, (name, radar, parameters) in OTHERWISE.items():
        if only and name not in only:
            continue
        beside = None if radar is None else resolve_radar(radar)
        yield load_scene(resolve(name), radar=beside, parameters=parameters), effect
    for entry in list_scenes():
        if only and entry.name not in only:
            continue
        yield load_scene(entry.path), None


def _row(effect: str, scene: Scene) -> dict[str, Any]:
    """Seconds of a scene with and without an effect."""
    switches = {**scene.settings.effects, effect: "off"}
    without = replace(scene, settings=replace(scene.settings, effects=switches))
    seconds: dict[str, list[float]] = {"on": [], "off": []}
    plans = {"on": plan_scene(scene), "off": plan_scene(without)}
    spent = 0.0
    for number in range(ROUNDS + 1):
        for key, one in (("on", scene), ("off", without)):
            before = time.process_time()
            simulate(one, plan=plans[key])
            taken = time.process_time() - before
            if number:  # the first round compiles
                seconds[key].append(taken)
                spent += taken
        if number > 2 and spent > SPENT:
            break
    on, off = min(seconds["on"]), min(seconds["off"])
    return {"effect": effect, "scene": scene.name, "on": on, "off": off, "cost": 1.0 - off / on}


def pair_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The table."""
    lines = [
        "",
        "## Effects of certain scenes",
        "",
        "As planned, and with the effect switched off, in turn; processor seconds of simulating. "
        "Slabs without transmission.",
        "",
        "| effect | scene | on | off | of the run it takes |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {r['effect']} | {r['scene']} | {r['on']:.2f} s | {r['off']:.2f} s | {100 * r['cost']:.0f} % |"
        for r in rows
    ]
    return lines


__all__ = ["pair_lines", "pair_table"]
