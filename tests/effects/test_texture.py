"""Maps and texture of surfaces through the whole chain; levels and statistics are cases of the validation page."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba import Motion, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.machine.backend import dr
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.materials.material import ClassMap, Material, SurfaceMaps
from sarmitsuba.scene.materials.texture import Bitmap, place_in_plan, place_on_mesh
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from tests.support.unweighted import render

pytestmark = pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # effects switched off

SIZE = 24.0
RADAR = RadarDescription(
    slant_range=3e3,
    heading_deg=37.0,
    look_angle_deg=40.0,
    bandwidth=150e6,
    azimuth_resolution=2.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
FILM = FilmDescription(image_grid="ground", image_extent_azimuth=SIZE, image_extent_range=SIZE)
SOIL = Material(
    "soil", permittivity=6.0 - 0.6j, rms_height=0.004, diffuse_law="constant", diffuse_level_db=-10.0
)
FIELD = replace(
    SOIL, name="field", diffuse_level_db=-4.0, cross_polar_ratio_db=-9.0, permittivity=20.0 - 4.0j
)
FACES = [[0, 1, 2], [0, 2, 3]]


def square(half: float = SIZE, height: float = 0.0, slope: float = 0.0) -> F64:
    x, y = half * np.array([-1.0, 1.0, 1.0, -1.0]), half * np.array([-1.0, -1.0, 1.0, 1.0])
    return np.column_stack([x, y, height + slope * x])


def scene_of(material: Material, vertices: Any = None, radar: RadarDescription = RADAR, **mesh: Any) -> Scene:
    """Ground and a conducting wall on it, so that there are mirrors and a few bounces."""
    wall = np.array([[-5.0, 3.0, 0.0], [5.0, 1.0, 0.0], [5.0, 1.0, 4.0], [-5.0, 3.0, 4.0]])
    shapes = [
        SceneMesh(square() if vertices is None else vertices, FACES, material, "ground", **mesh),
        SceneMesh(wall, FACES, "pec", "wall"),
    ]
    # maps end at their rim, single materials would go on
    settings = TraceSettings(endless_ground="off")
    return build_scene(shapes, radar=radar, film=FILM, settings=settings)


def chessboard(*materials: Material, placement: Any = None) -> Material:
    """Squares of 6 m of some materials."""
    bitmap = Bitmap(
        np.add.outer(np.arange(8), np.arange(8)) % len(materials),
        placement or place_in_plan((-SIZE, -SIZE, SIZE, SIZE)),
    )
    return replace(materials[0], name="board", maps=SurfaceMaps(classes=ClassMap(bitmap, materials)))


def run(scene: Scene) -> tuple[C64, set[str]]:
    """Raw data, and the kernels that made them."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        data = simulate(scene, seed=1).data
        kernels = {str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])}
    return data, kernels


def difference_db(a: Any, b: Any) -> float:
    return float(20.0 * np.log10(np.linalg.norm(a - b) / np.linalg.norm(b) + 1e-30))


def looks(image: SarImage, edge: float, origin: F64 | None = None) -> F64:
    """Mean sigma0 of squares of the scene, (n, n), whatever the image's axes."""
    points = image.grid.positions()
    n = int(0.7 * SIZE / edge)
    column, row = (np.floor(points[..., i] / edge + 0.5 * n).astype(int) for i in (0, 1))
    inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
    number = (row * n + column)[inside]
    power = image.sigma0()[inside]
    return np.asarray(np.bincount(number, power, n * n) / np.bincount(number, minlength=n * n)).reshape(n, n)


def test_off_is_off() -> None:
    plain, kernels = run(scene_of(SOIL))
    level = Bitmap(np.array([[0.1, 2.0]]), place_in_plan((-SIZE, -SIZE, SIZE, SIZE)))
    textured = replace(SOIL, texture_shape=2.0, texture_length=3.0, maps=SurfaceMaps(level=level))
    data, same = run(scene_of(textured).replace(texture="off"))
    assert np.array_equal(data, plain) and same == kernels
    data, other = run(scene_of(textured))
    assert not np.array_equal(data, plain) and other != kernels


