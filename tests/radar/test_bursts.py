"""Bursts: their times, steering and rates against closed forms, and what a description may not ask for."""

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.bursts import azimuth_rates, bursts_in_sight
from sarmitsuba.radar.doppler import beam_doppler

POINT = [sarmitsuba.PointTarget("p", np.zeros(3), 1.0)]
STEERING = 1.6
TWO = (
    "A: prf=1700, pulses=1200, near_deg=33, far_deg=37, steering_rate_deg=1.6;"
    "B: prf=1400, pulses=1400, bandwidth=15e6, near_deg=36.5, far_deg=40, steering_rate_deg=1"
)


def describe(mode="tops", mode_parameters=None, **changes):
    """A C-band radar on a straight track, 800 km away."""
    own = {"steering_rate_deg": STEERING} if mode == "tops" else {}
    numbers = {
        "slant_range": 800e3,
        "look_angle_deg": 35.0,
        "speed": 7200.0,
        "prf": 1700.0,
        "n_pulses": 1300,
        "center_frequency": 5.405e9,
        "bandwidth": 20e6,
        "azimuth_resolution": 20.0,
        "pattern": "gaussian",
        "azimuth_beamwidth_deg": 0.3,
        "elevation_beamwidth_deg": 5.0,
        **changes,
    }
    return sarmitsuba.RadarDescription(
        mode=mode, mode_parameters=mode_parameters if mode_parameters is not None else own, **numbers
    )


def built(extent=2000.0, **changes):
    film = sarmitsuba.FilmDescription(image_extent_azimuth=extent, image_extent_range=300.0)
    return sarmitsuba.build_scene(points=POINT, radar=describe(**changes), film=film)


def two(**own):
    """Two sub-swaths of their own numbers."""
    given = {"prf": 0.0, "n_pulses": 0, "mode_parameters": {"sub_swaths": TWO, **own}}
    return given


def test_the_beams_centroid_turns_at_the_steering_rate():
    radar = built().radar
    time, turn = radar.track.time, np.radians(STEERING)
    closed = 2.0 * 7200.0 / radar.waveform.wavelength * np.sin(turn * (time - time.mean()))
    # tol: rounding of the pulse times
    np.testing.assert_allclose(beam_doppler(radar), closed, atol=1e-6 * np.abs(closed).max())


def test_rates_of_point_beam_and_image():
    radar = built().radar
    rates = azimuth_rates(radar, radar.aim_point)
    wavelength, v = radar.waveform.wavelength, 7200.0
    k_a, k_s = -2.0 * v**2 / (wavelength * 800e3), 2.0 * v / wavelength * np.radians(STEERING)
    # tol: differences over two pulses
    assert rates.point == pytest.approx(k_a, rel=1e-5)
    assert rates.beam == pytest.approx(k_s, rel=1e-5)
    assert rates.image == pytest.approx(k_a * k_s / (k_a - k_s), rel=1e-5)
    assert rates.image == pytest.approx(k_s / rates.stretch, rel=1e-5)
    # the footprint passes over that many times the antenna's way
    assert radar.footprint_speed == pytest.approx(rates.stretch, rel=1e-4)


def test_a_pixel_is_served_by_the_band_of_the_azimuth_resolution():
    from sarmitsuba.signal.focusing.aperture_weights import aperture_weights

    radar = built(azimuth_beamwidth_deg=3.0).radar
    pulses = aperture_weights(radar, radar.aim_point, "rectangular").sum()
    doppler = pulses / 1700.0 * -azimuth_rates(radar, radar.aim_point).point
    assert doppler == pytest.approx(7200.0 / 20.0, rel=0.01)  # tol: curvature of the aperture


def test_bursts_pass_over_the_stretched_time_and_overlap():
    from sarmitsuba.signal.focusing.aperture_weights import aperture_weights

    radar = built().radar
    x = np.linspace(-15e3, 15e3, 1501)
    served = aperture_weights(radar, x[:, None] * radar.track.along, "rectangular").sum(axis=-1)
    length = np.trapezoid(served / served.max(), x)
    closed = azimuth_rates(radar, radar.aim_point).stretch * 1300 / 1700.0 * 7200.0
    assert length == pytest.approx(closed, rel=0.01)  # tol: the range of points away from the middle


def test_a_scansar_beam_rests_and_all_pulses_serve():
    radar = built(mode="scansar", azimuth_resolution=0.0, prf=1900.0).radar
    assert np.ptp(beam_doppler(radar)) < 1e-6
    assert np.isinf(radar.half_aperture) and radar.track.n_pulses == 1300


