"""Files come back exactly as they were written, and never half written."""

import dataclasses
import json
import re
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import OpenEXR
import pytest
from matplotlib.image import imread

import sarmitsuba
from sarmitsuba.core.errors import DataError, OutputError
from sarmitsuba.files import hdf5_file, read_image, read_raw, write_image, write_raw
from sarmitsuba.files.formats import FORMATS, FileFormat, find_format
from sarmitsuba.files.table_file import read_table
from sarmitsuba.machine import output as parameter_file
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.encoding import to_json
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.view.quicklook import quicklook, save
from tests.support.scenes import shipped

LAYERS = (Layer("VV", 1, 1), Layer("VV", 1, 2), Layer("VV", 2), Layer("HV"))
DOCS = Path(__file__).parents[2] / "docs"
PAGE = "\n".join((DOCS / name).read_text(encoding="utf-8") for name in ("files.md", "labels.md"))
METADATA = {"seed": 7, "scene": "σ.xml", "times": [0.1, 1e-300], "nested": {"a": None, "b": True}}


def make_raw(n_pulses: int = 5, n_fast: int = 11) -> RawData:
    rng = np.random.default_rng(1)
    track = Track.straight([-1e6 + 1 / 3, 0.1, 5e5], [0.0, 7500.123, 0.0], 4321.1, n_pulses)
    triad = np.broadcast_to(np.eye(3), (n_pulses, 3, 3))
    radar = Radar(
        mode="spotlight",
        track=track,
        waveform=Waveform(9.65e9, 300e6, 1e-6),
        antenna=Antenna("gaussian", 1234.5, 0.01, 0.02),
        pointing=Pointing(triad[:, 0].copy(), triad[:, 1].copy(), triad[:, 2].copy()),
        window=ReceiveWindow(7e5 + rng.random(n_pulses), 0.41, n_fast),
        channels=("VV", "HV"),
        look_side="left",
        aim_point=rng.random(3),
        noise_temperature=290.0,
        losses=1.5,
    )
    shape = (4, n_pulses, n_fast)
    data = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    return RawData(data, LAYERS, "compressed", radar, METADATA)


def make_image(n_azimuth: int = 6, n_range: int = 9) -> SarImage:
    rng = np.random.default_rng(2)
    grid = ImageGrid(
        "ground",
        np.arange(n_azimuth) * 0.3 - 1.0,
        np.arange(n_range) * 0.7,
        np.array([0.1, 0.2, 0.3]),
        np.array([0.0, 1.0, 0.0]),
        np.array([1.0, 0.0, 0.0]),
        0.5,
    )
    data = rng.normal(size=(4, n_azimuth, n_range)) + 1j * rng.normal(size=(4, n_azimuth, n_range))
    incidence = np.linspace(0.5, 0.6, n_range)
    return SarImage(data.astype(np.complex64), LAYERS, grid, 0.031, 0.4, 0.5, incidence, METADATA)


def assert_same(a: object, b: object, where: str = "") -> None:
    """Fail unless two values agree bit for bit, in type and in every field."""
    assert type(a) is type(b), f"{where}: {type(a)} is not {type(b)}"
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes(), where
    else:
        assert a == b, where


def test_raw_data_round_trip_is_exact(tmp_path: Path) -> None:
    raw = make_raw()
    write_raw(raw, tmp_path / "raw.h5")
    assert_same(read_raw(tmp_path / "raw.h5"), raw)


def test_image_round_trip_is_exact(tmp_path: Path) -> None:
    image = make_image()
    write_image(image, tmp_path / "image.h5")
    assert_same(read_image(tmp_path / "image.h5"), image)


def with_subsets(content: RawData | SarImage) -> RawData | SarImage:
    """Two subsets of two bounce orders in two channels, as a run with error bars and keep_orders makes them."""
    layers = tuple(Layer(c, o, s) for s in (1, 2) for o in (1, 3) for c in ("VV", "HV"))
    return dataclasses.replace(content, layers=layers, data=np.concatenate([content.data, 2 * content.data]))


