"""Link budgets: the textbook's forms, pulses and echoes in time, what is impossible, the command."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal.windows import taylor as taylor_window

import sarmitsuba
from sarmitsuba.analysis.link_budget import LinkBudget, link_budget
from sarmitsuba.analysis.pulse_timing import free_bands, overlap_share
from sarmitsuba.cli import main
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.truth import theory

PLAIN = RadarDescription(
    mode="spotlight",
    slant_range=10e3,
    azimuth_resolution=1.0,
    bandwidth=150e6,
    transmit_power=20.0,
    gain_db=30.0,
    losses_db=2.0,
    noise_temperature=600.0,
)
BEAM = replace(PLAIN, mode="stripmap", pattern="rectangular", antenna_length=2.0, antenna_height=0.3)
SPACE = replace(
    BEAM,
    slant_range=700e3,
    look_angle_deg=35.0,
    speed=7500.0,
    prf=2000.0,
    antenna_length=10.0,
    antenna_height=1.0,
    azimuth_resolution=6.0,
    pulse_width=30e-6,
    gain_db=45.0,
)


def budget_of(
    radar: RadarDescription, window: str = "rectangular", **film: float
) -> tuple[LinkBudget, sarmitsuba.Scene]:
    given = FilmDescription(**{"image_extent_azimuth": 60.0, "image_extent_range": 60.0, **film})
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=given)
    return link_budget(scene, range_window=window, azimuth_window=window), scene


def names(budget: LinkBudget) -> set[str]:
    return {finding.name for finding in budget.findings}


def test_both_textbook_forms_agree_and_are_the_prediction_without_beam_and_window() -> None:
    rng = np.random.default_rng(15)
    for _ in range(4):
        # tol: below, the change of range over apertures of a few degrees, and R^4 over them
        radar = replace(
            PLAIN,
            slant_range=rng.uniform(9e3, 20e3),
            look_angle_deg=rng.uniform(25.0, 60.0),
            heading_deg=rng.uniform(0.0, 360.0),
            center_frequency=rng.uniform(5e9, 16e9),
            prf=rng.uniform(80.0, 200.0),
        )
        budget, scene = budget_of(radar)
        place, t = budget.middle, budget.timing
        wave, temperature = scene.radar.waveform, radar.noise_temperature
        gain, losses = 10.0 ** (0.1 * radar.gain_db), 10.0 ** (0.1 * radar.losses_db)
        ground = SPEED_OF_LIGHT / (2.0 * wave.bandwidth * np.sin(place.incidence_angle))
        ratio = theory.point_snr(
            20.0, gain, wave.wavelength, 1.0, place.slant_range, 2e-6, place.n_pulses, temperature, losses
        )
        azimuth = wave.wavelength * place.slant_range / (2.0 * place.aperture_length)
        cells = theory.nesz_of_cells(ratio, ground, azimuth)
        average = theory.nesz_of_average_power(
            t.average_power, gain, wave.wavelength, place.slant_range, ground, 100.0, temperature, losses
        )
        assert cells == pytest.approx(average, rel=1e-9)  # tol: rounding
        assert place.nesz_textbook == pytest.approx(average, rel=1e-9)  # tol: rounding
        assert place.snr == pytest.approx(ratio, rel=2e-3)
        assert place.nesz == pytest.approx(average, rel=5e-3)
        assert place.snr_ground == pytest.approx(0.1 / place.nesz, rel=1e-12)


@pytest.mark.parametrize("resolution", [1.0, 1.5, 3.0])
def test_the_beams_taper_costs_what_its_closed_form_says(resolution: float) -> None:
    budget, scene = budget_of(replace(BEAM, azimuth_resolution=resolution))
    place, wavelength = budget.middle, scene.radar.waveform.wavelength
    point, ground = theory.uniform_aperture_taper(wavelength / 2.0, scene.radar.half_aperture)
    # tol: the aperture is sampled by some 80 to 300 pulses, and R^4 changes over it
    assert place.nesz / place.nesz_textbook == pytest.approx(ground, rel=5e-3)
    one = theory.point_snr(20.0, 1e3, wavelength, 1.0, 10e3, 2e-6, place.n_pulses, 600.0, 10.0**0.2)
    share = 2.0 * scene.radar.half_aperture * 10e3 / place.aperture_length
    assert place.snr == pytest.approx(one * share / point, rel=1e-2)
    assert (point, ground) > (1.0, 1.0)


def test_windows_cost_their_broadening() -> None:
    plain, taylor = budget_of(PLAIN)[0].middle, budget_of(PLAIN, "taylor")[0].middle
    weights = taylor_window(4096, nbar=4, sll=35, norm=False, sym=False)
    broadening = np.mean(weights**2) / np.mean(weights) ** 2
    assert plain.snr / taylor.snr == pytest.approx(broadening**2, rel=3e-3)  # tol: 40 pulses
    assert plain.azimuth_resolution == pytest.approx(0.886, rel=1e-2)  # tol: 1 m to a whole pulse of some 100
    assert plain.range_resolution == pytest.approx(0.886 * 0.99931, rel=1e-3)
    assert taylor.azimuth_resolution == pytest.approx(1.19, rel=1e-2)
    # ground fills the wider cell: only the azimuth's taper of the noise is left
    assert abs(10.0 * np.log10(taylor.nesz / plain.nesz)) < 0.01


def test_pulses_meet_echoes_where_a_pulse_train_says_so() -> None:
    """Against time itself, sampled: pulses leave, nadir echoes and the swath's echoes arrive."""
    rng = np.random.default_rng(8)
    clear = 0
    for _ in range(400):
        width = rng.uniform(5e-6, 40e-6)
        nadir = rng.uniform(3e-3, 4e-3)
        begin = nadir + rng.uniform(0.05e-3, 1e-3)
        window = (begin, begin + width + rng.uniform(5e-6, 100e-6))
        prf = rng.uniform(1200.0, 6000.0)
        bands = free_bands(window, (nadir, nadir + width), width, (1000.0, 8000.0))
        at = np.linspace(*window, 4001)[1:-1]
        blind = np.mod(at, 1.0 / prf) < width
        low = (np.mod(at - nadir, 1.0 / prf) < width) & (at - nadir >= 1.0 / prf)  # later pulses' only
        # tol: 1 / 4000 of the window, at two ends of each of a few overlaps
        assert overlap_share(window, (0.0, width), prf) == pytest.approx(blind.mean(), abs=3e-3)
        assert overlap_share(window, (nadir, nadir + width), prf, earliest=1) == pytest.approx(
            low.mean(), abs=3e-3
        )
        free = any(a <= prf <= b for a, b in bands)
        assert free == (not (blind | low).any())
        clear += free
    assert 20 < clear < 380


