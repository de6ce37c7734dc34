"""Image metrics on functions whose figures are known."""

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.metrics import (
    Chip,
    coherence,
    equivalent_number_of_looks,
    image_error_db,
    point_target,
    windows_over,
)


def sinc_image(
    row: float, column: float, cells: tuple[float, float], carrier: tuple[float, float]
) -> np.ndarray:
    """Periodic band-limited point (no truncation) with a carrier on both axes, 96 x 96."""
    n = 96
    out = []
    for position, cell, turn in zip((row, column), cells, carrier, strict=True):
        half = int(n / cell / 2)
        f = np.arange(-half, half + 1) / n
        x = np.arange(n) - position
        out.append(np.exp(2j * np.pi * np.outer(x, f)).mean(axis=1) * np.exp(2j * np.pi * turn * x))
    return np.outer(*out)


@pytest.mark.parametrize("carrier", [(0.0, 0.0), (0.37, -0.5), (12.13, 0.81)])
def test_point_target_figures_do_not_care_for_the_carrier(carrier: tuple[float, float]) -> None:
    image = 3.0 * sinc_image(47.313, 50.871, (2.0, 2.5), carrier)
    m = point_target(image, 0.5, 0.4, chip=96)
    assert (m.azimuth_index, m.range_index) == pytest.approx((47.313, 50.871), abs=2e-3)  # tol: 1/500 pixel
    assert (m.azimuth_position, m.range_position) == pytest.approx((47.313 * 0.5, 50.871 * 0.4), abs=1e-3)
    assert m.rcs == pytest.approx(9.0, rel=1e-5)
    assert m.azimuth.irw == pytest.approx(0.8859 * 0.5 * 96 / 49, rel=2e-3)  # tol: Dirichlet, not sinc
    assert m.range.irw == pytest.approx(0.8859 * 0.4 * 96 / 39, rel=2e-3)
    assert m.azimuth.pslr_db == pytest.approx(-13.26, abs=0.1)
    assert m.range.pslr_db == pytest.approx(-13.26, abs=0.1)
    # tol: sidelobes beyond the chip are missing from the textbook's -9.68 dB and -10.16 dB
    assert m.azimuth.islr_null_db == pytest.approx(-9.9, abs=0.3)
    assert m.azimuth.islr_20irw_db == pytest.approx(-10.16, abs=0.2)


def test_phase_is_that_of_the_peak() -> None:
    image = np.exp(0.7j) * sinc_image(47.5, 50.25, (2.0, 2.0), (0.3, 0.4))
    assert point_target(image, 1.0, 1.0, chip=96).phase == pytest.approx(0.7, abs=1e-3)


def test_near_picks_the_target() -> None:
    image = sinc_image(30.0, 30.0, (2.0, 2.0), (0, 0)) + 2.0 * sinc_image(60.2, 62.0, (2.0, 2.0), (0, 0))
    assert point_target(image, 1.0, 1.0, chip=96).azimuth_index == pytest.approx(60.2, abs=0.05)
    near = point_target(image, 1.0, 1.0, chip=96, near=(31, 29))
    assert near.azimuth_index == pytest.approx(30.0, abs=0.2)  # tol: sidelobes of the stronger one
    with pytest.raises(DataError, match="outside the image"):
        point_target(image, 1.0, 1.0, near=(500, 500))


def test_turned_cuts_follow_turned_lobes() -> None:
    # square spectrum turned by 20 degrees: its lobes lie along the turned axes
    angle, n = np.radians(20.0), 128
    x, y = np.meshgrid(np.arange(n) - 64.0, np.arange(n) - 64.0, indexing="ij")
    u, v = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    image = np.sinc(u / 2.0) * np.sinc(v / 2.0)
    directions = {
        "azimuth_direction": (np.cos(angle), -np.sin(angle)),
        "range_direction": (np.sin(angle), np.cos(angle)),
    }
    m = point_target(image, 1.0, 1.0, chip=128, **directions)  # type: ignore[arg-type]
    for cut in (m.azimuth, m.range):
        assert cut.irw == pytest.approx(2.0 * 0.8859, rel=5e-3)  # tol: truncated sinc
        assert cut.pslr_db == pytest.approx(-13.26, abs=0.15)


def test_chip_reproduces_its_pixels() -> None:
    rng = np.random.default_rng(3)
    data = rng.standard_normal((16, 12)) + 1j * rng.standard_normal((16, 12))
    chip = Chip(data, 5, 7)
    np.testing.assert_allclose(chip.on_grid(5 + np.arange(16), 7 + np.arange(12)), data, atol=1e-12)
    np.testing.assert_allclose(chip.at([5, 9], [7, 10]), [data[0, 0], data[4, 3]], atol=1e-12)


def test_coherence_and_error() -> None:
    rng = np.random.default_rng(4)
    a = rng.standard_normal((64, 64)) + 1j * rng.standard_normal((64, 64))
    b = rng.standard_normal((64, 64)) + 1j * rng.standard_normal((64, 64))
    assert coherence(a, 3j * a) == pytest.approx(1.0)
    assert coherence(a, b) < 5 / 64  # tol: 5 sigma of 64^2 independent samples
    assert image_error_db(a + 0.01 * b, a) == pytest.approx(-40.0, abs=0.2)  # tol: norms of random images
    assert image_error_db(a, a) == -np.inf
    with pytest.raises(DataError, match="all zero"):
        image_error_db(a, 0 * a)
    with pytest.raises(DataError, match="pixel by pixel"):
        coherence(a, b[:3])


def test_looks_of_averaged_speckle() -> None:
    rng = np.random.default_rng(5)
    looks = rng.exponential(size=(4, 100, 100)).mean(axis=0)
    assert equivalent_number_of_looks(looks) == pytest.approx(4.0, rel=0.1)  # tol: 3 sigma of 1e4 samples
    assert equivalent_number_of_looks(np.ones(5)) == np.inf
    assert len(list(windows_over((10, 7), 3))) == 6


def test_empty_images_are_refused() -> None:
    with pytest.raises(DataError, match="empty"):
        point_target(np.zeros((64, 64)), 1.0, 1.0)
    with pytest.raises(DataError, match="smaller than 8"):
        point_target(np.ones((4, 4)), 1.0, 1.0)
