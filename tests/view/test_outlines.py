"""Outlines in pictures: rims of bodies are where a focused image shows scatterers at their places."""

from pathlib import Path

import matplotlib.collections
import numpy as np
import pytest
import trimesh
from matplotlib.path import Path as Polygon

import sarmitsuba
from sarmitsuba import SceneMesh, build_scene
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ShownAxes
from sarmitsuba.view.outlines import outlines
from sarmitsuba.view.quicklook import quicklook
from tests.support.scenes import POINT, small_scene
from tests.support.unweighted import render

pytest.importorskip("shapely")

BOX = """<shape type="cube"><transform name="to_world"><scale x="{0}" y="{1}" z="{2}"/><rotate z="1" angle="{3}"/>
        <translate x="{4}" y="{5}" z="{2}"/></transform>
        <bsdf type="radar_material"><string name="material" value="concrete"/>
        <string name="diffuse_law" value="lambert"/><float name="diffuse_level_db" value="0"/></bsdf></shape>"""


def drawn(rng: np.random.Generator, **more: object) -> dict[str, object]:
    x, y = rng.uniform(-300.0, 300.0, 2)
    given = {
        "look": rng.uniform(30.0, 50.0),
        "heading": rng.uniform(0.0, 360.0),
        "side": ("left", "right")[int(rng.integers(2))],
        "grid": ("ground", "slant")[int(rng.integers(2))],
        "squint": 0.0,
        "mode": "spotlight",
        "x": x,
        "y": y,
    }
    return given | more


@pytest.mark.parametrize(
    ("seed", "more"),
    [
        (0, {"grid": "ground"}),
        (1, {"grid": "slant"}),
        (2, {"grid": "ground", "squint": 20.0}),
        (3, {"grid": "slant", "squint": -15.0}),
        (4, {"grid": "ground", "mode": "stripmap"}),
        (5, {"grid": "slant", "heading": 37.0, "side": "left"}),
    ],
)
def test_a_raised_point_is_where_the_image_shows_it(
    tmp_path: Path, seed: int, more: dict[str, object]
) -> None:
    """The place from ranges alone against the peak of the focused echoes of a scatterer above the image plane."""
    rng = np.random.default_rng(seed)
    given = drawn(rng, **more)
    place = np.array([*rng.uniform(-6.0, 6.0, 2), rng.uniform(8.0, 20.0)])
    place[:2] += (given["x"], given["y"])
    file = tmp_path / "point.xml"
    file.write_text(small_scene(POINT.format(*place), **given))
    scene = sarmitsuba.load_scene(file)
    image = render(scene)
    azimuth, range_ = ImagePlacement(image.grid.in_frame(scene.offset), scene.radar).locate(
        place[None] - scene.offset
    )
    row, column = np.unravel_index(int(image.rcs().argmax()), image.grid.shape)
    flat = place * (1.0, 1.0, 0.0)
    on_ground = ImagePlacement(image.grid.in_frame(scene.offset), scene.radar).locate(
        flat[None] - scene.offset
    )
    # tol: a pixel and a half, of half a cell
    assert azimuth[0] == pytest.approx(image.grid.azimuth[row], abs=1.5 * image.grid.azimuth_spacing)
    assert range_[0] == pytest.approx(image.grid.range[column], abs=1.5 * image.grid.range_spacing)
    # layover: towards the radar, by more than the tolerance
    assert range_[0] < on_ground[1][0] - 4.0


