"""Kinds of drawn files: the undamaged one, how it is damaged, and who reads it."""

import json
import os
import random
import shutil
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

from benchmarks.support import hostile_bombs as bombs
from benchmarks.support import hostile_structure as structure
from benchmarks.support.hostile_files import (
    PASSES_SHAPE,
    drawn_dictionary,
    mutate_bytes,
    mutate_text,
    resumed_scene,
    resumed_setting,
    sample_drawer,
)


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Parameters
    ----------
    file : name of the undamaged one among the samples
    mutate : makes another of its bytes
    read : reads a file, as the program would; what returns REFUSED has been answered with one line
    name : of the file as it is read, where its name matters
    """

    file: str
    mutate: Callable[[random.Random, bytes], bytes]
    read: Callable[[Path], object]
    name: str = ""

    def place(self, folder: Path) -> Path:
        """Where a drawn file lies."""
        return folder / (self.name or f"drawn{Path(self.file).suffix}")


REFUSED = "refused"


def _scene(path: Path) -> object:
    from sarmitsuba.loading.load import load_scene

    return load_scene(path)


def _spectrum(path: Path) -> object:
    return _scene(path.parent / "files.xml")


def _command(*words: str) -> object:
    """What the command line does; its errors are its own lines and the exit status 2."""
    from sarmitsuba import cli

    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stderr(nowhere):
        status = cli.main([*words, "--quiet"])
    if status not in (0, 2):
        raise AssertionError(f"exit status {status}")
    return REFUSED if status else status


def _render(path: Path) -> object:
    return _command("render", str(path), "--force", "-o", str(path.parent / "out"))


def _raw(path: Path) -> object:
    from sarmitsuba.files import read_raw

    return read_raw(path)


def _image(path: Path) -> object:
    from sarmitsuba.files import read_image

    return read_image(path)


def _mesh(path: Path) -> object:
    from sarmitsuba.loading.mesh_files import read_mesh, read_parts, read_shape

    if path.suffix == ".serialized":
        return read_shape(path, 0, path.name)
    read = read_parts if path.suffix == ".glb" else read_mesh
    return read(path, path.name)


def _parts(path: Path) -> object:
    """A scene of a mesh alone, by its own materials."""
    from sarmitsuba.loading.load import load_scene

    return load_scene(path, radar="airborne_x")


def _graph(path: Path) -> object:
    """A scene of several files, which are laid out first, in a folder of the case's own."""
    from sarmitsuba.commands.scenes import copy_scene

    folder = Path(tempfile.mkdtemp(dir=path.parent))
    for name, text in json.loads(path.read_bytes()).items():
        place = folder / name.removeprefix("@link ")
        place.parent.mkdir(parents=True, exist_ok=True)
        if name.startswith("@link "):
            if not place.exists():
                place.symlink_to(text)
        else:
            place.write_text(text, encoding="utf-8")
    scene = _scene(folder / "s.xml")
    copy_scene(folder / "s.xml", folder / "copy")
    return scene


def _mapped(path: Path) -> object:
    return _scene(path.parent / "mapped.xml")


def _track(path: Path) -> object:
    from sarmitsuba.radar.track import Track

    return Track.from_csv(path)


def _vectors(path: Path) -> object:
    from sarmitsuba.radar.orbit import StateVectors

    return StateVectors.read(path)


def _pattern(path: Path) -> object:
    from sarmitsuba.loading.load import load_scene

    table = {"sar_antenna.pattern": "table", "sar_antenna.pattern_file": str(path)}
    return load_scene("point", parameters=table)


def _passes(path: Path) -> object:
    """Passes, which must be as the run of the samples writes them."""
    import numpy as np

    from sarmitsuba.signal.raw_data import Layer
    from sarmitsuba.simulation.execution.passes import Passes, PassLayout

    layout = PassLayout((Layer("VV"),), *PASSES_SHAPE, 10.0)
    found = Passes.load(path, "made here", layout)
    if found.data is None or found.data.shape != layout.shape(1) or not (np.abs(found.data) <= 10.0).all():
        raise AssertionError("passes that no run writes")
    return found


def _import(path: Path) -> object:
    from sarmitsuba.loading.importing.convert import import_scene
    from sarmitsuba.loading.importing.import_options import ImportOptions

    return import_scene(path, path.parent / "imported.xml", ImportOptions(), force=True)


