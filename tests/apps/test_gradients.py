"""Derivatives of raw data: their relation to the raw data, closed forms, kernels, and what is refused."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba import (
    FilmDescription,
    Material,
    Motion,
    PointTarget,
    RadarDescription,
    Scene,
    SceneMesh,
    TraceSettings,
    build_scene,
    jacobian,
    simulate,
)
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.material_parameters import LevelMap
from sarmitsuba.apps.fit.parameter import Parameter, Step
from sarmitsuba.apps.fit.parsing import Needed, list_parameters, parse
from sarmitsuba.apps.fit.shape_offsets import MovingPart
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.machine.backend import dr
from sarmitsuba.radar.receiver import moving_in_pulse
from tests.support.differences import drawn, relative
from tests.support.draws import few_of


def plate(**radar: Any) -> Scene:
    """A rough plate of a metre, 3 km from a squinted radar; ``radar``: other values, None: none."""
    corners = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
    rough = Material("soil", permittivity=5.0, diffuse_law="lambert", diffuse_level_db=-5.0, rms_height=0.02)
    given = {
        "slant_range": 3000.0,
        "look_angle_deg": 40.0,
        "squint_angle_deg": 20.0,
        "mode": "spotlight",
        "n_pulses": 4,
        "noise_temperature": 0.0,
        "bandwidth": 150e6,
    }
    return build_scene(
        [SceneMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), rough, "plate")],
        radar=RadarDescription(**{k: v for k, v in (given | radar).items() if v is not None}),
        film=FilmDescription(image_extent_azimuth=8.0, image_extent_range=8.0),
        settings=TraceSettings(method="raw", effects={"diffuse_pairs": "off"}),
        name="plate",
    )


@pytest.mark.parametrize("kind", few_of(["alone", "rough", "metal"]))
@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
@pytest.mark.filterwarnings(
    "ignore:.*derivatives by shift have an error of"
)  # five coarse facets; the data count here
def test_raw_data_are_those_of_a_plain_run_to_the_bit(kind: str) -> None:
    scene = drawn(5, kind)
    found = jacobian(scene, "gain,clock_offset,track:2,shift:box:z")
    plain = simulate(scene)
    assert np.array_equal(found.raw.data, plain.data)
    assert found.derivative.shape == (len(found), *plain.data.shape) == (9, *plain.data.shape)
    assert np.isfinite(found.derivative).all()


@pytest.mark.parametrize("kind", few_of(["alone", "rough"]))
def test_plain_kernels_stay_as_they_are_and_other_values_compile_none(kind: str) -> None:
    scene = drawn(5, kind)
    model = ForwardModel(scene, parse("gain,track:1", scene))

    def kernels(run: Any) -> set[str]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            run()
            return {entry["hash"] for entry in dr.kernel_history() if "hash" in entry}

    before = kernels(lambda: simulate(scene))
    first = kernels(model.derivative)
    other = kernels(lambda: model.derivative(model.start + 0.01))
    assert kernels(lambda: simulate(scene)) == before
    assert other == first != before


def test_directions_to_a_plate_are_those_of_its_place() -> None:
    """The slant range changes with the antenna's place along the line of sight, and opposite with the plate's."""
    scene = plate()
    found = jacobian(scene, "track:1,shift:plate:x,shift:plate:y,shift:plate:z")
    track = scene.radar.track.position
    u = track / np.linalg.norm(track, axis=1, keepdims=True)
    farther = np.einsum("pk,kcps->cps", u, found.derivative[:3])
    for axis in range(3):
        # tol: a corner's distance over the range, 2.4e-4, over the least component, a third
        assert relative(found.derivative[axis], farther * u[:, axis, None]) < 8e-4
        assert relative(found.derivative[3 + axis], -found.derivative[axis].astype(np.complex128)) < 1e-4


def test_a_track_that_is_displaced_as_a_whole_is_the_sum_of_its_knots() -> None:
    scene = plate()
    whole, knots = (jacobian(scene, f"track:{n}:yz").derivative for n in (1, 3))
    for axis in range(2):
        # tol: float32 sums
        assert relative(knots[3 * axis : 3 * axis + 3].sum(axis=0), whole[axis].astype(np.complex128)) < 1e-5


def test_derivative_of_the_image_is_the_image_of_the_derivative() -> None:
    scene = plate()
    found = jacobian(scene, "gain,shift:plate:x")
    step = 1e-4
    image = found.image("shift:plate:x")
    moved = replace(found.raw, data=found.raw.data + np.complex64(step) * found.derivative[1])
    with_step, without = (sarmitsuba.focus(raw) for raw in (moved, found.raw))
    change = (with_step.data.astype(np.complex128) - without.data) / step
    # tol: float32 images over the step of a fortieth of a radian
    assert relative(image.data, change) < 1e-4


def test_values_are_named() -> None:
    scene = plate()
    found = jacobian(scene, ["gain", *parse("track:2:z", scene)])
    assert found.names == ("gain [dB]", "track z at knot 0 [m]", "track z at knot 1 [m]")
    assert found.number("track z at knot 1") == 2 and len(found) == 3
    with pytest.raises(SceneError, match="no parameter 'level'"):
        found.number("level")


@pytest.mark.parametrize(
    ("kind", "value", "bound"),
    [
        ("permittivity", 0.5, "at least 1"),
        ("permittivity", 1e17, r"at most 1e\+06"),
        ("loss", -0.1, "at least 0"),
        ("rms_height", 0.0, "above 0"),
        ("rms_height", np.nan, "above 0"),
    ],
)
def test_materials_have_values_that_there_are(kind: str, value: float, bound: str) -> None:
    scene = plate()
    (parameter,) = parse(f"{kind}:soil", scene)
    with pytest.raises(SceneError, match=f"parameter {kind}:soil = .* must be {bound}"):
        parameter.changed(scene, np.array([value]))
    assert not ForwardModel(scene, [parameter]).possible(np.array([value]))


@pytest.mark.parametrize("name", ["block:3", "north, 2", 'a "house"', " ", "x"])
def test_names_of_any_characters_can_be_given(name: str) -> None:
    scene = plate()
    scene = replace(scene, geometry=replace(scene.geometry, mesh_names=(name,)))
    inner = name.replace('"', '""')
    text = f'shift:"{inner}":x,scale:"{inner}", shift:"{inner}":z'
    found = parse(text, scene)
    assert [p.shape for p in found] == [name] * 3  # type: ignore[attr-defined]
    assert all(parse(p.label, scene) == (p,) for p in found)
    assert {p.label for p in found} < set(list_parameters(scene))


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ("", "none is given"),
        ([], "none is given"),
        (5, "5 is neither a text nor a parameter"),
        ([None], "None is neither a text nor a parameter"),
        ("gain,gain", r"gain \[dB\] is given 2 times"),
        ("levels,level:soil", r"level:soil \[dB\] is given 2 times"),
        ('shift:"plate:x', "a quotation mark stands alone"),
        ("sigma", "is not one of gain"),
        ("track:0", "is not one of gain"),
        ("shift:plate", "is not one of gain"),
        ("shift:roof:z", 'no shape "roof"'),
        ("height:plate", "the shape is flat"),
        ("level:grass", 'no material "grass"'),
        ("thickness:soil", "its thickness is 0"),
        ("track:1000000000", "1000000000 knots on a track of 4 pulses; take at most 4"),
        ("pointing:5", "5 knots on a track of 4 pulses"),
        ("correlation_length:soil", "its correlation_length is 0"),
    ],
)
def test_wrong_parameters_are_one_line(parameters: Any, reason: str) -> None:
    with pytest.raises((SceneError, RadarError), match=reason):
        jacobian(plate(), parameters)


@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_metal_has_no_permittivity_and_no_level() -> None:
    scene = drawn(0, "metal")
    for parameter, reason in (("permittivity:wall", "perfect conductor"), ("level:wall", "has no level")):
        with pytest.raises(SceneError, match=reason):
            jacobian(scene, parameter)


def test_what_is_not_supported_is_refused_in_one_line() -> None:
    scene = plate()
    moving = replace(scene.geometry, mesh_motion=(Motion(velocity=(1.0, 0.0, 0.0)),))
    cases = [
        (replace(scene, settings=replace(scene.settings, method="image")), RadarError, "makes no raw data"),
        (replace(scene, geometry=moving), SceneError, "moving objects"),
        (replace(scene, radar=replace(scene.radar, receiver=scene.radar.track)), RadarError, "two antennas"),
    ]
    for refused, kind, reason in cases:
        with pytest.raises(kind, match=reason):
            jacobian(refused, "gain")


def test_a_beam_that_is_turned_as_a_whole_is_the_sum_of_its_knots_and_is_found_again() -> None:
    scene = plate(pattern="gaussian", azimuth_beamwidth_deg=0.1, elevation_beamwidth_deg=0.1)
    whole, knots = (jacobian(scene, text).derivative for text in ("pointing", "pointing:3"))
    for angle in range(2):
        # tol: float32 sums
        assert (
            relative(knots[3 * angle : 3 * angle + 3].sum(axis=0), whole[angle].astype(np.complex128)) < 1e-5
        )
    model = ForwardModel(scene, parse("pointing", scene))
    angles = np.radians([0.01, -0.02])
    found = sarmitsuba.fit(scene, model.raw(model.data(angles)), "pointing")
    # tol: float32 data, whose level changes by some percent
    assert found.values == pytest.approx(angles, abs=1e-3 * float(np.abs(angles).max()))


@pytest.mark.filterwarnings("ignore:.*antenna_pattern is switched off")
def test_an_antenna_without_a_beam_has_no_pointing() -> None:
    with pytest.raises(RadarError, match="the antenna is isotropic"):
        jacobian(plate(), "pointing")
    scene = plate(pattern="gaussian", azimuth_beamwidth_deg=0.1, elevation_beamwidth_deg=0.1)
    effects = {**scene.settings.effects, "antenna_pattern": "off"}
    with pytest.raises(SceneError, match="the effect antenna_pattern is off"):
        jacobian(replace(scene, settings=replace(scene.settings, effects=effects)), "pointing")


def test_launches_carry_equal_parts() -> None:
    levels = tuple(frozenset([k]) for k in range(13))
    steps = tuple(Step(f"m{k}", {}, {}, 1.0) for k in range(50))
    parts = list(Needed((), levels, steps).parts())
    assert len(parts) == 7
    assert sum((p.levels for p in parts), ()) == levels and sum((p.steps for p in parts), ()) == steps
    assert {len(p.steps) for p in parts} == {7, 8} and {len(p.levels) for p in parts} == {1, 2}
    assert len(list(Needed((), (), ()).parts())) == 1


def test_materials_stand_for_all_that_they_have() -> None:
    found = [p.label for p in parse("materials", drawn(3, "rough"))]
    kinds = ("permittivity", "loss", "rms_height")
    assert found[0] == "level:soil" and len(found) == len(set(found))
    assert set(found[1:]) == {f"{k}:{m}" for k in kinds for m in ("wall", "soil")} | {
        "correlation_length:wall"
    }


def two_places(name: str) -> Scene:
    """The plate under radars whose antenna is at two places at once: at transmission and reception, flown and told."""
    place: dict[str, Any] = {"speed": 30e3, "azimuth_beamwidth_deg": 0.3, "elevation_beamwidth_deg": 0.3}
    if name == "orbit":
        own = ("slant_range", "look_angle_deg", "squint_angle_deg")
        place = {"orbit_altitude": 700e3, **dict.fromkeys(own), "antenna_length": 5.0, "antenna_height": 1.0}
    scene = plate(pattern="gaussian", **place)
    settings = replace(
        scene.settings, effects={**scene.settings.effects, "motion_in_pulse": "on", "antenna_pattern": "on"}
    )
    scene, radar = replace(scene, settings=settings), scene.radar
    if name == "points":
        return replace(scene, points=(PointTarget("point", np.array([0.3, 0.2, 0.0]), 30.0),))
    if name == "recorded":
        told = replace(radar.track, position=radar.track.position + np.array([0.2, 0.1, -0.3]))
        return replace(scene, radar=replace(radar, recorded=told, recorded_pointing=radar.pointing))
    if name == "received":  # data in whose record reception is apart already
        return replace(scene, radar=moving_in_pulse(radar))
    return scene


RADARS_AT_TWO_PLACES = ("fast", "orbit", "recorded", "points", "received")
OF_ALL_KINDS = "gain,clock_offset,track:2,pointing:2,level:soil,permittivity:soil,shift:plate:z,scale:plate"


def test_parameters_of_all_kinds_are_compared() -> None:
    def kinds(one: type[Parameter]) -> set[type[Parameter]]:
        own = set() if inspect.isabstract(one) else {one}
        return own.union(*(kinds(below) for below in one.__subclasses__()))

    found = {type(p) for p in parse(OF_ALL_KINDS, two_places("fast"))}
    # a map of levels changes a material's bitmap as a level does its number; a part is no parameter of a scene
    assert kinds(Parameter) - {LevelMap, MovingPart} == found


@pytest.mark.parametrize("name", RADARS_AT_TWO_PLACES)
def test_what_a_parameter_changes_is_followed_wherever_the_antenna_is(name: str) -> None:
    """A scene changed before its effects move the antenna within a pulse is that changed afterwards."""
    scene = two_places(name)
    model = ForwardModel(scene, parse(OF_ALL_KINDS, scene))
    for parameter in model.parameters:
        values = parameter.values(scene)
        # metres and radians of whole wavelengths and beams: nothing is lost in rounding
        values = values + 1e-8 if parameter.label == "clock_offset" else values + 0.125
        before = model.run.plan.apply(parameter.changed(scene, values)).radar
        after = parameter.changed(model.scene, values).radar
        assert after.receiver is not None and before.receiver is not None
        # tol: knots are displaced at reception as at that time, and not as at the pulse
        slope = 0.125 * float(after.times[1][0] - after.times[0][0]) / float(np.ptp(after.track.time))
        for one, other in zip(before.tracks, after.tracks, strict=True):
            assert np.abs(one.position - other.position).max() <= 1.01 * slope + 1e-9
        for one, other in zip(before.pointings, after.pointings, strict=True):
            assert np.array_equal(one.boresight, other.boresight)
        assert np.allclose(before.window.start_range, after.window.start_range, rtol=0.0, atol=1e-6)
        assert before.transmit_power == after.transmit_power
        told = [one.recorded and one.recorded.position for one in (before, after)]
        assert np.array_equal(*told)  # what the focuser is told does not follow what is flown


@pytest.mark.parametrize("name", RADARS_AT_TWO_PLACES)
def test_derivatives_by_the_radar_are_those_of_runs_of_changed_scenes(name: str) -> None:
    scene = two_places(name)
    found = jacobian(scene, "gain,clock_offset,track:1,pointing")
    steps = {"dB": 0.05, "s": 2e-11, "m": 2e-4, "rad": 5e-5}
    own = [
        (p, k)
        for p in parse("gain,clock_offset,track:1,pointing", scene)
        for k in range(len(p.values(scene)))
    ]
    for number, (parameter, k) in enumerate(own):
        h = steps[found.names[number].rsplit("[", 1)[1].rstrip("]")]
        ends = []
        for step in (h, -h):
            values = parameter.values(scene)
            values[k] += step
            ends.append(simulate(parameter.changed(scene, values)).data.astype(np.complex128))
        difference = (ends[0] - ends[1]) / (2.0 * h)
        off = float(np.linalg.norm(found.derivative[number] - difference))
        # tol: truncation, a sixth of a radian or a hundredth of the beam, and rays that follow the antenna's place; and
        # float32 data over the step, where a beam that is right on the plate does not change
        rounding = 2.0**-20 * float(np.linalg.norm(found.raw.data)) / h
        assert off < 0.02 * float(np.linalg.norm(difference)) + rounding, found.names[number]


def test_a_track_is_found_as_it_was_displaced_from_orbit() -> None:
    """The antenna of the data flies 5 mm higher, at transmission and at reception, 5 ms and 37 m later."""
    scene = two_places("orbit")
    track = scene.radar.track
    higher = replace(track, position=track.position + np.array([0.0, 0.0, 0.005]))
    data = simulate(replace(scene, radar=replace(scene.radar, track=higher)))
    assert data.radar.receives_itself
    found = sarmitsuba.fit(scene, data, "track:1:z")
    # tol: float32 data
    assert found.values == pytest.approx([0.005], abs=1e-6)
