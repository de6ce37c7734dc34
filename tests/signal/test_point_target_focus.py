"""Point targets and clutter through the focusers: width, sidelobes, place, phase and calibration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError, SarmitsubaWarning
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.focusers.omega_k import omega_k
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.profiles import band_weights
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import image_error_db, point_target_in
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.draws import few_of
from tests.support.unweighted import focus

METHODS = ("backprojection", "omega_k", "range_doppler", "chirp_scaling")
# the point lies off every pixel
POINT = np.array([3.37, -4.21, 0.0])


def request(extent: float = 36.0, center: Any = (0.0, 0.0), **changes: Any) -> dict[str, Any]:
    return {
        "grid": "slant",
        "center_x": center[0],
        "center_y": center[1],
        "height": 0.0,
        "extent_azimuth": extent,
        "extent_range": extent,
        "spacing_azimuth": 0.0,
        "spacing_range": 0.0,
        **changes,
    }


def expected_place(image: SarImage, point: np.ndarray) -> tuple[float, float]:
    """Grid coordinates of a scene point: zero Doppler on slant grids, metres on ground grids."""
    line = point - image.grid.origin
    along, across = float(line @ image.grid.along), float(line @ image.grid.across)
    if image.grid.kind == "ground":
        return along, across
    return along, float(np.hypot(across, image.grid.origin[2] - point[2]))


def check(image: SarImage, radar: Radar, point: np.ndarray, rcs: float, squint: float = 0.0) -> None:
    m = point_target_in(image, squint_angle=squint)
    azimuth_cell, range_cell = image.azimuth_resolution_cell, radar.waveform.range_cell
    # tol: the 2 % and 0.3 dB; 1/20 cell; 0.05 dB
    assert m.azimuth.irw / azimuth_cell == pytest.approx(0.8859, rel=0.02)
    assert m.range.irw / range_cell == pytest.approx(0.8859, rel=0.02)
    assert m.azimuth.pslr_db == pytest.approx(-13.26, abs=0.3)
    assert m.range.pslr_db == pytest.approx(-13.26, abs=0.3)
    along, across = expected_place(image, point)
    assert abs(m.azimuth_position - along) < azimuth_cell / 20
    assert abs(m.range_position - across) < range_cell / 20
    assert abs(10 * np.log10(m.rcs / rcs)) < 0.05


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("slant_range", "resolution"), [(10e3, 1.0), (700e3, 3.0)])
def test_point_target_quality(method: Any, slant_range: float, resolution: float) -> None:
    radar = ideal_radar(slant_range=slant_range, resolution=resolution)
    raw = ideal_echoes(radar, POINT, rcs=2.5, phase=0.6)
    image = focus(raw, focuser=method, request=request(48.0 * resolution**0.5))
    check(image, radar, POINT, 2.5)


def test_phase_at_the_point_is_the_targets_own() -> None:
    radar = ideal_radar()
    grid = default_grid(radar, request(8.0, center=POINT))
    raw = ideal_echoes(radar, POINT, rcs=2.5, phase=0.6)
    for data in (backproject(raw, grid), omega_k(raw, grid), backproject(raw, POINT[None])[:, None]):
        pixel = data[0, data.shape[1] // 2, data.shape[2] // 2] if data.ndim == 3 else data[0, 0, 0]
        # tol: the receive window cuts the profile's tails
        assert abs(pixel - np.sqrt(2.5) * np.exp(0.6j)) < 2e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("squint_deg", [-10.0, 25.0])
def test_squinted_point_target(method: Any, squint_deg: float) -> None:
    squint = np.radians(squint_deg)
    radar = ideal_radar(squint_angle=squint, n_samples=320)
    raw = ideal_echoes(radar, POINT, rcs=2.5)
    image = focus(raw, focuser=method, request=request(48.0))
    m = point_target_in(image, squint_angle=squint, chip=72)
    assert m.range.irw / radar.waveform.range_cell == pytest.approx(0.8859, rel=0.02)
    assert m.azimuth.irw / 1.0 == pytest.approx(0.8859, rel=0.02)
    assert m.azimuth.pslr_db == pytest.approx(-13.26, abs=0.3)
    assert m.range.pslr_db == pytest.approx(-13.26, abs=0.3)
    along, across = expected_place(image, POINT)
    assert abs(m.azimuth_position - along) < 0.05
    assert abs(m.range_position - across) < 0.05
    assert abs(10 * np.log10(m.rcs / 2.5)) < 0.05


def test_ground_grid_and_height() -> None:
    radar = ideal_radar()
    point = np.array([2.0, 3.0, 12.0])
    image = focus(ideal_echoes(radar, point), request=request(grid="ground", height=12.0))
    m = point_target_in(image)
    assert (m.azimuth_position, m.range_position) == pytest.approx((3.0, 2.0), abs=0.05)
    # a point above the image plane is laid over towards the radar by h / tan(incidence), here 45 degrees
    flat = point_target_in(focus(ideal_echoes(radar, point), request=request(grid="ground")))
    assert flat.range_position == pytest.approx(2.0 - 12.0, abs=0.1)  # tol: the wavefront curves by h^2 / R


def test_curved_track_focuses_by_backprojection_only() -> None:
    plain = ideal_radar()
    t = plain.track.time
    wobble = np.stack([0.8 * np.sin(9 * t), 0 * t, 0.5 * np.cos(5 * t)], axis=1)
    track = Track.from_samples(t, plain.track.position + wobble)
    r = np.linalg.norm(track.position, axis=1)
    window = replace(plain.window, start_range=r - 128 * plain.window.sample_spacing)
    radar = replace(plain, track=track, window=window)
    raw = ideal_echoes(radar, POINT, rcs=2.5)
    points = POINT + np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, -0.2, 0]])
    value = np.abs(backproject(raw, points)[0]) ** 2
    assert abs(10 * np.log10(value[0] / 2.5)) < 0.05
    assert value.argmax() == 0
    with pytest.raises(DataError, match="curved"):
        omega_k(raw, default_grid(plain, request()))


@pytest.mark.parametrize("range_window", ["rectangular", "hamming"])
@pytest.mark.parametrize("azimuth_window", ["rectangular", "taylor"])
def test_focusers_agree_pixel_by_pixel(range_window: str, azimuth_window: str) -> None:
    radar = ideal_radar(squint_angle=0.1)
    raw = ideal_echoes(
        radar, [POINT, [-20.0, 14.0, 0.0], [9.0, 17.0, 0.0]], rcs=[1.0, 2.0, 0.5], phase=[0, 1, 2]
    )
    grid = default_grid(radar, request(60.0))
    windows = {"range_window": range_window, "azimuth_window": azimuth_window}
    # tol: stationary phase of the track transform, ripple of the aperture's edges beyond the raised PRF
    assert image_error_db(omega_k(raw, grid, **windows), backproject(raw, grid, **windows)) < -60.0


@pytest.mark.parametrize("range_window", ["rectangular", "taylor", "hann"])
def test_rcs_does_not_depend_on_the_setting(range_window: str) -> None:
    settings: list[dict[str, Any]] = [
        {"slant_range": 1e3, "resolution": 0.5},
        {"slant_range": 100e3, "resolution": 5.0},
        {"prf_factor": 3.0},
        {"bandwidth": 30e6, "resolution": 6.0},
        {"center_frequency": 1.3e9, "resolution": 3.0},
        {"antenna": Antenna("gaussian", 30.0, 0.02, 0.2)},
        {"antenna": Antenna("rectangular", 30.0, 0.01, 0.2), "mode": "stripmap", "resolution": 0.5},
    ]
    for setting in settings:
        radar = ideal_radar(**setting)
        raw = ideal_echoes(radar, POINT, rcs=2.5)
        value = backproject(raw, POINT[None], range_window=range_window, azimuth_window="hamming")[0, 0]
        grid = default_grid(radar, request(8.0, center=POINT))
        windows = {"range_window": range_window, "azimuth_window": "hamming"}
        pixel = omega_k(raw, grid, **windows)[0, grid.shape[0] // 2, grid.shape[1] // 2]
        # tol: cut tails of the range profile
        assert abs(20 * np.log10(abs(value)) - 10 * np.log10(2.5)) < 0.02, setting
        assert abs(20 * np.log10(abs(pixel)) - 10 * np.log10(2.5)) < 0.02, setting


def test_chirped_data_give_the_same_image() -> None:
    radar = ideal_radar(pulse_width=1e-6)
    raw = ideal_echoes(radar, POINT, rcs=2.5)
    direct = focus(raw, request=request(16.0))
    chirped = focus(to_chirped(raw), request=request(16.0))
    # tol: the chirp's inverse works on profiles with cut tails
    assert image_error_db(chirped.data, direct.data) < -40.0
    check(focus(to_chirped(raw), request=request()), radar, POINT, 2.5)


def test_layers_stay_apart_and_pixels_outside_the_window_are_zero() -> None:
    radar = ideal_radar(n_samples=64)
    one = ideal_echoes(radar, POINT)
    layers = tuple(Layer("VV", order) for order in range(1, 7))
    data = np.concatenate([one.data * (n + 1) for n in range(6)])
    raw = RawData(data.astype(np.complex64), layers, "compressed", radar)
    for method in METHODS:
        image = focus(raw, focuser=method, request=request(120.0, spacing_azimuth=4.0))
        for n in range(1, 6):
            np.testing.assert_allclose(image.data[n], (n + 1) * image.data[0], atol=1e-5)
        outside = np.abs(image.grid.range - 10e3) > 30.0
        assert outside.any() and not image.data[:, :, outside].any()
        assert image.layers == layers


def test_beam_that_misses_gives_zero_not_noise() -> None:
    radar = ideal_radar(antenna=Antenna("gaussian", 1.0, 0.002, 0.2))
    raw = ideal_echoes(radar, POINT)
    noisy = replace(raw, data=raw.data + np.float32(1e-9))
    pixels = backproject(noisy, [[0.0, 0.0, 0.0], [0.0, 120.0, 0.0]])
    assert abs(pixels[0, 0]) > 0 and pixels[0, 1] == 0


def test_wide_image_at_a_low_prf_is_named_and_refused_in_omega_k() -> None:
    """What folds over looks different in each focuser, and holds a third of the image's energy."""
    radar = ideal_radar(resolution=2.0)
    raw = ideal_echoes(radar, POINT)
    with (
        pytest.warns(SarmitsubaWarning, match="times the PRF"),
        pytest.raises(DataError, match="of no use; take focuser backprojection"),
    ):
        focus(raw, focuser="omega_k", request=request(20.0, extent_azimuth=600.0, spacing_azimuth=4.0))


