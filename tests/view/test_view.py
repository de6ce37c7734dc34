"""Pictures show power honestly: no smoothing, equal metres, robust limits, files that appear whole."""

import dataclasses
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from scipy.signal import windows

from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.view.display import QUANTITIES, TURNTABLE, PictureOptions, limits_db, prepare, screen_size
from sarmitsuba.view.profile import cut_profile, profile
from sarmitsuba.view.quicklook import (
    bounce_orders,
    draw,
    panel,
    pixels,
    png,
    quicklook,
    quicklook_by_order,
    save,
)


def make_image(n_azimuth: int, n_range: int, spacing: tuple[float, float], orders: int = 0) -> SarImage:
    rng = np.random.default_rng(3)
    layers = tuple(Layer("VV", i + 1) for i in range(orders)) or (Layer("VV"),)
    shape = (len(layers), n_azimuth, n_range)
    data = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    grid = ImageGrid(
        "slant",
        np.arange(n_azimuth) * spacing[0],
        9000.0 + np.arange(n_range) * spacing[1],
        np.array([0.0, 0.0, 5000.0]),
        np.array([0.0, 1.0, 0.0]),
        np.array([1.0, 0.0, 0.0]),
    )
    metadata = {"scene": "test", "look_side": "right"}
    return SarImage(data, layers, grid, 0.031, 0.5, 0.5, np.full(n_range, 0.6), metadata)


def test_small_image_is_magnified_by_whole_pixels_in_equal_metres() -> None:
    image = make_image(50, 80, (0.5, 0.25))
    display = prepare(image, PictureOptions(), 1600)
    assert display.averaged == (1, 1)
    width, height = screen_size(display, 1600, 640)
    assert width % 80 == 0
    assert width / (80 * 0.25) == pytest.approx(height / (50 * 0.5), rel=0.01)  # tol: whole screen pixels
    assert max(width, height) >= 640


def test_large_image_is_power_averaged() -> None:
    image = make_image(900, 700, (0.5, 0.5))
    power = image.rcs()
    display = prepare(image, PictureOptions(quantity="rcs", looks=(1, 1)), 300)
    assert display.averaged == (3, 3)
    assert display.values.shape == (300, 233)
    kept = power[:900, :699]
    # tol: float rounding
    assert np.mean(10 ** (display.values / 10)) == pytest.approx(kept.mean(), rel=1e-12)
    assert display.extent[1] - display.extent[0] == pytest.approx(699 * 0.5)  # tol: float rounding
    assert max(screen_size(display, 300, 100)) <= 301


@pytest.mark.parametrize("shape", [(1, 1), (1, 500), (500, 1), (3000, 2)])
def test_odd_shapes_are_drawn(tmp_path: Path, shape: tuple[int, int]) -> None:
    save(quicklook(make_image(*shape, (0.3, 0.3))), tmp_path / "q.png")
    assert (tmp_path / "q.png").stat().st_size > 1000


def decibels(power: np.ndarray) -> np.ndarray:
    return 10.0 * np.log10(power + 1e-30)


