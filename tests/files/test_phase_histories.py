"""Phase histories from elsewhere: MATLAB files of exact point echoes focus where the points are, or are refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from sarmitsuba import cli
from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import read_raw
from sarmitsuba.signal.focusing.focusers.backprojection import backproject_numpy
from tests.support.draws import few_of
from tests.support.unweighted import focus

LIGHT = 299792458.0
Fields = dict[str, Any]


def circle(rng: np.random.Generator, n: int = 160, degrees: float = 4.0) -> np.ndarray:
    """Part of a circle about the origin, with the roughness of a real flight."""
    start = rng.uniform(0.0, 2.0 * np.pi)
    angle = start + np.radians(degrees) * np.arange(n) / n * rng.choice([-1.0, 1.0])
    radius, height = rng.uniform(5e3, 9e3), rng.uniform(4e3, 8e3)
    place = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, height)], axis=1)
    return (
        place + 0.3 * np.sin(np.linspace(0, 5, n))[:, None] * rng.normal(size=3) + rng.normal(0, 1e-3, (n, 3))
    )


def line(rng: np.random.Generator, n: int = 160) -> np.ndarray:
    """A straight climbing flight at any heading, squinted a little."""
    heading = rng.uniform(0.0, 2.0 * np.pi)
    along = np.array([np.cos(heading), np.sin(heading), 0.02])
    right = np.array([along[1], -along[0], 0.0]) * rng.choice([-1.0, 1.0])
    center = -rng.uniform(5e3, 9e3) * right + np.array([0.0, 0.0, rng.uniform(3e3, 6e3)])
    center += rng.uniform(-500.0, 500.0) * along
    return center + np.linspace(-200.0, 200.0, n)[:, None] * along


def echoes(place: np.ndarray, r0: np.ndarray, f: np.ndarray, points: np.ndarray, a: np.ndarray) -> np.ndarray:
    """fp[k, n] = sum a exp(-j 4 pi f_k (R_n - r0_n) / c); f is (k,) or (k, n)."""
    f = f if f.ndim == 2 else f[:, None]
    out = np.zeros((f.shape[0], len(place)), complex)
    for point, value in zip(points, a, strict=True):
        out += value * np.exp(-4j * np.pi * f * (np.linalg.norm(place - point, axis=1) - r0) / LIGHT)
    return out


def fields(place: np.ndarray, r0: np.ndarray, f: np.ndarray, points: np.ndarray, a: np.ndarray) -> Fields:
    return {
        "fp": echoes(place, r0, f, points, a).astype(np.complex64),
        "freq": f[:, None] if f.ndim == 1 else f,
        "x": place[None, :, 0],
        "y": place[None, :, 1],
        "z": place[None, :, 2],
        "r0": r0[None],
        "th": np.degrees(np.arctan2(place[:, 1], place[:, 0]))[None],
        "phi": np.degrees(np.arcsin(place[:, 2] / np.linalg.norm(place, axis=1)))[None],
    }


def save(path: Path, content: Fields) -> Path:
    scipy.io.savemat(path, {"data": content})
    return path


def scenario(seed: int) -> tuple[Fields, np.ndarray, np.ndarray, np.ndarray]:
    """Fields of a file, positions of three points, their amplitudes and the antenna's positions."""
    rng = np.random.default_rng(seed)
    place = circle(rng) if seed % 2 else line(rng)
    f = rng.choice([5.4e9, 9.6e9]) + rng.uniform(1.2e6, 1.6e6) * (np.arange(300) - 149.5)
    points = np.array([[0.0, 0.0, 0.0], [18.0, -14.0, 0.0], [-15.0, 20.0, 0.0]])
    points[:, :2] += rng.uniform(-3.0, 3.0, (3, 2))
    a = rng.uniform(0.5, 2.0, 3) * np.exp(1j * rng.uniform(-3.0, 3.0, 3))
    # motion compensation to the origin, and off it by more than a range cell, pulse by pulse
    r0 = np.linalg.norm(place, axis=1) + rng.uniform(-3.0, 3.0) + rng.uniform(-0.9, 0.9, len(place))
    return fields(place, r0, f, points, a), points, a, place


