"""Any parameters within the documented bounds give finite data; anything outside gives the one-line error."""

import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sarmitsuba
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.core.parameters import Param
from sarmitsuba.loading import tables

SCENE = """<scene version="3.0.0">
  <integrator type="sar_path">{sar_path}</integrator>
  <sensor type="sar_antenna">{sar_antenna}<film type="range_film">{range_film}</film></sensor>
  <shape type="rectangle"><bsdf type="radar_material">{radar_material}</bsdf></shape>
  <shape type="cube"><transform name="to_world"><scale value="0.3"/><translate x="0.5" z="0.2"/></transform>
    <bsdf type="radar_material"><string name="material" value="concrete"/></bsdf></shape>
  <shape type="sphere"><point name="center" x="-0.5" y="0.5" z="0.1"/><float name="radius" value="0.1"/>
    <bsdf type="point_scatterer">{point_scatterer}</bsdf></shape>
</scene>
"""
# a run of a few milliseconds unless the parameter under test says otherwise
SMALL: dict[str, dict[str, Any]] = {
    "sar_antenna": {"slant_range": 2000.0, "n_pulses": 4, "bandwidth": 150e6},
    "range_film": {"image_extent_azimuth": 4.0, "image_extent_range": 4.0},
    "sar_path": {"ray_spacing": 0.1, "max_depth": 2},
    "radar_material": {"material": "concrete"},
    "point_scatterer": {},
}
CHECKED = (
    tables.SENSOR,
    tables.FILM,
    tables.INTEGRATOR,
    tables.RADAR_MATERIAL,
    tables.POINT_SCATTERER,
)
# files and lists have tests of their own
FREE_TEXT = ("track_file", "recorded_track_file", "polarisation")
PAIRS = {
    f"{t.plugin}.{p.name}": (t, p)
    for t in CHECKED
    for p in t.rows
    if p.kind != "ignored" and p.name not in FREE_TEXT
}


def write(folder: Path, **elements: dict[str, Any]) -> Path:
    """Scene file of the small scene with parameters replaced or added."""
    parts = {}
    for table in CHECKED:
        given_here = SMALL[table.plugin] | elements.get(table.plugin, {})
        tags = {p.name: p.tag for p in table.rows}
        lines = []
        for name, value in given_here.items():
            text = (
                str(value).lower()
                if isinstance(value, bool)
                else repr(value)
                if isinstance(value, float)
                else value
            )
            lines.append(f'<{tags[name]} name="{name}" value="{text}"/>')
        parts[table.plugin] = "".join(lines)
    path = folder / "scene.xml"
    path.write_text(SCENE.format(**parts))
    return path


def inside(param: Param) -> st.SearchStrategy[Any]:
    """Values within the documented bounds, logarithmically over wide ones."""
    if param.allowed:
        return st.sampled_from(param.allowed)
    if param.kind == "boolean":
        return st.booleans()
    low, high = max(param.minimum, -1e12), min(param.maximum, 1e12)
    if param.kind.startswith("integer"):
        return st.integers(int(low), int(high))
    default = low if param.default is None else param.default
    edges = [x for x in (low, high, default) if not (param.positive and x == param.minimum)]
    ways = [st.sampled_from(edges), st.floats(low, high, exclude_min=param.positive)]
    floor = max(low, 1e-9)
    if high > floor:
        exponents = st.floats(math.log10(floor), math.log10(high))
        ways.append(exponents.map(lambda e: min(max(10.0**e, low), high)))
    return st.one_of(ways)


def outside(param: Param) -> list[Any]:
    """Values just and far beyond the bounds."""
    if param.allowed:
        return ["nonsense"]
    whole = param.kind != "float"
    values: list[Any] = []
    if math.isfinite(param.minimum):
        values += [param.minimum - 1, param.minimum - max(1.0, abs(param.minimum))]
        if param.positive:
            values.append(param.minimum)
    if math.isfinite(param.maximum):
        values += [param.maximum + max(1.0, 1e-6 * param.maximum), 1e3 * max(param.maximum, 1.0)]
    return [int(v) if whole else float(v) for v in values]


