"""Points and bodies at drawn places in the modes that move the beam, from automatic settings."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import FilmDescription, RadarDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.mesh.tessellate import cube
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.chain import bandwidth, chain, make_scene
from tests.support.unweighted import focus

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY


def axes(radar) -> tuple[np.ndarray, np.ndarray]:
    return radar.track.along, radar.across


@pytest.mark.parametrize(
    "mode", [pytest.param("stripmap", marks=pytest.mark.slow), "sliding_spotlight", "spotlight"]
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_width_of_points_all_over_the_image(mode: str, seed: int) -> None:
    # rows near both ends, off mid-swath, at any heading, side and squint: each as wide as its own aperture says
    rng = np.random.default_rng([seed, 15])
    antenna, factor, slant = rng.uniform(1.5, 2.5), rng.uniform(0.3, 0.7), rng.uniform(1500.0, 2500.0)
    heading, look = np.radians(rng.uniform(-180.0, 180.0)), np.radians(rng.uniform(30.0, 50.0))
    side, squint = rng.choice(["left", "right"]), np.radians(rng.uniform(-15.0, 15.0))
    sliding = factor if mode == "sliding_spotlight" else 1.0
    cell = theory.beam_cell(antenna, sliding)
    if mode == "spotlight":
        cell = 0.5
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    right = np.array([along[1], -along[0], 0.0])
    across = right if side == "right" else -right
    extents = 60.0 * cell, 60.0
    share = np.array([[0.43, -0.3], [-0.43, 0.35], [0.1, 0.05]]) + rng.uniform(-0.02, 0.02, (3, 2))
    places = [a * extents[0] * along + b * extents[1] * across for a, b in share]
    parameters = {
        "mode": mode,
        "slant_range": slant,
        "look_angle_deg": float(np.degrees(look)),
        "heading_deg": float(np.degrees(heading)),
        "look_side": str(side),
        "squint_angle_deg": float(np.degrees(squint)),
        "center_frequency": FREQUENCY,
        "bandwidth": bandwidth(0.5),
        "azimuth_resolution": cell,
        "image_extent_azimuth": extents[0],
        "image_extent_range": extents[1],
    }
    if mode != "spotlight":
        parameters |= {
            "pattern": "rectangular",
            "antenna_length": antenna,
            "elevation_beamwidth_deg": 30.0,
        }
    if mode == "sliding_spotlight":
        parameters["sliding_factor"] = factor
    points = [PointTarget(f"p{i}", place, 1.0) for i, place in enumerate(places)]
    scene = make_scene(None, (), parameters, points=points)
    known = [KnownPoint(tuple(place), f"p{i}", 1.0) for i, place in enumerate(places)]
    report = image_quality(chain(scene), known, areas=())
    assert not report.left_out

    # the track's line, from the numbers above alone
    line = np.sin(squint) * along + np.sqrt(np.sin(look) ** 2 - np.sin(squint) ** 2) * across
    line -= np.cos(look) * np.array([0.0, 0.0, 1.0])
    middle = -slant * line
    half = sliding * WAVELENGTH * np.cos(squint) / (4.0 * cell)  # sine off the boresight
    taper = theory.beam_taper(antenna, WAVELENGTH)
    turning = slant * np.cos(squint) / (1.0 - sliding) if sliding < 1.0 else np.inf
    for place, point in zip(places, report.points, strict=True):
        x = (place - middle) @ along
        closest = np.linalg.norm(place - middle - x * along)
        if mode == "spotlight":
            distance = np.hypot(x, closest)
            length = WAVELENGTH * slant / (2.0 * cell * np.cos(squint))
            width = 0.8859 * theory.aperture_cell(WAVELENGTH, distance, length, np.arcsin(x / distance))
        else:
            tangent = np.tan(squint)
            speed = 1.0
            if sliding < 1.0:
                tangent = (turning * tangent - x) / (turning - closest)
                speed = 1.0 - closest / turning
            cosine = 1.0 / np.hypot(1.0, tangent)

            def tapered(sine, speed=speed, cosine=cosine):
                return taper(speed * sine / cosine)

            width = cosine * theory.half_power_width(WAVELENGTH, half / speed, tapered)
        # tol: asked for; whole pulses, and the interpolation of the width
        assert point.azimuth_cut.irw == pytest.approx(width, rel=0.01), point.name
        assert abs(point.azimuth_error) < 0.03 * cell  # tol: side lobes of the other points
        assert abs(point.range_error) < 0.03 * 0.5  # tol: side lobes of the other points
        assert abs(point.rcs_error_db) < 0.1  # tol: side lobes of the other points


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_points_from_a_whole_circle_are_bessel_functions(seed: int) -> None:
    rng = np.random.default_rng([seed, 16])
    look, frequency = rng.uniform(30.0, 65.0), rng.uniform(0.8e9, 1.6e9)
    wavelength, cell = SPEED_OF_LIGHT / frequency, 0.5
    places = [np.append(rng.uniform(-0.9, 0.9, 2), 0.0) for _ in range(3)]
    amplitude = rng.uniform(0.5, 2.0, 3)
    scene = make_scene(
        None,
        (),
        {
            "mode": "circular",
            "slant_range": 3000.0,
            "look_angle_deg": look,
            "heading_deg": rng.uniform(-180.0, 180.0),
            "look_side": str(rng.choice(["left", "right"])),
            "center_frequency": frequency,
            "bandwidth": bandwidth(cell),
            "image_extent_azimuth": 2.4,
            "image_extent_range": 2.4,
        },
        points=[
            PointTarget(f"p{i}", p, a**2) for i, (p, a) in enumerate(zip(places, amplitude, strict=True))
        ],
    )
    raw = simulate(scene)
    for focuser in ("backprojection", "auto,error=-50"):
        image = focus(raw, request=scene.image, focuser=focuser)
        at = image.grid.positions()
        relative = scene.radar.waveform.bandwidth / frequency
        closed = sum(
            a
            * theory.circular_response(
                np.linalg.norm(at - p, axis=-1), np.radians(look), wavelength, relative
            )
            for p, a in zip(places, amplitude, strict=True)
        )
        # tol: points off the circle's axis are seen at look angles that differ over the circle
        assert np.abs(image.total() - closed).max() < 5e-3 * amplitude.max()


def boxes(seed: int, frequency: float, **radar: object) -> Scene:
    """Two metal boxes on metal ground, drawn."""
    rng = np.random.default_rng([seed, 17])
    corners, faces = cube()[:2]
    unit = (np.asarray(corners, dtype=float) - np.min(corners, axis=0)) / np.ptp(corners, axis=0)
    meshes = []
    for place in ([-2.2, 0.5, 0.0], [2.0, -0.7, 0.0]):
        turn = rng.uniform(0.0, np.pi)
        c, s = np.cos(turn), np.sin(turn)
        body = (
            (unit - [0.5, 0.5, 0.0]) * rng.uniform(0.8, 1.8, 3) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        )
        meshes.append(SceneMesh(body + place, faces, material="pec"))
    ground = 5.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    meshes.append(SceneMesh(ground, np.array([[0, 1, 2], [0, 2, 3]]), material="pec"))
    description = RadarDescription(
        mode="circular",
        slant_range=500.0,
        look_angle_deg=rng.uniform(35.0, 60.0),
        heading_deg=rng.uniform(-180.0, 180.0),
        center_frequency=frequency,
        bandwidth=100e6,
        **radar,
    )
    film = FilmDescription(
        image_extent_azimuth=8.0, image_extent_range=8.0, image_center_x=0.0, image_center_y=0.0
    )
    return build_scene(meshes, radar=description, film=film)


@cache
def every_pulse(seed: int) -> tuple[Scene, RawData]:
    """The boxes from a circle of two hundred pulses, each of them traced."""
    scene = boxes(seed, 0.2e9)
    return scene, simulate(replace(scene, settings=replace(scene.settings, method="raw")))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_pulses_of_a_circle_are_those_traced_alone(seed: int) -> None:
    # a launch plane of its own every 20 degrees: no pulse knows that it is one of a circle
    scene, raw = every_pulse(seed)
    rows = raw.total()
    energy = float(np.mean(np.sum(np.abs(rows) ** 2, axis=1)))
    n = scene.radar.track.n_pulses
    for pulse in np.random.default_rng([seed, 18]).integers(0, n, 5):
        radar = scene.radar.of_pulses([int(pulse)])
        alone = replace(
            scene,
            # with the circle's resolution, so the same pieces of edges: by its own the pulse has pieces of half a
            # wavelength, in the middles of which waves between the rims of the ground are off by -21 dB
            radar=replace(radar, half_aperture=0.5 * radar.footprint_speed),
            settings=replace(
                scene.settings, method="raw", ray_spacing=0.5 * raw.metadata["sampling"]["ray_spacing"]
            ),
        )
        error = float(np.sum(np.abs(rows[pulse] - simulate(alone).total()[0]) ** 2))
        # tol: shadow edges between rays of a fifth of a wavelength, -30 to -44 dB of the mean pulse; the next pulse is
        # off by -9 to -17 dB
        assert error < 10.0**-2.6 * energy, pulse


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_blocks_of_a_circle_are_as_wrong_as_they_say(seed: int) -> None:
    scene, raw = every_pulse(seed)
    grid = default_grid(scene.radar, scene.image)
    exact = focus(raw, grid).total()
    shared = simulate(replace(scene, settings=replace(scene.settings, key_pulse_interval=8)))
    stated = shared.metadata["sampling"]["block_error_db"]
    true = image_error_db(focus(shared, grid).total(), exact)
    # tol: as in tests/random/test_block_error.py; a circle has no end, where block boundaries would say less
    assert true - 3.0 < stated < true + 12.0
