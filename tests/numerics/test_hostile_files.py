"""A part of benchmarks/studies/hostile.py: drawn damage to every kind of file, and what is refused by rule."""

import io
import os
import random
import signal
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from sarmitsuba import cli
from sarmitsuba.commands.scenes import copy_scene
from sarmitsuba.core.errors import DataError, RadarError, SarmitsubaError, SceneError
from sarmitsuba.files import read_raw
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.maps import _pixels as read_pixels
from sarmitsuba.machine import exclusive
from sarmitsuba.machine.backend import CACHE_VARIABLE, prepare_kernel_cache
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.orbit import StateVectors
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.simulation.execution.passes import Passes, PassLayout
from tests.support.draws import few_of

# shapes without a material are said to be read as concrete
pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")

LAYOUT = PassLayout((Layer("VV"),), 3, 3, 10.0)
# what is read in this process; the others may take it down, and have their readers tried apart
KINDS = (
    "scene",
    "hdf5-image",
    "cphd",
    "sicd",
    "passes",
    "ply",
    "ply-text",
    "obj",
    "serialized",
    "scene-graph",
    "glb",
    "track",
    "vectors",
    "orbit-file",
)

SHAPE = '<shape type="ply"><string name="filename" value="{}"/></shape>'
SCENE = """<scene version="3.0.0"><sensor type="sar_antenna"><integer name="n_pulses" value="8"/>
<film type="range_film"/></sensor>{}<shape type="cube"/></scene>"""


@pytest.mark.parametrize("draws", few_of([6, 12]))
@pytest.mark.parametrize("name", KINDS)
def test_drawn_damage_is_read_or_refused_in_one_line(
    hostile: ModuleType, samples: Path, tmp_path: Path, name: str, draws: int
) -> None:
    kind = hostile.KINDS[name]
    whole = (samples / kind.file).read_bytes()
    if name == "scene":
        (tmp_path / "mesh.ply").write_bytes((samples / "mesh.ply").read_bytes())
    path = tmp_path / f"drawn{Path(kind.file).suffix}"
    path.write_bytes(whole)
    assert hostile.read_one(kind, path) == ("read", "")
    outcomes = []
    for seed in range(draws):
        path.write_bytes(kind.mutate(random.Random(seed), whole))
        outcome, text = hostile.read_one(kind, path)
        assert outcome in ("read", "refused"), f"seed {seed}: {outcome}: {text}"
        outcomes.append(outcome)
    assert "refused" in outcomes


def write(folder: Path, text: str, name: str = "scene.xml") -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_meshes_outside_the_folder_need_a_flag(tmp_path: Path, samples: Path) -> None:
    outside = tmp_path / "outside.ply"
    outside.write_bytes((samples / "mesh.ply").read_bytes())
    folder = tmp_path / "scene"
    for name in ("../outside.ply", str(outside), "link.ply", "../scene/../outside.ply"):
        path = write(folder, SCENE.format(SHAPE.format(name)))
        if not (folder / "link.ply").exists():
            os.symlink(outside, folder / "link.ply")
        with pytest.raises(SceneError, match=r"lies outside the folder of the scene; .*--allow-outside"):
            load_scene(path)
        assert load_scene(path, allow_outside=True).geometry.n_faces == 24
    (folder / "inside.ply").write_bytes(outside.read_bytes())
    assert load_scene(write(folder, SCENE.format(SHAPE.format("../scene/inside.ply")))).geometry.n_faces == 24


def test_the_command_line_has_the_flag(
    tmp_path: Path, samples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "outside.ply").write_bytes((samples / "mesh.ply").read_bytes())
    path = write(tmp_path / "scene", SCENE.format(SHAPE.format("../outside.ply")))
    assert cli.main(["explain", str(path), "--quiet"]) == 2
    assert "outside the folder of the scene" in capsys.readouterr().err
    assert cli.main(["explain", str(path), "--quiet", "--plan-only", "--allow-outside"]) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<include filename="../part.xml"/>', '<include> of "../part.xml" lies outside'),
        ('<include filename="/dev/zero"/>', "lies outside"),
        ('<include filename="sub/evil.xml"/>', "lies outside"),
        ('<default name="f" value="../part.xml"/><include filename="$f"/>', "could stand for any place"),
        ('<path value=".."/><include filename="part.xml"/>', '<path> of ".." lies outside'),
    ],
)
def test_includes_outside_the_folder_need_a_flag(tmp_path: Path, text: str, message: str) -> None:
    write(tmp_path, '<scene version="3.0.0"/>', "part.xml")
    path = write(tmp_path / "scene", SCENE.format(text))
    write(
        tmp_path / "scene" / "sub",
        '<scene version="3.0.0"><include filename="/dev/zero"/></scene>',
        "evil.xml",
    )
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert message in str(caught.value)


