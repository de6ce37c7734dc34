"""Scatterers of a user's own kinds, straight and over the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.errors import ExtensionError
from sarmitsuba.scene.scatterers import SCATTERERS, positions_of
from sarmitsuba.simulation.sources.kind import SOURCES, Expected, SourceKind, most_bounces
from sarmitsuba.simulation.sources.site import Site
from sarmitsuba.trace.reflectors import Reflector, Reflectors
from sarmitsuba.trace.source import Part, PointSource, Source

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.trace.kernel import Accumulator, LaneArrays, TraceCounts
    from sarmitsuba.trace.launch import LaunchGrid
    from sarmitsuba.trace.state import Kernel

# s of a usual core to trace one, and bytes while they are laid out
TRACED, BYTES = 1e-6, 300


class OwnKinds(SourceKind):
    """Every kind that extensions register."""

    name, rank = "reflectors", 15

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        targets = site.scene.scatterers
        if not targets:
            return None
        weights = site.shares(positions_of(targets))
        out = []
        for name in dict.fromkeys(target.kind for target in targets):
            kind = SCATTERERS[name]
            if not isinstance(kind, Reflector):
                raise ExtensionError(
                    f"kind of scatterer {name!r} has no amplitude; derive it from sarmitsuba.trace.reflectors.Reflector"
                )
            mine = [i for i, target in enumerate(targets) if target.kind == name and weights[i] > 1e-6]
            if mine:
                scatterers = Reflectors(kind, [targets[i] for i in mine], np.asarray(weights[mine]))
                out.append(PointSource(scatterers, most_bounces(site.scene)))
        return _Several(tuple(out)) if out else None

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Each as a node of a wire."""
        n = len(site.scene.scatterers)
        return Expected(n, 0.0, TRACED, n * BYTES) if n else None


@dataclass(frozen=True, eq=False)
class _PartOf(Part):
    """Part of one source of several."""

    source: int = 0


@dataclass(frozen=True, eq=False)
class _Several:
    """Several sources as one; see :class:`Source`."""

    each: tuple[Source, ...]

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        return [
            _PartOf(part.grid, part.first, part.count, part.rays, number)
            for number, source in enumerate(self.each)
            for part in source.parts(rays, n_pulses)
        ]

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        assert isinstance(part, _PartOf)
        return self.each[part.source].record(part, kernel, antenna, accumulator)

    def at(self, wavelength: float) -> _Several:
        return _Several(tuple(source.at(wavelength) for source in self.each))


SOURCES.register(OwnKinds())