@pytest.mark.parametrize(
    ("radar", "film", "name", "text"),
    [
        (
            replace(SPACE, prf=1000.0),
            {},
            "doppler",
            "prf = 1000 Hz is below the Doppler bandwidth 1250 Hz; raise",
        ),
        (replace(SPACE, pulse_width=6e-4), {}, "duty_cycle", "is a duty cycle of 1.2, which must be below 1"),
        (
            SPACE,
            {"image_extent_range": 130e3},
            "swath",
            "do not fit into the interval of 500 us at prf = 2000 Hz",
        ),
        (replace(SPACE, prf=2142.0), {}, "blind_range", "a pulse is sent while 95.1 % .*; take prf = 21"),
        (replace(SPACE, gain_db=55.0), {}, "gain", "gain_db = 55 dB is above 51.1 dB"),
        (
            replace(SPACE, azimuth_resolution=2.0),
            {},
            "aperture",
            "asks for a longer aperture than the beam holds",
        ),
        (
            replace(SPACE, azimuth_resolution=0.0, n_pulses=4000, antenna_length=20.0),
            {},
            "aperture",
            "the beam leaves the image centre within the aperture of 1.5e.04 m",
        ),
    ],
)
@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # of the loader, about the same
def test_what_cannot_be_is_said(
    radar: RadarDescription, film: dict[str, float], name: str, text: str
) -> None:
    budget, _ = budget_of(radar, **film)
    (found,) = [finding for finding in budget.findings if finding.name == name]
    assert found.impossible and found in budget.impossible
    assert re.search(text, found.text), found.text
    assert "\n" not in found.text and found.text in str(budget)


