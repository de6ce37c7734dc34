"""Layover and shadow of boxes on level ground by dense sampling, sharing no code with the labels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64

Bools = NDArray[np.bool_]

# corners of the unit box and its faces as corner, first and second edge: bottom, top, four sides
_FACES = (
    ((0, 0, 0), (1, 0, 0), (0, 1, 0)),
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    ((0, 0, 0), (1, 0, 0), (0, 0, 1)),
    ((0, 1, 0), (1, 0, 0), (0, 0, 1)),
    ((0, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
)
_BOTTOM = 0


@dataclass(frozen=True, eq=False)
class UprightBox:
    """Box on the plane z = 0.

    Parameters
    ----------
    middle : (2,) m
    size : (3,) m
    yaw : rad
    """

    middle: F64
    size: F64
    yaw: float

    @property
    def axes(self) -> F64:
        """(2, 2) horizontal unit vectors of its sides."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s], [-s, c]])

    def of_unit(self, share: F64) -> F64:
        """Points (n, 3), m, at shares 0 ... 1 of its sides."""
        xy = self.middle + ((share[:, :2] - 0.5) * self.size[:2]) @ self.axes
        return np.column_stack([xy, share[:, 2] * self.size[2]])

    def mesh(self) -> tuple[F64, list[list[int]]]:
        """Corners and triangles."""
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
        faces = []
        for start, one, two in _FACES:
            a, b, c = np.array(start), np.array(one), np.array(two)
            quad = [int(v @ [4, 2, 1]) for v in (a, a + b, a + b + c, a + c)]
            faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
        return self.of_unit(corners), faces

    def in_way(self, start: F64, end: F64) -> F64:
        """Length, in shares of the way, that lines from points (n, 3) to points (n, 3) run inside; <= 0: none."""
        turn = np.eye(3)
        turn[:2, :2] = self.axes
        low = np.array([-0.5, -0.5, 0.0]) * self.size
        middle = np.append(self.middle, 0.0)
        p, q = (start - middle) @ turn.T, (end - middle) @ turn.T
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = ((edge - p) / (q - p) for edge in (low, low + self.size))
        enter = np.nanmax(np.minimum(one, two), axis=1)
        leave = np.nanmin(np.maximum(one, two), axis=1)
        return np.asarray(np.minimum(leave, 1.0) - np.maximum(enter, 0.0))

    def covers(self, point: F64) -> Bools:
        """Whether points (n, 3) lie in its plan, (n,) bool."""
        local = np.abs((point[:, :2] - self.middle) @ self.axes.T)
        return np.asarray((local < 0.5 * self.size[:2]).all(axis=1))


@dataclass(frozen=True, eq=False)
class Sampled:
    """Samples of surfaces: places, number of the surface, whether seen, whether nothing is above."""

    point: F64
    surface: I64
    seen: Bools
    open: Bools


def sampled(boxes: list[UprightBox], extent: F64, step: float, antenna_of: Callable[[F64], F64]) -> Sampled:
    """Samples of boxes and of the ground.

    Parameters
    ----------
    extent : (2, 2) lower and upper corner of the ground, m
    step : between samples, m
    antenna_of : function that gives the antenna (n, 3) that looks at points (n, 3)
    """
    x, y = (np.arange(low, high, step) for low, high in extent.T)
    ground = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    ground = np.column_stack([ground, np.zeros(len(ground))])
    points, surfaces = [ground], [np.zeros(len(ground), dtype=np.int64)]
    for i, box in enumerate(boxes):
        for j, (start, one, two) in enumerate(_FACES):
            counts = [int(np.ceil(abs(np.array(edge) @ box.size) / step)) for edge in (one, two)]
            u, v = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts))
            share = np.array(start) + u.reshape(-1, 1) * np.array(one) + v.reshape(-1, 1) * np.array(two)
            points.append(box.of_unit(share))
            surfaces.append(np.full(len(share), 1 + 6 * i + j))
    point, surface = np.concatenate(points), np.concatenate(surfaces)
    antenna = antenna_of(point)
    seen, free = np.ones(len(point), dtype=bool), np.ones(len(point), dtype=bool)
    for i, box in enumerate(boxes):
        # a point of the box itself is hidden where the line goes on inside
        seen &= ~(box.in_way(point, antenna) > 1e-9)
        own = (surface > 6 * i) & (surface <= 6 * i + 6)
        free &= ~np.where(own, surface == 1 + 6 * i + _BOTTOM, box.covers(point))
    return Sampled(point, surface, seen, free)


def expected_masks(found: Sampled, row: F64, column: F64, shape: tuple[int, int]) -> tuple[I64, Bools]:
    """Mask of layover and shadow, and where it is sure: pixels whose neighbours hold the same surfaces, seen alike.

    Parameters
    ----------
    row, column : (n,) fractional pixel of every sample
    """
    state = found.surface * 4 + 2 * found.seen + found.open
    kinds, state = np.unique(state, return_inverse=True)
    i, j = np.rint(row).astype(np.int64), np.rint(column).astype(np.int64)
    inside = (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
    held = np.zeros((*shape, len(kinds)), dtype=bool)
    held[i[inside], j[inside], state[inside]] = True
    alike = np.zeros(shape, dtype=bool)
    around = [held[a : shape[0] - 2 + a, b : shape[1] - 2 + b] for a in range(3) for b in range(3)]
    alike[1:-1, 1:-1] = np.all([(one == around[4]).all(axis=-1) for one in around], axis=0)
    seen = held[..., (kinds & 2) > 0].sum(axis=-1)
    hidden = held[..., (kinds & 3) == 1].sum(axis=-1)
    dark = held[..., (kinds & 2) == 0].any(axis=-1)
    mask = np.full(shape, 255)
    mask[dark] = 1
    mask[(seen == 1) & (hidden == 0)] = 0
    mask[(seen > 1) & (hidden == 0)] = 2
    mask[(seen > 0) & (hidden > 0)] = 3
    return mask, alike
