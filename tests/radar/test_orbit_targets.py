"""Traced targets from orbit: where they are and how bright, by automatic settings; and what an anchor alone changes."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import image_quality
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.orbit import OrbitRequest, circular_orbit
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from tests.support.draws import few_of
from tests.support.unweighted import render

MIDDLE = np.array([11.3, -7.9, 2.0])


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # one lone plate: a dark image
@pytest.mark.parametrize("seed", few_of(range(3)))
def test_a_plate_that_faces_the_satellite(seed: int) -> None:
    """A square of 1 m square to the line of sight, on a drawn pass.

    Its return falls off over the aperture as sinc(2 sin(a) / lambda), a the angle from mid-aperture, and the
    aperture of an azimuth cell of 2 m spans 2 sin(a) / lambda = -1/4 ... 1/4.
    """
    rng = np.random.default_rng([41, seed])
    wanted = OrbitRequest(
        altitude=rng.uniform(450e3, 700e3),
        inclination=np.radians(97.5),
        incidence_angle=np.radians(rng.uniform(20.0, 55.0)),
        squint_angle=np.radians(rng.uniform(-3.0, 3.0)),
        ascending=bool(rng.integers(2)),
        look_side=("left", "right")[rng.integers(2)],
    )
    latitude, longitude = rng.uniform(-60.0, 60.0), rng.uniform(-180.0, 180.0)
    antenna = circular_orbit(wanted, Anchor.of_degrees(latitude, longitude), np.zeros(3)).states(np.zeros(1))[
        0
    ][0]
    normal = (antenna - MIDDLE) / np.linalg.norm(antenna - MIDDLE)
    first = np.cross(normal, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    corners = MIDDLE + 0.5 * np.array([-first - second, first - second, first + second, second - first])
    scene = build_scene(
        [SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], "pec")],
        radar=RadarDescription(
            mode="spotlight",
            orbit_altitude=wanted.altitude,
            orbit_inclination_deg=97.5,
            orbit_pass="ascending" if wanted.ascending else "descending",
            look_side=wanted.look_side,
            incidence_angle_deg=float(np.degrees(wanted.incidence_angle)),
            squint_angle_deg=float(np.degrees(wanted.squint_angle)),
            latitude_deg=latitude,
            longitude_deg=longitude,
            bandwidth=100e6,
            azimuth_resolution=2.0,
            aim_x=0.0,
            aim_y=0.0,
            aim_z=0.0,
        ),
        film=FilmDescription(
            image_grid="ground",
            image_extent_azimuth=80.0,
            image_extent_range=80.0,
            image_center_x=0.0,
            image_center_y=0.0,
            image_height=2.0,
        ),
    )
    image = render(scene)
    found = point_target_in(image)
    line = MIDDLE - image.grid.origin
    cells = [
        (found.azimuth_position - line @ image.grid.along) / image.azimuth_resolution_cell,
        (found.range_position - line @ image.grid.across) / image.range_resolution_cell,
    ]
    assert np.abs(cells).max() < 0.02  # tol: interpolation of the peak; the is 0.1
    wavelength = scene.radar.waveform.wavelength
    sine = np.linspace(-0.125, 0.125, 501) * wavelength
    expected = float(theory.plate_amplitude(1.0, 1.0, wavelength, sine).mean()) ** 2
    # tol: gridding at width 4, and the band's fall-off of 1 %
    assert 10.0 * np.log10(found.rcs / expected) == pytest.approx(0.0, abs=0.05)


def test_an_anchor_alone_changes_nothing() -> None:
    radar = RadarDescription(slant_range=5e3, azimuth_resolution=2.0, bandwidth=75e6)
    point = PointTarget("point", np.array([3.0, 4.0, 0.0]), 1.0)
    here, there = (
        simulate(build_scene(points=[point], radar=each))
        for each in (radar, replace(radar, latitude_deg=48.0, longitude_deg=11.0, height=500.0))
    )
    assert np.array_equal(here.data, there.data)
    assert here.anchor != there.anchor


@pytest.mark.parametrize(
    "mode",
    ["spotlight", *(pytest.param(m, marks=pytest.mark.slow) for m in ("stripmap", "sliding_spotlight"))],
)
def test_quality_finds_points_of_a_squinted_orbit_in_place_and_phase(mode: str) -> None:
    """Points on the ground and above it, passes drawn: seen from the scene a satellite climbs or sinks.

    A carrier of a level flight is up to half a turn a pixel off, and puts points above the ground beside their places.
    """
    rng = np.random.default_rng([43, len(mode)])
    for _ in range(2):
        places = np.column_stack([rng.uniform(-9.0, 9.0, (2, 2)), [0.0, rng.uniform(10.0, 25.0)]])
        radar = RadarDescription(
            mode=mode,
            orbit_altitude=rng.uniform(450e3, 700e3),
            orbit_pass=("ascending", "descending")[rng.integers(2)],
            look_side=("left", "right")[rng.integers(2)],
            incidence_angle_deg=rng.uniform(25.0, 50.0),
            squint_angle_deg=rng.uniform(-2.5, 2.5),
            latitude_deg=rng.uniform(-60.0, 60.0),
            pattern="rectangular",
            antenna_length=4.8,
            elevation_beamwidth_deg=2.0,
            bandwidth=100e6,
            azimuth_resolution=4.0 if mode == "stripmap" else 1.5,
            aim_x=0.0,
            aim_y=0.0,
            aim_z=0.0,
        )
        film = FilmDescription(image_extent_azimuth=160.0, image_extent_range=80.0, image_height=0.0)
        points = [PointTarget(f"{z:.0f}", np.array([x, y, z]), 10.0) for x, y, z in places]
        image = render(build_scene(points=points, radar=radar, film=film))
        found = image_quality(image).points
        assert len(found) == 2
        for point in found:
            assert (
                abs(point.azimuth_error) < 0.01 * image.azimuth_resolution_cell
            )  # tol: the peak's interpolation
            assert abs(point.range_error) < 0.01 * image.range_resolution_cell
        # tol: the other point's side lobes, 3e-2 at most
        assert abs(found[0].phase_error) < np.radians(3.0)
