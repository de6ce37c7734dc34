"""The documentation site builds without a warning and has every page; its reference names every public name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import sarmitsuba

ROOT = Path(__file__).parents[2]


def test_every_page_is_on_the_site_and_on_its_map() -> None:
    """The contents at the side list every page, and the map by what one wants to do links to each."""
    index = (ROOT / "docs" / "index.md").read_text()
    trees = re.findall(r"```{toctree}\n(.*?)```", index, re.DOTALL)
    listed = [line for tree in trees for line in tree.splitlines() if line and not line.startswith(":")]
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"} | {"tutorials/index"}
    assert sorted(listed) == sorted(pages)
    assert set(re.findall(r"\]\(([\w/]+)\.md(?:#[\w-]+)?\)", index)) == pages


# everything is read and every link resolved in both; themes and listings of the sources take as long again. That
# links lead somewhere is seen at once by test_docs_paths.py
READ = ("-b", "xml", "-D", "extensions=myst_nb,sphinx.ext.autodoc,sphinx.ext.mathjax,sphinx.ext.napoleon")
WHOLE = ("-b", "html")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "page", "described"),
    [
        pytest.param(
            READ, "reference.xml", r"<literal_strong>range_window</literal_strong> \S <literal", id="read"
        ),
        pytest.param(
            *(WHOLE, "reference.html", r"<strong>range_window</strong> \S <code"),
            id="whole",
        ),
    ],
)
def test_site_builds_without_a_warning(
    tmp_path: Path, options: tuple[str, ...], page: str, described: str
) -> None:
    pytest.importorskip("sphinx", reason="builds the site; in the docs extra")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        *options,
        "-W",
        "--keep-going",
        "-q",
        "-D",
        "nb_execution_mode=off",  # tests/tutorials runs the notebooks
        "docs",
        str(tmp_path),
    ]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
        "PYTHONWARNINGS": "ignore",
    }
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert run.returncode == 0, run.stderr
    made = (tmp_path / "generated" / page).read_text(encoding="utf-8")
    # a parameter's text stands beside its name, not in the place of its type
    assert re.search(described, made)
    assert all(name in made for name in sarmitsuba.__all__ if name != "__version__")
