"""The commands `insar` and `interferogram`, on the smallest scene."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.files import read_image, read_raw


@pytest.fixture(scope="module")
def pair(tmp_path_factory: Any) -> Path:
    out = Path(tmp_path_factory.mktemp("insar"))
    assert cli.main(["insar", "point", "-o", str(out / "out"), "--baseline", "40", "--looks", "2", "2"]) == 0
    return out / "out"


def test_a_pair_is_rendered_and_evaluated(pair: Path) -> None:
    record = json.loads((pair / "interferogram.json").read_text(encoding="utf-8"))
    assert record["baseline"]["perpendicular_m"] == pytest.approx(40.0, rel=1e-6)
    assert record["baseline"]["passes"] == 2 and record["looks"] == [2, 2]
    assert record["days"] == 1.0
    assert (pair / "interferogram.png").stat().st_size > 5000
    with np.load(pair / "heights.npz") as arrays:
        assert arrays["points"].shape == (*record["shape"], 3)
    # the second pass flies beside the first, and its image was not made: its data are focused on the first's grid
    one, two = (read_raw(pair / name / "raw.h5").radar.track for name in ("first", "second"))
    moved = two.center_position - one.center_position
    assert np.linalg.norm(moved) == pytest.approx(40.0, rel=1e-6)
    assert not (pair / "second" / "image.h5").exists()


def test_runs_that_are_there_are_evaluated_again(pair: Path, tmp_path: Path, capsys: Any) -> None:
    runs = [str(pair / "first"), str(pair / "second")]
    options = ["-o", str(tmp_path), "--looks", "2", "2", "--common-band", "--unwrap"]
    assert cli.main(["interferogram", *runs, *options]) == 0
    said = capsys.readouterr().out
    assert (
        "two passes 1 day apart, VV" in said
        and "perpendicular 40 m" in said
        and "focused on the grid" in said
    )
    record = json.loads((tmp_path / "interferogram.json").read_text(encoding="utf-8"))
    assert record["band"] == "common" and record["unwrapped"] is True
    with np.load(tmp_path / "heights.npz") as arrays:
        middle = tuple(n // 2 for n in record["shape"])
        assert arrays["coherence"][middle] > 0.95  # the point itself, whose main lobe is cut a little
        # tol: half a pixel of slant range
        assert abs(arrays["points"][middle][2]) < 0.3


def test_what_makes_no_pair_is_one_line(pair: Path, tmp_path: Path, capsys: Any) -> None:
    image = pair / "first" / "image.h5"
    assert read_image(image).grid.kind == "slant"
    bare = tmp_path / "bare"
    bare.mkdir()
    assert cli.main(["interferogram", str(image), str(bare), "-o", str(tmp_path / "o")]) == 2
    assert "holds no image" in capsys.readouterr().err
    shutil.copy(pair / "second" / "raw.h5", bare / "raw.h5")
    assert cli.main(["focus", str(bare / "raw.h5"), "-o", str(bare), "--quiet"]) == 0
    (bare / "raw.h5").unlink()
    assert cli.main(["interferogram", str(image), str(bare), "-o", str(tmp_path / "o")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is on another grid than the first, and there are no raw data" in line
    assert cli.main(["interferogram", str(image), str(image), "-o", str(tmp_path / "same")]) == 0
    assert not (tmp_path / "same" / "heights.npz").exists()  # no baseline, no heights
    assert cli.main(["insar", "point", "-o", str(tmp_path / "x"), "--no-focus"]) == 2
    assert "--no-focus and --page belong to render" in capsys.readouterr().err
    assert cli.main(["insar", "point", "-o", str(tmp_path / "x"), "--one-pass", "--days", "3"]) == 2
    assert "--days 3 with --one-pass, whose two images are of one time" in capsys.readouterr().err
    assert cli.main(["insar", "point", "-o", str(tmp_path / "x"), "--days", "nan"]) == 2
    assert "--days nan is not between 0 and 100000 days" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_there_are_no_heights_in_radar_shadow(tmp_path: Path, capsys: Any) -> None:
    """Behind the tower side lobes alone are left: their phase gave heights of 30 m."""
    coarse = ["-D", "sar_antenna.azimuth_resolution=1", "-D", "sar_antenna.bandwidth=150e6"]
    assert cli.main(["insar", "tower", "-o", str(tmp_path / "out"), *coarse]) == 0
    assert "none (nan) in radar shadow" in capsys.readouterr().out
    with np.load(tmp_path / "out" / "heights.npz") as arrays:
        z = arrays["points"][..., 2]
    behind = z[:, z.shape[1] // 2 + 1 :]  # of the tower, on level ground
    # tol: side lobes of the line at its foot; the heights in shadow were 24 to 30 m
    assert 0.05 < np.isnan(z).mean() < 0.2 and np.nanmax(np.abs(behind)) < 3.0
    (tmp_path / "out" / "first" / "parameters.json").unlink()
    pair = [str(tmp_path / "out" / name) for name in ("first", "second")]
    assert cli.main(["interferogram", *pair, "-o", str(tmp_path / "again")]) == 0
    assert "heights in radar shadow are not masked" in capsys.readouterr().err
