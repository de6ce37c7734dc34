"""Fits to raw data: values within the bound in noise, tracks, priors, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba import Prior, fit
from sarmitsuba.errors import DataError, SceneError
from sarmitsuba.focusing.autofocus import correct_ranges
from sarmitsuba.gradients.coarse_track import range_errors
from sarmitsuba.gradients.forward_model import ForwardModel
from sarmitsuba.gradients.least_squares import checked_iterations, known_priors
from sarmitsuba.gradients.material_parameters import with_material
from sarmitsuba.gradients.parsing import parse
from tests.support.fits import fields, fitted_levels, fitted_track, range_error

OFFSETS = np.array([1.5, -2.0, 0.7])


def test_levels_are_found_within_their_sigma() -> None:
    truth, (found,) = fitted_levels(fields(1, 2, 8), OFFSETS, 20.0, range(1))
    assert found.converged and found.costs[-1] < 0.5 * found.costs[0]
    # four standard deviations: one draw in 5000 of three values
    assert (np.abs(found.values - truth) < 4.0 * found.sigma).all()
    # the residual is the noise: its power has a standard error of 2 %
    assert found.sigma == pytest.approx(found.bound, rel=0.1)
    assert found.scene.materials[0].diffuse_level_db == pytest.approx(found.values[0])
    assert "level:field0 [dB]" in found.table() and found.as_dict()["converged"] is True


@pytest.mark.slow
def test_levels_spread_as_the_bound_says() -> None:
    for seed in (1, 2, 3):
        truth, fits = fitted_levels(fields(seed, 2, 16), OFFSETS, 20.0, range(10))
        spread = np.sqrt(np.mean([(f.values - truth) ** 2 for f in fits], axis=0))
        # tol: a spread of ten draws is off by half itself in one of 200
        assert (spread < 1.5 * fits[0].bound).all() and (spread > 0.5 * fits[0].bound).all()


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in range(2, 7))])
def test_a_track_off_by_two_wavelengths_is_found_to_a_fiftieth(seed: int) -> None:
    scene, knots = fields(seed, 1, 16), 2
    truth, found = fitted_track(scene, knots, 2.0, seed, 30.0)
    assert (
        range_error(scene, knots, truth) > 0.25
    )  # in wavelengths: the phase is off by half a cycle at least
    assert range_error(scene, knots, found.values - truth) < 0.02


def test_range_errors_of_parts_of_a_cell_and_of_several_are_found() -> None:
    scene = fields(1, 1, 8)
    model = ForwardModel(scene, parse("track:1", scene))
    # nothing at the ends of the window, where a shift would bring in zeros
    raw = model.raw(model.data() * np.hanning(model.shape[-1]).astype(np.float32))
    for common in (0.3, 2.6):  # cells of 1 m; from pulse to pulse less than a quarter of a wavelength
        error = common + 0.006 * np.sin(np.arange(8.0))
        late = correct_ranges(raw, -error).data
        found, lit = range_errors(model, late, raw.data)
        # tol: float32 data
        assert lit.all() and np.abs(found - error).max() < 1e-3 * scene.radar.waveform.wavelength


@pytest.mark.parametrize(("off_db", "computed"), [(0.05, 1), (3.0, 3)])
def test_the_jacobian_is_kept_while_the_data_follow_it(
    off_db: float, computed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("gain", scene))
    data = model.raw(model.data(model.start + off_db))
    calls = []
    own = ForwardModel.derivative
    monkeypatch.setattr(
        ForwardModel, "derivative", lambda *given, **more: calls.append(1) or own(*given, **more)
    )
    found = fit(scene, data, "gain")
    # 0.05 dB bend the data by 0.3 % of their change, 3 dB by 15 %, and the next step by less than 3 %
    assert len(calls) <= computed and found.converged
    # tol: float32 data
    assert found.values[0] == pytest.approx(off_db, abs=1e-5)


def test_priors_separate_what_the_data_do_not() -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("levels", scene))
    data = model.raw(model.data(model.start + 1.0))
    with pytest.raises(SceneError, match=r"determine only sums of gain \[dB\], level:field0 \[dB\]"):
        fit(scene, data, "gain,levels")
    found = fit(scene, data, "gain,levels", priors={"gain": Prior(0.4, 0.01)})
    assert found.values[0] == pytest.approx(0.4, abs=1e-3)
    # tol: the share of the prior that the data could bend, and float32
    assert found.values[1:] == pytest.approx(model.start + 0.6, abs=1e-2)
    with pytest.raises(SceneError, match="no such parameter"):
        fit(scene, data, "levels", priors={"gain": Prior(0.0, 1.0)})
    with pytest.raises(SceneError, match="sigma = 0"):
        fit(scene, data, "levels", priors={"level:wall": Prior(0.0, 0.0)})


def test_receive_windows_are_those_of_the_data() -> None:
    scene = fields(3, 1, 8)
    window = scene.radar.window
    # farther by five samples, shorter by eight, and moving by a tenth of one from pulse to pulse
    start = window.start_range + (5.0 + 0.1 * np.arange(8)) * window.sample_spacing
    other = replace(window, start_range=start, n_samples=window.n_samples - 8)
    seen = ForwardModel(replace(scene, radar=replace(scene.radar, window=other)), parse("levels", scene))
    data = seen.raw(seen.data(seen.start + 1.5))
    assert data.data.shape[2] == window.n_samples - 8
    found = fit(scene, data, "levels")
    # tol: float32 data
    assert found.values == pytest.approx(seen.start + 1.5, abs=1e-4)
    assert found.residual.data.shape == data.data.shape and found.unexplained < 1e-9


def test_data_of_another_radar_are_refused() -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("gain", scene))
    data = model.raw(model.data())
    shorter = replace(data, data=data.data[:, :, 1:])
    with pytest.raises(DataError, match="give the scene the radar of the data"):
        fit(scene, shorter, "gain")
    with pytest.raises(DataError, match="takes range-compressed ones"):
        fit(scene, replace(data, domain="chirped"), "gain")
    own = data.radar.window
    late = replace(own, start_range=own.start_range + own.extent)
    with pytest.raises(DataError, match=r"holds none of its echoes"):
        fit(scene, replace(data, radar=replace(data.radar, window=late)), "gain")
    finer = replace(own, sample_spacing=0.9 * own.sample_spacing, start_range=own.start_range + 0.1)
    with pytest.raises(DataError, match=r"samples of raw data and scene are .* m apart"):
        fit(scene, replace(data, radar=replace(data.radar, window=finer)), "gain")
    lower = replace(data.radar.waveform, center_frequency=9.0e9)
    with pytest.raises(DataError, match=r"centre frequencies of raw data and scene are 9 and 9\.65 GHz"):
        fit(scene, replace(data, radar=replace(data.radar, waveform=lower)), "gain")
    with pytest.raises(DataError, match="not ndarray"):
        fit(scene, data.data, "gain")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("prior", "reason"),
    [
        (Prior(np.nan, 1.0), "mean = nan"),
        (Prior(0.0, np.nan), "sigma = nan"),
        (Prior(0.0, 1e-200), "must be from"),
    ],
)
def test_priors_that_say_nothing_are_refused(prior: Prior, reason: str) -> None:
    with pytest.raises(SceneError, match=reason):
        known_priors(["gain [dB]"], {"gain": prior})


@pytest.mark.parametrize("iterations", [1.5, 0, -1, True, "3", None])
def test_iterations_are_a_whole_number(iterations: Any) -> None:
    with pytest.raises(SceneError, match="must be a whole number of at least 1"):
        checked_iterations(iterations)
    assert checked_iterations(np.int64(3)) == 3


@pytest.mark.parametrize("priors", [{"gain": (0.0, 1.0)}, {"gain": Prior("0", 1.0)}, [Prior(0.0, 1.0)]])
def test_priors_that_are_none_are_refused(priors: Any) -> None:
    with pytest.raises(SceneError, match=r"is no prior; give sarmitsuba\.Prior|is no mapping"):
        known_priors(["gain [dB]"], priors)


def test_data_that_are_not_finite_are_refused() -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("gain", scene))
    data = model.data()
    with pytest.raises(DataError, match="the raw data are zero"):
        fit(scene, model.raw(0.0 * data), "gain")
    data[0, 2, 3:5] = np.nan
    with pytest.raises(DataError, match="2 of 480 samples of the raw data are not finite"):
        fit(scene, model.raw(data), "gain")
    with pytest.raises(SceneError, match="iterations = 0"):
        fit(scene, model.raw(data), "gain", iterations=0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*prf")
def test_data_of_another_scene_are_left_unexplained() -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("level:wall,height:box", scene))
    data = model.raw(model.data())
    turns = np.exp(2j * np.pi * np.random.default_rng(3).random((1, 8, 1)))
    other = replace(data, data=(data.data * turns).astype(np.complex64))
    assert fit(scene, data, "level:wall,height:box").unexplained < 1e-9  # tol: float32
    found = fit(scene, other, "level:wall,height:box")
    assert found.unexplained > 0.3
    assert f"{100.0 * found.unexplained:.3g} % of the data's energy" in found.table()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*prf")
def test_a_turned_box_whose_walls_mirror_the_ground_is_found() -> None:
    scene = with_material(fields(3, 1, 8), "wall", rms_height=0.002)
    model = ForwardModel(scene, parse("rotation:box", scene))
    found = fit(scene, model.raw(model.data(np.array([3e-4]))), "rotation:box")
    assert found.converged and abs(found.values[0] - 3e-4) < 1e-8  # tol: float32; rad


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*prf")
def test_echoes_are_confirmed_by_their_phases_whatever_their_level() -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("level:wall,height:box", scene))
    brighter = model.raw(model.data(model.start + np.array([9.0, 0.0])))
    found = fit(scene, brighter, "height:box")
    # echoes 9 dB weaker than the data are right in phase: so is the height; tol: the wrong level pulls at it
    assert found.confirmed[0] > 0.99 and abs(found.values[0] - model.start[1]) < 1e-4
