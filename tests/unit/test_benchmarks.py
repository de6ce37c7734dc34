"""Benchmarks are found by their files; one's own is run by its path."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RUN_ALL = ROOT / "benchmarks" / "run_all.py"


def example() -> str:
    """The benchmark of the documentation."""
    pages = (ROOT / "docs").glob("extending*.md")
    text = next(t for t in (p.read_text(encoding="utf-8") for p in pages) if "## A benchmark\n" in t)
    found = re.search(r"```python\n(.*?)```", text[text.index("## A benchmark\n") :], re.DOTALL)
    assert found
    return found.group(1)


def run_all(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, str(RUN_ALL), *arguments], capture_output=True, text=True, cwd=ROOT
    )


def test_a_benchmark_of_ones_own_is_given_by_its_path(tmp_path: Path) -> None:
    file = tmp_path / "my_transform.py"
    file.write_text(example(), encoding="utf-8")
    done = run_all(str(file), "--only", "my_transform", "--quick", "-o", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert "Fourier transforms" in done.stdout
    report = json.loads((tmp_path / "out" / "my_transform.json").read_text(encoding="utf-8"))
    assert [row[0] for row in report["tables"][0]["rows"]] == ["one piece", "two pieces"]


def test_every_benchmark_beside_run_all_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The names are listed when one is wrong."""
    monkeypatch.syspath_prepend(str(RUN_ALL.parent))
    module = importlib.import_module("run_all")

    def said(*arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", ["run_all.py", *arguments])
        with pytest.raises(SystemExit) as ended:
            module.main()
        assert ended.value.code == 2
        return capsys.readouterr().err

    listed = set(said("--only", "nothing").rpartition("choose one of ")[2].strip().split(", "))
    files = {p.stem for p in RUN_ALL.parent.glob("*.py") if "\n@harness.benchmark\n" in p.read_text("utf-8")}
    assert listed == files and {"speed", "focusers", "accumulators"} <= files
    # a second benchmark of one name would hide the first
    double = tmp_path / "speed.py"
    double.write_text(example(), encoding="utf-8")
    assert "there is a benchmark 'speed' already" in said(str(double))


def test_sections_that_were_not_run_stay_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(RUN_ALL.parent)
    run_all_module = importlib.import_module("run_all")
    harness = importlib.import_module("harness")
    harness.discover()
    page, out = tmp_path / "benchmarks.md", tmp_path / "out"
    before = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    page.write_text(before, encoding="utf-8")
    out.mkdir()
    run_all_module.collect(out, page)
    assert page.read_text(encoding="utf-8") == before
    (out / "methods.md").write_text("## Methods\n\nnew\n", encoding="utf-8")
    run_all_module.collect(out, page)
    after = page.read_text(encoding="utf-8")
    assert "## Methods\n\nnew\n" in after and after.count("## Methods\n") == 1
    kept = [line for line in before.splitlines() if line.startswith("## ")]
    assert [line for line in after.splitlines() if line.startswith("## ")] == kept
