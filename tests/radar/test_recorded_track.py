"""The track flown and the track that the focuser is told."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import RadarError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.track_errors import TrackError
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing.ideal import ideal_echoes
from tests.support.unweighted import render


def scene_with(**more: object) -> sarmitsuba.Scene:
    radar = RadarDescription(
        mode="spotlight", bandwidth=150e6, azimuth_resolution=2.0, prf=100.0, aim_x=0.0, aim_y=0.0, **more
    )  # type: ignore[arg-type]
    film = FilmDescription(image_extent_azimuth=30.0, image_extent_range=30.0)
    return build_scene(points=[PointTarget("p", np.zeros(3), 1.0)], radar=radar, film=film)


def test_echoes_are_of_the_track_flown_and_the_radar_is_told_the_other(tmp_path: Path) -> None:
    scene = scene_with(track_offset_across=0.4, track_drift_up=0.2, track_jitter=0.05, track_jitter_seed=3)
    plain = scene_with()
    raw, true = sarmitsuba.simulate(scene), sarmitsuba.simulate(plain)
    np.testing.assert_array_equal(raw.data, true.data)
    assert raw.flown is not None and true.flown is None
    np.testing.assert_array_equal(raw.flown.position, true.radar.track.position)
    told = raw.radar.track.position - raw.flown.position
    assert raw.radar.recorded is None and told[:, 0].mean() == pytest.approx(0.4, abs=1e-9)

    raw.save(tmp_path / "raw.h5")
    again = sarmitsuba.read_raw(tmp_path / "raw.h5")
    assert again.flown is not None
    np.testing.assert_array_equal(again.radar.track.position, raw.radar.track.position + raw.radar.offset)
    np.testing.assert_array_equal(again.flown.position, raw.flown.position + raw.radar.offset)
    # and the echoes are those of the point from the track flown
    exact = ideal_echoes(plain.radar, np.zeros(3)).data
    assert np.linalg.norm(raw.data - exact) / np.linalg.norm(exact) < 0.01  # tol: gridding_width 4


@pytest.mark.parametrize("seed", range(4))
def test_error_model(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    track = Track.straight([0.0, 0.0, 4e3], 90.0 * along, 200.0, 4000)
    offset, drift = rng.uniform(-1.0, 1.0, 3), rng.uniform(-0.1, 0.1, 3)
    axes = np.array([along, [along[1], -along[0], 0.0], [0.0, 0.0, 1.0]])
    plain = TrackError(tuple(offset), tuple(drift)).recorded(track).position - track.position
    want = (offset + track.time[:, None] * drift) @ axes
    np.testing.assert_allclose(plain, want, atol=1e-9)  # tol: rounding at 4 km

    error = TrackError(jitter=0.1, corner=1.0, slope=4.0, seed=seed)
    jitter = (error.recorded(track).position - track.position) @ axes.T
    np.testing.assert_allclose(np.sqrt(np.mean(jitter**2, axis=0)), 0.1, rtol=1e-6)  # tol: rounding
    np.testing.assert_array_equal(error.recorded(track).position, error.recorded(track).position)
    # of the power law 1 / (1 + f^4), 99.9 % lies below 8 Hz, and above 2 Hz only some percent
    power = np.abs(np.fft.rfft(jitter * np.hanning(track.n_pulses)[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(track.n_pulses, 1.0 / 200.0)
    above = [float(power[frequency > f].sum() / power.sum()) for f in (2.0, 8.0)]
    assert above[0] < 0.15 and above[1] < 2e-3  # tol: few degrees of freedom


def test_recorded_track_file(tmp_path: Path) -> None:
    plain = scene_with()
    track, offset = plain.radar.track, plain.radar.offset
    told = track.position + offset + np.array([0.0, 0.0, 0.3])
    table = np.column_stack([track.time, told])
    file = tmp_path / "told.csv"
    np.savetxt(file, table, delimiter=",", fmt="%.17g")
    scene = scene_with(recorded_track_file=str(file))
    assert scene.radar.recorded is not None
    np.testing.assert_allclose(
        scene.radar.recorded.position - track.position, [[0, 0, 0.3]] * len(told), atol=1e-9
    )
    np.savetxt(file, table[1:], delimiter=",", fmt="%.17g")
    with pytest.raises(RadarError, match="pulses are recorded and"):
        scene_with(recorded_track_file=str(file))
    table[:, 0] *= 1.1
    np.savetxt(file, table, delimiter=",", fmt="%.17g")
    with pytest.raises(RadarError, match="its pulse times differ"):
        scene_with(recorded_track_file=str(file))
    with pytest.raises(RadarError, match="track_jitter has no effect beside recorded_track_file"):
        scene_with(recorded_track_file=str(file), track_jitter=0.1)
    with pytest.raises(RadarError, match="track_jitter_seed has no effect without track_jitter"):
        scene_with(track_jitter_seed=4)
    with pytest.raises(RadarError, match="methods image and raster make no raw data"):
        render(scene_with(track_offset_up=0.1), method="image")
