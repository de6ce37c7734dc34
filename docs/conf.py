"""Sphinx settings of the documentation site: `make docs`.

Sphinx with MyST: the docstrings are reStructuredText with formulas in the NumPy layout, which Sphinx reads as they
stand, and the pages are Markdown, which hosting sites show without building them.
"""

import re
import subprocess
import sys
from importlib import import_module
from inspect import isclass
from pathlib import Path

import sarmitsuba

project = "sarmitsuba"
copyright = "sarmitsuba developers"
version = release = sarmitsuba.__version__

extensions = [
    "myst_nb",  # MyST and notebooks
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_title = f"sarmitsuba {version}"
html_static_path: list[str] = []
exclude_patterns = ["figures.py"]

# tutorials are kept without their output; here they are run, and only those that have changed
nb_execution_mode = "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath", "amsmath"]
# pages show shell sessions and scene files in which not every line is of one language
suppress_warnings = ["misc.highlighting_failure"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_numpy_docstring = True
napoleon_use_rtype = False

# pages that programs make; `make validation` and others put theirs there too (Makefile, `pages`)
GENERATED = Path(__file__).parent / "generated"
BENCHMARKS = Path(__file__).parents[1] / "benchmarks" / "run_all.py"


def _reference() -> str:
    """The page of all public names, by the part of the package that they come from."""
    rooms: dict[str, list[str]] = {}
    for name in sarmitsuba.__all__:
        value = getattr(sarmitsuba, name)
        if name != "__version__":
            kind = (
                "function" if not isclass(value) else "exception" if issubclass(value, Exception) else "class"
            )
            rooms.setdefault(value.__module__.split(".")[1], []).append(f".. auto{kind}:: sarmitsuba.{name}")
    lines = [
        "# Reference of the public names",
        "",
        "What `import sarmitsuba` offers, loaded on first use. Modules below are open to use too; their names may "
        "still move before version 1.",
    ]
    for room, entries in sorted(rooms.items()):
        title = (import_module(f"sarmitsuba.{room}").__doc__ or room).splitlines()[0].rstrip(".")
        lines += ["", f"## {room.capitalize()}", "", f"{title}.", "", "```{eval-rst}", *entries, "```"]
    return "\n".join([*lines, ""])


def _generate() -> None:
    """Write the reference, and the page of benchmarks with what has been measured here.

    The reference is written only where it changes, so that the site is not read again.
    """
    GENERATED.mkdir(exist_ok=True)
    page, text = GENERATED / "reference.md", _reference()
    if not page.is_file() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")
    subprocess.run([sys.executable, str(BENCHMARKS), "--collect"], check=True)


_SECTIONS_WITH_NAMES = {"Parameters", "Attributes", "Other Parameters", "Raises", "Warns"}
_NAMED = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.+)$")


def _names_before_texts(lines: list[str]) -> list[str]:
    """Put what follows ``name :`` on its own indented line.

    The NumPy layout has the type there. Types are annotations in this package, so the docstrings say shape, unit and
    meaning in that place instead.
    """
    out: list[str] = []
    section = ""
    for i, line in enumerate(lines):
        following = lines[i + 1] if i + 1 < len(lines) else ""
        if following.startswith("---") and set(following) == {"-"}:
            section = line.strip()
        named = _NAMED.match(line) if section in _SECTIONS_WITH_NAMES else None
        if named is None:
            out.append(line)
        elif section in {"Raises", "Warns"}:  # napoleon takes one name at a time here
            out += [text for name in named.group(1).split(", ") for text in (name, f"    {named.group(2)}")]
        else:
            out += [named.group(1), f"    {named.group(2)}"]
    return out


def _contents(app: object, name: str, source: list[str]) -> None:
    """Add the generated pages, which the repository does not have, to the contents at the side."""
    if name == "index":
        source[0] += "\n```{toctree}\n:caption: Made by the program\n:glob:\n:hidden:\n\ngenerated/*\n```\n"


def _docstring(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    lines[:] = _names_before_texts(lines)


def setup(app: object) -> None:
    """Register the docstring step ahead of napoleon's."""
    app.connect("autodoc-process-docstring", _docstring, priority=100)  # type: ignore[attr-defined]
    app.connect("source-read", _contents)  # type: ignore[attr-defined]
    # lazily loaded names have to stand in the package before autodoc looks at it
    for name in sarmitsuba.__all__:
        getattr(import_module("sarmitsuba"), name)
    _generate()