def test_one_dataset_per_channel_is_the_image(tmp_path: Path) -> None:
    image, raw = with_subsets(make_image()), with_subsets(make_raw())
    write_image(image, tmp_path / "image.h5")
    write_raw(raw, tmp_path / "raw.h5")
    for name, root, content in (("image.h5", "image", image), ("raw.h5", "echoes", raw)):
        with h5py.File(tmp_path / name) as file:
            assert set(file[root]) == {"VV", "HV"}
            for channel in ("VV", "HV"):
                whole = file[f"{root}/{channel}"][()]
                np.testing.assert_array_equal(whole, content.total(channel))
                orders = sum(file[f"orders/{channel}/{k}"][()] for k in (1, 3))
                # tol: float32 rounding of sums in another order
                np.testing.assert_allclose(orders, whole, rtol=1e-5, atol=1e-5)
                parts = [file[f"subsets/{s}/orders/{channel}/{k}"][()] for s in (1, 2) for k in (1, 3)]
                np.testing.assert_allclose(sum(parts), whole, rtol=1e-5, atol=1e-5)  # tol: the same
            assert "add up to" in file["subsets"].attrs["note"]
            assert [file[f"subsets/{s}"].attrs["share"] for s in (1, 2)] == [0.5, 0.5]
    assert_same(read_image(tmp_path / "image.h5"), image)
    assert_same(read_raw(tmp_path / "raw.h5"), raw)


def test_layers_of_which_one_is_the_sum_of_others_are_refused(tmp_path: Path) -> None:
    image = dataclasses.replace(make_image(), layers=(Layer("VV"), Layer("VV", 1), Layer("HV"), Layer("HH")))
    with pytest.raises(DataError, match="/image/VV is both a sum and a part"):
        write_image(image, tmp_path / "image.h5")
    twice = dataclasses.replace(image, layers=(Layer("VV", 1), Layer("VV", 1), Layer("HV"), Layer("HH")))
    with pytest.raises(DataError, match=r"same channel, order and subset|both a sum and a part"):
        write_image(twice, tmp_path / "image.h5")
    assert list(tmp_path.iterdir()) == []


def test_hdf5_is_self_describing(tmp_path: Path) -> None:
    write_raw(make_raw(), tmp_path / "raw.h5")
    write_image(make_image(), tmp_path / "image.h5")
    with h5py.File(tmp_path / "raw.h5") as file:
        assert file["echoes/VV"].attrs["axes"] == "pulse, sample"
        assert file["echoes/VV"].dtype.kind == "c"
        assert file["echoes"].attrs["domain"] == "compressed"
        assert file["track/position"].attrs["unit"] == "m"
        assert file["radar/waveform/center_frequency"][()] == 9.65e9
        # a range of pulses is read without the rest
        assert file["echoes/VV"].chunks is not None
    missing = []
    for name in ("raw.h5", "image.h5"):
        with h5py.File(tmp_path / name) as file:
            assert "exp(-j 4 pi" in file.attrs["phase_convention"]
            assert file.attrs["software"].startswith("sarmitsuba ")
            assert "x east" in file.attrs["frame"]
            file.visititems(
                lambda name, item: (
                    missing.append(name)
                    if isinstance(item, h5py.Dataset)
                    and item.dtype.kind in "fic"
                    and "unit" not in item.attrs
                    else None
                )
            )
    assert missing == []


def test_axes_are_dimension_scales(tmp_path: Path) -> None:
    image = make_image()
    write_image(image, tmp_path / "image.h5")
    with h5py.File(tmp_path / "image.h5") as file:
        azimuth, across = file["image/VV"].dims
        assert (azimuth.label, across.label) == ("azimuth", "range")
        np.testing.assert_array_equal(azimuth[0][()], image.grid.azimuth)
        np.testing.assert_array_equal(across[0][()], image.grid.range)


