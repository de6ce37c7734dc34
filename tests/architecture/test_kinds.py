"""A kind of scatterers is one folder: without it the package imports, loads and renders all else."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
KINDS = "sarmitsuba.tracing.scatterers"
# folders that nothing else imports, the effect of each, and its bsdf where it has one
WHOLE = {
    "wires": ("line_scatterers", "radar_wire"),
    "volumes": ("vegetation", "radar_volume"),
    "pairs": ("diffuse_pairs", ""),
    "edges": ("edge_diffraction", ""),
}
# modules of the validation that import a kind, deleted with it
CHECKS = {
    f"sarmitsuba.truth.validation.{name}": kind
    for kind, names in {
        "wires": ("cases.wires",),
        "pairs": ("cases.courtyards",),
        "edges": ("cases.diffraction", "cases.full_wave", "full_wave"),
    }.items()
    for name in names
}

RENDER = """
import importlib, pkgutil, sys, warnings
import sarmitsuba
from sarmitsuba.effects.effect import EFFECTS
from sarmitsuba.scene.scatterers import SCATTERERS
from sarmitsuba.scene.summary import SceneSummary
for name in sarmitsuba.__all__:
    getattr(sarmitsuba, name)
for module in pkgutil.walk_packages(sarmitsuba.__path__, "sarmitsuba."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
folder, effect, bsdf = sys.argv[1:]
assert bsdf not in SCATTERERS and SCATTERERS.own_names
assert bsdf not in sarmitsuba.register_plugins()
assert effect not in EFFECTS and EFFECTS.own_names
size = {"range_film.pixels_azimuth": "16", "range_film.pixels_range": "16"}
scene = sarmitsuba.load_scene("dihedral", parameters=size)
assert folder not in SceneSummary.of(scene).as_dict()
image = sarmitsuba.render(scene, seed=1)
assert abs(image.data).max() > 0.0
"""


def test_nobody_imports_a_kind(house: Any) -> None:
    """The package's list of public names, which it is loaded by, aside."""
    wrong = [
        f"{house.modules[found.source].where}:{found.line} imports {found.target}"
        for found in house.imports
        for kind in WHOLE
        if f"{found.target}.".startswith(f"{KINDS}.{kind}.")
        and not found.source.startswith(f"{KINDS}.{kind}.")
        and CHECKS.get(found.source) != kind
        and (found.source, found.when) != ("sarmitsuba", "typing")
    ]
    assert not wrong, "\n".join(wrong)


def test_the_part_of_a_kind_in_scenes_needs_no_mitsuba(house: Any) -> None:
    """It is loaded with the list of effects, which planning and focusing read."""
    kinds = [
        module for module in house if module.name.startswith(f"{KINDS}.") and module.name.endswith(".kind")
    ]
    assert len(kinds) >= len(WHOLE)
    for module in kinds:
        taken = {node.module for node in ast.walk(module.tree) if isinstance(node, ast.ImportFrom)}
        assert not taken & {"sarmitsuba.machine.backend", f"{module.folder}.source"}, module.where


@pytest.mark.slow
@pytest.mark.parametrize("kind", WHOLE)
def test_the_folder_of_a_kind_can_be_deleted(kind: str, tmp_path: Path) -> None:
    for folder in ("sarmitsuba", "plugins"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    os.symlink(ROOT / "scenes", tmp_path / "scenes")
    shutil.rmtree(tmp_path / KINDS.replace(".", "/") / kind)
    for module, of in CHECKS.items():
        if of == kind:
            (tmp_path / f"{module.replace('.', '/')}.py").unlink()
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", RENDER, kind, *WHOLE[kind]],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
