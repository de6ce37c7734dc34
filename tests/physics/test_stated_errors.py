"""Errors that focusers state, and what ``auto`` makes of them, over random radars, beams, grids and scenes."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing import FOCUSERS, default_grid, focus
from sarmitsuba.focusing.focuser import parse_focuser
from sarmitsuba.focusing.focusers.backprojection import backproject, backproject_numpy
from sarmitsuba.focusing.ideal import ideal_echoes
from sarmitsuba.image.metrics import image_error_db
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.loader.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget

MARGIN = 12  # pixels from the image's ends to the outermost points


def beam_of(rng: np.random.Generator, cell: float, kinds: tuple[str, ...]) -> dict[str, Any]:
    kind = kinds[rng.integers(len(kinds))]
    if kind == "rectangular":
        size = {"antenna_length": rng.uniform(2.0, 3.0) * cell, "antenna_height": rng.uniform(0.05, 0.3)}
        return {"pattern": kind, **size}
    if kind == "gaussian":
        width = float(np.degrees(0.0156 / cell)) * rng.uniform(0.7, 1.0)
        return {
            "pattern": kind,
            "azimuth_beamwidth_deg": width,
            "elevation_beamwidth_deg": rng.uniform(8.0, 30.0),
        }
    return {"pattern": kind}


@cache
def drawn(mode: str, seed: int, *kinds: str, wander: float = 0.0) -> tuple[RawData, ImageGrid]:
    """Echoes of four points, three of them at the image's edges, of a radar drawn at random.

    The track wanders off a straight line by up to ``wander``, m.
    """
    rng = np.random.default_rng([seed, len(mode), len(kinds)])
    slant_range = float(rng.choice([3e3, 10e3, 30e3]))
    cell = float(rng.uniform(0.7, 2.0)) * (1.6 if slant_range > 2e4 else 1.0)
    radar = RadarDescription(
        mode=mode,
        slant_range=slant_range,
        look_angle_deg=rng.uniform(25.0, 60.0),
        heading_deg=rng.uniform(0.0, 360.0),
        look_side=("left", "right")[rng.integers(2)],
        squint_angle_deg=rng.uniform(-8.0, 8.0) * rng.integers(2),
        bandwidth=0.5 * SPEED_OF_LIGHT / cell,
        azimuth_resolution=cell,
        speed=100.0,
        **beam_of(rng, cell, kinds),
    )
    film = FilmDescription(
        image_grid=("slant", "ground")[rng.integers(2)],
        image_extent_azimuth=rng.uniform(40.0, 70.0) * cell,
        image_extent_range=float(rng.choice([60.0, 150.0])) * cell,
    )
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=film)
    grid, radar_there = default_grid(scene.radar, scene.image), scene.radar
    if wander:
        track = radar_there.track
        phase = np.linspace(0.0, 2.0 * np.pi, track.n_pulses)
        sway = sum(
            rng.normal(size=3) * np.sin(k * phase[:, None] + rng.uniform(0.0, 6.28, 3)) / k for k in (1, 2, 3)
        )
        position = track.position + wander * sway / np.abs(sway).max()
        velocity = np.gradient(position, track.time, axis=0)
        radar_there = replace(radar_there, track=Track(track.time, position, velocity))
    n = np.array(grid.shape)
    places = [n // 2, [MARGIN, n[1] - MARGIN], [n[0] - MARGIN, MARGIN], rng.integers(MARGIN, n - MARGIN)]
    points = []
    for row, column in places:
        one = replace(
            grid,
            azimuth=grid.azimuth[[row]] + rng.uniform(-0.5, 0.5) * grid.azimuth_spacing,
            range=grid.range[[column]] + rng.uniform(-0.5, 0.5) * grid.range_spacing,
        )
        points.append(one.positions()[0, 0])
    return ideal_echoes(radar_there, points, rng.uniform(0.5, 2.0, 4), rng.uniform(0.0, 6.28, 4)), grid


@pytest.mark.filterwarnings(
    "ignore:focus:sarmitsuba.errors.SarmitsubaWarning"
)  # edges of drawn beams are dim
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3))])
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_stated_errors_hold(mode: str, seed: int) -> None:
    """Of every focuser in the frequency domain and of polar format, against backprojection with its best kernel."""
    raw, grid = drawn(mode, seed, "isotropic", "rectangular", "gaussian")
    exact = backproject(raw, grid, interpolation="kernel:8", oversampling=4)
    tested = 0
    for name in ("omega_k", "omega_k,stolt=phase", "range_doppler", "chirp_scaling", "polar_format"):
        focuser = parse_focuser(name)
        if focuser.refusal(raw.radar, grid):
            continue
        stated = focuser.error_db(raw.radar, grid)
        if np.isnan(stated):  # too few pulses, or an image that folds over or leaves the beam
            continue
        assert image_error_db(focus(raw, grid, focuser=focuser).data, exact) < stated, name
        tested += 1
    # beams drawn narrower than the image leave nothing to test
    assert tested >= (2 if raw.radar.antenna.pattern == "isotropic" else 0)


@pytest.mark.parametrize(
    "seed", [1, 2, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (6, 7, 9, 10, 12, 13, 15, 18))]
)
def test_stated_errors_hold_on_tracks_that_wander(seed: int) -> None:
    """Compensation leaves a phase at each pixel, which is a part of what is stated."""
    raw, grid = drawn("spotlight", 40 + seed, "isotropic", wander=(0.3, 1.0, 3.0)[seed % 3])
    exact = backproject(raw, grid, interpolation="kernel:8", oversampling=4)
    taken = 0
    for name in ("omega_k", "range_doppler", "chirp_scaling"):
        try:
            image = focus(raw, grid, focuser=name)
        except DataError:  # too much motion, or a grid that lies along another line
            continue
        facts = image.metadata["focus"]
        if facts["stated_error_db"] is None:
            continue
        assert "motion_compensation" in facts
        true = image_error_db(image.data, exact)
        print(f"seed {seed} {name}: stated {facts['stated_error_db']}, true {true:.1f} dB")
        assert true < facts["stated_error_db"] + 1.0, name  # tol: what moving in range does to the envelope
        taken += 1
    assert taken


@pytest.mark.parametrize("wanted", [-40.0, -55.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_choice_keeps_the_wanted_error_of_the_exact_sum(seed: int, wanted: float) -> None:
    """Against the float64 sum by trigonometric interpolation, at pixels drawn at random and at the points' own."""
    raw, grid = drawn("spotlight", 20 + seed, "isotropic")
    image = focus(raw, grid, focuser=f"auto,error={wanted}")
    rng = np.random.default_rng(seed)
    bright = np.argsort(np.abs(image.data[0]).ravel())[-100:]
    pick = np.concatenate([bright, rng.integers(0, image.data[0].size, 100)])
    exact = backproject_numpy(raw, grid.positions().reshape(-1, 3)[pick])[0]
    assert image_error_db(image.data[0].ravel()[pick], exact) < wanted
    chosen = image.metadata["focus"]["method"]
    cheapest = {
        f.name: f.cpu_seconds(raw.radar, grid)
        for f in FOCUSERS
        if not f.refusal(raw.radar, grid) and f.error_db(raw.radar, grid) <= wanted
    }
    assert chosen == min(cheapest, key=lambda name: cheapest[name])
