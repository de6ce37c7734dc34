"""Every focuser on images drawn anywhere along the strip, against exact backprojection: level, phase, stated error."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import FOCUSERS, default_grid
from sarmitsuba.signal.focusing.focuser import check_focuser, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.ideal import ideal_echoes
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from tests.support.unweighted import focus

# factorised backprojection with its wanted error takes no pixels with apertures of their own, which are many here
NAMES = (
    "omega_k",
    "omega_k,stolt=phase",
    "range_doppler",
    "chirp_scaling",
    "polar_format",
    "factorised",
    "factorised,error=-25",
)
# images at the edge of the beam or at the strip's end are said to be so
SAID = "ignore:focus:sarmitsuba.core.errors.SarmitsubaWarning"


def radar_and_image(
    description: RadarDescription, *, strip: float, size: float, kind: str, away: float, across: float = 0.0
) -> tuple[Radar, ImageGrid]:
    """A radar whose track serves a strip (m) about its aim point, and an image of a size (m) elsewhere on it."""
    film = FilmDescription(
        image_grid="slant" if kind == "slant" else "ground",
        image_extent_azimuth=strip,
        image_extent_range=1.3 * size + 2.0 * abs(across),
    )
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=description, film=film)
    radar = scene.radar
    center = radar.aim_point + away * radar.track.along + across * radar.across
    request = {
        "grid": kind,
        "center_x": center[0],
        "center_y": center[1],
        "height": center[2],
        "extent_azimuth": size,
        "extent_range": size,
        "spacing_azimuth": 0.0,
        "spacing_range": 0.0,
    }
    return radar, default_grid(radar, request)


def drawn(seed: int) -> tuple[Radar, ImageGrid, str]:
    """Radar, image and azimuth window; squint to 30 degrees, P to X band, 5 to 700 km, the strip's ends among them."""
    rng = np.random.default_rng([77, seed])
    mode = ("stripmap", "stripmap", "stripmap", "spotlight", "sliding_spotlight")[rng.integers(5)]
    bands = [(9.6e9, 5e3, 0.9), (5.4e9, 20e3, 3.0), (1.3e9, 8e3, 2.0), (435e6, 5e3, 3.0), (9.6e9, 700e3, 6.0)]
    frequency, slant_range, cell = bands[rng.integers(len(bands))]
    cell *= float(rng.uniform(0.9, 1.5))
    squint = float(rng.uniform(-30.0, 30.0)) * (rng.random() < 0.7)
    wavelength = SPEED_OF_LIGHT / frequency
    aperture = wavelength * slant_range / (2.0 * cell * np.cos(np.radians(squint)) ** 2)
    beams: list[dict[str, Any]] = [
        {
            "pattern": "rectangular",
            "antenna_length": rng.uniform(2.0, 3.0) * cell,
            "antenna_height": 0.6 * wavelength,
        },
        {
            "pattern": "gaussian",
            "azimuth_beamwidth_deg": np.degrees(wavelength / (2.0 * cell)) * rng.uniform(0.7, 1.1),
            "elevation_beamwidth_deg": rng.uniform(10.0, 60.0),
        },
        {"pattern": "isotropic"},
    ]
    strip, size = float(rng.uniform(1.0, 4.0)) * aperture, float(rng.uniform(25.0, 50.0)) * cell
    away = float(rng.uniform(-0.5, 0.5)) * (strip if mode != "spotlight" else min(aperture, 60.0 * cell))
    at_end = mode == "stripmap" and rng.random() < 0.15
    if at_end:
        away = float(rng.choice([-1.0, 1.0])) * (0.5 * strip + float(rng.uniform(-0.2, 0.4)) * aperture)
    # many rates are below the beam's bandwidth: what folds over then does so in every focuser's image
    pulses = {"prf": float(rng.uniform(0.55, 1.0)) * 1.25 * 200.0 / cell} if rng.random() < 0.2 else {}
    radar = RadarDescription(
        mode=mode,
        slant_range=slant_range,
        look_angle_deg=float(rng.uniform(33.0, 55.0)),
        heading_deg=float(rng.uniform(0.0, 360.0)),
        look_side=("left", "right")[rng.integers(2)],
        squint_angle_deg=squint,
        center_frequency=frequency,
        bandwidth=min(0.5 * SPEED_OF_LIGHT / cell, 0.3 * frequency),
        azimuth_resolution=cell,
        speed=100.0,
        mode_parameters={"sliding_factor": float(rng.uniform(0.3, 1.0))} if "sliding" in mode else {},
        **beams[rng.integers(3 if mode != "stripmap" else 2)],
        **(pulses if mode == "stripmap" else {}),
    )
    image = {
        "strip": strip if at_end else 2.0 * abs(away) + 1.2 * size,
        "size": size,
        "kind": ("slant", "ground")[rng.integers(2)],
        "away": away,
        "across": float(rng.uniform(-30.0, 30.0)) * cell * (rng.random() < 0.5),
    }
    window = ("rectangular", "rectangular", "taylor", "hann")[rng.integers(4)]
    return *radar_and_image(radar, **image), window


