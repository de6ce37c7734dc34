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


@pytest.fixture
def runner(benchmark_script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """``benchmarks/run_all.py`` with every benchmark of the suite registered."""
    monkeypatch.syspath_prepend(str(RUN_ALL.parent))
    module = importlib.import_module("run_all")
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
    return [p for p in sorted((RUN_ALL.parent / folder).glob("*.py")) if not p.stem.startswith("_")]


def test_folders_hold_what_they_say() -> None:
    """The suite is what is registered, a study runs by itself, what two scripts of other folders share is support."""
    modules = {path.stem: folder for folder in ("suite", "studies", "support") for path in scripts(folder)}
    assert len(modules) == sum(len(scripts(folder)) for folder in ("suite", "studies", "support"))
    wrong = []
    for name, folder in modules.items():
        text = (RUN_ALL.parent / folder / f"{name}.py").read_text(encoding="utf-8")
        if ("\n@harness.benchmark\n" in text) != (folder == "suite"):
            wrong.append(f"{folder}/{name}.py: registered benchmarks are the suite")
        if folder == "studies" and '__name__ == "__main__"' not in text:
            wrong.append(f"{folder}/{name}.py does not run by itself")
        for used in re.findall(r"^\s*(?:import|from) (\w+)\b", text, re.MULTILINE):
            if modules.get(used, folder) not in {folder, "support"}:
                wrong.append(f"{folder}/{name}.py imports {used} of {modules[used]}")
            # a script's own folder is on the search path, the one that all share is put there
            if folder != "support" and modules.get(used) == "support" and "\nimport _support\n" not in text:
                wrong.append(f"{folder}/{name}.py imports {used} without _support")
    assert not wrong, "\n".join(sorted(set(wrong)))


def test_the_page_lists_every_script_and_shows_or_names_every_benchmark(
    runner: ModuleType, benchmark_script: Callable[[str], ModuleType], tmp_path: Path
) -> None:
    page = tmp_path / "benchmarks.md"
    before = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    page.write_text(before, encoding="utf-8")
    runner.collect(None, page)
    assert page.read_text(encoding="utf-8") == before, "run: python benchmarks/run_all.py --list"
    listing = benchmark_script("listing")
    for folder in ("suite", "studies", "support"):
        sentences = listing.scripts(folder)
        assert set(sentences) == {path.stem for path in scripts(folder)}
        for name, text in sentences.items():
            assert text.endswith(".") and f"| `{name}` | {text} |" in before, name
    for name in benchmark_script("harness").BENCHMARKS.names:
        (row,) = re.findall(rf"^\| `{name}` \| .* \| (.*) \|$", before, re.MULTILINE)
        shown = re.search(r"^\[(.+?)\]\(#", row)
        assert bool(shown) == (f"<!-- benchmark: {name} -->\n" in before)
        assert (f"\n## {shown[1]}\n" in before) if shown else row.startswith(listing.NOT_YET), name


def test_sections_that_were_not_run_stay_on_the_page(runner: ModuleType, tmp_path: Path) -> None:
    page, out = tmp_path / "benchmarks.md", tmp_path / "out"
    before = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    page.write_text(before, encoding="utf-8")
    out.mkdir()
    runner.collect(out, page)
    assert page.read_text(encoding="utf-8") == before
    (out / "methods.md").write_text("## Methods\n\nnew\n", encoding="utf-8")
    (out / "kill.md").write_text("## Killed runs\n\nmeasured now\n", encoding="utf-8")
    runner.collect(out, page)
    after = page.read_text(encoding="utf-8")
    older = f"{runner.OLDER}\n\n"  # sections that do not say their kernels say in their first line that they are old
    assert f"## Methods\n\n{older}new\n" in after and after.count("## Methods\n") == 1
    assert f"## Killed runs\n\n{older}measured now\n" in after and "| [Killed runs](#killed-runs) |" in after

    def sections(text: str) -> list[str]:
        return re.findall(r"^<!-- benchmark: (\w+) -->$", text, re.MULTILINE)

    assert sections(after) == list(dict.fromkeys([*sections(before), "kill"]))
    # a page that is made from nothing names the machine
    page.unlink()
    runner.collect(out, page)
    assert "| cores |" in page.read_text(encoding="utf-8")


def test_the_hash_of_sources_counts_code_and_not_words(benchmark_script: Callable[[str], ModuleType]) -> None:
    sources = benchmark_script("kernel_sources")
    code = (
        'class A:\n    """Words."""\n\n    # more words\n    def f(self):\n'
        '        """Words,\n        two lines.\n        """\n        return "# no comment"\n'
    )
    plain = 'class A:\n    def f(self):\n        return "# no comment"'
    assert sources.without_words(code) == plain
    assert sources.without_words(plain + "  \n\n") == plain
    assert sources.without_words(plain.replace("no", "another")) != plain


def test_figures_hold_while_every_change_has_its_reason(
    benchmark_script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    sources, stored = benchmark_script("kernel_sources"), benchmark_script("stored")
    monkeypatch.setattr(stored, "FOLDER", tmp_path)
    now = "a" * 12
    monkeypatch.setattr(sources, "current", lambda: now)
    assert sources.holds(now) and not sources.holds("b" * 12)
    sources.measured()
    now = "b" * 12
    assert not sources.holds("a" * 12)
    sources.still_holds("only names changed")
    assert sources.holds("a" * 12) and sources.holds("b" * 12)
    now = "c" * 12
    sources.measured()  # another benchmark is measured anew: that is no reason for the first
    assert sources.holds("c" * 12) and not sources.holds("a" * 12)
    sources.still_holds("the same bits")
    assert sources.holds("a" * 12)
