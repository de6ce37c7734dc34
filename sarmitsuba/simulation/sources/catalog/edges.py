"""Fringe currents of sharp metal edges, for edges within the lit part of the scene."""

from sarmitsuba.simulation.sources.kind import SOURCES, Expected, SourceKind, most_bounces
from sarmitsuba.simulation.sources.site import Site
from sarmitsuba.trace.edges import FringeCurrents
from sarmitsuba.trace.source import PointSource, Source

# seconds of a usual core to trace a piece
PIECE_TRACED = 5e-6


class EdgeKind(SourceKind):
    """Sharp metal edges in pieces as long as the spacing of the coherent rays."""

    name, rank = "edges", 30

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        if not site.flags.edge_diffraction:
            return None
        edges = site.edges
        if site.flags.taper:
            edges = edges.weighted(site.light(edges.middle))
        if not edges.n:
            return None
        return PointSource(FringeCurrents(edges), most_bounces(site.scene) if site.flags.multi_bounce else 1)

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of edges, which are found here and kept for the run."""
        if not site.flags.edge_diffraction or not site.edges.n:
            return None
        return Expected(site.edges.n, 0.0, PIECE_TRACED, 0.0)


SOURCES.register(EdgeKind())
