"""Explanation of a run before it starts: effects with their reasons, time and memory."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.plan import Decision, EffectsPlan
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.memory import format_bytes
from sarmitsuba.scene.ground import continue_ground
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.prediction.both_ways import NOTHING
from sarmitsuba.simulation.planning.prediction.needs import duration
from sarmitsuba.simulation.planning.prediction.prediction import Prediction, predict

# weaker changes of the image are rounding, dB
NOTHING_DB = db_from_power(NOTHING)
# shares of the processor time below this are within the scatter of timing
LEAST_TOLD = 0.1


@dataclass(frozen=True, eq=False)
class Explanation:
    """Plan and prediction of a run; ``str`` of it is a readable table.

    Parameters
    ----------
    scene : as loaded
    plan : decided effects
    prediction : time and memory; None if not requested
    """

    scene: Scene
    plan: EffectsPlan
    prediction: Prediction | None

    def __repr__(self) -> str:
        return f"Explanation({self.scene.name!r}: {self.plan.summary()})"

    def as_dict(self) -> Mapping[str, object]:
        """JSON-able form."""
        out: dict[str, object] = {
            "scene": self.scene.name,
            "method": self.scene.settings.method,
            "notes": list(self.scene.notes),
            "plan": dict(self.plan.as_dict()),
        }
        p = self.prediction
        if p is None:
            return out
        out["prediction"] = {
            "seconds": {stage: round(s, 4) for stage, s in p.seconds.items()},
            "measured": p.measured,
            "fits": not p.refusal,
            "refusal": p.refusal,
            "total_seconds": round(p.total, 4),
            "memory_bytes": p.memory,
            "rays": p.rays,
            "key_pulses": p.key_pulses,
            "contributions": p.contributions,
            "pixels": p.pixels,
            "facts": {
                "key_pulse_interval": float(p.key_pulse_interval),
                "rays_per_second": p.rays_per_second,
                "pixel_pulses_per_second": p.pixel_pulses_per_second,
                "raw_bytes": float(p.raw_bytes),
            },
        }
        return out

    def __str__(self) -> str:
        """One line per effect, then the pilot, the scene's notes and the prediction."""
        plan = self.plan
        rows = [("effect", "", "change", "cost", "why")]
        for d in plan.decisions:
            state = str(d.value) if d.value is not None else "on" if d.on else "off"
            last = "" if d.deepest is None else f"; bounce {d.deepest} is the last with an echo"
            rows.append((d.name, state, _error(d), _cost(d.cost), d.why + last))
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines = [
            "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[4]])
            for row in rows
        ]
        lines.insert(1, "-" * len(lines[0]))
        lines.insert(
            0, f"{self.scene.name}: {self.scene.settings.method}, channels {', '.join(plan.flags.channels)}"
        )
        lines.append(
            "change: energy of the change of the image, relative to the image, if the effect were switched on or off "
            "(max_depth: without the last bounce with an echo); law: foretold and not measured here, ? unknown"
        )
        if not all(np.isnan(d.cost) for d in plan.decisions):
            lines.append(
                "cost: share of the simulation's processor time that the effect takes, or would take; timed on the "
                "same pulses, accurate to about 10 %"
            )
        idle = [
            f"{d.name} ({_cost(d.cost)})"
            for d in plan.decisions
            if d.on and d.measured and d.error_db <= NOTHING_DB
        ]
        if idle:
            lines.append(
                f"on, without a change of this image (and their cost): {', '.join(idle)}; the plan is decided before "
                "tracing, and a proof would cost more than the effect"
            )
        if plan.pilot:
            p = plan.pilot
            lines.append(
                f"pilot: {p['rays']} rays at pulses {', '.join(str(i) for i in p['pulses'])}, "
                f"{1e3 * p['seconds']:.0f} ms"
            )
        lines += [f"note: {' '.join(note.split())}" for note in self.scene.notes]
        if self.prediction is not None:
            lines.append(_prediction_text(self.prediction))
        return "\n".join(lines)


@exclusive
def explain(scene: SceneLike, *, predicted: bool = True) -> Explanation:
    """Explanation of a scene's effects plan, with the predicted time and memory of simulation and focusing.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene
    predicted : whether to make the prediction, which traces a part of the run
    """
    scene = continue_ground(Scene.of(scene))
    if predicted:
        return Explanation(scene, *predict(scene, both_ways=True))
    return Explanation(scene, plan_scene(scene), None)


def _prediction_text(prediction: Prediction) -> str:
    stages = ", ".join(f"{stage} {duration(s)}" for stage, s in prediction.seconds.items())
    rates = "measured here on a part of it" if prediction.measured else "law"
    text = (
        f"predicted: {duration(prediction.total)} ({stages}; {rates}), {format_bytes(prediction.memory)} of memory; "
        f"{prediction.rays / 1e6:.3g} million rays at {prediction.key_pulses} key pulses, "
        f"{prediction.pixels / 1e6:.3g} million pixels"
    )
    return f"{text}\nrefused: {prediction.refusal}" if prediction.refusal else text


def _error(decision: Decision) -> str:
    if np.isnan(decision.error_db):
        return "?"
    if decision.error_db <= (NOTHING_DB if decision.measured else -200.0):
        return "none"
    kind = "measured here" if decision.measured or decision.source == "pilot" else "law"
    return f"{round(decision.error_db)} dB, {kind}"  # never -0


def _cost(share: float) -> str:
    if np.isnan(share):
        return "-"
    return f"{100 * share:.0f} %" if share >= LEAST_TOLD else f"< {100 * LEAST_TOLD:.0f} %"
