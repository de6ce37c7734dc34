"""Boxes on a square grid: the buildings of a city of any size."""

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.mesh.tessellate import cube


def city_mesh(
    n_buildings: int, extent: float, heights: tuple[float, float], seed: int = 1
) -> tuple[F64, I32]:
    """Return boxes on a square grid, walls along the axes, feet 0.5 m below z = 0.

    Parameters
    ----------
    n_buildings : at least 1; the grid has the next square number of plots, those left over stay empty
    extent : side of the square about the origin, m
    heights : lowest and highest building, m
    seed : of footprints, positions and heights

    Returns
    -------
    vertices (8 n, 3) float64, m; faces (12 n, 3) int32; normals outwards
    """
    if n_buildings < 1:
        raise SceneError(f"city: n_buildings = {n_buildings} must be at least 1")
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n_buildings)))
    pitch = extent / side
    plot = np.arange(n_buildings)
    center = (np.column_stack([plot % side, plot // side]) + 0.5) * pitch - 0.5 * extent
    # 0.4 to 0.6 of the plot, rounded to 0.1 m; the rest is street
    size = np.round(rng.uniform(0.4, 0.6, (n_buildings, 2)) * pitch, 1)
    center += np.round(rng.uniform(-0.05, 0.05, (n_buildings, 2)) * pitch, 1)
    height = np.round(rng.uniform(*heights, n_buildings), 1)
    v, f = cube()
    low = np.column_stack([center - 0.5 * size, np.full(n_buildings, -0.5)])
    high = np.column_stack([center + 0.5 * size, height])
    vertices = low[:, None] + (0.5 * v + 0.5)[None] * (high - low)[:, None]
    faces = f[None] + 8 * plot[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32)
