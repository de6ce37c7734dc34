"""The code of docs/python.md runs as it stands, and says what is true."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


def test_the_code_of_the_page_runs() -> None:
    text = PAGE.read_text(encoding="utf-8")
    blocks = list(re.finditer(r"```python\n(.*?)```", text, re.DOTALL))
    assert len(blocks) >= 5
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks:
        above = "\n" * text.count("\n", 0, block.start(1))  # a traceback then names the page's own line
        exec(compile(above + block[1], str(PAGE), "exec"), names)
