"""Where a focused image shows points: equal histories of range, on recorded tracks, of two antennas, from orbit."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.core.arrays import F64
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.motion import Motion
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid


def made(rng: np.random.Generator, **given: object) -> tuple[Radar, ImageGrid]:
    usual = {
        "slant_range": 4000.0,
        "look_angle_deg": rng.uniform(25.0, 55.0),
        "heading_deg": rng.uniform(-180.0, 180.0),
        "look_side": str(rng.choice(["left", "right"])),
    }
    usual = {} if "orbit_altitude" in given else usual
    radar = RadarDescription(
        **{"mode": "spotlight", "azimuth_resolution": 1.0, **usual, **given}  # type: ignore[arg-type]
    )
    film = FilmDescription(
        image_grid=str(rng.choice(["slant", "ground"])), image_extent_azimuth=60.0, image_extent_range=80.0
    )
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=film)
    return scene.radar, default_grid(scene.radar, scene.image)


def drawn_points(rng: np.random.Generator) -> F64:
    return rng.uniform([-20.0, -20.0, 0.0], [20.0, 20.0, 12.0], (50, 3))


def place_of(grid: ImageGrid, azimuth: F64, range_: F64) -> F64:
    """Points of the image plane at coordinates of the grid."""
    across = range_ if grid.kind == "ground" else np.sqrt(range_**2 - (grid.origin[2] - grid.height) ** 2)
    flat = np.array([grid.origin[0], grid.origin[1], grid.height])
    return np.asarray(flat + azimuth[:, None] * grid.along + across[:, None] * grid.across)


def worst_difference(radar: Radar, points: F64, places: F64) -> float:
    """Largest difference of range of points and their places over all pulses, m."""
    return max(
        float(np.abs(radar.slant_range(p) - radar.slant_range(q)).max())
        for p, q in zip(points, places, strict=True)
    )


@pytest.mark.parametrize("squint", [0.0, 11.0])
@pytest.mark.parametrize("seed", range(3))
def test_places_have_the_histories_of_their_points(seed: int, squint: float) -> None:
    rng = np.random.default_rng(seed)
    radar, grid = made(rng, squint_angle_deg=squint)
    points = drawn_points(rng)
    places = place_of(grid, *ImagePlacement(grid, radar).locate(points))
    assert worst_difference(radar, points, places) < 1e-6  # tol: Newton's method ends at 1e-7 m
    antenna = ImagePlacement(grid, radar).antenna(points)
    assert np.abs(antenna - radar.track.center_position).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_places_of_two_antennas_have_the_same_way_of_both(seed: int) -> None:
    rng = np.random.default_rng([1, seed])
    radar, grid = made(rng)
    beside = radar.track.moved(rng.uniform(-150.0, 150.0) * radar.across + rng.uniform(-30.0, 30.0, 3))
    radar = replace(radar, receiver=beside)
    points = drawn_points(rng)
    places = place_of(grid, *ImagePlacement(grid, radar).locate(points))
    # tol: points off the plane have no place for all pulses: second order over the aperture
    assert worst_difference(radar, points, places) < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_orbits_place_points_at_their_range_and_azimuth(seed: int) -> None:
    rng = np.random.default_rng([2, seed])
    radar, grid = made(
        rng, orbit_altitude=rng.uniform(450e3, 700e3), incidence_angle_deg=rng.uniform(25.0, 50.0)
    )
    points = drawn_points(rng)
    stopped = radar.start_stop()
    places = place_of(grid, *ImagePlacement(grid, radar).locate(points))
    # tol: at mid-aperture equal but for the curve of the track, a tenth of a millimetre
    assert worst_difference(stopped, points, places) < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_a_recorded_track_that_errs_displaces_the_image(seed: int) -> None:
    rng = np.random.default_rng([3, seed])
    radar, _ = made(rng)
    error = rng.uniform(-3.0, 3.0) * radar.track.along
    radar = replace(radar, recorded=radar.track.moved(error))
    grid = default_grid(radar.as_recorded(), {"extent_azimuth": 60.0, "extent_range": 80.0})
    points = drawn_points(rng)
    azimuth, range_ = ImagePlacement(grid, radar).locate(points)
    true = ImagePlacement(grid, replace(radar, recorded=None)).locate(points)
    assert azimuth - true[0] == pytest.approx(np.full(50, float(error @ radar.track.along)), abs=1e-4)
    assert range_ == pytest.approx(true[1], abs=1e-4)  # tol: Newton's method


def test_a_moving_point_is_displaced_by_its_doppler() -> None:
    rng = np.random.default_rng(5)
    radar, grid = made(rng)
    points = drawn_points(rng)
    speed = 0.7
    motion = Motion.of(velocity=speed * radar.across)
    rest, moved = (ImagePlacement(grid, radar).locate(points, m)[0] for m in (Motion(), motion))
    line = points - radar.track.center_position
    rate = speed * line @ radar.across
    expected = -rate / float(np.linalg.norm(radar.track.velocity[0]))
    assert moved - rest == pytest.approx(expected, rel=2e-3)  # tol: speed of the target over the radar's
