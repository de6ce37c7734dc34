"""A part of benchmarks/studies/hostile.py: files of the right outer form, their content drawn; work without network."""

import json
import os
import shutil
import subprocess
import sys
import zlib
from contextlib import closing
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.core.errors import DataError, OutputError, SarmitsubaError
from sarmitsuba.files import read_image, read_raw, write_image
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.atomic import make_folder
from sarmitsuba.machine.journal import Journal
from sarmitsuba.machine.output import OutputFile, OutputFolder
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.simulation.execution.passes import Passes, PassLayout
from sarmitsuba.view.page.run_folder import read_run

pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")

ROOT = Path(__file__).parents[2]
KINDS = (
    "scene-tree",
    "spectrum",
    "hdf5-raw-tree",
    "cphd-tree",
    "sicd-tree",
    "matlab-fields",
    "passes-arrays",
    "raster",
    "osm",
    "citygml",
    "geojson",
    "results",
    "gltf-nodes",
    "journal-blocks",
    "journal-trials",
    "journal-samples",
    "dictionary",
    "far-outlines",
    "far-raster",
    "hdf5-raw-vectors",
    "hdf5-image-vectors",
)
DEEP = "[" * 100_000 + "]" * 100_000
LAYOUT = PassLayout((Layer("VV"),), 3, 3, 10.0)


@pytest.fixture(scope="module")
def samples(samples: Path) -> Path:
    pytest.importorskip("rasterio", reason="in the importing extra")
    pytest.importorskip("shapely", minversion="2.1", reason="in the importing extra")
    return samples


@pytest.mark.parametrize("name", KINDS)
def test_drawn_content_is_read_or_refused_in_one_line(
    hostile: ModuleType, samples: Path, tmp_path: Path, name: str
) -> None:
    kind = hostile.KINDS[name]
    whole = (samples / kind.file).read_bytes()
    (tmp_path / "case").mkdir()
    hostile.lay_out(samples, tmp_path / "case")
    path = kind.place(tmp_path / "case")
    path.write_bytes(whole)
    assert hostile.read_one(kind, path) == ("read", "")
    for seed in range(10):
        path.write_bytes(hostile.drawn(name, seed, whole))
        outcome, text = hostile.read_one(kind, path)
        assert outcome in ("read", "refused"), f"seed {seed}: {outcome}: {text}"