@pytest.mark.parametrize("seed", range(3))
def test_outlines_enclose_the_bright_pixels_of_a_box(tmp_path: Path, seed: int) -> None:
    """A rough box without ground: its echoes lie between its footprint and its laid over roof."""
    rng = np.random.default_rng(100 + seed)
    given = drawn(rng, grid=("ground", "slant", "ground")[seed])
    size, height = rng.uniform(4.0, 8.0, 2), rng.uniform(3.0, 6.0)
    box = BOX.format(*size, height, rng.uniform(0.0, 90.0), given["x"] + 3.0, given["y"] - 2.0)
    file = tmp_path / "box.xml"
    file.write_text(small_scene(box, **given))
    scene = sarmitsuba.load_scene(file)
    (outline,) = outlines(scene)
    assert len(outline.foot) == 5
    np.testing.assert_allclose(outline.foot[:, 2] + scene.offset[2], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.ptp([outline.foot, outline.top], axis=0)[:, 2], 2.0 * height, atol=1e-5)
    x, y = outline.foot[:, 0], outline.foot[:, 1]
    area = abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))) / 2.0
    assert area == pytest.approx(
        4.0 * size[0] * size[1], rel=1e-3
    )  # tol: corners are rounded to a millimetre
    image = render(scene)
    figure = quicklook(image, scene=scene, outlined=True, with_plan=True)
    axes = figure.axes[0]
    rings = [
        path.vertices
        for collection in axes.collections
        if isinstance(collection, matplotlib.collections.LineCollection)
        for path in collection.get_paths()
    ]
    assert len(rings) == 2
    corners = np.concatenate(rings)
    from scipy.spatial import ConvexHull

    hull = Polygon(corners[ConvexHull(corners).vertices])
    shown = ShownAxes.of(image.grid)
    power = image.rcs()
    rows, columns = np.nonzero(power > 1e-2 * np.percentile(power, 99.5))
    places = np.stack(shown.shown(image.grid.azimuth[rows], image.grid.range[columns]), axis=-1)
    pixel = max(image.grid.azimuth_spacing, image.grid.range_spacing)
    # tol: side lobes beyond a cell are below 20 dB
    grown = hull.contains_points(places, radius=2.5 * pixel) | hull.contains_points(
        places, radius=-2.5 * pixel
    )
    weight = power[rows, columns]
    assert weight[grown].sum() > 0.98 * weight.sum()
    # they fill it, too: a shifted outline would be empty on one side
    inside = places[grown]
    for axis in (0, 1):
        low, high = corners[:, axis].min(), corners[:, axis].max()
        assert inside[:, axis].max() > high - 0.35 * (high - low)
        assert inside[:, axis].min() < low + 0.35 * (high - low)


def test_ground_and_hidden_faces_have_no_outline(tmp_path: Path) -> None:
    ground = """<shape type="rectangle"><transform name="to_world"><scale x="100" y="100"/></transform>
        <bsdf type="radar_material"><string name="material" value="concrete"/></bsdf></shape>"""
    given = drawn(np.random.default_rng(7), x=0.0, y=0.0)
    file = tmp_path / "ground.xml"
    file.write_text(small_scene(ground, **given))
    assert outlines(sarmitsuba.load_scene(file)) == ()


@pytest.mark.parametrize("seed", range(4))
def test_a_body_sunk_into_the_ground_stands_out_of_it(seed: int) -> None:
    """The footprint of a quay that reaches below the water lay behind the line at its foot."""
    rng = np.random.default_rng(seed)
    slope, level = (seed % 2 == 0) * rng.uniform(-0.1, 0.1, 2), rng.uniform(-20.0, 300.0)
    corners = np.array([[-90.0, -80, 0], [95, -80, 0], [95, 85, 0], [-90, 85, 0]])
    corners[:, 2] = level + corners[:, :2] @ slope
    ground = SceneMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "soil", "ground")
    size = rng.uniform([8.0, 8.0, 12.0], [20.0, 20.0, 15.0])
    box = trimesh.creation.box(extents=size)
    # in every other draw it reaches beyond the ground, which is level then
    beyond = bool(seed % 2)
    box.apply_translation([90.0 if beyond else 5.0, 5.0, level + float(rng.uniform(-2.0, 0.0))])
    above = trimesh.creation.box(extents=(6, 6, 3), transform=np.eye(4))
    above.apply_translation([-40.0, -30.0, level + 25.0])
    scene = build_scene([ground, SceneMesh.of(box, "brick", "quay"), SceneMesh.of(above, "brick", "above")])
    found = sorted(outlines(scene), key=lambda one: float(one.foot[0, 0]))
    assert len(found) == 2
    over, quay = (one.foot + scene.offset for one in found)
    # tol: vertices in single precision at 300 m
    np.testing.assert_allclose(quay[:, 2], level + quay[:, :2] @ slope, atol=1e-3)
    np.testing.assert_allclose(over[:, 2], level + 23.5, atol=1e-3)
    top = found[1].top + scene.offset
    np.testing.assert_allclose(top[:, 2], box.bounds[1, 2], atol=1e-3)


