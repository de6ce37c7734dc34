"""Images of bursts: resolution, centroid over the image, level over a burst, noise, overlap and mosaic."""

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.bursts import azimuth_rates
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.mosaic import mosaic_bursts, ramp_phase, zero_doppler_times

V, CELL, PRF, PULSES = 7200.0, 20.0, 1700.0, 1300
PLACES = (-6000.0, 0.0, 6000.0)  # m along the track


def points_seen(places=PLACES, *, burst="0", **changes):
    """Ideal points of 10 m^2 along the track (north), seen from 800 km by one burst."""
    mode = changes.pop("mode", "tops")
    own = {"burst": burst, **({"steering_rate_deg": 1.6} if mode == "tops" else {}), **changes.pop("own", {})}
    numbers = {
        "slant_range": 800e3,
        "look_angle_deg": 35.0,
        "speed": V,
        "prf": PRF,
        "n_pulses": PULSES,
        "center_frequency": 5.405e9,
        "bandwidth": 20e6,
        "azimuth_resolution": CELL,
        "pattern": "gaussian",
        "azimuth_beamwidth_deg": 2.0,
        "elevation_beamwidth_deg": 5.0,
        **changes,
    }
    points = [sarmitsuba.PointTarget(f"p{y:g}", np.array([0.0, y, 0.0]), 10.0) for y in places]
    extent = 2.0 * max(abs(y) for y in places) + 400.0
    film = sarmitsuba.FilmDescription(image_extent_azimuth=extent, image_extent_range=200.0)
    radar = sarmitsuba.RadarDescription(mode=mode, mode_parameters=own, **numbers)
    return sarmitsuba.build_scene(points=points, radar=radar, film=film)


def patch(scene, y, extent=300.0, shift=0.0):
    """Grid of 2 m about a place along the track."""
    radar = scene.radar
    x = float((np.array([0.0, y, 0.0]) - radar.track.center_position) @ radar.track.along) + shift
    return ImageGrid(
        kind="slant",
        azimuth=x + np.arange(-0.5 * extent, 0.5 * extent, 2.0),
        range=800e3 + np.arange(-40.0, 40.0, 2.0),
        origin=radar.track.center_position,
        along=radar.track.along,
        across=radar.across,
    )


def focused(raw, grid, **options):
    plain = {"range_window": "rectangular", "azimuth_window": "rectangular", "focuser": "backprojection"}
    return sarmitsuba.focus(raw, grid, **{**plain, **options})


def peak_line(image):
    """Azimuth line of the image through its peak."""
    data = image.data[0]
    return data[:, np.unravel_index(np.abs(data).argmax(), data.shape)[1]]


