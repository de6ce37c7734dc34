"""What an effect is: all the program knows of one is in the effect's own file in ``effects/catalog``."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, isnan
from types import MappingProxyType
from typing import ClassVar

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.registry import Registry
from sarmitsuba.scene.scene import Scene

_NO_FLAGS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Assessment:
    """What the context says about an effect, before the user has a word.

    Parameters
    ----------
    on : whether it must be simulated
    why : the fact that decides
    error_db : most that the image would change if it were the other way, energy over that of the image, dB; -inf for
        nothing, NaN where there is no bound
    value : for effects that are a number (bounce depth)
    measured : the pilot decided, not a fact
    asked : the user decided, by a setting other than the effect's switch
    note : what is left though the effect is on, one line; a warning
    """

    on: bool
    why: str
    error_db: float
    value: int | None = None
    measured: bool = False
    asked: bool = False
    note: str = ""


@dataclass(frozen=True)
class Decision:
    """One line of the plan.

    Parameters
    ----------
    name : of the effect
    on : whether it is simulated
    why : the fact, the measurement or the explicit setting that decided
    value : for effects that are a number, else None
    error_db : change of the image if it were the other way, energy over that of the image, dB; -inf where it makes no
        difference, NaN where nothing is known
    measured : ``error_db`` was measured, both ways at key pulses; else it is an upper bound
    cost : share of the simulation's processor time that it takes (on) or would take (off), measured both ways; NaN
        where it was not
    source : ``fact``, ``pilot`` or ``user``
    deepest : of bounces: the last one that returns anything, found both ways; None where that is not known
    """

    name: str
    on: bool
    why: str
    value: int | None = None
    error_db: float = float("nan")
    measured: bool = False
    cost: float = float("nan")
    source: str = "fact"
    deepest: int | None = None

    @property
    def error_is(self) -> str:
        """What ``error_db`` is: ``measured``, ``at most``, ``none`` or ``unknown``."""
        if self.measured:
            return "measured"
        return "unknown" if isnan(self.error_db) else "at most" if isfinite(self.error_db) else "none"


class Effect(ABC):
    """One effect: when it is needed, what it sets in the kernel, what later stages see without it.

    Attributes
    ----------
    name : in the plan, and of the switch in the scene file
    title : half a line for tables
    documentation : of the switch in the scene file, half a sentence; empty: it has no switch
    off_when, off_means : for the table of `docs/effects_reference.md`: what makes it unnecessary, what the image is
        without it
    rank : position in the plan; an effect may look at the decisions of those before it
    at_key_pulses : the echoes of single pulses show what it changes in the image; not so what changes the focusing, the
        channels or the receiver
    kernel_flags : the flags of the trace kernel that it sets, each with what the kernel does with it. Those that are
        fields of `KernelFlags` set the field, others go into `KernelFlags.extra` when they are true
    """

    name: ClassVar[str]
    title: ClassVar[str]
    documentation: ClassVar[str] = ""
    off_when: ClassVar[str] = ""
    off_means: ClassVar[str] = ""
    rank: ClassVar[int]
    at_key_pulses: ClassVar[bool] = True
    kernel_flags: ClassVar[Mapping[str, str]] = _NO_FLAGS

    @abstractmethod
    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """Whether the context calls for it."""

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Values of its ``kernel_flags``."""
        return {}

    def within(self, scene: Scene) -> Scene:
        """The scene that tracing and focusing see when it is on."""
        return scene

    def without(self, scene: Scene) -> Scene:
        """The scene that tracing and focusing see when it is off."""
        return scene


EFFECTS: Registry[Effect] = Registry("effect", "sarmitsuba.effects.catalog")


def effects() -> tuple[Effect, ...]:
    """Every effect in the order of the plan."""
    return tuple(sorted(EFFECTS, key=lambda effect: (effect.rank, effect.name)))


def switchable_effects() -> tuple[Effect, ...]:
    """Those with a switch in the scene file, in the order of the plan."""
    return tuple(effect for effect in effects() if effect.documentation)


__all__ = ["EFFECTS", "Assessment", "Decision", "Effect", "effects", "switchable_effects"]
