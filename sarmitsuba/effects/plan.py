"""Effects plan: the effects that are simulated for a scene, with reasons."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TypedDict

import numpy as np

from sarmitsuba.core.errors import ExtensionError, SarmitsubaWarning, SceneError
from sarmitsuba.core.parameters import did_you_mean, fill_description
from sarmitsuba.core.registry import Calling, checked_type
from sarmitsuba.effects.catalog.max_depth import DEEPEST, DEFAULT_DEPTH
from sarmitsuba.effects.catalog.wideband import LEAST_SUB_BANDS
from sarmitsuba.effects.context import PilotResult, SamplingFacts, SceneContext
from sarmitsuba.effects.effect import Assessment, Decision, Effect, effects, switchable_effects
from sarmitsuba.effects.flags import FlagValue, KernelFlags
from sarmitsuba.effects.shape import ShapeAnalysis
from sarmitsuba.scene.scene import Scene


class PilotFigures(TypedDict, total=False):
    """Results of the pilot trace as plain figures; lists have one entry per order, dB rounded to 0.1.

    Attributes
    ----------
    pulses : traced pulse numbers
    rays : traced in all
    patches, features, features_left_out : patches at random, on small features, and features without one
    seconds : whole pilot
    energy_from_order_db, energy_from_order_upper_db : share of the image's energy from an order on, as patches see it,
        and its upper bound: coherent returns in phase over resolution cells, and two standard errors; None where there
        is none
    strongest_cell_from_order_db : strongest patch from an order on, relative to ``strongest_cell_over``
    strongest_cell_over : ``clutter`` or ``peak``
    tolerance_db : accepted error
    """

    pulses: list[int]
    rays: int
    patches: int
    features: int
    features_left_out: int
    seconds: float
    energy_from_order_db: list[float | None]
    energy_from_order_upper_db: list[float | None]
    strongest_cell_from_order_db: list[float | None]
    strongest_cell_over: str
    tolerance_db: float


@dataclass(frozen=True)
class EffectsPlan:
    """Effects plan of a scene: decisions, kernel flags and number of bounces.

    Parameters
    ----------
    flags : switches of the trace kernel
    max_depth : most bounces of a ray
    decisions : one per effect
    notes : one line each: explicit settings that cost accuracy, and limitations of the pilot
    pilot : results of the pilot trace; empty without one
    echo_bounces : most bounces of an echo: an echo back along its chain has 2 n - 1 of them where its ray has n;
        0: as many as a ray
    """

    flags: KernelFlags
    max_depth: int
    decisions: tuple[Decision, ...] = field(default_factory=tuple)
    notes: tuple[str, ...] = ()
    pilot: PilotFigures = field(default_factory=PilotFigures)
    echo_bounces: int = 0

    def decision(self, name: str) -> Decision | None:
        """Decision on an effect, None when there is none."""
        return next((d for d in self.decisions if d.name == name), None)

    def on(self, name: str) -> bool:
        """Whether the effect is simulated."""
        decision = self.decision(name)
        return decision is not None and decision.on

    @property
    def sub_bands(self) -> int:
        """Number of frequencies that the band is traced at; 1: the carrier alone."""
        decision = self.decision("wideband")
        return decision.value or LEAST_SUB_BANDS if decision is not None and decision.on else 1

    def with_decision(self, decision: Decision) -> "EffectsPlan":
        """Plan with one decision added, or replaced where there is one of the same name."""
        kept = tuple(d for d in self.decisions if d.name != decision.name)
        return replace(self, decisions=(*kept, decision))

    def with_measured(
        self, name: str, error_db: float, cost: float, *, measured: bool = True, deepest: int | None = None
    ) -> "EffectsPlan":
        """Plan with the measured influence (dB; upper bound unless measured) and cost (share) of an effect."""
        found = {"error_db": error_db, "cost": cost, "measured": measured, "deepest": deepest}
        decisions = tuple(
            replace(d, **found) if d.name == name else d  # type: ignore[arg-type]
            for d in self.decisions
        )
        return replace(self, decisions=decisions)

    def with_key_pulses(
        self, interval: int, error_db: float, asked: bool, boundaries: tuple[int, int] = (0, 0)
    ) -> "EffectsPlan":
        """Plan with the number of pulses that share one tracing.

        Parameters
        ----------
        interval : pulses per key pulse; 1 traces every pulse
        error_db : against tracing every pulse, dB, measured at block boundaries; NaN for a single block
        asked : set by the user
        boundaries : number of block boundaries measured, and of all boundaries
        """
        if np.isnan(error_db):
            measured = "one block holds all pulses, so that its error is not measured"
        else:
            where = (
                "where"
                if boundaries[0] == boundaries[1]
                else f"at {boundaries[0]} of {boundaries[1]} places where"
            )
            measured = f"error against tracing every pulse {error_db:.0f} dB, measured {where} blocks meet"
        if asked:
            why, source = "set by the user" + (f"; {measured}" if interval > 1 else ""), "user"
        elif interval > 1:
            why, source = measured, "pilot"
        else:
            why, source = "every pulse is traced: as set, or the error of blocks would be too large", "fact"
        return self.with_decision(
            Decision(
                "key_pulse_interval",
                interval > 1,
                why,
                interval,
                error_db if interval > 1 else -np.inf,
                measured=interval > 1 and not np.isnan(error_db),
                source=source,
            )
        )

    def apply(self, scene: Scene) -> Scene:
        """Scene for tracing and focusing, with the effects that are off removed (beam, cross channels, noise ...)."""
        on = {d.name: d.on for d in self.decisions}
        for effect in effects():
            if effect.name in on:
                with Calling("effect", effect, "within" if on[effect.name] else "without"):
                    found = effect.within(scene) if on[effect.name] else effect.without(scene)
                    scene = checked_type(found, Scene)
        return scene

    def summary(self) -> str:
        """One line: bounces, effects that are on, and those off that make a difference or were switched off."""
        on = [d.name for d in self.decisions if d.on and d.value is None]
        off = [
            d.name
            for d in self.decisions
            if not d.on and d.value is None and (d.source == "user" or d.error_db != -np.inf)
        ]
        values = [f"{d.name} {d.value}" for d in self.decisions if d.value is not None]
        head = ", ".join(values) or f"max_depth {self.max_depth}"
        return f"{head}; on: {', '.join(on) or 'none'}; off: {', '.join(off) or 'none'}"

    def as_dict(self) -> Mapping[str, object]:
        """JSON-able form; an error of -inf dB (no difference) is None."""
        return {
            "max_depth": self.max_depth,
            "channels": list(self.flags.channels),
            "effects": {
                d.name: {
                    "on": d.on,
                    "why": d.why,
                    "value": d.value,
                    "error_db": round(d.error_db, 1) if np.isfinite(d.error_db) else None,
                    "error_is": d.error_is,
                    "cost": None if np.isnan(d.cost) else round(d.cost, 3),
                    "source": d.source,
                    **({} if d.deepest is None else {"deepest": d.deepest}),
                }
                for d in self.decisions
            },
            "notes": list(self.notes),
            "pilot": dict(self.pilot),
        }


def plan_effects(
    scene: Scene,
    sampling: SamplingFacts | None = None,
    pilot: PilotResult | None = None,
    *,
    shape: ShapeAnalysis | None = None,
    measured: Mapping[str, object] | None = None,
    warn: bool = True,
    up_to: int | None = None,
    draft: bool = False,
) -> EffectsPlan:
    """Effects plan of a scene; explicit settings take precedence, with a warning where they cost accuracy.

    Parameters
    ----------
    scene : as loaded
    sampling : of the run; without it, effects that depend on it stay on
    pilot : result of a pilot trace; without it, static context and safe defaults decide
    shape : analysis of the scene's geometry, None to compute it
    measured : measurements of kinds of sources, by name
    warn : issue a ``SarmitsubaWarning`` for explicit settings that cost more than the tolerance
    up_to : last rank to decide, None for all; effects not decided stay on
    draft : see :class:`SceneContext`
    """
    context = SceneContext(scene, sampling, pilot, shape, measured or {}, draft)
    wanted = scene.settings.effects
    _check_switches(scene)
    decided: dict[str, Decision] = {}
    chosen: dict[str, FlagValue] = {
        "channels": scene.radar.channels,
        "double_phase": scene.settings.phase_precision == "double",
    }
    notes: list[str] = []
    for effect in effects():
        if up_to is not None and effect.rank > up_to:
            break
        with Calling("effect", effect, "assess"):
            assessment = checked_type(effect.assess(context, decided), Assessment)
        decision = _decide(effect.name, wanted.get(effect.name, "auto"), assessment)
        decided[effect.name] = decision
        with Calling("effect", effect, "flags"):
            chosen.update(_find_declared(effect, effect.flags(decision.on, context, decided)))
        if decision.on and assessment.note:
            notes.append(assessment.note)
        loses = decision.source == "user" and decision.on != assessment.on and not decision.on
        if loses and not assessment.error_db <= context.tolerance_db:
            known = (
                f"at most {assessment.error_db:.0f} dB"
                if np.isfinite(assessment.error_db)
                else "without bound"
            )
            notes.append(
                f"{scene.name}: {effect.name} is switched off; predicted error {known} ({assessment.why})"
            )
    depth = decided["max_depth"].value or DEFAULT_DEPTH
    note = _depth_note(context, depth)
    if note:
        notes.append(note)
    if warn:
        for note in notes:
            warnings.warn(note, SarmitsubaWarning, stacklevel=2)
    return EffectsPlan(
        _kernel_flags(chosen),
        depth,
        tuple(decided.values()),
        tuple(notes),
        {} if pilot is None else _figures(context, pilot),
        _echo_bounces(context, chosen, depth),
    )


def remove_switch(scene: Scene, name: str) -> Scene:
    """Scene whose file leaves the switch of an effect automatic."""
    kept = {effect: switch for effect, switch in scene.settings.effects.items() if effect != name}
    return replace(scene, settings=replace(scene.settings, effects=kept))


def _echo_bounces(context: SceneContext, chosen: Mapping[str, FlagValue], depth: int) -> int:
    """Most bounces of an echo of rays with ``depth`` bounces, those back along their chain included."""
    if not chosen.get("diffuse_double") or depth < 2:
        return depth
    turns = depth if context.pilot is None else min(depth, context.pilot.last_turn(context.tolerance_db))
    return max(depth, 2 * turns - 1)


def _check_switches(scene: Scene) -> None:
    """Raise an error for a switch of an unknown effect."""
    known = [effect.name for effect in switchable_effects()]
    for name in scene.settings.effects:
        if name not in known:
            raise SceneError(
                f"{scene.name}: there is no effect {name!r} to switch{did_you_mean(name, known)}; choose of "
                f"{', '.join(known)}"
            )


def _find_declared(effect: Effect, values: Mapping[str, FlagValue]) -> Mapping[str, FlagValue]:
    """Kernel flags of an effect, if it has declared them all."""
    for name in values:
        if name not in effect.kernel_flags:
            raise ExtensionError(
                f"effect {effect.name!r} sets the kernel flag {name!r}; declare it in kernel_flags"
            )
    return values


def _kernel_flags(chosen: Mapping[str, FlagValue]) -> KernelFlags:
    """Kernel flags: known ones as fields, the others by name where they are on."""
    known = {f.name for f in fields(KernelFlags)}
    extra = frozenset(name for name, value in chosen.items() if name not in known and value)
    fitting = {name: value for name, value in chosen.items() if name in known}
    return fill_description(KernelFlags(extra=extra), fitting)


def _decide(name: str, switch: str, assessment: Assessment) -> Decision:
    if switch == "auto":
        source = "user" if assessment.asked else "pilot" if assessment.measured else "fact"
        return Decision(
            name, assessment.on, assessment.why, assessment.value, assessment.error_db, source=source
        )
    on = switch == "on"
    # setting equal to the automatic decision: its error bound holds; setting against it: no better bound is known
    return Decision(
        name,
        on,
        f"set {switch} by the user; {assessment.why}",
        assessment.value if on else None,
        assessment.error_db,
        source="user",
    )


def _depth_note(context: SceneContext, depth: int) -> str:
    """Warning about the bounces left out, where they are above the tolerance, with the number needed."""
    asked, pilot = context.scene.settings.max_depth, context.pilot
    if pilot is None or depth > pilot.n_orders:
        return ""
    tolerance, enough = context.tolerance_db, pilot.enough(context.tolerance_db)
    if enough:
        if depth >= enough or not asked:
            return ""
        remedy = f"set max_depth = {enough} or auto"
    else:
        likely = pilot.would_be_enough(tolerance)
        remedy = f"about max_depth = {likely} is needed" if likely <= DEEPEST else "they hardly decay"
    order = min(depth + 1, pilot.n_orders)
    over = "clutter" if pilot.clutter > 0 else "peak"
    left, cell = pilot.left_out_db(order - 1), pilot.cell_db(3, order)
    return (
        f"{context.scene.name}: max_depth = {depth} leaves out returns: those of bounce {order} and later hold "
        f"about {left:.0f} dB of the image's energy by a pilot's patches, strongest cell {cell:.0f} dB over the "
        f"{over}; {remedy}"
    )


def _figures(context: SceneContext, pilot: PilotResult) -> PilotFigures:
    def clean(value: float) -> float | None:
        return round(float(value), 1) if np.isfinite(value) else None

    orders = range(1, pilot.n_orders + 1)
    return {
        "pulses": list(pilot.pulses),
        "rays": pilot.rays,
        "patches": pilot.n_patches,
        "features": pilot.n_features,
        "features_left_out": pilot.n_skipped,
        "seconds": round(pilot.seconds, 4),
        "energy_from_order_db": [clean(pilot.energy_db(3, n)) for n in orders],
        "energy_from_order_upper_db": [clean(pilot.left_out_db(n - 1)) for n in orders],
        "strongest_cell_from_order_db": [clean(pilot.cell_db(3, n)) for n in orders],
        "strongest_cell_over": "clutter" if pilot.clutter > 0 else "peak",
        "tolerance_db": context.tolerance_db,
    }


__all__ = ["DEFAULT_DEPTH", "Decision", "EffectsPlan", "PilotFigures", "plan_effects"]
