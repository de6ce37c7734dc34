"""The interface of kinds of sources, their registry, and all that a scene has of them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from sarmitsuba.registry import Registry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.sources.site import Site
from sarmitsuba.trace.passage import Passage
from sarmitsuba.trace.source import Source
from sarmitsuba.trace.volume_scatterers import volume_passage

# the scatterer itself, and the ground on the way out and on the way home
MOST_BOUNCES = 3


@dataclass(frozen=True)
class Expected:
    """What a source takes, before it is made.

    Parameters
    ----------
    scatterers : about as many, all of them traced at every key pulse
    making, each : s of a usual core, to lay all out, and to trace one
    bytes : most while they are laid out
    """

    scatterers: float
    making: float
    each: float
    bytes: float


class SourceKind(ABC):
    """A kind of scatterers that no ray of a lattice finds; register an instance in ``SOURCES``.

    Attributes
    ----------
    name : one word
    rank : kinds are traced in this order
    """

    name: ClassVar[str]
    rank: ClassVar[int] = 100

    @abstractmethod
    def made(self, site: Site) -> Source | None:
        """The source of a scene; None where the scene has none, or the plan has switched it off."""

    @abstractmethod
    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """What the source takes, before it is made.

        Parameters
        ----------
        site : where
        sub_bands : number of frequencies that the band is traced at

        Notes
        -----
        Ignores what cropped images leave of sources beside them: bounds there.
        """


SOURCES: Registry[SourceKind] = Registry("kind of source", "sarmitsuba.simulation.sources.catalog")


def _in_turn() -> list[SourceKind]:
    return sorted(SOURCES, key=lambda kind: kind.rank)


def sources_of(site: Site) -> tuple[Source, ...]:
    """Sources of a scene as the effects plan leaves it; none in most scenes."""
    made = (kind.made(site) for kind in _in_turn())
    return tuple(source for source in made if source is not None)


def expected_sources(site: Site, sub_bands: int = 1) -> tuple[Expected, ...]:
    """What each source of a scene takes, before any is made; see :meth:`SourceKind.expected`."""
    expected = (kind.expected(site, sub_bands) for kind in _in_turn())
    return tuple(each for each in expected if each is not None)


def most_bounces(scene: Scene) -> int:
    """Bounces of the longest path of a scatterer: both ways over the ground, where the scene has any and allows it."""
    return min(scene.settings.max_depth or MOST_BOUNCES, MOST_BOUNCES) if scene.geometry.n_faces else 1


def passages_of(scene: Scene) -> tuple[Passage, ...]:
    """Volumes of a scene as what takes a part of waves that pass; nothing in most scenes."""
    return (volume_passage(scene.volumes),) if scene.volumes else ()


__all__ = [
    "MOST_BOUNCES",
    "SOURCES",
    "Expected",
    "SourceKind",
    "expected_sources",
    "most_bounces",
    "passages_of",
    "sources_of",
]
