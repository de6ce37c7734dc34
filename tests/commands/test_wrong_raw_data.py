"""Raw data that are not whole, or do not fit: `focus` says so in one line and leaves no results."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.files import write_raw
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar

# every dataset with one row per pulse
PER_PULSE = (
    "track/time",
    "track/position",
    "track/velocity",
    "radar/pointing/boresight",
    "radar/pointing/azimuth_axis",
    "radar/pointing/elevation_axis",
    "radar/window/start_range",
)


@pytest.fixture
def raw_file(tmp_path: Path) -> Path:
    radar = ideal_radar(resolution=3.0, n_samples=64)
    write_raw(ideal_echoes(radar, np.zeros(3)), tmp_path / "raw.h5")
    return tmp_path / "raw.h5"


def refused(path: Path, capsys: pytest.CaptureFixture[str], *more: str) -> str:
    out = path.parent / "out"
    assert cli.main(["focus", str(path), "-o", str(out), *more]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert not out.exists()
    return lines[0]


def rewrite(path: Path, name: str, change: Callable[[Any], Any]) -> None:
    with h5py.File(path, "a") as file:
        value = file[name][()]
        del file[name]
        file[name] = change(value)


def datasets(path: Path) -> list[str]:
    found: list[str] = []
    with h5py.File(path, "r") as file:
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    return found


def test_a_whole_file_is_focused(raw_file: Path, tmp_path: Path) -> None:
    assert cli.main(["focus", str(raw_file), "-o", str(tmp_path / "out")]) == 0


def test_every_missing_field_is_named(raw_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = datasets(raw_file)
    assert set(PER_PULSE) < set(names) and "echoes/VV" in names
    for name in names:
        if name in ("layers", "metadata"):  # can be done without
            continue
        with h5py.File(raw_file, "a") as file:
            file.move(name, "away")
        assert f"/{name} is missing" in refused(raw_file, capsys)
        with h5py.File(raw_file, "a") as file:
            file.move("away", name)


@pytest.mark.parametrize("name", PER_PULSE)
def test_lengths_that_differ(raw_file: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    rewrite(raw_file, name, lambda value: value[:-2])
    line = refused(raw_file, capsys)
    assert str(raw_file) in line and ("shape" in line or "must be (n,)" in line)


def test_fewer_echoes_than_pulses(raw_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite(raw_file, "echoes/VV", lambda value: value[:-3])
    assert "pulses in the data" in refused(raw_file, capsys)


@pytest.mark.parametrize("name", [*PER_PULSE, "echoes/VV"])
def test_nan(raw_file: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    def change(value: Any) -> Any:
        value[7] = np.nan
        return value

    rewrite(raw_file, name, change)
    line = refused(raw_file, capsys)
    assert (
        "holds NaN or infinite numbers" in line
        or "hold NaN or infinite numbers, the first is pulse 7" in line
    )


@pytest.mark.parametrize("seed", range(3))
def test_pulses_in_any_order(raw_file: Path, capsys: pytest.CaptureFixture[str], seed: int) -> None:
    with h5py.File(raw_file, "r") as file:
        order = np.random.default_rng(seed).permutation(len(file["track/time"]))
    for name in (*PER_PULSE, "echoes/VV"):
        rewrite(raw_file, name, lambda value: value[order])
    assert "pulse times must increase strictly; sort the pulses by time" in refused(raw_file, capsys)


def test_a_file_cut_anywhere(raw_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = raw_file.read_bytes()
    for length in np.random.default_rng(4).integers(0, len(whole), 8):
        raw_file.write_bytes(whole[:length])
        assert "cannot read raw data" in refused(raw_file, capsys)


def test_a_grid_beside_the_data(raw_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(raw_file, capsys, "--center", "3000", "0", "--extent", "20")
    assert "were not recorded" in line and "move the image's centre" in line
    # behind the radar, and beside the data in azimuth
    assert "behind the radar" in refused(raw_file, capsys, "--center", "-20000", "0", "--extent", "20")
    assert "were not recorded" in refused(raw_file, capsys, "--center", "0", "9000", "--extent", "20")