def test_an_include_is_an_ordinary_file_even_where_it_may_be_anywhere(tmp_path: Path) -> None:
    path = write(tmp_path, SCENE.format('<include filename="/dev/zero"/>'))
    with pytest.raises(SceneError, match="not a regular file"):
        load_scene(path, allow_outside=True)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(
    "subset", ["[{bomb}]", 'SYSTEM "file:///etc/passwd"', '[<!ENTITY x SYSTEM "file:///etc/passwd">]']
)
def test_document_types_are_refused(hostile: ModuleType, tmp_path: Path, subset: str, encoding: str) -> None:
    head = f"<!DOCTYPE a {subset.format(bomb=hostile.BOMB)}>"
    path = tmp_path / "scene.xml"
    path.write_bytes((head + SCENE.format("")).encode(encoding))
    with pytest.raises(SceneError, match="document type" if encoding == "utf-8" else "in UTF-8"):
        load_scene(path)
    orbit = tmp_path / "orbit.EOF"
    orbit.write_bytes((head + "<a><UTC>&x;&e11;</UTC></a>").encode(encoding))
    with pytest.raises(RadarError, match="document type"):
        StateVectors.read(orbit)


def test_document_types_in_cphd_are_refused(samples: Path, tmp_path: Path) -> None:
    whole = (samples / "raw.cphd").read_bytes()
    start = whole.index(b"<CPHD")
    size = int(whole[whole.index(b"XML_BLOCK_SIZE := ") + 18 :].split(b"\n")[0])
    kind = b"<!DOCTYPE CPHD [<!ENTITY x SYSTEM 'file:///etc/passwd'>]>"
    text = kind + b"<CPHD xmlns='http://api.nsgreg.nga.mil/schema/cphd/1.1.0'>&x;</CPHD>"
    path = tmp_path / "raw.cphd"
    path.write_bytes(whole[:start] + text.ljust(size) + whole[start + size :])
    with pytest.raises(DataError, match="document type"):
        read_raw(path)


def test_polynomials_of_any_order_in_cphd_are_refused(samples: Path, tmp_path: Path) -> None:
    """One coefficient of order 16 000 in both variables is a table of 2 GB, in a file of 15 kB."""
    whole = (samples / "raw.cphd").read_bytes()
    start = whole.index(b"<CODTimePoly")
    size = whole.index(b"</CODTimePoly>", start) + len(b"</CODTimePoly>") - start
    path = tmp_path / "raw.cphd"
    for order in (0, 16_000):
        orders = [f'{name}{i}="{order}"' for name in ("order", "exponent") for i in (1, 2)]
        text = f"<CODTimePoly {' '.join(orders[:2])}><Coef {' '.join(orders[2:])}>0.03</Coef></CODTimePoly>"
        path.write_bytes(whole[:start] + text.encode().ljust(size) + whole[start + size :])
        if order == 0:
            read_raw(path)
    with pytest.raises(DataError, match="times its size"):
        read_raw(path)


