"""The same seed gives the same bits from the command line, from Python in one step, and from Python in two."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba import cli
from sarmitsuba.core.errors import DataError, SarmitsubaWarning

SMALL = {
    "range_film.pixels_azimuth": "16",
    "range_film.pixels_range": "16",
    "sar_path.ray_spacing": "1.0",
    "sar_path.diffuse_pairs": "off",
}


def draw_case(number: int) -> dict[str, Any]:
    """Method, focuser, window, seed and settings of a case."""
    generator = np.random.default_rng(5200 + number)
    method = ("hybrid", "image", "raster", "hybrid", "hybrid")[number % 5]
    focuser = str(generator.choice(["backprojection", "factorised", "omega_k"]))
    more = {"sar_antenna.noise_temperature": "300"} if generator.random() < 0.5 else {}
    if generator.random() < 0.5 and method != "raster":
        more["sar_path.keep_orders"] = "true"
    if number == 4:  # one pass only: the time is over at once
        more |= {"sar_path.target_error_db": "-60", "sar_path.time_limit": "0.001"}
    window = str(generator.choice(["taylor", "rectangular", "hamming"]))
    return {
        "method": method,
        "focuser": focuser,
        "window": window,
        "seed": int(generator.integers(100)),
        "more": more,
    }


@pytest.mark.filterwarnings("ignore::sarmitsuba.SarmitsubaWarning")
@pytest.mark.parametrize("number", [0, 1, *(pytest.param(i, marks=pytest.mark.slow) for i in range(2, 15))])
def test_all_ways_from_a_scene_to_an_image_give_the_same_bits(tmp_path: Path, number: int) -> None:
    case = draw_case(number)
    parameters = {**SMALL, **case["more"]}
    windows = {"range_window": case["window"], "azimuth_window": case["window"]}
    arguments = [x for name, value in parameters.items() for x in ("-D", f"{name}={value}")]
    arguments += [
        "--method",
        case["method"],
        "--seed",
        str(case["seed"]),
        "--window",
        case["window"],
        "--no-chart",
    ]
    out = tmp_path / "out"
    assert (
        cli.main(["render", "tower", *arguments, "--focuser", case["focuser"], "-o", str(out), "--quiet"])
        == 0
    )
    written = sarmitsuba.read_image(out / "image.h5")

    given = {"parameters": parameters, "method": case["method"], "seed": case["seed"]}
    one = sarmitsuba.render("tower", focuser=case["focuser"], **given, **windows)
    assert one.layers == written.layers
    np.testing.assert_array_equal(one.data, written.data)
    assert "sampling_error" in one.metadata or case["method"] == "raster"
    if case["method"] == "hybrid":
        scene = sarmitsuba.load_scene("tower", parameters=parameters)
        raw = sarmitsuba.simulate(scene, seed=case["seed"])
        np.testing.assert_array_equal(raw.data, sarmitsuba.read_raw(out / "raw.h5").data)
        two = sarmitsuba.focus(raw, focuser=case["focuser"], **windows)
        np.testing.assert_array_equal(two.data, written.data)


@pytest.mark.parametrize("method", ["image", "raster"])
def test_methods_without_raw_data_say_so_on_every_way(tmp_path: Path, method: str, capsys: Any) -> None:
    parameters = {**SMALL, "sar_path.method": method}
    with pytest.raises(DataError, match="makes an image without raw data; render it"):
        sarmitsuba.simulate("tower", parameters=parameters)
    with pytest.raises(DataError, match="makes one pass only; leave out target_error_db"):
        sarmitsuba.render("tower", parameters=parameters, target_error_db=-40.0)
    arguments = ["render", "tower", "--method", method, "--target-error", "-40", "-o", str(tmp_path / "out")]
    assert cli.main(arguments) == 2
    assert "makes one pass only; leave out target_error_db" in capsys.readouterr().err


def test_python_adds_passes_that_a_scene_asks_for() -> None:
    parameters = {**SMALL, "sar_path.target_error_db": "-16"}
    with pytest.warns(SarmitsubaWarning):  # of the coarse rays
        image = sarmitsuba.render("tower", parameters=parameters, seed=1)
    assert image.metadata["refinement"]["passes"] > 1 and image.metadata["refinement"]["met"]
