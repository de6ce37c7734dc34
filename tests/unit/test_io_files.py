"""Files come back exactly as they were written, and never half written."""

import dataclasses
import json
import subprocess
import sys
import textwrap
from pathlib import Path

import h5py
import numpy as np
import OpenEXR
import pytest

from sarmitsuba.echo.raw import Layer, RawData
from sarmitsuba.errors import DataError, OutputError
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.io import parameters, read_image, read_raw, write_image, write_raw
from sarmitsuba.io.atomic import atomic_path
from sarmitsuba.io.encoding import to_json
from sarmitsuba.io.formats import FORMATS, FileFormat, find_format
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform

LAYERS = (Layer("VV", 1, 1), Layer("VV", 1, 2), Layer("VV", 2), Layer("HV"))
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


def test_hdf5_is_self_describing(tmp_path: Path) -> None:
    write_raw(make_raw(), tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5") as file:
        assert file["data"].attrs["axes"] == "layer, pulse, fast sample"
        assert file["data"].dtype.kind == "c"
        assert file["radar/track/position"].attrs["unit"] == "m"
        assert file["radar/waveform/center_frequency"][()] == 9.65e9
        assert "exp(-j 4 pi" in file.attrs["phase_convention"]
        # a range of pulses is read without the rest
        assert file["data"].chunks is not None
        missing = []
        file.visititems(
            lambda name, item: (
                missing.append(name)
                if isinstance(item, h5py.Dataset) and item.dtype.kind == "f" and "unit" not in item.attrs
                else None
            )
        )
    assert missing == []


def test_long_data_is_chunked_by_pulses(tmp_path: Path) -> None:
    raw = make_raw(n_pulses=3000, n_fast=200)
    write_raw(raw, tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5") as file:
        layers, pulses, samples = file["data"].chunks
    assert (layers, samples) == (1, 200)
    assert 1 < pulses < 3000


def test_exr_has_named_channels(tmp_path: Path) -> None:
    image = make_image()
    write_image(image, tmp_path / "image.exr")
    with OpenEXR.File(str(tmp_path / "image.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        facts = json.loads(file.header()["sarmitsuba"])
    assert set(channels) == {
        "VV.re", "VV.im", "VV.order1.re", "VV.order1.im", "VV.order2.re", "VV.order2.im", "HV.re", "HV.im",
    }  # fmt: skip
    assert np.array_equal(channels["VV.order1.re"], (image.data[0] + image.data[1]).real)
    assert np.array_equal(channels["VV.order2.re"], image.data[2].real)
    assert np.array_equal(channels["VV.im"], image.data[:3].sum(axis=0).imag)
    assert np.array_equal(channels["HV.im"], image.data[3].imag)
    assert facts["range_spacing_m"] == pytest.approx(0.7)  # tol: float rounding of a difference


def test_parameters_are_standard_json(tmp_path: Path) -> None:
    facts = {
        "a": np.float32(1.5),
        "b": float("-inf"),
        "c": (1, 2),
        "d": Path("x/y"),
        "e": np.arange(3),
        "f": 1 + 2j,
    }
    parameters.write(tmp_path / "p.json", facts)
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


def test_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory") as caught:
        write_raw(make_raw(), tmp_path / "no" / "raw.h5")
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit")
@pytest.mark.parametrize("name", ["raw.h5", "image.h5", "image.exr", "p.json"])
def test_disk_that_refuses_to_grow_leaves_nothing(tmp_path: Path, name: str) -> None:
    # a limit on the file's size fails the same calls as a full disk does, in a process of its own
    script = f"""
        import resource, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        from pathlib import Path
        from test_io_files import make_raw, make_image
        from sarmitsuba.errors import OutputError
        from sarmitsuba.io import parameters, write_image, write_raw
        path = Path({str(tmp_path)!r}) / {name!r}
        raw, image = make_raw(400, 400), make_image(400, 400)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
        try:
            if path.name == "p.json":
                parameters.write(path, {{"a": list(range(100_000))}})
            elif path.name == "raw.h5":
                write_raw(raw, path)
            else:
                write_image(image, path)
        except OutputError as error:
            print(error)
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("\n") == 1 and "cannot write" in run.stdout
    assert list(tmp_path.iterdir()) == []


def test_damaged_and_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "raw.h5"
    with pytest.raises(DataError, match="no such file"):
        read_raw(path)
    path.write_text("not HDF5")
    with pytest.raises(DataError, match="cannot read"):
        read_raw(path)
    write_raw(make_raw(100, 100), path)
    with pytest.raises(DataError, match="holds RawData, not an image"):
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
        del file["radar/track/time"]
    with pytest.raises(DataError, match="time"):
        read_raw(path)


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
    with pytest.raises(DataError, match=r"no image format for the suffix '\.tif'; there are hdf5"):
        find_format(Path("a.tif"), "image")


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
