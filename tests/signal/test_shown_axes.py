"""The axes of pictures: a scatterer at a known place of the scene is at that place of the picture."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image import ImageGrid, SarImage, ShownAxes
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.view.display import PictureOptions, prepare
from sarmitsuba.view.quicklook import quicklook
from tests.support.scenes import POINT, small_scene
from tests.support.unweighted import render


def point_image(folder: Path, px: object, py: object, pz: object, **values: object) -> SarImage:
    file = folder / "point.xml"
    file.write_text(small_scene(POINT.format(px, py, pz), **values))
    return render(sarmitsuba.load_scene(file))


def brightest(image: SarImage, axes: str | None = None) -> tuple[float, float, float]:
    """Place of the brightest pixel on the axes of the drawn picture (across, up), and half a pixel, m."""
    figure = quicklook(image, PictureOptions(axes=axes))
    picture = figure.axes[0].get_images()[0]
    values = np.asarray(picture.get_array())
    row, column = np.unravel_index(int(values.argmax()), values.shape)
    left, right, below, above = picture.get_extent()
    half = 0.5 * max(abs(right - left) / values.shape[1], abs(above - below) / values.shape[0])
    x = left + (column + 0.5) * (right - left) / values.shape[1]
    y = below + (row + 0.5) * (above - below) / values.shape[0]
    assert figure.axes[0].get_xlim() == (left, right) and figure.axes[0].get_ylim() == (below, above)
    return float(x), float(y), half


@pytest.mark.parametrize("seed", range(6))
def test_a_point_of_the_scene_is_at_its_coordinates_of_the_picture(tmp_path: Path, seed: int) -> None:
    """Headings along the axes and turned ones, both sides, away from the scene's origin and from the image's centre."""
    rng = np.random.default_rng(seed)
    heading = float([0.0, 90.0, 180.0, 270.0, 37.0, rng.uniform(0.0, 360.0)][seed])
    side = ("left", "right")[int(rng.integers(2))]
    x, y = rng.uniform(-300.0, 300.0, 2)
    px, py = x + rng.uniform(-15.0, 15.0), y + rng.uniform(-15.0, 15.0)
    image = point_image(
        tmp_path,
        look=rng.uniform(25, 55),
        heading=heading,
        side=side,
        x=x,
        y=y,
        px=px,
        py=py,
        pz=0.0,
        grid="ground",
    )
    across, up, half = brightest(image)
    # the heading counts clockwise from north (y); the radar looks at a right angle to it
    turn = np.radians(heading)
    flight = np.array([np.sin(turn), np.cos(turn)])
    look = np.array([flight[1], -flight[0]]) * (1.0 if side == "right" else -1.0)
    figure = quicklook(image)
    if heading % 90.0 == 0.0:
        flies_north = heading % 180.0 == 0.0
        expected = (px, py) if flies_north else (py, px)
        names = ("x of the scene", "y of the scene") if flies_north else ("y of the scene", "x of the scene")
    else:
        expected = (float(look @ (px, py)), float(flight @ (px, py)))
        names = ("ground range from the scene's origin", "azimuth from the scene's origin")
    # tol: half a pixel
    assert (across, up) == pytest.approx(expected, abs=half + 1e-6)
    assert figure.axes[0].get_xlabel().startswith(names[0])
    assert figure.axes[0].get_ylabel().startswith(names[1])
    # numbers of the picture lead back to the pixel
    a, r = ShownAxes.of(image.grid).grid_coordinates(across, up)
    peak = np.unravel_index(int(image.rcs().argmax()), image.grid.shape)
    assert image.grid.azimuth[peak[0]] == pytest.approx(float(a), abs=1e-6)  # tol: rounding
    assert image.grid.range[peak[1]] == pytest.approx(float(r), abs=1e-6)
    # multi-looked, too
    drawn = image.multilook(2, 2).plot().axes[0]
    assert drawn.get_xlabel() == figure.axes[0].get_xlabel()
    assert drawn.get_ylabel() == figure.axes[0].get_ylabel()
    (mesh,) = drawn.collections
    values = np.asarray(mesh.get_array()).reshape(mesh.get_coordinates().shape[0] - 1, -1)
    i, j = np.unravel_index(int(values.argmax()), values.shape)
    corners = mesh.get_coordinates()[i : i + 2, j : j + 2].reshape(-1, 2)
    # tol: the brightest block may be the neighbour of the point's, by half a block
    assert np.abs(corners.mean(axis=0) - expected).max() <= 2.0 * half + 1e-6
    # near range is left, early azimuth below
    first, last = drawn.transData.transform([mesh.get_coordinates()[0, 0], mesh.get_coordinates()[-1, -1]])
    assert (first < last).all()
    # in the other frame the centre of the image is zero
    radar = brightest(image, "radar")[:2]
    offset = np.array([px - x, py - y])
    assert radar == pytest.approx((look @ offset, flight @ offset), abs=half + 1e-6)


def test_slant_range_is_shown_as_it_is(tmp_path: Path) -> None:
    image = point_image(
        tmp_path, look=40.0, heading=20.0, side="left", x=50.0, y=0.0, px=52.0, py=3.0, pz=0.0, grid="slant"
    )
    across, up, half = brightest(image)
    radar_place = image.grid.origin
    offset = np.array([52.0, 3.0, 0.0]) - image.grid.offset - radar_place
    along = float(offset @ image.grid.along)
    # tol: half a pixel
    assert up == pytest.approx(along, abs=half)
    assert across == pytest.approx(float(np.sqrt(offset @ offset - along**2)), abs=half)
    assert quicklook(image).axes[0].get_xlabel() == "slant range (m)"
    with pytest.raises(DataError, match="slant range has no axes of the scene"):
        quicklook(image, PictureOptions(axes="scene"))
    with pytest.raises(DataError, match='axes "scenes" are unknown; did you mean "scene"'):
        quicklook(image, PictureOptions(axes="scenes"))


def grid_of(angle: float, size: int = 40) -> ImageGrid:
    turn = np.radians(angle)
    along = np.array([np.sin(turn), np.cos(turn), 0.0])
    across = np.array([along[1], -along[0], 0.0])
    axis = np.arange(size) - size // 2
    return ImageGrid("ground", 0.5 * axis, 0.7 * axis, np.array([3.0, -8.0, 0.0]), along, across)


@pytest.mark.parametrize("angle", [0.0, 90.0, 180.0, 33.0])
def test_near_range_is_left_whichever_way_the_numbers_run(angle: float) -> None:
    grid = grid_of(angle)
    image = SarImage(
        np.ones((1, *grid.shape), dtype=np.complex64),
        (Layer("VV"),),
        grid,
        0.03,
        1.0,
        1.0,
        np.full(grid.shape[1], 0.7),
    )
    image.data[0, 3, 30] = 100.0
    display = prepare(image, PictureOptions(), 1600)
    left, right, below, above = display.extent
    x, y = display.axes.shown(grid.azimuth[3], grid.range[30])
    place = grid.positions()[3, 30, :2]
    shown = np.array([x, y])
    if angle != 33.0:
        np.testing.assert_allclose(np.sort(shown), np.sort(place), atol=1e-9)  # tol: rounding
    assert (float(x) - left) / (right - left) == pytest.approx(30.5 / 40)  # tol: rounding, also below
    assert (float(y) - below) / (above - below) == pytest.approx(3.5 / 40)
    moved = dataclasses.replace(grid, offset=np.array([100.0, 200.0, 0.0]))
    x1, y1 = ShownAxes.of(moved).shown(grid.azimuth[3], grid.range[30])
    assert np.hypot(float(x1 - x), float(y1 - y)) == pytest.approx(np.hypot(100.0, 200.0))


def test_quality_takes_an_area_as_on_the_axes_of_the_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Heading 180 deg: numbers fall to the right and upwards; the same rectangle in both frames."""
    import json

    from sarmitsuba import cli

    point = {
        "look": 40.0,
        "heading": 180.0,
        "side": "right",
        "x": 100.0,
        "y": 50.0,
        "px": 95.0,
        "py": 48.0,
        "pz": 0.0,
    }
    image = point_image(tmp_path, **point, grid="ground")
    image.save(tmp_path / "image.h5")
    found = []
    for area in (["45", "52", "90", "100"], ["--axes", "radar", "-2", "5", "0", "10"]):
        frame, numbers = (area[:2], area[2:]) if "--axes" in area else ([], area)
        out = tmp_path / "-".join(numbers).replace("--", "-m")
        assert (
            cli.main(["quality", str(tmp_path / "image.h5"), "--area", *numbers, *frame, "-o", str(out)]) == 0
        )
        (one,) = json.loads((out / "quality.json").read_text())["areas"]
        found.append(one)
    assert found[0] == found[1]
    pixel = max(image.grid.azimuth_spacing, image.grid.range_spacing)
    # tol: the table has the places of the outermost pixels inside
    assert found[0]["azimuth_m"] == pytest.approx([-2.0, 5.0], abs=pixel)
    assert found[0]["range_m"] == pytest.approx([0.0, 10.0], abs=pixel)
