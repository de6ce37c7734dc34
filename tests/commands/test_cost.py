"""``cost`` on a small scene: the table, the estimate, its check and a line that ``render`` takes."""

import json
from functools import partial
from pathlib import Path

import pytest

from sarmitsuba.apps.cost import study_cost
from sarmitsuba.apps.cost_trials import WorkClock
from sarmitsuba.cli import main


@pytest.fixture(autouse=True)
def counted_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Budgets buy the same runs on every machine."""
    monkeypatch.setattr("sarmitsuba.apps.cost.study_cost", partial(study_cost, clock=WorkClock()))


@pytest.mark.slow
def test_recommendation_is_checked_and_can_be_rendered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cost"
    assert main(["cost", "dihedral", "--target-error", "-25", "--budget", "30", "-o", str(out)]) == 0
    text = capsys.readouterr().out
    for name in (
        "max_depth",
        "ray_spacing",
        "key_pulse_interval",
        "gridding_width",
        "phase_precision",
        "focuser",
    ):
        assert f"| {name} |" in text
    record = json.loads((out / "cost.json").read_text())
    assert record["met"] and record["recommended"]["measured"] and record["estimate"] == "measured"
    assert "(predicted)" not in next(x for x in text.splitlines() if x.startswith("recommended for"))
    assert record["estimated_against_factor"] == 0.5 and record["estimated_against"] in text
    assert record["recommended"]["error_db"] <= -25.0
    # tol: 2 dB, what the command estimates
    assert abs(record["check"]["error_db"] - record["recommended"]["error_db"]) < 2.0
    assert (out / "cost.png").stat().st_size > 0
    another = ["cost", "dihedral", "-D", "sar_path.seed=8", "--budget", "1", "-o", str(out)]
    assert main(another) == 2
    assert "holds a study of another scene" in capsys.readouterr().err
    assert json.loads((out / "cost.json").read_text()) == record
    line = next(x for x in text.splitlines() if "python -m sarmitsuba render" in x)
    words = line.split()[3:]
    words[words.index("OUT")] = str(tmp_path / "image")
    assert main(words) == 0
    assert (tmp_path / "image" / "image.h5").exists()


@pytest.mark.slow
def test_what_the_study_switches_off_the_line_to_render_does(tmp_path: Path) -> None:
    out = tmp_path / "cost"
    words = ["range_film.image_extent_azimuth=20", "range_film.image_extent_range=20"]
    words += ["sar_antenna.azimuth_resolution=6", "sar_antenna.n_pulses=64", "sar_path.keep_orders=true"]
    given = [w for word in words for w in ("-D", word)]
    assert (
        main(["cost", "flat_ground", *given, "--target-error", "-40", "--budget", "12", "-o", str(out)]) == 0
    )
    record = json.loads((out / "cost.json").read_text())
    assert "-D sar_path.keep_orders=false" in record["options"]
