"""Files, modules and functions that the pages name exist."""

import ast
import re
from pathlib import Path

import sarmitsuba

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "sarmitsuba"
PAGES = [*sorted(ROOT.glob("docs/*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
SOURCES = [
    *(
        path
        for folder in ("sarmitsuba", "plugins", "benchmarks", "tests")
        for path in (ROOT / folder).rglob("*.py")
    ),
    ROOT / "Makefile",
    ROOT / "pyproject.toml",
]
TOP = ("sarmitsuba", "plugins", "scenes", "tests", "benchmarks", "docs")
# a path that begins in the repository, or in the package
FROM_ROOT = re.compile(rf"(?<![\w./-])(?:{'|'.join(TOP)})/[\w./-]*[\w/]")
FROM_PACKAGE = re.compile(r"`((?:[\w-]+/)+[\w-]*(?:\.\w+)?)`")
SCRIPT = re.compile(r"(?<![\w./-])\w+\.(?:py|js)\b")
# stand for a file of the reader's; a library; a group of entry points
PLACEHOLDERS = {
    *("benchmarks/suite/NAME.py", "benchmarks/studies/NAME.py", "FILE.py"),
    "three.js",
    "sarmitsuba.extensions",
}
READERS_OWN = {"docs/extending.md"}


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_paths_on_pages_exist() -> None:
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir()}
    scripts = {path.name for folder in TOP for path in (ROOT / folder).rglob("*.[pj][ys]")}
    wrong = []
    for page in PAGES:
        where, text = page.relative_to(ROOT).as_posix(), text_of(page)
        named = set(FROM_ROOT.findall(text))
        inside = {name for name in FROM_PACKAGE.findall(text) if name.split("/")[0] in folders}
        wrong += [f"{where}: {name}" for name in named - PLACEHOLDERS if not (ROOT / name).exists()]
        wrong += [f"{where}: {name}" for name in inside if not (PACKAGE / name).exists()]
        if where not in READERS_OWN:
            wrong += [
                f"{where}: {name}" for name in set(SCRIPT.findall(text)) - PLACEHOLDERS if name not in scripts
            ]
    assert not wrong, "\n".join(sorted(wrong))


def test_paths_in_sources_exist() -> None:
    """Pages, benchmarks and tests that a docstring, a comment, a message or a page sends the reader to."""
    named = re.compile(r"(?<![\w./-])(?:docs|benchmarks|tests)/[\w/]+\.(?:md|py)\b")
    run = re.compile(r"python -m (benchmarks(?:\.[a-z]\w*)+)(?![.\w])")
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in (*SOURCES, *PAGES)
        for name in set(run.findall(text_of(path)))
        if not (ROOT / f"{name.replace('.', '/')}.py").is_file()
    ]
    wrong += [
        f"{path.relative_to(ROOT)}: {name}"
        for path in SOURCES
        for name in set(named.findall(text_of(path))) - PLACEHOLDERS
        if not (ROOT / name).is_file()
    ]
    assert not wrong, "\n".join(sorted(wrong))


def anchors(page: str) -> set[str]:
    """Of the headings to the fourth level, as the site and GitHub name them."""
    titles = re.findall(r"^#{1,4} +(.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE)
    plain = (re.sub(r"\]\([^)]*\)|[`*\[]", "", title) for title in titles)
    return {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in plain}


def test_links_between_pages_have_their_page_and_heading() -> None:
    wrong, n = [], 0
    for page in ROOT.glob("docs/*.md"):
        text = re.sub(r"```.*?```|`[^`\n]*`", "", text_of(page), flags=re.DOTALL)
        for file, anchor in re.findall(r"\]\(([\w/.-]*)(?:#([\w-]+))?\)", text):
            n += 1
            target = page.parent / file if file else page
            if not target.exists() or (anchor and anchor not in anchors(text_of(target))):
                wrong.append(f"{page.name}: {file}#{anchor}")
    assert n > 150
    assert not wrong, "\n".join(wrong)


def test_links_beside_the_site_exist() -> None:
    wrong = []
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"):
        for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text_of(page)):
            if not link.startswith("https://") and not (page.parent / link).exists():
                wrong.append(f"{page.name}: {link}")
    assert not wrong, "\n".join(wrong)


def defined(path: Path) -> set[str]:
    """Functions, classes and methods of a module."""
    nodes = ast.walk(ast.parse(text_of(path)))
    return {node.name for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}


def table(page: str, head: str) -> list[list[str]]:
    """Cells of the rows of a table, without its head."""
    found = re.search(rf"^{re.escape(head)}\n\|[-|]+\|\n((?:\|.*\|\n)+)", page, re.MULTILINE)
    assert found, head
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in found[1].splitlines()]


def test_functions_that_the_page_of_physics_names_exist() -> None:
    page = text_of(ROOT / "docs" / "physics.md")
    rows = table(page, "| quantity | file | function |")
    wrong = [
        f"{quantity}: {file} {name}"
        for quantity, file, name in rows
        if name.strip("`") not in defined(PACKAGE / file.strip("`"))
    ]
    assert not wrong, "\n".join(wrong)
    # what a reader who knows radar looks for first
    for wanted in (
        "roughness loss",
        "reciprocal doubling",
        "slab on reflection",
        "Doppler rate",
        "σ0 area",
        "key-pulse error",
    ):
        assert any(wanted in quantity for quantity, _, _ in rows), wanted


def resolves(dotted: str) -> bool:
    """Whether a dotted name of the package is a module, or a name that stands in one; nothing is imported."""
    *parts, name = dotted.split(".")[1:]
    place = PACKAGE.joinpath(*parts)
    if (place / name).is_dir() or (place / f"{name}.py").is_file():
        return True
    if not parts:
        return name in sarmitsuba.__all__
    module = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    if module.is_file():
        return re.search(rf"\b{name}\b", text_of(module)) is not None
    return resolves(".".join(["sarmitsuba", *parts]))  # an attribute of what that names


def test_modules_and_names_on_pages_exist() -> None:
    wrong = []
    for page in PAGES:
        named = set(re.findall(r"(?<![\w./])sarmitsuba(?:\.[A-Za-z_]\w*)+", text_of(page)))
        wrong += [f"{page.relative_to(ROOT)}: {name}" for name in named - PLACEHOLDERS if not resolves(name)]
    assert not wrong, "\n".join(sorted(wrong))
