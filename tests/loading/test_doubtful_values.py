"""Values that look like a mistake of units are said in one line each, and no shipped scene or radar raises an alarm."""

import importlib.util
import warnings
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.loading.library import list_radars, list_scenes
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.builder import build_radar
from sarmitsuba.radar.description import RadarDescription, RadarInput
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.image_request import Extent
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.mesh.model_units import doubtful_unit, up_axis
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.planning.sampling.density_plan import azimuth_cell

SMALL = Extent.of_box(np.array([-5.0, -5.0, 0.0]), np.array([5.0, 5.0, 5.0]))


def said(
    radar: RadarDescription, film: FilmDescription | None = None, track: Track | None = None
) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        build_radar(RadarInput.of(radar, film or FilmDescription(), track), SMALL)
    assert all(issubclass(w.category, SarmitsubaWarning) and "\n" not in str(w.message) for w in caught)
    return [str(w.message) for w in caught]


def test_a_look_angle_in_radians() -> None:
    (line,) = said(RadarDescription(look_angle_deg=0.6))
    assert "look_angle_deg = 0.6 deg looks straight down; if it is meant in radians, give 34.38" in line
    assert said(RadarDescription(look_angle_deg=10.0)) == []


def test_a_slant_range_in_kilometres() -> None:
    wide = Extent.of_box(np.array([-40.0, -30.0, 0.0]), np.array([40.0, 30.0, 5.0]))
    with pytest.warns(
        SarmitsubaWarning, match=r"slant_range = 10 m .* 80 m wide; .* in km, give 10000"
    ) as caught:
        build_radar(RadarInput.of(RadarDescription(slant_range=10.0), FilmDescription()), wide)
    assert len(caught) == 1
    assert said(RadarDescription(slant_range=10.0)) == []  # a scene of 10 m


def test_pixels_wider_than_the_cell() -> None:
    # 300 MHz: 0.5 m in slant range, 0.71 m on the ground at 45 deg
    lines = said(
        RadarDescription(azimuth_resolution=1.0),
        FilmDescription(pixel_spacing_azimuth=2.0, pixel_spacing_range=0.6),
    )
    assert len(lines) == 2 and "pixel_spacing_azimuth = 2 m" in lines[0] and "pixel_spacing_range" in lines[1]
    assert "is wider than the resolution cell of 0.4997 m" in lines[1]
    fine = FilmDescription(pixel_spacing_azimuth=0.9, pixel_spacing_range=0.6, image_grid="ground")
    assert said(RadarDescription(azimuth_resolution=1.0), fine) == []


def test_a_track_in_degrees(tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 200)
    degrees = np.stack([11.50 + 0 * time, 48.10 + 0.001 * (time - 0.5), 5000.0 + 0 * time], axis=1)
    lines = said(RadarDescription(), track=Track.from_samples(time, degrees))
    assert (
        sum("moves at 0.001 m/s at a height of 5000 m: are x and y longitude" in line for line in lines) == 1
    )
    # along a runway, and on rails beside a slope
    metres = np.stack([-3000.0 + 0 * time, 100.0 * (time - 0.5), 5000.0 + 0 * time], axis=1)
    rail = np.stack([-30.0 + 0 * time, 0.1 * (time - 0.5), 8.0 + 0 * time], axis=1)
    for positions in (metres, rail):
        assert not any(
            "longitude" in x for x in said(RadarDescription(), track=Track.from_samples(time, positions))
        )


def box(size: tuple[float, float, float], x: float = 0.0) -> np.ndarray:
    """(12, 3, 3) triangles of a box that stands on z = 0."""
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float) * size
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return corner[np.array(faces)] + np.array([x, 0.0, 0.0])


def terrain(size: float, relief: float, n: int = 40) -> np.ndarray:
    """(m, 3, 3) triangles of mountains."""
    rng = np.random.default_rng(1)
    axis = np.linspace(0.0, size, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = relief * np.abs(np.sin(5 * x / size) * np.cos(4 * y / size)) + 0.05 * relief * rng.random((n, n))
    p = np.stack([x, y, z], axis=-1)
    one = np.stack([p[:-1, :-1], p[1:, :-1], p[1:, 1:]], axis=2)
    two = np.stack([p[:-1, :-1], p[1:, 1:], p[:-1, 1:]], axis=2)
    return np.concatenate([one.reshape(-1, 3, 3), two.reshape(-1, 3, 3)])


def test_models_in_millimetres() -> None:
    house = np.concatenate([box((12.0, 8.0, 9.0)), box((40.0, 30.0, 0.1), -10.0)])
    assert doubtful_unit(house) == ""
    assert "walls of 9000 m" in doubtful_unit(1000.0 * house)
    # a car made of small triangles: none of its panels is 1 km high
    car = np.concatenate(
        [box((1.8, 0.2, 0.2)) + np.array([0.0, 0.2 * i, 0.2 * k]) for i in range(20) for k in range(7)]
    )
    assert doubtful_unit(car) == ""
    assert "1400 m high" in doubtful_unit(1000.0 * car)
    # true metres: mountains, and the tallest tower on a plain
    assert doubtful_unit(terrain(8000.0, 2500.0)) == ""
    tower = np.concatenate([box((60.0, 60.0, 830.0)), box((3000.0, 3000.0, 0.1))])
    assert doubtful_unit(tower) == ""
    with pytest.warns(SarmitsubaWarning, match=r"the geometry is not in metres, it has walls of 9000 m"):
        triangles = 1000.0 * box((12.0, 8.0, 9.0))
        mesh = SceneMesh(triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), "concrete")
        build_scene(
            [mesh], radar=RadarDescription(slant_range=1e5), film=FilmDescription(image_extent_limit=100.0)
        )