def one_line(error: BaseException) -> str:
    text = str(error)
    assert "\n" not in text and "Traceback" not in text and re.match(r"\S.*: ", text), text
    return text


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_any_one_parameter_within_its_bounds_loads(tmp_path: Path, data: st.DataObject) -> None:
    """One parameter anywhere in its bounds, the rest small: a scene, or one line about what it clashes with."""
    table, param = PAIRS[data.draw(st.sampled_from(list(PAIRS)))]
    value = data.draw(inside(param))
    path = write(tmp_path, **{table.plugin: {param.name: value}})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            scene = sarmitsuba.load_scene(path)
        except SarmitsubaError as error:
            # never blamed on its own bounds
            assert "is not of type" not in one_line(error)
            assert f"{param.name} = " not in str(error) or "the bound" not in str(error)
            return
    for array in (scene.radar.track.position, scene.radar.window.start_range, scene.geometry.vertices):
        assert np.isfinite(array).all()


@pytest.mark.parametrize("name", PAIRS)
def test_values_out_of_bounds_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    """Beyond each bound of each parameter: file, element, parameter, value, and what is allowed."""
    table, param = PAIRS[name]
    for value in outside(param):
        path = write(tmp_path, **{table.plugin: {param.name: value}})
        with pytest.raises(SarmitsubaError) as caught, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sarmitsuba.load_scene(path)
        text = one_line(caught.value)
        assert text.startswith("scene.xml: ") and param.name in text


# what changes the size of a run has narrower bounds here, so that a run stays small
SIZES = {
    "n_pulses": st.integers(1, 16),
    "slant_range": st.floats(200.0, 1e8),
    "azimuth_resolution": st.floats(0.2, 100.0),
    "prf": st.floats(100.0, 1e4),
    "bandwidth": st.floats(1e6, 4e8),
    "center_frequency": st.floats(2e8, 1e11),
    "sampling_rate": st.floats(4e8, 2e9),
    "ray_spacing": st.floats(0.05, 1.0),
    "diffuse_ray_spacing": st.floats(0.05, 1.0),
    "scatterer_cell": st.floats(0.2, 10.0),
    "max_depth": st.integers(1, 100),
    "key_pulse_interval": st.integers(1, 64),
    "gridding_width": st.integers(2, 8),
    "speed": st.floats(1.0, 1e4),
    "pulse_width": st.floats(1e-8, 1e-4),
    "image_extent_azimuth": st.floats(1.0, 10.0),
    "image_extent_range": st.floats(1.0, 10.0),
    "look_angle_deg": st.floats(1.0, 89.0),
    "squint_angle_deg": st.floats(-60.0, 60.0),
    "heading_deg": st.floats(-360.0, 360.0),
}
# places and switches whose bounds mean only "not this scene": the loader's test above has them
LEFT_OUT = (
    *(
        "aim_x",
        "aim_y",
        "aim_z",
        "image_center_x",
        "image_center_y",
        "image_height",
        "near_range",
        "far_range",
    ),
    *("pixel_spacing_azimuth", "pixel_spacing_range", "time_limit", "target_error_db", "method"),
    *("azimuth_beamwidth_deg", "elevation_beamwidth_deg", "antenna_length", "antenna_height", "pattern"),
    *("keep_orders", "keep_subsets", "default_rms_height"),
)
RUNNABLE = [name for name, (_, p) in PAIRS.items() if p.name not in LEFT_OUT]


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_any_parameters_within_bounds_give_finite_data(tmp_path: Path, data: st.DataObject) -> None:
    """Three parameters at once anywhere in their bounds: finite echoes, or one line that says what clashes."""
    picks = data.draw(st.lists(st.sampled_from(RUNNABLE), min_size=3, max_size=3, unique=True))
    elements: dict[str, dict[str, Any]] = {}
    for table, param in map(PAIRS.__getitem__, picks):
        elements.setdefault(table.plugin, {})[param.name] = data.draw(SIZES.get(param.name, inside(param)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            raw = sarmitsuba.simulate(sarmitsuba.load_scene(write(tmp_path, **elements)))
        except SarmitsubaError as error:
            one_line(error)
            return
    assert np.isfinite(raw.data).all()
    assert raw.data.any()
