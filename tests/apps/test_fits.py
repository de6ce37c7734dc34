"""Fits to raw data: values within the bound in noise, tracks, priors, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba import Prior, fit, simulate
from sarmitsuba.apps.fit.coarse_track import range_errors
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.least_squares import checked_iterations, known_priors
from sarmitsuba.apps.fit.material_parameters import change_material
from sarmitsuba.apps.fit.measured_looks import radar_differences
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.apps.fit.radar_parameters import AntennaTrack
from sarmitsuba.core.errors import DataError, SarmitsubaWarning, SceneError
from sarmitsuba.core.witness import Witness
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.signal.focusing.autofocus import correct_ranges
from tests.support.fits import fields, fitted_levels, fitted_track, noisy, range_error

OFFSETS = np.array([1.5, -2.0, 0.7])
# of radars whose tracks do not follow what stands in the scene
FIXED = {"aim_x": 0.0, "aim_y": 0.0, "aim_z": 0.0, "prf": 100.0}


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
    # 0.05 dB bend the data by 0.3 % of their change, 3 dB by 15 %, and the next step by less than 3 %; one more at the
    # end, for sigma and the witness, and one for the cells by which a value is confirmed
    assert len(calls) <= computed + 2 and found.converged
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


def test_data_that_do_not_match_their_radar_or_the_scene_are_refused() -> None:
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("gain", scene))
    data = model.raw(model.data())
    shorter = replace(data, data=data.data[:, :, 1:])
    with pytest.raises(DataError, match="give raw data with the radar that recorded them"):
        fit(scene, shorter, "gain")
    with pytest.raises(DataError, match="takes range-compressed ones"):
        fit(scene, replace(data, domain="chirped"), "gain")
    own = data.radar.window
    late = replace(own, start_range=own.start_range + own.extent)
    with pytest.raises(DataError, match=r"holds none of the scene's echoes"):
        fit(scene, replace(data, radar=replace(data.radar, window=late)), "gain")
    few = replace(data, radar=data.radar.of_pulses(slice(0, 4)), data=data.data[:, :4])
    with pytest.raises(DataError, match="raw data of 4 pulses, and a radar to be fitted of 8"):
        fit(scene, few, "track:1")
    lower = replace(data.radar.waveform, center_frequency=9.0e9)
    with pytest.raises(DataError, match=r"centre frequencies of raw data and scene are 9 and 9\.65 GHz"):
        fit(scene, replace(data, radar=replace(data.radar, waveform=lower)), "gain")
    with pytest.raises(DataError, match="not ndarray"):
        fit(scene, data.data, "gain")  # type: ignore[arg-type]


def test_data_of_another_look_are_fitted_with_their_radar_and_a_warning_says_so() -> None:
    scene = fields(3, 1, 8)
    other = fields(3, 1, 8, look_angle_deg=48.0, bandwidth=120e6)
    truth = ForwardModel(other, parse("levels", other))
    data = truth.raw(truth.data(truth.start + 1.5))
    with pytest.warns(
        SarmitsubaWarning, match=r"look angle .* and 48 deg.*bandwidth 150 and 120 MHz"
    ) as said:
        found = fit(scene, data, "levels")
    assert len(said) == 1
    # tol: float32 data
    assert found.values == pytest.approx(truth.start + 1.5, abs=1e-4)
    assert radar_differences(scene.radar, scene.radar) == []


@pytest.mark.parametrize("change", ["track", "power", "side", "pattern", "pulses", "receiver"])
def test_radars_that_differ_are_told_apart(change: str) -> None:
    radar = fields(3, 1, 8).radar
    moved = radar.displaced(np.array([0.0, 0.0, 1e-3]))
    found = {
        "track": radar_differences(radar, moved),
        "power": radar_differences(radar, replace(radar, transmit_power=2.0 * radar.transmit_power)),
        "side": radar_differences(radar, replace(radar, look_side="left")),
        "pattern": radar_differences(radar, replace(radar, antenna=Antenna("gaussian", 1.0, 0.1, 0.1))),
        "pulses": radar_differences(radar, radar.of_pulses(slice(0, 6))),
        "receiver": radar_differences(radar, replace(radar, receiver=radar.track)),
    }[change]
    assert found and any(change in one for one in found)
    if change == "track":
        assert radar_differences(radar, moved, {"track"}) == []


def test_ray_sets_spacings_and_seed_are_those_of_the_data() -> None:
    """Data of two ray sets, of other rays and another seed than the scene's, as `render` writes them."""
    scene = fields(3, 1, 8)
    own = replace(scene.settings, keep_subsets=True, seed=7, diffuse_ray_spacing=0.3)
    data = simulate(replace(scene, settings=own))
    start = change_material(scene, "field0", diffuse_level_db=-20.0)
    found = fit(start, data, "levels")
    truth = [m.diffuse_level_db for m in scene.materials]
    # tol: float32 data
    assert found.values == pytest.approx(truth, abs=1e-3) and found.unexplained < 1e-6
    assert found.scene.settings.seed == 7 and found.residual.data.shape[0] == 1


