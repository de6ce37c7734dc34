"""Layover, shadow and incidence by geometry against closed forms of boxes and slopes, and against dense sampling."""

import dataclasses
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.analysis.geometric_labels import (
    BOTH,
    LAYOVER,
    NO_SURFACE,
    SHADOW,
    VALID,
    surface_points,
)
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import Labels
from tests.support.draws import few_of
from tests.support.label_truth import UprightBox, expected_masks, sampled

RANGE = 3000.0
TRIANGLES = [[0, 1, 2], [0, 2, 3]]


def radar_of(rng: np.random.Generator, **given: Any) -> RadarDescription:
    """A radar with a drawn heading, side and look angle."""
    usual = {
        "mode": "spotlight",
        "slant_range": RANGE,
        "look_angle_deg": rng.uniform(25.0, 55.0),
        "heading_deg": rng.uniform(-180.0, 180.0),
        "look_side": str(rng.choice(["left", "right"])),
        "bandwidth": 200e6,
        "azimuth_resolution": 1.0,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
    }
    return RadarDescription(**{**usual, **given})


def film_of(grid: str, pixels: tuple[int, int] = (61, 83)) -> FilmDescription:
    return FilmDescription(
        image_grid=grid,
        pixels_azimuth=pixels[0],
        pixels_range=pixels[1],
        pixel_spacing_azimuth=0.8,
        pixel_spacing_range=0.7,
        image_center_x=0.0,
        image_center_y=0.0,
    )


def sheet(corners: object) -> SceneMesh:
    return SceneMesh(np.asarray(corners), TRIANGLES, "soil", "ground")


def across_track(radar: Radar, profile: object, half: float = 200.0) -> F64:
    """Corners of a strip along the track, the same everywhere, through points (across, height) of a profile."""
    points = np.asarray(profile, dtype=np.float64)
    return np.array(
        [
            sign * half * radar.track.along + u * radar.across + [0.0, 0.0, z]
            for u, z in points
            for sign in (-1.0, 1.0)
        ]
    )


