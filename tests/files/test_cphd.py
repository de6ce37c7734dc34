"""CPHD files: checked by their standard's checker, by arithmetic on the bare file, and by reading them back."""

import importlib
import shutil
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import read_raw, write_raw
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.unweighted import focus

skcphd = pytest.importorskip("sarkit.cphd", reason="writes CPHD; in the extra formats, from Python 3.11")
verification = pytest.importorskip("sarkit.verification")

LIGHT = 299792458.0
SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]


def turned(radar: Radar, heading: float) -> Radar:
    """The radar flown along another heading (rad, clockwise), everything turned about the origin."""
    turn = np.array(
        [[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]]
    )
    track, p = radar.track, radar.pointing
    axes = (p.boresight @ turn, p.azimuth_axis @ turn, p.elevation_axis @ turn)
    return replace(
        radar,
        track=Track(track.time, track.position @ turn, track.velocity @ turn),
        pointing=type(p)(*axes),
    )


def drawn(seed: int) -> tuple[RawData, np.ndarray, np.ndarray]:
    """Echoes of three points from a drawn place on the Earth, with heading, look, squint, mode and range drawn."""
    rng = np.random.default_rng(seed)
    mode = ("spotlight", "stripmap")[seed % 2]
    far = seed % 3 == 2
    radar = turned(
        ideal_radar(
            slant_range=700e3 if far else rng.uniform(4e3, 15e3),
            resolution=rng.uniform(1.5, 3.0),
            look_angle=np.radians(rng.uniform(25.0, 55.0)),
            squint_angle=np.radians(rng.uniform(-6.0, 6.0)) if mode == "spotlight" else 0.0,
            mode=mode,
            n_samples=160,
            antenna=Antenna()
            if mode == "spotlight"
            else Antenna("gaussian", 1.0, np.radians(8.0), np.radians(30.0)),
        ),
        rng.uniform(0.0, 2.0 * np.pi),
    )
    anchor = Anchor.of_degrees(rng.uniform(-80, 80), rng.uniform(-180, 180), rng.uniform(-50, 2000))
    radar = replace(radar, anchor=anchor, offset=np.round(rng.uniform(-9e3, 9e3, 3)))
    points = np.column_stack([rng.uniform(-12, 12, (3, 2)), rng.uniform(0.0, 4.0, 3)])
    phases = rng.uniform(-np.pi, np.pi, 3)
    raw = ideal_echoes(radar, points, 1.0, phases)
    request = ImageRequest("ground", 0.0, 0.0, 0.0, 30.0, 30.0, offset=tuple(radar.offset))
    return replace(raw, request=request), points + radar.offset, phases


def findings(path: Path) -> list[str]:
    """What the checker of the standard's owner finds wrong or unwanted."""
    with path.open("rb") as file:
        check = verification.CphdConsistency.from_file(file)
        check.check()
    return list(check.failures())