def test_what_the_model_lacks_is_in_sigma_and_in_chi_squared() -> None:
    """A box in the data that the model lacks: the level of the field below is off, and within its sigma."""
    off = {}
    for seed in range(1, 5):
        full = fields(seed, 1, 16, **FIXED)
        model = ForwardModel(full, parse("level:field0", full))
        data, temperature = noisy(model.raw(model.data()), 20.0, seed)
        bare = fields(seed, 1, 16, box=False, **FIXED)
        found = fit(bare, data, "level:field0")
        assert temperature > 0.0 and found.chi_squared[0] > 2.0 and "times the noise" in found.table()
        assert found.sigma[0] > 3.0 * found.bound[0]
        off[seed] = (found.values[0] - model.start[0]) / found.sigma[0]
        own = fit(full, data, "level:field0")
        # the noise's power has a standard error of 3 %
        assert own.chi_squared[0] == pytest.approx(1.0, abs=0.15) and own.sigma == pytest.approx(
            own.bound, rel=0.15
        )
    assert max(map(abs, off.values())) < 4.0, off


def test_a_missing_box_shows_where_no_noise_is_stated() -> None:
    full, bare = fields(2, 1, 16, **FIXED), fields(2, 1, 16, box=False, **FIXED)
    data = simulate(full)
    found = fit(bare, data, "level:field0")
    assert data.radar.noise_temperature == 0.0 and found.chi_squared[0] > 2.0


def test_a_fit_says_how_exact_its_derivatives_were() -> None:
    _, (found,) = fitted_levels(fields(1, 2, 8), OFFSETS, 20.0, range(1))
    (witness,) = found.witnesses.values()
    # the bend of a change of 5 % over the difference
    assert witness.error_db < -40.0 and not witness.contradicts and "measured here" in found.table()
    told = found.as_dict()["witnesses"]["level"]  # type: ignore[index]
    assert Witness.read(told) is not None and found.as_dict()["chi_squared"][0] == pytest.approx(1.0, abs=0.2)  # type: ignore[index]


def test_derivatives_that_are_wrong_are_not_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when a displaced track was followed at transmission alone: half of what the derivatives say."""
    scene = fields(3, 1, 8)
    model = ForwardModel(scene, parse("track:1:z", scene))
    data = model.raw(model.data(np.array([2e-3])))
    own = AntennaTrack.changed
    monkeypatch.setattr(AntennaTrack, "changed", lambda self, scene, values: own(self, scene, 0.5 * values))
    with pytest.warns(SarmitsubaWarning, match="derivatives by track have an error of"):
        found = fit(scene, data, "track:1:z")
    # tol: truncation of the difference
    assert found.witnesses["track"].error_db == pytest.approx(0.0, abs=0.3)
    assert found.confirmed[0] == 0.0 and "not confirmed" in found.table()


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
    scene = change_material(fields(3, 1, 8), "wall", rms_height=0.002)
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
