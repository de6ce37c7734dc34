"""Sources of echoes at known positions: the site of a run, the kinds of sources, and their registry.

A kind of scatterers lies in one folder ``tracing/scatterers/<kind>/``. Its modules enter by registries, which find them
by their names, as a user's extension enters by its import:

``kind.py``
    Without Mitsuba. Its objects in a scene (a class of :class:`sarmitsuba.scene.scatterers.Target`); its bsdf, how
    shapes with it are read, shown, counted and labelled (a :class:`sarmitsuba.loading.scatterer_shapes.ShapeKind`, in
    ``SCATTERERS``); and when it is simulated (an :class:`sarmitsuba.effects.effect.Effect`, in ``EFFECTS``).
``source.py``
    Its tracing and cost: a :class:`SourceKind` in ``SOURCES``. ``make_source`` turns the targets of a scene
    into a :class:`sarmitsuba.tracing.kernel.source.Source`, mostly a ``PointSource`` of ``Scatterers``, whose
    ``mechanism`` and ``owner`` label its echoes, and whose derivatives by the legs are those of all sources.

A scene carries targets of all kinds in ``Scene.scatterers`` from the reader to the source; nobody between them asks
for a kind. Without the folder its bsdf is unknown, and all else is as before.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, TypeVar, cast

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.registry import Registry
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.kernel.passage import Passage
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.source import Source

# antenna positions from which folds are examined
MOST_LOOKS = 1000
# the scatterer itself, and the ground on the incident and on the scattered leg
MOST_BOUNCES = 3
Made = TypeVar("Made")


class Site(ABC):
    """Scene with the quantities from which sources are made.

    Parameters
    ----------
    scene : with the effects plan applied
    flags : of the trace kernel
    trace_scene : geometry on the device; None: sources that need it are left out
    measured : measurements of kinds of sources, by name
    """

    def __init__(
        self,
        scene: Scene,
        flags: KernelFlags,
        trace_scene: TraceScene | None = None,
        measured: Mapping[str, object] | None = None,
    ) -> None:
        self.scene, self.flags, self.measured = scene, flags, measured or {}
        self._trace_scene = trace_scene

    @property
    def trace_scene(self) -> TraceScene | None:
        """Geometry on the device."""
        return self._trace_scene

    @property
    def wavelength(self) -> float:
        """Wavelength of the carrier, m."""
        return self.scene.radar.waveform.wavelength

    @property
    @abstractmethod
    def cells(self) -> tuple[float, float]:
        """Resolutions in range and in azimuth, m; infinite where an object is unresolved."""

    @property
    @abstractmethod
    def distance(self) -> float:
        """Smallest distance to an antenna, m."""

    @property
    @abstractmethod
    def cell_area(self) -> float:
        """Area of the resolution cell perpendicular to the elevation direction, m^2."""

    @property
    @abstractmethod
    def half_cell(self) -> float:
        """Half a resolution cell, m, the most that one scatterer may represent; infinite where it is unresolved."""

    @property
    @abstractmethod
    def spacing(self) -> float:
        """Spacing of the coherent rays of surfaces, m; 0 where it does not matter."""

    @cached_property
    def kept(self) -> dict[tuple[str, KernelFlags], object]:
        """Results of :meth:`once`."""
        return {}

    def once(self, name: str, make: Callable[[], Made]) -> Made:
        """Result of ``make``, the same object in all tracings and forecasts with this scene, sampling and flags."""
        key = name, self.flags
        if key not in self.kept:
            self.kept[key] = make()
        return cast(Made, self.kept[key])

    def towards(self, point: F64) -> F64:
        """Unit vectors (n, 3) from a point to the antenna along the track, at most ``MOST_LOOKS``."""
        position = self.scene.radar.track.position
        step = -(-len(position) // MOST_LOOKS)
        away = np.concatenate([position[::step], position[-1:]]) - point
        return unit_rows(away)

    @property
    @abstractmethod
    def box(self) -> F64:
        """Bounds of the lit part of the scene, (2, 3) m."""

    @property
    @abstractmethod
    def center(self) -> F64:
        """Centre of the lit part of the scene, (3,) m."""

    @property
    @abstractmethod
    def views(self) -> F64:
        """Antenna positions (n, 3) m, in turn, the middle one in the middle."""

    @property
    @abstractmethod
    def scatterer_cell(self) -> float:
        """Edge of the cells that carry one diffuse scatterer, m."""

    @property
    @abstractmethod
    def resolution(self) -> float:
        """Edge of a resolution cell on the ground, m."""

    @property
    @abstractmethod
    def block(self) -> int:
        """Most pulses that share one tracing; 1 where every pulse or aspect is traced."""

    @abstractmethod
    def shares(self, points: F64) -> F64:
        """Amplitude factor (n,) of scatterers at points (n, 3) m, tapered beyond a cropped image."""

    @abstractmethod
    def light(self, points: F64) -> F64:
        """Amplitude (n,) of the launch window at points (n, 3) m."""


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
    def make_source(self, site: Site) -> Source | None:
        """Source of a scene; None where the scene has none, or the plan has switched it off."""

    @abstractmethod
    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Expected cost of the source, before it is made; None without one.

        Parameters
        ----------
        site : scene and sampling
        sub_bands : number of frequencies that the band is traced at

        Notes
        -----
        Upper bounds in cropped images: sources outside the image are counted.
        """

    def measures(self, flags: KernelFlags) -> bool:
        """Whether :meth:`measure` finds something in a scene with these flags."""
        return False

    def measure(self, site: Site) -> object:
        """Measurement before the plan: the effect of the kind decides by it (``SceneContext.measured``)."""
        return None

    def note(self, site: Site) -> str:
        """Assumption about the kind in a scene, for the user; empty: none."""
        return ""

    def bounces(self, scene: Scene, flags: KernelFlags) -> int:
        """Bounces of the longest path of the kind, whatever the mirrors of the scene return."""
        return 1

    def passage(self, scene: Scene) -> Passage | None:
        """Attenuation of waves that go through the scatterers; None where there is none."""
        return None


