"""Show which effects a scene will be simulated with and why, and how long the run will take, before running it."""

import argparse
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sarmitsuba.commands.console import Console

if TYPE_CHECKING:
    from sarmitsuba.effects.plan import EffectsPlan
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.simulation.prediction import Prediction

NAME = "explain"
HELP = "show the effects plan of a scene, with predicted time and memory"

_WITHOUT_RAW = ("image", "raster")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (XML), or the name of a shipped scene")
    parser.add_argument(
        "--radar",
        metavar="RADAR",
        help="radar to use in place of the scene's own: an XML file or a shipped radar's name",
    )
    parser.add_argument(
        "-D",
        "--define",
        action="append",
        default=[],
        type=definition,
        metavar="NAME=VALUE",
        help="set a $NAME of the scene file, or a parameter such as sar_path.max_depth; may be repeated",
    )
    parser.add_argument(
        "--method",
        choices=("raw", "hybrid", "image", "raster"),
        help="how to simulate (default: the scene's)",
    )
    parser.add_argument(
        "--no-error-bars", action="store_true", help="as for render: one set of rays instead of two"
    )
    parser.add_argument(
        "--plan-only", action="store_true", help="show the plan without predicting time and memory"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace, console: Console) -> int:
    """Explain."""
    from sarmitsuba.backend import ensure_backend
    from sarmitsuba.loader.library import resolve_radar
    from sarmitsuba.loader.load import load_scene

    ensure_backend()
    radar: Path | None = resolve_radar(args.radar) if args.radar else None
    scene = load_scene(args.scene, radar=radar, parameters=dict(args.define))
    changes: dict[str, Any] = {"method": args.method} if args.method else {}
    if not args.no_error_bars:
        changes["keep_subsets"] = True
    scene = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, **changes))
    plan, prediction = explain(scene, predicted=not args.plan_only)
    if args.json:
        console.say(json.dumps(_facts(scene, plan, prediction), indent=2))
    else:
        console.say(_table(scene, plan, prediction))
    return 0


def explain(scene: "Scene", *, predicted: bool = True) -> "tuple[EffectsPlan, Prediction | None]":
    """Return the plan of a scene and the prediction of its run (None for methods without raw data)."""
    from sarmitsuba.simulation.pilot import plan_scene
    from sarmitsuba.simulation.prediction import predict

    if predicted and scene.settings.method not in _WITHOUT_RAW:
        return predict(scene)
    return plan_scene(scene), None


def _facts(scene: "Scene", plan: "EffectsPlan", prediction: "Prediction | None") -> dict[str, Any]:
    facts: dict[str, Any] = {
        "scene": scene.name,
        "method": scene.settings.method,
        "plan": dict(plan.as_dict()),
    }
    if prediction is not None:
        facts["prediction"] = {
            "seconds": {stage: round(s, 4) for stage, s in prediction.seconds.items()},
            "total_seconds": round(prediction.total, 4),
            "memory_bytes": prediction.memory,
            "rays": prediction.rays,
            "key_pulses": prediction.key_pulses,
            "contributions": prediction.contributions,
            "pixels": prediction.pixels,
            "facts": {k: float(v) for k, v in prediction.facts.items()},
        }
    return facts


def _table(scene: "Scene", plan: "EffectsPlan", prediction: "Prediction | None") -> str:
    rows = [("effect", "", "if not", "cost", "why")]
    for d in plan.decisions:
        state = str(d.value) if d.value is not None else "on" if d.on else "off"
        rows.append((d.name, state, _error(d.error_db), _cost(d.cost), d.why))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    lines = [
        "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[4]]) for row in rows
    ]
    lines.insert(1, "-" * max(len(line) for line in lines[:1]))
    lines.insert(0, f"{scene.name}: {scene.settings.method}, channels {', '.join(plan.flags.channels)}")
    lines.append(
        "if not: error of the image, relative to its clutter or peak, if the effect were switched the other way; "
        "cost: the effect's share of the time of a run with everything on"
    )
    if plan.pilot:
        p = plan.pilot
        lines.append(
            f"pilot: {p['rays']} rays at pulses {', '.join(str(i) for i in p['pulses'])}, {1e3 * p['seconds']:.0f} ms"
        )
    if prediction is not None:
        stages = ", ".join(f"{stage} {_seconds(s)}" for stage, s in prediction.seconds.items())
        lines.append(
            f"predicted: {_seconds(prediction.total)} ({stages}), {prediction.memory / 2**20:.0f} MiB; "
            f"{prediction.rays / 1e6:.3g} million rays at {prediction.key_pulses} key pulses, "
            f"{prediction.pixels / 1e6:.3g} million pixels"
        )
    return "\n".join(lines)


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if value >= 1.0 else f"{1e3 * value:.0f} ms"


def _error(value_db: float) -> str:
    if np.isnan(value_db):
        return "?"
    return f"{value_db:.0f} dB" if value_db > -200.0 else "none"


def _cost(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "-"


def definition(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    return name, value


__all__ = ["HELP", "NAME", "add_arguments", "explain", "run"]
