"""``import`` takes no file of others, whatever its names say; ended at any moment it leaves one scene whole."""

import json
import os
import re
import shutil
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba import load_scene
from sarmitsuba.core.errors import OutputError
from sarmitsuba.loading import mesh_files
from sarmitsuba.loading.importing.convert import import_scene
from sarmitsuba.machine.atomic import remove_unfinished
from sarmitsuba.machine.output import MANIFEST
from sarmitsuba.scene.mesh.formats import read_ply, write_ply
from sarmitsuba.scene.mesh.tessellate import cube


def meshes(folder: Path, sizes: dict[str, float]) -> Path:
    """A folder of boxes, one mesh file each."""
    folder.mkdir(exist_ok=True)
    for name, size in sizes.items():
        corners, faces = cube()
        write_ply(folder / f"{name}.ply", 0.5 * size * np.asarray(corners, dtype=np.float64), faces)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def widths(scene: Path) -> list[float]:
    """Of the meshes that a scene names, all of which are there."""
    named = [
        str(node.get("value")) for node in ET.parse(scene).iter("string") if node.get("name") == "filename"
    ]
    assert len(set(named)) == len(named) >= 2
    return [float(np.ptp(read_ply(scene.parent / name)[0][:, 0])) for name in named]


def precious(place: Path) -> None:
    place.mkdir()
    (place / "precious.txt").write_text("thesis")


def a_mesh(place: Path) -> None:
    meshes(place, {"00_walls": 9.0})


def a_link(place: Path) -> None:
    meshes(place.parent / "elsewhere", {"00_walls": 9.0})
    place.symlink_to(place.parent / "elsewhere")


@pytest.mark.parametrize("make", [precious, a_mesh, a_link, Path.touch])
@pytest.mark.parametrize("force", [False, True])
def test_a_folder_of_others_is_refused_before_the_source_is_read(
    make: Callable[[Path], Any], force: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path / "city_meshes")
    before = contents(tmp_path)
    monkeypatch.setattr("sarmitsuba.loading.importing.convert.find_source", None)
    with pytest.raises(OutputError, match=r"city_meshes: the meshes go here, but "):
        import_scene(tmp_path / "src", tmp_path / "city.xml", force=force)
    assert contents(tmp_path) == before


def test_the_source_is_never_the_target(tmp_path: Path) -> None:
    source = meshes(tmp_path / "src", {"a": 8.0})
    import_scene(source, tmp_path / "city.xml")
    for given, output in (
        ("city_meshes", "city.xml"),
        ("city_meshes/00_a.ply", "city.xml"),
        ("a.xml", "a.xml"),
    ):
        (tmp_path / "a.xml").write_text("<CityModel/>")
        before = contents(tmp_path)
        with pytest.raises(OutputError, match=r"choose another -o"):
            import_scene(tmp_path / given, tmp_path / output, force=True)
        assert contents(tmp_path) == before


def test_meshes_of_a_scene_that_is_elsewhere_now_stay(tmp_path: Path) -> None:
    source, scene = meshes(tmp_path / "src", {"a": 8.0, "b": 9.0}), tmp_path / "city.xml"
    import_scene(source, scene)
    (tmp_path / "city_meshes" / "notes.txt").write_text("mine")
    scene.rename(tmp_path / "kept.xml")
    with pytest.raises(OutputError, match="holds the meshes of a scene imported before"):
        import_scene(source, scene)
    assert len(widths(tmp_path / "kept.xml")) == 2
    import_scene(source, scene, force=True)
    assert len(widths(scene)) == 2 and (tmp_path / "city_meshes" / "notes.txt").read_text() == "mine"
    assert len(list((tmp_path / "city_meshes").iterdir())) == 2 + len(("notes.txt", MANIFEST))


