"""Bistatic phase histories: backprojection against the direct sum over frequency and pulse, at any two tracks."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from sarmitsuba import cli
from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.files import read_raw
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.focuser import FOCUSERS
from sarmitsuba.signal.focusing.focusers.backprojection import backproject, backproject_numpy
from tests.support.draws import few_of
from tests.support.unweighted import focus

LIGHT = 299792458.0
F64 = np.ndarray[Any, np.dtype[np.float64]]


def flight(rng: np.random.Generator, n: int, still: bool = False) -> F64:
    """A bent, climbing flight at any heading and distance, or an antenna that stands still."""
    heading, aside = rng.uniform(0.0, 2.0 * np.pi, 2)
    along = np.array([np.cos(heading), np.sin(heading), rng.uniform(-0.03, 0.03)])
    middle = np.array([np.cos(aside), np.sin(aside), rng.uniform(0.4, 1.0)]) * rng.uniform(3e3, 9e3)
    if still:
        return np.tile(middle, (n, 1))
    s = np.linspace(-1.0, 1.0, n)[:, None]
    bend = rng.normal(size=3) * [3.0, 3.0, 1.0]
    return middle + rng.uniform(120.0, 300.0) * s * along + bend * np.sin(3.0 * s)


def history(seed: int) -> tuple[dict[str, Any], F64, F64, F64]:
    """Fields of a file, points, the two tracks; the second antenna by turns the transmitter and the receiver."""
    rng = np.random.default_rng(seed)
    n = 150
    first, second = flight(rng, n), flight(rng, n, still=seed % 3 == 2)
    f = 9.6e9 + 1.5e6 * (np.arange(200) - 99.5)
    points = rng.uniform(-15.0, 15.0, (3, 3)) * [1.0, 1.0, 0.0]
    r0 = half_way(np.zeros(3), first, second) + rng.uniform(-0.9, 0.9, n)
    fp = sum(np.exp(-4j * np.pi / LIGHT * np.outer(f, half_way(p, first, second) - r0)) for p in points)
    names = ("xt", "yt", "zt") if seed % 2 else ("xr", "yr", "zr")
    fields: dict[str, Any] = {"fp": np.asarray(fp).astype(np.complex64), "freq": f, "r0": r0}
    fields |= dict(zip(("x", "y", "z"), first.T, strict=True)) | dict(zip(names, second.T, strict=True))
    return fields, points, first, second


def half_way(point: F64, first: F64, second: F64) -> F64:
    return np.asarray(0.5 * (np.linalg.norm(point - first, axis=1) + np.linalg.norm(point - second, axis=1)))


def save(path: Path, fields: dict[str, Any]) -> Path:
    scipy.io.savemat(path, {"data": fields})
    return path


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3, 4, 5))])
def test_the_sum_over_frequency_and_pulse(tmp_path: Path, seed: int) -> None:
    fields, points, first, second = history(seed)
    raw = read_raw(save(tmp_path / "a.mat", fields))
    assert raw.radar.receiver is not None
    rng = np.random.default_rng(seed)
    where = points[rng.integers(0, 3, 60)] + rng.uniform(-2.0, 2.0, (60, 3)) * [1.0, 1.0, 0.0]
    origin = np.prod([np.linalg.norm(at, axis=1) for at in (first, second)], axis=0)
    exact = np.zeros(60, complex)
    for i, p in enumerate(where):
        ways = [np.linalg.norm(p - at, axis=1) for at in (first, second)]
        turn = np.exp(4j * np.pi / LIGHT * np.outer(fields["freq"], 0.5 * (ways[0] + ways[1]) - fields["r0"]))
        exact[i] = np.sum(fields["fp"] * turn * (ways[0] * ways[1] / origin)) / turn.size
    for found in (
        backproject(raw, where, interpolation="kernel:8")[0],
        backproject_numpy(raw, where)[0],
    ):
        # tol: of a point's peak; profiles end with the swath, where the points' side lobes are cut: 1 / (pi n), n = 58
        # cells away, -45 dB, and less where the pulses cut them differently
        assert np.sqrt(np.mean(np.abs(found - exact) ** 2)) < 10 ** (-50 / 20)


@pytest.mark.filterwarnings("ignore:focus. the rows")  # two tracks whose turns cancel at some pixels
@pytest.mark.parametrize("seed", few_of(range(3)))
def test_an_image_on_the_grid_and_back_from_hdf5(tmp_path: Path, seed: int) -> None:
    """The image is the list of points, whatever its lines; a file of ours keeps the second track."""
    raw = read_raw(save(tmp_path / "a.mat", history(seed)[0]))
    request = {"extent_azimuth": 12.0, "extent_range": 12.0}
    image = focus(raw, request=request)
    listed = backproject(raw, image.grid.positions().reshape(-1, 3)).reshape(image.data.shape)
    # tol: the same arithmetic in another order
    assert np.linalg.norm(image.data - listed) < 1e-4 * np.linalg.norm(listed)
    raw.save(tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5")
    assert again.radar.receiver is not None and raw.radar.receiver is not None
    np.testing.assert_array_equal(again.radar.receiver.position, raw.radar.receiver.position)
    np.testing.assert_array_equal(focus(again, request=request).data, image.data)


def test_points_are_where_they_are(tmp_path: Path) -> None:
    """Both antennas on one side, one behind the other, so that the grid is that of one aperture."""
    rng = np.random.default_rng(5)
    s = np.linspace(-150.0, 150.0, 150)[:, None]
    first = np.array([-5e3, 0.0, 4e3]) + s * [0.0, 1.0, 0.0]
    second = np.array([-6e3, 900.0, 5e3]) + s * [0.1, 1.0, 0.0]
    f = 9.6e9 + 1.5e6 * (np.arange(200) - 99.5)
    r0 = half_way(np.zeros(3), first, second)
    point = rng.uniform(-10.0, 10.0, 3) * [1.0, 1.0, 0.0]
    fp = 2.0 * np.exp(-4j * np.pi / LIGHT * np.outer(f, half_way(point, first, second) - r0) + 0.7j)
    fields = {"fp": fp.astype(np.complex64), "freq": f, "r0": r0}
    fields |= dict(zip(("x", "y", "z", "xr", "yr", "zr"), [*first.T, *second.T], strict=True))
    raw = read_raw(save(tmp_path / "a.mat", fields))
    image = focus(raw, request={"extent_azimuth": 60.0, "extent_range": 60.0})
    (found,) = image_quality(image, [KnownPoint(tuple(point.tolist()), "p", 4.0, 0.7)], []).points
    # tol: a twentieth of a cell
    assert abs(found.azimuth_error) < 0.05 * image.azimuth_resolution_cell
    assert abs(found.range_error) < 0.05 * image.range_resolution_cell
    # tol: the peak is found between pixels with the carrier of one antenna's line of sight
    assert abs(np.degrees(found.phase_error)) < 5.0 and abs(found.rcs_error_db) < 0.1
    pixel = backproject(raw, point[None])[0, 0]
    # tol: side lobes cut by the swath's ends, -45 dB
    assert abs(pixel - 2.0 * np.exp(0.7j)) < 0.01 * 2.0


def test_what_does_not_take_two_antennas_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save(tmp_path / "a.mat", history(0)[0])
    raw = read_raw(path)
    small = {"extent_azimuth": 5.0, "extent_range": 5.0}
    others = [focuser.name for focuser in FOCUSERS if not focuser.bistatic]
    assert {"omega_k", "range_doppler", "chirp_scaling", "polar_format"} <= set(others)
    for name in others:
        with pytest.raises(
            DataError, match=f"focuser {name}: the data are bistatic .*; take focuser .*backproj"
        ):
            focus(raw, request=small, focuser=name)
    for name in ("auto", "auto,error=-50"):
        assert focus(raw, request=small, focuser=name).metadata["focus"]["method"] == "backprojection"
    with pytest.raises(DataError, match="autofocus: not possible with bistatic data"):
        focus(raw, request=small, autofocus="phase_gradient")
    horn = replace(raw, radar=replace(raw.radar, antenna=Antenna("gaussian", 100.0, 0.1, 0.1)))
    with pytest.raises(DataError, match="give an isotropic antenna"):
        focus(horn, request=small)
    with pytest.raises(RadarError, match="149 positions of the receiver and 150 of the transmitter"):
        replace(raw.radar, receiver=Track.straight([0, 0, 1e3], [0, 10, 0], 10.0, 149))
    assert cli.main(["focus", str(path), "--focuser", "omega_k", "-o", str(tmp_path / "out")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("yr"), "xr, zr: beside x, y, z one more antenna is supported"),
        (
            lambda d: d.update(xt=d["x"], yt=d["y"], zt=d["z"]),
            "xt, yt, zt, xr, yr, zr: beside x, y, z one more",
        ),
        (lambda d: d.update(xr=d["xr"][:-2]), "xr has 148 values, fp has 150 pulses"),
        (lambda d: d["xr"].__setitem__(7, np.nan), "1 of 150 pulses hold NaN .* pulse 7"),
    ],
)
def test_wrong_second_antennas_are_one_line(tmp_path: Path, change: Any, message: str) -> None:
    fields = history(0)[0]
    change(fields)
    with pytest.raises(DataError, match=message):
        read_raw(save(tmp_path / "a.mat", fields))
