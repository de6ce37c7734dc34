"""Factorised backprojection is backprojection, to the error that it states, on any track."""

import dataclasses

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.factorised.division import Plan
from sarmitsuba.signal.focusing.factorised.sampling import (
    ROW_BAND,
    SubimageSampling,
    refinement_error,
    refinement_weights,
    row_polynomials,
)
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject_numpy
from sarmitsuba.signal.focusing.focusers.factorised import Factorised
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.unweighted import focus

EXACT = "backprojection,interpolation=kernel:8,oversampling=4"


def band_noise(radar: Radar, seed: int, n_layers: int = 1) -> RawData:
    """Noise that fills the band in range and all pulses: no sample is spared an error."""
    rng = np.random.default_rng(seed)
    shape = (n_layers, radar.track.n_pulses, radar.window.n_samples)
    spectrum = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    spectrum[..., np.abs(np.fft.fftfreq(shape[-1])) > 0.5 / 1.2] = 0.0
    layers = tuple(Layer("VV", order=i) for i in range(n_layers))
    return RawData(np.fft.ifft(spectrum).astype(np.complex64), layers, "compressed", radar)


def on_a_curve(radar: Radar, rng: np.random.Generator) -> Radar:
    """The radar on a track bent in all three dimensions, with pulses at uneven places."""
    track = radar.track
    u = np.linspace(-1.0, 1.0, track.n_pulses)
    length = float(np.ptp(track.position[:, 1]))
    bend = np.outer(u**2, rng.uniform(-0.1, 0.1, 3) * length)
    bend += np.outer(np.sin(3.0 * u), rng.uniform(-0.02, 0.02, 3) * length)
    jitter = rng.uniform(-0.2, 0.2, (track.n_pulses, 3)) * length / track.n_pulses
    curved = Track.from_samples(track.time, track.position + bend + jitter)
    distance = np.linalg.norm(curved.position, axis=1)
    window = radar.window
    half = 0.5 * window.n_samples * window.sample_spacing
    return dataclasses.replace(
        radar, track=curved, window=dataclasses.replace(window, start_range=distance - half)
    )


@pytest.mark.parametrize("seed", [2, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 1))])
def test_it_is_the_exact_sum_on_random_curved_tracks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radar = ideal_radar(
        slant_range=float(rng.uniform(1e3, 8e3)),
        resolution=float(rng.uniform(0.4, 0.9)),
        bandwidth=float(rng.uniform(150e6, 500e6)),
        squint_angle=float(rng.uniform(-0.3, 0.3)),
        look_angle=float(rng.uniform(0.5, 1.1)),
        n_samples=400,
    )
    radar = on_a_curve(radar, rng)
    kind = "slant" if seed % 2 else "ground"
    grid = default_grid(radar, ImageRequest(grid=kind, extent_azimuth=40.0, extent_range=40.0))
    raw = band_noise(radar, seed)
    pick = rng.integers(0, grid.shape[0] * grid.shape[1], 150)
    exact = backproject_numpy(raw, grid.positions().reshape(-1, 3)[pick])
    for options in ("", ",stages=2", ",stages=3,error=-60", ",stages=4"):
        focuser = parse_focuser("factorised" + options)
        assert isinstance(focuser, Factorised)
        image = focus(raw, grid, focuser=focuser).data.reshape(1, -1)[:, pick]
        stated = focuser.error_db(radar, grid)
        assert stated <= focuser.error, options
        assert image_error_db(image, exact) < stated, options


@pytest.mark.parametrize(("squint", "on_rows"), [(0.0, True), (0.5, False)])
def test_rows_that_recede_are_interpolated_in_angle_first(squint: float, on_rows: bool) -> None:
    radar = ideal_radar(slant_range=3e3, resolution=0.4, bandwidth=300e6, squint_angle=squint, n_samples=400)
    grid = default_grid(radar, ImageRequest(grid="ground", extent_azimuth=50.0, extent_range=40.0))
    focuser = Factorised(error=-60.0)
    plan = focuser.plan(radar, grid)
    assert isinstance(plan, Plan) and {section.on_rows for section in plan.sections} == {on_rows}
    raw = band_noise(radar, 9)
    # the first and last rows are the least radial
    pick = np.concatenate([np.arange(5, 40), 60 + np.arange(20) * grid.shape[1], np.arange(-40, -5)])
    exact = backproject_numpy(raw, grid.positions().reshape(-1, 3)[pick])
    image = focus(raw, grid, focuser=focuser).data.reshape(1, -1)[:, pick]
    assert image_error_db(image, exact) < focuser.error_db(radar, grid) <= -60.0


