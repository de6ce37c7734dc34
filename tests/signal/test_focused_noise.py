"""A point's SNR in the focused image is the predicted one, whatever the focuser, the window and the mode.

A focuser that is no matched filter, or is calibrated wrongly for its own weights, shows here.
"""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.radar.link_budget import snr
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.aperture_weights import aperture_weights, direction_gain, look_directions
from sarmitsuba.signal.focusing.focuser import FOCUSERS
from sarmitsuba.signal.focusing.ideal import ideal_echoes
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.noise import add_noise
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.geometries import random_geometry
from tests.support.unweighted import focus

RCS = 3.0


def noisy_radar(mode: str, slant_range: float, cell: float, seed: int) -> tuple[Radar, ImageGrid]:
    radar, grid = random_geometry(mode, slant_range, cell, seed)
    return replace(radar, noise_temperature=290.0), grid


def predicted(radar: Radar, points: np.ndarray, window: str) -> np.ndarray:
    """SNR of a point of ``RCS``, linear: the radar equation for one pulse, summed over the pulses with their weights.

    A pulse's echo has the amplitude g / R^2 and the weight w g R^2 in the matched sum; the noise of all has the same
    power. The band's window costs its noise-equivalent width.
    """
    gain = direction_gain(radar, slice(None), look_directions(radar, points))
    weight = aperture_weights(radar, points, window) * gain
    distance = np.linalg.norm(points[:, None] - radar.track.position, axis=-1)
    pulses = (weight * gain).sum(axis=1) ** 2 / np.sum(
        (weight * (distance / distance.mean()) ** 2) ** 2, axis=1
    )
    one = snr(radar, RCS, float(distance.mean()), 1)
    return one * pulses / parse_window(window).broadening


@pytest.mark.filterwarnings("ignore:focus. the rows")
@pytest.mark.filterwarnings(
    "ignore:.*focuser chirp_scaling has an error"
)  # noise alone, at the edges of the band
@pytest.mark.parametrize(
    ("mode", "slant_range", "cell", "seed", "window"),
    [
        ("spotlight", 10e3, 1.0, 24, "taylor"),
        ("stripmap", 10e3, 1.0, 25, "hamming"),
        ("spotlight", 700e3, 5.0, 22, "hamming"),
        pytest.param("spotlight", 10e3, 1.0, 20, "rectangular", marks=pytest.mark.slow),
        pytest.param("stripmap", 10e3, 1.0, 21, "rectangular", marks=pytest.mark.slow),
        pytest.param("stripmap", 700e3, 5.0, 23, "kaiser:2.5", marks=pytest.mark.slow),
    ],
)
def test_snr_of_a_point_is_the_predicted_one(
    mode: str, slant_range: float, cell: float, seed: int, window: str
) -> None:
    radar, grid = noisy_radar(mode, slant_range, cell, seed)
    rows, columns = (np.linspace(n // 8, n - 1 - n // 8, 9).astype(int) for n in grid.shape)
    points = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns]).positions().reshape(-1, 3)
    point = points[len(points) // 2]
    echoes = ideal_echoes(radar, point, rcs=RCS)
    # every channel has noise of its own: four draws at the price of one pass
    four = tuple(Layer(channel) for channel in ("HH", "HV", "VH", "VV"))
    silence = RawData(np.zeros_like(echoes.data).repeat(4, axis=0), four, "compressed", radar)
    noise = add_noise(silence, seed=seed)
    wanted = float(1.0 / np.mean(1.0 / predicted(radar, points, window)))
    middle = (slice(None), slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    taken = []
    for focuser in FOCUSERS:
        if not type(focuser).__module__.startswith("sarmitsuba.") or focuser.objection(radar, grid):
            continue  # other tests register focusers of their own
        taken.append(focuser.name)
        images = [
            focus(raw, grid, focuser=focuser, range_window=window, azimuth_window=window).data
            for raw in (echoes, noise)
        ]
        peak = float(abs(images[0][0, rows[4], columns[4]]) ** 2)
        assert peak == pytest.approx(RCS, rel=0.03), focuser.name  # tol: calibration, 0.13 dB
        found = peak / float(np.mean(np.abs(images[1][middle]) ** 2))
        # tol: the 0.3 dB; a mean over some 12000 cells has a sigma of 0.04 dB, 0.08 dB with a window
        assert abs(10.0 * np.log10(found / wanted)) < 0.3, (
            f"{focuser.name}: {10 * np.log10(found / wanted):.2f}"
        )
    assert {"backprojection", "omega_k", "range_doppler", "chirp_scaling"} <= set(taken)


def test_polar_format_among_them() -> None:
    """A scene small enough for plane waves, so that the focuser is not left out of all of the above."""
    radar, _ = noisy_radar("spotlight", 10e3, 1.0, 20)
    extents = {"extent_azimuth": 20.0, "extent_range": 20.0, "grid": "ground"}
    small = default_grid(radar, {"center_x": 0.0, "center_y": 0.0, "height": 0.0, **extents})
    point = small.positions_on_line(small.shape[0] // 2)[small.shape[1] // 2]
    echoes = ideal_echoes(radar, point, rcs=RCS)
    silence = RawData(np.zeros_like(echoes.data), echoes.layers, "compressed", radar)
    draws = [focus(add_noise(silence, seed=seed), small, focuser="polar_format").data for seed in range(12)]
    peak = focus(echoes, small, focuser="polar_format").data[0][small.shape[0] // 2, small.shape[1] // 2]
    found = abs(peak) ** 2 / float(np.mean(np.abs(draws) ** 2))
    wanted = float(predicted(radar, point[None], "rectangular")[0])
    # tol: the 0.3 dB; a mean over some 3000 cells has a sigma of 0.08 dB
    assert abs(10.0 * np.log10(found / wanted)) < 0.3
