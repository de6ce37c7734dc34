"""What strangers hand in does not act: files of every kind, pages made of them, and signals in the middle."""

import dataclasses
import hashlib
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

import sarmitsuba
import sarmitsuba.view.page
from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import DataError, SarmitsubaError, SarmitsubaWarning, SceneError
from sarmitsuba.files import read_image, read_raw, write_image, write_raw
from sarmitsuba.loading.maps import MOST_PIXELS, _pixels
from sarmitsuba.loading.mesh_files import obj_materials, read_parts
from sarmitsuba.machine.backend import CACHE_VARIABLE, prepare_kernel_cache
from sarmitsuba.radar.image_request import ImageRequest
from tests.support.unweighted import focus

ROOT = Path(__file__).parents[2]
WEB = Path(sarmitsuba.view.page.__file__).parent / "web"
SCENE = '<scene version="3.0.0">{}</scene>'
SPECTRUM = SCENE.format('<bsdf type="diffuse"><spectrum name="reflectance" filename="{}"/></bsdf>')
needs_posix = pytest.mark.skipif(os.name != "posix", reason="pipes, links and signals of Unix")


# ---------------------------------------------------------------- scene files


def test_a_spectrum_outside_the_folder_is_not_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret.spd"
    secret.write_text("do not tell 1 2")
    (tmp_path / "scene").mkdir()
    path = tmp_path / "scene" / "scene.xml"
    for name in ("../secret.spd", str(secret), "$f"):
        path.write_text(SPECTRUM.format(name))
        with pytest.raises(SceneError, match=r"outside the folder|could stand for any place") as caught:
            sarmitsuba.load_scene(path)
        assert "do not tell" not in str(caught.value)


@needs_posix
def test_the_folder_that_the_program_runs_in_is_not_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of a scene are looked for beside it; one that is missing there is not taken from where the user works."""
    (tmp_path / "work").mkdir()
    (tmp_path / "scene").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    Path("notes.spd").write_text("do not tell\n1 2")
    Path("notes.xml").write_text(SCENE.format('<do not="tell"/>'))
    path = tmp_path / "scene" / "scene.xml"
    for text in (SPECTRUM.format("notes.spd"), SCENE.format('<include filename="notes.xml"/>')):
        path.write_text(text)
        with pytest.raises(SceneError, match="there is no such file beside the scene"):
            sarmitsuba.load_scene(path)
    (tmp_path / "scene" / "notes.spd").write_text("no spectrum\nat all")
    path.write_text(SPECTRUM.format("notes.spd"))
    with pytest.raises(SceneError, match="Could not extract wavelength in line 1"):
        sarmitsuba.load_scene(path)
    (tmp_path / "scene" / "notes.spd").unlink()
    (tmp_path / "scene" / "sub").mkdir()
    os.symlink(tmp_path / "work" / "notes.spd", tmp_path / "scene" / "sub" / "notes.spd")
    path.write_text(SPECTRUM.format("notes.spd").replace("<bsdf", '<path value="sub"/><bsdf'))
    with pytest.raises(SceneError, match="outside the folder"):
        sarmitsuba.load_scene(path)


@needs_posix
def test_pipes_and_devices_do_not_hold_a_scene_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.spd")
    path = tmp_path / "scene.xml"
    path.write_text(SPECTRUM.format("pipe.spd"))
    with pytest.raises(SceneError, match="not a regular file"):
        sarmitsuba.load_scene(path)
    path.write_text(SPECTRUM.format("/dev/zero"))
    with pytest.raises(SceneError, match="not a regular file"):
        sarmitsuba.load_scene(path, allow_outside=True)


def test_nesting_ends_before_the_stack_does(tmp_path: Path) -> None:
    path = tmp_path / "deep.xml"
    path.write_text(SCENE.format('<shape type="x">' * 10_000 + "</shape>" * 10_000))
    with pytest.raises(SceneError, match="elements are nested more than 200 deep"):
        sarmitsuba.load_scene(path)


# ---------------------------------------------------------------- meshes, bitmaps, rasters, recordings


def test_rows_of_blanks_cost_their_length(tmp_path: Path) -> None:
    path = tmp_path / "blanks.obj"
    blank = b" \t" * 200_000
    path.write_bytes(
        b"usemtl" + blank + b"wall\nv 0 0 0\nv 1 0 0\nv 0 1 0\n" + blank + b"f" + blank + b"1/1 2//2 3\n"
    )
    assert obj_materials(path) == ("wall",)
    (part,) = read_parts(path, "test")
    assert part.faces.shape == (1, 3) and part.material == "wall"


def test_a_scene_is_found_from_a_folder_beside_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative path with .. to the scene is not taken for an include outside its folder."""
    (tmp_path / "work").mkdir()
    (tmp_path / "other" / "scene").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "work")
    text = Path(sarmitsuba.__file__).parents[1].joinpath("scenes", "point.xml").read_text()
    (tmp_path / "other" / "scene" / "mine.xml").write_text(text)
    assert sarmitsuba.load_scene("../other/scene/mine.xml").name == "mine"


