"""SICD files: checked by their standard's checker and projection, and by reading them back."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import read_image, write_image
from sarmitsuba.files.catalog.sicd import objection
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import Layer
from tests.support.unweighted import focus

sksicd = pytest.importorskip("sarkit.sicd", reason="writes SICD; in the extra formats, from Python 3.11")
projection = pytest.importorskip("sarkit.sicd.projection")
verification = pytest.importorskip("sarkit.verification")


def drawn(seed: int, grid: str) -> tuple[SarImage, np.ndarray]:
    """An image of a point, with place, heading, side, look, squint, mode and range drawn; and where the point is."""
    rng = np.random.default_rng(seed)
    mode = ("spotlight", "stripmap")[seed % 2]
    radar = ideal_radar(
        slant_range=rng.uniform(4e3, 15e3),
        resolution=rng.uniform(0.8, 1.5),
        look_angle=np.radians(rng.uniform(25.0, 55.0)),
        squint_angle=np.radians(rng.uniform(-6.0, 6.0)) if mode == "spotlight" else 0.0,
        mode=mode,
        n_samples=128,
        antenna=Antenna()
        if mode == "spotlight"
        else Antenna("gaussian", 1.0, np.radians(6.0), np.radians(30.0)),
    )
    side = ("left", "right")[seed % 3 == 0]
    mirror = np.diag([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    heading = rng.uniform(0.0, 2.0 * np.pi)
    turn = mirror @ np.array(
        [[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]]
    )
    track, p = radar.track, radar.pointing
    radar = replace(
        radar,
        track=Track(track.time, track.position @ turn, track.velocity @ turn),
        pointing=Pointing(p.boresight @ turn, p.azimuth_axis @ turn, p.elevation_axis @ turn),
        look_side=side,
        anchor=Anchor.of_degrees(rng.uniform(-80, 80), rng.uniform(-180, 180), rng.uniform(-50, 2000)),
        offset=np.round(rng.uniform(-9e3, 9e3, 3)),
    )
    point = np.array([*rng.uniform(-4.0, 4.0, 2), 0.0])
    request = ImageRequest(
        grid, *rng.uniform(-3.0, 3.0, 2), 0.0, 24.0, 24.0, offset=(*map(float, radar.offset),)
    )
    image = focus(ideal_echoes(radar, point, 4.0, 0.7), request=request, focuser="backprojection")
    return image, radar.anchor.to_ecef(point + radar.offset)


def findings(path: Path) -> list[str]:
    """What the checker of the standard's owner finds wrong or unwanted."""
    with path.open("rb") as file:
        check = verification.SicdConsistency.from_file(file)
        check.check()
    return list(check.failures())


def opened(path: Path) -> tuple[Any, np.ndarray]:
    with path.open("rb") as file, sksicd.NitfReader(file) as reader:
        return reader.metadata.xmltree, np.asarray(reader.read_image()).astype(np.complex64)


CASES = [
    pytest.param(seed, grid, marks=() if seed in (0, 1) else pytest.mark.slow)
    for seed in range(4)
    for grid in ("ground", "slant")
]


@pytest.mark.parametrize(("seed", "grid"), CASES)
def test_pixels_project_to_where_they_stand(seed: int, grid: str, tmp_path: Path) -> None:
    """By the standard's own projection along contours of range and range rate; the checker has nothing to say."""
    image, truth = drawn(seed, grid)
    path = tmp_path / "drawn.nitf"
    write_image(image, path)
    assert findings(path) == []
    tree, pixels = opened(path)
    helper, model = sksicd.XmlHelper(tree), projection.MetadataParams.from_xml(tree)
    scp = helper.load("{*}ImageData/{*}SCPPixel")
    spacing = [helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}SS") for name in ("Row", "Col")]
    anchor, last = image.anchor, pixels.shape[1] - 1
    turned = helper.load("{*}SCPCOA/{*}SideOfTrack") == "L"
    frame = image.grid.in_frame(np.zeros(3))
    ground = anchor.to_ecef([0.0, 0.0, frame.height])

    def place(row: float, column: float) -> np.ndarray:
        sets = projection.compute_projection_sets(model, (np.array([row, column]) - scp) * spacing)
        return np.asarray(projection.r_rdot_to_ground_plane_mono(model.LOOK, sets, ground, anchor.axes[2]))

    for row, column in ((0, 0), (0, last), (pixels.shape[0] - 1, 0), (pixels.shape[0] - 1, last)):
        line = last - column if turned else column
        ours = anchor.to_ecef(frame.positions_on_line(line)[row])
        # tol: what is asked for is 0.1 m; a straight track is a polynomial to rounding
        assert np.linalg.norm(place(row, column) - ours) < 1e-3
    brightest = np.unravel_index(np.abs(pixels).argmax(), pixels.shape)
    assert np.linalg.norm(place(*brightest) - truth) < np.hypot(*spacing)  # tol: the point is between pixels


@pytest.mark.parametrize(("seed", "grid"), CASES)
def test_spectra_are_where_the_file_says(seed: int, grid: str, tmp_path: Path) -> None:
    """Energy lies within DeltaK1 ... DeltaK2 of both dimensions, by the transform whose sign the file gives."""
    image, _ = drawn(seed, grid)
    write_image(image, tmp_path / "drawn.nitf")
    tree, pixels = opened(tmp_path / "drawn.nitf")
    helper = sksicd.XmlHelper(tree)
    for axis, name in enumerate(("Row", "Col")):
        low, high, step = (
            helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}{key}") for key in ("DeltaK1", "DeltaK2", "SS")
        )
        assert helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}Sgn") == -1
        n = 512
        power = (np.abs(np.fft.fft(pixels, n, axis=axis)) ** 2).sum(axis=1 - axis)
        k = np.fft.fftfreq(n, step)
        slack = 0.15 * (high - low)  # tol: the band bends over the aperture; 24 m cut the side lobes
        assert power[(k > low - slack) & (k < high + slack)].sum() > 0.98 * power.sum()


