"""Errors that a run measures on drawn pulses, against runs that are exact in that respect."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.witness import Witness
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution import witnesses
from sarmitsuba.simulation.execution.ray_witness import halved_plan, witness_rays
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer
from sarmitsuba.simulation.planning.sampling.chains import halve_spacing
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.launch import LatticeLevel, LaunchGrid, lattice

SMALL = {
    "range_film.image_extent_azimuth": "12",
    "range_film.image_extent_range": "16",
    "sar_antenna.azimuth_resolution": "1",
}


def scene_of(name: str, **settings: Any) -> Scene:
    scene = sarmitsuba.load_scene(name, parameters=SMALL)
    settings = {"keep_subsets": True, "effects": {"diffuse_pairs": "off"}, **settings}
    return replace(scene, settings=replace(scene.settings, **settings))


def echoes_of(raw: RawData) -> C64:
    """Echoes of the first channel."""
    return np.sum(
        [p for p, layer in zip(raw.data, raw.layers, strict=True) if layer.channel == raw.channels[0]], axis=0
    )


@pytest.mark.filterwarnings("ignore::sarmitsuba.SarmitsubaWarning")
@pytest.mark.parametrize(("name", "depth"), [("dihedral", 1), ("trihedral", 2)])
def test_bounces_left_out_are_measured(name: str, depth: int) -> None:
    """Runs too short for a pilot, of which nothing was known."""
    scene = replace(sarmitsuba.load_scene(name), settings=scene_of(name).settings)
    shallow = simulate(replace(scene, settings=replace(scene.settings, max_depth=depth)))
    found = shallow.metadata["witnesses"]["bounces"]
    true = image_error_db(echoes_of(shallow), echoes_of(simulate(scene)))
    # tol: 1 dB, pulses of one block; the lobe of the corner is as wide as the aperture
    assert abs(found["error_db"] - true) < 1.0 and true < found["upper_db"] + 0.1


def test_blocks_are_held_against_pulses_traced_one_by_one() -> None:
    shared = simulate(scene_of("tower"))
    found = shared.metadata["witnesses"]["blocks"]
    exact = simulate(scene_of("tower", method="raw"))
    true = image_error_db(echoes_of(shared), echoes_of(exact))
    # tol: 8 dB, a pulse drawn where an edge flashes up
    assert abs(found["error_db"] - true) < 8.0
    assert "blocks" not in exact.metadata["witnesses"]
    assert simulate(scene_of("tower")).metadata["witnesses"] == shared.metadata["witnesses"]


def test_an_error_alike_on_both_sides_of_a_boundary_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planted error that grows with the square of the time from the key pulse: where blocks meet, it cancels."""
    from sarmitsuba.simulation.execution.tracing import KeyPulse

    made = KeyPulse.profiles

    def off(self: KeyPulse, *args: Any) -> Any:
        profiles = made(self, *args)
        n = profiles.shape[1]
        return profiles * (1.0 + (np.arange(n) - n // 2) ** 2 / (n / 2.0) ** 2)[:, None].astype(np.float32)

    monkeypatch.setattr(KeyPulse, "profiles", off)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SarmitsubaWarning)
        shared = simulate(scene_of("tower", key_pulse_interval=60))
    found = shared.metadata["witnesses"]["blocks"]
    assert found["law_db"] + 3.0 < found["error_db"] and -16.0 < found["error_db"] < -3.0
    assert any("error by blocks of pulses is" in str(w.message) for w in caught)


def test_short_runs_without_error_bars_take_no_witness() -> None:
    plain = simulate(scene_of("tower", keep_subsets=False))
    assert not {"blocks", "bounces", "effects"} & set(plain.metadata["witnesses"])


def test_effects_that_are_off_are_traced_in_long_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(witnesses, "LONG", 0.0)
    scene = scene_of("tower", effects={})
    off = simulate(scene)
    found = off.metadata["witnesses"]["effects"]
    assert "wideband" in found["reference"] and found["samples"] >= 1
    assert found["law_db"] == pytest.approx(-20.0, abs=6.0)
    assert found["error_db"] < found["law_db"] + 3.0


def test_rays_are_halved_where_both_measures_say_that_they_are_too_wide() -> None:
    run = Run(scene_of("tower"))
    assert run.sampling is not None
    rays = run.lattices(run.sampling, 0)

    def plan(error_db: float, law_db: float) -> SamplingPlan | None:
        assert run.sampling is not None
        return halved_plan(run.sampling, rays, Witness(error_db, error_db, 1, law_db))

    halved = plan(-5.0, -8.0)
    assert halved is not None and halved.halvings == 1
    assert halved_plan(halved, rays, Witness(-5.0, -5.0, 1, -8.0)) is None  # once
    assert plan(-5.0, -20.0) is None and plan(-20.0, -8.0) is None and plan(-5.0, np.nan) is None
    diffuse = [[replace(grid, purpose="diffuse") for grid in grids] for grids in rays]
    assert halved_plan(run.sampling, diffuse, Witness(-5.0, -5.0, 1, -8.0)) is None
    chosen = replace(run.scene, settings=replace(run.scene.settings, ray_spacing=0.1))
    assert halved_plan(replace(run.sampling, scene=chosen), rays, Witness(-5.0, -5.0, 1, -8.0)) is None


@pytest.mark.parametrize("method", ["hybrid", pytest.param("raw", marks=pytest.mark.slow)])
def test_the_witness_of_rays_holds_the_error_of_two_sets(method: str) -> None:
    """Methods with raw data hand it on, as method image does: without it nothing is traced again, or said."""
    plain = sarmitsuba.load_scene("dihedral")
    two, one = (
        simulate(replace(plain, settings=replace(plain.settings, method=method, keep_subsets=kept)))
        for kept in (True, False)
    )
    found = two.metadata["witnesses"]["rays"]
    assert found["law_db"] <= found["error_db"] <= found["upper_db"] and "two sets" in found["reference"]
    assert one.metadata["witnesses"]["rays"]["law_db"] is None


@pytest.mark.parametrize("waves", [1, 4])
@pytest.mark.parametrize("allowed", [1e6, 2.5e4])
def test_the_error_of_a_midpoint_rule_is_found_from_a_few_of_its_rays(waves: int, allowed: float) -> None:
    """Tubes return their middle's value times their area; seen from one direction, and from many at once."""
    spacing = 0.1
    # what is lit goes on beyond the window, as ground does: cells are exchanged as they are
    grid = lattice(3.0, 3.0, spacing, taper=spacing)
    grid = replace(grid, levels=(LatticeLevel(0, spacing, (0.0, 0.1)),))
    direction = 1.5 * np.random.default_rng(1).standard_normal((waves, 2)) * (waves > 1)

    def echoes(grids: Sequence[LaunchGrid]) -> C64:
        out = np.zeros((1, waves), complex)
        for one in grids:
            share = np.array([level.weight * level.spacing**2 for level in one.every_level])[one.level]
            value = share * (np.square(one.x) + np.square(one.y))
            out[0] += np.exp(1j * (direction @ np.stack([one.x, one.y]))) @ value
        return out.astype(np.complex64)

    exact = echoes([halve_spacing(halve_spacing(grid))])
    true = 10.0 * np.log10(np.sum(np.abs(echoes([grid]) - exact) ** 2))
    seeds = range(10 if allowed < 1e6 else 1)
    found = [witness_rays(echoes, [grid], np.ones(1), np.nan, 0.8, 5.0, seed, allowed) for seed in seeds]
    levels = np.array([[each.error_db, each.upper_db] for each in found if each is not None])
    # tol: dB, the rest of two halvings where all rays are traced; else the draw of a few runs of rays
    if waves == 1 or allowed == 1e6:  # a few runs do not show that errors cancel among all
        assert abs(np.median(levels[:, 0]) - true) < (0.8 if allowed == 1e6 else 3.0)
    assert np.mean(levels[:, 1] > true - 0.8) >= 0.9  # the confidence that it states


@pytest.mark.slow
def test_echoes_are_proportional_to_the_weight_of_their_rays() -> None:
    """Also those that go back along their own chain of mirrors, whose field passes it twice."""
    run = Run(scene_of("tower", keep_subsets=False))
    assert run.sampling is not None and run.trace_scene is not None
    assert run.plan.flags.diffuse_double and run.plan.flags.multi_bounce
    rays = run.rays(run.sampling, 0)
    tracer = BatchTracer(run.tracer(run.sampling), rays, run.layers.per_subset, run.layers.max_order)
    grids = [replace(each, x=each.x[::50], y=each.y[::50]) for each in rays.plain[0]]

    def echoes(weight: float) -> C64:
        lattices = [replace(one, levels=(replace(one.every_level[0], weight=weight),)) for one in grids]
        return tracer.trace(Batch(0, 0, 1, together=True), lattices).profiles

    # tol: float32 sums
    np.testing.assert_allclose(
        echoes(-3.0), -3.0 * echoes(1.0), rtol=1e-3, atol=1e-5 * np.abs(echoes(3.0)).max()
    )