def test_sub_swath_of_the_aim_point_and_times_of_bursts():
    near = built(**two())
    far = built(**{**two(), "look_angle_deg": 38.5})
    assert (near.radar.burst.sub_swath, near.radar.track.n_pulses) == ("A", 1200)
    assert (far.radar.burst.sub_swath, far.radar.waveform.bandwidth) == ("B", 15e6)
    cycle = 1200 / 1700 + 1400 / 1400
    assert near.radar.burst.cycle == pytest.approx(cycle)
    moved = built(**two(burst="0", burst_offset=0.25)).radar
    assert moved.burst.middle == pytest.approx(-0.25)
    assert moved.track.time.mean() == pytest.approx(moved.burst.middle)
    # the beam looks 3 deg of elevation farther out in B: its middle is 38.25 deg, the aim point at 38.5
    middle = far.radar.pointing.boresight[far.radar.track.center_index]
    assert np.degrees(np.arccos(-middle[2])) == pytest.approx(38.25, abs=1e-3)


@pytest.mark.filterwarnings("ignore:.*below the Doppler bandwidth")
def test_bursts_that_light_an_image_are_those_nearest_in_time():
    cycle = 1200 / 1700 + 1.0
    inside = built(**two())
    seam = built(**two(burst_offset=0.5 * cycle))
    wide = built(extent=3.2 * 7200.0 * cycle, **two())
    fixed = built(**two(burst_offset=0.5 * cycle, burst="1"))
    found = [bursts_in_sight(one.description, one.radar, one.image) for one in (inside, seam, wide, fixed)]
    assert found == [(), (0, 1), (-2, -1, 0, 1, 2), ()]


def test_bursts_in_orbit_are_steered_about_zero_doppler():
    scene = sarmitsuba.load_scene("trihedral", radar="sentinel1_iw")
    doppler = beam_doppler(scene.radar)
    assert scene.radar.burst.sub_swath == "IW2"
    assert abs(doppler.mean()) < 1.0
    v = np.linalg.norm(scene.radar.track.velocity[0])
    k_s = 2.0 * v / scene.radar.waveform.wavelength * np.radians(0.979863)
    assert np.ptp(doppler) == pytest.approx(k_s * 1534 / 1451.627, rel=1e-3)  # tol: sine of the angle
    # annotated k_a of IW2 of a product (S1B_IW_SLC__1SDV_20210401T052622) over its swath: -2188 to -2056 Hz/s
    assert -2190.0 < azimuth_rates(scene.radar, scene.radar.aim_point).point < -2050.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"prf": 0.0}, "has no prf"),
        ({"n_pulses": 0}, "has no pulses"),
        ({"mode_parameters": {}}, "has no steering_rate_deg above 0"),
        ({"mode_parameters": {"steering_rate_deg": 1.6, "steering_limit_deg": 0.5}}, "no grating lobe"),
        ({"mode_parameters": {"steering_rate_deg": 1.6, "burst_cycle": 0.5}}, "overlap in time"),
        ({"mode_parameters": {"steering_rate_deg": 1.6, "burst": "first"}}, "no number of a burst"),
        (
            {"pattern": "isotropic", "azimuth_beamwidth_deg": 0.0, "elevation_beamwidth_deg": 0.0},
            "pattern = isotropic",
        ),
        ({"squint_angle_deg": 1.0}, "no squint"),
        ({**two(), "prf": 1500.0}, "no effect beside prf of sub_swaths"),
        ({**two(), "look_angle_deg": 50.0}, "in no sub-swath (A 33 to 37, B 36.5 to 40 deg)"),
        (two(sub_swath="C"), "there is no sub_swath 'C'"),
        (two(sub_swaths="A prf=1"), "is no sub-swath"),
        (two(sub_swaths="A: prf=fast"), "is no number"),
        (two(sub_swaths="A: pfr=1"), 'did you mean "prf"'),
        (two(sub_swaths="A: prf=1; A: prf=2"), "twice"),
    ],
)
def test_refused_in_one_line(changes, said):
    with pytest.raises(RadarError) as error:
        built(**changes)
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_given_track_has_no_bursts():
    track = sarmitsuba.Track.straight([0.0, -8e5, 6e5], [7200.0, 0.0, 0.0], 1700.0, 100)
    radar = sarmitsuba.RadarDescription(mode="tops", mode_parameters={"steering_rate_deg": STEERING})
    with pytest.raises(RadarError, match="leave the track out"):
        sarmitsuba.build_scene(points=POINT, track=track, radar=radar)
