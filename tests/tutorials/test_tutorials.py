"""The tutorials: every notebook runs, its own assertions hold, and it is kept without output."""

import ast
import base64
import io
import json
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sarmitsuba.core.errors import SarmitsubaWarning

FOLDER = Path(__file__).parents[2] / "docs" / "tutorials"
BOOKS = sorted(FOLDER.glob("*.ipynb"))
# those that overrule the program on purpose, and are told so
WARNED = {"10_accuracy", "11_effects"}


def code_of(book: Path) -> list[str]:
    cells = json.loads(book.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def holds_something(png: bytes) -> bool:
    """Whether a PNG has more than one colour in each half."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("L"))
    half = pixels.shape[1] // 2
    return bool(np.ptp(pixels[:, :half]) > 100 and np.ptp(pixels[:, half:]) > 100)


def draws(cell: str) -> bool:
    """Whether code calls a function that draws, by its name."""
    calls = [node.func for node in ast.walk(ast.parse(cell)) if isinstance(node, ast.Call)]
    names = [call.attr if isinstance(call, ast.Attribute) else getattr(call, "id", "") for call in calls]
    return any(re.fullmatch(r"plot|subplots|imshow|quicklook\w*|\w+_figure", name) for name in names)


def run(book: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run the cells in this process, as a notebook would; the number of pictures that it would show."""
    import matplotlib.pyplot as plt

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
            # a kernel without pyplot knows no other way to show a figure
            if hasattr(value, "_repr_png_"):
                assert holds_something(value._repr_png_()), cell
                pictures += 1
        for figure in map(plt.figure, plt.get_fignums()):
            file = io.BytesIO()
            figure.savefig(file, format="png")
            assert holds_something(file.getvalue()), cell
            pictures += 1
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
    for cell in content.cells:
        if cell.cell_type == "code" and draws(cell.source):
            shown = [o.data["image/png"] for o in cell.outputs if "image/png" in o.get("data", {})]
            assert shown and all(holds_something(base64.b64decode(png)) for png in shown), cell.source
