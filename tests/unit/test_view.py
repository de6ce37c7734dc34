"""Pictures show power honestly: no smoothing, equal metres, robust limits, files that appear whole."""

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from sarmitsuba.echo.raw import Layer
from sarmitsuba.errors import DataError
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.view.display import limits_db, prepare, screen_size
from sarmitsuba.view.profile import cut, profile
from sarmitsuba.view.quicklook import bounce_orders, quicklook, quicklook_by_order, save


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
    display = prepare(image, image.sigma0(), "sigma0", 1600)
    assert display.averaged == (1, 1)
    width, height = screen_size(display, 1600, 640)
    assert width % 80 == 0
    assert width / (80 * 0.25) == pytest.approx(height / (50 * 0.5), rel=0.01)  # tol: whole screen pixels
    assert max(width, height) >= 640


def test_large_image_is_power_averaged() -> None:
    image = make_image(900, 700, (0.5, 0.5))
    power = image.rcs()
    display = prepare(image, power, "rcs", 300)
    assert display.averaged == (3, 3)
    assert display.values_db.shape == (300, 233)
    kept = power[:900, :699]
    # tol: float rounding
    assert np.mean(10 ** (display.values_db / 10)) == pytest.approx(kept.mean(), rel=1e-12)
    assert display.extent[1] - display.extent[0] == pytest.approx(699 * 0.5)  # tol: float rounding
    assert max(screen_size(display, 300, 100)) <= 301


@pytest.mark.parametrize("shape", [(1, 1), (1, 500), (500, 1), (3000, 2)])
def test_odd_shapes_are_drawn(tmp_path: Path, shape: tuple[int, int]) -> None:
    save(quicklook(make_image(*shape, (0.3, 0.3))), tmp_path / "q.png")
    assert (tmp_path / "q.png").stat().st_size > 1000


def test_limits_ignore_a_few_bright_points_and_empty_pixels() -> None:
    values = np.zeros(100_000)
    values[:20] = 90.0
    values[20:5000] = -np.inf
    assert limits_db(values) == (-50.0, 0.0)
    assert limits_db(np.full(4, -np.inf)) == (-50.0, 0.0)


def test_clutter_stays_visible_beside_a_city_of_corners() -> None:
    rng = np.random.default_rng(4)
    clutter = 10 * np.log10(rng.exponential(size=100_000))
    clutter[:2000] += 50.0  # two per cent of the pixels: above the 99.9th percentile's reach
    low, high = limits_db(clutter)
    quartile = 10 * np.log10(np.log(4.0))  # of an exponential distribution
    assert high == pytest.approx(quartile + 25.0, abs=0.2)  # tol: sampling, and the shift by the two per cent
    assert high - low == 50.0
    lobes = np.linspace(-80.0, 0.0, 10_000)  # a target alone: no clutter, the percentile holds
    assert limits_db(lobes)[1] == pytest.approx(-0.08, abs=0.01)  # tol: one sample


def test_picture_has_range_right_and_azimuth_up(tmp_path: Path) -> None:
    image = make_image(100, 100, (1.0, 1.0))
    image.data[:] *= 1e-3
    image.data[0, 80:90, 20:30] = 1.0  # late azimuth, near range: top left
    save(quicklook(image), tmp_path / "q.png")
    picture = matplotlib.image.imread(tmp_path / "q.png")[:, :, 0]
    height, width = picture.shape
    inner = picture[62 : height - 62, 90 : width - 130]
    bright = np.argwhere(inner > 0.9).mean(axis=0) / inner.shape
    # tol: half an image pixel in 100
    assert bright == pytest.approx([0.15, 0.25], abs=0.005)


def test_pixels_are_not_smoothed(tmp_path: Path) -> None:
    image = make_image(64, 64, (1.0, 1.0))
    save(quicklook(image, span_db=40.0), tmp_path / "q.png")
    picture = matplotlib.image.imread(tmp_path / "q.png")[:, :, 0]
    height, width = picture.shape
    inner = picture[62 : height - 62, 90 : width - 130]
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
    position, values, place = cut(image, "range")
    assert place == 3.5
    assert position[values.argmax()] == 9000.0 + 11 * 0.25
    assert values.max() == pytest.approx(40.0, abs=1e-5)  # tol: float32 rounding
    assert cut(image, "azimuth")[2] == 9000.0 + 11 * 0.25
    assert profile(image, "azimuth").axes[0].get_xlabel() == "azimuth (m)"
    with pytest.raises(DataError, match="outside the image, 0 to"):
        cut(image, "range", at=99.0)
