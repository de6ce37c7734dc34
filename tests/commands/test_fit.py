"""The commands `fit` and `derivative`, on a small field of rough soil."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from sarmitsuba import cli
from sarmitsuba.files import read_image, read_raw, write_raw
from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.render import simulate

FIELD = """<scene version="3.0.0">
    <default name="level" value="-10"/>
    <integrator type="sar_path"><string name="diffuse_pairs" value="off"/></integrator>
    <sensor type="sar_antenna">
        <float name="slant_range" value="3000"/><float name="look_angle_deg" value="40"/>
        <float name="center_frequency" value="9.65e9"/><float name="bandwidth" value="150e6"/>
        <integer name="n_pulses" value="8"/><float name="noise_temperature" value="0"/>
        <film type="range_film">
            <float name="image_extent_azimuth" value="12"/><float name="image_extent_range" value="12"/>
        </film>
    </sensor>
    <shape type="rectangle"><transform name="to_world"><scale value="9"/></transform>
        <bsdf type="radar_material" id="soil">
            <string name="diffuse_law" value="lambert"/><float name="diffuse_level_db" value="$level"/>
            <float name="permittivity_real" value="5"/><float name="rms_height" value="0.02"/>
        </bsdf>
    </shape>
</scene>
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "field.xml"
    path.write_text(FIELD, encoding="utf-8")
    write_raw(simulate(load_scene(path, parameters={"level": "-7.5"})), tmp_path / "raw.h5")
    return path


def test_a_level_is_fitted_to_two_looks_and_written(scene: Path, capsys: Any) -> None:
    data, out = str(scene.parent / "raw.h5"), scene.parent / "out"
    command = ["fit", str(scene), "--data", data, data, "--parameters", "levels", "-o", str(out)]
    assert cli.main([*command, "--prior", "level:soil=-10:5"]) == 0
    said = capsys.readouterr().out
    assert "level:soil [dB]" in said and "converged after" in said
    record = json.loads((out / "fit.json").read_text(encoding="utf-8"))
    # tol: data of the scene's own model, float32; the prior weighs as noise of -60 dB
    assert record["values"] == pytest.approx([-7.5], abs=1e-3)
    assert record["start"] == [-10.0] and record["converged"] is True
    assert record["confirmed"] == [pytest.approx(1.0, abs=1e-4)] and len(record["steps"]) > 1
    measured = read_raw(data).data
    for look in ("residual", "residual_2"):
        assert np.linalg.norm(read_raw(out / f"{look}.h5").data) < 1e-3 * np.linalg.norm(measured)
        assert (out / f"{look}.png").read_bytes().startswith(b"\x89PNG")
    with Image.open(out / "residual.png") as picture:
        assert picture.size[0] == 1400 and np.ptp(np.asarray(picture.convert("L"))) > 200


def test_rounds_by_amplitude_say_their_windows(scene: Path, capsys: Any) -> None:
    command = ["fit", str(scene), "--data", str(scene.parent / "raw.h5"), "--parameters", "levels"]
    out = scene.parent / "out"
    assert cli.main([*command, "--by", "amplitude", "-o", str(out)]) == 0
    said = capsys.readouterr()
    assert "step 1: residual" in said.err and "averaged over 8 range cells" in said.err
    assert "averaged over 3 range cells" in said.err and " W," not in said.out
    assert "in windows of 3 range cells" in said.out
    record = json.loads((out / "fit.json").read_text(encoding="utf-8"))
    assert record["windows"] == [8, 8, 6, 6, 4, 4, 3, 3, 3, 3, 3] and len(record["costs"]) == 11
    # tol: by intensity the speckle of the model is that of the data; dB
    assert record["values"] == pytest.approx([-7.5], abs=0.05)


def test_wrong_options_are_one_line(scene: Path, capsys: Any) -> None:
    command, run = ["fit", str(scene), "--data", str(scene.parent / "raw.h5"), "--parameters"], scene.parent
    for options, reason in (
        (["roughness"], "'roughness' is not one of gain"),
        (["height:house"], 'no shape "house"; there are'),
        (["levels", "--data", str(run)], f"is the folder of a run; give its file {run / 'raw.h5'}"),
        (["levels", "--prior", "level:soil=3"], "is not of the form NAME=MEAN:SIGMA"),
        (["levels", "--iterations", "0"], "must be at least 1"),
        (["levels", "--data", "a.h5", "b.h5", "--radar", "c.xml"], "each look has the radar of its data"),
    ):
        assert cli.main([*command, *options]) == 2
        assert reason in capsys.readouterr().err


def test_a_derivative_is_drawn_and_written(tmp_path: Path, capsys: Any) -> None:
    path, out = tmp_path / "field.xml", tmp_path / "out"
    path.write_text(FIELD, encoding="utf-8")
    assert cli.main(["derivative", str(path)]) == 0
    listed = capsys.readouterr().out.split()
    assert {"level:soil", "permittivity:soil", "rms_height:soil", "gain"} <= set(listed)
    command = ["derivative", str(path), "--parameter", "level:soil", "-o", str(out)]
    assert cli.main([*command, "--change", "2", "--simulate"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("level:soil: +2 dB simulated") and said[-1] == str(out / "derivative.png")
    record = json.loads((out / "derivative.json").read_text(encoding="utf-8"))
    x = 2.0 * np.log(10.0) / 20.0
    assert record["stated_error"] == pytest.approx(0.5 * x) and record["value"] == -10.0
    # all echoes of the field grow by exp(x); tol: float32 images
    assert record["simulated_error"] == pytest.approx((np.exp(x) - 1.0 - x) / (np.exp(x) - 1.0), rel=1e-3)
    assert read_image(out / "derivative.h5").data.any()
    with Image.open(out / "derivative.png") as picture:
        assert picture.size[0] == 1400
    for options, reason in (
        (["--parameter", "level:roof"], 'no material "roof"; there are soil'),
        (["--parameter", "track:2:x"], "is by one value, not by 2"),
        (["--simulate"], "give --parameter"),
    ):
        assert cli.main(["derivative", str(path), *options, "-o", str(out)]) == 2
        assert reason in capsys.readouterr().err


@pytest.mark.parametrize("change", ["nan", "inf", "5mm"])
def test_a_change_is_a_finite_number(change: str, tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(
            ["derivative", "tower", "--parameter", "gain", "--change", change, "-o", str(tmp_path / "out")]
        )
    assert stop.value.code == 2 and f"'{change}' is no finite number" in capsys.readouterr().err
