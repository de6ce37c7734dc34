"""The command ``depth``: error, energy and time by number of bounces."""

import json
import math
from pathlib import Path

import pytest

from sarmitsuba.apps.depth import study_depth
from sarmitsuba.cli import main
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.load import load_scene


def test_a_dihedral_is_its_second_bounce(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["depth", "dihedral", "--deepest", "3", "--json", "-o", str(tmp_path)])
    rows = json.loads(capsys.readouterr().out)
    assert [row["bounces"] for row in rows] == [1, 2, 3]
    # its faces send single bounces away from the radar; what ends at the second bounce is the whole image
    assert rows[0]["error_db"] == pytest.approx(0.0, abs=0.1)  # tol: side lobes of the single bounces, -20 dB
    assert rows[1]["energy_db"] == pytest.approx(0.0, abs=0.1)
    assert rows[1]["error_db"] < -50.0  # tol: waves that meet both edges and a face, -60 dB
    assert rows[2]["error_db"] is None
    assert rows[0]["changed"] == 1.0 and rows[2]["changed"] < 0.01
    assert all(row["seconds"] > 0.0 for row in rows)
    assert {path.name for path in tmp_path.glob("depth*")} == {
        "depth.json",
        "depth.png",
        "depth_images.png",
        "depth_orders.png",
    }


def test_images_by_depth_add_up() -> None:
    study = study_depth(load_scene("trihedral"), deepest=3, timed=False)
    total = sum(study.image_of(n).total() for n in (1, 2, 3))
    assert (
        abs(total - study.image_up_to(3).total()).max() <= 1e-6 * abs(total).max()
    )  # tol: order of float32 sums
    assert study.rows[1].error_db > -3.0  # the third bounce is the corner's


@pytest.mark.parametrize(
    "name, changes, words",
    [("point", {}, "no surfaces"), ("plate", {"sar_path.method": "raster"}, "one bounce")],
)
def test_scenes_without_bounces_are_refused(name: str, changes: dict[str, str], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        study_depth(load_scene(name, parameters=changes), timed=False)


def test_one_object_by_mechanism(capsys: pytest.CaptureFixture[str]) -> None:
    """The corner's triple bounce is 4 pi a^4 / (3 lambda^2) = 36.375 dBsm; a name that is none gets a hint."""
    assert main(["depth", "trihedral", "--only", "tri*", "--json"]) == 0
    rows = {row["mechanism"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["triple bounce"]["bounces"] == "3"
    # tol: side lobes beyond the image, and rays of the corner's rims
    assert 10.0 * math.log10(rows["triple bounce"]["rcs_m2"]) == pytest.approx(36.375, abs=0.2)
    assert sum(row["rcs_m2"] for row in rows.values()) < 1.01 * rows["triple bounce"]["rcs_m2"]
    assert main(["depth", "trihedral", "--only", "trihedrel"]) == 2
    assert 'did you mean "trihedral"?' in capsys.readouterr().err
