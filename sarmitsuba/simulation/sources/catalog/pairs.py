"""Pairs of diffuse scatterers that see each other, drawn at random."""

from sarmitsuba.simulation.sources.kind import SOURCES, Expected, SourceKind
from sarmitsuba.simulation.sources.pair_estimate import (
    PILOT_POINTS,
    estimate_pairs,
    expected_pair_points,
    pilot_cell,
    run_pairs,
)
from sarmitsuba.simulation.sources.site import Site
from sarmitsuba.trace.diffuse_pairs import PairSource
from sarmitsuba.trace.source import Source

# seconds of a usual core: a point that pairs are drawn from, laid out, a pair traced, and a realisation that tells
# their level
POINT_LAID, PAIR_TRACED, LEVEL = 1e-6, 2.5e-7, 0.25
# bytes of a point while it is laid out, and about as many pairs as points
POINT_BYTES, PAIRS_OF_POINTS = 280, 0.1


class PairKind(SourceKind):
    """Pairs, as many as the error of their realisation wants."""

    name, rank = "pairs", 40

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        if not site.flags.diffuse_pairs or site.trace_scene is None:
            return None
        pairs = run_pairs(site, estimate_pairs(site, pilot_cell(site, PILOT_POINTS)))
        return PairSource(pairs) if pairs.n else None

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Points, by the level of pairs where it is known."""
        if not site.flags.diffuse_pairs or site.trace_scene is None:
            return None
        points = expected_pair_points(site)
        making = LEVEL + points * POINT_LAID
        return Expected(PAIRS_OF_POINTS * points, making, PAIR_TRACED, points * POINT_BYTES)


SOURCES.register(PairKind())
