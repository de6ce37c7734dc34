"""Waves of metal edges: fringe currents of those within the lit part of the scene, and waves of folds beyond rays."""

import numpy as np

from sarmitsuba.effects.fold_sections import fold_grids
from sarmitsuba.tracing.kernel.source import PointSource, Source
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind, most_bounces

# seconds of a usual core to trace a piece
PIECE_TRACED = 5e-6
# seconds of a usual core for the table of a fold between faces of ten wavelengths
SECTION_SOLVED = 0.3


class EdgeKind(SourceKind):
    """Sharp metal edges in pieces as long as the spacing of the coherent rays."""

    name, rank = "edges", 30

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        if not site.flags.edge_diffraction:
            return None
        edges = site.edges
        if site.flags.taper:
            edges = edges.weigh(site.light(edges.middle))
        if not edges.n:
            return None
        return PointSource(FringeCurrents(edges), most_bounces(site.scene) if site.flags.multi_bounce else 1)

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of edges, which are found here and kept for the run."""
        if not site.flags.edge_diffraction or not site.edges.n:
            return None
        return Expected(site.edges.n, 0.0, PIECE_TRACED, 0.0)


class FoldKind(SourceKind):
    """Folds between flat metal faces that do not meet squarely, seen by one antenna."""

    name, rank = "folds", 31

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        return None if site.fold_waves is None else PointSource(site.fold_waves)

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost of the sections that are solved, and of the pieces of their folds."""
        folds = site.folds
        if not folds.n:
            return None
        grids = fold_grids(folds, site.wavelength, site.towards(folds.middle.mean(axis=0)))
        if not grids:
            return None
        seconds = sub_bands * len(grids) * SECTION_SOLVED
        length = folds.length[[grid.row for grid in grids]]
        pieces = float(np.ceil(length / max(0.5 * site.resolution, site.wavelength)).sum())
        return Expected(pieces, seconds, PIECE_TRACED, 0.0)


SOURCES.register(EdgeKind())
SOURCES.register(FoldKind())
