"""Polar format beside backprojection: level, phase and shape of points anywhere in its image, and its refusals."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import check_focuser, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject_numpy
from sarmitsuba.signal.focusing.focusers.polar_format import LARGEST_PHASE, _WavenumberRaster
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.metrics import point_target_in
from tests.support.unweighted import focus


def asked(extent: float, grid: Literal["slant", "ground"] = "slant") -> ImageRequest:
    return ImageRequest(grid=grid, extent_azimuth=extent, extent_range=extent)


@pytest.mark.parametrize(
    ("grid", "squint", "slant_range", "resolution", "extent"),
    [
        ("slant", 0.0, 10e3, 1.0, 120.0),
        ("ground", 12.0, 10e3, 0.5, 120.0),
        pytest.param("ground", 0.0, 700e3, 3.0, 300.0, marks=pytest.mark.slow),
        *(
            pytest.param(grid, squint, *rest, marks=pytest.mark.slow)
            for grid, squint, rest in (
                ("slant", 12.0, (10e3, 1.0, 120.0)),
                ("ground", 0.0, (10e3, 1.0, 120.0)),
                ("ground", 12.0, (10e3, 1.0, 120.0)),
                ("slant", 0.0, (10e3, 0.5, 120.0)),
                ("slant", 12.0, (10e3, 0.5, 120.0)),
                ("ground", 0.0, (10e3, 0.5, 120.0)),
                ("slant", 0.0, (700e3, 3.0, 300.0)),
                ("slant", 12.0, (700e3, 3.0, 300.0)),
                ("ground", 12.0, (700e3, 3.0, 300.0)),
            )
        ),
    ],
)
def test_points_at_centre_edges_and_corners(
    slant_range: float, resolution: float, extent: float, squint: float, grid: str
) -> None:
    rng = np.random.default_rng(int(slant_range + extent + squint))
    radar = ideal_radar(
        slant_range=slant_range,
        resolution=resolution,
        squint_angle=np.radians(squint * rng.uniform(0.5, 1.0)),
        look_angle=np.radians(rng.uniform(35.0, 55.0)),
        n_samples=int(2.0 * extent) + 160,
    )
    pixels = default_grid(radar, asked(extent, grid))
    where = pixels.positions()
    rows, columns = pixels.shape
    at = [(r, c) for r in (8, rows // 2, rows - 9) for c in (8, columns // 2, columns - 9)]
    points = np.array([where[i] for i in at])
    raw = ideal_echoes(radar, points, rng.uniform(0.5, 2.0, len(at)), rng.uniform(0.0, 6.28, len(at)))
    image = focus(raw, pixels, focuser="polar_format")
    got = np.array([image.data[0][i] for i in at])
    exact = backproject_numpy(raw, points)[0]
    # tol: phase 5 degrees, level 0.1 dB: curvature at the corners, R^2 over the aperture
    assert np.abs(np.angle(got / exact)).max() < np.radians(5.0)
    assert np.abs(20.0 * np.log10(np.abs(got / exact))).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_shape_at_the_corner_of_the_largest_image(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # pixels of the largest image grow with the distance, what is left of the curvature at its corners does not
    look = np.radians(rng.uniform(35.0, 50.0))
    radar = ideal_radar(resolution=0.5, look_angle=look, n_samples=500, slant_range=4e3)
    focuser, extent = parse_focuser("polar_format"), 100.0
    while not focuser.refusal(radar, default_grid(radar, asked(extent + 20.0))):
        extent += 20.0
    half = 0.5 * extent - 15.0
    point = np.array([rng.choice([-half, half]), rng.choice([-half, half]), 0.0])
    raw = ideal_echoes(radar, point, 1.5)
    m, exact = (
        point_target_in(
            focus(raw, request=replace(asked(48.0), center_x=point[0], center_y=point[1]), focuser=name)
            if name == "backprojection"
            else focus(raw, request=asked(extent), focuser=name)
        )
        for name in ("polar_format", "backprojection")
    )
    assert m.azimuth.irw == pytest.approx(exact.azimuth.irw, rel=0.02)
    assert m.range.irw == pytest.approx(exact.range.irw, rel=0.02)
    # tol: half a dB, the curvature left at the corner
    assert m.azimuth.pslr_db == pytest.approx(exact.azimuth.pslr_db, abs=0.5)
    assert m.range.pslr_db == pytest.approx(exact.range.pslr_db, abs=0.5)
    assert m.azimuth_position == pytest.approx(
        exact.azimuth_position, abs=0.025
    )  # tol: a twentieth of a cell
    assert m.range_position == pytest.approx(exact.range_position, abs=0.05)  # tol: a twentieth of a cell


def test_it_refuses_scenes_beyond_the_literatures_radius_and_names_what_would_do() -> None:
    radar = ideal_radar(resolution=0.5, n_samples=3000)
    wavelength, distance = radar.waveform.wavelength, 10e3
    # pi lambda r^2 / (8 rho^2 R), a third of which the fit takes away
    radius = 0.5 * np.sqrt(8.0 * distance * LARGEST_PHASE / (np.pi * wavelength))
    check_focuser(parse_focuser("polar_format"), radar, default_grid(radar, asked(radius)))
    with pytest.raises(
        DataError, match=r"polar_format: the wavefront's curvature .*take focuser backprojection"
    ):
        check_focuser(parse_focuser("polar_format"), radar, default_grid(radar, asked(4.0 * radius)))


def test_a_beam_is_compensated() -> None:
    antenna = Antenna("gaussian", 1.0, np.radians(1.0), np.radians(3.0))
    radar = ideal_radar(antenna=antenna, n_samples=320)
    points = np.array([[0.0, 0.0, 0.0], [25.0, 30.0, 0.0]])
    raw = ideal_echoes(radar, points, [1.0, 2.0])
    image = focus(raw, request=asked(80.0), focuser="polar_format")
    peak = point_target_in(image)
    assert 10.0 * np.log10(peak.rcs / 2.0) == pytest.approx(
        0.0, abs=0.1
    )  # tol: gain varies over the aperture


@pytest.mark.parametrize("seed", range(3))
def test_the_raster_is_the_sum_over_samples(seed: int) -> None:
    """Samples on a polar raster against their sum at every pixel, for image and aperture of any shape."""
    rng = np.random.default_rng(seed)
    turn = np.radians(np.linspace(-1.0, 1.0, 40)) * rng.uniform(1.0, 4.0)
    k = np.linspace(390.0, 400.0, 50) + rng.uniform(-5.0, 5.0)
    slope = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    extent = rng.uniform(5.0, 30.0, 2)
    places = rng.uniform(-0.5, 0.5, (200, 2)) * extent + rng.uniform(-3.0, 3.0, 2)
    samples = rng.standard_normal((2, 40, 50))
    samples = (samples[0] + 1j * samples[1]).astype(np.complex64)
    raster = _WavenumberRaster.of(k * slope[:, :, None], places)
    got = raster.forward(samples.ravel())
    wave = (k[None, :, None] * slope[:, None, :]).reshape(-1, 2)
    exact = np.exp(1j * places @ wave.T) @ samples.ravel().astype(np.complex128)
    # tol: two kernels of six taps at twice the rate, -103 dB each at the band's rms, -90 dB at its edge; float32
    assert 20.0 * np.log10(np.linalg.norm(got - exact) / np.linalg.norm(exact)) < -80.0
