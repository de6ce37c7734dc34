"""Waveforms by formula and file: autocorrelations against the textbook, filters, and images of them."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, build_scene, focus, simulate
from sarmitsuba.analysis.link_budget import link_budget
from sarmitsuba.analysis.receiver_budget import filter_loss
from sarmitsuba.cli import main
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.files import read_raw, write_raw
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.chirp import pulse_samples
from sarmitsuba.signal.receive import receive

RADAR = RadarDescription(
    slant_range=3e3,
    bandwidth=65e6,
    pulse_width=1e-6,
    azimuth_resolution=3.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
FILM = FilmDescription(image_extent_azimuth=30.0, image_extent_range=150.0)
# Hz: whole samples a chip
RATES = {"barker:13": 78e6, "p4:64": 128e6}
POINT = [PointTarget("a", np.zeros(3), 1.0)]


def scene_of(sampling_rate=0.0, **changes):
    """One point seen by this radar."""
    film = replace(FILM, sampling_rate=sampling_rate)
    return build_scene([], POINT, radar=replace(RADAR, **changes), film=film)


def _side_lobe_db(code, per_chip=1):
    """Highest side lobe of the aperiodic autocorrelation of a code's chips, dB."""
    wave = Waveform(9.6e9, 1e8, 1e-5, code=code)
    chips = np.exp(1j * wave.chips)
    found = np.abs(np.correlate(chips, chips, "full"))
    middle = found.size // 2
    assert found[middle] == pytest.approx(chips.size)
    return float(db_from_power((np.delete(found, middle).max() / chips.size) ** 2))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 7, 11, 13])
def test_barker_codes_have_side_lobes_of_one(n):
    assert _side_lobe_db(f"barker:{n}") == pytest.approx(-20.0 * np.log10(n), abs=1e-9)


def test_frank_and_p4_codes():
    # Lewis and Kretschmer 1982: Frank of 16 chips 1.414 of 16; P4 of 100 about sqrt(2 / (N pi^2)), -26 dB
    assert _side_lobe_db("frank:4") == pytest.approx(20.0 * np.log10(np.sqrt(2.0) / 16.0), abs=1e-6)
    assert _side_lobe_db("p4:100") == pytest.approx(10.0 * np.log10(2.0 / (100 * np.pi**2)), abs=1.0)


def test_nonlinear_modulation_has_the_spectrum_of_its_window():
    # stationary phase is good for a large product of band and time
    wave = Waveform(9.6e9, 100e6, 2e-5, code="nlfm:0.54")
    pulse = pulse_samples(wave, 240e6)
    n = 4 * pulse.size
    spectrum = np.abs(np.fft.fft(pulse, n)) ** 2
    f = np.fft.fftfreq(n, 1.0 / 240e6)
    inside = np.abs(f) < 45e6
    window = 0.54 + 0.46 * np.cos(2.0 * np.pi * f[inside] / 100e6)
    # tol: ripple of 1 / sqrt(B T)
    assert np.corrcoef(spectrum[inside], window)[0, 1] > 0.98
    response = np.abs(np.fft.ifft(spectrum))
    lobes = (
        response[8:400] / response[0]
    )  # the main lobe of a Hamming window is two cells wide to either side
    linear = np.abs(np.fft.ifft(np.abs(np.fft.fft(pulse_samples(replace(wave, code=""), 240e6), n)) ** 2))
    assert db_from_power(lobes.max() ** 2) < -35.0
    assert db_from_power((linear[3:400].max() / linear[0]) ** 2) > -16.0


@pytest.mark.parametrize("form", ["down", "nlfm:0.54", "barker:13", "p4:64"])
@pytest.mark.parametrize("method", ["matched", "mismatched"])
def test_point_keeps_its_level_and_its_place(form, method):
    usual = focus(simulate(scene_of(), seed=1), range_window="rectangular")
    scene = scene_of(RATES.get(form, 0.0), pulse_form=form, pulse_filter=method)
    image = focus(simulate(scene, seed=1), range_window="rectangular")
    places = [np.unravel_index(np.argmax(np.abs(i.data[0])), i.grid.shape) for i in (usual, image)]
    assert np.abs(np.subtract(*places)).max() <= 1
    # tol: pixels are half a cell apart
    assert np.abs(image.data).max() == pytest.approx(np.abs(usual.data).max(), rel=0.06)


