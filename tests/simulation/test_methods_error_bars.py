"""Error bars from subsets: pure arithmetic on made-up planes."""

import math

import numpy as np
import pytest

from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.witness import Witness
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.simulation.execution.error_bars import (
    PASSES,
    PASSES_SCATTER_DB,
    PASSES_SHARED_DB,
    SHARED_DB,
    SHARED_SCATTER_DB,
    add_error_bars,
    add_two_sets,
    estimate_error,
    estimate_pass_error,
    exchange_two_sets,
    has_subsets,
)
from sarmitsuba.simulation.execution.passes import Passes


def subsets(error: float, seed: int = 0) -> tuple[np.ndarray, tuple[Layer, ...], np.ndarray]:
    """Two stored subsets of a random image, each its share of truth + independent noise of rms ``error``."""
    rng = np.random.default_rng(seed)

    def noise() -> np.ndarray:
        return (rng.standard_normal((128, 128)) + 1j * rng.standard_normal((128, 128))) / np.sqrt(2.0)

    truth = noise()
    data = np.stack([SUBSET_SHARES[h] * (truth + error * noise()) for h in (1, 2)]).astype(np.complex64)
    return data, (Layer("VV", 0, 1), Layer("VV", 0, 2)), truth


@pytest.mark.parametrize("error", [0.3, 0.03])
def test_estimate_is_the_error_of_the_mean(error: float) -> None:
    data, layers, truth = subsets(error)
    bars = estimate_error(data, layers)
    true = np.sum(np.abs(data.sum(axis=0) - truth) ** 2) / np.sum(np.abs(truth) ** 2)
    # tol: Monte Carlo, two chi-square sums of 2 * 16384 terms each, and the noise in the denominator (0.2 dB at 0.3)
    weights = sum(SUBSET_SHARES[h] ** 2 for h in (1, 2))  # of sets with equal errors in their weighted mean
    assert abs(bars.noise_db[0] - 10 * np.log10(true * 0.5 / weights)) < 0.3
    # tol: theory, noise / sqrt(2); Monte Carlo as above
    assert abs(bars.noise_db[0] - 20 * np.log10(error / np.sqrt(2))) < 0.3
    assert bars.error_db[0] == pytest.approx(bars.noise_db[0] + SHARED_DB)
    assert SHARED_SCATTER_DB < bars.confidence_db[0] < SHARED_SCATTER_DB + 0.2  # and the few pixels' own


def test_map_has_the_local_error() -> None:
    data, layers, _ = subsets(0.1)
    data[0, :, 64:] = data[1, :, 64:] * np.float32(
        SUBSET_SHARES[1] / SUBSET_SHARES[2]
    )  # right: no difference, no error
    bars = estimate_error(data, layers)
    assert bars.per_pixel.shape == (1, 128, 128)
    # tol: mean over 64 x 128 pixels of a 25-pixel rms: 3 % bias and spread
    assert np.mean(bars.per_pixel[0, :, :60]) == pytest.approx(
        10 ** (SHARED_DB / 20) * 0.1 / np.sqrt(2), rel=0.06
    )
    assert np.all(bars.per_pixel[0, :, 68:] < 1e-6)


def test_orders_are_summed_and_channels_kept_apart() -> None:
    data, _, _ = subsets(0.1)
    zero = np.zeros_like(data[0])
    layers = tuple(Layer(c, o, h) for h in (1, 2) for o in (1, 2) for c in ("HH", "VV"))
    planes = np.stack([data[0], zero, zero, data[0], data[1], zero, zero, data[1]])
    bars = estimate_error(planes, layers, pixels=False)
    assert bars.channels == ("HH", "VV")
    assert bars.error_db[0] == pytest.approx(bars.error_db[1])
    assert set(bars.as_dict()) == {"HH", "VV"}


def test_a_channel_of_rounding_has_no_error() -> None:
    """HV of ground without a cross-polar return stated 3 dB: rays were halved, and the image was "not usable"."""
    data, layers, _ = subsets(0.1)
    planes = np.stack([data[0], 1e-6 * data[1], data[1], -2e-6 * data[0]])
    names = tuple(Layer(c, 0, h) for h in (1, 2) for c in ("VV", "HV"))
    bars = estimate_error(planes, names)
    assert bars.channels == ("VV",) and bars.per_pixel.shape[0] == 1
    assert bars.error_db == estimate_error(data, layers).error_db
    both = estimate_pass_error(planes[:2] * 0.1, planes[:2], ("VV", "HV"), 0.5)
    assert both.channels == ("VV",) and len(both.error_db) == 1
    silent = estimate_error(np.zeros_like(planes), names, pixels=False)
    assert silent.channels == ("VV", "HV")


