"""Drawn radars with the image that they can make, for trials of focusers, and drawn places on the Earth."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image import ImageGrid

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


def singular_place(rng: np.random.Generator, reach: float) -> Anchor:
    """Place within ``reach`` m of where maps have an edge.

    The antimeridian, a pole, the equator, the limits of UTM, or the border of a zone, of UTM or of Norway's wider ones.
    """
    degrees = reach / 111e3
    borders = [
        (rng.uniform(-89.9, 89.9), 180.0),
        (rng.uniform(-89.9, 89.9), -180.0),
        (90.0, rng.uniform(-180, 180)),
        (-90.0, rng.uniform(-180, 180)),
        (0.0, rng.uniform(-180, 180)),
        (84.0, rng.uniform(-180, 180)),
        (-80.0, rng.uniform(-180, 180)),
        (rng.uniform(-80, 84), -180.0 + 6.0 * rng.integers(60)),
        (rng.uniform(56, 64), rng.choice([0.0, 3.0, 6.0, 12.0])),
        (rng.uniform(72, 84), rng.choice([0.0, 6.0, 9.0, 12.0, 18.0, 21.0, 30.0, 33.0, 42.0])),
    ]
    latitude, longitude = borders[rng.integers(len(borders))]
    latitude = np.clip(latitude + rng.uniform(-degrees, degrees), -90.0, 90.0)
    longitude += rng.uniform(-degrees, degrees) / max(np.cos(np.radians(latitude)), 1e-3)
    return Anchor.of_degrees(latitude, longitude, rng.uniform(0, 1500))


__all__ = ["CELLS", "random_geometry", "singular_place"]