def town(empty: float, seed: int = 4) -> np.ndarray:
    """Power (400, 400) of one look: streets, ground and roofs 10 dB apart, corners, and a margin of side lobes."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice([-10.0, 0.0, 8.0], size=(40, 40)).repeat(10, axis=0).repeat(10, axis=1)
    power = rng.exponential(size=(400, 400)) * 10.0 ** (kinds / 10.0)
    rows = int(400 * empty)
    power[:rows] *= 10.0 ** (-2.0 - 4.0 * rng.random((rows, 400)))
    corners = rng.integers(rows, 400, 160), rng.integers(0, 400, 160)
    power[corners] = 10.0 ** rng.uniform(3.0, 6.0, 160)  # a thousandth of the pixels
    return power


@pytest.mark.parametrize("clutter", [True, None])
@pytest.mark.parametrize("empty", [0.0, 0.2, 0.4, 0.55])
def test_a_city_is_not_black_however_much_of_the_picture_is_empty(empty: float, clutter: bool | None) -> None:
    values = decibels(town(empty))
    low, high = limits_db(values, clutter=clutter)
    lit = values[int(400 * empty) :]
    grey = np.clip((lit - low) / (high - low), 0.0, 1.0)
    # a tenth of the scale is black: some of the streets' speckle, and no more
    assert (grey < 0.1).mean() < 0.15
    assert 0.25 < np.median(grey) < 0.65
    assert (grey >= 1.0).mean() < 0.02


def test_side_lobes_of_corners_do_not_hide_the_clutter_that_an_image_is_known_to_hold() -> None:
    """Lines of side lobes 20 to 60 dB over the clutter cross a third of the picture."""
    rng = np.random.default_rng(1)
    power = rng.exponential(size=(400, 400))
    gain = np.ones(400)
    gain[rng.integers(0, 400, 100)] = 10.0 ** rng.uniform(1.5, 5.0, 100)
    low, high = limits_db(decibels(power * gain[:, None]), clutter=True)
    # tol: side lobes within 20 dB of the clutter count with it
    assert low == pytest.approx(-0.42 * 50.0, abs=4.0)
    assert high == pytest.approx(0.58 * 50.0, abs=4.0)


@pytest.mark.parametrize("cells", [16, 32, 100, 400])
def test_a_target_alone_keeps_its_peak_white(cells: int) -> None:
    x = np.arange(-cells, cells, 0.5) + 0.1
    values = decibels(np.outer(np.sinc(x) ** 2, np.sinc(x) ** 2))
    peak = float(np.percentile(values, 99.9))
    assert limits_db(values) == (peak - 50.0, peak)
    assert limits_db(values, clutter=False) == (peak - 50.0, peak)


@pytest.mark.parametrize("deep", [False, True])
def test_side_lobes_of_a_small_rough_body_are_not_taken_for_clutter(deep: bool) -> None:
    """A sphere of 1 m alone: white lay 60 dB below its peak, and the picture showed rounding noise.

    Clutter that these side lobes do not hide is shown as ever.
    """
    response = np.fft.fftshift(np.abs(np.fft.fft(windows.taylor(41, nbar=4, sll=35), 80)))
    cut = decibels((response / response.max()) ** 2)
    values = cut[:, None] + cut
    noise = np.random.default_rng(8).exponential(size=values.shape)
    values = decibels(10.0 ** (0.1 * values) + 10.0 ** (-0.1 * (105.0 if deep else 60.0)) * noise)
    low, high = limits_db(values, clutter=True)
    if deep:
        assert high == pytest.approx(float(np.percentile(values, 99.9))) and low == high - 50.0
    else:
        assert low == pytest.approx(-60.0 - 0.42 * 50.0, abs=4.0)  # tol: the nearest side lobes count with it


def test_empty_pixels_do_not_count() -> None:
    values = decibels(np.random.default_rng(2).exponential(size=(200, 200)))
    padded = np.concatenate([values, np.full((300, 200), -np.inf)])
    # tol: blocks on the seam
    assert limits_db(padded) == pytest.approx(limits_db(values), abs=0.2)
    assert limits_db(np.full((2, 2), -np.inf)) == (-50.0, 0.0)


def test_a_lone_rough_body_is_not_white() -> None:
    """A tenth of the image is a body with side lobes of Taylor weights: it is not white throughout."""
    rng = np.random.default_rng(3)
    body = np.zeros((120, 120), dtype=bool)
    body[40:80, 40:76] = True
    field = np.where(body, rng.normal(size=body.shape) + 1j * rng.normal(size=body.shape), 0.0)
    window = np.zeros(120)
    window[20:100] = windows.taylor(80, nbar=4, sll=35)
    spectrum = np.fft.fftshift(np.fft.fft2(field)) * np.outer(window, window)
    power = np.abs(np.fft.ifft2(np.fft.ifftshift(spectrum))) ** 2
    low, high = limits_db(decibels(power), clutter=True)
    assert np.mean(decibels(power)[body] >= high) < 0.05 and low == high - 50.0


def test_quantities_are_what_they_say() -> None:
    image = make_image(64, 64, (0.5, 0.5))
    shown = {q: prepare(image, PictureOptions(quantity=q), 1600) for q in QUANTITIES}
    sigma0 = decibels(image.sigma0())
    theta = image.incidence_angle
    np.testing.assert_allclose(shown["sigma0"].values, sigma0, atol=1e-9)  # tol: rounding, as below
    np.testing.assert_allclose(shown["gamma0"].values, sigma0 - 10 * np.log10(np.cos(theta)), atol=1e-9)
    np.testing.assert_allclose(shown["beta0"].values, sigma0 - 10 * np.log10(np.sin(theta)), atol=1e-9)
    np.testing.assert_allclose(shown["rcs"].values, decibels(image.rcs()), atol=1e-9)
    np.testing.assert_allclose(shown["amplitude"].values, np.abs(image.total()), rtol=1e-6)
    np.testing.assert_allclose(shown["phase"].values, np.angle(image.total()), atol=1e-6)
    assert shown["phase"].limits == (-np.pi, np.pi)
    assert shown["amplitude"].limits[0] == 0.0
    # three times the root mean square of circular Gaussian amplitudes; tol: the mode lies below the mean
    assert shown["amplitude"].limits[1] == pytest.approx(3.0 * np.sqrt(2.0), rel=0.15)


def test_looks_average_power_and_phase_averages_complex_values() -> None:
    image = make_image(60, 80, (0.5, 0.5))
    power = prepare(image, PictureOptions(quantity="rcs", looks=(3, 4)), 1600)
    assert power.values.shape == (20, 20) and power.averaged == (3, 4)
    expected = image.rcs().reshape(20, 3, 20, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(power.values, decibels(expected), atol=1e-9)  # tol: rounding
    image.data[:] = np.exp(0.7j)
    phase = prepare(image, PictureOptions(quantity="phase", looks=(3, 4)), 1600)
    np.testing.assert_allclose(phase.values, 0.7, atol=1e-6)  # tol: complex64


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"quantity": "sigma"}, 'quantity "sigma" is unknown; did you mean "sigma0"'),
        ({"limits": (0.0, -30.0)}, "limits 0 and -30 are not ascending"),
        ({"span_db": 0.0}, "span = 0 dB is not above 0"),
        ({"looks": (0, 1)}, "looks = 0 x 1 are not at least"),
        ({"channel": "HV"}, 'no channel "HV"; it has VV'),
        ({"colour_map": "grey2"}, 'colour map "grey2" is unknown'),
        ({"order": 3}, "bounce order 3 was not kept separately"),
    ],
)
def test_options_that_do_not_fit(options: dict, text: str) -> None:
    with pytest.raises(DataError, match=text):
        quicklook(make_image(20, 20, (1.0, 1.0)), PictureOptions(**options))


def test_given_limits_and_colours_are_used_in_axes_of_the_callers() -> None:
    figure = Figure()
    axes = figure.add_subplot()
    options = PictureOptions(limits=(-30.0, 5.0), colour_map="viridis")
    picture = draw(make_image(30, 40, (0.5, 0.25)), axes, options)
    assert picture.get_clim() == (-30.0, 5.0) and picture.get_cmap().name == "viridis"
    assert axes.get_xlabel() == "slant range (m)" and axes.get_aspect() == 1.0


@pytest.mark.parametrize("shape", [(200, 400), (100, 400), (300, 300), (600, 150)])
def test_labels_of_a_panel_are_whole(shape: tuple[int, int]) -> None:
    """Beside a low picture "azimuth from the scene's origin (m)" was cut off above and below."""
    image = make_image(*shape, (0.5, 0.5))
    turn = np.radians(37.0)
    grid = dataclasses.replace(
        image.grid,
        kind="ground",
        along=np.array([np.sin(turn), np.cos(turn), 0.0]),
        across=np.array([np.cos(turn), -np.sin(turn), 0.0]),
    )
    figure = panel(dataclasses.replace(image, grid=grid))
    pixels(figure)  # lays it out
    axes = figure.axes[0]
    assert "azimuth" in axes.get_ylabel() and "origin" in axes.get_ylabel()
    for axis in (axes.xaxis, axes.yaxis):
        box = axis.label.get_window_extent()
        assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width and 0.0 <= box.y0 < box.y1 <= figure.bbox.height


def test_png_bytes_are_the_file(tmp_path: Path) -> None:
    image = make_image(30, 40, (0.5, 0.5))
    save(quicklook(image), tmp_path / "q.png")
    with (tmp_path / "q.png").open("rb") as file:
        assert png(image) == file.read()


def test_the_window_is_said() -> None:
    image = make_image(30, 40, (0.5, 0.5))
    assert "window" not in quicklook(image).axes[0].get_title()
    facts = {**image.metadata, "focus": {"range_window": "taylor:4:-35", "azimuth_window": "hann"}}
    title = quicklook(dataclasses.replace(image, metadata=facts)).axes[0].get_title()
    assert "window hann x taylor:4:-35" in title


def test_picture_has_range_right_and_azimuth_up(tmp_path: Path) -> None:
    image = make_image(100, 100, (1.0, 1.0))
    image.data[:] *= 1e-3
    image.data[0, 80:90, 20:30] = 1.0  # late azimuth, near range: top left
    save(quicklook(image), tmp_path / "q.png")
    picture = matplotlib.image.imread(tmp_path / "q.png")[:, :, 0]
    height, width = picture.shape
    inner = picture[74 : height - 74, 90 : width - 130]
    bright = np.argwhere(inner > 0.9).mean(axis=0) / inner.shape
    # tol: half an image pixel in 100
    assert bright == pytest.approx([0.15, 0.25], abs=0.005)


def test_pixels_are_not_smoothed(tmp_path: Path) -> None:
    image = make_image(64, 64, (1.0, 1.0))
    save(quicklook(image, PictureOptions(span_db=40.0)), tmp_path / "q.png")
    picture = matplotlib.image.imread(tmp_path / "q.png")[:, :, 0]
    height, width = picture.shape
    inner = picture[74 : height - 74, 90 : width - 130]
    assert inner.shape == (640, 640)
    blocks = inner.reshape(64, 10, 64, 10)[1:-1, :, 1:-1]  # the frame's line covers the outermost pixels
    assert np.ptp(blocks, axis=(1, 3)).max() == 0.0


def test_orders_are_shown_apart(tmp_path: Path) -> None:
    image = make_image(40, 40, (1.0, 1.0), orders=4)
    assert bounce_orders(image) == (1, 2, 3, 4)
    figure = quicklook_by_order(image)
    assert [a.get_title() for a in figure.axes][:4] == [
        "VV, 1 bounce",
        "VV, 2 bounces",
        "VV, 3 bounces",
        "VV, 4 bounces",
    ]
    save(figure, tmp_path / "o.png")
    with pytest.raises(DataError, match="keep_orders"):
        quicklook_by_order(make_image(4, 4, (1.0, 1.0)))


def test_profile_runs_through_the_peak() -> None:
    image = make_image(30, 40, (0.5, 0.25))
    image.data[0, 7, 11] = 100.0
    position, values, place = cut_profile(image, "range")
    assert place == 3.5
    assert position[values.argmax()] == 9000.0 + 11 * 0.25
    assert values.max() == pytest.approx(40.0, abs=1e-5)  # tol: float32 rounding
    assert cut_profile(image, "azimuth")[2] == 9000.0 + 11 * 0.25
    assert profile(image, "azimuth").axes[0].get_xlabel() == "azimuth from mid-track (m)"
    with pytest.raises(DataError, match="outside the image, 0 to"):
        cut_profile(image, "range", at=99.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_lone_body_is_not_white_over_its_side_lobes(seed: int) -> None:
    # Rationale: the picture of a mesh alone is a body on a fifth of the pixels, 20 dB of spread, over side lobes 40 dB
    # below, which are the only even area: they are not the clutter by which a picture is scaled.
    rng = np.random.default_rng(seed)
    power = 1e-5 * rng.exponential(1.0, (120, 200))
    power[40:80, 30:150] = rng.exponential(1.0, (40, 120)) * 10.0 ** rng.uniform(-1.0, 1.0, (40, 120))
    values = decibels(power)
    low, high = limits_db(values, clutter=True)
    # tol: the 98th percentile; over side lobes a fifth of the pixels would be white
    assert np.mean(values > high) < 0.025
    assert low < np.median(values[40:80, 30:150]) < high


def test_a_target_on_a_turntable_is_scaled_by_itself() -> None:
    """Side lobes about a car took most of the picture of `rcs`, which was scaled by them: the car was white."""
    rng = np.random.default_rng(1)
    image = make_image(120, 200, (0.1, 0.1))
    power = 1e-6 * rng.exponential(1.0, (120, 200))
    power[50:70, 80:130] = rng.exponential(1.0, (20, 50))
    image.data[0] = np.sqrt(power)
    known = {"effects": {"effects": {"diffuse": {"on": True}}}, TURNTABLE: True}
    shown = prepare(dataclasses.replace(image, metadata=known), PictureOptions(), 1600)
    # tol: white is the 99.9th percentile
    assert np.mean(shown.values > shown.limits[1]) < 0.0015
    plain = prepare(dataclasses.replace(image, metadata={**known, TURNTABLE: False}), PictureOptions(), 1600)
    assert np.mean(plain.values > plain.limits[1]) > 0.02
    drawn = quicklook(dataclasses.replace(image, metadata=known)).artists
    texts = [one.get_text() for one in drawn if isinstance(one, Annotation)]
    assert "radar moves" in texts and "flight" not in texts


def hill(n_azimuth: int, n_range: int, seed: int) -> SarImage:
    """Speckle whose mean varies by 8 dB over hundreds of pixels."""
    rng = np.random.default_rng(seed)
    image = make_image(n_azimuth, n_range, (0.5, 0.5))
    x = np.linspace(-1.0, 1.0, n_range)
    slope = 10.0 ** (0.2 * np.sin(np.pi * x))  # amplitude: 4 dB up and 4 dB down
    image.data[0] *= slope * rng.uniform(0.9, 1.1)
    return dataclasses.replace(image, metadata={"effects": {"effects": {"diffuse": {"on": True}}}})


@pytest.mark.parametrize("seed", range(3))
def test_terrain_is_multilooked_and_scaled_to_its_slopes(seed: int) -> None:
    # Rationale: in one look, speckle of 5.6 dB over a scale of 50 dB hides slopes of 8 dB.
    image = hill(1300, 900, seed)
    display = prepare(image, PictureOptions(), 1600)
    assert display.averaged == (6, 6) and display.multilooked
    grey = np.clip((display.values - display.limits[0]) / np.ptp(display.limits), 0.0, 1.0)
    columns = grey.mean(axis=0)
    # the slope takes more than half of the scale and three times the deviation of what speckle is left
    assert np.ptp(columns) > 0.5
    assert np.ptp(columns) > 3.0 * (grey - columns).std()
    assert "multilooked: power of 6 x 6 pixels averaged" in quicklook(image).axes[0].get_title()
    one = prepare(image, PictureOptions(looks=(1, 1)), 1600)
    assert one.averaged == (1, 1) and not one.multilooked
    assert prepare(image, PictureOptions(limits=(-40.0, 3.0)), 1600).limits == (-40.0, 3.0)
    assert prepare(image, PictureOptions(quantity="phase"), 1600).averaged == (1, 1)


def test_what_lies_beside_terrain_does_not_darken_its_scale() -> None:
    """A map's edge on 4 % of the picture set black to -44 dB: a hill of 10 dB was light grey."""
    image = hill(1300, 900, 0)
    before = prepare(image, PictureOptions(), 1600).limits
    image.data[0, -52:] *= np.float32(0.02)
    # tol: percentiles of 4 % fewer pixels
    assert prepare(image, PictureOptions(), 1600).limits == pytest.approx(before, abs=0.5)


