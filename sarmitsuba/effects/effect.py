"""Interface of effects; each is one file of ``effects/catalog``, or ``kind.py`` of a kind of scatterers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, isnan
from types import MappingProxyType
from typing import ClassVar

from sarmitsuba.core.registry import Registry
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.scene.scene import Scene

_NO_FLAGS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Assessment:
    """Automatic decision on an effect, from the context, before explicit settings.

    Parameters
    ----------
    on : whether it must be simulated
    why : the deciding fact
    error_db : upper bound of the change of the image with the opposite decision, energy relative to the image, dB;
        -inf for no change, NaN where there is no bound
    value : for effects that are a number (max_depth)
    measured : the pilot decided, not a fact
    asked : the user decided, by a setting other than the effect's switch
    note : warning about the error that remains with the effect on, one line
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
    why : the deciding fact, measurement or explicit setting
    value : for effects that are a number, else None
    error_db : change of the image with the opposite decision, energy relative to the image, dB; -inf for no change, NaN
        where it is not known
    measured : whether ``error_db`` was measured with and without the effect; else it is an upper bound
    cost : share of the simulation's processor time that it takes (on) or would take (off), measured; NaN if not
        measured
    source : ``fact``, ``pilot`` or ``user``
    deepest : of max_depth: the last bounce with an echo, from measurement; None where it is not known
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
        """Kind of ``error_db``: ``measured``, ``at most``, ``none`` or ``unknown``."""
        if self.measured:
            return "measured"
        return "unknown" if isnan(self.error_db) else "at most" if isfinite(self.error_db) else "none"


class Effect(ABC):
    """Physical effect: condition for simulating it, its kernel flags, and the scene with and without it.

    Attributes
    ----------
    name : in the plan, and of the switch in the scene file
    title : half a line for tables
    documentation : of the switch in the scene file, half a sentence; empty: it has no switch
    off_when, off_means : for the table of `docs/effects.md`: condition for off, and the simulation without it
    rank : position in the plan; an effect may use the decisions of those before it
    frequencies : at which the band is traced at least where it is on, 1 for an effect without frequency dependence
    at_key_pulses : whether its influence on the image follows from the echoes of single pulses; false for effects on
        focusing, channels or the receiver
    of_receiver : whether it changes what the receiver makes of echoes, and not the echoes
    hidden : its echoes that faces may hide from the antenna even where rays have one bounce; empty: none
    kernel_flags : flags of the trace kernel that it sets, each with a description. Fields of `KernelFlags` are set,
        others go into `KernelFlags.extra` when they are true
    """

    name: ClassVar[str]
    title: ClassVar[str]
    documentation: ClassVar[str] = ""
    off_when: ClassVar[str] = ""
    off_means: ClassVar[str] = ""
    rank: ClassVar[int]
    frequencies: ClassVar[int] = 1
    at_key_pulses: ClassVar[bool] = True
    of_receiver: ClassVar[bool] = False
    hidden: ClassVar[str] = ""
    kernel_flags: ClassVar[Mapping[str, str]] = _NO_FLAGS

    @abstractmethod
    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """Automatic decision in a context."""

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Values of its ``kernel_flags``."""
        return {}

    def within(self, scene: Scene) -> Scene:
        """Scene for tracing and focusing with the effect on."""
        return scene

    def without(self, scene: Scene) -> Scene:
        """Scene for tracing and focusing with the effect off."""
        return scene


EFFECTS: Registry[Effect] = Registry(
    "effect", Effect, "sarmitsuba.effects.catalog", "sarmitsuba.tracing.scatterers.*.kind"
)


def effects() -> tuple[Effect, ...]:
    """All effects in the order of the plan."""
    return tuple(sorted(EFFECTS, key=lambda effect: (effect.rank, effect.name)))


def switchable_effects() -> tuple[Effect, ...]:
    """Effects with a switch in the scene file, in the order of the plan."""
    return tuple(effect for effect in effects() if effect.documentation)


def idealise_receiver(scene: Scene, *, switched_off: bool = False) -> Scene:
    """Scene without the effects of its receiver; with ``switched_off`` without those alone that it switches off."""
    for effect in EFFECTS:
        if effect.of_receiver and (not switched_off or scene.settings.effects.get(effect.name) == "off"):
            scene = effect.without(scene)
    return scene