def clutter(radar: Radar, n: int, extent: float, seed: int) -> RawData:
    """Echoes of n circular Gaussian points spread evenly over a square, sigma0 = 1 (ranges kept to 1/64 sample)."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (n, 3)) * [extent, extent, 0.0]
    amplitude = np.sqrt(0.5 * extent**2 / n) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    window, fine = radar.window, 64
    size = 2 * window.n_samples
    bins = np.rint(np.fft.fftfreq(size) * size).astype(int)
    rate = window.sampling_rate / radar.waveform.bandwidth
    band = band_weights(size, rate, 1.0, parse_window("rectangular")) * rate
    data = np.empty((1, radar.track.n_pulses, window.n_samples), dtype=np.complex64)
    for t, antenna in enumerate(radar.track.position):
        r = np.linalg.norm(points - antenna, axis=1)
        a = amplitude * radar.amplitude_constant / r**2 * np.exp(-4j * np.pi / radar.waveform.wavelength * r)
        i = np.rint((r - window.start_range[t]) / window.sample_spacing * fine).astype(int)
        inside = (i >= 0) & (i < size * fine)
        real, imag = (np.bincount(i[inside], part[inside], size * fine) for part in (a.real, a.imag))
        data[0, t] = np.fft.ifft(np.fft.fft(real + 1j * imag)[bins] * band)[: window.n_samples]
    return RawData(data, (Layer("VV"),), "compressed", radar)


@pytest.mark.slow
@pytest.mark.parametrize(("squint", "seeds"), [(0.0, (1, 2)), (0.3, (3,))])
def test_clutter_has_its_sigma0(squint: float, seeds: tuple[int, ...]) -> None:
    radar = ideal_radar(squint_angle=squint, n_samples=400, resolution=1.0, prf_factor=1.6)
    means: dict[str, list[float]] = {}
    for seed in seeds:
        raw = clutter(radar, 50000, 190.0, seed)
        for method in METHODS:
            for window in ("rectangular", "taylor"):
                image = focus(
                    raw, focuser=method, range_window=window, azimuth_window=window, request=request(140.0)
                )
                means.setdefault(f"{method} {window}", []).append(float(image.sigma0().mean()))
    for values in means.values():
        # tol: sigma of the mean over 1.4e4 cells a seed with 1.4 points a cell is 0.05 dB
        assert abs(10 * np.log10(np.mean(values))) < 0.15 / np.sqrt(len(values)), means


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("squint", few_of([0.3, 0.0]))
@pytest.mark.parametrize(("range_window", "azimuth_window"), [("hamming", "hamming"), ("hann", "taylor")])
def test_energy_of_the_impulse_response_is_the_cells_area(
    method: Any, squint: float, range_window: str, azimuth_window: str
) -> None:
    """Parseval: clutter of sigma0 = 1 has the mean intensity sum |h|^2 dA, which must be the cell's area."""
    radar = ideal_radar(squint_angle=squint, n_samples=320)
    image = focus(
        ideal_echoes(radar, np.zeros(3)),
        focuser=method,
        range_window=range_window,
        azimuth_window=azimuth_window,
        request=request(110.0),
    )
    # ground area of a pixel: slant range to ground range by the broadside incidence angle
    broadside = np.arccos(radar.track.center_position[2] / image.grid.range)
    pixel = image.grid.azimuth_spacing * image.grid.range_spacing / np.sin(broadside)
    energy = float((image.rcs() * pixel[None, :]).sum())
    center = image.cell_area[tuple(n // 2 for n in image.grid.shape)]
    assert abs(10 * np.log10(energy / center)) < 0.03  # tol: sidelobes beyond the image


def test_cell_grows_with_range_under_a_fixed_aperture() -> None:
    radar = ideal_radar(slant_range=1e3, resolution=0.5, n_samples=400)
    image = focus(ideal_echoes(radar, np.zeros(3)), request=request(200.0, spacing_azimuth=5.0))
    azimuth = image.cell_area[0] * np.sin(image.incidence_angle) / image.range_resolution_cell
    r = image.grid.range
    # tol: the aperture's curvature, (L / R)^2
    np.testing.assert_allclose(azimuth / azimuth[r.size // 2], r / r[r.size // 2], rtol=2e-3)
