"""Cutting triangles into pixels: no gap, no pixel twice, whatever the triangles and however bent their image."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import Delaunay

from sarmitsuba.analysis.geometric_labels import Fragments, fragments
from sarmitsuba.core.arrays import F64

SHAPE = (47, 61)
ANTENNA = np.array([0.0, 0.0, 100.0])


def flat(points: F64) -> F64:
    return np.asarray(points[:, :2])


def bent(points: F64) -> F64:
    """As range bends the ground: a hyperbola from 60 pixels before the image on; nothing is shown before it."""
    place = np.stack([points[:, 0] + 0.1 * points[:, 1], np.hypot(points[:, 1] + 60.0, 80.0) - 100.0], axis=1)
    place[points[:, 1] < -60.0] = np.nan
    return place


def drawn(rng: np.random.Generator, low: float, high: float, count: int) -> F64:
    """Triangles of a drawn triangulation of a square, also with corners on centres of pixels."""
    points = rng.uniform(low, high, (count, 2))
    points[::3] = np.rint(points[::3])
    points = np.concatenate([points, [[low, low], [low, high], [high, low], [high, high]]])
    corners = np.unique(points, axis=0)
    return np.pad(corners[Delaunay(corners).simplices], ((0, 0), (0, 0), (0, 1)))


def once_each(found: Fragments) -> None:
    count = np.bincount(found.pixel, minlength=SHAPE[0] * SHAPE[1])
    assert (count == 1).all(), f"{(count == 0).sum()} gaps, {(count > 1).sum()} pixels twice"


@pytest.mark.parametrize("place", [flat, bent])
@pytest.mark.parametrize("count", [1, 40, 3000])
@pytest.mark.parametrize("seed", range(3))
def test_a_triangulated_plane_is_once_in_every_pixel(
    place: Callable[[F64], F64], count: int, seed: int
) -> None:
    rng = np.random.default_rng([seed, count])
    triangles = drawn(rng, -150.0, 150.0, count)
    turned = np.where(rng.random(len(triangles))[:, None, None] < 0.5, triangles[:, ::-1], triangles)
    found = fragments(turned, place, SHAPE, ANTENNA, lambda middle, radius: middle[:, 1] + radius > -30.0)
    once_each(found)
    row, column = np.divmod(found.pixel, SHAPE[1])
    # tol: triangles are straight in the image to 0.02 pixels at the middles of their edges
    assert np.abs(place(found.point) - np.stack([row, column], axis=1)).max() < 0.03
    if place is flat:
        assert found.area == pytest.approx(np.ones(len(found.area)))


def test_pixels_whose_centre_is_on_a_common_edge_are_in_one_triangle() -> None:
    corner = np.array([[-5.0, 10.0, 0.0], [80.0, 10.0, 0.0], [80.0, 70.0, 0.0], [-5.0, 70.0, 0.0]])
    below = corner - [0.0, 60.0, 0.0]
    found = fragments(
        np.array([corner[[0, 1, 2]], corner[[0, 3, 2]], below[[0, 1, 2]], below[[2, 3, 0]]]),
        flat,
        SHAPE,
        ANTENNA,
    )
    once_each(found)


def test_places_without_image_are_left_out() -> None:
    def half(points: F64) -> F64:
        place = flat(points).copy()
        place[points[:, 1] < 20.25] = np.nan
        return place

    square = np.array([[-1e4, -1e4, 0.0], [1e4, -1e4, 0.0], [1e4, 1e4, 0.0], [-1e4, 1e4, 0.0]])
    found = fragments(square[[[0, 1, 2], [0, 2, 3]]], half, SHAPE, ANTENNA)
    column = found.pixel % SHAPE[1]
    assert column.min() >= 20
    # all but the columns beside the border, closer to it than the smallest triangle
    assert (np.bincount(column, minlength=SHAPE[1])[22:] == SHAPE[0]).all()


def test_nothing_gives_nothing() -> None:
    found = fragments(np.zeros((0, 3, 3)), flat, SHAPE, ANTENNA)
    assert found.pixel.size == 0 and found.point.shape == (0, 3)
    away = np.array([[[500.0, 0.0, 0.0], [501.0, 0.0, 0.0], [500.0, 1.0, 0.0]]])
    assert fragments(away, flat, SHAPE, ANTENNA).pixel.size == 0
    line = np.array([[[5.0, 5.0, 0.0], [20.0, 20.0, 0.0], [10.0, 10.0, 3.0]]])  # seen edge on
    assert fragments(line, flat, SHAPE, ANTENNA).pixel.size == 0
