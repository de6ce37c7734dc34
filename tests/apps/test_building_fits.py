"""Fits of heights and shifts that start off by metres, from one and several looks."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import fit
from sarmitsuba.apps.fit.confirmation import CONFIRMED
from sarmitsuba.core.errors import DataError, SceneError
from tests.support.buildings import Drawn, drawn_town

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off"),
    pytest.mark.filterwarnings("ignore:.*max_depth = 2 leaves out returns"),
]
OFF = ("height:@", "shift:@:x", "shift:@:y")


def errors_over_sigma(drawn: Drawn, **options: object) -> np.ndarray:
    found = drawn.fitted(**options)
    assert found.converged and (found.confirmed > CONFIRMED).all(), found.table()
    assert np.abs(found.start - drawn.truth).max() > 1.0
    return np.asarray((found.values - drawn.truth) / found.sigma)


def test_a_height_off_by_metres_is_found_within_its_sigma_from_two_looks() -> None:
    # tol: four standard deviations, and the error of the model's rays that change with the height
    assert np.abs(errors_over_sigma(drawn_town(11, 1))).max() < 6.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [12, 13, 14])
@pytest.mark.parametrize("looks", [(0,), (0, 1)])
def test_heights_off_by_three_metres_are_found(seed: int, looks: tuple[int, ...]) -> None:
    drawn = drawn_town(seed, 6, looks)
    found = drawn.fitted()
    error = np.abs(found.values - drawn.truth)
    assert (error < 0.05).all(), f"{error} m, stated {found.sigma}, confirmed {found.confirmed}"
    # a residual of noise: the noise's own power, with its standard error
    for residual, raw, scene in zip(found.residuals, drawn.data, drawn.scenes, strict=True):
        noise = np.mean(np.abs(raw.data) ** 2) / (1.0 + 10.0**2)
        assert np.mean(np.abs(residual.data) ** 2) == pytest.approx(noise, rel=0.1), scene.name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [15, 16, 17])
def test_height_and_place_off_by_a_metre_are_found_from_two_looks(seed: int) -> None:
    drawn = drawn_town(seed, 1, wrong=1.0, kinds=OFF)
    found = drawn.fitted()
    error = np.abs(found.values - drawn.truth)
    # a few stay at another cycle of phase, which the fit says
    assert (error < 0.01).all() or (found.confirmed < CONFIRMED).all(), (
        f"{error} m, confirmed {found.confirmed}"
    )


@pytest.mark.slow
def test_what_the_model_does_not_hold_is_not_confirmed() -> None:
    """Data of other scatterers: the phases say nothing, and the fit says so."""
    drawn = drawn_town(18, 2, speckle=5)
    found = drawn.fitted(iterations=3)
    assert (found.confirmed < 0.5).all()
    assert (found.sigma > 0.01).all()
    assert (
        "not confirmed by the phases of the data: height:building0 [m], height:building1 [m]" in found.table()
    )


@pytest.mark.slow
def test_amplitude_alone_finds_heights_to_its_resolution() -> None:
    before, after = [], []
    for seed in (21, 22, 23):
        drawn = drawn_town(seed, 6, speckle=5)
        found = drawn.fitted(by="amplitude")
        assert np.isnan(found.confirmed).all()
        before += list(found.start - drawn.truth)
        after += list(found.values - drawn.truth)
    # tol: the range cell of 0.75 m on the ground; a few stay at false maxima
    assert np.median(np.abs(after)) < 0.5 * np.median(np.abs(before))


def test_looks_that_do_not_belong_together_are_refused() -> None:
    drawn = drawn_town(11, 1)
    first, second = drawn.scenes
    with pytest.raises(SceneError, match="gain belongs to the radar of one look, and there are 2 looks"):
        fit([first, second], drawn.data, "gain")
    with pytest.raises(SceneError, match="2 scenes and 1 raw data"):
        fit([first, second], drawn.data[:1], drawn.parameters)
    with pytest.raises(DataError, match="there are no raw data"):
        fit(first, [], drawn.parameters)
    other = drawn_town(12, 1).scenes[1]
    with pytest.raises(SceneError, match=r"differ in the start values of height:building0 \[m\]"):
        fit([first, other], [drawn.data[0], drawn_town(12, 1).data[1]], drawn.parameters)
    with pytest.raises(SceneError, match="neither complex nor amplitude"):
        fit(first, drawn.data[0], drawn.parameters, by="phase")


def test_one_scene_serves_looks_whose_data_hold_their_radars() -> None:
    drawn = drawn_town(11, 1, wrong=0.001)
    anywhere = replace(drawn.scenes[0], name="anywhere")
    found = fit(anywhere, drawn.data, drawn.parameters)
    both = drawn.fitted()
    assert found.values == pytest.approx(both.values, abs=1e-6) and len(found.residuals) == 2
