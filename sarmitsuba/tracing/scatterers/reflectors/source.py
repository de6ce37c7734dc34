"""Scatterers of a user's own kinds, straight and over the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.errors import ExtensionError
from sarmitsuba.core.units import power_from_db
from sarmitsuba.scene.scatterers import SCATTERERS, ScattererTarget, targets_by_kind
from sarmitsuba.tracing.kernel.source import Part, PointSource, Scatterers, Source
from sarmitsuba.tracing.scatterers.reflectors.lobes import change_in_blocks
from sarmitsuba.tracing.scatterers.reflectors.reflector import Reflector, Reflectors
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind, most_bounces

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.tracing.kernel.kernel import Accumulator, LaneArrays, TraceCounts
    from sarmitsuba.tracing.kernel.launch import LaunchGrid
    from sarmitsuba.tracing.kernel.state import Kernel

# s of a usual core to trace one, and bytes while they are laid out
TRACED, BYTES = 1e-6, 300


class OwnKinds(SourceKind):
    """Every kind that extensions register.

    Scatterers whose amplitude changes within a block of pulses by more than the tolerance, as in a lobe narrower than
    the block, are traced at every pulse: neither a block's key pulse nor a shorter block would tell the lobe.
    """

    name, rank = "reflectors", 15

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        targets = _own_targets(site.scene)
        if not targets:
            return None
        weights = site.shares(np.array([target.position for target in targets]))
        out = []
        for kind in _kinds(targets):
            mine = [i for i, target in enumerate(targets) if target.kind == kind.name and weights[i] > 1e-6]
            if mine:
                lit = [targets[i] for i in mine]
                scatterers = Reflectors(kind, lit, np.asarray(weights[mine]), np.array(mine))
                source = PointSource(scatterers, most_bounces(site.scene))
                out.append(_OfKind(source, _changes(site, kind, lit)))
        return _Several(tuple(out)) if out else None

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Each as a node of a wire, and as many as a block has pulses where it is traced at every pulse."""
        targets, traced = _own_targets(site.scene), 0
        for kind in _kinds(targets):
            mine = [target for target in targets if target.kind == kind.name]
            traced += len(mine) * (site.block if _changes(site, kind, mine) else 1)
        return Expected(traced, 0.0, TRACED, len(targets) * BYTES) if targets else None


def _own_targets(scene: Scene) -> list[ScattererTarget]:
    """Scatterers of a user's own kinds, in the order of the kinds."""
    each = (target for targets in targets_by_kind(scene.scatterers).values() for target in targets)
    return [target for target in each if isinstance(target, ScattererTarget)]


def _kinds(targets: Sequence[ScattererTarget]) -> list[Reflector]:
    """Kinds of these scatterers."""
    out = []
    for name in dict.fromkeys(target.kind for target in targets):
        kind = SCATTERERS[name]
        if not isinstance(kind, Reflector):
            raise ExtensionError(
                f"kind of scatterer {name!r} has no amplitude; derive it from sarmitsuba.extend.Reflector"
            )
        out.append(kind)
    return out


def _changes(site: Site, kind: Reflector, targets: Sequence[ScattererTarget]) -> bool:
    """Whether the amplitude of any changes within a block by more than the tolerance; refuses what is not finite."""
    allowed = float(power_from_db(site.scene.settings.tolerance_db))
    return change_in_blocks(site.scene, kind, targets, site.block) > allowed and site.block > 1


@dataclass(frozen=True, eq=False)
class _OfKind:
    """Scatterers of one kind, and whether they are traced at every pulse."""

    source: PointSource
    every_pulse: bool


@dataclass(frozen=True, eq=False)
class _PartOf(Part):
    """Part of one source of several."""

    source: int = 0


@dataclass(frozen=True, eq=False)
class _Several:
    """Several sources as one; see :class:`Source`."""

    each: tuple[_OfKind, ...]

    @property
    def unknown(self) -> frozenset[str]:
        """See :class:`PointSource`."""
        return frozenset().union(*(one.source.unknown for one in self.each))

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        return [
            _PartOf(part.grid, part.first, part.count, part.rays, of_kind.every_pulse, number)
            for number, of_kind in enumerate(self.each)
            for part in of_kind.source.parts(rays, n_pulses)
        ]

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        assert isinstance(part, _PartOf)
        return self.each[part.source].source.record(part, kernel, antenna, accumulator)

    def scatterers_of(self, part: Part) -> Scatterers:
        assert isinstance(part, _PartOf)
        return self.each[part.source].source.scatterers

    def at(self, wavelength: float) -> _Several:
        return _Several(tuple(replace(one, source=one.source.at(wavelength)) for one in self.each))


SOURCES.register(OwnKinds())
