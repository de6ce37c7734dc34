"""Gradients of losses by many parameters: against the Jacobian, against differences of whole runs, losses, refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba import Scene, SquaredDifference, focusing_operator, gradient, jacobian, simulate
from sarmitsuba.apps.fit.forward_model import MOST_TEXELS, ForwardModel
from sarmitsuba.apps.fit.losses import MultilookDifference, average_looks
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.apps.fit.reverse import Objective, apply_transpose
from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import DataError, ResourceError, SceneError
from sarmitsuba.machine.backend import dr
from sarmitsuba.scene.materials.material import SurfaceMaps
from tests.support.differences import relative
from tests.support.many_bodies import adjoint_of, city, products

# scenes are small, and leave out bounces and edges
pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")

QUAD = {"polarisation": "HH,HV,VH,VV"}
WIDE = {"wideband": "on", "diffuse_pairs": "off", "edge_diffraction": "off"}
BEAM = {
    "mode": "stripmap",
    "n_pulses": 40,
    "pattern": "gaussian",
    "azimuth_beamwidth_deg": 1.0,
    "elevation_beamwidth_deg": 3.0,
}
# drawn scenes, with parameters of every sort
CASES: dict[str, tuple[dict[str, Any], str]] = {
    "map": ({"texels": (2, 2)}, "level_map:soil,level:soil,shifts:x"),
    "raw": ({"settings": {"method": "raw"}, "radar": {"n_pulses": 3}}, "shifts:y,levels"),
    "raw heights": ({"settings": {"method": "raw"}, "radar": {"n_pulses": 3}}, "heights,rotations"),
    "quad": ({"radar": QUAD}, "heights,shifts:x,rotations,level:soil"),
    "metal": ({"kind": "metal"}, "heights,scales,shift:ground:z"),
    "stripmap": (
        {"radar": {"mode": "stripmap", "n_pulses": 40}, "settings": {"key_pulse_interval": 8}},
        "heights,levels,shift:house1:x",
    ),
    "sub_bands": (
        {"kind": "metal", "radar": {"bandwidth": 3e9}, "settings": {"effects": WIDE}},
        "heights,shifts:x",
    ),
    "edges": ({"kind": "metal", "settings": {"effects": {"diffuse_pairs": "off"}}}, "heights,shifts:x,gain"),
    "pairs": ({"settings": {"effects": {"edge_diffraction": "off"}}}, "levels,gain"),
    "pointing": (
        {"radar": BEAM, "settings": {"key_pulse_interval": 8}},
        "pointing:2,levels,heights,track:2:x",
    ),
    "all": ({}, "gain,clock_offset,track:3:xz,permittivity:wall,rms_height:soil,levels,heights,shifts:z"),
}
QUICK = ("map", "raw")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in CASES]
)
def test_gradient_is_the_product_of_adjoint_data_and_jacobian(name: str) -> None:
    given, parameters = CASES[name]
    quick = name in QUICK
    given = given | {"settings": {"max_depth": 2 if quick else 3} | given.get("settings", {})}
    scene = city(2, 2 if quick else 4, pitch=8.0, **given)
    model = ForwardModel(scene, parse(parameters, scene))
    assert name != "sub_bands" or model.run.plan.sub_bands > 1
    rng = np.random.default_rng(2)
    # shapes displaced by millimetres, where it is only them and levels
    moved = not quick and name != "all"
    values = model.start + rng.uniform(-0.004, 0.004, len(model.start)) if moved else None
    data, planes = model.derivative(values)
    adjoint = adjoint_of(rng, data)
    found, memory = apply_transpose(model, adjoint, values)
    expected, size = products(adjoint, planes)
    assert size.all() and (memory > 0 or name == "edges")
    # tol: float32 sums of adjoint grids and of planes, and weights of rays on both sides of edges, whose returns cancel
    # to a tenth; relative to the norms of both
    assert np.abs((found - expected) / size).max() < 1e-6


def test_edges_are_left_out_on_request() -> None:
    scene = city(2, 1, pitch=8.0, settings={"max_depth": 2})
    model = ForwardModel(scene, parse("heights", scene))
    data, planes = model.derivative(edges=False)
    adjoint = adjoint_of(np.random.default_rng(3), data)
    expected, size = products(adjoint, planes)
    found = gradient(scene, "heights", lambda d: (0.0, adjoint), edges=False).gradient
    # tol: float32 sums of adjoint grids and of planes
    assert np.abs((found - expected) / size).max() < 1e-6
    with_edges, _ = apply_transpose(model, adjoint)
    assert np.abs((with_edges - found) / size).max() > 1e-5
    assert np.array_equal(jacobian(scene, "heights", edges=False).derivative, planes)


def test_levels_of_texels_against_differences_of_whole_runs() -> None:
    scene = city(5, 1, pitch=10.0, texels=(2, 3), settings={"max_depth": 2})
    model = ForwardModel(scene, parse("level_map:soil", scene))
    _, planes = model.derivative()
    assert len(model.names) == 6 and model.names[4] == "level_map:soil row 1 column 1 [dB]"
    way = np.random.default_rng(5).standard_normal(6)
    h = 0.02
    ends = [model.data(model.start + s * h * way).astype(np.complex128) for s in (1.0, -1.0)]
    expected = (ends[0] - ends[1]) / (2.0 * h)
    # tol: differences of second order, (0.02 x 2 x 0.115)^2 / 6, and float32 data over the step
    assert relative(np.einsum("k,kcps->cps", way, planes.astype(np.complex128)), expected) < 1e-4


def test_an_objective_changes_by_its_gradient() -> None:
    """Levels of a map and of walls, with the loss of data at other values."""
    scene = city(6, 1, pitch=10.0, texels=(2, 2), settings={"max_depth": 2})
    model = ForwardModel(scene, parse("level_map:soil,level:wall", scene))
    rng = np.random.default_rng(6)
    measured = model.data(model.start + rng.uniform(-2.0, 2.0, len(model.start)))
    objective = Objective(scene, "level_map:soil,level:wall", SquaredDifference(measured))
    value, slope = objective(objective.start)
    way, h = rng.standard_normal(len(slope)), 0.02
    ends = [objective(objective.start + s * h * way)[0] for s in (1.0, -1.0)]
    # tol: differences of second order, and float32 data over the step
    assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(slope @ way, rel=1e-3)
    found = gradient(scene, "level_map:soil,level:wall", SquaredDifference(measured))
    # tol: float64 sums in the order in which threads end
    assert found.loss == value and found.gradient == pytest.approx(slope, rel=1e-13) and len(found) == 5
    assert np.array_equal(found.raw.data, simulate(scene).data) and np.array_equal(
        found.values, objective.start
    )


def test_one_kernel_serves_any_number_of_shapes_and_any_adjoint_data() -> None:
    def kernels(bodies: int, seed: int) -> set[str]:
        scene = city(9, bodies, pitch=6.0, settings={"max_depth": 1})
        model = ForwardModel(scene, parse("shifts:x,levels", scene))
        adjoint = adjoint_of(np.random.default_rng(seed), model.data())
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            apply_transpose(model, adjoint)
            return {entry["hash"] for entry in dr.kernel_history() if "hash" in entry}

    assert kernels(2, 1) == kernels(4, 2)


def test_zero_adjoint_data_give_zero() -> None:
    scene = city(4, 1, pitch=8.0, settings={"max_depth": 1})
    model = ForwardModel(scene, parse("heights,levels", scene))
    found, memory = apply_transpose(model, np.zeros(model.shape, dtype=np.complex64))
    assert not found.any() and memory > 0  # of grids that are not made


def numbers(rng: np.random.Generator, shape: tuple[int, ...]) -> C64:
    """Independent complex normal numbers."""
    return np.asarray(rng.standard_normal(shape) + 1j * rng.standard_normal(shape), dtype=np.complex64)


def test_losses_change_by_their_adjoint_data() -> None:
    rng = np.random.default_rng(8)
    scene = city(8, 1, pitch=10.0, settings={"max_depth": 1})
    raw = simulate(scene)
    operator = focusing_operator(raw, focuser="backprojection")
    scale = float(np.sqrt(np.mean(np.abs(raw.data) ** 2)))
    data, other, way = (numbers(rng, raw.data.shape) * np.float32(scale) for _ in range(3))
    image = (operator @ other.reshape(-1)).reshape(operator.image_shape)
    losses = [
        SquaredDifference(other),
        SquaredDifference(replace(raw, data=other), weights=rng.uniform(0.0, 2.0, raw.data.shape[1:])),
        MultilookDifference(operator, average_looks(image, (3, 2)), (3, 2)),
        MultilookDifference(operator, average_looks(image, (2, 2), amplitude=True), (2, 2), amplitude=True),
    ]
    for loss in losses:
        value, adjoint = loss(data)
        h = np.float32(0.002)
        ends = [loss(data + s * h * way)[0] for s in (np.float32(1.0), np.float32(-1.0))]
        expected = (ends[0] - ends[1]) / (2.0 * float(h))
        found = float(np.vdot(adjoint.astype(np.complex128), way.astype(np.complex128)).real)
        assert value > 0.0
        # tol: differences of second order, and float32 data and images over the step
        assert found == pytest.approx(expected, rel=2e-3)


def test_wrong_losses_are_one_line() -> None:
    scene = city(8, 1, pitch=10.0, settings={"max_depth": 1})
    shape = simulate(scene).data.shape
    cases = [
        (lambda data: None, r"returns nothing \(None\); return its value and the adjoint data"),
        (lambda data: data, "returns an array of complex64"),
        (lambda data: (1.0,), "returns a value of type tuple"),
        (lambda data: ("1", data), "its value is a value of type str; return a real number"),
        (lambda data: (1j, data), "its value is a value of type complex"),
        (lambda data: (1.0, None), r"its adjoint is nothing \(None\); return complex numbers of the shape"),
        (lambda data: (1.0, np.array("x")), "its adjoint is an array of <U1"),
        (5, "int is no function"),
        (lambda data: (np.nan, data), "its value is nan"),
        (lambda data: (1.0, data[:, :-1]), "its adjoint has the shape"),
        (lambda data: (1.0, data * np.nan), "its adjoint is not finite"),
        (SquaredDifference(np.zeros((1, 2, 3), dtype=np.complex64)), "measured raw data of the shape"),
        (SquaredDifference(np.zeros(shape, dtype=np.complex64), weights=np.ones(7)), "do not broadcast"),
        (SquaredDifference(np.zeros(shape, dtype=np.complex64), np.ones((2, *shape))), "do not broadcast"),
    ]
    for loss, reason in cases:
        with pytest.raises(DataError, match=reason):
            gradient(scene, "gain", loss)
    with pytest.raises(DataError, match="a weight is below 0"):
        SquaredDifference(np.zeros(shape, dtype=np.complex64), weights=np.full(1, -1.0))
    with pytest.raises(DataError, match="are not finite"):
        SquaredDifference(np.full(shape, np.nan, dtype=np.complex64))


def test_a_loss_takes_the_channels_of_the_scene_by_their_names() -> None:
    radar = {"polarisation": "HH,VV"}
    both, one = (city(8, 1, pitch=10.0, radar=r, settings={"max_depth": 1}) for r in (radar, {}))
    raw = simulate(both)
    rng = np.random.default_rng(8)
    other = replace(raw, data=raw.data * (1.0 + 0.1 * rng.standard_normal(raw.data.shape)).astype(np.float32))
    turned = replace(other, data=other.data[::-1], layers=other.layers[::-1])
    assert turned.channels == ("VV", "HH")
    weights = rng.uniform(1.0, 2.0, raw.data.shape)
    expected = gradient(both, "levels", SquaredDifference(other, weights))
    found = gradient(both, "levels", SquaredDifference(turned, weights[::-1]))
    # tol: float64 sums in the order in which threads end
    assert found.loss == expected.loss > 0.0 and found.gradient == pytest.approx(expected.gradient, rel=1e-12)
    (channel,) = one.radar.channels
    wrong = {"HH": "VV", "VV": "HH"}[channel]
    data = simulate(one)
    renamed = replace(data, layers=tuple(replace(layer, channel=wrong) for layer in data.layers))
    with pytest.raises(DataError, match=f"of channels {wrong} and a radar of {channel}"):
        gradient(one, "levels", SquaredDifference(renamed))
    with pytest.raises(DataError, match="of channels HH, VV and a radar of"):
        gradient(one, "levels", SquaredDifference(raw))


def test_memory_is_stated_where_the_loss_is_zero() -> None:
    scene = city(8, 1, pitch=10.0, settings={"max_depth": 1})
    for parameters in ("levels", "heights,levels"):
        objective = Objective(scene, parameters, SquaredDifference(simulate(scene)))
        still, moved = objective.at(), objective.at(objective.start + 1e-3)
        assert still.loss == 0.0 < moved.loss and not still.gradient.any()
        assert still.memory == moved.memory > 0


def with_level(scene: Scene, values: np.ndarray) -> Scene:
    """The scene with other values in the map of its soil."""
    changed = [
        m
        if m.maps is None or m.maps.level is None
        else replace(m, maps=SurfaceMaps(replace(m.maps.level, values=values)))
        for m in scene.materials
    ]
    return replace(scene, materials=tuple(changed))


def test_wrong_parameters_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = city(8, 1, texels=(2, 2))
    with pytest.raises(SceneError, match="the material has no sigma0_map"):
        jacobian(scene, "level_map:wall")
    with pytest.raises(SceneError, match="texels of 0"):
        jacobian(with_level(scene, np.zeros((2, 2))), "level_map:soil")
    side = int(np.sqrt(MOST_TEXELS)) + 1
    with pytest.raises(SceneError, match=r"take sarmitsuba\.gradient"):
        jacobian(with_level(scene, np.ones((side, side))), "level_map:soil")
    with pytest.raises(SceneError, match="no shape rises above the ground"):
        jacobian(city(8, 0), "heights")
    objective = Objective(scene, "level_map:soil", lambda data: (0.0, data))
    with pytest.raises(SceneError, match="3 values for 4 parameters"):
        objective(objective.start[:3])
    with pytest.raises(SceneError, match=r"no finite value of level_map:soil row 0 column 1 \[dB\]"):
        objective(np.array([0.0, np.nan, 0.0, 0.0]))
    with pytest.raises(SceneError, match=r"gain = 1e\+06 dB must be within 300 dB"):
        Objective(scene, "gain", lambda data: (0.0, data))(np.array([1e6]))
    monkeypatch.setattr("sarmitsuba.machine.memory.free_memory", lambda: 10**5)
    with pytest.raises(ResourceError, match="a gradient by 4 values needs"):
        objective(objective.start)


def test_shapes_above_the_ground_are_named() -> None:
    scene = city(3, 3)
    assert [p.label for p in parse("heights,shifts:y", scene)] == [
        *(f"height:house{k}" for k in range(3)),
        *(f"shift:house{k}:y" for k in range(3)),
    ]
    assert sarmitsuba.gradient is gradient
