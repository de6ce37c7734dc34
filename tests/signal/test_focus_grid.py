"""The default grid: where its pixels stand and how fine it is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing.aperture_weights import ground_cell_area, matched_weights
from sarmitsuba.signal.focusing.grid import default_grid, natural_spacing
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from tests.support.unweighted import focus


def request(**changes: Any) -> ImageRequest:
    base = ImageRequest(center_x=12.0, center_y=-7.0, height=3.0, extent_azimuth=60.0, extent_range=40.0)
    return replace(base, **changes)


@pytest.mark.parametrize("kind", ["slant", "ground"])
@pytest.mark.parametrize("squint", [0.0, 0.3])
def test_a_pixel_stands_at_the_centre_and_the_extent_is_covered(kind: str, squint: float) -> None:
    radar = ideal_radar(squint_angle=squint, n_samples=64)
    grid = default_grid(radar, request(grid=kind))
    positions = grid.positions()
    distance = np.linalg.norm(positions - np.array([12.0, -7.0, 3.0]), axis=-1)
    assert distance.min() < 1e-6  # tol: rounding of a square root at 10 km
    x, y = positions[..., 0], positions[..., 1]
    assert x.min() <= 12.0 - 20.0 + 1e-6 and x.max() >= 12.0 + 20.0 - 1e-6
    assert y.min() <= -7.0 - 30.0 + 1e-6 and y.max() >= -7.0 + 30.0 - 1e-6
    assert (np.diff(grid.azimuth) > 0).all() and (np.diff(grid.range) > 0).all()


def test_spacing_is_half_a_cell_and_can_be_given() -> None:
    radar = ideal_radar(resolution=1.0, n_samples=64)
    grid = default_grid(radar, request())
    assert grid.azimuth_spacing == pytest.approx(0.5, rel=0.01)  # tol: whole number of pulses
    assert grid.range_spacing == pytest.approx(0.5 * radar.waveform.range_cell, rel=1e-9)
    given = default_grid(radar, request(spacing_azimuth=0.25, spacing_range=0.3))
    assert (given.azimuth_spacing, given.range_spacing) == pytest.approx((0.25, 0.3))


def test_squint_needs_finer_pixels() -> None:
    plain = natural_spacing(ideal_radar(bandwidth=600e6), np.zeros(3), "slant")
    turned = natural_spacing(ideal_radar(bandwidth=600e6, squint_angle=0.8), np.zeros(3), "slant")
    # the band of 600 MHz, seen along the track: 2 pi / spacing must span it
    band = 4 * np.pi * 600e6 / SPEED_OF_LIGHT * np.sin(0.8)
    assert turned[0] < 2 * np.pi / band
    assert turned[0] < 0.6 * plain[0]


def test_request_may_come_with_the_data_or_not_at_all() -> None:
    raw = ideal_echoes(ideal_radar(n_samples=128), np.zeros(3))
    asked = default_grid(replace(raw, request=request()))
    np.testing.assert_array_equal(asked.azimuth, default_grid(raw, request()).azimuth)
    own = default_grid(raw)
    r = np.linalg.norm(own.positions()[own.shape[0] // 2] - raw.radar.track.center_position, axis=-1)
    window = raw.radar.window
    assert (r > window.start_range.min()).all() and (r < window.start_range.max() + window.extent).all()


def test_a_grid_in_another_frame_means_the_same_pixels() -> None:
    raw = ideal_echoes(ideal_radar(n_samples=128), np.array([1.0, 2.0, 0.0]))
    offset = np.array([456789.0, 5600123.0, 512.0])
    moved = replace(raw, radar=replace(raw.radar, offset=offset))
    grid = default_grid(moved)
    np.testing.assert_array_equal(grid.offset, offset)
    outside = grid.in_frame(np.zeros(3))
    np.testing.assert_allclose(
        outside.positions(), grid.positions() + offset, rtol=0, atol=1e-8
    )  # tol: float64
    image = focus(moved, outside)
    # tol: phase of 1e-9 m, the rounding of float64 at 5600 km
    np.testing.assert_allclose(image.data, focus(moved, grid).data, rtol=0, atol=1e-5)
    np.testing.assert_allclose(image.data, focus(raw).data, rtol=0, atol=1e-5)


def test_data_in_the_frame_of_a_far_file_focus_to_the_same_image() -> None:
    raw = ideal_echoes(ideal_radar(n_samples=128), np.array([1.0, 2.0, 0.0]))
    offset = np.array([456789.0, 5600123.0, 512.0])
    far = replace(raw, radar=replace(raw.radar, offset=offset).in_file_frame())
    assert far.radar.aim_point[1] > 5e6
    # tol: as above
    np.testing.assert_allclose(focus(far).data, focus(raw).data, rtol=0, atol=1e-5)


def test_impossible_grids_are_refused() -> None:
    radar = ideal_radar(n_samples=64)
    with pytest.raises(DataError, match="on the side it does not look to"):
        default_grid(radar, request(center_x=-2e4))
    with pytest.raises(DataError, match="spacings"):
        default_grid(radar, request(spacing_range=-1.0))
    with pytest.raises(DataError, match="outside the receive window"):
        default_grid(replace(radar, aim_point=np.array([900.0, 0.0, 0.0])))


def test_cell_area_is_the_product_of_the_cells_for_a_plain_geometry() -> None:
    radar = ideal_radar(resolution=2.0, n_samples=64)
    weights = matched_weights(radar, np.zeros(3))
    area = ground_cell_area(radar, np.zeros(3), weights, "rectangular")
    n = radar.track.n_pulses
    length = n * np.linalg.norm(radar.track.position[1] - radar.track.position[0])
    azimuth = radar.waveform.wavelength * 10e3 / (2.0 * length)
    plain = azimuth * radar.waveform.range_cell / np.sin(np.pi / 4)
    assert area == pytest.approx(plain, rel=1e-3)  # tol: curvature of the aperture, (L / R)^2


def test_one_pulse_is_no_aperture() -> None:
    radar = ideal_radar(n_samples=64)
    one = replace(radar, track=radar.track.of_pulses(slice(0, 1)))
    with pytest.raises(DataError, match="1 pulse gives no synthetic aperture"):
        ground_cell_area(one, np.zeros(3), np.ones(1), "rectangular")


@pytest.mark.parametrize("north", [440.0, 940.0])  # nearer than half the scene's bound on offsets, and beyond
@pytest.mark.parametrize("whole", [True, False])
def test_a_request_counts_in_the_frame_of_the_users_file(north: float, whole: bool) -> None:
    """The frame of the data moves with the scene; a request by hand knows nothing of it, for any of its fields."""
    place = np.array([30.0, north, 5.0])
    scene = build_scene(
        points=[PointTarget("a", place, 4.0)],
        radar=RadarDescription(mode="spotlight", slant_range=5e3, bandwidth=60e6, azimuth_resolution=2.0),
        film=FilmDescription(image_extent_azimuth=60.0, image_extent_range=60.0),
    )
    assert (np.abs(scene.radar.offset[1] - north) < 1.0) == (north > 500.0)
    raw = replace(ideal_echoes(scene.radar, place - scene.radar.offset, 4.0), request=scene.image)
    asked: dict[str, Any] = {"grid": "ground", "extent_azimuth": 20.0, "extent_range": 30.0, "height": 5.0}
    asked |= {"center_x": 30.0, "center_y": north}
    image = focus(raw, request=ImageRequest(**asked) if whole else asked)
    middle = image.rcs()[image.grid.shape[0] // 2, image.grid.shape[1] // 2]
    assert middle == pytest.approx(4.0, rel=1e-3)  # tol: the window's cut of the point's side lobes
    assert image.grid.in_frame(np.zeros(3)).origin == pytest.approx(place)
    # the scene's own request, in whatever frame, is the data's
    np.testing.assert_array_equal(focus(raw, request=scene.image).data, focus(raw).data)
    assert scene.image.as_dict()["center_y"] == pytest.approx(north)