@pytest.mark.parametrize("mode", ["stripmap", "sliding_spotlight", "spotlight"])
def test_an_automatic_prf_is_possible_and_what_a_steered_beam_folds_is_said(mode: str) -> None:
    radar = replace(
        BEAM, mode=mode, antenna_length=1.5, azimuth_resolution=0.8 if mode == "stripmap" else 0.5
    )
    budget, scene = budget_of(radar)
    t, wide = budget.timing, replace(radar, prf=1.01 * budget.timing.lowest_prf)
    assert budget.impossible == ()
    assert names(budget) == ({"azimuth_ghosts"} if mode != "stripmap" else set())
    assert names(budget_of(wide)[0]) == set()
    if mode != "stripmap":
        # tol: the image is seen from both ends of the aperture too, and its near side is nearer
        spread = 2.0 * 100.0 * 60.0 / (scene.radar.waveform.wavelength * 10e3)
        assert t.processed_bandwidth == pytest.approx(spread, rel=0.03)
        assert t.processed_bandwidth < t.prf < t.lowest_prf
        starved = budget_of(replace(radar, prf=0.9 * t.processed_bandwidth))[0]
        assert "doppler" in {finding.name for finding in starved.impossible}


def test_what_has_a_price_is_said() -> None:
    small, _ = budget_of(replace(SPACE, antenna_length=3.0, antenna_height=0.4, prf=2400.0))
    assert "antenna_area" in names(small) and "antenna_area" not in names(budget_of(SPACE)[0])
    silent, _ = budget_of(replace(PLAIN, noise_temperature=0.0))
    assert names(silent) == {"noise_temperature"} and not silent.impossible
    assert np.isnan(silent.middle.nesz) and " - " in str(silent)
    nadir, scene = budget_of(SPACE)
    below = 2.0 * scene.radar.track.center_position[2] / SPEED_OF_LIGHT
    # a prf at which the nadir's echo of the next pulses falls into the swath, and none at which it does not
    late = 0.5 * (nadir.timing.echo_begins + nadir.timing.echo_ends) - below - 15e-6
    hit, _ = budget_of(replace(SPACE, prf=2.0 / late))
    assert "nadir" in names(hit)
    assert names(nadir) == set() and nadir.impossible == ()


def test_the_budget_of_the_fixed_parts() -> None:
    budget, scene = budget_of(SPACE)
    t = budget.timing
    assert t.average_power == pytest.approx(20.0 * 30e-6 * 2000.0)
    assert t.beam_bandwidth == pytest.approx(2 * 7500.0 / 10.0 * 0.8859, rel=1e-3)
    assert t.processed_bandwidth == pytest.approx(7500.0 / 6.0, rel=2e-3)
    assert t.pulses_in_flight == int(2.0 * budget.places[0].slant_range / SPEED_OF_LIGHT * 2000.0)
    assert budget.data.samples_per_pulse == scene.radar.window.n_samples + np.ceil(30e-6 * 180e6)
    assert budget.data.bytes == 8 * scene.radar.track.n_pulses * budget.data.samples_per_pulse
    assert budget.antenna_area == pytest.approx(10.0, rel=1e-3)
    assert [place.name for place in budget.places] == ["near", "middle", "far"]
    assert np.all(np.diff([place.incidence_angle for place in budget.places]) > 0.0)


def test_no_budget_without_an_aperture_or_a_window() -> None:
    with pytest.raises(RadarError, match="needs an aperture of at least 2 pulses"):
        budget_of(replace(PLAIN, n_pulses=1, azimuth_resolution=0.0, prf=100.0))
    with pytest.raises(
        RadarError, match="undefined for a circular aperture, which has no separate range and azimuth"
    ):
        budget_of(replace(PLAIN, mode="circular", azimuth_resolution=0.0))
    with pytest.raises(DataError, match=r"unknown; .*choose one of"):
        budget_of(PLAIN, "taylr")


def test_the_command_prints_a_table_or_json_and_says_impossible_by_its_status(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["link", "point", "--radar", "airborne_x", "-D", "sar_antenna.noise_temperature=500"]) == 0
    text = capsys.readouterr().out
    assert "NESZ (dB)" in text and "free prf" in text and "impossible" not in text
    assert (
        main(["link", "point", "--radar", "airborne_x", "-D", "sar_antenna.pulse_width=0.1", "--json"]) == 1
    )
    found = json.loads(capsys.readouterr().out)
    assert found["findings"][0]["name"] == "duty_cycle" and found["places"][1]["nesz"] is None
    assert main(["link", "point", "--rcs", "0"]) == 2
    assert "--rcs = 0 m^2 must be above 0" in capsys.readouterr().err