@pytest.mark.parametrize(("seed", "grid"), CASES)
def test_what_is_read_back_is_the_image(seed: int, grid: str, tmp_path: Path) -> None:
    image, _ = drawn(seed, grid)
    write_image(image, tmp_path / "a.nitf")
    back = read_image(tmp_path / "a.nitf")
    assert back.channels == image.channels and back.grid.kind == grid
    # tol: float32, and a carrier of thousands of cycles over the image
    assert np.abs(back.data - image.data).max() < 1e-4 * np.abs(image.data).max()
    ours, theirs = (one.anchor.to_ecef(one.grid.in_frame(np.zeros(3)).positions()) for one in (image, back))
    # tol: slant pixels stand where range meets a plane 0.1 deg off the other
    assert np.linalg.norm(ours - theirs, axis=-1).max() < (1e-3 if grid == "ground" else 0.1)
    assert back.azimuth_resolution_cell == pytest.approx(image.azimuth_resolution_cell, rel=1e-9)
    assert back.range_resolution_cell == pytest.approx(image.range_resolution_cell, rel=1e-9)
    write_image(back, tmp_path / "b.nitf")
    assert findings(tmp_path / "b.nitf") == []


def test_channels_go_to_files_of_their_own(tmp_path: Path) -> None:
    image, _ = drawn(0, "ground")
    both = replace(
        image, data=np.concatenate([image.data, 2.0 * image.data]), layers=(Layer("HH"), Layer("RV"))
    )
    write_image(both, tmp_path / "two.nitf")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["two_HH.nitf", "two_RV.nitf"]
    assert all(findings(p) == [] for p in tmp_path.iterdir())
    assert read_image(tmp_path / "two_RV.nitf").channels == ("RV",)


def test_what_cannot_be_written_or_read_is_one_line(tmp_path: Path) -> None:
    image, _ = drawn(0, "ground")
    with pytest.raises(DataError, match="how it was flown"):
        write_image(replace(image, metadata={}), tmp_path / "x.nitf")
    write_image(image, tmp_path / "x.nitf")
    whole = (tmp_path / "x.nitf").read_bytes()
    for cut in (100, 2000, len(whole) // 2):
        (tmp_path / "bad.nitf").write_bytes(whole[:cut])
        with pytest.raises(DataError, match="bad") as caught:
            read_image(tmp_path / "bad.nitf")
        assert "\n" not in str(caught.value)


def test_from_orbit(tmp_path: Path) -> None:
    """Ground pixels project to their places; slant ones have no grid in the standard."""
    scene = load_scene("trihedral", radar="terrasar_spotlight", parameters={"image_extent_limit": "60"})
    scene = scene.replace(image_grid="ground")
    point = np.array([3.0, -2.0, 0.0])
    raw = ideal_echoes(scene.radar, point, 4.0)
    image = focus(raw, request=scene.image, focuser="backprojection")
    path = tmp_path / "orbit.nitf"
    write_image(image, path)
    assert findings(path) == []
    tree, pixels = opened(path)
    helper, model = sksicd.XmlHelper(tree), projection.MetadataParams.from_xml(tree)
    spacing = np.array([helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}SS") for name in ("Row", "Col")])
    brightest = np.array(np.unravel_index(np.abs(pixels).argmax(), pixels.shape))
    sets = projection.compute_projection_sets(
        model, (brightest - helper.load("{*}ImageData/{*}SCPPixel")) * spacing
    )
    ground = image.anchor.to_ecef([0.0, 0.0, 0.0])
    place = projection.r_rdot_to_ground_plane_mono(model.LOOK, sets, ground, image.anchor.axes[2])
    assert np.linalg.norm(image.anchor.from_ecef(place) - point) < 0.5 * np.hypot(
        *spacing
    )  # tol: half a pixel
    slant = focus(raw, request=replace(scene.image, grid="slant"), focuser="backprojection")
    with pytest.raises(DataError, match="--grid ground"):
        write_image(slant, tmp_path / "slant.nitf")


def test_what_the_standard_has_no_grid_for_is_refused_before_simulating(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slant-range pixels from orbit: nothing is traced; an airborne line, or pixels on the ground, are no obstacle."""
    monkeypatch.setattr(
        "sarmitsuba.simulation.execution.render.simulate", None
    )  # a call would fail otherwise
    orbit = ["--radar", "terrasar_spotlight", "-D", "image_extent_limit=60"]
    asked = ["render", "trihedral", *orbit, "-D", "range_film.image_grid=slant", "-o", str(tmp_path / "out")]
    assert main([*asked, "--format", "hdf5,sicd"]) == 2
    assert "--format sicd: the track is curved" in capsys.readouterr().err
    scene = load_scene("trihedral", radar="terrasar_spotlight", parameters={"image_extent_limit": "60"})
    assert objection(scene.radar, "slant") and not objection(scene.radar, "ground")
    assert not objection(load_scene("trihedral").radar, "slant")