def _fresh_run(path: Path) -> Path:
    """A folder of results with the drawn file in it, under its own name."""
    run = path.parent / "results"
    shutil.rmtree(run, ignore_errors=True)
    shutil.copytree(path.parent / "run", run)
    shutil.copy(path, run / path.name)
    return run


def _results(path: Path) -> object:
    """What a render into the folder does before and after its work; nothing outside may be gone."""
    from sarmitsuba.machine.output import output_folder

    run = _fresh_run(path)
    with output_folder(str(run)) as folder:
        folder.check("another", ("raw.h5", "image.h5", "parameters.json"), force=True)
        folder.check_space(1.0)
        folder.clear("another")
        with folder.writing("image.h5") as target:
            target.write_bytes(b"new")
    if not (path.parent / "outside.txt").is_file():
        raise AssertionError("a file outside the folder was removed")
    return run


def _view(path: Path) -> object:
    """The page of a run, none of whose values may have become an element or an attribute."""
    run = _fresh_run(path)
    result = _command("view", str(run), "-o", str(path.parent / "page.html"), "--force")
    if result != REFUSED:
        seen = _Elements()
        seen.feed((path.parent / "page.html").read_text(encoding="utf-8"))
        if seen.running != ["importmap", "module"] or seen.strange:
            raise AssertionError(f"elements of the page: {seen.running} {seen.strange[:3]}")
    return result


