"""Noise and signal that a link budget predicts are those of the focused image of an empty scene, with one point."""

from dataclasses import replace

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.analysis.link_budget import LinkBudget, link_budget
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.truth.validation.measured_noise import empty_echoes, focused_noise, focused_peak

# of the noise, in four channels each: as many cells where only the rows about the aim point count
DRAWS = {"stripmap": 4, "spotlight": 12}


def drawn_scene(mode: str, seed: int) -> sarmitsuba.Scene:
    """A radar 10 km away whose beam fades towards both ends of the swath; every other one points a little wrongly."""
    rng = np.random.default_rng([15, seed])
    radar = RadarDescription(
        mode=mode,
        slant_range=rng.uniform(8e3, 12e3),
        look_angle_deg=rng.uniform(35.0, 55.0),
        heading_deg=rng.uniform(0.0, 360.0),
        look_side=("left", "right")[rng.integers(2)],
        squint_angle_deg=rng.uniform(-4.0, 4.0),
        bandwidth=150e6,
        azimuth_resolution=1.3,
        pattern=("rectangular", "gaussian")[rng.integers(2)],
        antenna_length=2.0,
        antenna_height=0.8,
        gain_db=rng.uniform(20.0, 30.0),
        transmit_power=rng.uniform(1.0, 50.0),
        losses_db=rng.uniform(0.0, 4.0),
        noise_temperature=rng.uniform(300.0, 900.0),
        pointing_error_azimuth_deg=0.3 * (seed % 2),
        pointing_error_elevation_deg=0.2 * (seed % 2),
    )
    film = FilmDescription(image_extent_azimuth=70.0, image_extent_range=280.0)
    return build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=film)


def measured(scene: sarmitsuba.Scene, budget: LinkBudget, window: str, seed: int) -> np.ndarray:
    """(places, 2) NESZ and SNR of the point, dB, from focused noise and focused echoes of a point at every place.

    The noise is that of some columns, brought to the place's own by the predicted slope over the swath.
    """
    radar = scene.radar
    grid = default_grid(radar, scene.image)
    draws = [empty_echoes(radar, seed=20 * seed + i) for i in range(DRAWS[radar.mode])]
    row = grid.azimuth.size // 2
    # where the beam is held on the aim point, it fades towards the first and last rows
    rows = slice(None) if np.isfinite(radar.half_aperture) else slice(row - 12, row + 13)
    columns = [0, grid.range.size // 2, grid.range.size - 1]
    slope = np.polyfit(columns, [10.0 * np.log10(place.nesz) for place in budget.places], 2)
    found = []
    for column in columns:
        around = slice(max(column - 20, 0), column + 21)
        strip = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[around])
        power, nesz = np.mean([focused_noise(noise, strip, window) for noise in draws], axis=0)
        fit = np.polyval(slope, np.arange(grid.range.size)[around])
        here = float(np.mean(10.0 ** (0.1 * (fit - np.polyval(slope, column)))))
        found.append((nesz / here, focused_peak(radar, grid, row, column, window) / power * here))
    return 10.0 * np.log10(np.array(found))


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # rows of one pixel
@pytest.mark.parametrize(
    ("mode", "seed", "window"),
    [
        pytest.param("stripmap", 1, "taylor", marks=pytest.mark.slow),
        ("stripmap", 2, "rectangular"),
        pytest.param("stripmap", 3, "taylor", marks=pytest.mark.slow),
        pytest.param("stripmap", 4, "hamming", marks=pytest.mark.slow),
        pytest.param("spotlight", 5, "taylor", marks=pytest.mark.slow),
        pytest.param("spotlight", 6, "rectangular", marks=pytest.mark.slow),
        pytest.param("spotlight", 7, "kaiser:2.5", marks=pytest.mark.slow),
    ],
)
def test_predicted_noise_and_signal_are_the_focused_ones(mode: str, seed: int, window: str) -> None:
    scene = drawn_scene(mode, seed)
    budget = link_budget(scene, range_window=window, azimuth_window=window)
    wanted = 10.0 * np.log10([[place.nesz, place.snr] for place in budget.places])
    # the beam fades over the swath, or the test would not tell
    assert np.ptp(wanted[:, 0]) > 1.0
    # tol: the 0.3 dB; a mean over some 2000 cells has a sigma of 0.1 dB
    assert np.abs(measured(scene, budget, window, seed) - wanted).max() < 0.3