def test_what_opens_files_elsewhere_or_connections_is_noticed(hostile: ModuleType, tmp_path: Path) -> None:
    """The watch of the benchmark itself, in a process of its own because a hook is never taken off."""
    (tmp_path / "case").mkdir()
    (tmp_path / "secret").write_text("x")
    code = f"""
import socket
from benchmarks.studies import hostile
from contextlib import closing
from pathlib import Path
watch = hostile.Watch(Path({str(tmp_path / "case")!r}))
watch.on = True
open({str(tmp_path / "secret")!r}).close()
Path({str(tmp_path / "case" / "own")!r}).touch()
print(len(watch.found), watch.kind)
try:
    socket.create_connection(("127.0.0.1", 9), timeout=0.1)
except OSError:
    pass
print(watch.kind)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert ended.stdout.split() == ["1", "outside", "connection"]


@pytest.mark.parametrize("text", [DEEP, '{"files": {"raw.h5": Infinity}, "mark": ""}', '{"files": []}', "[]"])
def test_lists_of_results_of_any_form_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / ".sarmitsuba.json").write_text(text)
    with pytest.raises(OutputError, match="the list of written files cannot be read"):
        OutputFolder(tmp_path)


def test_records_nested_too_deep_are_refused(tmp_path: Path) -> None:
    (tmp_path / "parameters.json").write_text(DEEP)
    with pytest.raises(DataError, match="cannot be read"):
        read_run(tmp_path)
    for record in (DEEP, json.dumps({"fingerprint": "x", "count": float("inf")})):
        np.savez(
            tmp_path / "passes.npz",
            data=np.zeros(1),
            change=np.zeros(0),
            record=np.frombuffer(record.encode(), np.uint8),
        )
        with pytest.raises(DataError, match="cannot read the passes"):
            Passes.load(tmp_path / "passes.npz", "x", LAYOUT)


def test_headers_of_arrays_that_do_not_end_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "passes.npz", record=np.zeros(3, np.uint8))
    whole = (tmp_path / "passes.npz").read_bytes()
    (tmp_path / "passes.npz").write_bytes(whole.replace(b"(3,), }", b"(3,), ("))
    with pytest.raises(DataError, match="cannot read the passes"):
        Passes.load(tmp_path / "passes.npz", "x", LAYOUT)


@pytest.mark.skipif(os.name != "posix", reason="pipes of Unix")
def test_passes_that_are_a_pipe_hold_nobody_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "passes.npz")
    with pytest.raises(DataError, match="not a regular file"):
        Passes.load(tmp_path / "passes.npz", "x", LAYOUT)


def test_a_journal_ends_where_a_label_is_none(tmp_path: Path) -> None:
    from sarmitsuba.machine import journal

    with closing(Journal(tmp_path / "raw.blocks", lambda label, payload: True)) as written:
        written.append({"x": 1}, np.arange(3.0))
    with (tmp_path / "raw.blocks").open("ab") as file:
        for label in (DEEP.encode(), b"[1]", b"{"):
            file.write(
                journal._HEADER.pack(journal._RECORD, len(label), 0, zlib.crc32(b"", zlib.crc32(label)))
                + label
            )
    with closing(Journal(tmp_path / "raw.blocks", lambda label, payload: True)) as read:
        assert read.labels == [{"x": 1}]


def test_maps_on_meshes_of_structured_ply_files(samples: Path) -> None:
    """Indices of faces that trimesh gives with their count beside them."""
    path = samples / "uv.xml"
    text = (samples / "files.xml").read_text().replace('<string name="map_extent" value="-3 -2 3 2"/>', "")
    path.write_text(text)
    from sarmitsuba.core.errors import SceneError

    with pytest.raises(SceneError, match='has no attribute "uv"'):
        load_scene(path)


def test_phase_histories_have_places_that_can_be(samples: Path, tmp_path: Path) -> None:
    import scipy.io

    from sarmitsuba.files import read_raw

    found = scipy.io.loadmat(samples / "raw.mat")["data"][0, 0]
    fields = {name: found[name] for name in found.dtype.names}
    for name in ("x", "r0"):
        far = np.full_like(fields[name], 1e300)
        scipy.io.savemat(tmp_path / "raw.mat", {"data": fields | {name: far}})
        with pytest.raises(DataError, match=r"reach 1e\+300 m; at most 1e\+10 m"):
            read_raw(tmp_path / "raw.mat")


@pytest.mark.parametrize("element", ["ImageAreaCornerPoints", "CODTimePoly", "Parameters"])
def test_documents_without_an_element_are_refused(samples: Path, tmp_path: Path, element: str) -> None:
    from sarmitsuba.files import read_image, read_raw

    for name, tags in (("raw.cphd", (element,)), ("image.nitf", ("WFParameters", "IPPPoly", "UVectECF"))):
        whole = (samples / name).read_bytes()
        for tag in tags:
            old = tag.encode()
            assert old + b">" in whole
            (tmp_path / name).write_bytes(
                whole.replace(old + b">", old[::-1] + b">").replace(old + b" ", old[::-1] + b" ")
            )
            with pytest.raises(DataError, match=r"cannot be read as|has no"):
                (read_raw if name == "raw.cphd" else read_image)(tmp_path / name)


def test_outlines_with_corners_twice_and_rings_in_rings(tmp_path: Path) -> None:
    shapely = pytest.importorskip("shapely", minversion="2.1", reason="in the importing extra")
    from sarmitsuba.loading.importing.polygons import triangulate
    from sarmitsuba.loading.importing.sources.citygml import _outermost

    ring = [(0, 0), (4, 0), (4, 3), (4, 3), (4, 3), (0, 3), (0, 0), (0, 0)]
    corners, faces = triangulate(shapely.Polygon(ring))
    a, b, c = (corners[faces[:, i]] for i in range(3))
    u, v = b - a, c - a
    assert 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() == pytest.approx(12.0, rel=1e-12)
    import xml.etree.ElementTree as ET

    root = ET.fromstring("<p>" + "<LinearRing>" * 100 + "</LinearRing>" * 100 + "<a><LinearRing/></a></p>")
    assert len(list(_outermost(root, "LinearRing"))) == 2


OFFLINE = """
import socket, sys
from sarmitsuba import cli
try:
    socket.create_connection(("1.1.1.1", 53), timeout=2)
except OSError:
    print("no network", file=sys.stderr)
