"""Interference against the link budget and brute force, and filters against it with their stated cost."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, build_scene, focus, simulate
from sarmitsuba.core.constants import BOLTZMANN, SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.files import read_raw, write_raw
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.signal.chirp import n_fast_chirped
from sarmitsuba.signal.focusing.interference_filter import filter_interference, parse_interference_filter
from sarmitsuba.signal.interference import draw_interference, interference_power, interference_temperature
from sarmitsuba.signal.noise import noise_power
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.signal.receive import receive

COLUMNS = (
    "kind,x_m,y_m,z_m,eirp_w,frequency_hz,bandwidth_hz,pulse_width_s,prf_hz,azimuth_deg,elevation_deg,"
    "beamwidth_deg"
)
NARROW = "narrow,100,-50,2,5e-5,9.61e9,4e6,0,0,0,0,360"
CHIRP = "chirp,-300,20,0,2e-4,9.6e9,30e6,2e-6,97e3,270,45,60"
PULSE = "pulse,50,200,10,1e-4,9.58e9,0,1e-6,151e3,0,0,360"


def scene_of(tmp_path, *rows, extent=60.0, **changes):
    """One point; emitters of these rows."""
    file = tmp_path / "emitters.csv"
    file.write_text("\n".join([COLUMNS, *rows]) + "\n", encoding="utf-8")
    radar = RadarDescription(
        slant_range=2e3,
        bandwidth=75e6,
        azimuth_resolution=2.0,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
        interference_file=str(file) if rows else "",
        **changes,
    )
    film = FilmDescription(image_extent_azimuth=60.0, image_extent_range=extent)
    return build_scene([], [PointTarget("a", np.zeros(3), 1.0)], radar=radar, film=film)


def _silent(radar):
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    return RawData(np.zeros(shape, np.complex64), (Layer("VV"),), "compressed", radar)


def test_power_at_the_receiver_is_the_one_way_radar_equation(tmp_path):
    radar = scene_of(tmp_path, CHIRP, gain_db=30.0, losses_db=4.0).radar
    for pulse in (0, radar.track.n_pulses - 1):
        line = radar.track.position[pulse] - (np.array([-300.0, 20.0, 0.0]) - radar.offset)
        r = np.linalg.norm(line)
        middle = np.array([-np.cos(np.pi / 4), 0.0, np.sin(np.pi / 4)])
        off = np.arccos(line @ middle / r)
        # Friis with half of the beam's power at half of its width off the middle
        expected = 2e-4 * 1e3 * (SPEED_OF_LIGHT / 9.6e9 / (4 * np.pi * r)) ** 2 / 10**0.2
        expected *= 0.5 ** ((2.0 * off / np.radians(60.0)) ** 2)
        assert interference_power(radar, 0)[pulse] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("row", [NARROW, CHIRP, PULSE])
def test_signals_have_their_power_and_instantaneous_frequency(tmp_path, row):
    radar = scene_of(tmp_path, row).radar
    pick = slice(2, 40)
    signal = draw_interference(radar, 3, 0.0, pick)
    assert signal.shape == (38, n_fast_chirped(radar))
    power = 0.5 * interference_power(radar, 0, pick).mean() * radar.emitters.duty(0)
    # tol: pulses are seen a few times in a record; 32 random tones
    assert np.mean(np.abs(signal) ** 2) == pytest.approx(power, rel=0.25)
    turn = np.angle(signal[:, 1:] * signal[:, :-1].conj()) * radar.window.sampling_rate / (2.0 * np.pi)
    on = np.abs(signal[:, 1:] * signal[:, :-1]) > 0.0
    frequency, width = float(row.split(",")[5]) - 9.6e9, float(row.split(",")[6])
    weight = np.abs(signal[:, 1:])[on] ** 2
    # tol: the mean frequency of a few chirps that the record cuts, and of the drawn tones
    assert np.average(turn[on], weights=weight) == pytest.approx(frequency, abs=max(0.35 * width, 1e4))
    # the same bits from the same seed in any batch of pulses
    assert np.array_equal(signal[5:9], draw_interference(radar, 3, 0.0, slice(7, 11)))
    assert not np.array_equal(signal, draw_interference(radar, 4, 0.0, pick))


def test_power_in_the_image_is_that_of_noise_of_the_stated_temperature(tmp_path):
    scene = scene_of(tmp_path, NARROW, "narrow,-200,90,0,1e-4,9.59e9,30e6,0,0,0,0,360", PULSE)
    radar = scene.radar
    temperature = interference_temperature(radar)
    noisy = replace(radar, emitters=None, noise_temperature=temperature)
    image = focus(receive(_silent(radar), seed=1), request=scene.image, range_window="rectangular")
    reference = focus(receive(_silent(noisy), seed=1), request=scene.image, range_window="rectangular")
    found, expected = (np.mean(np.abs(i.data) ** 2) for i in (image, reference))
    # tol: signals of few tones are no noise: their Doppler lines meet the image's band by chance
    assert db_from_power(found / expected) == pytest.approx(0.0, abs=1.5)
    assert noise_power(noisy, "chirped") / radar.window.sampling_rate == pytest.approx(
        BOLTZMANN * temperature
    )


def test_file_keeps_the_emitters_and_bits_are_repeatable(tmp_path):
    scene = scene_of(tmp_path, NARROW, CHIRP, adc_bits=4, noise_temperature=300.0)
    raw = simulate(scene, seed=1)
    assert np.array_equal(raw.data, simulate(scene, seed=1).data)
    write_raw(raw, tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5").radar.emitters
    assert np.allclose(again.position, [[100, -50, 2], [-300, 20, 0]]) and np.array_equal(again.kind, [0, 1])
    assert np.array_equal(again.beam, scene.radar.emitters.beam)


def _level_db(image):
    """Mean away from the point in the middle, over a point of 1 m^2, dB."""
    power = np.abs(image.data[0]) ** 2
    row, column = (n // 2 for n in power.shape)
    power[row - 12 : row + 13] = np.nan
    power[:, column - 12 : column + 13] = np.nan
    return float(db_from_power(np.nanmean(power)))


def test_notch_removes_tones_and_states_its_cost(tmp_path):
    rows = ["narrow,100,-50,2,0.3,9.61e9,0,0,0,0,0,360", "narrow,10,-90,2,0.3,9.587e9,0,0,0,0,0,360"]
    kept = {"noise_temperature": 3000.0, "gain_db": 30.0, "transmit_power": 10.0, "extent": 200.0}
    raw = simulate(scene_of(tmp_path, *rows, **kept), seed=1)
    clean = simulate(scene_of(tmp_path, **kept), seed=1)
    before, after = focus(raw), focus(raw, interference_filter="notch")
    ideal = focus(clean)
    assert _level_db(before) > _level_db(ideal) + 10.0
    assert _level_db(after) < _level_db(ideal) + 3.0
    facts = after.metadata["focus"]["interference_filter"]
    share = facts["removed_share"]
    assert 0.0 < share < 0.3
    # removing a share s of a flat band from signal and noise costs 1 - s, and spreads s / (1 - s)
    assert facts["snr_loss_db"] == pytest.approx(-db_from_power(1.0 - share), abs=0.1)
    assert facts["islr_added_db"] == pytest.approx(db_from_power(share / (1.0 - share)), abs=0.5)
    # the point keeps its level
    middle = tuple(n // 2 for n in after.grid.shape)
    # tol: residual tones and side lobes, -20 dB
    assert abs(after.data[0][middle]) == pytest.approx(abs(ideal.data[0][middle]), rel=0.1)


def test_time_frequency_filter_removes_chirps_and_pulses(tmp_path):
    rows = [CHIRP.replace("2e-4", "0.3"), PULSE.replace("1e-4", "0.3")]
    kept = {"noise_temperature": 3000.0, "gain_db": 30.0, "transmit_power": 10.0, "extent": 200.0}
    raw = simulate(scene_of(tmp_path, *rows, **kept), seed=1)
    ideal = focus(simulate(scene_of(tmp_path, **kept), seed=1))
    before, after = focus(raw), focus(raw, interference_filter="time_frequency")
    assert _level_db(before) > _level_db(ideal) + 10.0
    assert _level_db(after) < _level_db(before) - 9.0 and _level_db(after) < _level_db(ideal) + 5.0
    assert 0.0 < after.metadata["focus"]["interference_filter"]["removed_share"] < 0.5


def test_filters_leave_clean_data_as_they_are(tmp_path):
    raw = simulate(scene_of(tmp_path, noise_temperature=3000.0), seed=1)
    for name in ("notch", "time_frequency"):
        filtered, facts = filter_interference(raw, parse_interference_filter(f"{name},threshold=30"))
        assert facts["removed_share"] == 0.0 and facts["snr_loss_db"] == pytest.approx(0.0, abs=1e-4)
        # tol: transforms there and back in float32
        assert np.linalg.norm(filtered.data - raw.data) < 1e-5 * np.linalg.norm(raw.data)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("radio" + NARROW[6:], 'kind "radio" is none of narrow, chirp, pulse'),
        (NARROW.replace("9.61e9", "9.7e9"), "outside the radar's band"),
        (CHIRP.replace("97e3", "0"), "needs pulse_width_s and prf_hz"),
        (NARROW.replace("5e-5", "-1"), "eirp_w = -1 must be at least 0"),
    ],
)
def test_impossible_emitters_are_one_line(tmp_path, row, words):
    with pytest.raises(RadarError, match=words):
        scene_of(tmp_path, row)


def test_filter_that_removes_everything_is_refused():
    with pytest.raises(DataError, match=r"threshold = 1 must be"):
        parse_interference_filter("notch,threshold=1")
    assert parse_interference_filter("none") is None
