"""Random pairs of mutually visible diffuse scatterers."""

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.kernel.source import Source
from sarmitsuba.tracing.scatterers.pairs.diffuse_pairs import PairSource
from sarmitsuba.tracing.scatterers.pairs.kind import FLAG, PAIRS
from sarmitsuba.tracing.scatterers.pairs.pair_estimate import (
    PILOT_POINTS,
    estimate_pairs,
    expected_pair_points,
    pair_level,
    pilot_cell,
    run_pairs,
)
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind

# seconds of a reference core: for laying out a point, for tracing a pair, and for the draw that estimates their level
POINT_LAID, PAIR_TRACED, LEVEL = 1e-6, 2.5e-7, 0.25
# bytes of a point while it is laid out; there are about as many pairs as points
POINT_BYTES, PAIRS_OF_POINTS = 280, 0.1


class PairKind(SourceKind):
    """Pairs of diffuse scatterers, as many as the sampling error requires."""

    name, rank = PAIRS, 40

    def make_source(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        if not site.flags.on(FLAG) or site.trace_scene is None:
            return None
        pairs = run_pairs(site, estimate_pairs(site, pilot_cell(site, PILOT_POINTS)))
        return PairSource(pairs) if pairs.n else None

    def measures(self, flags: KernelFlags) -> bool:
        """Where they are on: their power decides."""
        return flags.on(FLAG)

    def measure(self, site: Site) -> object:
        """Their :class:`PairLevel`."""
        return pair_level(site)

    def bounces(self, scene: Scene, flags: KernelFlags) -> int:
        """Two where they are on."""
        return 2 if flags.on(FLAG) else 1

    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of points, which depends on the level of pairs where it is known."""
        if not site.flags.on(FLAG) or site.trace_scene is None:
            return None
        points = expected_pair_points(site)
        making = LEVEL + points * POINT_LAID
        return Expected(PAIRS_OF_POINTS * points, making, PAIR_TRACED, points * POINT_BYTES)


SOURCES.register(PairKind())
