"""Unknown track errors of 0.1 m: the peak they cost, and what autofocus gives back."""

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError, ExtensionError
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import AUTOFOCUSERS, default_grid
from sarmitsuba.signal.focusing.autofocus import AutofocusTask, correct_ranges, parse_autofocus
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from tests.support.unweighted import focus


def case(mode: str, clutter: bool, seed: int) -> Any:
    """The case of benchmarks/suite/track_error.py: 0.1 m that the radar does not know of."""
    return importlib.import_module("benchmarks.suite.track_error").case(mode, clutter, seed)


# methods that search for sharpness take half a minute each where every pixel has an aperture of its own
QUICK = {("phase_gradient", "spotlight", False), ("minimum_entropy", "spotlight", False)}
CASES = [
    pytest.param(
        *(method, mode, clutter),
        marks=() if (method, mode, clutter) in QUICK else pytest.mark.slow,
    )
    for method in ("phase_gradient", "minimum_entropy", "maximum_contrast")
    for mode in ("spotlight", "stripmap")
    for clutter in (False, True)
]


# omega-K moves echoes as at the middle of the image; with a wandering track that is -39 dB where -43 are foretold
@pytest.mark.filterwarnings("ignore:.*the image of focuser omega_k has an error of -3")
@pytest.mark.parametrize(("method", "mode", "clutter"), CASES)
def test_the_peak_that_is_lost_comes_back(method: str, mode: str, clutter: bool) -> None:
    one = case(mode, clutter, seed=len(method) + len(mode) + clutter)
    lost = one.levels(focus(one.raw, request=one.request, focuser="omega_k"))
    assert lost.mean() < -6.0
    image = focus(one.raw, request=one.request, focuser="omega_k", autofocus=method)
    # tol: 1 dB, asked for, of the points' mean; single points with clutter of -20 dB in their cell 1.5 dB, and 2.5 dB
    # by contrast, which the brightest of them lead
    assert one.levels(image).mean() == pytest.approx(0.0, abs=1.0)
    single = 1.0 if not clutter else 2.5 if method == "maximum_contrast" else 1.5
    assert np.abs(one.levels(image)).max() < single

    # and when the track is known, by motion compensation
    known = focus(one.known, request=one.request, focuser="omega_k")
    assert np.abs(one.levels(known)).max() < 1.0  # tol: asked for
    facts = image.metadata["focus"]["autofocus"]
    assert facts["method"] == method and 0.02 < facts["range_error_rms"] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("focuser", ["backprojection", "polar_format"])
def test_it_serves_other_focusers(focuser: str) -> None:
    one = case("spotlight", True, seed=77)
    image = focus(one.raw, request=one.request, focuser=focuser, autofocus="phase_gradient")
    assert np.abs(one.levels(image)).max() < 1.5  # tol: clutter of -20 dB in a point's cell


@pytest.mark.parametrize("seed", range(3))
def test_correcting_a_known_range_error_gives_the_true_echoes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radar = ideal_radar(n_samples=160)
    error = rng.uniform(-0.4, 0.4, radar.track.n_pulses)
    distance = np.linalg.norm(radar.track.position, axis=1)
    flown = replace(
        radar,
        track=Track.from_samples(radar.track.time, radar.track.position * (1.0 + error / distance)[:, None]),
    )
    got = correct_ranges(replace(ideal_echoes(flown, np.zeros(3)), radar=radar), error).data
    true = ideal_echoes(radar, np.zeros(3)).data
    # tol: the sinc's tails beyond the window's end
    assert np.linalg.norm(got - true) / np.linalg.norm(true) < 0.02


def test_names_and_data_that_are_refused() -> None:
    assert set(AUTOFOCUSERS.names) == {"phase_gradient", "minimum_entropy", "maximum_contrast"}
    assert parse_autofocus("none") is None
    assert parse_autofocus("phase_gradient,rounds=3").options["rounds"] == 3  # type: ignore[union-attr]
    with pytest.raises(ExtensionError, match="autofocus 'sharp' is unknown; choose one of"):
        parse_autofocus("sharp")
    with pytest.raises(DataError, match="autofocus phase_gradient: option 'turns' is unknown"):
        parse_autofocus("phase_gradient,turns=3")
    radar = ideal_radar()
    raw = ideal_echoes(radar, np.zeros(3))
    with pytest.raises(DataError, match="autofocus: the data are all zero"):
        focus(replace(raw, data=0.0 * raw.data), autofocus="phase_gradient")


def test_good_data_are_left_as_they_are() -> None:
    radar = ideal_radar(n_samples=160)
    raw = ideal_echoes(radar, [[0.0, 0.0, 0.0], [9.0, 7.0, 0.0]])
    grid = default_grid(radar, {"extent_azimuth": 24.0, "extent_range": 24.0})
    window = parse_window("rectangular")
    task = AutofocusTask(raw, grid, parse_focuser("omega_k"), window, window)
    wavelength = radar.waveform.wavelength
    for method in AUTOFOCUSERS:
        # tol: rad rms; the measures of sharpness win a little by lower side lobes
        assert 4.0 * np.pi / wavelength * np.std(method.estimate(task)) < 0.1
