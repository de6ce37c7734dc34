"""WGS-84 conversions against published values, and the anchor of the file's frame through scenes and files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from sarmitsuba import read_image, read_raw, write_image, write_raw
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.geodesy import Anchor, ecef_of_geodetic, geodetic_of_ecef
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.simulation.execution.render import simulate
from tests.support.unweighted import focus


def degrees(whole: float, minutes: float, seconds: float) -> float:
    return whole + minutes / 60.0 + seconds / 3600.0


# IOGP Publication 373-7-2 (EPSG Guidance Note 7, part 2): examples of methods 9602 and 9837
NORTH_SEA = np.array([np.radians(degrees(53.0, 48.0, 33.820)), np.radians(degrees(2.0, 7.0, 46.380)), 73.0])


def test_earth_centred_positions_are_the_published_ones() -> None:
    published = np.array([3771793.968, 140253.342, 5124304.349])
    # tol: the published angles end at 1 ms of arc, 15 mm on the ground
    assert np.abs(ecef_of_geodetic(NORTH_SEA) - published).max() < 0.02
    back = geodetic_of_ecef(published)
    assert np.abs(back[:2] - NORTH_SEA[:2]).max() * 6.4e6 < 0.02
    assert abs(back[2] - 73.0) < 0.02


def test_topocentric_positions_are_the_published_ones() -> None:
    local = Anchor.of_degrees(55.0, 5.0, 200.0).from_geodetic(NORTH_SEA)
    assert np.abs(local - [-189013.869, -128642.040, -4220.171]).max() < 0.02  # tol: as above


def test_round_trips_of_drawn_points() -> None:
    rng = np.random.default_rng(7)
    n = 3000
    anchor = Anchor(float(rng.uniform(-1.5, 1.5)), float(rng.uniform(-3.0, 3.0)), 430.0)
    points = rng.uniform(-1.0, 1.0, (n, 3)) * 10.0 ** rng.uniform(0.0, 6.0, (n, 1))
    # tol: the issue's; rounding is a few nanometres
    assert np.abs(anchor.from_geodetic(anchor.to_geodetic(points)) - points).max() < 1e-6
    assert np.abs(anchor.from_ecef(anchor.to_ecef(points)) - points).max() < 1e-6
    # the poles and the date line, up to geostationary height
    latitude = np.concatenate([rng.uniform(-0.5, 0.5, n) * np.pi, [0.5 * np.pi, -0.5 * np.pi, 0.0]])
    longitude = np.concatenate([rng.uniform(-1.0, 1.0, n) * np.pi, [0.0, 0.0, np.pi]])
    height = rng.uniform(-1e4, 4e7, n + 3)
    position = ecef_of_geodetic(np.stack([latitude, longitude, height], axis=1))
    back = geodetic_of_ecef(position)
    assert np.abs(back[:, 0] - latitude).max() < 1e-14
    assert np.abs(back[:, 2] - height).max() < 1e-6
    assert np.abs(ecef_of_geodetic(back) - position).max() < 1e-6


def test_axes_are_the_derivatives_of_the_position() -> None:
    place = np.array([0.83, -2.1, 512.0])
    step = np.array([1e-6, 1e-6, 1.0])
    moved = [(ecef_of_geodetic(place + d) - ecef_of_geodetic(place - d)) for d in np.diag(step)]
    north, east, up = (d / np.linalg.norm(d) for d in moved)
    # tol: differences over 13 m of positions good to 1e-9 m
    assert np.abs(Anchor(*place).axes - [east, north, up]).max() < 1e-8


def orbit(**changes: float | str) -> RadarDescription:
    given = RadarDescription(
        mode="spotlight",
        orbit_altitude=514e3,
        latitude_deg=48.1,
        longitude_deg=11.6,
        height=520.0,
        azimuth_resolution=3.0,
        bandwidth=50e6,
    )
    return replace(given, **changes)  # type: ignore[arg-type]


def test_the_anchor_is_that_of_the_files_frame_wherever_the_scene_has_its_own() -> None:
    place = np.array([8000.0, -3000.0, 40.0])
    scene = build_scene(points=[PointTarget("far", place, 1.0)], radar=orbit())
    assert scene.offset.any()
    assert scene.anchor == Anchor.of_degrees(48.1, 11.6, 520.0)
    track = scene.radar.track
    line = scene.points[0].position - track.center_position
    incidence = np.degrees(np.arccos(-line[2] / np.linalg.norm(line)))
    assert incidence == pytest.approx(35.0, abs=1e-4)  # tol: mid-aperture lies between two pulses
    in_file = scene.radar.in_file_frame()
    assert in_file.anchor == scene.anchor
    radius = np.linalg.norm(scene.anchor.to_ecef(in_file.track.position), axis=1)
    assert np.abs(radius - (6378137.0 + 514e3)).max() < 1e-6


def test_the_anchor_goes_with_data_images_and_their_files(tmp_path: Path) -> None:
    scene = build_scene(points=[PointTarget("far", np.array([8000.0, 0.0, 0.0]), 1.0)], radar=orbit())
    raw = simulate(scene)
    assert raw.anchor == scene.anchor
    write_raw(raw, tmp_path / "raw.h5")
    read = read_raw(tmp_path / "raw.h5")
    assert read.anchor == scene.anchor
    image = focus(read, request={"extent_azimuth": 40.0, "extent_range": 40.0})
    assert image.anchor == scene.anchor
    write_image(image, tmp_path / "image.h5")
    assert read_image(tmp_path / "image.h5").anchor == scene.anchor
    write_image(image, tmp_path / "image.exr")
    header = OpenEXR.File(str(tmp_path / "image.exr")).header()
    assert np.allclose(header["anchor"], [48.1, 11.6, 520.0], rtol=0.0, atol=1e-12)
    # a grid from elsewhere stands where the data do
    bare = replace(default_grid(raw, {"extent_azimuth": 20.0, "extent_range": 20.0}), anchor=Anchor())
    assert focus(raw, bare).anchor == scene.anchor
    # the image's middle is the point, 8 km east of the anchor
    middle = image.grid.geodetic()[image.grid.shape[0] // 2, image.grid.shape[1] // 2]
    assert np.abs(scene.anchor.from_geodetic(middle) - [8000.0, 0.0, 0.0]).max() < 1e-6
