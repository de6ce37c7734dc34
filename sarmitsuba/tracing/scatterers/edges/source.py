"""Waves of metal edges: fringe currents of those within the lit part of the scene, and waves of folds beyond rays."""

import numpy as np

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.fold_sections import Folds, find_folds, fold_grids
from sarmitsuba.effects.omitted_waves import EDGES, SimulatedWaves
from sarmitsuba.effects.theory_error import MOST_IMAGE_FACES, too_many
from sarmitsuba.scene.mesh.double_faces import double_faces
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.visible_faces import VisibleFaces
from sarmitsuba.tracing.kernel.source import PointSource, Source
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents, edges_of
from sarmitsuba.tracing.scatterers.edges.fold_waves import FoldWaves
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind, most_bounces

# seconds of a usual core to trace a piece
PIECE_TRACED = 5e-6
# seconds of a usual core for the table of a fold between faces of ten wavelengths
SECTION_SOLVED = 0.3


def _site_edges(site: Site) -> SharpEdges:
    """Edges of a site, in pieces as long as the spacing of its rays; found once."""
    scene = site.scene
    return site.once(
        "edges",
        lambda: edges_of(scene.geometry, scene.materials, site.wavelength, site.half_cell, site.spacing),
    )


def _site_folds(site: Site) -> Folds:
    """Folds of a site whose waves are followed, found once."""
    return site.once("folds", lambda: followed_folds(site.scene, site.flags, site.wavelength))


def _site_fold_waves(site: Site) -> FoldWaves:
    """Waves of the folds of a site, which several tracings share."""
    folds = _site_folds(site)

    def make() -> FoldWaves:
        towards = site.towards(folds.middle.mean(axis=0))
        return FoldWaves(folds, site.wavelength, towards, 0.5 * site.resolution)

    return site.once("fold waves", make)


def followed_folds(scene: Scene, flags: KernelFlags, wavelength: float) -> Folds:
    """Folds between faces of smooth metal at rest whose waves a run follows beyond rays, as far as tabulated."""
    geometry, corners = scene.geometry, np.zeros((0, 3, 3))
    if SimulatedWaves.of(scene, flags).folds:
        visible, still = VisibleFaces.of(geometry, scene.materials), np.ones(geometry.n_faces, dtype=bool)
        for _, faces in geometry.moving_meshes():
            still[faces] = False
        smooth = np.array([m.rms_height == 0.0 for m in scene.materials], dtype=bool)[geometry.face_material]
        kept = visible.metal & still[visible.face] & smooth[visible.face]
        if kept.any() and not too_many(visible.corners[kept], MOST_IMAGE_FACES):
            corners = visible.corners[kept]
            corners = corners[~double_faces(corners, visible.shape[kept])]
    return find_folds(corners, wavelength)


class EdgeKind(SourceKind):
    """Sharp metal edges in pieces as long as the spacing of the coherent rays."""

    name, rank = "edges", 30

    def make_source(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        if not site.flags.on(EDGES):
            return None
        edges = _site_edges(site)
        if site.flags.taper:
            edges = edges.weigh(site.light(edges.middle))
        if not edges.n:
            return None
        return PointSource(FringeCurrents(edges), most_bounces(site.scene) if site.flags.multi_bounce else 1)

    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of edges, which are found here and kept for the run."""
        n = _site_edges(site).n if site.flags.on(EDGES) else 0
        return Expected(n, 0.0, PIECE_TRACED, 0.0) if n else None

    def note(self, site: Site) -> str:
        """Edges of facets that share no corners, and double faces."""
        return _site_edges(site).joined_text if site.flags.on(EDGES) else ""


class FoldKind(SourceKind):
    """Folds between flat metal faces that do not meet squarely, seen by one antenna."""

    name, rank = "folds", 31

    def make_source(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        if not _site_folds(site).n:
            return None
        waves = _site_fold_waves(site)
        return PointSource(waves) if waves.n else None

    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost of the sections that are solved, and of the pieces of their folds."""
        folds = _site_folds(site)
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
