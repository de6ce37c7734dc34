"""Interface and registry of kinds of sources, and the sources of a scene."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from sarmitsuba.core.registry import Registry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.planning.sources.site import Site
from sarmitsuba.tracing.kernel.source import Source
from sarmitsuba.tracing.scatterers.slabs.passage import Passage
from sarmitsuba.tracing.scatterers.volumes.volume_scatterers import volume_passage

# the scatterer itself, and the ground on the incident and on the scattered leg
MOST_BOUNCES = 3


@dataclass(frozen=True)
class Expected:
    """Expected cost of a source, before it is made.

    Parameters
    ----------
    scatterers : estimated number, all of them traced at every key pulse
    making, each : s of a reference core, to make all of them, and to trace one
    bytes : peak while they are made
    """

    scatterers: float
    making: float
    each: float
    bytes: float


class SourceKind(ABC):
    """Kind of scatterers traced directly to the antenna; register an instance in ``SOURCES``.

    Attributes
    ----------
    name : one word
    rank : kinds are traced in this order
    """

    name: ClassVar[str]
    rank: ClassVar[int] = 100

    @abstractmethod
    def made(self, site: Site) -> Source | None:
        """Source of a scene; None where the scene has none, or the plan has switched it off."""

    @abstractmethod
    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Expected cost of the source, before it is made; None without one.

        Parameters
        ----------
        site : scene and sampling
        sub_bands : number of frequencies that the band is traced at

        Notes
        -----
        Upper bounds in cropped images: sources outside the image are counted.
        """


SOURCES: Registry[SourceKind] = Registry(
    "kind of source", SourceKind, "sarmitsuba.simulation.planning.sources.catalog"
)


def _in_turn() -> list[SourceKind]:
    return sorted(SOURCES, key=lambda kind: kind.rank)


def sources_of(site: Site) -> tuple[Source, ...]:
    """Sources of a scene with the effects plan applied; none in most scenes."""
    made = (kind.made(site) for kind in _in_turn())
    return tuple(source for source in made if source is not None)


def expected_sources(site: Site, sub_bands: int = 1) -> tuple[Expected, ...]:
    """Expected cost of each source of a scene; see :meth:`SourceKind.expected`."""
    expected = (kind.expected(site, sub_bands) for kind in _in_turn())
    return tuple(each for each in expected if each is not None)


def most_bounces(scene: Scene) -> int:
    """Bounces of the longest path of a scatterer: both legs over the ground, where the scene has any and allows it."""
    return min(scene.settings.max_depth or MOST_BOUNCES, MOST_BOUNCES) if scene.geometry.n_faces else 1


def passages_of(scene: Scene) -> tuple[Passage, ...]:
    """Passages of a scene (volumes that attenuate waves); none in most scenes."""
    return (volume_passage(scene.volumes),) if scene.volumes else ()