@pytest.mark.parametrize("seed", SEEDS)
def test_a_written_file_is_right_by_its_checker_and_by_arithmetic(seed: int, tmp_path: Path) -> None:
    """At each point's Earth-fixed place the bare samples add up in phase, to its root RCS and phase."""
    raw, points, phases = drawn(seed)
    path = tmp_path / "drawn.cphd"
    write_raw(raw, path)
    assert findings(path) == []
    with path.open("rb") as file, skcphd.Reader(file) as reader:
        signal, vectors = reader.read_channel(raw.channels[0])
    f = vectors["SC0"][:, None] + vectors["SCSS"][:, None] * np.arange(signal.shape[1])

    def delay(point: np.ndarray) -> np.ndarray:
        return (
            np.linalg.norm(vectors["TxPos"] - point, axis=1)
            + np.linalg.norm(vectors["RcvPos"] - point, axis=1)
        ) / LIGHT

    middle = vectors.size // 2
    apart = 40 if vectors.size > 80 else vectors.size // 2
    seen = slice(middle - apart, middle + apart)  # in stripmap with a beam each point counts by its gain
    anchor = raw.radar.anchor
    for point, phase in zip(points, phases, strict=True):
        late = delay(anchor.to_ecef(point)) - delay(vectors["SRPPos"])
        sums = (signal * np.exp(2j * np.pi * f * late[:, None]))[seen].mean(axis=1)
        got = sums * np.exp(-1j * phase)
        # tol: three points share the band, side lobes of the others; -22 dB
        assert np.abs(np.angle(got.mean())) < 0.1
        if raw.radar.antenna.pattern == "isotropic":
            assert np.abs(got.mean()) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_read_back_focuses_to_the_same_points(seed: int, tmp_path: Path) -> None:
    raw, points, _ = drawn(seed)
    raw = replace(raw, radar=replace(raw.radar, antenna=Antenna()))  # patterns are not in the file
    write_raw(raw, tmp_path / "drawn.cphd")
    back = read_raw(tmp_path / "drawn.cphd")
    assert back.channels == raw.channels and back.radar.track.n_pulses == raw.radar.track.n_pulses
    one = raw.radar.anchor.to_ecef(points)
    places = back.radar.anchor.from_ecef(one)
    for place, point in zip(places, points, strict=True):
        small = ImageRequest("ground", *place[:2], float(place[2]), 1.0, 1.0, 0.25, 0.25)
        was = ImageRequest("ground", *point[:2], float(point[2]), 1.0, 1.0, 0.25, 0.25)
        got, want = (
            focus(data, request=request, focuser="backprojection").data[0]
            for data, request in ((back, small), (raw, was))
        )
        centre = tuple(n // 2 for n in want.shape)
        # tol: the profile's ends are cut at another place; the frames' tangent planes differ by mm over the aperture
        assert abs(20.0 * np.log10(abs(got[centre] / want[centre]))) < 0.1
        assert abs(np.angle(got[centre] / want[centre])) < 0.05
    assert back.request is not None
    # tol: corner points are rounded to nothing, the flight's direction on the ground to the file's
    assert back.request.extent_range == pytest.approx(30.0, abs=0.1)


def rewritten(path: Path, target: Path, change: Any) -> None:
    """Another producer's file: the XML, the samples and the vectors changed, written by the reference library."""
    with path.open("rb") as file, skcphd.Reader(file) as reader:
        tree = reader.metadata.xmltree
        name = tree.findtext("{*}Channel/{*}RefChId")
        signal, vectors = reader.read_channel(name)
    signal, vectors = change(skcphd.ElementWrapper(tree.getroot()), signal, vectors)
    with target.open("wb") as file, skcphd.Writer(file, skcphd.Metadata(xmltree=tree)) as writer:
        writer.write_signal(name, signal)
        writer.write_pvp(name, vectors)


def peak(raw: RawData, place: np.ndarray) -> complex:
    request = ImageRequest("ground", *place[:2], float(place[2]), 1.0, 1.0, 0.25, 0.25)
    image = focus(raw, request=request, focuser="backprojection").data[0]
    return complex(image[tuple(n // 2 for n in image.shape)])


def test_conventions_of_other_producers(tmp_path: Path) -> None:
    """The other sign, 16-bit samples with a scale per vector, vectors without signal, an antenna that moves on."""
    raw, points, _ = drawn(0)
    write_raw(raw, tmp_path / "ours.cphd")
    ours = read_raw(tmp_path / "ours.cphd")
    place = ours.radar.anchor.from_ecef(raw.radar.anchor.to_ecef(points[0]))

    def conjugated(top: Any, signal: Any, vectors: Any) -> Any:
        top["Global"]["SGN"] = 1
        return signal.conj(), vectors

    def moving(top: Any, signal: Any, vectors: Any) -> Any:
        vectors = vectors.copy()
        half = 0.5 * (vectors["RcvTime"] - vectors["TxTime"])[:, None]
        vectors["TxPos"] = vectors["TxPos"] - half * vectors["TxVel"]
        vectors["RcvPos"] = vectors["RcvPos"] + half * vectors["RcvVel"]
        return signal, vectors

    def gaps(top: Any, signal: Any, vectors: Any) -> Any:
        vectors, signal = vectors.copy(), signal.copy()
        vectors["SIGNAL"][::7] = 0
        signal[::7] = 1e6
        return signal, vectors

    want = peak(ours, place)
    for change, share in ((conjugated, 1.0), (moving, 1.0), (gaps, 1.0)):
        rewritten(tmp_path / "ours.cphd", tmp_path / "theirs.cphd", change)
        got = peak(read_raw(tmp_path / "theirs.cphd"), place)
        # tol: a seventh of the pulses out of an even aperture changes the other points' side lobes by 1/7 of -20 dB
        assert abs(got / want - share) < 0.03, change.__name__


def test_two_antennas_and_two_channels(tmp_path: Path) -> None:
    raw, _, _ = drawn(0)
    behind = raw.radar.track
    follower = Track(behind.time, behind.position + np.array([30.0, 10.0, 5.0]), behind.velocity)
    radar = replace(raw.radar, receiver=follower, channels=("HH", "HV"))
    both = replace(
        raw, radar=radar, layers=(Layer("HH"), Layer("HV")), data=np.concatenate([raw.data, 0.5 * raw.data])
    )
    write_raw(both, tmp_path / "two.cphd")
    assert findings(tmp_path / "two.cphd") == []
    back = read_raw(tmp_path / "two.cphd")
    assert back.channels == ("HH", "HV") and back.radar.receiver is not None
    apart = np.linalg.norm(back.radar.receiver.position - back.radar.track.position, axis=1)
    assert apart == pytest.approx(np.linalg.norm([30.0, 10.0, 5.0]), abs=1e-6)
    assert np.abs(back.total("HV") - 0.5 * back.total("HH")).max() < 1e-6 * np.abs(back.total("HH")).max()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda data: data[:200], "cannot be read as CPHD"),
        (lambda data: data[: len(data) // 2], "SIGNAL block of .* cut off or is damaged"),
        (lambda data: b"CPHD/9.9\n" + data[10:], "cannot be read as CPHD"),
        (
            lambda data: data.replace(b"<DomainType>FX<", b"<DomainType>TOA<").replace(b"  ", b" ", 1),
            "CPHD|TOA|time",
        ),
    ],
)
def test_damaged_files_are_one_line(spoil: Any, said: str, tmp_path: Path) -> None:
    raw, _, _ = drawn(0)
    write_raw(raw, tmp_path / "good.cphd")
    path = tmp_path / "bad.cphd"
    path.write_bytes(spoil((tmp_path / "good.cphd").read_bytes()))
    with pytest.raises(DataError, match=said) as caught:
        read_raw(path)
    assert "\n" not in str(caught.value)


def test_chirped_echoes_are_refused_and_a_missing_library_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw, _, _ = drawn(0)
    with pytest.raises(DataError, match="range compress"):
        write_raw(replace(raw, domain="chirped"), tmp_path / "x.cphd")
    monkeypatch.setitem(sys.modules, "sarkit.cphd", None)
    with pytest.raises(DataError, match="formats"):
        write_raw(raw, tmp_path / "x.cphd")
    assert not list(tmp_path.iterdir())


def test_the_command_line_focuses_a_file(tmp_path: Path) -> None:
    raw, _, _ = drawn(0)
    write_raw(raw, tmp_path / "x.cphd")
    assert main(["focus", str(tmp_path / "x.cphd"), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    assert (tmp_path / "out" / "image.h5").is_file()


@pytest.mark.slow
def test_an_independent_program_finds_the_points(tmp_path: Path) -> None:
    """FastSAR reads the file through sarpy and forms an image of its own."""
    fastsar = pytest.importorskip("fastsar", reason="another program; in the extra independent")
    pytest.importorskip("sarpy", reason="reads CPHD for FastSAR; in the extra independent")
    if not any(map(shutil.which, ("c++", "g++", "clang++"))):
        pytest.skip("FastSAR compiles itself, and there is no C++ compiler")
    raw, points, _ = drawn(0)
    place = (points[0] - raw.radar.offset) * [1.0, 1.0, 0.0]
    one = ideal_echoes(raw.radar, place, 4.0)
    write_raw(replace(one, request=raw.request), tmp_path / "x.cphd")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        formed = fastsar.form_cphd(str(tmp_path / "x.cphd"), backend="cpu")
    image = np.abs(formed["image"])
    row, column = np.unravel_index(image.argmax(), image.shape)
    local = formed["origin"] + row * formed["spx"] * formed["e1"] + column * formed["spy"] * formed["e2"]
    ecef = importlib.import_module("fastsar.io").local_to_ecf(local, formed["meta"])
    anchor = raw.radar.anchor
    off = anchor.from_ecef(ecef) - (place + raw.radar.offset)
    axes = np.stack(
        [anchor.axes @ (one_axis @ formed["meta"]["R"]) for one_axis in (formed["e1"], formed["e2"])]
    )
    assert (np.abs(axes @ off) < 0.55 * np.array([formed["spx"], formed["spy"]])).all()  # tol: half a pixel
