"""Some pulses of a flight: `RawData.of_pulses`, `Radar.of_pulses`, `Track.of_pulses`."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from sarmitsuba.core.errors import RadarError
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.signal.raw_data import RawData
from tests.support.unweighted import focus

POINT = np.array([1.0, -2.0, 0.5])


@pytest.fixture(scope="module")
def raw() -> RawData:
    return ideal_echoes(ideal_radar(), POINT)


@pytest.mark.parametrize(
    "pick",
    [slice(None, None, 2), slice(30, -40), [3, 5, 8, 90], np.arange(154) % 3 == 1],
    ids=["slice", "part", "numbers", "mask"],
)
def test_what_is_left_is_what_a_radar_of_these_pulses_records(raw: RawData, pick: slice | ArrayLike) -> None:
    if isinstance(pick, np.ndarray):
        pick = np.resize(pick, raw.radar.track.n_pulses)
    some = raw.of_pulses(pick)
    again = ideal_echoes(some.radar, POINT)
    np.testing.assert_array_equal(some.data, again.data)
    assert some.radar.track.n_pulses == some.data.shape[1] < raw.data.shape[1]
    np.testing.assert_array_equal(some.radar.pointing.boresight, raw.radar.of_pulses(pick).pointing.boresight)


def test_half_the_aperture_is_half_as_sharp_and_as_bright(raw: RawData) -> None:
    n = raw.radar.track.n_pulses
    grid = default_grid(raw.radar)
    whole = point_target_in(focus(raw, grid))
    half = point_target_in(focus(raw.of_pulses(slice(n // 4, n // 4 + n // 2)), grid))
    # tol: the aperture's ends count half a pulse each, 1 of 77
    assert half.azimuth.irw == pytest.approx(whole.azimuth.irw * n / (n // 2), rel=0.02)
    assert half.range.irw == pytest.approx(whole.range.irw, rel=1e-3)
    assert half.rcs == pytest.approx(whole.rcs, rel=2e-3)


@pytest.mark.parametrize(
    ("pick", "text"), [([5, 3], "increase strictly"), ([10**6], "give a slice, numbers from 0")]
)
def test_pulses_that_are_not_there_or_out_of_order(raw: RawData, pick: list[int], text: str) -> None:
    with pytest.raises(RadarError, match=text):
        raw.of_pulses(pick)
    with pytest.raises(RadarError, match="n >= 1"):
        raw.of_pulses(slice(0, 0))
