"""Volume scatterers (vegetation), straight and over the ground."""

import numpy as np

from sarmitsuba.simulation.planning.sources.kind import SOURCES, Expected, SourceKind, most_bounces
from sarmitsuba.simulation.planning.sources.site import Site
from sarmitsuba.tracing.kernel.source import PointSource, Source
from sarmitsuba.tracing.scatterers.volumes.volume_scatterers import scatterer_spacing, volume_scatterers

# seconds of a reference core: for laying out a cell of the lattice, and for tracing a scatterer
CELL_LAID, SCATTERER_TRACED = 1e-6, 8e-6
# bytes of a cell while it is laid out, and of a scatterer that is kept
CELL_BYTES, SCATTERER_BYTES = 150, 100


class VolumeKind(SourceKind):
    """Volumes as scatterers in cells of a lattice."""

    name, rank = "volumes", 20

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        scene = site.scene
        if not scene.volumes:
            return None
        scatterers = volume_scatterers(scene.volumes, site.cell_area, scene.settings.seed, site.shares)
        return PointSource(scatterers, most_bounces(scene)) if scatterers.n else None

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of cells in the bounding boxes, and of scatterers inside the volumes."""
        volumes, area = site.scene.volumes, site.cell_area
        if not volumes:
            return None
        steps = [scatterer_spacing(volume, area) for volume in volumes]
        boxes = [
            float(np.prod(np.ptp(volume.bounds, axis=0) / step + 1.0))
            for volume, step in zip(volumes, steps, strict=True)
        ]
        kept = sum(volume.content / step**3 for volume, step in zip(volumes, steps, strict=True))
        making = sum(boxes) * CELL_LAID
        return Expected(kept, making, SCATTERER_TRACED, max(boxes) * CELL_BYTES + kept * SCATTERER_BYTES)


SOURCES.register(VolumeKind())