def test_scans_of_a_picture_are_bounded_by_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A progressive JPEG may go through all of its pixels once more for every 95 bytes."""
    monkeypatch.setattr("sarmitsuba.machine.isolated._LEAST_LIMIT", 1)
    stored = io.BytesIO()
    Image.new("L", (2000, 2000)).save(stored, "jpeg", progressive=True)
    whole, path = stored.getvalue(), tmp_path / "map.jpg"
    path.write_bytes(whole)
    assert read_pixels(path, "map").shape == (2000, 2000, 1)
    path.write_bytes(whole[:-2] + whole[whole.rindex(b"\xff\xda") : -2] * 10_000 + whole[-2:])
    with pytest.raises(SceneError, match="never ends"):
        read_pixels(path, "map")


def test_names_of_thousands_of_characters_are_cut(tmp_path: Path) -> None:
    long = "x" * 5000
    for text in (
        SHAPE.format(long),
        f'<{long} name="a"/>',
        f'<include filename="{long}"/>',
        f'<shape type="{long}"/>',
    ):
        with pytest.raises(SarmitsubaError) as caught:
            load_scene(write(tmp_path, SCENE.format(text)))
        assert len(str(caught.value)) <= 900


def test_messages_are_one_line_of_bounded_length_whatever_they_are_made_of() -> None:
    text = str(DataError("a\nb\x85c" + "y" * 10**6 + "; the remedy"))
    assert len(text) <= 900 and text.startswith("a b c") and text.endswith("; the remedy")


def test_the_state_of_passes_is_never_unpickled(tmp_path: Path) -> None:
    marker = tmp_path / "run"

    class Evil:
        def __reduce__(self) -> tuple[object, ...]:
            return (Path.touch, (marker,))

    record = np.frombuffer(b"{}", np.uint8)
    evil = np.empty(1, dtype=object)
    evil[0] = Evil()
    np.savez(tmp_path / "passes.npz", record=record, data=evil, change=evil)
    with pytest.raises(DataError, match="cannot read the passes"):
        Passes.load(tmp_path / "passes.npz", "any", LAYOUT)
    assert not marker.exists()


def test_readers_that_die_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, "", "file")
    survive(path, lambda: None)
    survive(path, lambda: 1 / 0)  # its errors are the caller's to word
    with pytest.raises(DataError, match=r"crashes \(SIGSEGV\)"):
        survive(path, lambda: os.kill(os.getpid(), signal.SIGSEGV))
    with pytest.raises(DataError, match="never ends"):
        survive(path, lambda: os.kill(os.getpid(), signal.SIGXCPU))
    monkeypatch.setattr("sarmitsuba.machine.isolated._PATIENCE", 0.02)
    with pytest.raises(DataError, match="never ends"):
        survive(path, signal.pause)


def test_trials_fork_while_no_other_thread_computes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenBLAS stops its threads before a fork, and waits for ever where one of ours is in the midst of a product."""
    fork, held = os.fork, []

    def watched() -> int:
        held.append(exclusive._lock._is_owned())
        return fork()

    monkeypatch.setattr(os, "fork", watched)
    survive(write(tmp_path, "", "file"), lambda: None)
    assert held == [True]


def test_kernels_go_elsewhere_where_the_home_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    assert prepare_kernel_cache() is None
    monkeypatch.setenv("HOME", "/proc/nobody")  # not even root can write there
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv(CACHE_VARIABLE, "")  # undone after the test, whatever is put there
    with pytest.warns(UserWarning, match="compiled kernels are kept in"):
        folder = prepare_kernel_cache()
    assert folder is not None and folder.parent == tmp_path and os.environ[CACHE_VARIABLE] == str(folder)
    assert folder.stat().st_mode & 0o077 == 0
    assert prepare_kernel_cache() is None  # said once
    folder.chmod(0o777)  # somebody else could have put kernels there
    monkeypatch.setenv(CACHE_VARIABLE, "")
    with pytest.warns(UserWarning, match="compiled kernels"):
        assert prepare_kernel_cache() != folder


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SHAPE.format("../outside.ply"), "outside its own folder"),
        (SHAPE.format("/etc/passwd"), "outside its own folder"),
        ('<include filename="scene.xml"/>', "includes itself"),
        ('<include filename="../part.xml"/>', "lies outside"),
        ("<a>", "malformed XML"),
    ],
)
def test_copying_a_scene_reads_and_writes_nothing_elsewhere(tmp_path: Path, text: str, message: str) -> None:
    """A name with ``..`` would have been read beside the scene, and written beside the target."""
    for name in ("outside.ply", "part.xml"):
        write(tmp_path, '<scene version="3.0.0"/>', name)
    path = write(tmp_path / "scene", SCENE.format(text))
    with pytest.raises(SceneError, match=message):
        copy_scene(path, tmp_path / "deep" / "target")
    assert not (tmp_path / "deep").exists()