class _Elements(HTMLParser):
    """Types of the scripts that a page runs, and elements and attributes that no page of ours has."""

    def __init__(self) -> None:
        super().__init__()
        self.running: list[str | None] = []
        self.strange: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take down scripts and what would act."""
        given = dict(attrs)
        if tag == "script" and given.get("type") not in ("application/json", "application/octet-stream"):
            self.running.append(given.get("type"))
        if tag in ("img", "iframe", "object", "embed", "base") or any(k.startswith("on") for k in given):
            self.strange.append(tag)


# ---- what interrupted runs leave, and what Python hands over ---------------------------------------------------------


def _blocks(path: Path) -> object:
    """A run that goes on from a journal of blocks: its echoes are those of the whole run, or new ones."""
    import numpy as np

    from sarmitsuba.simulation.execution.render import simulate

    raw = simulate(resumed_scene(), state=path)
    if not (np.isfinite(raw.data).all() and np.abs(raw.data).max() < 1e15):
        raise AssertionError("echoes that no run gives")
    return raw


def _trials(path: Path) -> object:
    import numpy as np

    from sarmitsuba.apps.cost_trials import Trials, WorkClock

    trials = Trials(WorkClock(), path, "one")
    try:
        trial = trials.run(resumed_scene(), resumed_setting())
    finally:
        trials.close()
    if not np.isfinite(trial.image).all() or min(trial.stages.values()) < 0.0:
        raise AssertionError("a trial that no study makes")
    return trial


def _samples(path: Path) -> object:
    """The files of a data set from a journal of samples; where its first records are lost there are none to write."""
    import h5py
    import numpy as np

    from sarmitsuba.apps.dataset_generate import STORE, _write_files
    from sarmitsuba.apps.dataset_recipe import PART_NAMES
    from sarmitsuba.apps.dataset_store import SampleForm
    from sarmitsuba.machine.journal import Journal

    drawer = sample_drawer(path.parent / "small.toml")
    form = SampleForm(drawer.recipe.samples, PART_NAMES, drawer.classes, drawer.recipe.shape)
    journal = Journal(path, form)
    try:
        if not journal.labels:
            return REFUSED
        _write_files(drawer, path.parent, journal, {})
    finally:
        journal.close()
    with h5py.File(path.parent / STORE) as file:
        if not (np.abs(file["images"][()]) < 1e16).all():
            raise AssertionError("images that no sample has")
    return journal


def _dictionary(path: Path) -> object:
    """A scene of a dict that has values of foreign types, keys of others, itself, or nothing in it."""
    from sarmitsuba.loading.load import load_scene

    seed = int(path.read_bytes())  # 0: nothing is changed
    return load_scene(drawn_dictionary(random.Random(seed), changed=seed > 0))


_SICD, _CPHD = structure.within(b"<SICD", b"</SICD>"), structure.within(b"<CPHD", b"</CPHD>")
KINDS = {
    "scene": Kind("scene.xml", mutate_text, _scene),
    "scene-tree": Kind("files.xml", structure.xml_tree, _scene),
    "spectrum": Kind("reflectance.spd", mutate_text, _spectrum, "reflectance.spd"),
    "render": Kind("scene.xml", mutate_text, _render),
    "hdf5-raw": Kind("raw.h5", mutate_bytes, _raw),
    "hdf5-raw-tree": Kind("raw.h5", structure.hdf5, _raw),
    "hdf5-image": Kind("image.h5", mutate_bytes, _image),
    "hdf5-image-tree": Kind("image.h5", structure.hdf5, _image),
    "cphd": Kind("raw.cphd", mutate_bytes, _raw),
    "cphd-tree": Kind("raw.cphd", _CPHD, _raw),
    "sicd": Kind("image.nitf", mutate_bytes, _image),
    "sicd-tree": Kind("image.nitf", _SICD, _image),
    "matlab": Kind("raw.mat", mutate_bytes, _raw),
    "matlab-fields": Kind("raw.mat", structure.matlab, _raw),
    "passes": Kind("passes.npz", mutate_bytes, _passes),
    "passes-arrays": Kind("passes.npz", structure.npz, _passes),
    "passes-bombs": Kind("passes.npz", bombs.npz, _passes),
    "scene-graph": Kind("graph.json", bombs.scene_graph, _graph),
    "hdf5-raw-bombs": Kind("raw.h5", bombs.hdf5, _raw),
    "hdf5-image-bombs": Kind("image.h5", bombs.hdf5, _image),
    "exr": Kind("map.exr", bombs.openexr, _mapped, "map.exr"),
    "exr-bytes": Kind("map.exr", mutate_bytes, _mapped, "map.exr"),
    "serialized": Kind("mesh.serialized", bombs.serialized, _mesh),
    "serialized-bytes": Kind("mesh.serialized", mutate_bytes, _mesh),
    "obj-parts": Kind("mesh.obj", bombs.obj, _parts),
    "ply": Kind("mesh.ply", mutate_bytes, _mesh),
    "ply-text": Kind("text.ply", mutate_text, _mesh),
    "stl": Kind("mesh.stl", mutate_bytes, _mesh),
    "obj": Kind("mesh.obj", mutate_text, _mesh),
    "glb": Kind("mesh.glb", mutate_bytes, _mesh),
    "track": Kind("track.csv", mutate_text, _track),
    "vectors": Kind("vectors.csv", mutate_text, _vectors),
    "orbit-file": Kind("vectors.EOF", mutate_text, _vectors),
    "pattern": Kind("pattern.csv", mutate_text, _pattern),
    "raster": Kind("raster.tif", structure.raster, _import),
    "osm": Kind("map.osm", structure.xml_tree, _import),
    "osm-text": Kind("map.osm", mutate_text, _import),
    "citygml": Kind("city.gml", structure.xml_tree, _import),
    "citygml-text": Kind("city.gml", mutate_text, _import),
    "geojson": Kind("map.geojson", structure.json_tree, _import),
    "gltf-nodes": Kind("nodes.gltf", bombs.gltf_nodes, _parts),
    "journal-blocks": Kind("raw.blocks", bombs.journal, _blocks),
    "journal-trials": Kind("cost.trials", bombs.journal, _trials),
    "journal-samples": Kind("samples.journal", bombs.journal, _samples),
    "dictionary": Kind("dictionary.txt", bombs.dictionary, _dictionary),
    "far-outlines": Kind("map.geojson", bombs.far_outlines, _import),
    "far-raster": Kind("raster.tif", bombs.far_raster, _import),
    "hdf5-raw-vectors": Kind("raw.h5", bombs.vectors, _raw),
    "hdf5-image-vectors": Kind("image.h5", bombs.vectors, _image),
    "results": Kind("run/.sarmitsuba.json", structure.json_tree, _results, ".sarmitsuba.json"),
    "view-record": Kind("run/parameters.json", structure.json_tree, _view, "parameters.json"),
    "view-image": Kind("run/image.h5", structure.hdf5, _view, "image.h5"),
    "view-raw": Kind("run/raw.h5", structure.hdf5, _view, "raw.h5"),
}


__all__ = ["KINDS", "REFUSED", "Kind"]