@pytest.mark.slow
def test_one_material_all_over_a_map_is_that_material() -> None:
    """Every place of several bounces takes its material from the map: mirror, currents, scatterers, both ways."""
    radar = replace(RADAR, polarisation="HH,HV")
    plain = simulate(scene_of(FIELD, radar=radar), seed=1).data
    mapped = replace(SOIL, name="map", maps=chessboard(FIELD, FIELD).maps)
    # tol: the same numbers added in another order
    assert difference_db(simulate(scene_of(mapped, radar=radar), seed=1).data, plain) < -90.0
    assert difference_db(simulate(scene_of(SOIL, radar=radar), seed=1).data, plain) > -10.0


@pytest.mark.slow
def test_each_part_of_a_map_is_as_its_material_alone() -> None:
    """What two materials return alone, cut out by the map and its reverse, adds up to what both return alone."""
    board = [chessboard(*pair) for pair in ((SOIL, FIELD), (FIELD, SOIL))]
    alone = [simulate(scene_of(m), seed=1).data for m in (SOIL, FIELD)]
    mapped = [simulate(scene_of(replace(m, name="board")), seed=1).data for m in board]
    assert difference_db(mapped[0], alone[0]) > -10.0
    # tol: the coherent return of a tube across an edge has the material of the ray that stands for it
    assert difference_db(mapped[0] + mapped[1], alone[0] + alone[1]) < -40.0


def test_texture_coordinates_and_plan_are_two_ways_to_say_one_place() -> None:
    """On a slope, with coordinates that are turned and go round the picture more than once."""
    vertices = square(slope=0.3)
    turn = np.radians(31.0)
    to_uv = np.array(
        [[np.cos(turn), -np.sin(turn), 0.3], [np.sin(turn), np.cos(turn), -1.2], [0.0, 0.0, 1.0]]
    )
    plan = (vertices[:, :2] * [1.0, -1.0] + SIZE) / (2.0 * SIZE)
    uv = np.column_stack([plan, np.ones(4)]) @ to_uv.T
    values = 10.0 ** np.random.default_rng(5).uniform(-1.0, 1.0, (7, 9))
    data = []
    for placement, attributes in (
        (place_in_plan((-SIZE, -SIZE, SIZE, SIZE), to_uv), {}),
        (place_on_mesh(("uv",)), {"uv": uv[:, :2]}),
    ):
        level = Bitmap(values, placement, repeat=True, smooth=True)
        scene = scene_of(replace(SOIL, maps=SurfaceMaps(level=level)), vertices, attributes=attributes)
        data.append(simulate(scene, seed=1).data)
    # tol: float32 of the coordinates
    assert difference_db(data[0], data[1]) < -80.0


@pytest.mark.slow
def test_a_map_moves_with_its_mesh() -> None:
    """Uniform motion along the track's right angle: the map's squares stay on the mesh."""
    alone = [simulate(scene_of(m, motion=Motion((1.5, -2.0, 0.0))), seed=1).data for m in (SOIL, FIELD)]
    board = [chessboard(*pair) for pair in ((SOIL, FIELD), (FIELD, SOIL))]
    mapped = [simulate(scene_of(m, motion=Motion((1.5, -2.0, 0.0))), seed=1).data for m in board]
    assert difference_db(mapped[0] + mapped[1], alone[0] + alone[1]) < -40.0