status = [
    cli.main(["import", "map.osm", "-o", "city.xml"]),
    cli.main(["render", "point", "-o", "out", "--no-error-bars", "--page", "-D", "range_film.image_extent_azimuth=4",
        "-D", "range_film.image_extent_range=4", "-D", "sar_antenna.slant_range=1000"]),
    cli.main(["view", "out", "-o", "view.html"]),
]
print(status, file=sys.stderr)
"""


def test_everything_works_without_network_interfaces(samples: Path, tmp_path: Path) -> None:
    """Import, render with its page, and view in a network namespace in which there is not even a loopback address."""
    alone = ["unshare", "--net", "--map-root-user"]
    if (
        shutil.which("unshare") is None
        or subprocess.run([*alone, "true"], capture_output=True, check=False).returncode
    ):
        pytest.skip("unshare is missing or not allowed: no namespace without interfaces can be made")
    shutil.copy(samples / "map.osm", tmp_path)
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    ended = subprocess.run(
        [*alone, sys.executable, "-c", OFFLINE], cwd=tmp_path, env=os.environ | {"PYTHONPATH": paths},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "no network" in ended.stderr and "[0, 0, 0]" in ended.stderr, ended.stderr
    assert (tmp_path / "view.html").is_file() and (tmp_path / "city.xml").is_file()


@pytest.mark.parametrize("turn", [(-1, 1), (1, -1)], ids=["column", "row"])
@pytest.mark.parametrize("name", ["raw.h5", "image.h5"])
def test_vectors_as_matlab_writes_them_are_vectors(
    samples: Path, tmp_path: Path, name: str, turn: tuple[int, int]
) -> None:
    """(n, 1) and (1, n): of the time of a track it was a traceback."""
    read = read_raw if name == "raw.h5" else read_image
    whole, count = read(samples / name), 0
    axes = ("grid/azimuth", "grid/range", "grid/origin", "calibration/incidence_angle")
    for place in ("track/time", "radar/window/start_range", "radar/aim_point", *axes):
        shutil.copy(samples / name, tmp_path / name)
        with h5py.File(tmp_path / name, "r+") as file:
            if place not in file:
                continue
            values = file[place][()]
            del file[place]
            file[place] = values.reshape(turn)
            count += 1
        np.testing.assert_array_equal(read(tmp_path / name).data, whole.data)
    assert count >= 3


@pytest.mark.parametrize("place", ["track/position", "track/time", "radar/window/start_range"])
def test_vectors_of_other_shapes_are_refused_in_one_line(samples: Path, tmp_path: Path, place: str) -> None:
    for shape in ((1, 3, -1), (-1, 1, 2)):
        shutil.copy(samples / "raw.h5", tmp_path / "raw.h5")
        with h5py.File(tmp_path / "raw.h5", "r+") as file:
            values = np.resize(file[place][()], 24)
            del file[place]
            file[place] = values.reshape(shape)
        with pytest.raises(DataError, match=r"shape|must be"):
            read_raw(tmp_path / "raw.h5")


@pytest.mark.parametrize(
    "name", ["sar_antenna.n_pulses", "sar_path.seed", "sar_antenna.slant_range", "sar_path.ray_spacing"]
)
def test_numbers_of_400_digits_are_refused_in_one_line(name: str) -> None:
    with pytest.raises(SarmitsubaError, match=r"is not a finite number|must be|not a number"):
        load_scene("point", parameters={name: "9" * 400})


@pytest.mark.skipif(os.name != "posix", reason="names of bytes")
def test_names_that_are_no_text_are_refused_before_the_work(tmp_path: Path, samples: Path) -> None:
    strange = tmp_path / os.fsdecode(b"b\xff")
    strange.mkdir()
    shutil.copy(samples / "scene.xml", strange)
    image = read_image(samples / "image.h5")
    for act in (
        lambda: load_scene(strange / "scene.xml"),
        lambda: write_image(image, strange / "a.exr"),
        lambda: image.plot(strange / "a.png"),
        lambda: OutputFile(strange / "a.png"),
        lambda: make_folder(strange / "out"),
    ):
        with pytest.raises(SarmitsubaError, match="the name is not UTF-8 text"):
            act()
    assert cli.main(["render", str(strange / "scene.xml"), "-o", str(tmp_path / "o")]) == 2


@pytest.mark.skipif(os.name != "posix", reason="closes standard streams")
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&- <&-"])
def test_a_closed_output_is_none(closed: str) -> None:
    command = f"{sys.executable} -m sarmitsuba scenes {closed}"
    assert subprocess.run(["sh", "-c", command], check=False).returncode == 0
