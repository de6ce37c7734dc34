"""Thin straight wires (cables, rails, masts), straight and over the ground."""

import numpy as np

from sarmitsuba.scene.materials.cylinder import table_size
from sarmitsuba.simulation.planning.sources.kind import SOURCES, Expected, SourceKind, most_bounces
from sarmitsuba.simulation.planning.sources.site import Site
from sarmitsuba.tracing.kernel.source import PointSource, Source
from sarmitsuba.tracing.scatterers.wires.wire_nodes import WireScatterers, cut

# seconds of a reference core: for laying out a node, for a table entry per order, and for tracing a node
NODE_LAID, NUMBER_LAID, NODE_TRACED = 1e-6, 1.1e-7, 1e-6
# bytes of a node and of a table entry while they are laid out
NODE_BYTES, NUMBER_BYTES = 300, 150


class WireKind(SourceKind):
    """Wires as rows of nodes."""

    name, rank = "wires", 10

    def made(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        scene = site.scene
        if not scene.wires:
            return None
        nodes = cut(scene.wires, site.wire_step)
        nodes = nodes.weighted(site.shares(nodes.point))
        if not len(nodes.point):
            return None
        return PointSource(WireScatterers(nodes, scene.wires, site.wavelength), most_bounces(scene))

    def expected(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of nodes, and of tables for each thickness and material at each frequency."""
        wires = site.scene.wires
        if not wires:
            return None
        step, wavenumber = site.wire_step, 2.0 * np.pi / site.wavelength
        nodes = sum(wire.length / step + 2.0 for wire in wires)
        tables = [
            table_size(wavenumber * radius, eps)
            for radius, eps in {(wire.radius, wire.permittivity) for wire in wires}
        ]
        terms = sum(tilts * azimuths * orders for tilts, azimuths, orders in tables)
        numbers = max(tilts * azimuths for tilts, azimuths, _ in tables)
        making = nodes * NODE_LAID + sub_bands * terms * NUMBER_LAID
        return Expected(nodes, making, NODE_TRACED, nodes * NODE_BYTES + numbers * NUMBER_BYTES)


SOURCES.register(WireKind())
