"""The receive chain of a scene: parameters, refusals, and the run that obeys its switch."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, build_scene, render, simulate
from sarmitsuba.apps.fit.forward_model import refuse
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.signal.receive import receive

RADAR = RadarDescription(
    slant_range=2e3,
    bandwidth=75e6,
    azimuth_resolution=4.0,
    noise_temperature=300.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
FILM = FilmDescription(image_extent_azimuth=20.0, image_extent_range=20.0)
POINTS = [PointTarget("a", np.zeros(3), 1.0), PointTarget("b", np.array([3.0, 2.0, 0.0]), 0.1)]


def scene_of(**changes):
    """Two points seen by a radar with these parameters."""
    return build_scene([], POINTS, radar=replace(RADAR, **changes), film=FILM)


def test_run_receives_what_the_chain_says_and_the_switch_leaves_it_out():
    ideal = scene_of(noise_temperature=0.0)
    scene = scene_of(adc_bits=3, dead_pulses=0.2, phase_noise="10:-50,1000:-70")
    echoes = simulate(ideal, seed=2)
    expected = receive(replace(echoes, radar=scene.radar), seed=2)
    raw = simulate(scene, seed=2)
    assert np.array_equal(raw.data, expected.data)
    assert raw.metadata["receive_chain"]["dead_pulses"] == round(0.2 * scene.radar.track.n_pulses)
    off = scene_of(noise_temperature=0.0, dead_pulses=0.2).replace(receive_chain="off")
    with pytest.warns(SarmitsubaWarning, match="receive_chain is switched off"):
        assert np.array_equal(simulate(off, seed=2).data, echoes.data)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"raw_coding": "baq", "noise_temperature": 0.0}, "raw_coding = baq .* give noise_temperature"),
        ({"baq_bits": 2}, "baq_bits has no effect with raw_coding = none"),
        (
            {"fdbaq_margin_db": 2.0, "raw_coding": "baq"},
            "fdbaq_margin_db has no effect with raw_coding = baq",
        ),
        ({"phase_noise": "100:-90,10:-60"}, "phase_noise .* ascending"),
        ({"phase_noise": "10"}, "is no list of frequency:level"),
        ({"receive_distortion": "1,0,0"}, "is no invertible matrix"),
        ({"receive_distortion": "1,1,1,1", "polarisation": "HH,HV,VH,VV"}, "is no invertible matrix"),
        ({"transmit_distortion": "1,0.1,0,1", "polarisation": "HH,HV"}, "mixes channels with VH, VV"),
        ({"transmit_distortion": "1,0,0,2", "polarisation": "RH,RV"}, "transmitted in H and V"),
        (
            {"transmit_gaps": True, "receiver_offset_along": 50.0},
            "transmit_gaps is of a receiver that shares",
        ),
    ],
)
def test_contradictions_are_one_line(changes, words):
    with pytest.raises(RadarError, match=words) as error:
        scene_of(**changes)
    assert "\n" not in str(error.value)


def test_methods_without_raw_data_and_derivatives_refuse():
    scene = scene_of(iq_phase_deg=3.0)
    for method in ("image", "raster"):
        with pytest.raises(RadarError, match="make no raw data, so that iq_phase_deg has no effect"):
            render(scene, method=method)
    with pytest.raises(RadarError, match="iq_phase_deg of the receiver cannot be differentiated"):
        refuse(scene)