def test_up_axis_of_models() -> None:
    house = np.concatenate([box((12.0, 8.0, 9.0)), box((40.0, 30.0, 0.1), -10.0)])
    assert up_axis(house) == 2
    assert up_axis(house[:, :, [1, 2, 0]]) == 1  # z to y
    assert up_axis(box((12.0, 8.0, 9.0))) == 2  # a box alone says nothing


def sionna() -> list[Path]:
    spec = importlib.util.find_spec("sionna")
    places = spec.submodule_search_locations if spec else None
    return sorted(path for place in places or () for path in Path(place).glob("rt/scenes/*/*.xml"))


# seconds to load, under each radar
LARGE = {
    *("street_trees", "forest", "urban_block_trees"),
    *(
        "simple_street_canyon",
        "simple_street_canyon_with_cars",
        "etoile",
        "box_two_screens",
        "box_knife",
        "triple_reflector",
    ),
}


def slow_if_large(name: str) -> list[pytest.MarkDecorator]:
    return [pytest.mark.slow] if name in LARGE else []


@pytest.mark.parametrize(
    "name", [pytest.param(entry.name, marks=slow_if_large(entry.name)) for entry in list_scenes()]
)
def test_no_alarm_on_shipped_scenes(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings(
            "ignore", ".*ITU-R P.2040 gives", SarmitsubaWarning
        )  # ground at Ku band: that is so
        # every scene under every third radar, every radar over scenes; under their own: test_scene_loader.py
        for radar in list_radars()[sum(name.encode()) % 3 :: 3]:
            load_scene(name, radar=radar.name)


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=slow_if_large(path.stem)) for path in sionna()],
    ids=lambda path: path.stem,
)
def test_no_alarm_on_scenes_of_sionna(path: Path) -> None:
    if path.stat().st_size > 500_000:
        pytest.skip("its size says nothing more, and it takes seconds to load")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*ITU-R P.2040 gives", SarmitsubaWarning)
        warnings.filterwarnings("ignore", ".*of round metal", SarmitsubaWarning)  # domes are faceted
        for radar in list_radars()[sum(path.stem.encode()) % 3 :: 3]:
            scene = load_scene(path, radar=radar.name)
            image, bounds = scene.image, scene.geometry.bounds
            middle = 0.5 * (bounds[0] + bounds[1])[:2]
            center = np.array([image.center_x, image.center_y])
            # the image lies on the scene and is not much larger than it needs
            assert np.abs(center - middle).max() < 0.5 * scene.geometry.diameter + 1.0
            assert image.extent_azimuth <= 3.0 * scene.geometry.diameter + max(
                200.0, 50.0 * azimuth_cell(scene)
            )


ONE = [PointTarget("p", np.zeros(3))]


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("apart", [31.0, 11.0])
def test_predicted_azimuth_ghosts_are_there(mode: str, apart: float) -> None:
    """One point in an image of 100 m: every ghost has the energy of the point, and lies a step of the prf away."""
    wavelength, speed = 299792458.0 / 9.6e9, 100.0
    prf = 2.0 * speed / wavelength * apart / 10e3
    radar = RadarDescription(mode=mode, n_pulses=24, prf=prf)
    film = FilmDescription(image_extent_azimuth=100.0, image_extent_range=60.0)
    with pytest.warns(SarmitsubaWarning, match="azimuth ghosts") as caught:
        scene = build_scene((), ONE, radar=radar, film=film)
    (line,) = (str(w.message) for w in caught)
    predicted = 0.01 * float(line.split("about ")[1].split(" %")[0])
    assert float(line.split("azimuth ghosts ")[1].split(" m")[0]) == pytest.approx(
        apart, rel=0.01
    )  # tol: cosines
    with pytest.warns(SarmitsubaWarning, match="leaves a ghost"):
        raw = simulate(scene)
    assert isinstance(raw, RawData)
    image = focus(raw, azimuth_window="taylor", range_window="taylor")
    power = image.rcs().sum(axis=1)
    own = np.abs(image.grid.azimuth) < 0.5 * apart
    ghosts = power[~own].sum() / power.sum()
    # tol: the ghosts' side lobes reach over the image's rim, and range migration smears them
    assert ghosts == pytest.approx(predicted, abs=0.05)
    assert predicted > 0.6


def test_a_prf_that_is_enough_is_not_blamed() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_scene(
            (),
            ONE,
            radar=RadarDescription(mode="spotlight"),
            film=FilmDescription(image_extent_azimuth=100.0),
        )


def test_a_beam_that_is_too_wide_for_the_prf() -> None:
    beam = {"pattern": "gaussian", "azimuth_beamwidth_deg": 2.0, "elevation_beamwidth_deg": 20.0}
    film = FilmDescription(image_extent_azimuth=300.0, image_extent_range=100.0)
    # half of what the beam's main lobe needs
    lines = said(RadarDescription(azimuth_resolution=1.0, prf=60.0, **beam), film)
    assert len(lines) == 1 and "azimuth ghosts" in lines[0]
    assert said(RadarDescription(azimuth_resolution=1.0, **beam), film) == []
