"""A release has one version, and says what changed under it."""

import re
import tarfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from sarmitsuba.files.table_file import read_table
from sarmitsuba.version import __version__
from tools.release import (
    REPOSITORY,
    ReleaseError,
    cut_changelog,
    cut_citation,
    cut_limits,
    lock_of,
    pack_site,
    python_blocks,
    version_of,
)

ROOT = Path(__file__).parents[2]
CHANGES = (
    "# Changelog\n\n## Unreleased: 1.2.0\n\n### Added\n\n- A thing.\n\n## 1.1.0 - 2025-01-02\n\n- Older.\n"
)


def test_one_source_of_the_version() -> None:
    assert version_of(ROOT) == __version__
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    # before the release, after it, or on the way to the next
    assert headings[0] == f"Unreleased: {__version__}" or headings[1].startswith(f"{__version__} - ")


def test_the_changelog_is_cut() -> None:
    text = cut_changelog(CHANGES, "1.2.0", "2026-03-04")
    assert text == CHANGES.replace("## Unreleased: 1.2.0", "## Unreleased\n\n## 1.2.0 - 2026-03-04")
    real = cut_changelog((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), __version__, "2026-03-04")
    assert f"## {__version__} - 2026-03-04\n\n### " in real


@pytest.mark.parametrize(
    ("text", "version", "message"),
    [
        (CHANGES, "1.1.0", "1.1.0 has been released"),
        (CHANGES, "1.3.0", 'no section "## Unreleased: 1.3.0"'),
        (CHANGES.replace("### Added\n\n- A thing.\n\n", ""), "1.2.0", "nothing stands under"),
        (CHANGES + CHANGES, "1.2.0", "no section"),
    ],
)
def test_what_cannot_be_cut_is_said(text: str, version: str, message: str) -> None:
    with pytest.raises(ReleaseError, match=re.escape(message)):
        cut_changelog(text, version, "2026-03-04")


def test_the_citation_has_version_and_day() -> None:
    text = cut_citation("a: b\nversion: 0.9.0\nlicense: X\n", "1.2.0", "2026-03-04")
    assert text == "a: b\nversion: 1.2.0\ndate-released: 2026-03-04\nlicense: X\n"
    assert cut_citation(text, "1.3.0", "2027-01-01").count("date-released") == 1
    with pytest.raises(ReleaseError, match="no line version"):
        cut_citation("a: b\n", "1.2.0", "2026-03-04")


def test_the_known_limits_are_a_page() -> None:
    text = cut_changelog(CHANGES, "1.2.0", "2026-03-04")
    with pytest.raises(ReleaseError, match=re.escape('1.2.0 has no "### Known limits"')):
        cut_limits(text, "1.2.0", "https://x")
    text = text.replace(
        "- A thing.\n", "- A thing.\n\n### Known limits\n\n- Flat ([why](docs/physics.md#b)).\n"
    )
    assert cut_limits(text, "1.2.0", "https://x") == (
        "# Known limits of sarmitsuba 1.2.0\n\n- Flat ([why](https://x/blob/v1.2.0/docs/physics.md#b)).\n"
    )
    with pytest.raises(ReleaseError):  # the section of another version is not this one's
        cut_limits(text, "1.1.0", "https://x")
    urls = read_table(ROOT / "pyproject.toml", "a project", 1 << 20)["project"]
    assert isinstance(urls, dict) and urls["urls"]["Homepage"] == REPOSITORY
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if f"## Unreleased: {__version__}" in changes:
        changes = cut_changelog(changes, __version__, "2026-03-04")
    assert cut_limits(changes, __version__, REPOSITORY).count("\n- ") >= 3


def test_the_extra_all_holds_what_a_user_may_want() -> None:
    """Every extra but those for tests, documentation and references that the repository holds ready made."""
    project = read_table(ROOT / "pyproject.toml", "a project", 1 << 20)["project"]
    assert isinstance(project, dict)
    extras = project["optional-dependencies"]
    (whole,) = (Requirement(text) for text in extras["all"])
    ours = {"all", "dev", "docs", "full-wave", "independent", "peers", "scenes-build", "test"}
    assert whole.name == "sarmitsuba" and whole.extras == set(extras) - ours


def test_the_site_is_packed(tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    with pytest.raises(ReleaseError, match="holds no site"):
        pack_site(site, tmp_path, "1.2.0")
    (site / "index.html").write_text("<p>", encoding="utf-8")
    with tarfile.open(pack_site(site, tmp_path, "1.2.0")) as archive:
        assert "sarmitsuba-1.2.0-site/index.html" in archive.getnames()


def requirements() -> list[Requirement]:
    """Every requirement of pyproject.toml, but the package's own extras."""
    table = read_table(ROOT / "pyproject.toml", "a project", 1 << 20)
    project, build = table["project"], table["build-system"]
    assert isinstance(project, dict) and isinstance(build, dict)
    groups = [build["requires"], project["dependencies"], *project["optional-dependencies"].values()]
    found = [Requirement(text) for group in groups for text in group]
    return [each for each in found if each.name != "sarmitsuba"]


def test_every_dependency_is_bounded_on_both_sides() -> None:
    for each in requirements():
        signs = {spec.operator for spec in each.specifier}
        assert signs == {"=="} or ({">="} <= signs and signs & {"<", "<="}), str(each)


def test_the_versions_of_this_environment_are_allowed() -> None:
    """What these tests ran with is inside of what is promised."""
    for each in requirements():
        if each.marker is not None and not each.marker.evaluate():
            continue
        try:
            version = metadata.version(each.name)
        except metadata.PackageNotFoundError:
            continue  # of an extra that is not installed
        assert version in each.specifier, f"{each}: {version}"


def test_the_lowest_versions_are_those_of_the_bounds() -> None:
    lowest = dict(line.split("==") for line in (ROOT / "tests" / "lowest.txt").read_text().splitlines()[1:])
    needed = {each.name: each for each in requirements()}
    for name, version in lowest.items():
        (least,) = (spec.version for spec in needed[name].specifier if spec.operator == ">=")
        assert Version(least) == Version(version), name


def test_the_lock_has_versions_and_hashes() -> None:
    def entry(name: str, **archive: object) -> dict[str, object]:
        return {"metadata": {"name": name, "version": "1.2"}, "download_info": {"archive_info": archive}}

    report = {
        "install": [
            entry("sarmitsuba"),
            entry("NumPy", hashes={"sha256": "a" * 64}),
            entry("h5py", hash=f"sha256={'b' * 64}"),  # as pip before 23.1 writes it
        ]
    }
    assert lock_of(report, "sarmitsuba") == (
        f"h5py==1.2 --hash=sha256:{'b' * 64}\nNumPy==1.2 --hash=sha256:{'a' * 64}\n"
    )
    report["install"].append(entry("odd", hashes={"md5": "c" * 32}))
    with pytest.raises(ReleaseError, match=r"odd 1.2: pip reports no SHA-256 hash"):
        lock_of(report, "sarmitsuba")


def test_the_readme_has_python_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the release tries it, on a scene that takes less."""
    (block,) = python_blocks((ROOT / "README.md").read_text(encoding="utf-8"))
    assert '"tower"' in block
    monkeypatch.chdir(tmp_path)
    exec(compile(block.replace('"tower"', '"point"'), "README.md", "exec"), {})  # the picture keeps its name
    assert (tmp_path / "tower.png").is_file()
