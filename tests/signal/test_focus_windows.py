"""Windows: shape, names, and the impulse response each is known for."""

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.metrics import cut_metrics

# name: -3 dB width in cells, highest sidelobe in dB, noise-equivalent width in dB
KNOWN = {
    "rectangular": (0.8859, -13.26, 0.0),
    "hamming": (1.303, -42.67, 1.344),
    "hann": (1.441, -31.47, 1.761),
    "taylor:4:-35": (1.184, -35.17, 0.914),
    "taylor:5:-35": (1.187, -35.22, 0.926),
    "kaiser:2.5": (1.042, -20.95, 0.365),
    "hamming:0.75": (1.0, -21.24, 0.235),
}


@pytest.mark.parametrize("name", KNOWN)
def test_impulse_response_is_the_textbook_one(name: str) -> None:
    width, sidelobe, broadening = KNOWN[name]
    window = parse_window(name)
    u = (np.arange(2048) + 0.5) / 2048 - 0.5
    x = np.arange(-640, 641) / 32
    h = np.cos(2 * np.pi * np.outer(x, u)) @ window(u)
    cut = cut_metrics(x, h**2)
    assert cut.irw == pytest.approx(width, rel=2e-3)  # tol: the table's three decimals
    assert cut.pslr_db == pytest.approx(sidelobe, abs=0.05)  # tol: sidelobe sampled 32 times per cell
    assert 10 * np.log10(window.broadening) == pytest.approx(
        broadening, abs=2e-3
    )  # tol: the table's decimals


def test_aperture_weights_are_symmetric_and_stand_at_pulse_centres() -> None:
    weights = parse_window("taylor").aperture(7)
    np.testing.assert_allclose(weights, weights[::-1], rtol=1e-12)  # tol: rounding
    assert weights.argmax() == 3
    np.testing.assert_array_equal(parse_window("rectangular").aperture(5), np.ones(5))


def test_names_round_trip_and_take_defaults() -> None:
    assert str(parse_window("taylor")) == "taylor:4:-35"
    assert parse_window("TAYLOR:5") == Window("taylor", (5.0, -35.0))
    assert parse_window(str(parse_window("kaiser:3.25"))) == Window("kaiser", (3.25,))
    assert parse_window("hann")(np.array([0.6, -0.51])).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    "text",
    ["boxcar", "taylor:4:35", "taylor:x", "taylor:1", "hann:3", "kaiser:-1", "hamming:0.2", ""],
)
def test_bad_windows_are_refused_in_one_line(text: str) -> None:
    with pytest.raises(DataError, match=r"^window [^\n]*$"):
        parse_window(text)