def half_power_width(line, step):
    """Width of a peak in m, by zero padding of its spectrum about its own centroid."""
    turn = np.angle(np.sum(line[1:] * line[:-1].conj()))
    base = line * np.exp(-1j * turn * np.arange(line.size))
    fine = np.abs(np.fft.ifft(np.pad(np.fft.fftshift(np.fft.fft(base)), 15 * line.size // 2 * 2)))
    peak = int(fine.argmax())
    fine = np.roll(fine, fine.size // 2 - peak) / fine[peak]
    inside = np.flatnonzero(fine >= np.sqrt(0.5))
    ends = [
        np.interp(np.sqrt(0.5), fine[[a, b]], [a, b])
        for a, b in ((inside[0] - 1, inside[0]), (inside[-1] + 1, inside[-1]))
    ]
    return (ends[1] - ends[0]) * step * line.size / fine.size


@pytest.fixture(scope="module")
def tops():
    import warnings

    with warnings.catch_warnings():
        # points apart from each other by no multiple of the ghosts' distance of 5.2 km
        warnings.simplefilter("ignore", sarmitsuba.SarmitsubaWarning)
        scene = points_seen()
        return scene, sarmitsuba.simulate(scene)


@pytest.mark.parametrize("y", PLACES)
def test_a_point_has_its_level_and_the_azimuth_cell_everywhere(tops, y):
    scene, raw = tops
    line = peak_line(focused(raw, patch(scene, y)))
    assert np.abs(line).max() ** 2 == pytest.approx(10.0, rel=0.02)  # tol: 0.1 dB, side lobes of other points
    assert half_power_width(line, 2.0) == pytest.approx(0.886 * CELL, rel=0.01)


@pytest.mark.parametrize("y", PLACES)
def test_the_centroid_runs_at_k_t(tops, y):
    scene, raw = tops
    grid = patch(scene, y)
    image = focused(raw, grid)
    # the carrier of the closest range off, what is left turns with the centroid
    data = image.data[0] * np.exp(-4j * np.pi / scene.radar.waveform.wavelength * grid.range)
    line = data[:, np.unravel_index(np.abs(data).argmax(), data.shape)[1]]
    turn = np.angle(np.sum(line[1:] * line[:-1].conj()))
    rates = azimuth_rates(scene.radar, scene.radar.aim_point)
    expected = 2.0 * np.pi * rates.image * (y / V) * (2.0 / V)
    assert np.angle(np.exp(1j * (turn - expected))) == pytest.approx(0.0, abs=0.01 * 2 * np.pi * 1472 * 2 / V)
    deramped = data * np.exp(-1j * ramp_phase(raw.radar, grid))
    line = deramped[:, np.unravel_index(np.abs(data).argmax(), data.shape)[1]]
    # tol: the ripple of the band's ends
    assert np.angle(np.sum(line[1:] * line[:-1].conj())) == pytest.approx(0.0, abs=2e-3)


def test_a_shift_of_a_thousandth_of_a_pixel_leaves_the_phase_of_the_overlap():
    rates_of = []
    shifts = {}
    cycle, pixel = 2.4, 14.0  # s, m as of Sentinel-1
    for burst in ("0", "1"):
        scene = points_seen((0.0,), burst=burst, own={"burst_cycle": cycle, "burst_offset": 0.5 * cycle})
        raw = sarmitsuba.simulate(scene)
        grids = [patch(scene, 0.0, extent=4.0, shift=s) for s in (0.0, 1e-3 * pixel)]
        values = [complex(focused(raw, grid).data[0, 1, 20]) for grid in grids]
        shifts[burst] = float(np.angle(values[1] * np.conj(values[0])))
        rates_of.append(azimuth_rates(scene.radar, scene.radar.aim_point).image)
    found = shifts["0"] - shifts["1"]
    # the aim point lies half a cycle after the middle of burst 0, and before that of burst 1
    assert found == pytest.approx(2.0 * np.pi * rates_of[0] * cycle * 1e-3 * pixel / V, abs=0.01)
    assert abs(found) > 0.04


def test_scansar_levels_are_even_and_its_echoes_are_not():
    """Scalloping: the beam's two-way power, mean over the burst, before; nothing after."""
    places = (-1500.0, 0.0, 1500.0)
    scene = points_seen(
        places, mode="scansar", n_pulses=300, azimuth_resolution=0.0, azimuth_beamwidth_deg=0.3
    )
    raw = sarmitsuba.simulate(scene)
    before, closed = [], []
    for y in places:
        level = np.abs(peak_line(focused(raw, patch(scene, y, extent=400.0)))).max() ** 2
        assert 10.0 * np.log10(level / 10.0) == pytest.approx(0.0, abs=0.1)
        before.append(matched_weights(scene.radar, np.array([0.0, y, 0.0])).mean())
        x = np.linspace(-0.5, 0.5, 301) * 300 / PRF * V
        sine = (y - x) / np.hypot(y - x, 800e3)
        closed.append(np.mean(2.0 ** (-2.0 * (sine / np.sin(np.radians(0.15))) ** 2)))
    # power of the beam, two ways, over its middle
    before_db = 10.0 * np.log10(np.array(before) / before[1])
    np.testing.assert_allclose(before_db, 10.0 * np.log10(np.array(closed) / closed[1]), atol=0.1)
    assert before_db.min() < -0.5


def test_nesz_of_a_turning_beam_is_that_of_the_textbook():
    """A place is lit for a shorter time, and its cell is as much wider: the noise is that of stripmap."""
    from sarmitsuba.analysis.link_budget import link_budget

    scene = points_seen(
        (0.0,), transmit_power=4000.0, noise_temperature=500.0, gain_db=45.0, pulse_width=50e-6
    )
    place = link_budget(scene, range_window="rectangular", azimuth_window="rectangular").places[1]
    wavelength = scene.radar.waveform.wavelength
    average, gain = 4000.0 * 50e-6 * PRF, 10**4.5
    cell = scene.radar.waveform.range_cell / np.sin(np.radians(35.0))
    closed = (
        2
        * (4 * np.pi) ** 3
        * 800e3**3
        * V
        * 1.380649e-23
        * 500.0
        / (average * gain**2 * wavelength**3 * cell)
    )
    assert 10.0 * np.log10(place.nesz) == pytest.approx(10.0 * np.log10(closed), abs=0.1)


@pytest.mark.slow
def test_mosaic_of_two_bursts_has_every_point_once():
    own = {"burst_cycle": 2.0, "burst_offset": 1.0}
    scene = points_seen((-2000.0, 2000.0), burst="auto", own=own, azimuth_beamwidth_deg=0.3)
    image = sarmitsuba.render(scene, range_window="rectangular", azimuth_window="rectangular")
    assert [facts["number"] for facts in image.metadata["bursts"]] == [0, 1]
    assert len(image.parts) == 2
    x = image.grid.azimuth - float(-scene.radar.track.center_position @ scene.radar.track.along)
    power = np.abs(image.data[0]).max(axis=1) ** 2
    for y in (-2000.0, 2000.0):
        assert power[np.abs(x - y) < 15.0].max() == pytest.approx(
            10.0, rel=0.15
        )  # tol: points between pixels
    # the seam is where both are equally far in time: at the aim point
    seam = np.flatnonzero(np.diff((image.data[0] == image.parts[1].data[0]).mean(axis=1) > 0.5))
    assert abs(x[seam[0]]) <= 2.0 * image.grid.azimuth_spacing
    with pytest.raises(DataError, match="raw data are those of one burst"):
        sarmitsuba.simulate(scene)


def test_zero_doppler_times_are_those_of_a_straight_track(tops):
    scene, _ = tops
    grid = patch(scene, 6000.0)
    expected = grid.azimuth[:, None] / V + np.zeros(grid.shape)
    np.testing.assert_allclose(zero_doppler_times(scene.radar, grid), expected, atol=1e-9)


def test_mosaic_refuses_images_of_other_pixels(tops):
    scene, raw = tops
    images = [focused(raw, patch(scene, 0.0, extent=extent)) for extent in (20.0, 30.0)]
    with pytest.raises(DataError, match="differ in their pixels"):
        mosaic_bursts(images, [scene.radar] * 2)


def sliding():
    """Points seen by an aircraft whose beam turns about a place beyond the scene."""
    places = (-33.0, -15.0, 0.0, 7.0, 29.0)
    points = [sarmitsuba.PointTarget(f"p{y:g}", np.array([0.7 * y, y, 0.0]), 10.0) for y in places]
    radar = sarmitsuba.RadarDescription(
        mode="sliding_spotlight",
        mode_parameters={"sliding_factor": 0.3},
        center_frequency=9.6e9,
        bandwidth=100e6,
        azimuth_resolution=0.5,
        pattern="rectangular",
        antenna_length=2.0,
        elevation_beamwidth_deg=5.0,
    )
    film = sarmitsuba.FilmDescription(image_extent_azimuth=90.0, image_extent_range=60.0)
    return sarmitsuba.simulate(sarmitsuba.build_scene(points=points, radar=radar, film=film))


def error_db(image, reference):
    return 10.0 * np.log10(np.sum(np.abs(image - reference) ** 2) / np.sum(np.abs(reference) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("window", ["taylor", "rectangular"])
def test_turning_beams_in_the_frequency_domain(tops, window):
    """Deramped, filtered and reramped echoes give backprojection's pixels."""
    scene, raw = tops
    grid = patch(scene, 0.0, extent=1200.0)
    options = {"azimuth_window": window, "range_window": "taylor"}
    reference = focused(raw, grid, focuser="backprojection,interpolation=kernel:8", **options)
    for name in ("omega_k", "range_doppler", "chirp_scaling"):
        image = focused(raw, grid, focuser=name, motion_compensation="off", **options)
        found = error_db(image.data, reference.data)
        assert found < -45.0
        assert found < image.metadata["focus"]["stated_error_db"] + 0.1
        assert image.azimuth_resolution_cell == pytest.approx(reference.azimuth_resolution_cell, rel=2e-3)


@pytest.mark.slow
def test_tops_from_orbit_in_the_frequency_domain():
    """By a straight track at the effective velocity, and the change of its histories over image and aperture."""
    orbit = {
        "orbit_altitude": 693e3,
        "orbit_inclination_deg": 98.18,
        "incidence_angle_deg": 39.0,
        "latitude_deg": 48.0,
        "prf": 1452.0,
        "n_pulses": 1535,
        "center_frequency": 5.405e9,
        "bandwidth": 20e6,
        "pulse_width": 50e-6,
        "azimuth_resolution": 22.0,
        "pattern": "rectangular",
        "antenna_length": 12.3,
        "elevation_beamwidth_deg": 5.0,
        "mode_parameters": {"steering_rate_deg": 0.98, "burst": "0"},
    }
    places = np.array([[0.0, 0.0], [0.35, 0.4], [-0.4, -0.35], [0.3, -0.42], [-0.2, 0.3]]) * 1500.0
    points = [
        sarmitsuba.PointTarget(f"p{i}", np.array([*place, 0.0]), 10.0) for i, place in enumerate(places)
    ]
    film = sarmitsuba.FilmDescription(image_extent_azimuth=1500.0, image_extent_range=1500.0)
    radar = sarmitsuba.RadarDescription(mode="tops", **orbit)
    raw = sarmitsuba.simulate(sarmitsuba.build_scene(points=points, radar=radar, film=film))
    for grid in ("slant", "ground"):
        reference = sarmitsuba.focus(
            raw, request={"grid": grid}, focuser="backprojection,interpolation=kernel:8"
        )
        image = sarmitsuba.focus(raw, reference.grid, focuser="omega_k")
        found = error_db(image.data, reference.data)
        assert found < -45.0 and found < image.metadata["focus"]["stated_error_db"]


@pytest.mark.slow
def test_sliding_spotlight_in_the_frequency_domain():
    raw = sliding()
    reference = sarmitsuba.focus(raw, focuser="backprojection,interpolation=kernel:8")
    image = sarmitsuba.focus(raw, focuser="omega_k", motion_compensation="off")
    assert error_db(image.data, reference.data) < -50.0
    ground = sarmitsuba.focus(raw, request={"grid": "ground"}, focuser="omega_k", motion_compensation="off")
    reference = sarmitsuba.focus(raw, ground.grid, focuser="backprojection,interpolation=kernel:8")
    assert error_db(ground.data, reference.data) < -45.0
