"""First pictures of five cities look like pictures, and are drawn again without computing anything."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from sarmitsuba import cli


@pytest.fixture(scope="module")
def cities(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    return benchmark_script("cities")


SMALL = {
    "munich": ("-D", "image_extent_limit=120"),
    "urban_block": ("-D", "range_film.image_extent_azimuth=60"),
}


@pytest.mark.parametrize(
    "name",
    [
        "quarter",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("town", "urban_block", "suburb", "munich")),
    ],
)
def test_a_city_is_less_than_45_per_cent_black(cities: ModuleType, name: str, tmp_path: Path) -> None:
    (city,) = (c for c in cities.CITIES if c.name == name)
    out = cities.render(city, tmp_path, *SMALL.get(name, ()))
    if out is None:
        pytest.skip("sionna-rt, which carries the Munich scene, is not installed")
    grey = cities.shown(out)
    assert cities.black_share(grey) < 0.45
    assert 0.15 < np.median(grey[grey >= cities.BLACK]) < 0.7  # what is not black is not white either
    assert (grey >= 1.0).mean() < 0.05
    record = json.loads((out / "parameters.json").read_text())
    # Munich's domes are faceted, and so small a part of it leaves lit towers at ranges beside the image
    known = ("outside the receive window", "of round metal") if name == "munich" else ()
    assert [w for w in record["warnings"] if not any(text in w for text in known)] == []
    assert record["focus"]["window"] == "taylor"


def test_a_picture_is_drawn_again(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    arguments = [
        "render",
        "dihedral",
        "-o",
        str(out),
        "-D",
        "polarisation=HH,VV",
        "--no-error-bars",
        "--quiet",
    ]
    assert cli.main(arguments) == 0
    capsys.readouterr()
    image, first = (out / "image.h5").read_bytes(), (out / "quicklook.png").read_bytes()
    os.utime(out / "image.h5", (1.0, 1.0))
    assert cli.main(["picture", str(out)]) == 0
    assert capsys.readouterr().out == f"{out / 'quicklook.png'}\n"
    assert (out / "quicklook.png").read_bytes() == first
    more = ["--quantity", "gamma0", "--limits", "-30", "0", "--colour-map", "viridis", "--looks", "2", "2"]
    assert (
        cli.main(["picture", str(out / "image.h5"), "--channel", "VV", *more, "-o", str(tmp_path / "a.png")])
        == 0
    )
    drawn = matplotlib.image.imread(tmp_path / "a.png")[74:-74, 90:-130, :3]
    assert np.ptp(drawn, axis=2).max() > 0.1  # in colour
    assert cli.main(["picture", str(out), "--channel", "VV"]) == 0
    assert (out / "quicklook.png").read_bytes() == first
    assert (out / "image.h5").read_bytes() == image
    assert (out / "image.h5").stat().st_mtime == 1.0


@pytest.fixture(scope="module")
def point(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("point") / "out"
    assert cli.main(["render", "point", "-o", str(out), "--no-error-bars", "--quiet"]) == 0
    return out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--channel", "HV"], 'the image has no channel "HV"; it has VV'),
        (["--colour-map", "viridix"], 'did you mean "viridis"'),
        (["--limits", "3", "-3"], "limits 3 and -3 are not ascending"),
        (["--order", "2"], "bounce order 2 was not kept separately"),
    ],
)
def test_bad_options_get_one_line(point: Path, capsys: Any, arguments: list[str], text: str) -> None:
    capsys.readouterr()
    assert cli.main(["picture", str(point), *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert text in line
    assert cli.main(["picture", str(point.parent / "nothing")]) == 2
