"""Build step: wheels carry plugins/ and scenes/ inside the package, and a bill of materials (SBOM) of what is in them.

Editable installs use the folders in place.
"""

import hashlib
import json
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

BILL = "sarmitsuba.cdx.json"
# works of others inside the package: name, licence (SPDX, or the file that holds it), folder, files, and what their
# version follows in a file
WORKS = (
    ("three.js", "MIT", "sarmitsuba/view/page/web/vendor", "*.js", ("README.md", r"three\.js (\S+)")),
    (
        "Austin RCS Benchmark Suite",
        "LICENSE-AustinRCSBenchmarks.txt",
        "sarmitsuba/truth/validation/measured",
        "*.csv.gz",
        None,
    ),
)


class Hook(BuildHookInterface[Any]):
    """Adds folders and bill to every wheel but the editable one, which would only hold copies that go stale."""

    folder: str | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Run before the build."""
        if self.target_name == "wheel" and version == "standard":
            build_data["force_include"].update(
                {"plugins": "sarmitsuba/_plugins", "scenes": "sarmitsuba/_scenes"}
            )
            self.folder = tempfile.mkdtemp(prefix="sbom-")
            path = Path(self.folder) / BILL
            core = self.metadata.core
            bill = make_bill(
                Path(self.root), self.metadata.version, core.license_expression, core.dependencies
            )
            path.write_text(json.dumps(bill, indent=1) + "\n", encoding="utf-8")
            build_data["sbom_files"].append(str(path))

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Run after the build."""
        if self.folder is not None:
            shutil.rmtree(self.folder)


def make_bill(root: Path, version: str, licence: str, dependencies: list[str]) -> dict[str, Any]:
    """Bill of materials in CycloneDX 1.6: works of others in the wheel, with hashes of their files, and what it needs.

    The same sources give the same bill: it has no time and no random number.

    Parameters
    ----------
    root : of the repository
    version, licence : of the package
    dependencies : requirements of the package, as in its metadata
    """
    needed = [
        {
            "type": "library",
            "bom-ref": f"requirement:{requirement}",
            "name": re.split(r"[^A-Za-z0-9._-]", requirement)[0],
            "scope": "required",
            "properties": [{"name": "requirement", "value": requirement}],
        }
        for requirement in sorted(dependencies)
    ]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "library",
                "bom-ref": "sarmitsuba",
                "name": "sarmitsuba",
                "version": version,
                "licenses": [{"expression": licence}],
                "purl": f"pkg:pypi/sarmitsuba@{version}",
            }
        },
        "components": [*(_work(root, *work) for work in WORKS), *needed],
        "dependencies": [{"ref": "sarmitsuba", "dependsOn": [each["bom-ref"] for each in needed]}],
    }


def _work(
    root: Path, name: str, licence: str, folder: str, pattern: str, version: tuple[str, str] | None
) -> dict[str, Any]:
    """Component of the bill for a work of others inside the package."""
    place = root / folder
    files = sorted(place.glob(pattern))
    if not files:
        raise FileNotFoundError(f"{place}: no {pattern} of {name}")
    component: dict[str, Any] = {"type": "library", "bom-ref": name, "name": name}
    if version is not None:
        found = re.search(version[1], (place / version[0]).read_text(encoding="utf-8"))
        if found is None:
            raise ValueError(f"{place / version[0]}: no version of {name}")
        component["version"] = found[1]
    named = (place / licence).is_file()
    component["licenses"] = [{"license": {"name": f"{folder}/{licence}"} if named else {"id": licence}}]
    component["components"] = [
        {
            "type": "file",
            "name": path.relative_to(root).as_posix(),
            "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(path.read_bytes()).hexdigest()}],
        }
        for path in files
    ]
    return component
