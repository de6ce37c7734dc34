"""Wires in the lit part of a scene, clipped to a box."""

import numpy as np

from sarmitsuba.core.arrays import F64


def clip_segments(segments: F64, low: F64, high: F64) -> F64:
    """End points (m, 3) of segments (n, 2, 3) clipped to a box, by Liang and Barsky's method."""
    start, step = segments[:, 0], segments[:, 1] - segments[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / step, (high - start) / step
    still = step == 0.0
    inside = (start >= low) & (start <= high)
    a = np.where(still, np.where(inside, -np.inf, np.inf), a)
    b = np.where(still, np.where(inside, np.inf, -np.inf), b)
    first = np.maximum(np.minimum(a, b).max(axis=1), 0.0)
    last = np.minimum(np.maximum(a, b).min(axis=1), 1.0)
    kept = first <= last
    ends = [start[kept] + t[kept, None] * step[kept] for t in (first, last)]
    return np.concatenate(ends)