@pytest.mark.parametrize("upsampling", [1.5, 2.0, 3.1])
def test_weights_along_rows_interpolate_a_band(upsampling: float) -> None:
    rng = np.random.default_rng(13)
    turns = rng.uniform(-0.5, 0.5, 40) / upsampling  # cycles per sample
    for x in rng.uniform(0.0, 1.0, 20):
        weights = np.zeros(8)
        for k, (even, odd) in enumerate(row_polynomials(upsampling)):
            parts = [np.polynomial.polynomial.polyval((x - 0.5) ** 2, part) for part in (even, odd)]
            weights[[k, 7 - k]] = parts[0] + np.array([1.0, -1.0]) * parts[1] * (x - 0.5)
        found = np.exp(2j * np.pi * np.outer(turns, np.arange(-3, 5))) @ weights
        wrong = np.abs(found - np.exp(2j * np.pi * turns * x))
        # tol: the worst frequency and place over the mean of all
        assert wrong.max() < 6.0 * refinement_error(upsampling / (1.0 + ROW_BAND)) + 1e-5


@pytest.mark.parametrize(("slant_range", "resolution"), [(10e3, 0.7), (700e3, 3.0)])
def test_points_at_the_corners_are_calibrated(slant_range: float, resolution: float) -> None:
    radar = ideal_radar(slant_range=slant_range, resolution=resolution, n_samples=256)
    grid = default_grid(radar, ImageRequest(extent_azimuth=80.0, extent_range=80.0))
    rows, columns = ([4, -5, grid.shape[0] // 2], [4, -5, grid.shape[1] // 2])
    points = np.array([grid.positions()[i, j] for i, j in zip(rows, columns, strict=True)])
    raw = ideal_echoes(radar, points, rcs=2.5, phase=0.7)
    image = focus(raw, grid, focuser="factorised").data[0]
    exact = backproject_numpy(raw, points)[0]
    for i, j, value in zip(rows, columns, exact, strict=True):
        # tol: the stated -50 dB
        assert abs(image[i, j] / value - 1.0) < 10 ** (-50 / 20)
        assert abs(abs(image[i, j]) ** 2 / 2.5 - 1.0) < 0.05  # tol: sidelobes of the other points
        assert abs(np.angle(image[i, j] * np.exp(-0.7j))) < np.radians(3.0)  # tol: the same


def test_the_antenna_weighs_as_in_backprojection() -> None:
    radar = ideal_radar(
        slant_range=4e3,
        resolution=0.5,
        bandwidth=300e6,
        n_samples=400,
        antenna=Antenna("rectangular", 1e3, 0.02, 0.04),
    )
    raw = band_noise(radar, 5)
    grid = default_grid(radar, ImageRequest(extent_azimuth=70.0, extent_range=60.0))
    for window in ("rectangular", "hann"):
        exact = focus(raw, grid, focuser=EXACT, azimuth_window=window).data
        image = focus(raw, grid, focuser="factorised", azimuth_window=window).data
        assert image_error_db(image, exact) < Factorised().error_db(radar, grid)


def under_a_narrow_beam(seed: int) -> tuple[RawData, ImageGrid]:
    """Noise and an image off the beam's centre, at whose corners the two-way power has fallen by 5 to 13 dB."""
    rng = np.random.default_rng(seed)
    slant_range, look = rng.uniform(1.5e3, 4e3), rng.uniform(0.6, 1.0)
    extent = rng.uniform(0.04, 0.06, 2) * slant_range
    widths = np.sqrt(np.log(rng.uniform(3.0, 20.0)) / np.log(4.0)) * rng.dirichlet([1.0, 1.0]) ** 0.5
    angles = 0.65 * extent / slant_range * (1.0, np.cos(look))
    antenna = Antenna(
        str(rng.choice(["gaussian", "rectangular"])), 1e3, *(2.0 * angles / np.maximum(widths, 0.05))
    )
    radar = ideal_radar(
        slant_range=slant_range,
        look_angle=look,
        squint_angle=float(rng.choice([0.0, rng.uniform(-0.4, 0.4)])),
        resolution=1.0,
        bandwidth=150e6,
        n_samples=int(1.3 * np.hypot(*extent) / 0.8),
        antenna=antenna,
    )
    request = ImageRequest(
        grid="ground",
        extent_azimuth=extent[0],
        extent_range=extent[1],
        spacing_azimuth=extent[0] / 160,
        spacing_range=extent[1] / 120,
    )
    grid = default_grid(radar, request)
    away = 0.15 * extent * rng.choice([-1.0, 1.0], 2)
    grid = dataclasses.replace(grid, azimuth=grid.azimuth + away[0], range=grid.range + away[1])
    return band_noise(radar, seed), grid


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(n, marks=pytest.mark.slow) for n in range(3, 20))])
@pytest.mark.parametrize("wanted", [-50.0, -65.0])
def test_a_beam_that_falls_across_the_image_leaves_the_stated_error(seed: int, wanted: float) -> None:
    """The sum of weights is interpolated, as accurately as the image is made."""
    raw, grid = under_a_narrow_beam(seed)
    focuser = Factorised(error=wanted)
    exact = focus(raw, grid, focuser=EXACT).data
    stated = focuser.error_db(raw.radar, grid)
    assert stated <= wanted + 0.5
    assert image_error_db(focus(raw, grid, focuser=focuser).data, exact) < stated