@pytest.mark.parametrize("method", ["image", pytest.param("raster", marks=pytest.mark.slow)])
def test_the_texture_is_the_scenes_whatever_the_heading(method: Any) -> None:
    clutter = replace(SOIL, rms_height=0.05, texture_shape=1.0, texture_length=5.0)
    film = replace(FILM, image_extent_azimuth=60.0, image_extent_range=60.0)

    def seen(heading: float, seed: int) -> F64:
        radar = replace(RADAR, heading_deg=heading, bandwidth=300e6, azimuth_resolution=0.5)
        scene = build_scene(
            [SceneMesh(square(40.0), FACES, clutter, "ground")],
            radar=radar,
            film=film,
            settings=TraceSettings(method=method, seed=seed),
        )
        return np.log(looks(render(scene), 3.0)).ravel()

    first, again, other = seen(10.0, 1), seen(133.0, 1), seen(10.0, 2)
    # 3 m hold 24 looks: their spread of 0.2 in the logarithm, beside 1 of the texture, leaves 0.95
    assert np.corrcoef(first, again)[0, 1] > 0.85
    # tol: 25 squares of 3 m over texture of 5 m are some ten independent ones
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.85


def test_raster_draws_maps_of_level_and_material() -> None:
    level = Bitmap(np.array([[0.25, 1.0], [2.0, 4.0]]), place_in_plan((-SIZE, -SIZE, SIZE, SIZE)))
    settings = TraceSettings(method="raster", effects={"speckle": "off"})
    images = []
    for material in (
        SOIL,
        replace(SOIL, maps=SurfaceMaps(level=level)),
        chessboard(SOIL, FIELD, placement=place_in_plan((-96.0, -96.0, 96.0, 96.0))),
    ):
        scene = build_scene([SceneMesh(square(), FACES, material)], radar=RADAR, film=FILM, settings=settings)
        images.append(render(scene, range_window="taylor", azimuth_window="taylor").sigma0())
    points = render(scene).grid.positions()
    x, y = points[..., 0], points[..., 1]
    # without the rim, over which the image's transforms go round
    clear = (np.abs(x) > 4.0) & (np.abs(y) > 4.0) & (np.hypot(x, y) < 10.0)
    want = np.where(y > 0.0, np.where(x > 0.0, 1.0, 0.25), np.where(x > 0.0, 4.0, 2.0))
    # tol: side lobes of the neighbours
    np.testing.assert_allclose((images[1] / images[0])[clear], want[clear], rtol=0.15)
    # squares of 24 m about the origin, the first of them soil in the north-west
    want = np.where((x > 0.0) == (y > 0.0), 10.0**0.6, 1.0)
    np.testing.assert_allclose((images[2] / images[0])[clear], want[clear], rtol=0.15)


@pytest.mark.slow
def test_a_map_aside_changes_nothing_behind_a_pane() -> None:
    """A small plate of metal seen through glass, beside a patch of soil, and of a map that says soil everywhere.

    The plate has finer rays than the pane before it.
    """

    def upright(x: float, lean: float, half: float, low: float, high: float) -> F64:
        corners = ((-half, low), (half, low), (half, high), (-half, high))
        return np.array([[x + lean * z, y, z] for y, z in corners])

    radar = replace(RADAR, look_angle_deg=80.0, heading_deg=0.0, bandwidth=300e6, azimuth_resolution=0.9)
    profiles = []
    for soil in (SOIL, chessboard(SOIL, replace(SOIL, name="the same"))):
        shapes = [
            SceneMesh(np.add(square(2.0), [-9.0, 8.0, 0.0]), FACES, soil, "patch"),
            SceneMesh(
                upright(-2.0, 0.0, 4.0, 0.0, 6.0),
                FACES,
                {"material": "glass", "smooth": True, "thickness": 0.006},
                "pane",
            ),
            SceneMesh(upright(0.0, np.tan(np.radians(10.0)), 0.15, 0.5, 0.8), FACES, "pec", "plate"),
            SceneMesh(square(height=-0.01), FACES, replace(SOIL, name="ground", rms_height=0.03), "ground"),
        ]
        scene = build_scene(shapes, radar=radar, film=FILM).replace(texture="on")
        profiles.append(simulate(scene, seed=1).data)
    plain, mapped = profiles
    assert np.linalg.norm(mapped - plain) < 1e-3 * np.linalg.norm(plain)  # tol: sums in float32
