"""The tutorials: every notebook runs, its own assertions hold, and it is kept without output."""

import ast
import json
import os
import re
import warnings
from pathlib import Path

import pytest

from sarmitsuba.errors import SarmitsubaWarning

FOLDER = Path(__file__).parents[2] / "docs" / "tutorials"
BOOKS = sorted(FOLDER.glob("*.ipynb"))
# those that overrule the program on purpose, and are told so
WARNED = {"10_accuracy", "11_effects"}


def code_of(book: Path) -> list[str]:
    cells = json.loads(book.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def run(book: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run the cells in this process, as a notebook would; the number of pictures made."""
    import matplotlib.pyplot as plt
    from matplotlib.figure import Figure

    monkeypatch.chdir(folder)
    names: dict[str, object] = {"__name__": "__main__"}
    pictures = 0
    plt.close("all")
    for number, cell in enumerate(code_of(book)):
        tree = ast.parse(cell)
        shown = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, f"{book.stem} cell {number}", "exec"), names)
        if isinstance(shown, ast.Expr):
            value = eval(compile(ast.Expression(shown.value), f"{book.stem} cell {number}", "eval"), names)
            assert isinstance(repr(value), str)
            pictures += isinstance(value, Figure)
        pictures += len(plt.get_fignums())
        plt.close("all")
    return pictures


# `make docs` runs all of them
QUICK = ("01", "09")
RUN = [
    pytest.param(book, id=book.stem, marks=() if book.stem.startswith(QUICK) else pytest.mark.slow)
    for book in BOOKS
]


@pytest.mark.parametrize("book", RUN)
def test_a_tutorial_runs_and_makes_a_picture(
    book: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with warnings.catch_warnings():
        if book.stem in WARNED:
            warnings.simplefilter("ignore", SarmitsubaWarning)
        pictures = run(book, tmp_path, monkeypatch)
    assert pictures > 0 or book.stem == "11_effects"  # which prints tables


def test_tutorials_are_kept_without_output_and_listed() -> None:
    listed = re.findall(r"^(\d\d_\w+)$", (FOLDER / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed == [book.stem for book in BOOKS] and len(BOOKS) >= 12
    for book in BOOKS:
        content = json.loads(book.read_text(encoding="utf-8"))
        code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
        assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code), book.name
        assert content["metadata"]["kernelspec"]["name"] == "python3", book.name


@pytest.mark.slow
@pytest.mark.parametrize("book", BOOKS, ids=lambda book: book.stem)
def test_a_tutorial_runs_in_jupyter(book: Path, tmp_path: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="runs notebooks; in the test extra")
    nbclient = pytest.importorskip("nbclient", reason="runs notebooks; in the test extra")
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    content = nbformat.read(book, as_version=4)
    nbclient.NotebookClient(content, resources={"metadata": {"path": str(tmp_path)}}).execute()
