"""Reading of a run folder of ``render`` or ``focus``: image, raw data and scene."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.files import FORMATS, read_image, read_raw
from sarmitsuba.files.labels_file import read_labels
from sarmitsuba.loading.kept_paths import found_path
from sarmitsuba.machine.encoding import Json, json_value
from sarmitsuba.machine.regular_files import read_text
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.range_compression import COMPRESSIONS, range_compress
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.pixel_labels import Labels
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.fingerprint import shapes_hash

RECORD, LABELS = "parameters.json", "labels.h5"


@dataclass(frozen=True, eq=False)
class RunFolder:
    """Run folder with its image, raw data and scene.

    Parameters
    ----------
    path : the folder
    image : focused
    raw : range compressed; None: the run made no raw data (methods ``image`` and ``raster``)
    scene : None: the data do not belong to a scene file
    record : contents of parameters.json
    account : error by cause, and time by stage, of the image; empty where the record has none
    notes : missing parts and their reasons, one line each
    labels : of the image's pixels; None: the run wrote none
    """

    path: Path
    image: SarImage
    raw: RawData | None
    scene: Scene | None
    record: dict[str, Json]
    notes: tuple[str, ...] = ()
    account: Mapping[str, Json] = field(default_factory=dict)
    labels: Labels | None = None

    @property
    def seed(self) -> int | None:
        """Random seed of the run."""
        seed = self.record.get("seed")
        return seed if isinstance(seed, int) else None


def read_run(path: Path, *, allow_outside: bool = False) -> RunFolder:
    """Read a run folder.

    Parameters
    ----------
    path : the folder
    allow_outside : whether the scene named in the record may refer to files outside its folder; the record's own
        statement is ignored

    Raises
    ------
    DataError
        The folder holds no image or no record, or the scene has changed since the run.
    """
    record = _record(path)
    if record.get("command") == "rcs":
        raise DataError(f"{path}: this is a sweep of `rcs`; `rcs ... --page` makes its page")
    image_path = _result(path, "image")
    if image_path is None:
        raise DataError(f"{path}: holds no image; give a folder written by `render` or `focus`")
    image = read_image(image_path)
    notes = []
    scene_record, origin, raw_path = _find_simulated(record, path)
    raw = None
    if raw_path is None or not os.path.exists(raw_path):
        notes.append(f"{path}: no raw data; the page has no pulses to show and no image to build up")
    else:
        # as for the image, so that the page focuses the same image
        done = image.metadata.get("focus", {}).get("range_compression", "flat")
        raw = range_compress(read_raw(raw_path), method=done if done in COMPRESSIONS else "flat")
    scene = _scene(scene_record, origin, allow_outside)
    if scene is None:
        notes.append(f"{path}: the scene file is not known; the page shows the track and the image alone")
    else:
        if scene_record.get("scene_hash") not in (None, shapes_hash(scene)):
            notes.append(
                f"{path}: {scene.path} holds other shapes or materials than when these results were made; the page "
                "shows those of now: render it again"
            )
        if raw is not None:
            _check_same(path, scene, raw)
    account = {name: record.get(name) for name in ("errors", "account")}
    labels = read_labels(path / LABELS) if os.path.isfile(path / LABELS) else None
    if labels is not None and labels.grid.shape != image.grid.shape:
        notes.append(f"{path}: {LABELS} is of another image; the page shows no labels")
        labels = None
    return RunFolder(path, image, raw, scene, scene_record or record, tuple(notes), account, labels)


def scene_of_run(path: Path, *, allow_outside: bool = False) -> Scene:
    """Scene of a run folder, loaded again; see :func:`read_run`.

    Raises
    ------
    DataError
        The folder holds no record, its scene is not known, or has changed since the run.
    """
    record, origin, _ = _find_simulated(_record(path), path)
    scene = _scene(record, origin, allow_outside)
    if scene is None:
        raise DataError(
            f"{path}: the scene of these results is not known; leave out --outlines and --with-view"
        )
    if record.get("scene_hash") not in (None, shapes_hash(scene)):
        raise DataError(
            f"{path}: {scene.path} holds other shapes or materials than when these results were made; render it again"
        )
    return scene


def _find_simulated(record: dict[str, Json], path: Path) -> tuple[dict[str, Json], Path, Path | None]:
    """Record and folder of the run that simulated, and its raw data."""
    if record.get("command") != "focus":
        return record, path, _result(path, "raw")
    raw_path = found_path(str(record.get("raw_file", "")), path)
    origin = raw_path.parent
    return (_record(origin) if os.path.isfile(origin / RECORD) else {}), origin, raw_path


def _record(folder: Path) -> dict[str, Json]:
    path = folder / RECORD
    try:
        facts = json_value(read_text(path, errors="strict"))
    except (OSError, ValueError) as error:
        raise DataError(f"{folder}: {RECORD} cannot be read; give a folder written by `render`") from error
    if not isinstance(facts, dict):
        raise DataError(f"{path}: is not the record of a run; give a folder written by `render` or `focus`")
    return facts


def _result(folder: Path, stem: str) -> Path | None:
    """File of the raw data or the image in any format; HDF5, which holds all data, is preferred."""
    for entry in sorted(FORMATS, key=lambda entry: entry.name != "hdf5"):
        if entry.read_image if stem == "image" else entry.read_raw:
            for suffix in entry.suffixes:
                if os.path.isfile(folder / f"{stem}{suffix}"):
                    return folder / f"{stem}{suffix}"
    return None


def _scene(record: dict[str, Json], folder: Path, allow_outside: bool) -> Scene | None:
    """Scene of the run in ``folder``, loaded again with the run's parameters."""
    from sarmitsuba.loading.from_mesh import MeshOptions
    from sarmitsuba.loading.load import load_scene

    source, given = record.get("scene"), record.get("definitions")
    if not isinstance(source, str):
        return None
    file = found_path(source, folder)
    if not os.path.exists(file):
        raise DataError(
            f"{one_line(file)}: the scene of these results does not exist any more; render it again"
        )
    definitions = {str(k): str(v) for k, v in given.items()} if isinstance(given, dict) else {}
    radar, mesh, ground = record.get("radar_file"), record.get("mesh"), record.get("ground")
    options = None
    if isinstance(mesh, dict):
        materials, up = mesh.get("materials"), mesh.get("up")
        options = MeshOptions(
            "y" if up == "y" else "z" if up == "z" else "auto",
            str(mesh.get("unit", "auto")),
            {str(k): str(v) for k, v in materials.items()} if isinstance(materials, dict) else {},
        )
    return load_scene(
        file,
        radar=found_path(radar, folder, radar=True) if isinstance(radar, str) else None,
        parameters=definitions,
        mesh=options,
        ground=ground if isinstance(ground, str) else None,
        allow_outside=allow_outside,
    )


def _check_same(path: Path, scene: Scene, raw: RawData) -> None:
    """Raise a DataError where the track of the scene file has changed since the raw data were made."""
    now, then = scene.radar.in_file_frame().track, raw.radar.in_file_frame().track
    flown = then if raw.flown is None else raw.flown
    # tol: positions are stored as float64; a micrometre has no visible phase
    if now.n_pulses != flown.n_pulses or np.abs(now.position - flown.position).max() > 1e-6:
        raise DataError(
            f"{path}: the track of {scene.path} has changed since these results were made; render it again"
        )
