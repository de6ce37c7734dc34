"""Extent of the scatterers: their outline and the default aim point."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.arrays import F64


@dataclass(frozen=True, eq=False)
class Extent:
    """Outline and middle of all scatterers, scene frame.

    Parameters
    ----------
    outline : (n, 3) float64, m; points whose convex hull contains all scatterers
    middle : (3,) float64, m; default aim point: the middle of the outline, on the ground
    """

    outline: F64
    middle: F64

    @staticmethod
    def of_box(low: F64, high: F64) -> "Extent":
        """Extent of an axis-parallel box with the ground at its bottom; (3,) lower and upper corner, m."""
        ends = np.stack([low, high])
        corners = np.array(
            [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        return Extent(corners, np.array([*(0.5 * (ends[0] + ends[1])[:2]), ends[0, 2]]))

    def in_axes(self, origin: F64, axes: F64) -> tuple[F64, F64]:
        """Lower and upper corner (3,) of the outline's box, from ``origin``, along the rows of ``axes``."""
        local = (self.outline - origin) @ axes.T
        return local.min(axis=0), local.max(axis=0)
