"""A beam measured in azimuth and elevation."""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.radar.pattern import PATTERNS, Pattern
from sarmitsuba.samples import Samples


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
        """Return the product of both cuts, linear between their nodes."""
        product: Samples = _looked_up(sin_azimuth, numbers[:4], xp) * _looked_up(
            sin_elevation, numbers[4:], xp
        )
        return product


def _looked_up(sine: Samples, numbers: Sequence[Samples | float], xp: ModuleType) -> Samples:
    """Gain of a cut whose numbers are the first node's sine, nodes per sine, number of the last node, and the nodes."""
    start, per_sine, last, nodes = numbers
    value: Samples
    place = xp.clip((sine - start) * per_sine, 0.0, last)
    if xp is np:
        node = xp.minimum(place, last - 1.0).astype(xp.intp)
        first, second = (xp.take(nodes, index) for index in (node, node + 1))
        value = first + (place - node) * (second - first)
        return value
    node = xp.uint32_array_t(place)(xp.minimum(place, last - 1.0))
    first, second = (xp.gather(type(nodes), nodes, index) for index in (node, node + 1))
    value = xp.fma(place - type(place)(node), second - first, first)
    return value


PATTERNS.register(Table())

__all__ = ["Table"]
