"""Images of a given number of pixels."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba import FilmDescription, ImageRequest, PointTarget, RadarDescription, build_scene, cli
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.simulation.planning.sampling.piece import crop


@pytest.mark.parametrize("seed", range(6))
def test_the_image_has_that_many_pixels_about_its_centre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = tuple(int(n) for n in rng.integers(1, 90, 2))
    kind = ("slant", "ground")[seed % 2]
    spacing = 0.0 if seed % 3 else float(rng.uniform(0.2, 0.4))
    scene = build_scene(
        points=[PointTarget("p", np.zeros(3), 1.0)],
        radar=RadarDescription(
            slant_range=4e3,
            look_angle_deg=float(rng.uniform(25.0, 60.0)),
            heading_deg=float(rng.uniform(0.0, 360.0)),
        ),
        film=FilmDescription(
            image_grid=kind,
            pixels_azimuth=counts[0],
            pixels_range=counts[1],
            pixel_spacing_range=spacing,
            image_center_x=0.0,
            image_center_y=0.0,
        ),
    )
    grid = default_grid(scene.radar, scene.image)
    assert grid.shape == counts
    middle = grid.positions()[counts[0] // 2, counts[1] // 2]
    assert np.abs(middle).max() < 1e-6  # the point is in that pixel
    if spacing:
        assert grid.range_spacing == pytest.approx(spacing, rel=1e-9)
    # every pixel lies in the part of the ground that is traced
    offset = grid.positions().reshape(-1, 3)
    half = 0.5 * np.array([scene.image.extent_azimuth, scene.image.extent_range])
    along = np.abs(offset @ scene.radar.track.along).max()
    across = np.abs(offset @ scene.radar.across).max()
    # tol: 0.1 %, the automatic spacing is that of the track's true aperture; the traced part has a margin of cells
    assert along <= 1.001 * half[0] and across <= 1.001 * half[1]
    # tol: 1 %, cells at the middle and curvature over the image; a pixel where the number is even
    assert across >= 0.49 * (scene.image.extent_range - 2.2 * np.ptp(offset @ scene.radar.across) / counts[1])
    piece = default_grid(scene.radar, crop(scene, 0.5).image)
    assert piece.shape == tuple(max(1, round(0.5 * n)) for n in counts)


def test_pixels_past_the_ground_track_are_refused() -> None:
    with pytest.raises(RadarError, match=r"pixels_range = 50000, .* reach past the ground track"):
        build_scene(points=[PointTarget("p", np.zeros(3), 1.0)], film=FilmDescription(pixels_range=50_000))
    with pytest.raises(DataError, match="number of pixels is below 0"):
        default_grid(sarmitsuba.load_scene("point").radar, ImageRequest(pixels_range=-1))


def test_commands_take_pixels_and_an_extent_afterwards(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = ("--quiet", "--no-chart")
    run = tmp_path / "run"
    assert cli.main(["render", "point", "-o", str(run), "--pixels", "40x24", *quiet]) == 0
    assert sarmitsuba.read_image(run / "image.h5").grid.shape == (40, 24)
    shapes = []
    for given in (("--pixels", "16"), ("--extent", "3"), ()):
        out = str(tmp_path / "again")
        assert cli.main(["focus", str(run / "raw.h5"), "-o", out, "--force", *given, *quiet]) == 0
        shapes.append(sarmitsuba.read_image(Path(out) / "image.h5").grid.shape)
    assert shapes[0] == (16, 16) and shapes[2] == (40, 24)
    spacing = sarmitsuba.read_image(run / "image.h5").grid.azimuth_spacing
    assert shapes[1][0] == 2 * np.ceil(1.5 / spacing) + 1
    with pytest.raises(SystemExit):
        cli.main(["render", "point", "-o", str(run), "--pixels", "40y24"])
    assert "is not of the form AZIMUTHxRANGE" in capsys.readouterr().err
