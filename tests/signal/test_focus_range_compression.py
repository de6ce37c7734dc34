"""Range compression against the echo stage's chirp."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.range_compression import compression_filter, range_compress
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import RawData


def echoes(pulse_width: float, positions: list[list[float]]) -> RawData:
    radar = ideal_radar(n_samples=300, pulse_width=pulse_width, resolution=20.0)
    return ideal_echoes(radar, positions, phase=0.3)


@pytest.mark.parametrize("pulse_width", [0.4e-6, 2e-6, 20e-6])
def test_flat_compression_undoes_the_chirp(pulse_width: float) -> None:
    raw = echoes(pulse_width, [[0, 0, 0], [30, 0, 0]])
    back = range_compress(to_chirped(raw), method="flat")
    assert back.domain == "compressed" and back.data.shape == raw.data.shape
    middle = slice(60, 240)
    # tol: the sinc's tails are cut at the window's ends, which blurs the band's edge by a bin
    assert image_error_db(back.data[..., middle], raw.data[..., middle]) < -40.0


@pytest.mark.parametrize("method", ["flat", "matched"])
@pytest.mark.parametrize("pulse_width", [0.4e-6, 2e-6, 20e-6])
def test_a_points_peak_is_unbiased(method: str, pulse_width: float) -> None:
    raw = echoes(pulse_width, [[0, 0, 0]])
    # put the point exactly on a sample of pulse 0
    r = np.linalg.norm(raw.radar.track.position, axis=1)
    start = r - 150 * raw.radar.window.sample_spacing
    radar = replace(raw.radar, window=replace(raw.radar.window, start_range=start))
    raw = ideal_echoes(radar, [0, 0, 0], phase=0.3)
    back = range_compress(to_chirped(raw), method=method)
    ratio = back.data[0, :, 150] / raw.data[0, :, 150]
    np.testing.assert_allclose(20 * np.log10(np.abs(ratio)), 0.0, atol=0.01)  # tol: the required 0.01 dB
    np.testing.assert_allclose(np.angle(ratio), 0.0, atol=2e-3)  # tol: cut tails


def test_filter_is_zero_outside_the_band() -> None:
    radar = ideal_radar(n_samples=64)
    for method in ("flat", "matched"):
        response = compression_filter(radar, 4096, method)
        outside = np.abs(np.fft.fftfreq(4096)) > 0.5 / 1.2 + 1 / 4096
        assert not response[outside].any()


def test_compressed_data_pass_and_wrong_ones_do_not() -> None:
    raw = echoes(2e-6, [[0, 0, 0]])
    assert range_compress(raw) is raw
    chirped = to_chirped(raw)
    with pytest.raises(DataError, match="matched"):
        range_compress(chirped, method="best")
    with pytest.raises(DataError, match="samples per pulse"):
        range_compress(replace(chirped, data=chirped.data[..., :-5]))
