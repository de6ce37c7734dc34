"""The effects there are: every module of ``sarmitsuba.effects.catalog`` holds one. A new file adds an effect."""

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

from sarmitsuba.effects import catalog
from sarmitsuba.effects.context import Context
from sarmitsuba.scene.scene import Scene


@dataclass(frozen=True)
class Assessment:
    """What the context say about an effect, before the user has a word.

    Parameters
    ----------
    on : whether it must be simulated
    why : the fact that decides
    error_db : error of the image if it were the other way, dB of the image's clutter or peak; -inf for none
    value : for effects that are a number (bounce depth)
    measured : the pilot decided, not a fact
    asked : the user decided, by a setting other than the effect's switch
    """

    on: bool
    why: str
    error_db: float
    value: int | None = None
    measured: bool = False
    asked: bool = False


@dataclass(frozen=True)
class Decision:
    """One line of the plan.

    Parameters
    ----------
    name : of the effect
    on : whether it is simulated
    why : the fact, the measurement or the explicit setting that decided
    value : for effects that are a number, else None
    error_db : predicted error of the image if it were the other way, dB; -inf where it makes no difference
    cost : share of the run's time that it takes (on) or would take (off), from `benchmarks/effects.py`
    source : ``fact``, ``pilot`` or ``user``
    """

    name: str
    on: bool
    why: str
    value: int | None = None
    error_db: float = float("nan")
    cost: float = 0.0
    source: str = "fact"


class Effect(ABC):
    """One effect: when it is needed, what it sets in the kernel, what later stages see without it.

    Attributes
    ----------
    name : in the plan, and in the scene file where it can be set there
    title : half a line for tables
    rank : place in the plan; an effect may look at the decisions of those before it
    cost : share of the time of a run with everything on that it takes, measured by `benchmarks/effects.py`
    """

    name: ClassVar[str]
    title: ClassVar[str]
    rank: ClassVar[int]
    cost: ClassVar[float] = 0.0

    @abstractmethod
    def assess(self, context: Context, decided: Mapping[str, Decision]) -> Assessment:
        """Whether the context call for it."""

    def flags(self, on: bool, context: Context, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        """Fields of ``KernelFlags`` that it sets."""
        return {}

    def without(self, scene: Scene) -> Scene:
        """The scene that tracing and focusing see when it is off."""
        return scene


@cache
def effects() -> tuple[Effect, ...]:
    """Every effect of the catalogue, in order."""
    found = []
    for module in pkgutil.iter_modules(catalog.__path__):
        loaded = importlib.import_module(f"{catalog.__name__}.{module.name}")
        found.append(loaded.EFFECT)
    found.sort(key=lambda effect: (effect.rank, effect.name))
    return tuple(found)


__all__ = ["Assessment", "Decision", "Effect", "effects"]
