import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sarmitsuba.core.errors import ExtensionError, RadarError, SceneError
from sarmitsuba.core.parameters import Param, ParamTable, did_you_mean
from sarmitsuba.loading.tables import INTEGRATOR, SENSOR, plugin_tables

WHERE = 'scene.xml: sensor "radar"'


def table(*params: Param) -> ParamTable:
    return ParamTable("plugin", "bsdf", "A plugin.", params)


def test_absent_parameters_take_their_defaults() -> None:
    assert SENSOR.read({}, WHERE) == SENSOR.defaults()
    assert SENSOR.read({}, WHERE)["center_frequency"] == 9.6e9


def test_an_integer_is_a_float_but_not_the_other_way_round() -> None:
    assert SENSOR.read({"slant_range": 5000}, WHERE)["slant_range"] == 5000.0
    with pytest.raises(RadarError, match=r"n_pulses = 5\.5 is not of type integer; give an integer"):
        SENSOR.read({"n_pulses": 5.5}, WHERE)


def test_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(
        RadarError, match=r'^scene.xml: sensor "radar": unknown parameter "prff"; did you mean "prf"'
    ):
        SENSOR.read({"prff": 1.0}, WHERE)


def test_names_from_mitsuba_are_refused_with_the_remedy() -> None:
    with pytest.raises(RadarError, match="the geometry is given by slant_range"):
        SENSOR.read({"to_world": None}, WHERE)


def test_error_holds_value_unit_bound_and_remedy() -> None:
    with pytest.raises(RadarError) as caught:
        SENSOR.read({"look_angle_deg": 95.0}, WHERE)
    text = str(caught.value)
    assert "\n" not in text
    for part in (
        "look_angle_deg = 95 deg",
        "above the bound 89.999 deg",
        '<float name="look_angle_deg" value="45"/>',
    ):
        assert part in text


def test_the_bound_itself_is_refused_where_a_value_must_be_positive() -> None:
    with pytest.raises(RadarError, match="look_angle_deg = 0 deg is not above the bound 0 deg"):
        SENSOR.read({"look_angle_deg": 0.0}, WHERE)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_must_be_finite(value: float) -> None:
    with pytest.raises(RadarError, match="is not a finite number"):
        SENSOR.read({"prf": value}, WHERE)


def test_a_boolean_is_no_number() -> None:
    with pytest.raises(RadarError, match="not of type float"):
        SENSOR.read({"prf": True}, WHERE)


@pytest.mark.parametrize(("given_", "read"), [("auto", 0), ("7", 7), (3, 3)])
def test_integer_or_auto(given_: object, read: int) -> None:
    assert INTEGRATOR.read({"max_depth": given_}, WHERE)["max_depth"] == read


def test_text_of_the_command_line_is_parsed_by_kind() -> None:
    assert INTEGRATOR["keep_orders"].parse("true", WHERE, SceneError) is True
    assert INTEGRATOR["max_depth"].parse("auto", WHERE, SceneError) == 0
    assert SENSOR["prf"].parse("1e3", WHERE, RadarError) == 1000.0
    with pytest.raises(SceneError, match='keep_orders = "perhaps" is not of type boolean'):
        INTEGRATOR["keep_orders"].parse("perhaps", WHERE, SceneError)


@settings(max_examples=50)
@given(st.floats(allow_nan=True) | st.integers() | st.text(max_size=8) | st.booleans() | st.none())
def test_every_parameter_takes_or_refuses_anything(value: object) -> None:
    for one in plugin_tables().values():
        for param in one.rows:
            try:
                read = one.read({param.name: value}, WHERE)[param.name]
            except one.error as error:
                assert "\n" not in str(error)
                continue
            if isinstance(read, float) and param.kind == "float":
                assert param.minimum <= read <= param.maximum


def test_every_default_is_within_its_own_bounds() -> None:
    for one in plugin_tables().values():
        for param in one.rows:
            if param.default in ("", None):  # not given; choices apply to given values only
                continue
            assert one.read({param.name: param.default}, WHERE)[param.name] == param.default


def test_every_parameter_is_documented() -> None:
    for one in plugin_tables().values():
        assert one.doc.endswith(".")
        for param in one.rows:
            assert param.doc or param.name == "conductivity"
            assert f"`{param.name}`" in one.markdown()


def test_exclusive_lower_bound_in_words() -> None:
    assert Param("x", "float", 1.0, "x", "m", 0.0, positive=True).bounds_text() == "a number above 0 m"
    assert Param("x", "float", 1.0, "x", "m", maximum=2.0).bounds_text() == "a number of at most 2 m"


def test_did_you_mean_is_silent_without_a_close_name() -> None:
    assert did_you_mean("qqq", ["prf", "speed"]) == ""
    with pytest.raises(SceneError, match="plugin knows a, b"):
        table(Param("a", "float", 0.0, "a"), Param("b", "float", 0.0, "b")).read({"zzzz": 1}, WHERE)


def test_what_comes_on_top_takes_no_name_that_is_taken() -> None:
    table = ParamTable(
        "thing",
        "bsdf",
        "A thing.",
        (Param("size", "float", 1.0, "of it"),),
        more=lambda: (Param("size", "float", 2.0, "another"),),
    )
    with pytest.raises(ExtensionError, match="thing already has a parameter 'size'"):
        table.read({}, "here")


@pytest.mark.parametrize("value", [1e-300, -1e-61, 5e-324])
def test_numbers_whose_powers_underflow_are_refused(value: float) -> None:
    with pytest.raises(SceneError, match=r"nearer to 0 than 1e-60"):
        Param("shift", "float", 0.0, "a shift", "m").convert(value, WHERE, SceneError)
    assert Param("shift", "float", 0.0, "a shift", "m").convert(0, WHERE, SceneError) == 0.0


def test_texts_hold_no_nul() -> None:
    with pytest.raises(RadarError, match="holds the character NUL; leave it out") as caught:
        SENSOR.read({"track_file": "a\0b"}, WHERE)
    assert "\0" not in str(caught.value)
