"""Sphinx settings of the documentation site: `make docs`.

Sphinx with MyST: the docstrings are reStructuredText with formulas in the NumPy layout, which Sphinx reads as they
stand, and the pages are Markdown, which hosting sites show without building them.
"""

import re
from importlib import import_module

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


def _docstring(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    lines[:] = _names_before_texts(lines)


def setup(app: object) -> None:
    """Register the docstring step ahead of napoleon's."""
    app.connect("autodoc-process-docstring", _docstring, priority=100)  # type: ignore[attr-defined]
    # lazily loaded names have to stand in the package before autodoc looks at it
    for name in sarmitsuba.__all__:
        getattr(import_module("sarmitsuba"), name)
