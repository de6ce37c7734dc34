"""Lattices of rays turned off the edges of facets."""

import numpy as np
import pytest

from sarmitsuba.tracing.kernel.launch import LEAST_ANGLE, lattice


def _nearest(turn: float, edges: np.ndarray) -> float:
    """Least angle between an edge and a line of the lattice, rad, by trying every line."""
    lines = [np.array([np.cos(turn + q), np.sin(turn + q)]) for q in 0.5 * np.pi * np.arange(4)]
    return min(np.arccos(min(1.0, e @ a / np.hypot(*e))) for e in edges for a in lines)


@pytest.mark.parametrize("seed", range(40))
def test_no_line_of_the_lattice_follows_an_edge(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    angle = rng.uniform(0.0, 2.0 * np.pi, 4)
    edges = rng.uniform(0.5, 2.0, 4)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    free = lattice(1.0, 1.0, 0.5, seed=seed)
    off = lattice(1.0, 1.0, 0.5, seed=seed, edges=edges)
    assert _nearest(off.turn, edges) >= LEAST_ANGLE
    # a lattice that follows none stays as it is
    assert off.turn == free.turn or _nearest(free.turn, edges) < LEAST_ANGLE


@pytest.mark.parametrize("seed", range(8))
def test_a_window_between_the_lines_of_the_lattice_has_one_ray(seed: int) -> None:
    """Without one the launch had no rays, and what is divided by their number failed in the kernel."""
    grid = lattice(0.01, 0.02, 1e4, seed=seed)
    assert grid.n_rays == 1
    assert abs(float(grid.x[0])) <= 0.01 and abs(float(grid.y[0])) <= 0.02
