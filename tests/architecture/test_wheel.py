"""What is installed is complete: plugins, scenes with their meshes, type marker."""

import json
import re
import subprocess
import sys
import zipfile
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("hatchling", reason="builds the wheel; in the test extra")
pytest.importorskip("hatch_fancy_pypi_readme", reason="builds the wheel; in the test extra")

ROOT = Path(__file__).parents[2]


def check_bill(bill: dict[str, Any], names: set[str], facts: str) -> None:
    """The bill of materials holds every file of others that the wheel holds, with its hash, and every dependency."""
    assert (
        bill["bomFormat"] == "CycloneDX" and f"Version: {bill['metadata']['component']['version']}\n" in facts
    )
    works = [each for each in bill["components"] if "components" in each]
    files = {file["name"]: file["hashes"][0]["content"] for each in works for file in each["components"]}
    others = {
        name for name in names if ("/vendor/" in name and name.endswith(".js")) or name.endswith(".csv.gz")
    }
    assert others and files == {name: sha256((ROOT / name).read_bytes()).hexdigest() for name in others}
    assert all(each["licenses"] for each in works) and works[0]["version"]
    needed = {
        each["properties"][0]["value"] for each in bill["components"] if each.get("scope") == "required"
    }
    assert len(needed) == sum(
        line.startswith("Requires-Dist: ") and "extra ==" not in line for line in facts.splitlines()
    )


def test_wheel_contains_plugins_and_scenes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (bill,) = (
            archive.read(name) for name in names if name.endswith(".dist-info/sboms/sarmitsuba.cdx.json")
        )
        (facts,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    check_bill(json.loads(bill), names, facts)
    for folder, inside in (("plugins", "_plugins"), ("scenes", "_scenes")):
        files = [
            p
            for p in (ROOT / folder).rglob("*")
            if p.is_file() and p.suffix in {".py", ".xml", ".ply", ".csv", ".toml"}
        ]
        assert files
        for path in files:
            assert f"sarmitsuba/{inside}/{path.relative_to(ROOT / folder).as_posix()}" in names
    assert "sarmitsuba/py.typed" in names
    web = ROOT / "sarmitsuba" / "view" / "page" / "web"
    assert {f"sarmitsuba/view/page/web/{p.relative_to(web).as_posix()}" for p in web.rglob("*.*")} <= names
    assert not [name for name in names if name.startswith("tests") or "__pycache__" in name]
    # a package index shows the README far from the checkout: no relative link may be left
    assert "Project-URL: Homepage, https://" in facts
    links = re.findall(r"\]\(([^)]+)\)", facts)
    assert len(links) > 10
    assert [link for link in links if not link.startswith(("https://", "#"))] == []