def check(radar: Radar, grid: ImageGrid, window: str = "rectangular", seed: int = 0) -> list[str]:
    """Compare every focuser that does not refuse with exact backprojection; names of those that did."""
    rng = np.random.default_rng(seed)
    n = np.array(grid.shape)
    edge = np.minimum(12, n // 4)
    places = [tuple(n // 2), (edge[0], n[1] - edge[1] - 1), tuple(rng.integers(edge, n - edge))]
    positions = grid.positions()
    points = np.array([positions[place] for place in places])
    raw = ideal_echoes(radar, points, rng.uniform(0.5, 2.0, 3), rng.uniform(0.0, 6.28, 3))
    exact = backproject(raw, grid, interpolation="kernel:8", oversampling=4, azimuth_window=window)[0]
    focused = []
    for name in NAMES:
        focuser = parse_focuser(name)
        if focuser.objection(radar, grid):
            continue
        stated = focuser.error_db(radar, grid)
        if stated > -20.0:  # says itself that it is no good
            continue
        image = focus(raw, grid, focuser=focuser, azimuth_window=window).data[0]
        for place in places:
            ratio = complex(image[place] / exact[place])
            # tol: the bounds asked for; factorised backprojection spreads its error, of the wanted -25 dB, evenly
            level = 0.05 if "error" not in name else 0.5
            assert abs(20.0 * np.log10(abs(ratio))) < level, (name, place)
            assert abs(np.degrees(np.angle(ratio))) < 6.0, (name, place)
        if np.isfinite(stated):  # none for few pulses and for images that leave the beam
            assert image_error_db(image, exact) < stated + 3.0, (name, stated)
        focused.append(name)
    return focused


def at(
    away: float, *, cell: float = 1.0, kind: str = "slant", size: float = 40.0, **changes: Any
) -> tuple[Radar, ImageGrid]:
    """An image of ``size`` cells ``away`` metres along the strip of a stripmap radar."""
    wavelength = SPEED_OF_LIGHT / changes.get("center_frequency", 9.6e9)
    radar = RadarDescription(
        **{
            "mode": "stripmap",
            "slant_range": 5e3,
            "look_angle_deg": 45.0,
            "bandwidth": 0.5 * SPEED_OF_LIGHT / cell,
            "azimuth_resolution": cell,
            "pattern": "rectangular",
            "antenna_length": 2.0 * cell,
            "antenna_height": max(0.05, 0.6 * wavelength),
            "speed": 100.0,
            **changes,
        }
    )
    return radar_and_image(radar, strip=2.0 * abs(away) + size * cell, size=size * cell, kind=kind, away=away)


EIGHT = [
    (80.0, {}),
    (95.0, {}),
    (150.0, {}),
    (400.0, {}),
    (1800.0, {"center_frequency": 5.4e9, "slant_range": 20e3, "cell": 3.0}),
    (100.0, {"center_frequency": 435e6, "cell": 3.0, "squint_angle_deg": -23.0, "look_angle_deg": 50.0}),
    (
        -300.0,
        {"slant_range": 10e3, "cell": 0.7, "squint_angle_deg": 8.0, "heading_deg": 77.0, "kind": "ground"},
    ),
    (
        500.0,
        {
            "center_frequency": 1.3e9,
            "slant_range": 8e3,
            "cell": 2.0,
            "squint_angle_deg": 15.0,
            "look_side": "left",
        },
    ),
]


# one of each kind in the fast part
@pytest.mark.parametrize(
    ("away", "changes"),
    [pytest.param(*case, marks=[] if i in (0, 2, 5) else pytest.mark.slow) for i, case in enumerate(EIGHT)],
)
def test_a_point_keeps_its_level_away_from_the_aim_point(away: float, changes: dict[str, Any]) -> None:
    """The middle of the Doppler band is the boresight's, not the direction of the image's centre."""
    radar, grid = at(away, **changes)
    assert "omega_k" in check(radar, grid)


@pytest.mark.filterwarnings(SAID, "ignore:RadarDescription:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("seed", [1, 16, *(pytest.param(n, marks=pytest.mark.slow) for n in range(100, 180))])
def test_drawn_images_anywhere_on_the_strip(seed: int) -> None:
    try:
        radar, grid, window = drawn(seed)
    except SarmitsubaError as refused:
        pytest.skip(str(refused))
    check(radar, grid, window, seed)


@pytest.mark.parametrize("prf", [75.0, 110.0])
@pytest.mark.filterwarnings("ignore:RadarDescription:sarmitsuba.core.errors.SarmitsubaWarning")
def test_pulses_too_few_for_the_aperture_fold_over_as_they_do_in_backprojection(prf: float) -> None:
    radar, grid = at(120.0, prf=prf)
    assert 2.0 * radar.half_aperture > 0.5 * radar.waveform.wavelength / (100.0 / prf) * 0.8
    assert "omega_k" in check(radar, grid)


def short(seed: int) -> tuple[Radar, ImageGrid, str]:
    """Pixels' own apertures of a time-bandwidth product of 4 to 20: some twenty pulses, in a tapered window."""
    rng = np.random.default_rng([78, seed])
    cell = float(rng.uniform(1.5, 3.0))
    product = float(rng.uniform(4.0, 20.0))
    radar, grid = at(
        float(rng.uniform(-30.0, 30.0)) * cell,
        cell=cell,
        size=50.0,
        kind=("slant", "ground")[rng.integers(2)],
        center_frequency=9.65e9,
        slant_range=max(product * 2.0 * cell**2 / 0.0311, 900.0),
        squint_angle_deg=float(rng.uniform(-15.0, 15.0)) * rng.integers(2),
        antenna_length=float(rng.uniform(1.1, 2.0)) * cell,
        antenna_height=0.3,
    )
    return radar, grid, ("hamming", "hann", "taylor", "rectangular")[rng.integers(4)]


@pytest.mark.filterwarnings(SAID, "ignore:RadarDescription:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("window", ["hamming", pytest.param("rectangular", marks=pytest.mark.slow)])
def test_apertures_of_few_pulses_keep_the_stated_error(window: str) -> None:
    """A window bends so much within such an aperture that stationary phase to second order misses its level."""
    beam = {"antenna_length": 3.0, "antenna_height": 0.3, "look_angle_deg": 35.0}
    radar, grid = at(0.0, cell=2.5, size=53.0, center_frequency=9.65e9, slant_range=3e3, prf=108.33, **beam)
    assert 2.0 * radar.half_aperture * 3e3 / (100.0 / 108.33) < 25.0
    assert "omega_k" in check(radar, grid, window)


@pytest.mark.slow
@pytest.mark.filterwarnings(SAID, "ignore:RadarDescription:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("seed", range(12))
def test_drawn_apertures_of_few_pulses(seed: int) -> None:
    try:
        radar, grid, window = short(seed)
    except SarmitsubaError as refused:
        pytest.skip(str(refused))
    check(radar, grid, window, seed)


def test_the_choice_keeps_the_wanted_error_along_the_strip() -> None:
    radar, grid = at(150.0, size=90.0)
    raw = ideal_echoes(radar, grid.positions()[grid.shape[0] // 2, grid.shape[1] // 2])
    image = focus(raw, grid, focuser="auto,error=-25")
    exact = backproject(raw, grid, interpolation="kernel:8", oversampling=4)
    assert image.metadata["focus"]["method"] != "backprojection"
    assert image_error_db(image.data, exact) < -25.0


@pytest.mark.parametrize("pattern", ["isotropic", "rectangular"])
def test_a_beam_that_turns_is_accepted_where_it_is_deramped(pattern: str) -> None:
    """Sliding spotlight: pixels' own apertures, about a boresight that turns, whatever the antenna."""
    radar, grid = at(20.0, mode="sliding_spotlight", mode_parameters={"sliding_factor": 0.5})
    assert np.isfinite(radar.half_aperture)
    radar = replace(radar, antenna=replace(radar.antenna, pattern=pattern))
    for name in ("omega_k", "range_doppler", "chirp_scaling"):
        check_focuser(parse_focuser(name), radar, grid)
    with pytest.raises(SarmitsubaError, match=r"its own aperture.*backprojection"):
        check_focuser(FOCUSERS["polar_format"], radar, grid)


def test_an_aperture_along_the_track_is_refused() -> None:
    radar, grid = at(0.0, squint_angle_deg=30.0)
    wide = replace(radar, half_aperture=0.6)
    with pytest.raises(SarmitsubaError, match="degrees off broadside"):
        check_focuser(FOCUSERS["omega_k"], wide, grid)
