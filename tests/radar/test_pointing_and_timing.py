"""A beam that points elsewhere than the focuser is told, and pulses at uneven times."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.aperture import PulseIntervals
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.mode import StraightPath
from sarmitsuba.radar.track_errors import PointingError
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Method, TraceSettings
from sarmitsuba.signal.metrics import image_error_db
from tests.support.unweighted import focus, render

BEAM = {"pattern": "gaussian", "azimuth_beamwidth_deg": 2.0, "elevation_beamwidth_deg": 6.0}


def point_scene(**more: object) -> Scene:
    values = {"mode": "stripmap", "bandwidth": 150e6, "azimuth_resolution": 2.0, "prf": 150.0, **more}
    radar = RadarDescription(aim_x=0.0, aim_y=0.0, slant_range=2e3, **values)  # type: ignore[arg-type]
    film = FilmDescription(image_extent_azimuth=30.0, image_extent_range=30.0)
    return build_scene(points=[PointTarget("p", np.zeros(3), 1.0)], radar=radar, film=film)


@pytest.mark.parametrize("seed", range(3))
def test_the_beam_turns_in_azimuth_and_elevation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boresight, along, up = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    n = 400
    nominal = Pointing(*(np.broadcast_to(v, (n, 3)) for v in (boresight, along, up)))
    time = np.linspace(-2.0, 2.0, n)
    offset, drift = rng.uniform(-0.05, 0.05, 2), rng.uniform(-0.01, 0.01, 2)
    true = PointingError(tuple(offset), tuple(drift)).flown(nominal, time)
    want = offset + time[:, None] * drift
    azimuth = np.arctan2(true.boresight @ along, true.boresight @ boresight)
    elevation = np.arcsin(true.boresight @ up)
    np.testing.assert_allclose(np.stack([azimuth, elevation], axis=1), want, atol=1e-12)
    triad = np.stack([true.boresight, true.azimuth_axis, true.elevation_axis], axis=1)
    np.testing.assert_allclose(
        triad @ triad.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (n, 3, 3)), atol=1e-12
    )
    jitter = PointingError(jitter=1e-3, corner=2.0, seed=seed).angles(time)
    assert np.sqrt((jitter**2).mean(axis=0)) == pytest.approx([1e-3, 1e-3])
    assert abs(np.corrcoef(jitter.T)[0, 1]) < 0.9  # two series


def test_the_focuser_is_told_the_nominal_beam(tmp_path: Path) -> None:
    plain = point_scene(**BEAM)
    off = point_scene(
        **BEAM, pointing_error_azimuth_deg=0.5, pointing_drift_elevation_deg=0.1, pointing_jitter_deg=0.02
    )
    assert plain.radar.recorded_pointing is None
    raw, true = sarmitsuba.simulate(off), sarmitsuba.simulate(plain)
    np.testing.assert_array_equal(raw.radar.pointing.boresight, true.radar.pointing.boresight)
    assert raw.radar.recorded_pointing is None
    u = -plain.radar.track.position / np.linalg.norm(plain.radar.track.position, axis=1)[:, None]
    gains = [
        r.antenna.two_way_amplitude(
            np.sum(u * r.pointing.azimuth_axis, axis=1), np.sum(u * r.pointing.elevation_axis, axis=1)
        )
        for r in (off.radar, plain.radar)
    ]
    got = np.linalg.norm(raw.data[0], axis=1) / np.linalg.norm(true.data[0], axis=1)
    np.testing.assert_allclose(got, gains[0] / gains[1], rtol=1e-5)  # tol: float32 profiles
    raw.save(tmp_path / "raw.h5")
    again = sarmitsuba.read_raw(tmp_path / "raw.h5")
    np.testing.assert_array_equal(again.radar.pointing.boresight, raw.radar.pointing.boresight)
    some = off.radar.of_pulses(slice(0, 9))
    assert some.recorded_pointing is not None and some.recorded_pointing.boresight.shape == (9, 3)
    with pytest.raises(
        RadarError, match="methods image and raster make no raw data, so that a pointing error"
    ):
        render(off, method="image")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"pointing_error_azimuth_deg": 0.1}, "has no effect with pattern = isotropic"),
        ({**BEAM, "pointing_jitter_seed": 3}, "has no effect without pointing_jitter_deg"),
        ({"prf_jitter_seed": 3}, "has no effect without prf_jitter"),
        ({"pri_sequence": "1,0"}, "is not a list of intervals above 0"),
        ({"pri_sequence": "1"}, "is not a list of intervals above 0"),
        ({"pri_sequence": "ramp:3"}, "is not a list of intervals above 0"),
        ({"pri_sequence": "ramp:30:2"}, "is not a list of intervals above 0"),
        ({"pri_sequence": "1,two"}, "is not a list of intervals above 0"),
        ({"prf_jitter": 0.3}, "above the bound 0.2"),
    ],
)
def test_parameters_without_effect_are_refused(values: dict[str, object], said: str) -> None:
    with pytest.raises(RadarError) as caught:
        point_scene(**values)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_times_of_pulses() -> None:
    even = PulseIntervals().times(250.0, 9)
    np.testing.assert_allclose(even, (np.arange(9) - 4.0) / 250.0, atol=1e-15)
    turns = PulseIntervals(sequence=(0.8, 1.0, 1.2)).times(100.0, 10)
    np.testing.assert_allclose(np.diff(turns), np.tile([0.008, 0.010, 0.012], 3), atol=1e-15)
    assert turns[0] == -turns[-1]
    random = np.diff(PulseIntervals(jitter=0.1, seed=4).times(100.0, 20001)) * 100.0
    assert random.mean() == pytest.approx(1.0, abs=5 * 0.1 / np.sqrt(20000))  # tol: 5 sigma
    assert random.std() == pytest.approx(0.1, rel=5 / np.sqrt(40000))  # tol: 5 sigma
    assert abs(np.corrcoef(random[1:], random[:-1])[0, 1]) < 5 / np.sqrt(20000)  # independent
    path = StraightPath(np.array([1.0, 2.0, 3.0]), np.array([0.0, 50.0, 0.0]))
    track = PulseIntervals(sequence=(0.5, 1.5)).track(path, 100.0, 5)
    np.testing.assert_allclose(track.position[:, 1], 2.0 + 50.0 * track.time)
    ramp = point_scene(pri_sequence="ramp:20:0.4").radar.track.time
    assert np.diff(ramp)[[0, 19]] * 150.0 == pytest.approx([1.2, 0.8])
    # what is off leaves the track as it was, bit by bit
    np.testing.assert_array_equal(
        point_scene().radar.track.time, point_scene(pri_sequence="").radar.track.time
    )


def test_focusers_of_even_pulses_refuse_uneven_ones_in_one_line() -> None:
    raw = sarmitsuba.simulate(point_scene(prf_jitter=0.1, mode="spotlight"))
    for focuser in ("omega_k", "range_doppler", "chirp_scaling"):
        with pytest.raises(DataError, match="intervals between pulses differ by up to") as caught:
            focus(raw, focuser=focuser)
        assert "take focuser backprojection" in str(caught.value) and "\n" not in str(caught.value)
        with pytest.raises(DataError, match="not uniformly sampled"):
            focus(raw, focuser=focuser, motion_compensation="off")
    assert np.abs(focus(raw).total()).max() == pytest.approx(1.0, rel=0.01)  # tol: the peak between pixels


def test_blocks_of_uneven_pulses_are_those_traced_one_by_one() -> None:
    def scene(method: Method) -> Scene:
        soil = {
            "material": "medium_dry_ground",
            "rms_height": 0.05,
            "diffuse_law": "constant",
            "diffuse_level_db": -10.0,
        }
        corners = np.array([[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0], [8.0, 8.0, 0.0], [-8.0, 8.0, 0.0]])
        radar = RadarDescription(
            slant_range=1e3,
            azimuth_resolution=1.0,
            bandwidth=150e6,
            pri_sequence="ramp:15:0.8",
            prf_jitter=0.05,
            **BEAM,
        )  # type: ignore[arg-type]
        return build_scene(
            [SceneMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground")],
            radar=radar,
            film=FilmDescription(image_extent_azimuth=12.0, image_extent_range=12.0),
            settings=TraceSettings(method=method),
        )

    hybrid, raw = (sarmitsuba.simulate(scene(method), seed=1) for method in ("hybrid", "raw"))
    assert hybrid.metadata["sampling"]["key_pulse_interval"] > 8
    error = image_error_db(focus(hybrid).total(), focus(raw).total())
    # tol: other rays find the scatterers; even pulses -39 dB (settings.tolerance_db = -40)
    assert error < -36.0