def test_the_command_draws_them_from_the_scene_of_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from sarmitsuba import cli
    from sarmitsuba.view.page.run_folder import scene_of_run

    file, out = tmp_path / "box.xml", tmp_path / "out"
    box = BOX.format(5, 4, 3, 20, 3, 0)
    file.write_text(small_scene(box, **drawn(np.random.default_rng(8), x=0.0, y=0.0)))
    quiet = ["--quiet", "--no-error-bars", "--no-chart", "--method", "image"]
    assert cli.main(["render", str(file), "-o", str(out), *quiet]) == 0
    plain = (out / "quicklook.png").read_bytes()
    assert cli.main(["picture", str(out), "--outlines", "--with-view"]) == 0
    assert (out / "quicklook.png").read_bytes() != plain
    file.write_text(file.read_text().replace('scale x="5"', 'scale x="6"'))
    with pytest.raises(DataError, match="other shapes or materials"):
        scene_of_run(out)


@pytest.mark.parametrize("method", ["image", "hybrid"])
def test_render_and_focus_draw_the_picture_that_picture_draws(tmp_path: Path, method: str) -> None:
    """The same options give the same pixels; and others than without them."""
    from sarmitsuba import cli

    file = tmp_path / "box.xml"
    shapes = BOX.format(5, 4, 3, 20, 53, -80)
    file.write_text(small_scene(shapes, **drawn(np.random.default_rng(9), x=50.0, y=-80.0, grid="ground")))
    quiet, shown = ["--quiet", "--no-chart"], ["--axes", "radar", "--outlines", "--with-view"]

    def picture(name: str, *command: str) -> bytes:
        out = tmp_path / name
        assert (
            cli.main(
                [command[0], *command[1:], *([] if command[0] == "picture" else ["-o", str(out), *quiet])]
            )
            == 0
        )
        return (out / "quicklook.png").read_bytes()

    made = ["render", str(file), "--no-error-bars", "--method", method]
    plain = picture("plain", *made)
    styled = picture("styled", *made, *shown)
    assert styled != plain
    assert picture("plain", "picture", str(tmp_path / "plain"), *shown) == styled
    if method == "hybrid":
        raw = str(tmp_path / "plain" / "raw.h5")
        assert picture("focused", "focus", raw, *shown) == styled


def test_what_a_run_cannot_draw_is_refused_before_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from sarmitsuba import cli

    file, out = tmp_path / "box.xml", tmp_path / "out"
    file.write_text(small_scene(BOX.format(5, 4, 3, 20, 3, 0), grid="slant"))
    for more, words in (
        (["--axes", "scene"], "slant range has no axes of the scene"),
        (["--no-focus", "--method", "hybrid", "--outlines"], "--no-focus makes none"),
    ):
        assert cli.main(["render", str(file), "-o", str(out), *more]) == 2
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1
        assert not list(out.glob("*.h5"))


def test_houses_of_a_map_have_one_outline_each(tmp_path: Path) -> None:
    """Not their balconies, nor the pavement on which they stand."""
    import json

    from sarmitsuba.loading.importing.convert import import_scene
    from sarmitsuba.loading.importing.import_options import ImportOptions

    boxes = [[[x, 0], [x + 12, 0], [x + 12, 15], [x, 15], [x, 0]] for x in (0, 40)]
    house = {"type": "Feature", "properties": {"building": "yes", "height": 18}}
    features = [house | {"geometry": {"type": "Polygon", "coordinates": [box]}} for box in boxes]
    (tmp_path / "a.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    model = import_scene(tmp_path / "a.geojson", tmp_path / "a.xml", ImportOptions(crs="local"))
    assert {"balconies", "pavement"} <= {part for part, *_ in model.parts}
    scene = sarmitsuba.load_scene(tmp_path / "a.xml")
    found = [outline.foot[:, :2] + scene.offset[:2] for outline in outlines(scene)]
    assert len(found) == 2
    # tol: rings are simplified to 5 cm
    low = sorted(foot.min(axis=0).tolist() for foot in found)
    np.testing.assert_allclose(low, [[0.0, 0.0], [40.0, 0.0]], atol=0.06)
    np.testing.assert_allclose([np.ptp(foot, axis=0) for foot in found], [[12.0, 15.0]] * 2, atol=0.06)