@pytest.mark.parametrize("seed", few_of(range(6), 2))
def test_points_land_in_place_with_their_phase(tmp_path: Path, seed: int) -> None:
    """Circular and straight flights, any heading and side, ranges r0 that jump from pulse to pulse."""
    content, points, a, _ = scenario(seed)
    raw = read_raw(save(tmp_path / "data_3dsar_pass1_az001_HV.mat", content))
    assert raw.channels == ("HV",)
    image = focus(raw, request={"extent_azimuth": 70.0, "extent_range": 70.0})
    known = [
        KnownPoint(tuple(p.tolist()), f"p{i}", float(abs(v)) ** 2, float(np.angle(v)))
        for i, (p, v) in enumerate(zip(points, a, strict=True))
    ]
    report = image_quality(image, known, [])
    assert len(report.points) == 3
    for point in report.points:
        # tol: 0.1 of a cell, the task's bound
        assert abs(point.azimuth_error) < 0.1 * image.azimuth_resolution_cell
        assert abs(point.range_error) < 0.1 * image.range_resolution_cell
        # tol: side lobes of the other points, -40 dB
        assert abs(np.degrees(point.phase_error)) < 3.0
        # tol: the same, and R^2 against r0^2, 0.1 dB at 40 m of 7 km
        assert abs(point.rcs_error_db) < 0.3


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3))])
def test_profiles_are_the_sum_over_frequencies_at_every_range(tmp_path: Path, seed: int) -> None:
    """Against the direct sum over frequency and pulse at each pixel, nothing interpolated."""
    content, points, _, place = scenario(seed)
    raw = read_raw(save(tmp_path / "a.mat", content))
    rng = np.random.default_rng(seed)
    where = points[rng.integers(0, 3, 40)] + np.column_stack([rng.uniform(-2, 2, (40, 2)), np.zeros(40)])
    r = np.linalg.norm(where[:, None] - place, axis=2)
    r0 = content["r0"][0]
    exact = np.zeros(len(where), complex)
    for k, f in enumerate(content["freq"][:, 0]):
        turn = np.exp(4j * np.pi * f * (r - r0) / LIGHT)
        exact += np.sum(content["fp"][k] * (r / r0) ** 2 * turn, axis=1)
    exact /= content["fp"].size
    found = backproject_numpy(raw, where)[0]
    # tol: profiles end with the swath, where each point's side lobes are cut: 1 / (pi n) of a point n cells away
    assert np.linalg.norm(found - exact) < 10 ** (-45 / 20) * np.linalg.norm(exact)