@pytest.mark.parametrize("name", ["../buffer.bin", "/etc/hostname", "http://127.0.0.1:9/buffer.bin"])
def test_a_gltf_file_names_buffers_beside_it_alone(tmp_path: Path, name: str) -> None:
    import trimesh

    (tmp_path / "model").mkdir()
    files = trimesh.creation.box().scene().export(file_type="gltf")
    model = files["model.gltf"]
    for part, content in files.items():
        (tmp_path / "model" / part).write_bytes(content)
    path = tmp_path / "model" / "model.gltf"
    assert len(read_parts(path, "test")) == 1
    (buffer,) = re.findall(rb'"uri":\s*"([^"]+\.bin)"', model)[:1]
    (tmp_path / "buffer.bin").write_bytes(files[buffer.decode()])
    path.write_bytes(model.replace(buffer, name.encode()))
    with pytest.raises(SceneError, match="lies outside its folder"):
        read_parts(path, "test")


def test_a_bitmap_is_measured_before_it_is_unpacked(tmp_path: Path) -> None:
    import struct
    import zlib

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes(10_000))
    (tmp_path / "bomb.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )
    with pytest.raises(SceneError, match=f"more pixels than the bound {MOST_PIXELS}"):
        _pixels(tmp_path / "bomb.png", "test")


def test_what_calls_itself_tif_is_read_as_geotiff_alone(tmp_path: Path) -> None:
    terrain = pytest.importorskip("sarmitsuba.loading.importing.terrain")
    pytest.importorskip("rasterio")
    (tmp_path / "x.tif").write_text(
        '<VRTDataset rasterXSize="4" rasterYSize="4"><SRS>EPSG:4326</SRS><GeoTransform>10,1,0,50,0,-1</GeoTransform>'
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename>/vsicurl/http://127.0.0.1:9/x'
        "</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(SceneError, match="no readable raster"):
        terrain.read_raster(tmp_path / "x.tif", 0.0, None)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the limit needs /proc")
def test_a_matlab_file_that_unpacks_a_thousandfold_is_refused(tmp_path: Path) -> None:
    import scipy.io

    fields = {"fp": np.zeros((2000, 24_000), np.complex64), "freq": np.linspace(9e9, 9.1e9, 2000)}
    fields |= {name: np.ones(24_000) for name in ("x", "y", "z", "r0")}
    scipy.io.savemat(tmp_path / "bomb.mat", {"data": fields}, do_compression=True)
    with pytest.raises(DataError, match="damaged or malicious"):
        read_raw(tmp_path / "bomb.mat")


# ---------------------------------------------------------------- numbers that cannot be


@pytest.fixture(scope="module")
def point() -> tuple[Any, Any]:
    raw = sarmitsuba.simulate(sarmitsuba.load_scene("point"), seed=1)
    return raw, focus(raw)


RADAR_WRONG: dict[str, dict[str, Any]] = {
    "transmit_power": {"transmit_power": -1.0},
    "losses": {"losses": 0.0},
    "noise_temperature": {"noise_temperature": float("inf")},
    "half_aperture": {"half_aperture": 0.0},
    "look_side": {"look_side": "<img src=x onerror=alert(1)>"},
    "aim_point": {"aim_point": np.array([0.0, 1e300, 0.0])},
}


@pytest.mark.parametrize("name", RADAR_WRONG)
def test_a_radar_from_a_file_has_the_bounds_of_a_scene_file(
    point: tuple[Any, Any], tmp_path: Path, name: str
) -> None:
    raw, _ = point
    wrong = dataclasses.replace(raw, radar=dataclasses.replace(raw.radar, **RADAR_WRONG[name]))
    write_raw(wrong, tmp_path / "raw.h5")
    with pytest.raises(DataError, match=name):
        read_raw(tmp_path / "raw.h5")
    with pytest.raises(SarmitsubaError, match=name):
        focus(wrong)


def test_speed_latitude_gain_and_request_are_checked(point: tuple[Any, Any], tmp_path: Path) -> None:
    raw, _ = point
    radar = raw.radar
    still = dataclasses.replace(radar.track, velocity=0.0 * radar.track.velocity)
    beam = dataclasses.replace(radar.antenna, gain=0.0)
    far = dataclasses.replace(radar.anchor, latitude=1e308)
    for field, value, said in (
        ("track", still, "speeds"),
        ("antenna", beam, "gain"),
        ("anchor", far, "latitude"),
    ):
        write_raw(
            dataclasses.replace(raw, radar=dataclasses.replace(radar, **{field: value})), tmp_path / "raw.h5"
        )
        with pytest.raises(DataError, match=said):
            read_raw(tmp_path / "raw.h5")
    request = dataclasses.replace(raw.request or ImageRequest(), spacing_range=float("inf"))
    write_raw(dataclasses.replace(raw, request=request), tmp_path / "raw.h5")
    with pytest.raises(DataError, match="spacing_range"):
        read_raw(tmp_path / "raw.h5")


def test_an_image_from_a_file_is_checked(point: tuple[Any, Any], tmp_path: Path) -> None:
    _, image = point
    path = tmp_path / "image.h5"
    for dataset, value, said in (
        ("calibration/wavelength", 0.0, "wavelength"),
        ("grid/range", np.zeros(image.grid.range.shape), "steps"),
        ("grid/along", np.array([0.0, 2.0, 0.0]), "unit vectors"),
        ("calibration/incidence_angle", -1.0 + 0.0 * image.incidence_angle, "incidence"),
    ):
        write_image(image, path)
        with h5py.File(path, "r+") as file:
            file[dataset][...] = value
        with pytest.raises(DataError, match=said):
            read_image(path)


# ---------------------------------------------------------------- pages and terminals


def test_one_module_alone_makes_elements_of_text() -> None:
    """Values of a page pass through its templates, which escape them."""
    sinks = re.compile(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|srcdoc")
    found = {
        path.name
        for path in WEB.iterdir()
        if path.suffix in {".js", ".html"} and sinks.search(path.read_text(encoding="utf-8"))
    }
    assert found == {"markup.js"}
    for page in ("index.html", "rcs.html"):
        text = (WEB / page).read_text(encoding="utf-8")
        assert "{{policy}}" in text.partition("<script")[0]
        assert not re.search(r"\son\w+=", text), "an event attribute, which the policy blocks"


def test_pages_run_their_own_scripts_alone(tmp_path: Path) -> None:
    import base64

    from sarmitsuba.view.page.write import write_page

    write_page(
        tmp_path / "page.html", {"title": "</title><script>alert(1)</script>", "x": "</script><script>1"}
    )
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert "default-src 'none'" in policy and "http" not in policy and "unsafe-eval" not in policy
    assert "unsafe-inline" not in policy.partition("script-src")[2].partition(";")[0]
    running = re.findall(r'<script(?: type="(?:module|importmap)")?>(.*?)</script>', text, re.DOTALL)
    assert len(running) == 2
    for script in running:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_terminals_get_no_control_characters_and_no_megabytes(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    evil = "a\x1b[2Jb\x07c\x9bd\u202ee" + "x" * 5_000_000
    console.warn(evil)
    console.note(evil + "note")
    console.complain(evil)
    console.say("a\x1b]0;title\x07b\tc\nd")
    with pytest.warns(SarmitsubaWarning) as caught:
        import warnings

        warnings.warn(evil, SarmitsubaWarning, stacklevel=1)
    out = capsys.readouterr()
    assert len(out.err) < 3000 and len(str(caught[0].message)) <= 900
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", out.err + out.out + str(caught[0].message))
    assert out.out.endswith("b\tc\nd\n")


# ---------------------------------------------------------------- kernels, threads, signals


@needs_posix
@pytest.mark.parametrize("kind", ["writable", "link"])
def test_kernels_that_others_could_have_written_are_not_used(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = tmp_path / ".drjit"
    if kind == "link":
        (tmp_path / "elsewhere").mkdir()
        folder.symlink_to(tmp_path / "elsewhere")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    with pytest.warns(SarmitsubaWarning, match=r"others can write|is no folder"):
        chosen = prepare_kernel_cache()
    assert chosen is not None and chosen != folder
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    if kind == "writable":
        folder.chmod(0o755)
        assert prepare_kernel_cache() is None


@pytest.fixture(scope="module")
def mixes(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    return benchmark_script("thread_mixes")


def test_threads_get_the_bits_of_one_thread(mixes: ModuleType) -> None:
    """A part of benchmarks/studies/thread_mixes.py; the last mix is the first that a process of its own does."""
    report = mixes.run(4, fresh_every=4)
    assert report["calls"] >= 8 and report["different"] == 0, report["first"]


@needs_posix
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_a_run_with_one_line_whatever_it_is_at(
    tmp_path: Path, benchmark_script: Callable[[str], ModuleType], number: int, status: int
) -> None:
    """A part of benchmarks/studies/interrupt.py: at the first moment, while modules load, in the middle of the work."""
    interrupt = benchmark_script("interrupt")
    for share in (0.0, 0.4):
        ended = interrupt.interrupted(tmp_path, number, delay=share)
        assert ended.status == status and ended.wrong == "", ended


@needs_posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_run_inside_c_code_that_answers_none(
    tmp_path: Path, benchmark_script: Callable[[str], ModuleType], number: int
) -> None:
    """No thread of Python runs meanwhile: a process outside ends this one, and removes its unfinished file."""
    interrupt = benchmark_script("interrupt")
    ended = interrupt.interrupted(tmp_path, number, 0.0, "python")
    assert ended.status == interrupt.KILLED and ended.wrong == "", ended
    assert [path.name for path in tmp_path.rglob("*part*")] == []
