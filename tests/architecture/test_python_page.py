"""The code of the pages about Python runs as it stands, and says what is true."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize(
    ("name", "least"),
    [("running", 5), pytest.param("analysis", 3, marks=pytest.mark.slow), ("rcs", 1), ("radar", 1)],
)
def test_the_code_of_the_page_runs(name: str, least: int) -> None:
    page = DOCS / f"{name}.md"
    text = page.read_text(encoding="utf-8")
    blocks = list(re.finditer(r"```python\n(.*?)```", text, re.DOTALL))
    assert len(blocks) >= least
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks:
        above = "\n" * text.count("\n", 0, block.start(1))  # a traceback then names the page's own line
        exec(compile(above + block[1], str(page), "exec"), names)