def stripmap() -> Radar:
    """Track three apertures long; every pixel has its own, at whose end the two-way beam has fallen by 9 dB."""
    radar = ideal_radar(
        slant_range=3e3,
        resolution=0.3,
        bandwidth=300e6,
        n_samples=500,
        mode="stripmap",
        antenna=Antenna("gaussian", 1e3, 0.03, 0.5),
    )
    track, n = radar.track, radar.track.n_pulses
    step = (track.position[-1] - track.position[0]) / (n - 1)
    prf = 1.0 / float(np.diff(track.time).mean())
    longer = Track.straight(track.center_position, track.velocity[0], prf, 3 * n)
    assert np.allclose(np.diff(longer.position, axis=0), step)
    pointing = dataclasses.replace(
        radar.pointing,
        **{
            name: np.repeat(getattr(radar.pointing, name)[n // 2][None], 3 * n, axis=0)
            for name in ("boresight", "azimuth_axis", "elevation_axis")
        },
    )
    start = np.full(3 * n, 3e3 - 250 * radar.window.sample_spacing)
    window = dataclasses.replace(radar.window, start_range=start)
    return dataclasses.replace(radar, track=longer, pointing=pointing, window=window, half_aperture=0.018)


@pytest.mark.slow
def test_pixels_with_their_own_apertures() -> None:
    radar = stripmap()
    raw = band_noise(radar, 6)
    grid = default_grid(radar, ImageRequest(grid="ground", extent_azimuth=200.0, extent_range=25.0))
    focuser = Factorised(error=-36.0)
    plan = focuser.plan(radar, grid)
    assert isinstance(plan, Plan) and len(plan.sections) > 1 and plan.merges == 0
    for window in ("rectangular", "hamming"):
        exact = focus(raw, grid, focuser=EXACT, azimuth_window=window).data
        image = focus(raw, grid, focuser=focuser, azimuth_window=window).data
        assert image_error_db(image, exact) < focuser.error_db(radar, grid) <= -36.0
    # sharp ends and a small error: no gain over the plain sum
    sharp = dataclasses.replace(radar, antenna=Antenna())
    with pytest.raises(
        DataError, match=r"factorised: the pixels' own apertures end so sharply.*backprojection"
    ):
        focus(dataclasses.replace(raw, radar=sharp), grid, focuser="factorised,error=-60")


def test_layers_are_focused_alike() -> None:
    radar = ideal_radar(resolution=1.0, n_samples=200)
    raw = band_noise(radar, 7, n_layers=3)
    grid = default_grid(radar, ImageRequest(extent_azimuth=30.0, extent_range=30.0))
    together = focus(raw, grid, focuser="factorised").data
    for i in range(3):
        alone = dataclasses.replace(raw, data=raw.data[i : i + 1], layers=raw.layers[i : i + 1])
        # tol: order of float32 sums
        assert image_error_db(together[i : i + 1], focus(alone, grid, focuser="factorised").data) < -110.0


def test_what_it_refuses() -> None:
    radar = ideal_radar(resolution=1.0, n_samples=2000, look_angle=0.05, slant_range=2e3)
    raw = band_noise(radar, 8)
    request = ImageRequest(grid="ground", extent_azimuth=10.0, extent_range=400.0)
    with pytest.raises(
        DataError, match=r"factorised: the image extends below the track; take focuser .*backproj"
    ):
        focus(raw, default_grid(radar, request), focuser="factorised")
    radar = ideal_radar(resolution=1.0, n_samples=100)
    grid = default_grid(radar, ImageRequest(extent_azimuth=10.0, extent_range=300.0))
    with pytest.raises(DataError, match=r"the image leaves the receive window.*take focuser backprojection"):
        focus(band_noise(radar, 9), grid, focuser="factorised")
    for options, message in (
        ("stages=5", "stages = 5 must be"),
        ("upsampling=1.2", "upsampling = 1.2 must be from 1.5 to 4, or 0"),
    ):
        with pytest.raises(DataError, match=message):
            focus(band_noise(radar, 9), grid, focuser=f"factorised,{options}")


def test_the_error_falls_with_the_upsampling() -> None:
    radar = ideal_radar(resolution=0.7, n_samples=300)
    raw = band_noise(radar, 10)
    grid = default_grid(radar, ImageRequest(extent_azimuth=40.0, extent_range=40.0))
    exact = focus(raw, grid, focuser=EXACT).data
    errors = []
    for upsampling in (1.5, 1.75, 2.0):
        focuser = Factorised(error=-30.0, upsampling=upsampling, stages=3)
        errors.append(image_error_db(focus(raw, grid, focuser=focuser).data, exact))
        assert errors[-1] < focuser.error_db(radar, grid)
        # a prediction, not only a bound; tol: pulses that do not fill the grid's band by prf_factor and a few samples
        assert errors[-1] > focuser.error_db(radar, grid) - 15.0
    assert errors[0] > errors[1] + 5.0 > errors[2] + 10.0


@pytest.mark.parametrize("upsampling", [1.75, 2.0])
def test_the_refinement_is_as_good_as_stated(upsampling: float) -> None:
    rng = np.random.default_rng(11)
    n, ratio = 4096, 8
    band = np.abs(np.fft.fftfreq(n)) < 0.5 / upsampling
    spectrum = (rng.standard_normal(n) + 1j * rng.standard_normal(n)) * band
    signal = np.fft.ifft(spectrum)
    weights = np.array(refinement_weights(upsampling, ratio))
    for j in range(ratio):
        shift = (j + 0.5) / ratio
        exact = np.fft.ifft(spectrum * np.exp(2j * np.pi * np.fft.fftfreq(n) * shift))
        value = sum(weights[j, k] * np.roll(signal, 3 - k) for k in range(8))
        error = np.linalg.norm(value - exact) / np.linalg.norm(exact)
        assert error < 2.0 * refinement_error(upsampling)  # tol: the worst place over the mean of all
    assert SubimageSampling(upsampling, 6).error_db(1) < SubimageSampling(upsampling, 4).error_db(1)


def test_auto_takes_it_for_large_images_on_curved_tracks() -> None:
    rng = np.random.default_rng(12)
    radar = on_a_curve(ideal_radar(slant_range=5e3, resolution=0.2, bandwidth=600e6, n_samples=3000), rng)
    request = ImageRequest(grid="ground", extent_azimuth=200.0, extent_range=200.0)
    chosen, reason = parse_focuser("auto").resolved(radar, default_grid(radar, request))
    assert chosen.name == "factorised" and "backprojection" in reason
    chosen, _ = parse_focuser("auto,error=-50").resolved(radar, default_grid(radar, request))
    assert chosen.name == "factorised"
    chosen, _ = parse_focuser("auto,error=-95").resolved(radar, default_grid(radar, request))
    assert chosen.name == "backprojection"