def test_a_city_and_a_small_image_keep_their_pixels() -> None:
    image = make_image(1200, 1200, (0.5, 0.5))
    image.data[0] = np.tile(np.sqrt(town(0.1)), (3, 3)).astype(np.complex64)
    assert prepare(image, PictureOptions(), 1600).averaged == (1, 1)
    assert prepare(hill(300, 300, 0), PictureOptions(), 1600).averaged == (1, 1)


@pytest.mark.parametrize("polar", [True, False])
def test_the_statement_of_the_error_is_below_the_curves(polar: bool) -> None:
    """All of it, within the figure, and on nothing else."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from sarmitsuba.view.polar import AspectCurves, aspect_figure

    angle = np.arange(0.0, 360.0 if polar else 30.0, 2.0)
    note = "expected error (rms, down to 20 dB below the peak): " + ", ".join(["a cause of many words"] * 12)
    curves = [AspectCurves(name, np.cos(angle), {"1 bounce": np.cos(angle) - 3.0}) for name in ("HH", "VV")]
    figure = aspect_figure(angle, curves, swept="azimuth", title="a target", note=note)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    (text,) = [t for t in figure.findobj(Text) if "expected error" in t.get_text()]
    assert " ".join(text.get_text().split()) == note
    box = text.get_window_extent(canvas.get_renderer())
    width, height = canvas.get_width_height()
    assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
    for axes in figure.axes:
        assert axes.get_tightbbox(canvas.get_renderer()).y0 >= box.y1 - 1.0  # tol: a screen pixel