def strip(radar: Radar, profile: object) -> SceneMesh:
    corners = across_track(radar, profile)
    faces = [
        [2 * i + a, 2 * i + b, 2 * i + c]
        for i in range(len(corners) // 2 - 1)
        for a, b, c in ((0, 1, 3), (0, 3, 2))
    ]
    return SceneMesh(corners, faces, "soil", "terrain")


def shown_at(radar: Radar, u: F64 | float, z: F64 | float, grid: ImageGrid) -> F64:
    """Range coordinate of a grid at which a point u across from the aim point and z high is shown."""
    base = radar.track.center_position
    ground = float(-base @ radar.across)
    slant = np.hypot(ground + np.asarray(u), base[2] - np.asarray(z))
    if grid.kind == "slant":
        return np.asarray(slant)
    return np.asarray(np.sqrt(slant**2 - base[2] ** 2) - ground - float(grid.origin @ radar.across))


def edges_of(mask: F64, grid: ImageGrid, codes: tuple[int, ...]) -> tuple[float, float]:
    """First and last edge of the middle row's pixels with one of the codes, at the borders of pixels."""
    columns = np.flatnonzero(np.isin(mask[mask.shape[0] // 2], codes))
    return (
        float(grid.range[columns[0]]) - 0.5 * grid.range_spacing,
        float(grid.range[columns[-1]]) + 0.5 * grid.range_spacing,
    )


@pytest.mark.parametrize("grid", ["ground", "slant"])
@pytest.mark.parametrize("seed", few_of(range(6), 2))
def test_layover_and_shadow_of_a_box_end_where_they_must(grid: str, seed: int) -> None:
    r"""A box of height h on the ground between u = a and b.

    Its front wall is laid over :math:`h / \tan\theta` towards the radar, and its shadow is :math:`h \tan\theta` long
    behind it, here with the spherical wavefront: exact for both.
    """
    rng = np.random.default_rng([3, seed])
    description = radar_of(rng, look_angle_deg=rng.uniform(35.0, 50.0))
    bare = build_scene([sheet([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])], radar=description)
    radar = bare.radar
    height, deep = rng.uniform(4.0, 7.0), rng.uniform(3.0, 6.0)
    turn = float(np.arctan2(radar.across[1], radar.across[0]))
    box = UprightBox(np.zeros(2), np.array([deep, 30.0, height]), turn)
    scene = build_scene(
        [
            strip(radar, [(-100.0, 0.0), (100.0, 0.0)]),
            SceneMesh(*box.mesh(), "concrete", "box"),
        ],
        radar=description,
        film=film_of(grid),
    )
    found = sarmitsuba.labels(scene)
    mask = found["layover_shadow"]
    half, where = 0.5 * found.grid.range_spacing, found.grid
    front, back = -0.5 * deep, 0.5 * deep
    begin, end = edges_of(mask, where, (LAYOVER, BOTH))
    # tol: a pixel has the label of its centre, so that an edge lies within half a pixel
    assert begin == pytest.approx(float(shown_at(radar, front, height, where)), abs=half + 0.02)
    assert end == pytest.approx(float(shown_at(radar, front, 0.0, where)), abs=half + 0.02)
    base = radar.track.center_position
    distance = float(-base @ radar.across) + back
    tip = back + height * distance / (base[2] - height)  # by similar triangles
    begin, end = edges_of(mask, where, (SHADOW, BOTH))
    assert begin == pytest.approx(float(shown_at(radar, back, height, where)), abs=half + 0.02)
    assert end == pytest.approx(float(shown_at(radar, tip, 0.0, where)), abs=half + 0.02)
    # the usual lengths for plane waves
    theta = np.arctan(-(base @ radar.across) / base[2])
    if grid == "ground":
        assert tip - back == pytest.approx(
            height * np.tan(theta), rel=0.02
        )  # tol: height and box over the range
        layover = float(shown_at(radar, front, 0.0, where) - shown_at(radar, front, height, where))
        assert layover == pytest.approx(height / np.tan(theta), rel=0.02)
    assert not (mask == NO_SURFACE).any()
    # the shadow is the box's, where it lies on the ground behind it
    dark = found["shadow_of"][mask == SHADOW]
    names = found.layers["shadow_of"].codes
    assert {names[int(code)] for code in np.unique(dark)} == {"box"}


@pytest.mark.parametrize("steeper", [-0.03, 0.03])
@pytest.mark.parametrize("seed", few_of(range(4), 2))
def test_a_slope_is_laid_over_from_the_incidence_angle_on(steeper: float, seed: int) -> None:
    """A ridge whose front is a little flatter, or steeper, than the incidence angle at its middle."""
    rng = np.random.default_rng([5, seed])
    description = radar_of(rng, look_angle_deg=rng.uniform(20.0, 40.0))
    radar = build_scene([sheet([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])], radar=description).radar
    theta = float(np.radians(description.look_angle_deg))
    height = 6.0
    front, back = height / np.tan(theta + steeper), 40.0
    profile = [
        (-100.0, 0.0),
        (-0.5 * front, 0.0),
        (0.5 * front, height),
        (0.5 * front + back, 0.0),
        (100.0, 0.0),
    ]
    found = sarmitsuba.labels(build_scene([strip(radar, profile)], radar=description, film=film_of("ground")))
    mask = found["layover_shadow"]
    # tol: the incidence angle at the ridge, 0.5 front / RANGE < 0.01 rad off that at the middle
    if steeper < 0.0:
        assert (mask == VALID).all()
    else:
        low, high = (float(shown_at(radar, u, z, found.grid)) for u, z in (profile[2], profile[1]))
        inside = (found.grid.range > low) & (found.grid.range < high)
        assert inside.sum() == (mask[mask.shape[0] // 2] == LAYOVER).sum()
        assert (mask[:, inside] == LAYOVER).all() and not (mask == SHADOW).any()
        assert (found["surfaces"][:, inside] == 3).all()


@pytest.mark.parametrize("steeper", [-0.03, 0.03])
@pytest.mark.parametrize("seed", few_of(range(4), 2))
def test_a_slope_away_from_the_radar_is_dark_from_grazing_on(steeper: float, seed: int) -> None:
    """A ridge whose back is a little flatter, or steeper, than the line of sight over its top."""
    rng = np.random.default_rng([7, seed])
    description = radar_of(rng, look_angle_deg=rng.uniform(50.0, 60.0))
    radar = build_scene([sheet([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])], radar=description).radar
    base = radar.track.center_position
    height, front = 6.0, 30.0
    distance = float(-base @ radar.across)
    grazing = float(np.arctan((base[2] - height) / distance))
    back = height / np.tan(grazing + steeper)
    profile = [(-100.0, 0.0), (-front, 0.0), (0.0, height), (back, 0.0), (100.0, 0.0)]
    found = sarmitsuba.labels(build_scene([strip(radar, profile)], radar=description, film=film_of("slant")))
    mask = found["layover_shadow"]
    if steeper < 0.0:
        assert (mask == VALID).all()
    else:
        begin, end = edges_of(mask, found.grid, (SHADOW,))
        tip = height * distance / (base[2] - height)
        half = 0.5 * found.grid.range_spacing
        assert begin == pytest.approx(float(shown_at(radar, 0.0, height, found.grid)), abs=half + 0.02)
        assert end == pytest.approx(float(shown_at(radar, tip, 0.0, found.grid)), abs=half + 0.02)


def test_local_incidence_is_that_of_the_slope() -> None:
    rng = np.random.default_rng(11)
    description = radar_of(rng, look_angle_deg=45.0)
    radar = build_scene([sheet([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])], radar=description).radar
    slope = np.radians(12.0)
    profile = [(-60.0, -60.0 * np.tan(slope)), (60.0, 60.0 * np.tan(slope))]
    found = sarmitsuba.labels(build_scene([strip(radar, profile)], radar=description, film=film_of("slant")))
    angle = found["local_incidence_angle"]
    point = found["surface_position"]
    line = radar.track.center_position - point
    normal = -np.sin(slope) * radar.across + np.array([0.0, 0.0, np.cos(slope)])
    expected = np.arccos(line @ normal / np.linalg.norm(line, axis=-1))
    known = np.isfinite(angle)
    assert known.mean() > 0.9
    assert np.abs(angle - expected)[known].max() < 1e-5  # tol: float32
    # positions are on the slope, at the range and azimuth of the pixel
    u, along = point @ radar.across, point @ radar.track.along
    assert np.abs(point[..., 2] - u * np.tan(slope))[known].max() < 1e-6  # tol: float64 of 3 km
    slant = np.linalg.norm(line - (line @ radar.track.along)[..., None] * radar.track.along, axis=-1)
    # tol: triangles are straight in the image to 0.02 pixels
    assert np.abs(slant - found["slant_position"][..., 1])[known].max() < 0.03 * found.grid.range_spacing
    assert (
        np.abs(along - radar.track.center_position @ radar.track.along - found["slant_position"][..., 0])[
            known
        ].max()
        < 0.03 * found.grid.azimuth_spacing
    )


def _straight(radar: Radar) -> Callable[[F64], F64]:
    """The antenna that looks at points at the middle of their aperture, on a straight track, by its geometry."""
    base, along = radar.track.center_position, radar.track.along

    def antenna(point: F64) -> F64:
        if not np.isfinite(radar.half_aperture):
            return np.broadcast_to(base, point.shape)
        leg = point - base
        ahead = leg @ along
        closest = np.sqrt(np.sum(leg**2, axis=1) - ahead**2)
        boresight = np.broadcast_to(radar.pointing.boresight, radar.track.position.shape)
        pulse = np.unique(np.linspace(0, len(boresight) - 1, 200).astype(int))
        place, sine = (radar.track.position[pulse] - base) @ along, boresight[pulse] @ along
        tangent = sine / np.sqrt(1.0 - sine**2)
        if np.ptp(tangent) == 0.0:
            return base + (ahead - closest * tangent[0])[:, None] * along
        # the pulse whose beam's middle passes the point: its place where this falls through zero
        out = np.zeros(len(point))
        for rows in np.array_split(np.arange(len(point)), 1 + len(point) // 20_000):
            off = ahead[rows, None] - place - closest[rows, None] * tangent
            last = np.clip((off > 0.0).sum(axis=1) - 1, 0, len(place) - 2)
            here, there = (off[np.arange(len(rows)), last + k] for k in (0, 1))
            out[rows] = place[last] + here / (here - there) * (place[last + 1] - place[last])
        return base + out[:, None] * along

    return antenna


MODES = {
    "spotlight": {},
    "squinted spotlight": {"squint_angle_deg": 14.0},
    "stripmap": {"mode": "stripmap", "pattern": "rectangular", "antenna_length": 2.0, "antenna_height": 0.3},
    "sliding spotlight": {
        "mode": "sliding_spotlight",
        "pattern": "rectangular",
        "antenna_length": 2.0,
        "antenna_height": 0.3,
    },
    "squinted stripmap": {
        "mode": "stripmap",
        "squint_angle_deg": -10.0,
        "pattern": "rectangular",
        "antenna_length": 2.0,
        "antenna_height": 0.3,
    },
}


@pytest.mark.parametrize("grid", ["ground", "slant"])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", few_of(range(4)))
def test_drawn_boxes_have_the_masks_of_dense_sampling(mode: str, grid: str, seed: int) -> None:
    rng = np.random.default_rng([17, seed])
    description = radar_of(rng, **MODES[mode])
    boxes = [
        UprightBox(
            rng.uniform(-4.0, 4.0, 2) + shift,
            rng.uniform([4.0, 4.0, 3.0], [9.0, 9.0, 12.0]),
            rng.uniform(0.0, np.pi),
        )
        for shift in ([-12.0, -9.0], [9.0, -11.0], [0.0, 12.0])
    ]
    meshes = [sheet([[-90, -90, 0], [90, -90, 0], [90, 90, 0], [-90, 90, 0]])]
    meshes += [SceneMesh(*box.mesh(), "concrete", f"box {i}") for i, box in enumerate(boxes)]
    scene = build_scene(meshes, radar=description, film=film_of(grid))
    found = sarmitsuba.labels(scene)
    radar, where = scene.radar, found.grid
    truth = sampled(boxes, np.array([[-60.0, -60.0], [60.0, 60.0]]), 0.2, _straight(radar))
    # a straight level track shows points at their azimuth and range of closest approach
    leg = truth.point - radar.track.center_position
    ahead = leg @ radar.track.along
    closest = np.sqrt(np.sum(leg**2, axis=1) - ahead**2)
    row = (
        ahead - (where.origin - radar.track.center_position) @ where.along - where.azimuth[0]
    ) / where.azimuth_spacing
    column = closest
    if grid == "ground":
        drop = radar.track.center_position[2]
        column = np.sqrt(closest**2 - drop**2) - (where.origin - radar.track.center_position) @ where.across
    column = (column - where.range[0]) / where.range_spacing
    mask, sure = expected_masks(truth, row, column, where.shape)
    assert sure.mean() > 0.5
    wrong = found["layover_shadow"][sure] != mask[sure]
    assert {VALID, SHADOW, LAYOVER} <= set(np.unique(mask[sure]))
    assert wrong.mean() == 0.0, f"{100.0 * wrong.mean():.3f} % of the pixels away from edges"


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("grid", ["ground", "slant"])
def test_orbits_have_the_masks_of_range_and_doppler(mode: str, grid: str) -> None:
    """From orbit, against places of the same range and range rate at mid-aperture of a short track."""
    description = RadarDescription(
        mode=mode,
        orbit_altitude=520e3,
        incidence_angle_deg=38.0,
        squint_angle_deg=2.0,
        bandwidth=200e6,
        azimuth_resolution=1.0,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    boxes = [UprightBox(np.array([2.0, -3.0]), np.array([9.0, 8.0, 10.0]), 0.5)]
    meshes = [sheet([[-90, -90, 0], [90, -90, 0], [90, 90, 0], [-90, 90, 0]])]
    meshes += [SceneMesh(*box.mesh(), "concrete", f"box {i}") for i, box in enumerate(boxes)]
    scene = build_scene(meshes, radar=description, film=film_of(grid))
    found = sarmitsuba.labels(scene)
    radar = scene.radar.start_stop()
    pulse = radar.track.center_index
    antenna, velocity = radar.track.position[pulse], radar.track.velocity[pulse]
    truth = sampled(
        boxes,
        np.array([[-60.0, -60.0], [60.0, 60.0]]),
        0.2,
        lambda point: np.broadcast_to(antenna, point.shape),
    )

    def state(point: F64) -> F64:
        line = point - antenna
        distance = np.linalg.norm(line, axis=-1)
        return np.stack([distance - np.linalg.norm(antenna), line @ velocity / distance], axis=-1)

    # a cubic through the states of all pixels gives their numbers
    places = found.grid.in_frame(scene.offset).positions()
    pixel = np.stack(np.meshgrid(*(np.arange(n) for n in found.grid.shape), indexing="ij"), axis=-1)
    known = state(places).reshape(-1, 2)
    middle, scale = known.mean(axis=0), np.ptp(known, axis=0)

    def terms(states: F64) -> F64:
        a, b = ((states - middle) / scale).T
        return np.stack([a**i * b**j for i in range(4) for j in range(4 - i)], axis=-1)

    fit = np.linalg.lstsq(terms(known), pixel.reshape(-1, 2), rcond=None)[0]
    assert np.abs(terms(known) @ fit - pixel.reshape(-1, 2)).max() < 0.01  # tol: next order
    row, column = (terms(state(truth.point)) @ fit).T
    mask, sure = expected_masks(truth, row, column, found.grid.shape)
    assert sure.mean() > 0.5 and {VALID, SHADOW, LAYOVER} <= set(np.unique(mask[sure]))
    assert (found["layover_shadow"][sure] == mask[sure]).all()


def _plain(**mesh: Any) -> Scene:
    ground = sheet([[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]])
    box = UprightBox(np.zeros(2), np.array([6.0, 6.0, 4.0]), 0.3)
    return build_scene(
        [ground, SceneMesh(*box.mesh(), "concrete", "box", **mesh)],
        radar=radar_of(np.random.default_rng(1)),
        film=film_of("ground"),
    )


@pytest.mark.parametrize("seed", few_of(range(4)))
def test_a_shape_smaller_than_a_pixel_is_in_the_pixel_of_its_middle(seed: int) -> None:
    rng = np.random.default_rng([23, seed])
    corners = rng.uniform(-0.03, 0.03, (4, 3)) + rng.uniform(-8.0, 8.0, 3)
    scene = build_scene(
        [SceneMesh(corners, TRIANGLES, "pec", "chip")], radar=radar_of(rng), film=film_of("slant")
    )
    found = sarmitsuba.labels(scene)
    (at,) = np.argwhere(found["shape"] == 1)
    assert (found["surfaces"] > 0).sum() == 1
    radar = scene.radar
    leg = corners.mean(axis=0) - radar.track.center_position
    ahead = leg @ radar.track.along
    assert found.grid.azimuth[at[0]] == pytest.approx(ahead, abs=0.5 * found.grid.azimuth_spacing + 0.05)
    closest = np.sqrt(leg @ leg - ahead**2)
    # tol: half a pixel, and the size of the shape
    assert found.grid.range[at[1]] == pytest.approx(closest, abs=0.5 * found.grid.range_spacing + 0.05)


def test_a_moving_box_is_shown_beside_its_place() -> None:
    """A target that comes nearer by v is displaced by v R / V along the track."""
    rest, speed = _plain(), 0.4
    scene = _plain(motion=Motion.of(velocity=speed * rest.radar.across))
    rows = []
    for one in (rest, scene):
        grid = sarmitsuba.labels(one).grid
        found = surface_points(one, grid)
        roof = found.seen & (found.found.point[:, 2] > 3.99)
        rows.append((found.found.pixel[roof] // grid.shape[1]).mean() * grid.azimuth_spacing)
    line = scene.radar.aim_point - scene.radar.track.center_position
    rate = speed * float(scene.radar.across @ line) / float(np.linalg.norm(line))
    shift = -rate * float(np.linalg.norm(line)) / float(np.linalg.norm(scene.radar.track.velocity[0]))
    assert rows[1] - rows[0] == pytest.approx(shift, abs=0.8)  # tol: a pixel


@pytest.mark.parametrize("pixels", [(1, 1), (1, 9), (7, 1), (3, 4)])
def test_images_of_few_pixels_agree_with_the_whole(pixels: tuple[int, int]) -> None:
    scene = _plain()
    whole = sarmitsuba.labels(scene)
    rows, columns = (slice(20, 20 + pixels[0]), slice(30, 30 + pixels[1]))
    grid = dataclasses.replace(whole.grid, azimuth=whole.grid.azimuth[rows], range=whole.grid.range[columns])
    few = sarmitsuba.labels(scene, grid)
    # tol: pixels' spacing counts where shapes smaller than a pixel are, and there are none
    for name in ("layover_shadow", "surfaces", "shape"):
        np.testing.assert_array_equal(few[name], whole[name][rows, columns])


def test_threads_label_alike() -> None:
    scene, found = _plain(), []
    threads = [threading.Thread(target=lambda: found.append(sarmitsuba.labels(scene))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    first: Labels = found[0]
    assert len(found) == 3
    for other in found[1:]:
        for name in first.layers:
            np.testing.assert_array_equal(first[name], other[name])


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # pixels wider than the cell of a circle
def test_what_cannot_be_labelled_is_said() -> None:
    scene = _plain()
    with pytest.raises(DataError, match="opposite sides"):
        sarmitsuba.labels(scene.replace(mode="circular", arc_deg=360.0, azimuth_resolution=0.0))
    with pytest.raises(DataError, match=r"no shape \"bxo\".*did you mean.*box"):
        sarmitsuba.labels(scene, classes={"bxo": "building"})
    found = sarmitsuba.labels(scene)
    with pytest.raises(DataError, match='no layer "mask"'):
        found["mask"]
