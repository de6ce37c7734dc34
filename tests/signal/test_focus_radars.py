"""The focusers from every shipped radar, on both grids, and the image that the user asks for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import DataError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.loading.library import resolve_radar
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import check_focuser, parse_focuser
from tests.support.unweighted import focus

# without a beam of their own, straight and quick; the others are those of published figures
IDEALISED = ["airborne_ku", "airborne_l", "airborne_x", "spaceborne_x"]
SHIPPED = sorted(path.stem for path in resolve_radar("airborne_x").parent.glob("*.xml"))
PUBLISHED = sorted(set(SHIPPED) - set(IDEALISED))
FREQUENCY_DOMAIN = ("omega_k", "omega_k,stolt=phase", "range_doppler", "chirp_scaling")


def echoes_of(radar: str) -> tuple[sarmitsuba.Scene, sarmitsuba.RawData]:
    """Three points about the aim point, one of them off the image plane, seen by a shipped radar."""
    scene = sarmitsuba.load_scene("point", radar=radar)
    cell = scene.radar.waveform.range_cell
    points = [np.zeros(3), np.array([5.3, -3.1, 0.0]) * cell, np.array([-4.2, 6.0, 2.0]) * cell]
    targets = tuple(PointTarget(f"p{i}", p, 1.0 + i) for i, p in enumerate(points))
    scene = replace(scene, points=targets)
    return scene, sarmitsuba.simulate(scene)


def test_there_are_radars() -> None:
    assert set(IDEALISED) < set(SHIPPED) and len(PUBLISHED) >= 6


@pytest.mark.parametrize("grid", ["slant", "ground"])
@pytest.mark.parametrize("radar", IDEALISED)
def test_all_focusers_are_backprojection_from_every_idealised_radar(radar: str, grid: str) -> None:
    scene, raw = echoes_of(radar)
    size = 24.0 * scene.radar.waveform.range_cell
    request = replace(scene.image, grid=grid, extent_azimuth=size, extent_range=size)
    full = focus(raw, request=request)
    for name in FREQUENCY_DOMAIN:
        image = focus(raw, request=request, focuser=name)
        error = np.linalg.norm(image.data - full.data) / np.linalg.norm(full.data)
        # tol: stationary phase, largest for the few pulses and low frequency of airborne_l
        assert 20.0 * np.log10(error) < -50.0, name
        assert full.grid.kind == image.grid.kind == grid and full.grid.shape == image.grid.shape
        np.testing.assert_allclose(full.cell_area, image.cell_area, rtol=0.01)  # tol: own weights of each


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:.*a formula expected -45.0 dB"
)  # of an image of 9 rows in a burst of sentinel1_iw
@pytest.mark.parametrize("radar", PUBLISHED)
def test_all_focusers_are_backprojection_from_every_published_radar_or_refuse(radar: str) -> None:
    scene, raw = echoes_of(radar)
    raw = replace(raw, data=raw.data[:1], layers=raw.layers[:1])
    size = 24.0 * scene.radar.waveform.range_cell
    request = replace(scene.image, extent_azimuth=size, extent_range=size)
    full = focus(raw, request=request)
    for name in FREQUENCY_DOMAIN:
        image = focus(raw, request=request, focuser=name)
        error = np.linalg.norm(image.data - full.data) / np.linalg.norm(full.data)
        # tol: stationary phase, -49 dB for airborne_l_band; worst where an aperture has the least product of time and
        # Doppler bandwidth: 35 for drone_ku (17 m of track in cells of half a metre), -38 dB; in a burst ends of
        # apertures lie between pulses, -39 and -45 dB
        few = radar in ("drone_ku", "sentinel1_iw", "sentinel1_ew")
        assert 20.0 * np.log10(error) < (-37.0 if few else -48.0), name
        np.testing.assert_allclose(full.cell_area, image.cell_area, rtol=0.02)  # tol: own weights of each


@pytest.mark.parametrize("squint", [0.0, 8.0, -11.0])
def test_omega_k_on_the_ground_at_random(squint: float) -> None:
    rng = np.random.default_rng(int(20 + squint))
    points = [
        PointTarget(f"p{i}", np.array([*rng.uniform(-9, 9, 2), 1.5]), rng.uniform(1, 4)) for i in range(5)
    ]
    radar = RadarDescription(
        mode="spotlight",
        slant_range=rng.uniform(3e3, 8e3),
        look_angle_deg=rng.uniform(25, 60),
        heading_deg=rng.uniform(0, 360),
        squint_angle_deg=squint,
        bandwidth=200e6,
        azimuth_resolution=0.8,
    )
    film = FilmDescription(
        image_grid="ground", image_extent_azimuth=25.0, image_extent_range=25.0, image_height=1.5
    )
    scene = build_scene(points=points, radar=radar, film=film)
    raw = sarmitsuba.simulate(scene)
    image = focus(raw, default_grid(scene.radar, scene.image), focuser="omega_k")
    grid = image.grid
    full = focus(raw, grid)
    error = np.linalg.norm(image.data - full.data) / np.linalg.norm(full.data)
    assert 20.0 * np.log10(error) < -50.0  # tol: stationary phase


def test_what_omega_k_cannot_do_names_what_can() -> None:
    scene, raw = echoes_of("airborne_x")
    wavy = scene.radar.track.position + np.sin(np.arange(raw.radar.track.n_pulses))[:, None] * [0.0, 0.0, 0.1]
    curved = replace(raw, radar=replace(raw.radar, track=replace(raw.radar.track, position=wavy)))
    with pytest.raises(DataError, match=r"the track is curved .*; take focuser backprojection( or \w+)*$"):
        focus(curved, request=scene.image, focuser="omega_k", motion_compensation="off")
    across = default_grid(scene.radar, replace(scene.image, extent_range=3.0e4, spacing_range=500.0))
    with pytest.raises(
        DataError, match=r"reaches across the ground track; take focuser backprojection( or \w+)*$"
    ):
        check_focuser(parse_focuser("omega_k"), scene.radar, across)


def test_part_of_a_request_changes_that_part_only() -> None:
    scene, raw = echoes_of("airborne_ku")
    own = focus(raw, request={"extent_azimuth": 9.0, "extent_range": 7.0}).grid
    middle = own.positions()[own.shape[0] // 2, own.shape[1] // 2]
    assert own.kind == scene.image.grid
    for change, value in {"grid": "ground", "height": 1.0, "spacing_range": 0.2, "center_x": 2.0}.items():
        grid = focus(raw, request={"extent_azimuth": 9.0, "extent_range": 7.0, change: value}).grid
        here = grid.positions()[grid.shape[0] // 2, grid.shape[1] // 2]
        wanted = middle + {"height": [0, 0, 1.0], "center_x": [2.0, 0, 0]}.get(change, [0.0, 0.0, 0.0])
        np.testing.assert_allclose(here, wanted, atol=1e-6)
        if change == "spacing_range":
            assert grid.range_spacing == pytest.approx(0.2)
        if change == "grid":
            assert grid.kind == "ground" and np.ptp(grid.range) == pytest.approx(7.0, abs=0.2)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"extent_azimuth": -5.0}, "extents -5 m and .* above 0"),
        ({"extent_range": float("nan")}, "must be finite and above 0"),
        ({"spacing_range": float("inf")}, "must be finite and above 0"),
        ({"extent_azimuth": 1e9, "extent_range": 1e9}, "more than 1073741824 pixels"),
        ({"height": 1e6}, "is not below the antenna"),
        ({"center_y": float("nan")}, "center_y = nan m is not a finite number"),
        ({"center_x": 5e4}, "were not recorded, only those of"),
        ({"extents": 3.0}, "extents unknown; did you mean"),
        ({"grid": "polar"}, "kind 'polar' is unknown"),
    ],
)
def test_images_that_cannot_be_are_one_line(changes: dict[str, object], text: str) -> None:
    _, raw = echoes_of("airborne_x")
    with pytest.raises(DataError, match=text) as caught:
        focus(raw, request=changes)
    assert "\n" not in str(caught.value)


def test_the_command_line_changes_the_image_too(tmp_path: Path) -> None:
    from sarmitsuba.cli import main
    from sarmitsuba.files import read_image, write_raw

    _, raw = echoes_of("airborne_x")
    write_raw(raw, tmp_path / "raw.h5")
    options = (
        "--grid slant --extent 12 10 --spacing 0.5 0.25 --height 1 --focuser omega_k --window taylor:4:-30"
    )
    assert main(["focus", str(tmp_path / "raw.h5"), "-o", str(tmp_path / "out"), *options.split()]) == 0
    grid = read_image(tmp_path / "out" / "image.h5").grid
    assert (grid.kind, grid.height) == ("slant", 1.0)
    assert (grid.azimuth_spacing, grid.range_spacing) == pytest.approx((0.5, 0.25))
    assert np.ptp(grid.azimuth) == pytest.approx(12.0, abs=1.1)


@pytest.mark.parametrize("command", ["focus", "render"])
def test_help_lists_the_windows_with_their_parameters(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from sarmitsuba.cli import main
    from sarmitsuba.signal.focusing import WINDOWS

    with pytest.raises(SystemExit):
        main([command, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert all(f"{family.syntax}:" in text for family in WINDOWS)