SOURCES: Registry[SourceKind] = Registry(
    "kind of source", SourceKind, "sarmitsuba.tracing.scatterers.*.source"
)


def _order_kinds() -> list[SourceKind]:
    return sorted(SOURCES, key=lambda kind: kind.rank)


def sources_of(site: Site) -> tuple[Source, ...]:
    """Sources of a scene with the effects plan applied; none in most scenes."""
    made = (kind.make_source(site) for kind in _order_kinds())
    return tuple(source for source in made if source is not None)


def expected_sources(site: Site, sub_bands: int = 1) -> tuple[Expected, ...]:
    """Expected cost of each source of a scene; see :meth:`SourceKind.estimate_cost`."""
    expected = (kind.estimate_cost(site, sub_bands) for kind in _order_kinds())
    return tuple(each for each in expected if each is not None)


def measure_sources(site: Site) -> dict[str, object]:
    """Measurements of the kinds, by name; see :meth:`SourceKind.measure`."""
    return {kind.name: kind.measure(site) for kind in _order_kinds() if kind.measures(site.flags)}


def notes_of(site: Site) -> tuple[str, ...]:
    """Notes of the kinds; see :meth:`SourceKind.note`."""
    return tuple(note for kind in _order_kinds() if (note := kind.note(site)))


def bounces_of(scene: Scene, flags: KernelFlags) -> int:
    """Bounces of the longest path of any source of a scene."""
    over_ground = most_bounces(scene) if scene.has_sources else 1
    return max(over_ground, *(kind.bounces(scene, flags) for kind in SOURCES))


def most_bounces(scene: Scene) -> int:
    """Bounces of the longest path of a scatterer: both legs over the ground, where the scene has any and allows it."""
    return min(scene.settings.max_depth or MOST_BOUNCES, MOST_BOUNCES) if scene.geometry.n_faces else 1


def passages_of(scene: Scene) -> tuple[Passage, ...]:
    """Passages of a scene (volumes that attenuate waves); none in most scenes."""
    found = (kind.passage(scene) for kind in _order_kinds()) if scene.scatterers else ()
    return tuple(passage for passage in found if passage is not None)