def test_pulses_with_frequencies_of_their_own(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    place = circle(rng)
    start = 9.5e9 + rng.uniform(-2e6, 2e6, len(place))
    f = start + 1.4e6 * np.arange(300)[:, None]
    r0 = np.linalg.norm(place, axis=1)
    points = np.array([[9.0, -7.0, 0.0]])
    raw = read_raw(save(tmp_path / "a.mat", fields(place, r0, f, points, np.array([1.0 + 0.0j]))))
    image = focus(raw, request={"extent_azimuth": 40.0, "extent_range": 40.0})
    (point,) = image_quality(image, [KnownPoint((9.0, -7.0, 0.0), "p", 1.0, 0.0)], []).points
    assert abs(point.range_error) < 0.02 * image.range_resolution_cell  # tol: 4 MHz of 420 differ
    assert abs(np.degrees(point.phase_error)) < 2.0  # tol: the same
    assert abs(point.rcs_error_db) < 0.2  # tol: the same, and R^2 against r0^2


def folder_of_degrees(folder: Path, content: Fields) -> None:
    """A file per degree, by number and not by letter; two polarisations side by side."""
    folder.mkdir()
    for channel, factor in (("HH", 1.0), ("VV", 0.5)):
        for i, part in enumerate(np.array_split(np.arange(160), 4)):
            cut = {
                key: value if key == "freq" else factor ** (key == "fp") * value[:, part]
                for key, value in content.items()
            }
            save(folder / f"data_az{8 + i}_{channel}.mat", cut)
    (folder / "readme.txt").write_text("not data")


def test_folder_of_files_is_read_as_one(tmp_path: Path) -> None:
    content = scenario(1)[0]
    folder_of_degrees(tmp_path / "pass1", content)
    raw = read_raw(tmp_path / "pass1")
    whole = read_raw(save(tmp_path / "whole_HH.mat", content))
    assert raw.channels == ("HH", "VV")
    np.testing.assert_array_equal(raw.data[0], whole.data[0])
    np.testing.assert_array_equal(raw.radar.track.position, whole.radar.track.position)


@pytest.mark.slow
def test_folder_of_files_focuses_as_one_without_a_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, points, a, _ = scenario(1)
    folder = tmp_path / "pass1"
    folder_of_degrees(folder, content)
    out = tmp_path / "out"
    command = ["focus", str(folder), "--extent", "30", "--spacing", "0.2", "-o", str(out)]
    center = ["--center", *(str(v) for v in points[1, :2])]
    assert cli.main([*command, *center]) == 0
    assert cli.main(["quality", str(out), "--point", *(str(v) for v in points[1])]) == 0
    (point,) = json.loads((out / "quality.json").read_text())["points"]
    assert abs(point["azimuth_error_m"]) < 0.03 and abs(point["range_error_m"]) < 0.05  # tol: 0.1 cell
    assert point["rcs_m2"] == pytest.approx(
        abs(a[1]) ** 2, rel=0.05
    )  # tol: taylor side lobes, R^2 against r0^2
    capsys.readouterr()
    # other data would replace these results
    (folder / "data_az8_HH.mat").rename(folder / "data_az12_HH.mat")
    assert cli.main(command) == 2


def without(name: str) -> Callable[[Fields], None]:
    return lambda content: content.pop(name)


def with_nan(name: str, pulse: int) -> Callable[[Fields], None]:
    def change(content: Fields) -> None:
        content[name][..., pulse] = np.nan

    return change


def shuffled(content: Fields) -> None:
    order = np.random.default_rng(2).permutation(content["fp"].shape[1])
    for name in content.keys() - {"freq"}:
        content[name] = content[name][:, order]


def swapped(content: Fields) -> None:
    order = np.arange(content["fp"].shape[1])
    order[[40, 41]] = order[[41, 40]]
    for name in content.keys() - {"freq"}:
        content[name] = content[name][:, order]


def shorter(name: str) -> Callable[[Fields], None]:
    return lambda content: content.update({name: content[name][:, :-3]})


def changed(name: str, value: Callable[[Any], Any]) -> Callable[[Fields], None]:
    return lambda content: content.update({name: value(content[name])})


def bent(f: np.ndarray) -> np.ndarray:
    f = f.copy()
    f[100] += 3e5
    return f


def doubled(content: Fields) -> None:
    for name in "xyz":
        content[name][:, 31] = content[name][:, 30]


BAD: dict[str, tuple[Callable[[Fields], object], str]] = {
    **{f"no {name}": (without(name), f"data has no {name}; it has") for name in ("fp", "freq", "x", "r0")},
    "short x": (shorter("x"), "x has 157 values, fp has 160 pulses"),
    "short th": (shorter("th"), "th has 157 values, fp has 160 pulses"),
    "short r0": (shorter("r0"), "r0 has 157 values, fp has 160 pulses"),
    "short freq": (changed("freq", lambda f: f[:-2]), "freq has the shape .298,., fp holds 300 frequencies"),
    "transposed": (changed("fp", lambda fp: fp.T), "x has 160 values, fp has 300 pulses"),
    "nan in fp": (with_nan("fp", 12), "1 of 160 pulses hold NaN .* pulse 12"),
    "nan in x": (with_nan("x", 5), "1 of 160 pulses hold NaN .* pulse 5"),
    "nan in r0": (with_nan("r0", 0), "1 of 160 pulses hold NaN .* pulse 0"),
    "random order": (shuffled, "reverses at .* sort the pulses in the order of flight"),
    "two swapped": (swapped, "reverses at .* first at pulse"),
    "two at one place": (doubled, "pulses 30 and 31 have the same position"),
    "uneven": (changed("freq", bent), "off uniform steps of .* by 3e.05 Hz"),
    "downwards": (changed("freq", lambda f: f[::-1]), "freq must increase"),
    "real": (changed("fp", np.abs), "not complex frequency x pulse"),
    "text": (changed("freq", lambda _: "9.6 GHz"), "freq holds .*, not numbers"),
    "negative r0": (changed("r0", lambda r: -r), "r0 must be above 0"),
    "bistatic": (
        lambda content: content.update(xt=content["x"]),
        "xt: beside x, y, z one more antenna is supported",
    ),
}


@pytest.mark.parametrize("name", sorted(BAD))
def test_wrong_files_are_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, *_ = scenario(1)
    change, message = BAD[name]
    change(content)
    path = save(tmp_path / "data.mat", content)
    with pytest.raises(DataError, match=message) as found:
        read_raw(path)
    assert "\n" not in str(found.value) and "data" in str(found.value)
    assert cli.main(["focus", str(path), "-o", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", range(12))
def test_damaged_files_are_one_line(tmp_path: Path, seed: int) -> None:
    """Cut anywhere, or with bytes changed: an error of ours, or data of the right size."""
    rng = np.random.default_rng(seed)
    content, *_ = scenario(1)
    path = tmp_path / "data.mat"
    scipy.io.savemat(path, {"data": content}, do_compression=bool(seed % 2))
    whole = bytearray(path.read_bytes())
    if seed < 8:
        path.write_bytes(whole[: int(rng.integers(0, len(whole) - 64))])
        with pytest.raises(DataError):
            read_raw(path)
        return
    for at in rng.integers(128, 2000, 6):
        whole[at] = int(rng.integers(0, 256))
    path.write_bytes(whole)
    try:
        raw = read_raw(path)
    except DataError as error:
        assert "\n" not in str(error)
    else:
        assert raw.data.shape[1] == 160


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("data.mat", b"not a MATLAB file", "cannot be read as a MATLAB file"),
        ("data.mat", b"", "cannot be read as a MATLAB file"),
        ("data.xyz", b"", "no raw format for the suffix"),
    ],
)
def test_other_files_are_one_line(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_raw(tmp_path / name)


def test_missing_things_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        read_raw(tmp_path / "none.mat")
    with pytest.raises(DataError, match=r"folder without any \.mat file"):
        read_raw(tmp_path)
    scipy.io.savemat(tmp_path / "other.mat", {"picture": np.zeros((3, 3))})
    with pytest.raises(DataError, match="no struct 'data'"):
        read_raw(tmp_path / "other.mat")
    newer = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(512)
    (tmp_path / "new.mat").write_bytes(newer)
    with pytest.raises(DataError, match=r"version 7\.3; save it in MATLAB with -v7"):
        read_raw(tmp_path / "new.mat")


def test_grid_beside_the_data_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, *_, place = scenario(1)
    path = save(tmp_path / "data.mat", content)
    beyond = -0.5 * place[80]
    command = ["focus", str(path), "-o", str(tmp_path / "out"), "--center", str(beyond[0]), str(beyond[1])]
    assert cli.main([*command, "--extent", "20"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "were not recorded" in lines[0]


def test_files_that_do_not_fit_each_other_are_one_line(tmp_path: Path) -> None:
    content, *_ = scenario(1)
    save(tmp_path / "a1_HH.mat", content)
    short = {**content, "fp": content["fp"][:-1], "freq": content["freq"][:-1]}
    save(tmp_path / "a2_HH.mat", short)
    with pytest.raises(DataError, match=r"a2_HH\.mat: 299 frequencies, a1_HH\.mat has 300"):
        read_raw(tmp_path)
    (tmp_path / "a2_HH.mat").unlink()
    moved = {**content, "r0": content["r0"] + 1.0}
    save(tmp_path / "a1_VV.mat", moved)
    with pytest.raises(DataError, match=r"a1_VV\.mat: pulses or frequencies differ from those of a1_HH"):
        read_raw(tmp_path)


def test_history_written_as_hdf5_is_the_same_data(tmp_path: Path) -> None:
    content, points, *_ = scenario(0)
    raw = read_raw(save(tmp_path / "a_VH.mat", content))
    raw.save(tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5")
    request = {"extent_azimuth": 10.0, "extent_range": 10.0, "center_x": float(points[1, 0])}
    first, second = (focus(data, request=request) for data in (raw, again))
    np.testing.assert_array_equal(first.data, second.data)
    assert again.channels == ("VH",) and again.request == raw.request