def ended_at(call: int, source: Path, scene: Path, stop: bool) -> bool:
    """Import in a process that ends at a call of the system's; whether there were so many."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DeprecationWarning
        )  # of forking beside threads, which the child does not use
        child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    seen, status = 0, 1
    try:
        # no trial in a child of this child: the threads of SciPy's transforms, started anew after a fork, may miss that
        # the next fork ends them, and wait for ever
        mesh_files.survive = lambda path, read: None  # type: ignore[assignment]
        for name in ("replace", "unlink", "mkdir", "open"):

            def counted(inner: Callable[..., Any], *args: Any, **more: Any) -> Any:
                nonlocal seen
                seen += 1
                if seen == call:
                    if stop:
                        remove_unfinished()
                    os._exit(9)
                return inner(*args, **more)

            setattr(os, name, partial(counted, getattr(os, name)))
        import_scene(source, scene, force=True)
        status = 0
    finally:
        os._exit(status)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize(
    ("first", "stop", "step"),
    [
        pytest.param(False, False, 11, id="second import, killed, 11"),
        pytest.param(True, True, 11, id="first import, told to end, 11"),
        *(
            pytest.param(
                *(first, stop, step),
                id=f"{'first' if first else 'second'} import, {'told to end' if stop else 'killed'}, {step}",
                marks=pytest.mark.slow,
            )
            for first, stop, step in (
                (False, True, 11),
                (True, False, 11),
                *product((False, True), (False, True), (1,)),
            )
        ),
    ],
)
def test_an_import_that_is_ended_leaves_one_scene_whole(
    stop: bool, first: bool, step: int, tmp_path: Path
) -> None:
    """At calls that change the disk: the old scene or the new one is whole, and the next import tidies up."""
    old, new = (meshes(tmp_path / f"src{size}", {"a": size, "b": size}) for size in (8.0, 9.0))
    work, start = tmp_path / "work", tmp_path / "start"
    start.mkdir()
    if not first:
        import_scene(old, start / "city.xml")
    call, seen = step, set()
    while True:
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(start, work)
        scene = work / "city.xml"
        if not ended_at(call, new, scene, stop):
            break
        found = round(widths(scene)[0]) if scene.exists() else 0
        seen.add(found)
        assert not scene.exists() or len({round(w) for w in widths(scene)[:2]}) == 1
        if stop and found != 9:
            assert {k: v for k, v in contents(work).items() if k != f"city_meshes/{MANIFEST}"} == {
                k: v for k, v in contents(start).items() if k != f"city_meshes/{MANIFEST}"
            }
        if first and not scene.exists():
            import_scene(old, scene)  # not asked to force anything
        else:
            import_scene(old, scene, force=True)
        assert {round(w) for w in widths(scene)[:2]} == {8}
        names = {p.name for p in (work / "city_meshes").iterdir()}
        assert names == {*json.loads((work / "city_meshes" / MANIFEST).read_text())["files"], MANIFEST}
        assert len(names) == len(widths(scene)) + 1 and {p.name for p in work.iterdir()} == {
            "city.xml",
            "city_meshes",
        }
        call += step
    assert step > 1 or seen == {0 if first else 8, 9}
    assert seen and call > 8


@pytest.mark.parametrize("seed", range(3))
def test_names_are_text_and_never_parameters(seed: int, tmp_path: Path) -> None:
    """Drawn names of files, of their folder and of the scene: what is written can be loaded."""
    rng = np.random.default_rng([seed, 12])
    first = ("$wall", "a---b", "_arg_0")[seed]
    signs = list("$\\{}<>&\"'-#%;=!@ é日.a_1")
    drawn = ["".join(rng.choice(signs, 6)) + "z" for _ in range(2)]
    source = meshes(tmp_path / f"x{drawn[0]}", {first: 8.0, drawn[1]: 9.0})
    scene = tmp_path / f"y{drawn[1]}.xml"
    import_scene(source, scene)
    assert len(re.findall("<shape ", scene.read_text(encoding="utf-8"))) == 2
    assert load_scene(scene).geometry.vertices.size
