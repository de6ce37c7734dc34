"""Benchmarks are found by their files; one's own is run by its path."""

import importlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"


def example() -> str:
    """The benchmark of the documentation."""
    pages = (ROOT / "docs").glob("extending*.md")
    text = next(t for t in (p.read_text(encoding="utf-8") for p in pages) if "## A benchmark\n" in t)
    found = re.search(r"```python\n(.*?)```", text[text.index("## A benchmark\n") :], re.DOTALL)
    assert found
    return found.group(1)


def run_all(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "benchmarks.run_all", *arguments], capture_output=True, text=True, cwd=ROOT
    )


def test_a_benchmark_of_ones_own_is_given_by_its_path(tmp_path: Path) -> None:
    file = tmp_path / "my_transform.py"
    file.write_text(example(), encoding="utf-8")
    done = run_all(str(file), "--only", "my_transform", "--quick", "-o", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert "Fourier transforms" in done.stdout
    report = json.loads((tmp_path / "out" / "my_transform.json").read_text(encoding="utf-8"))
    assert [row[0] for row in report["tables"][0]["rows"]] == ["one piece", "two pieces"]


@pytest.fixture
def runner(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    """``benchmarks/run_all.py`` with every benchmark of the suite registered."""
    module = importlib.import_module("benchmarks.run_all")
    benchmark_script("harness").discover()
    return module


def test_every_benchmark_of_the_suite_is_found(
    runner: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The names are listed when one is wrong."""

    def said(*arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", ["run_all.py", *arguments])
        with pytest.raises(SystemExit) as ended:
            runner.main()
        assert ended.value.code == 2
        return capsys.readouterr().err

    listed = set(said("--only", "nothing").rpartition("choose one of ")[2].strip().split(", "))
    files = {path.stem for path in scripts("suite")}
    assert listed == files and {"speed", "focusers", "accumulators"} <= files
    # a second benchmark of one name would hide the first
    double = tmp_path / "speed.py"
    double.write_text(example(), encoding="utf-8")
    assert "there is a benchmark 'speed' already" in said(str(double))


def scripts(folder: str) -> list[Path]:
    return [p for p in sorted((BENCHMARKS / folder).glob("*.py")) if not p.stem.startswith("_")]


def test_folders_hold_what_they_say() -> None:
    """The suite is what is registered, a study runs by itself, what two scripts of other folders share is support."""
    modules = {path.stem: folder for folder in ("suite", "studies", "support") for path in scripts(folder)}
    assert len(modules) == sum(len(scripts(folder)) for folder in ("suite", "studies", "support"))
    wrong = []
    for name, folder in modules.items():
        text = (BENCHMARKS / folder / f"{name}.py").read_text(encoding="utf-8")
        if ("\n@harness.benchmark\n" in text) != (folder == "suite"):
            wrong.append(f"{folder}/{name}.py: registered benchmarks are the suite")
        if folder == "studies" and '__name__ == "__main__"' not in text:
            wrong.append(f"{folder}/{name}.py does not run by itself")
        wrong += [
            f"{folder}/{name}.py imports of {used}"
            for used in re.findall(r"^\s*from benchmarks\.(\w+)", text, re.MULTILINE)
            if used not in {folder, "support"}
        ]
        if "sys.path" in text:
            wrong.append(f"{folder}/{name}.py changes the search path")
    assert not wrong, "\n".join(sorted(set(wrong)))


def test_the_page_has_what_was_measured_and_lists_every_script(
    runner: ModuleType, benchmark_script: Callable[[str], ModuleType], tmp_path: Path
) -> None:
    page, out = tmp_path / "benchmarks.md", tmp_path / "out"
    out.mkdir()
    (out / "kill.md").write_text("## Killed runs\n\n![k](kill_time.png)\n", encoding="utf-8")
    (out / "kill_time.png").write_bytes(b"picture")
    (out / "error_time.md").write_text("## Error against seconds\n", encoding="utf-8")
    (out / "deleted.md").write_text("## A benchmark that is gone\n", encoding="utf-8")
    runner.collect(out, page)
    text = page.read_text(encoding="utf-8")
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == [
        *("Error against seconds", "Killed runs"),  # what accuracy costs comes first
        *("All benchmarks", "Studies", "What the scripts share"),
    ]
    assert (tmp_path / "images" / "benchmarks" / "kill_time.png").read_bytes() == b"picture"
    assert "![k](images/benchmarks/kill_time.png)" in text
    listing = benchmark_script("listing")
    for folder in ("suite", "studies", "support"):
        sentences = listing.scripts(folder)
        assert set(sentences) == {path.stem for path in scripts(folder)}
        for name, sentence in sentences.items():
            assert sentence.endswith(".") and f"| `{name}` | {sentence} |" in text, name
    for name in benchmark_script("harness").BENCHMARKS.names:
        (row,) = re.findall(rf"^\| `{name}` \| .* \| (.*) \|$", text, re.MULTILINE)
        run = {
            "kill": "[Killed runs](#killed-runs)",
            "error_time": "[Error against seconds](#error-against-seconds)",
        }
        assert row == run[name] if name in run else row.startswith(listing.NOT_YET), name
    made = page.stat().st_mtime_ns
    runner.collect(out, page)  # a page that is the same is not written, so that the site is not read again
    assert page.stat().st_mtime_ns == made