def test_sigma0_needs_no_json(tmp_path: Path) -> None:
    fit = {"center": 3.0, "scale": 2.0, "coefficients": [1.0, 0.1]}
    table = {"azimuth": [-1.0, 1.0], "range": [0.0, 6.0], "ratio": [[1.0, 1.1], [1.2, 1.3]]}
    for focus in ({}, {"azimuth_cell_polynomial": fit, "azimuth_cell_rows": table}):
        image = dataclasses.replace(make_image(), metadata={"focus": focus})
        write_image(image, tmp_path / "image.h5")
        with h5py.File(tmp_path / "image.h5") as file:
            sigma0 = np.abs(file["image/VV"][()]) ** 2 / file["calibration/cell_area"][()]
        np.testing.assert_allclose(sigma0, image.sigma0("VV"), rtol=1e-5)  # tol: float32


def test_files_hold_positions_of_the_scenes_file(tmp_path: Path) -> None:
    offset = np.array([456789.0, 5600123.0, 512.0])
    image, raw = make_image(), make_raw()
    here = dataclasses.replace(image, grid=dataclasses.replace(image.grid, offset=offset))
    write_image(here, tmp_path / "image.h5")
    read = read_image(tmp_path / "image.h5")
    expected = image.grid.positions() + offset
    np.testing.assert_allclose(read.grid.positions(), expected, rtol=0, atol=1e-8)  # tol: float64
    with h5py.File(tmp_path / "image.h5") as file:  # the formula of docs/files.md
        grid = {name: file[f"grid/{name}"][()] for name in file["grid"]}
    plane = np.array([*grid["origin"][:2], grid["height"]])
    own = plane + grid["azimuth"][2] * grid["along"] + grid["range"][3] * grid["across"]
    np.testing.assert_allclose(own, expected[2, 3], rtol=0, atol=1e-8)  # tol: float64
    request = ImageRequest(center_x=1.5, center_y=-2.0, height=0.25, offset=tuple(offset))
    radar = dataclasses.replace(raw.radar, offset=offset)
    write_raw(dataclasses.replace(raw, radar=radar, request=request), tmp_path / "raw.h5")
    back = read_raw(tmp_path / "raw.h5")
    np.testing.assert_array_equal(back.radar.track.position, raw.radar.track.position + offset)
    np.testing.assert_array_equal(back.radar.aim_point, raw.radar.aim_point + offset)
    assert not back.radar.offset.any()
    assert back.request == ImageRequest(center_x=456790.5, center_y=5600121.0, height=512.25)