@pytest.mark.parametrize("levels", [(0, 1), (0, 1, 2, 3), (0, 0, 0), (0, 1, 1)])
def test_passes_state_the_error_of_their_mean(levels: tuple[int, ...]) -> None:
    """Passes whose errors are independent and fall as their rays: the stated error is the true one, and the constant.

    Each is a stand-in of raw data with two subsets and two orders; the truth is known because it was made up.
    """
    rng = np.random.default_rng(7)
    shape = (128, 128)

    def noise() -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    truth, passes = noise(), Passes("made up")
    layers = tuple(Layer("VV", order, subset) for subset in (1, 2) for order in (1, 2))
    for level in levels:
        whole = truth + 0.1 * 2.0 ** (-0.5 * level) * noise()
        parts = np.stack([whole * part for part in (0.5, 0.25, 0.2, 0.05)]).astype(np.complex64)
        raw = object.__new__(RawData)
        for name, value in {"data": parts, "layers": layers, "metadata": {"sampling": {}}}.items():
            object.__setattr__(raw, name, value)
        passes.add(raw, level)
    assert passes.data is not None and passes.change is not None and passes.change.shape == (1, *shape)
    mean = passes.data.sum(axis=0)
    true_db = 10 * np.log10(np.sum(np.abs(mean - truth) ** 2) / np.sum(np.abs(truth) ** 2))
    bars = estimate_pass_error(passes.change, mean[None], ("VV",), passes.share)
    # tol: Monte Carlo, sums of 16384 chi-square terms and their cross terms
    assert abs(bars.error_db[0] - PASSES_SHARED_DB - true_db) < 0.3
    assert bars.noise_db[0] > true_db and bars.source == PASSES
    # exponential powers: the sum of n has the spread of n / 2 equal ones; 16 pixels err together
    chance = 4.0 * 10.0 / np.log(10.0) / np.sqrt(0.5 * 128 * 128)
    assert bars.confidence_db[0] == pytest.approx(np.hypot(chance, PASSES_SCATTER_DB), rel=0.01)


def test_what_passes_said_stands() -> None:
    """An image focused from the data of many passes keeps their figure; that of its two subsets says less."""
    data, layers, _ = subsets(0.1)
    x, y, _ = np.eye(3)
    grid = ImageGrid("ground", np.arange(128.0), np.arange(128.0), np.zeros(3), y, x)
    said = {"VV": {"error_db": -44.0, "at_most_db": -41.0, "confidence_db": 1.0, "source": PASSES}}
    image = SarImage(
        data, layers, grid, 0.03, 2.0, 3.0, np.full(128, 0.8), {"refinement": {"sampling_error": said}}
    )
    assert add_error_bars(image).metadata["sampling_error"] == said
    own = add_error_bars(SarImage(data, layers, grid, 0.03, 2.0, 3.0, np.full(128, 0.8), {}))
    assert "noise_db" in own.metadata["sampling_error"]["VV"]


def test_without_halves_there_is_one_clear_line() -> None:
    data, _, _ = subsets(0.1)
    assert not has_subsets((Layer("VV"),))
    with pytest.raises(DataError, match="keep_subsets"):
        estimate_error(data, (Layer("VV", 1), Layer("VV", 2)))


def test_the_error_of_two_sets_is_a_part_of_the_witness_of_rays() -> None:
    """Change of one set: bias of 0.01 and scatter of 0.004, of which the mean of two sets has half."""
    of_one, scatter = (10.0 * math.log10(x) for x in (0.014, 0.004))
    error = add_two_sets(of_one, scatter)
    assert error == pytest.approx(10.0 * math.log10(0.012))
    assert add_two_sets(-30.0, scatter) == pytest.approx(scatter)
    assert add_two_sets(of_one, math.nan) == of_one
    found = Witness(error, error, 5, scatter)
    assert exchange_two_sets(found, scatter) == found
    assert exchange_two_sets(found, -40.0).error_db == pytest.approx(10.0 * math.log10(0.01005))
    assert exchange_two_sets(found, -10.0).error_db == pytest.approx(-10.0)
    assert exchange_two_sets(Witness(-math.inf, -math.inf, 5), -30.0).error_db == pytest.approx(-30.0)
