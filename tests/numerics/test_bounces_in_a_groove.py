"""V grooves of lossy walls: as many bounces as the image needs, where every second one returns nothing."""

import numpy as np
import pytest

from sarmitsuba import RadarDescription, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.simulation.planning.pilot import plan_scene
from tests.support.unweighted import focus

# m, of the walls: along the groove, and down to its edge
SIZE = 8.0


def groove(opening_deg: float, heading_deg: float, look_deg: float) -> Scene:
    """Groove along the scene's y axis, open to the zenith, on a track of about ten pulses."""
    half = np.radians(opening_deg / 2.0)
    x, z, y = SIZE * np.sin(half), SIZE * np.cos(half), SIZE / 2.0
    walls = [
        SceneMesh(
            np.array([[0.0, -y, 0.0], [0.0, y, 0.0], [side * x, y, z], [side * x, -y, z]]),
            [[0, 1, 2], [0, 2, 3]],
            {"material": "concrete", "smooth": True},
            name,
        )
        for side, name in ((1.0, "right"), (-1.0, "left"))
    ]
    radar = RadarDescription(
        slant_range=2e3,
        bandwidth=75e6,
        azimuth_resolution=8.0,
        look_angle_deg=look_deg,
        heading_deg=heading_deg,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=SIZE / 2.0,
    )
    film = FilmDescription(image_extent_azimuth=30.0, image_extent_range=40.0)
    return build_scene(walls, radar=radar, film=film)


GROOVES = [(15.76, 327.4, 13.0), (15.99, 45.1, 17.0)]


@pytest.mark.parametrize(("opening", "heading", "look"), GROOVES)
def test_no_return_at_one_bounce_does_not_end_the_pilot(opening: float, heading: float, look: float) -> None:
    """Seen obliquely only odd bounces return: the eighth returns nothing, the ninth does."""
    assert 8 < plan_scene(groove(opening, heading, look)).max_depth < 30


@pytest.mark.slow
@pytest.mark.parametrize(("opening", "heading", "look"), GROOVES)
def test_bounces_left_out_are_below_the_tolerance(opening: float, heading: float, look: float) -> None:
    scene = groove(opening, heading, look)
    depth = plan_scene(scene).max_depth
    images = [focus(simulate(scene.replace(max_depth=n), seed=1)).data for n in (depth, 30)]
    left_out = np.linalg.norm(images[1] - images[0]) / np.linalg.norm(images[1])
    assert left_out < 10.0 ** (scene.settings.tolerance_db / 20.0)
