"""Closed forms of the receive chain's losses, against simulated and drawn echoes."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, build_scene, focus, simulate
from sarmitsuba.analysis.link_budget import link_budget
from sarmitsuba.analysis.receiver_budget import echo_power, receiver_budget
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.receive_chain import ReceiveChain
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.signal.receive import pulse_factors, receive

RADAR = RadarDescription(
    slant_range=3e3,
    bandwidth=75e6,
    pulse_width=4e-6,
    azimuth_resolution=2.0,
    noise_temperature=900.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
POINT = [PointTarget("a", np.zeros(3), 1.0)]
WIDE = FilmDescription(image_extent_azimuth=30.0, image_extent_range=1200.0)
FILM = FilmDescription(image_extent_azimuth=60.0, image_extent_range=120.0)


def scene_of(points=None, **changes):
    """One point, or these, of a radar with changed parameters."""
    return build_scene([], points or POINT, radar=replace(RADAR, **changes), film=FILM)


def test_power_of_the_ground_is_that_of_drawn_scatterers():
    rng = np.random.default_rng(4)
    n, sigma0 = 600, 0.1
    places = rng.uniform([-60.0, -30.0], [60.0, 30.0], (n, 2))
    area = 120.0 * 60.0
    points = [
        PointTarget(str(i), np.array([x, y, 0.0]), sigma0 * area / n, phase=float(2 * np.pi * rng.random()))
        for i, (x, y) in enumerate(places)
    ]
    scene = scene_of(points, noise_temperature=0.0)
    record = to_chirped(simulate(scene, seed=1)).data[0]
    grid = default_grid(scene.radar, scene.image)
    # the pulse covers all of the ground in the middle of the record
    middle = record.shape[1] // 2
    found = np.mean(np.abs(record[:, middle - 60 : middle + 60]) ** 2)
    # tol: speckle of 60 pulses that see the same scatterers
    assert db_from_power(found / echo_power(scene.radar, grid, sigma0)) == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize(
    "chain",
    [
        {"raw_coding": "baq", "baq_bits": 2},
        {"adc_bits": 2},
        {"saturation_db": -3.0, "adc_bits": 5},
        {"iq_gain_db": 3.0, "iq_phase_deg": 12.0},
        {"raw_coding": "fdbaq", "dead_pulses": 0.3},
    ],
)
def test_noise_of_the_image_rises_as_stated(chain):
    # a window of four pulses, so that the weaker ends of the records count little
    scene = build_scene([], POINT, radar=replace(RADAR, pulse_width=1.5e-6, **chain), film=WIDE)
    radar = scene.radar
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    silent = RawData(np.zeros(shape, np.complex64), (Layer("VV"),), "compressed", radar)
    ideal = replace(silent, radar=replace(radar, chain=None))
    found = []
    for seed in range(4):
        images = [focus(receive(raw, seed=seed), request=scene.image) for raw in (silent, ideal)]
        found.append([np.mean(np.abs(image.data) ** 2) for image in images])
    received, thermal = np.mean(found, axis=0)
    grid = default_grid(radar, scene.image)
    budget = receiver_budget(radar, grid, 1e-12, 1e9)
    # noise over the level of a point, which the chain changes too
    assert db_from_power(received / budget.gain / thermal) == pytest.approx(
        db_from_power(budget.raise_noise(radar.noise_temperature)),
        abs=0.35,  # tol: weaker ends of the records, and the inverse filter, 1 / sqrt(B T)
    )


def test_pulse_losses_are_those_of_drawn_factors():
    scene = scene_of(dead_pulses=0.2, gain_drift_db=4.0, gain_jitter_db=1.5, phase_noise="1:-45,3000:-45")
    radar = replace(scene.radar, aim_point=np.array([2e5, 0.0, 0.0]))
    time = radar.track.time
    grid = default_grid(scene.radar, scene.image)
    budget = receiver_budget(radar, grid, 0.1, 2.0 * float(time[-1] - time[0]))
    drawn = np.array([pulse_factors(radar, seed)[0] for seed in range(300)])
    peaks = np.abs(drawn.mean(axis=1)) ** 2
    energy = np.mean(np.abs(drawn) ** 2, axis=1)
    # tol: 300 draws of tracks of 60 pulses, and one part in 60 of the side lobes lies under the peak
    assert db_from_power(peaks.mean()) == pytest.approx(db_from_power(budget.gain), abs=0.15)
    assert db_from_power(energy.mean() / peaks.mean()) == pytest.approx(
        db_from_power(budget.pulse_loss), abs=0.15
    )
    assert budget.added_islr == pytest.approx(budget.pulse_loss - 1.0)


def test_link_states_the_receiver_and_is_unchanged_without():
    plain = link_budget(scene_of())
    assert plain.receiver is None and "received" not in str(plain)
    budget = link_budget(scene_of(raw_coding="baq", baq_bits=3, dead_pulses=0.1))
    text = str(budget)
    assert (
        "signal to quantisation noise 14.6" in text
        and "coded with 3 bits" in text
        and "NESZ, received" in text
    )
    assert budget.middle.nesz == plain.middle.nesz
    assert budget.middle.nesz_received > budget.middle.nesz / 0.9
    assert budget.as_dict()["receiver"]["bits"] == 3
    assert ReceiveChain().given == ()
