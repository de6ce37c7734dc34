"""``cost`` on a small scene: the table, the promise, its check and a line that ``render`` takes."""

import json
from pathlib import Path

import pytest

from sarmitsuba.cli import main


def test_recommendation_is_checked_and_can_be_rendered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cost"
    assert main(["cost", "dihedral", "--target-error", "-25", "--budget", "15", "-o", str(out)]) == 0
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
    facts = json.loads((out / "cost.json").read_text())
    assert facts["met"] and facts["recommended"]["measured"]
    assert facts["recommended"]["error_db"] <= -25.0
    # tol: 2 dB, what the command promises
    assert abs(facts["check"]["error_db"] - facts["recommended"]["error_db"]) < 2.0
    assert (out / "cost.png").stat().st_size > 0
    line = next(x for x in text.splitlines() if "python -m sarmitsuba render" in x)
    words = line.split()[3:]
    words[words.index("OUT")] = str(tmp_path / "image")
    assert main(words) == 0
    assert (tmp_path / "image" / "image.h5").exists()