def test_mismatched_filter_lowers_side_lobes_of_a_barker_code():
    levels = {}
    for method in ("matched", "mismatched"):
        coded = scene_of(
            52e6, pulse_form="barker:13", bandwidth=50e6, pulse_filter=method
        )  # four samples a chip
        raw = simulate(coded, seed=1)
        line = np.abs(raw.data[0, raw.data.shape[1] // 2])
        peak = int(np.argmax(line))
        lobes = np.concatenate([line[: peak - 5], line[peak + 6 :]])
        levels[method] = float(db_from_power((lobes.max() / line[peak]) ** 2))
    assert levels["matched"] == pytest.approx(-22.3, abs=1.5)  # tol: the band cuts the chips' spectrum
    # a long filter has a side lobe of -47 dB here, and loses 0.2 dB (Ackroyd and Ghani 1973)
    assert levels["mismatched"] < -40.0
    assert db_from_power(filter_loss(coded.radar)) == pytest.approx(0.21, abs=0.05)


@pytest.mark.parametrize(
    ("form", "method"), [("nlfm:0.54", "matched"), ("p4:64", "mismatched"), ("up", "matched")]
)
def test_noise_behind_the_filter_is_that_of_the_budget(form, method):
    given = {"noise_temperature": 600.0}
    rate = RATES.get(form, 0.0)
    scene = scene_of(rate, pulse_form=form, pulse_filter=method, **given)
    silent = simulate(scene_of(rate), seed=1)
    silent = replace(silent, data=np.zeros_like(silent.data))
    found = []
    for radar in (scene.radar, scene_of(rate, **given).radar):
        draws = [receive(replace(silent, radar=radar), seed=s).data for s in range(6)]
        found.append(np.mean([np.mean(np.abs(d) ** 2) for d in draws]))
    budget = link_budget(scene)
    loss_db = db_from_power(budget.receiver.filter_loss)
    # tol: 6 draws of 30 pulses of 100 samples
    assert db_from_power(found[0] / found[1]) == pytest.approx(loss_db, abs=0.2)
    assert budget.middle.nesz_received / budget.middle.nesz == pytest.approx(budget.receiver.filter_loss)


def test_chips_of_a_file_are_kept_in_raw_data(tmp_path):
    (tmp_path / "code.csv").write_text("phase_deg\n0\n0\n0\n180\n0\n", encoding="utf-8")
    scene = scene_of(pulse_form=f"file:{tmp_path / 'code.csv'}")
    assert np.allclose(scene.radar.waveform.chips, [0.0, 0.0, 0.0, np.pi, 0.0])
    raw = simulate(scene, seed=1)
    write_raw(raw, tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5")
    assert again.radar.waveform == raw.radar.waveform and again.radar.chain == raw.radar.chain


def test_what_needs_a_linear_chirp_refuses(tmp_path):
    scene = scene_of(pulse_form="barker:13")
    with pytest.raises(DataError, match="needs a linear chirp, and the waveform is barker:13"):
        focus(simulate(scene, seed=1), interference_filter="time_frequency")
    coded = ["-D", "sar_antenna.pulse_form=barker:13", "--raw", "chirped", "-o", str(tmp_path / "out")]
    assert main(["render", "point", *coded]) != 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pulse_form": "barker:6"}, "is none of nlfm"),
        ({"pulse_form": "sideways"}, "has no number"),
        ({"pulse_form": "nlfm:0.01"}, "pedestal of 0.01"),
        ({"pulse_form": "p4:66"}, "66 chips .* bandwidth of at least"),
        ({"pulse_form": "barker:13", "pulse_filter": "flat"}, "pulse_filter = flat divides"),
        ({"pulse_form": "p4:50", "pulse_filter": "mismatched"}, "whole samples a chip"),
        ({"pulse_form": "file:nowhere.csv"}, "cannot read chips"),
    ],
)
def test_impossible_waveforms_are_one_line(changes, words):
    with pytest.raises(RadarError, match=words) as error:
        scene_of(**changes)
    assert "\n" not in str(error.value)