def test_long_data_is_chunked_by_pulses(tmp_path: Path) -> None:
    raw = make_raw(n_pulses=3000, n_fast=200)
    write_raw(raw, tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5") as file:
        pulses, samples = file["echoes/VV"].chunks
    assert samples == 200
    assert 1 < pulses < 3000


def read_exr(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Channels and header of an OpenEXR file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}, dict(file.header())


def test_exr_and_hdf5_agree(tmp_path: Path) -> None:
    offset = np.array([456789.0, 5600123.0, 512.0])
    image = with_subsets(make_image())
    image = dataclasses.replace(image, grid=dataclasses.replace(image.grid, offset=offset))
    write_image(image, tmp_path / "image.exr")
    write_image(image, tmp_path / "image.h5")
    channels, header = read_exr(tmp_path / "image.exr")
    with h5py.File(tmp_path / "image.h5") as file:
        planes = {c: file[f"image/{c}"][()] for c in file["image"]}
        planes |= {f"{c}.order{k}": file[f"orders/{c}/{k}"][()] for c in file["orders"] for k in (1, 3)}
        grid = {name: file[f"grid/{name}"][()] for name in file["grid"]}
    assert set(channels) == {f"{name}.{part}" for name in planes for part in ("re", "im")}
    for name, plane in planes.items():
        both = channels[f"{name}.re"] + 1j * channels[f"{name}.im"]
        np.testing.assert_array_equal(both[::-1], plane)
    n_azimuth = grid["azimuth"].size
    first, step = header["row_azimuth_m"]
    # tol: float64
    np.testing.assert_allclose(first + step * np.arange(n_azimuth), grid["azimuth"][::-1], atol=1e-12)
    first, step = header["column_range_m"]
    np.testing.assert_allclose(first + step * np.arange(grid["range"].size), grid["range"], atol=1e-12)
    for name in ("along", "across"):
        np.testing.assert_array_equal(header[name], grid[name])
    np.testing.assert_array_equal(header["origin_m"], grid["origin"])
    np.testing.assert_array_equal(header["image_plane_origin_m"], [*grid["origin"][:2], grid["height"]])
    assert header["origin_m"][1] > 5.6e6  # in the frame of the file


def test_exr_rows_stand_as_the_picture_shows_them(tmp_path: Path) -> None:
    image = make_image(60, 80)
    data = np.zeros((1, 60, 80), np.complex64)
    data[0, 50:54, 60:66] = 1.0  # late in azimuth, far in range
    data += 1e-3
    image = dataclasses.replace(image, data=data, layers=(Layer("VV"),), metadata={})
    write_image(image, tmp_path / "image.exr")
    channels, _ = read_exr(tmp_path / "image.exr")
    rows, columns = np.nonzero(channels["VV.re"] > 0.5)
    inside_exr = np.array([rows.mean() / 60, columns.mean() / 80])

    figure = quicklook(image)
    save(figure, tmp_path / "quicklook.png")
    picture = imread(tmp_path / "quicklook.png")[..., :3].mean(axis=2)
    height, width = picture.shape
    box = figure.axes[0].get_position()  # from below
    picture = picture[
        round(height * (1 - box.y1)) : round(height * (1 - box.y0)),
        round(width * box.x0) : round(width * box.x1),
    ][4:-4, 4:-4]  # without the frame
    rows, columns = np.nonzero(picture > 0.8)
    inside_png = np.array([rows.mean() / picture.shape[0], columns.mean() / picture.shape[1]])
    assert inside_exr[0] < 0.2 and inside_exr[1] > 0.7  # up and to the right
    np.testing.assert_allclose(inside_exr, inside_png, atol=0.04)  # tol: a pixel, and the frame cut off


def test_parameters_are_standard_json(tmp_path: Path) -> None:
    record = {
        "a": np.float32(1.5),
        "b": float("-inf"),
        "c": (1, 2),
        "d": Path("x/y"),
        "e": np.arange(3),
        "f": 1 + 2j,
    }
    parameter_file.write(tmp_path / "p.json", record)
    assert json.loads((tmp_path / "p.json").read_text(encoding="utf-8"), parse_constant=pytest.fail) == {
        "a": 1.5, "b": "-inf", "c": [1, 2], "d": "x/y", "e": [0, 1, 2], "f": [1.0, 2.0],
    }  # fmt: skip


def test_dataclasses_become_objects() -> None:
    assert to_json(Layer("VV", 1)) == {"channel": "VV", "order": 1, "subset": 0}


def test_atomic_write_keeps_the_old_file_when_interrupted(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_threads_that_write_one_file_leave_a_whole_one(tmp_path: Path) -> None:
    """Each has a file of its own on the way; readers meanwhile find the old or the new one."""
    image, target = make_image(), tmp_path / "image.h5"
    write_image(image, target)

    def work(writes: bool) -> None:
        for _ in range(4):
            if writes:
                write_image(image, target)
            else:
                assert_same(read_image(target), image)

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(work, i != 3) for i in range(4)]:
            done.result()
    assert [path.name for path in tmp_path.iterdir()] == ["image.h5"]


def test_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory") as caught:
        write_raw(make_raw(), tmp_path / "no" / "raw.h5")
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit")
def test_disk_that_refuses_to_grow_leaves_nothing(tmp_path: Path) -> None:
    # a limit on the file's size fails the same calls as a full disk does, in a process of its own
    script = f"""
        import resource, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        from pathlib import Path
        from test_io_files import make_raw, make_image
        from sarmitsuba.core.errors import OutputError
        from sarmitsuba.files import write_image, write_raw
        from sarmitsuba.machine import output as parameter_file
        folder = Path({str(tmp_path)!r})
        raw, image = make_raw(400, 400), make_image(400, 400)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
        for name, write, what in (
            ("p.json", lambda what, path: parameter_file.write(path, what), {{"a": list(range(100_000))}}),
            ("raw.h5", write_raw, raw),
            ("image.h5", write_image, image),
            ("image.exr", write_image, image),
        ):
            try:
                write(what, folder / name)
            except OutputError as error:
                print(name, error)
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["p.json", "raw.h5", "image.h5", "image.exr"]
    assert all("cannot write" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_damaged_and_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "raw.h5"
    with pytest.raises(DataError, match="no such file"):
        read_raw(path)
    path.write_text("not HDF5")
    with pytest.raises(DataError, match="cannot read"):
        read_raw(path)
    write_raw(make_raw(100, 100), path)
    with pytest.raises(DataError, match="holds sarmitsuba raw data, not an image"):
        read_image(path)
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(DataError, match="cannot read"):
        read_raw(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    with pytest.raises(DataError, match="other HDF5 data"):
        read_raw(path)


def test_incomplete_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "raw.h5"
    write_raw(make_raw(), path)
    with h5py.File(path, "a") as file:
        del file["track/time"]
    with pytest.raises(DataError, match="/track/time is missing"):
        read_raw(path)


@pytest.mark.parametrize("n", [10, pytest.param(60, marks=pytest.mark.slow)])
def test_files_cut_short_anywhere_are_refused(tmp_path: Path, n: int) -> None:
    whole, path = tmp_path / "whole.h5", tmp_path / "image.h5"
    write_image(make_image(), whole)
    content = whole.read_bytes()
    for length in np.linspace(0, len(content) - 1, n).astype(int):
        path.write_bytes(content[:length])
        with pytest.raises(DataError, match=r"image\.h5: cannot read an image: .") as caught:
            read_image(path)
        assert "\n" not in str(caught.value)


def hostile(change: Callable[[h5py.File], None], match: str, *, raw: bool = False) -> Any:
    return pytest.param(change, match, raw, id=match)


def replaced(name: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = value

    return change


def claimed(file: h5py.File) -> None:
    del file["image/HV"]
    file.create_dataset("image/HV", (1 << 20, 1 << 20), np.complex64, chunks=(1024, 1024))


@pytest.mark.parametrize(
    ("change", "match", "raw"),
    [
        hostile(replaced("image/HV", h5py.ExternalLink("/etc/passwd", "/x")), "/image/HV is a link"),
        hostile(replaced("grid", h5py.SoftLink("/image")), "/grid is a link"),
        hostile(replaced("layers", ["/image/HV", "/../etc"]), "is no plane"),
        hostile(replaced("layers", ["/image/XX"]), "/image/XX is missing"),
        hostile(replaced("layers", 3), "cannot read"),
        hostile(claimed, "states 8.8e"),
        hostile(replaced("image/HV", np.zeros((6, 9))), "not a plane of complex64"),
        hostile(replaced("image/HV", np.zeros((3, 9), np.complex64)), "several shapes"),
        hostile(replaced("grid/azimuth", np.arange(7.0)), "do not match the grid"),
        hostile(replaced("grid/range", np.full(9, np.nan)), "NaN or infinite"),
        hostile(replaced("grid/origin", np.zeros(2)), "not (3,)"),
        hostile(replaced("calibration/wavelength", "short"), "not a single number"),
        hostile(replaced("metadata", "[1]"), "/metadata is not a JSON object"),
        hostile(replaced("metadata", "{"), "Expecting"),
        hostile(lambda file: file["grid"].attrs.modify("kind", "round"), "kind 'round'"),
        hostile(replaced("track/time", np.zeros(5)), "must increase", raw=True),
        hostile(replaced("radar/pointing/boresight", np.zeros((4, 3))), "not (5, 3)", raw=True),
        hostile(replaced("radar/window/n_samples", 12), "do not match /radar/window", raw=True),
        hostile(replaced("radar/waveform/bandwidth", -1.0), "must be positive", raw=True),
        hostile(replaced("radar/antenna", 1.0), "/radar/antenna is not a group", raw=True),
    ],
)
def test_hostile_files_get_one_line(
    tmp_path: Path, change: Callable[[h5py.File], None], match: str, raw: bool
) -> None:
    path = tmp_path / "file.h5"
    if raw:
        write_raw(make_raw(), path)
    else:
        write_image(make_image(), path)
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(DataError, match=re.escape(match)) as caught:
        read_raw(path) if raw else read_image(path)
    assert str(caught.value).startswith(f"{path}: cannot read") and "\n" not in str(caught.value)


def test_a_file_of_channels_only_is_read(tmp_path: Path) -> None:
    path = tmp_path / "image.h5"
    write_image(make_image(), path)
    with h5py.File(path, "a") as file:
        for name in ("layers", "orders", "subsets", "metadata"):
            del file[name]
    image = read_image(path)
    assert image.layers == (Layer("HV"), Layer("VV"))
    np.testing.assert_array_equal(image.total("VV"), make_image().total("VV"))


def test_newer_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "raw.h5"
    write_raw(make_raw(), path)
    with h5py.File(path, "a") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(DataError, match="update sarmitsuba"):
        read_raw(path)


def test_format_is_found_by_suffix_or_name() -> None:
    assert find_format(Path("a.H5"), "raw").name == "hdf5"
    assert find_format(Path("a.dat"), "raw", "hdf5").name == "hdf5"
    with pytest.raises(DataError, match=r"no image format for the suffix '\.bmp'; there are .*hdf5"):
        find_format(Path("a.bmp"), "image")


def test_a_registered_format_is_found_by_suffix_and_name(tmp_path: Path) -> None:
    def write(path: Path, image: SarImage) -> None:
        np.save(path, image.data)

    before = FORMATS.names
    FORMATS.register(FileFormat("test_npy", "pixels only", (".npy",), write_image=write))
    assert FORMATS.names == (*before, "test_npy")
    image = make_image()
    write_image(image, tmp_path / "a.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), image.data)
    with pytest.raises(DataError, match="test_npy can be written but not read"):
        read_image(tmp_path / "a.npy")
    with pytest.raises(DataError, match=r"no raw format for the suffix '\.npy'"):
        write_raw(make_raw(), tmp_path / "a.npy")


# ---- docs/files.md, and docs/labels.md for labels.h5


def listed(heading: str) -> dict[str, str]:
    """Path and unit of every row of the section's table."""
    section = PAGE.split(f"## `{heading}`")[1].split("\n## ")[0]
    return dict(re.findall(r"^\| `(/[^`]+)` \|[^|]*\|\s*([^|]*?)\s*\|", section, re.MULTILINE))


def general(name: str) -> str:
    """Path with the page's example channel, order and subset."""
    name = re.sub(r"^subsets/\d/", "subsets/1/", name)
    name = re.sub(r"(image|echoes)/(VV|HV)$", r"\1/VV", name)
    return "/" + re.sub(r"orders/(VV|HV)/\d$", "orders/VV/2", name)


def held(path: Path) -> dict[str, str]:
    """Path and unit of every dataset of a file."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: (
                found.update({general(name): str(item.attrs.get("unit", ""))})
                if isinstance(item, h5py.Dataset)
                else None
            )
        )
    return found


def test_the_page_lists_every_dataset(tmp_path: Path) -> None:
    image, raw = make_image(), dataclasses.replace(make_raw(), request=ImageRequest())
    plain = dataclasses.replace(
        image, layers=tuple(dataclasses.replace(e, order=0) for e in image.layers[:2])
    )
    plain = dataclasses.replace(plain, data=image.data[:2])
    write_image(plain, tmp_path / "plain.h5")
    write_image(with_subsets(image), tmp_path / "image.h5")
    assert held(tmp_path / "plain.h5") | held(tmp_path / "image.h5") == listed("image.h5")
    few = dataclasses.replace(raw, layers=plain.layers, data=raw.data[:2])
    write_raw(few, tmp_path / "few.h5")
    write_raw(with_subsets(raw), tmp_path / "raw.h5")
    assert held(tmp_path / "few.h5") | held(tmp_path / "raw.h5") == listed("raw.h5")


def test_the_page_lists_every_dataset_of_labels(tmp_path: Path) -> None:
    scene = shipped("plate")
    grid = default_grid(scene.radar, {"pixels_azimuth": 5, "pixels_range": 4})
    sarmitsuba.labels(scene, grid, classes={scene.geometry.mesh_names[0]: "metal"}).save(
        tmp_path / "labels.h5"
    )
    found = {
        re.sub(r"^/codes/\w+/", "/codes/LAYER/", name): unit
        for name, unit in held(tmp_path / "labels.h5").items()
    }
    shared = {
        name: unit for name, unit in listed("image.h5").items() if name.startswith(("/grid/", "/anchor/"))
    }
    assert found == listed("labels.h5") | shared


def test_the_page_lists_the_header_of_exr(tmp_path: Path) -> None:
    write_image(make_image(), tmp_path / "image.exr")
    _, header = read_exr(tmp_path / "image.exr")
    section = PAGE.split("## `image.exr`")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.*?`) \|", section, re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    own = {
        "channels", "compression", "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio",
        "screenWindowCenter", "screenWindowWidth", "type",
    }  # fmt: skip
    assert names == set(header) - own


@pytest.mark.filterwarnings("error")
def test_a_file_that_cannot_be_opened_is_closed_without_a_word(tmp_path: Path) -> None:
    from sarmitsuba.machine.guarded import GuardedFile

    with pytest.raises(OSError):
        GuardedFile(tmp_path / "no folder" / "file.h5")
    gone = GuardedFile.__new__(GuardedFile)
    with pytest.raises(OSError):
        gone.__init__(tmp_path / "no folder" / "file.h5")  # type: ignore[misc]
    gone.close()
    assert gone.closed


@pytest.mark.parametrize("suffix", ["json", "toml"])
def test_whole_numbers_beyond_64_bits_are_floats(suffix: str, tmp_path: Path) -> None:
    """Neither np.isfinite nor a format of numbers takes a larger integer, nor float() one of 400 digits."""
    given = {"most": 2**64 - 1, "least": -(2**63), "more": 2**64, "less": -(2**63) - 1, "long": 10**400}
    path = tmp_path / f"table.{suffix}"
    text = "".join(f"{name} = {value}\n" for name, value in given.items())
    path.write_text(json.dumps(given) if suffix == "json" else text, encoding="utf-8")
    table = read_table(path, "a table", 10_000)
    assert (table["most"], table["least"]) == (2**64 - 1, -(2**63))
    assert (table["more"], table["less"], table["long"]) == (2.0**64, -(2.0**63), np.inf)
    assert all(type(table[name]) is float for name in ("more", "less", "long"))


def test_readers_wait_for_the_back_end_without_hdf5s_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread that holds the back end may read files itself (`focus(path)`): the other order is a deadlock."""
    from h5py._objects import phil

    write_image(make_image(), tmp_path / "image.h5")
    waiting = threading.Event()
    locked = hdf5_file.backend_lock

    def backend_lock() -> object:
        waiting.set()
        return locked()

    monkeypatch.setattr(hdf5_file, "backend_lock", backend_lock)
    with locked():
        reader = threading.Thread(target=read_image, args=(tmp_path / "image.h5",))
        reader.start()
        assert waiting.wait(60.0)
        assert phil.acquire(False)
        phil.release()
    reader.join()
