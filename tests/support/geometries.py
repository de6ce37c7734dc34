"""Drawn radars with the image that they can make, for trials of focusers."""

from dataclasses import replace

import numpy as np

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.focusing import default_grid
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.loader.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget

CELLS = 72  # edge of the image, resolution cells


def random_geometry(mode: str, slant_range: float, cell: float, seed: int) -> tuple[Radar, ImageGrid]:
    """A radar with random heading, squint, look angle and side, and a slant grid about its aim point.

    Parameters
    ----------
    mode : ``spotlight`` with an isotropic antenna, or ``stripmap`` with a rectangular one of twice the cell's length
    slant_range : m, to the aim point, the origin
    cell : m, resolution in azimuth and range
    seed : of the geometry
    """
    rng = np.random.default_rng([13, seed, len(mode)])
    radar = RadarDescription(
        mode=mode,
        slant_range=slant_range,
        look_angle_deg=rng.uniform(25.0, 55.0),
        heading_deg=rng.uniform(0.0, 360.0),
        look_side=("left", "right")[rng.integers(2)],
        squint_angle_deg=rng.uniform(-4.0, 4.0),
        bandwidth=0.5 * SPEED_OF_LIGHT / cell,
        azimuth_resolution=cell,
        speed=7500.0 if slant_range > 1e5 else 100.0,
        pattern="isotropic",
    )
    if mode == "stripmap":
        radar = replace(radar, pattern="rectangular", antenna_length=2.0 * cell, antenna_height=0.05)
    film = FilmDescription(
        image_grid="slant", image_extent_azimuth=CELLS * cell, image_extent_range=CELLS * cell
    )
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=film)
    return scene.radar, default_grid(scene.radar, scene.image)


__all__ = ["CELLS", "random_geometry"]
