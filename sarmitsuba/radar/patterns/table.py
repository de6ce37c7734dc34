"""Beam from measured cuts in azimuth and elevation."""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import Samples
from sarmitsuba.radar.pattern import PATTERNS, Pattern


class Table(Pattern):
    """Product of two measured cuts; beyond a cut's ends its last value holds."""

    name = "table"
    doc = "measured cuts in azimuth and elevation, from `pattern_file`"
    measured = True

    def gain(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """Return the product of both cuts, in a kernel linear between their nodes."""
        product: Samples = _looked_up(sin_azimuth, numbers[:4], xp) * _looked_up(
            sin_elevation, numbers[4:], xp
        )
        return product


def _looked_up(sine: Samples, numbers: Sequence[Samples | float], xp: ModuleType) -> Samples:
    """Gain of a cut whose numbers are the first node's sine, nodes per sine, number of the last node, and the nodes."""
    start, per_sine, last, nodes = numbers
    value: Samples
    place = xp.clip((sine - start) * per_sine, 0.0, last)
    if xp is np:  # smooth (Catmull and Rom's cubic): focusers take second derivatives
        node = xp.minimum(place, last - 1.0).astype(xp.intp)
        before, first, second, after = (xp.take(nodes, node + k, mode="clip") for k in range(-1, 3))
        x = place - node
        square = 2.0 * before - 5.0 * first + 4.0 * second - after
        cube = 3.0 * (first - second) + after - before
        value = xp.maximum(first + 0.5 * x * (second - before + x * (square + x * cube)), 0.0)
        return value
    node = xp.uint32_array_t(place)(xp.minimum(place, last - 1.0))
    first, second = (xp.gather(type(nodes), nodes, index) for index in (node, node + 1))
    value = xp.fma(place - type(place)(node), second - first, first)
    return value


PATTERNS.register(Table())
