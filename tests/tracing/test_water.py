"""Water under wind: the drawn waves and what they do to scatterers, key pulses against every pulse, when it is on."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import (
    FilmDescription,
    Material,
    Motion,
    RadarDescription,
    Scene,
    SceneError,
    SceneMesh,
    build_scene,
    simulate,
)
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.scene.materials.laws.sea import Sea
from sarmitsuba.scene.materials.sea_spectrum import SeaState
from sarmitsuba.scene.motion import STILL
from sarmitsuba.simulation.planning.sampling import water as sampling
from sarmitsuba.tracing.scatterers.water.wind_waves import WaterTables
from sarmitsuba.truth.theory import sea as theory
from tests.support.unweighted import focus, render

WAVELENGTH = 0.03106
FACES = [[0, 1, 2], [0, 2, 3]]
RADAR = RadarDescription(
    slant_range=2e3,
    look_angle_deg=40.0,
    heading_deg=70.0,
    speed=120.0,
    bandwidth=150e6,
    azimuth_resolution=2.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
FILM = FilmDescription(image_extent_azimuth=30.0, image_extent_range=30.0)

pytestmark = pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # effects switched off


def sea(wind: float = 8.0, bearing: float = 200.0, drawn: float = 4.0, name: str = "sea") -> Material:
    """Sea water, fully developed."""
    given = {"wind_speed": wind, "wind_direction_deg": bearing, "shortest_drawn_wave": drawn}
    return Material(name, permittivity=54.0 - 39.0j, diffuse_law="sea", law_parameters=tuple(given.items()))


def harbour(
    radar: RadarDescription = RADAR,
    *,
    drawn: float = 4.0,
    wall: bool = False,
    motion: Motion = STILL,
    **settings: str,
) -> Scene:
    """A square of water, and a wall in it where asked for."""
    h = 12.0
    water = np.array([[-h, -h, 0.0], [h, -h, 0.0], [h, h, 0.0], [-h, h, 0.0]])
    board = np.array([[-5.0, 2.0, 0.0], [5.0, 4.0, 0.0], [5.0, 4.0, 3.0], [-5.0, 2.0, 3.0]])
    parts = [SceneMesh(water, FACES, sea(drawn=drawn), "water")]
    if wall:
        parts.append(SceneMesh(board, FACES, "pec", "wall", motion=motion))
    scene = build_scene(parts, radar=radar, film=FILM)
    return scene.replace(**settings) if settings else scene


def energy_db(error: C64, signal: C64) -> float:
    return float(10.0 * np.log10(np.sum(np.abs(error) ** 2) / np.sum(np.abs(signal) ** 2)))


# ------------------------------------------------------------------------------------------ the drawn waves


def at(water: WaterTables, points: F64, time: float) -> tuple[F64, F64, F64]:
    """Displacement, velocity and normal of the surface, as the kernel has them, (n, 3) each; no random velocities."""
    p = mi.Vector3d(*(mi.Float64(np.ascontiguousarray(column)) for column in points.T))
    material = dr.zeros(mi.UInt32, len(points))
    shift, velocity = water._orbit(mi.Vector3f(p), material, mi.Float(time))
    up = mi.Vector3f(0.0, 0.0, 1.0)
    normal = water.tilt(up, mi.Vector3f(p), material, mi.Float(time))
    return tuple(np.array(v).T for v in (shift, velocity, normal))  # type: ignore[return-value]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_waves_lift_carry_and_tilt_the_surface_as_linear_theory_has_it(seed: int) -> None:
    ensure_backend()
    rng = np.random.default_rng(seed)
    wind, bearing, time = float(rng.uniform(5, 14)), float(rng.uniform(0, 360)), float(rng.uniform(-3, 3))
    material = sea(wind, bearing)
    water = WaterTables.of([material], WAVELENGTH, 256, seed)
    assert water is not None
    points = np.column_stack([rng.uniform(-200.0, 200.0, (50, 2)), np.zeros(50)])
    shift, velocity, normal = at(water, points, time)
    # closed form of every wave: height a cos(k x - w t + phase) and the circle of a particle
    waves = Sea().wind_waves(material, WAVELENGTH, np.zeros(1), seed).waves
    kx, ky, omega, phase, a = waves.T
    k = np.hypot(kx, ky)
    assert np.allclose(omega, k * theory.phase_speed(k), rtol=1e-9)
    turn = points[:, :1] * kx + points[:, 1:2] * ky - omega * time + phase
    want = np.stack([-np.sin(turn) * a * kx / k, -np.sin(turn) * a * ky / k, np.cos(turn) * a])
    # tol: float32 phases, 200 m * 1.6 rad/m * 6e-8, and 48 of them
    assert np.abs(shift - want.sum(axis=2).T).max() < 2e-4
    rate = np.stack(
        [np.cos(turn) * a * omega * kx / k, np.cos(turn) * a * omega * ky / k, np.sin(turn) * a * omega]
    )
    assert np.abs(velocity - rate.sum(axis=2).T).max() < 2e-4
    slope = np.stack([np.sum(-np.sin(turn) * a * kk, axis=1) for kk in (kx, ky)], axis=1)
    lean = np.column_stack([-slope, np.ones(50)])
    assert np.abs(normal - lean / np.linalg.norm(lean, axis=1, keepdims=True)).max() < 1e-4
    # they run with the wind
    downwind = -np.array([np.sin(np.radians(bearing)), np.cos(np.radians(bearing))])
    assert (np.column_stack([kx, ky]) @ downwind > 0.0).all()


def test_drawn_waves_have_the_spectrum_s_variances() -> None:
    state, split = SeaState(9.0), 2.0 * np.pi / 4.0
    downwind = np.array([0.6, 0.8])
    height, orbit, slope = np.zeros(40), np.zeros(40), np.zeros((40, 2))
    for seed in range(40):
        kx, ky, omega, _, a = state.drawn(split, downwind, seed).T
        height[seed] = np.sum(0.5 * a**2)
        orbit[seed] = np.sum(0.5 * (a * omega) ** 2)
        along, across = kx * 0.6 + ky * 0.8, ky * 0.6 - kx * 0.8
        slope[seed] = [np.sum(0.5 * (a * part) ** 2) for part in (along, across)]
    low = 0.5 * state.peak
    # tol: what the spectrum has in waves longer than twice the highest, and those too low to draw
    assert np.mean(height) == pytest.approx(sum(theory.band_integral(9.0, low, split, 0.0)), rel=0.01)
    want = sum(theory.band_integral(9.0, low, split, 2.0, 2.0))
    assert np.mean(orbit) == pytest.approx(want, rel=0.01)  # tol: 40 draws of 48 strata
    # tol: standard error of 40 draws of 48 directions, 3 %
    assert np.mean(slope, axis=0) == pytest.approx(theory.band_integral(9.0, low, split, 2.0), rel=0.09)


# ------------------------------------------------------------------------------------------ key pulses


@pytest.mark.parametrize(("drawn", "limit"), [(1e4, -28.0), pytest.param(4.0, -23.0, marks=pytest.mark.slow)])
def test_key_pulses_and_every_pulse_see_the_same_water(drawn: float, limit: float) -> None:
    """Range rates carry the velocities; what is left is the acceleration of the long waves over a block."""
    every = simulate(harbour(drawn=drawn, wall=True, method="raw"), seed=3).data
    keys = simulate(harbour(drawn=drawn, wall=True), seed=3).data
    # tol: 0.05 rad of the waves' acceleration and the blocks' own error; wrong velocities are at 0 dB
    assert energy_db(keys - every, every) < limit
    still = simulate(harbour(drawn=drawn, wall=True, water_motion="off"), seed=3).data
    assert energy_db(still - every, every) > -6.0


@pytest.mark.slow
@pytest.mark.parametrize("beam", [False, True])
def test_key_pulses_hold_with_a_receiver_apart_a_beam_and_a_ship_under_way(beam: bool) -> None:
    radar = replace(RADAR, receiver_offset_along=-40.0)
    if beam:
        radar = replace(
            RADAR, speed=400.0, pattern="rectangular", antenna_length=0.8, elevation_beamwidth_deg=20.0
        )
    motion = (
        STILL if beam else Motion((1.0, 0.5, 0.0))
    )  # with a moving mesh, blocks are as short as the beam asks
    every = simulate(harbour(radar, wall=True, motion=motion, method="raw"), seed=3).data
    keys = simulate(harbour(radar, wall=True, motion=motion), seed=3).data
    # tol: waves' acceleration and the blocks' own error (-26 dB), the place in the beam
    assert -60.0 < energy_db(keys - every, every) < -22.0


def test_time_zero_is_where_all_methods_meet() -> None:
    """Water that stands still is as it is at mid-aperture, where the pulses of moving water are the same."""
    still, moving = (
        simulate(harbour(method="raw", **switch), seed=2) for switch in ({"water_motion": "off"}, {})
    )
    middle = int(np.argmin(np.abs(still.radar.track.time)))
    assert still.radar.track.time[middle] == 0.0
    assert np.array_equal(still.data[:, middle], moving.data[:, middle])
    assert energy_db(still.data[:, 0] - moving.data[:, 0], still.data[:, 0]) > -3.0


# ------------------------------------------------------------------------------------------ the effect


def test_water_motion_is_on_where_there_is_water_under_wind_and_phase() -> None:
    plan = plan_effects(harbour(), warn=False)
    decision = plan.decision("water_motion")
    assert decision is not None and decision.on and plan.flags.water_motion
    assert "0.18 m/s" in decision.why and "48 long waves" in decision.why and decision.error_db == 0.0
    assert not plan_effects(harbour(method="raster"), warn=False).on("water_motion")
    land = build_scene([SceneMesh(np.eye(3), [[0, 1, 2]], "concrete")], radar=RADAR, film=FILM)
    plan = plan_effects(land, warn=False)
    assert not plan.on("water_motion") and not plan.flags.water_motion
    # asked for, it has nothing to do
    assert not plan_effects(land.replace(water_motion="on"), warn=False).flags.water_motion
    assert (
        sampling.fastest(land) == 0.0
        and sampling.block_length(land, np.zeros(3), 100, every_beam=True) == 100
    )


def test_image_and_raster_show_the_level_of_the_sea() -> None:
    radar = replace(RADAR, azimuth_resolution=0.5, bandwidth=300e6)
    for method in ("image", "raster"):
        scene = harbour(radar, drawn=1e4, method=method)
        image = render(scene)
        inner = image.sigma0()[np.ix_(*(np.arange(n // 3, 2 * n // 3) for n in image.grid.shape))]
        # the wind comes from 200 deg, the radar looks to the right of 70 deg
        want = theory.two_scale(
            8.0,
            WAVELENGTH,
            54.0 - 39.0j,
            np.radians(40.0),
            np.radians(160.0 - 200.0),
            longest=1e-3,
            split=50.6,
        )
        # tol: 4 standard errors of some 300 looks, and smear over the edge of the water
        assert 10.0 * np.log10(inner.mean() / want[1]) == pytest.approx(0.0, abs=1.5), method


def test_a_sea_has_the_rms_height_of_its_waves_unless_it_is_given() -> None:
    developed = sea(10.0).rms_height
    low = 0.1 * SeaState(10.0).peak
    assert developed == pytest.approx(np.sqrt(sum(theory.band_integral(10.0, low, 7400.0, 0.0))), rel=1e-3)
    assert replace(sea(10.0), rms_height=0.004).rms_height == 0.004
    assert Material("flat", permittivity=54.0 - 39.0j).rms_height == 0.0


def test_water_has_the_permittivity_of_its_temperature_and_salinity() -> None:
    square = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 9.0, 0.0], [0.0, 9.0, 0.0]])
    for given, temperature, salinity in (
        ({"material": "sea_water"}, 15.0, 35.0),
        ({"material": "sea_water", "temperature_celsius": 5.0, "salinity": 8.0}, 5.0, 8.0),
        ({"material": "fresh_water", "temperature_celsius": 25.0}, 25.0, 0.0),
    ):
        scene = build_scene(
            [SceneMesh(square, FACES, {**given, "rms_height": 0.001})], radar=RADAR, film=FILM
        )
        want = theory.sea_water_permittivity(scene.radar.waveform.center_frequency, temperature, salinity)
        # tol: two fits of salt water
        assert scene.materials[0].permittivity == pytest.approx(want, rel=0.05)


def test_wind_is_refused_where_no_law_takes_it() -> None:
    square = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 9.0, 0.0], [0.0, 9.0, 0.0]])
    for given, words in (
        (
            {"material": "sea_water", "wind_speed": 5.0},
            "wind_speed has no effect with diffuse_law = constant_gamma",
        ),
        ({"material": "sea_water", "diffuse_law": "sea", "wind_speed": 80.0}, "wind_speed"),
        ({"material": "concrete", "salinity": 5.0}, 'salinity has no effect with material = "concrete"'),
        ({"material": "fresh_water", "salinity": 5.0}, "take sea_water or leave it out"),
    ):
        with pytest.raises(SceneError, match=words):
            build_scene([SceneMesh(square, FACES, given)], radar=RADAR, film=FILM)


@pytest.mark.slow
def test_a_current_carries_the_sea_along() -> None:
    """All scatterers have the current's range rate besides, and show -R v / V along the track from where they were."""
    h, shown = 10.0, []
    water = np.array([[-h, -h, 0.0], [h, -h, 0.0], [h, h, 0.0], [-h, h, 0.0]])
    radar = replace(RADAR, heading_deg=0.0)  # looks east
    film = FilmDescription(image_extent_azimuth=90.0, image_extent_range=30.0)
    for speed in (0.0, 1.5):
        part = SceneMesh(water, FACES, sea(drawn=1e4), "water", motion=Motion((speed, 0.0, 0.0)))
        image = focus(simulate(build_scene([part], radar=radar, film=film), seed=5))
        power = np.sum(np.abs(image.total()) ** 2, axis=1)
        shown.append(float(image.grid.azimuth @ power / power.sum()))
    want = -2e3 / 120.0 * 1.5 * np.sin(np.radians(40.0))
    assert shown[1] - shown[0] == pytest.approx(want, abs=2.0)  # tol: other speckle, ends of the image
