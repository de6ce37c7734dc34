"""Echoes of surfaces, from the rays of a batch's lattices; each ray is a tube that returns an echo at every hit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from sarmitsuba.tracing.kernel.kernel import trace
from sarmitsuba.tracing.kernel.source import Part

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.kernel import Accumulator, LaneArrays, TraceCounts
    from sarmitsuba.tracing.kernel.launch import LaunchGrid
    from sarmitsuba.tracing.kernel.state import Kernel


class Surfaces:
    """Source of the echoes of surfaces; see :class:`sarmitsuba.tracing.kernel.source.Source`."""

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        """One launch for each lattice."""
        return [Part(grid, 0, grid.n_rays, rays=grid.n_rays) for grid in rays]

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        """Record one launch, with only the kind of return that the lattice samples."""
        purpose, flags = part.grid.purpose, kernel.flags
        if purpose == "coherent":
            flags = replace(flags, diffuse=False)
        elif purpose == "diffuse":
            flags = replace(flags, coherent=False)
        return trace(replace(kernel, flags=flags), antenna, accumulator)

    def at(self, wavelength: float) -> Surfaces:
        """The same source: only the kernel's wavenumber changes."""
        return self
