"""Imported cities: areas, volumes, heights and places against shapely and PROJ, other formats, hostile input."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import OutputError, SarmitsubaError, SceneError
from sarmitsuba.loading.importing.city_model import Model
from sarmitsuba.loading.importing.convert import import_scene
from sarmitsuba.loading.importing.facades import FacadeOptions
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.terrain import network
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.scene.mesh.formats import write_ply
from tests.support.unweighted import render

shapely = pytest.importorskip("shapely", minversion="2.1", reason="in the importing extra")
rasterio = pytest.importorskip("rasterio", reason="in the importing extra")

SEEDS = range(4)
FOOT = 0.5  # m; how deep walls stand in the ground
PLAIN = FacadeOptions.read("none", 1, {})


def random_footprint(rng: np.random.Generator, middle: F64) -> Any:
    """A star-shaped outline at any heading, now and then with a courtyard."""
    n = int(rng.integers(4, 12))
    angle = np.sort(2 * np.pi * (np.arange(n) + rng.uniform(0.1, 0.9, n)) / n)
    ring = rng.uniform(8.0, 20.0, (n, 1)) * np.column_stack([np.cos(angle), np.sin(angle)])
    hole = [0.2 * ring + middle] if rng.random() < 0.6 else []
    return shapely.Polygon(ring + middle, hole)


def feature(polygon: Any, name: int, **tags: object) -> dict[str, object]:
    return {
        "type": "Feature",
        "id": f"way/{name}",
        "properties": {"building": "yes", **tags},
        "geometry": shapely.geometry.mapping(polygon),
    }


def write_features(path: Path, features: Sequence[object]) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def volume(model: Model) -> float:
    """Of closed surfaces with their outsides outwards, by the divergence theorem, m^3."""
    total = 0.0
    for part, _, v, f in model.parts:
        if part != "ground":
            a, b, c = (v[f[:, i]] for i in range(3))
            total += float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
    return total


def area_facing_up(model: Model, part: str) -> float:
    total = 0.0
    for name, _, v, f in model.parts:
        if name == part:
            total += 0.5 * float(np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])[:, 2].sum())
    return total


@pytest.mark.parametrize("seed", SEEDS)
def test_areas_and_volumes_are_those_of_the_footprints(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    polygons = [random_footprint(rng, np.array([60.0 * i, 0.0])) for i in range(5)]
    heights = rng.uniform(5.0, 60.0, 5)
    pair = shapely.MultiPolygon([random_footprint(rng, np.array([x, 80.0])) for x in (0.0, 60.0)])
    features = [
        feature(p, i, height=f"{h!r} m")
        for i, (p, h) in enumerate(zip(polygons, heights.tolist(), strict=True))
    ]
    source = write_features(
        tmp_path / "a.geojson", [*features, feature(pair, 9, height=10.0, min_height=4.0)]
    )
    model = import_scene(source, tmp_path / "a.xml", ImportOptions(crs="local", facades=PLAIN))
    want = sum(p.area * (h + FOOT) for p, h in zip(polygons, heights, strict=True)) + pair.area * 6.0
    # tol: float rounding
    assert volume(model) == pytest.approx(want, rel=1e-9)
    assert area_facing_up(model, "roofs") == pytest.approx(
        sum(p.area for p in polygons) + pair.area, rel=1e-9
    )
    high = [b.ridge for b in model.buildings]
    assert high[:5] == pytest.approx(heights)
    assert model.n_buildings == 7


@pytest.mark.parametrize("seed", SEEDS)
def test_pitched_roofs_have_the_volume_of_prism_and_pyramid(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 360.0)
    long, short, height, rise = rng.uniform([12, 6, 8, 2], [25, 11, 20, 5])
    house = shapely.affinity.rotate(shapely.box(0, 0, long, short), turn)
    options = ImportOptions(crs="local", facades=PLAIN)
    for shape, share in (("gabled", 0.5), ("pyramidal", 1 / 3)):
        tags = {"height": height, "roof:shape": shape, "roof:height": rise}
        model = import_scene(
            write_features(tmp_path / "a.geojson", [feature(house, 1, **tags)]),
            tmp_path / "a.xml",
            options,
            force=True,
        )
        want = long * short * (height - rise + FOOT + share * rise)
        assert volume(model) == pytest.approx(want, rel=1e-9)  # tol: float rounding
        # storeys end at the eaves: the default roof of 0.35 of the shorter side, at most half the house, stands on them
        source = write_features(
            tmp_path / "c.geojson", [feature(house, 1, **{"building:levels": 4, "roof:shape": shape})]
        )
        model = import_scene(source, tmp_path / "c.xml", options, force=True)
        assert model.buildings[0].eaves == pytest.approx(12.0)
        assert model.buildings[0].ridge == pytest.approx(12.0 + min(0.35 * short, 6.0))
    # the ridge is as long as the house, and along it unless across
    for across, length in ((False, long), (True, short)):
        tags = {"height": height, "roof:shape": "gabled", "roof:height": rise}
        tags |= {"roof:orientation": "across"} if across else {}
        source = write_features(tmp_path / "b.geojson", [feature(house, 1, **tags)])
        model = import_scene(source, tmp_path / "b.xml", options, force=True)
        roof = next(v for part, _, v, _ in model.parts if part == "roofs")
        ridge = roof[roof[:, 2] == roof[:, 2].max()]
        assert np.linalg.norm(np.ptp(ridge, axis=0)) == pytest.approx(length)


@pytest.mark.parametrize("seed", SEEDS)
def test_places_are_those_of_the_earth_to_a_centimetre(seed: int, tmp_path: Path) -> None:
    """What the scene file says of its frame puts the walls back on their longitude and latitude, by PROJ too."""
    from rasterio.warp import transform

    rng = np.random.default_rng(seed)
    lat, lon = rng.uniform(-70, 70), rng.uniform(-180, 180)
    spread = np.array([5000 / (111e3 * np.cos(np.radians(lat))), 5000 / 111e3])
    polygons = [
        shapely.box(
            *(p := np.array([lon, lat]) + rng.uniform(-1, 1, 2) * spread), *(p + rng.uniform(0.1, 0.4) * 1e-3)
        )
        for _ in range(4)
    ]
    source = write_features(tmp_path / "a.geojson", [feature(p, i, height=9) for i, p in enumerate(polygons)])
    import_scene(source, tmp_path / "a.xml")
    anchor = load_scene(tmp_path / "a.xml").radar.anchor
    model = import_scene(source, tmp_path / "a.xml", force=True)
    want = np.concatenate([np.asarray(p.exterior.coords) for p in polygons])
    flat = np.concatenate([np.asarray(b.polygon.exterior.coords) for b in model.buildings])
    points = np.column_stack([flat, np.zeros(len(flat))])
    geodetic = anchor.to_geodetic(points)
    off = np.degrees(geodetic[:, 1::-1]) - want
    off[:, 0] = (off[:, 0] + 180.0) % 360.0 - 180.0
    metres = np.radians(off) * 6.38e6
    assert np.abs(metres).max() < 0.01
    xyz = np.column_stack(transform("EPSG:4979", "EPSG:4978", want[:, 0], want[:, 1], geodetic[:, 2]))
    assert np.abs(xyz - anchor.to_ecef(points)).max() < 0.01


def test_a_building_is_an_object_and_its_parts_have_its_name(tmp_path: Path) -> None:
    houses = [
        feature(shapely.box(30.0 * i, 0, 30.0 * i + 12, 9), name, height=6) for i, name in enumerate("aab")
    ]
    source = write_features(tmp_path / "a.geojson", houses)
    import_scene(source, tmp_path / "a.xml", ImportOptions(crs="local", facades=PLAIN))
    scene = load_scene(tmp_path / "a.xml")
    assert set(scene.geometry.object_names) == {"way a", "way a (2)", "way b", "ground 0"}
    assert {"way a/walls", "way a (2)/roofs", "way b/walls"} <= set(scene.geometry.mesh_names)
    for number, name in enumerate(scene.geometry.object_names):
        corners = scene.geometry.vertices[scene.geometry.faces[scene.geometry.faces_of_object(number)]]
        # tol: footprints are metres; rounding
        assert name == "ground 0" or np.ptp(corners[..., 0]) == pytest.approx(12.0, abs=1e-6)


@pytest.mark.parametrize("turn", [0.0, 20.0, 44.0, 85.0])
def test_the_heading_along_most_walls_is_told(turn: float, tmp_path: Path) -> None:
    houses = [shapely.affinity.rotate(shapely.box(40 * i, 0, 40 * i + 12, 9), turn) for i in range(3)]
    houses.append(shapely.affinity.rotate(shapely.box(120, 60, 123, 64), turn + 30.0))
    source = write_features(tmp_path / "a.geojson", [feature(p, i, height=6) for i, p in enumerate(houses)])
    model = import_scene(source, tmp_path / "a.xml", ImportOptions(crs="local", facades=PLAIN))
    heading = round(-turn % 90.0)  # counter-clockwise turns are westward headings
    assert any(f"90 % of the walls run along or across heading {heading} deg" in note for note in model.notes)


def test_a_radar_laid_over_keeps_the_place(tmp_path: Path) -> None:
    source = write_features(tmp_path / "a.geojson", [feature(shapely.box(-60.1, 20, -60.0999, 20.0001), 1)])
    import_scene(source, tmp_path / "a.xml")
    for radar in ("airborne_x", "sentinel1_stripmap"):
        anchor = load_scene(tmp_path / "a.xml", radar=radar).radar.anchor
        assert np.degrees(anchor.latitude) == pytest.approx(20.00005)
        assert np.degrees(anchor.longitude) == pytest.approx(-60.09995)
    elsewhere = load_scene(
        tmp_path / "a.xml", radar="airborne_x", parameters={"sar_antenna.latitude_deg": "3"}
    )
    assert np.degrees(elsewhere.radar.anchor.latitude) == pytest.approx(3.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_facades_take_away_and_add_what_they_say(seed: int, tmp_path: Path) -> None:
    """Volume without windows' recesses, with balconies' troughs; the budget and the seed hold."""
    rng = np.random.default_rng(seed)
    house = shapely.affinity.rotate(shapely.box(0, 0, 30, 14), rng.uniform(0, 360))
    source = write_features(tmp_path / "a.geojson", [feature(house, 1, **{"building:levels": 6})])

    def build(**statistics: Any) -> Model:
        kinds = dict.fromkeys(("windows", "balconies", "pavements"), False)
        facades = FacadeOptions(seed=seed, spread=0.0, **kinds | statistics)
        return import_scene(
            source, tmp_path / "a.xml", ImportOptions(crs="local", facades=facades), force=True
        )

    solid = 30 * 14 * 18.5
    n = 6 * 2 * (round(30 / 3.2) + round(14 / 3.2))
    windows = build(windows=True, share=1.0)
    assert volume(windows) == pytest.approx(solid - n * 1.3 * 1.5 * 0.2)
    assert f"{n} windows" in " ".join(windows.notes)
    both = build(windows=True, balconies=True, share=1.0, balcony_share=1.0)
    # troughs have no side at the wall: closed by it, each wall's own plane as the origin of its flux
    bay = np.array([30 / round(30 / 3.2), 14 / round(14 / 3.2)]) - 2 * 0.15
    trough = bay * 1.2 * (0.18 + 1.0) - (bay - 2 * 0.12) * (1.2 - 0.12) * 1.0
    want = 5 * 2 * float(trough @ [round(30 / 3.2), round(14 / 3.2)])
    middle = np.asarray(house.centroid.coords)[0]
    axes = np.asarray(house.exterior.coords)[1:3] - np.asarray(house.exterior.coords)[:2]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    got = 0.0
    v, f = next((v, f) for part, _, v, f in both.parts if part == "balconies")
    for body in v[f].reshape(-1, 22, 3, 3):
        place = (body.mean(axis=(0, 1))[:2] - middle) @ axes.T
        half = 0.5 * np.array([np.ptp((np.asarray(house.exterior.coords) - middle) @ axis) for axis in axes])
        k = int(np.argmax(np.abs(place) - half))
        wall = np.append(middle + np.sign(place[k]) * half[k] * axes[k], 0.0)
        a, b, c = (body[:, i] - wall for i in range(3))
        got += float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
    assert got == pytest.approx(want)
    again = build(windows=True, balconies=True)
    first = {part: v for part, _, v, _ in again.parts}
    assert all((first[p] == v).all() for p, _, v, _ in build(windows=True, balconies=True).parts)


def test_plain_walls_are_the_same_whatever_the_seed(tmp_path: Path) -> None:
    source = write_features(tmp_path / "a.geojson", [feature(shapely.box(0, 0, 30, 14), 1)])
    files = []
    for seed in (1, 2):
        options = ImportOptions(crs="local", facades=FacadeOptions.read("none", seed, {}))
        import_scene(source, tmp_path / "a.xml", options, force=True)
        files.append([p.read_bytes() for p in sorted((tmp_path / "a_meshes").glob("*.ply"))])
    assert files[0] == files[1]


def test_footprints_have_windows_balconies_and_a_kerb_unless_told_otherwise(tmp_path: Path) -> None:
    """What the image shows of a house: points on the laid over facade, and a weaker line of the kerb before it."""
    house = feature(shapely.box(0, -12, 14, 12), 1, height=18)
    source = write_features(tmp_path / "a.geojson", [house])
    powers = {}
    for kinds in ("", "none", "kerb"):
        options = ImportOptions(crs="local", facades=FacadeOptions.read(kinds, 1, {}))
        model = import_scene(source, tmp_path / "a.xml", options, force=True)
        made = {part for part, *_ in model.parts}
        assert ("pavement" in made) == (kinds != "none") and ("balconies" in made) == (kinds == "")
        given = {"range_film.image_center_x": "-8", "range_film.image_extent_range": "70"}
        given |= {"range_film.image_extent_azimuth": "20"}
        image = render(load_scene(tmp_path / "a.xml", parameters=given))
        powers[kinds] = image.sigma0()
        x = (image.grid.positions() + image.grid.offset)[..., 0]
    # the wall x = 0 is laid over to x = -18 / tan(40 deg) = -21; its upper part, clear of the pavement
    wall = (x > -19.0) & (x < -6.0)
    bright = {kinds: float(np.mean(power[wall] > 1.0)) for kinds, power in powers.items()}
    assert bright["none"] == bright["kerb"] == 0.0 and bright[""] > 0.01
    # the edge of the pavement, 2 m before the wall: its riser and the ground form a corner
    kerb = np.abs(x + 2.0) < 0.5
    # tol: over the wall's laid over clutter; the mean of 50 cells of speckle varies by 0.6 dB
    assert np.mean(powers["kerb"][kerb]) > 4.0 * np.mean(powers["none"][kerb])


def test_large_cities_have_relief_about_the_origin_and_say_so(tmp_path: Path) -> None:
    houses = [
        feature(shapely.box(x, y, x + 12, y + 12), 1, height=12) for x in range(0, 200, 40) for y in (0, 40)
    ]
    source = write_features(tmp_path / "a.geojson", houses)

    def build(**more: Any) -> Model:
        options = ImportOptions(crs="local", anchor=Anchor(), facades=FacadeOptions(**more))
        return import_scene(source, tmp_path / "a.xml", options, force=True)

    whole, some = build(), build(limit=2000)
    assert some.parts.n_triangles < 0.5 * whole.parts.n_triangles
    relief = {p: v for p, _, v, _ in some.parts}
    near = np.hypot(*relief["windows"][:, :2].T).max()
    (said,) = [note for note in some.notes if "plain walls" in note]
    n_plain = int(said.split()[1])
    away = sorted(float(np.hypot(*shapely.geometry.shape(h["geometry"]).centroid.coords[0])) for h in houses)
    first_plain = away[len(houses) - n_plain]
    assert f"those from {first_plain:.3g} m of the origin on" in said and "limit = 2000" in said
    assert near < first_plain + 12.0 and 0 < n_plain < len(houses)
    assert not [note for note in whole.notes if "plain walls" in note]
    # the same walls as without the limit
    windows = {tuple(v) for v in next(v for p, _, v, _ in whole.parts if p == "windows").round(6).tolist()}
    assert {tuple(v) for v in relief["windows"].round(6).tolist()} <= windows
    # the pavement is around the houses with relief alone, one slab level with its kerb, closed but for its underside
    corners = relief["pavement"]
    assert np.hypot(*corners[:, :2].T).max() < first_plain + 12.0
    assert set(corners[:, 2].round(6)) == {0.12, -FOOT}
    model = build(pavement=3.0, windows=False, balconies=False)
    assert area_facing_up(model, "pavement") == pytest.approx(len(houses) * 18.0**2, rel=1e-6)


def write_raster(path: Path, heights: F64, west: float, north: float, step: float, crs: str) -> Path:
    from rasterio.transform import from_origin

    profile = {"driver": "GTiff", "height": heights.shape[0], "width": heights.shape[1], "count": 1}
    profile |= {"dtype": "float32", "crs": crs, "nodata": -9999.0}
    with rasterio.open(path, "w", transform=from_origin(west, north, step, step), **profile) as file:
        file.write(np.where(np.isnan(heights), -9999.0, heights).astype(np.float32), 1)
    return path


@pytest.mark.parametrize("seed", SEEDS)
def test_networks_keep_their_tolerance(seed: int) -> None:
    """Every sample against the triangle that it lies in, by its own arithmetic; areas without gaps or overlaps."""
    rng = np.random.default_rng(seed)
    shape = rng.integers(12, 40, 2)
    y, x = np.mgrid[: shape[0], : shape[1]]
    z = 8 * np.sin(x / rng.uniform(3, 9)) * np.cos(y / rng.uniform(3, 9)) + rng.normal(size=shape) * 0.05
    hole = rng.random() < 0.5
    if hole:
        z[4:7, 5:9] = np.nan
    net = network(z, 0.4)
    corners = np.column_stack([net.columns, net.rows]).astype(np.float64)
    worst, area = 0.0, 0.0
    for face in net.faces:
        matrix = np.column_stack([corners[face], np.ones(3)])
        area += 0.5 * abs(np.linalg.det(matrix))
        weights = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(matrix)
        inside = (weights > -1e-9).all(axis=-1)
        worst = max(worst, float(np.abs(weights @ z[net.rows[face], net.columns[face]] - z)[inside].max()))
    assert worst == pytest.approx(net.deviation)
    assert worst <= 0.4
    assert len(net.faces) < 2 * (shape[0] - 1) * (shape[1] - 1)
    # a hole of 3 x 4 samples takes the triangles that touch it: 2 x 3 squares whole, those around it at least in half
    full = (shape[0] - 1) * (shape[1] - 1)
    low, high = (full - 20, full - 6) if hole else (full, full)
    assert low - 1e-6 <= area <= high + 1e-6  # tol: float rounding


def test_buildings_stand_on_the_terrain(tmp_path: Path) -> None:
    """A slope of 10 % to the east in UTM: ground, height and place of a house, against PROJ."""
    from rasterio.warp import transform

    east, north = 691000.0, 5334000.0
    z = np.tile(500 + 0.1 * 5.0 * (np.arange(80) + 0.5), (80, 1))
    z[:3, :3] = np.nan
    dem = write_raster(tmp_path / "dem.tif", z, east, north, 5.0, "EPSG:32632")
    house = shapely.box(east + 200, north - 220, east + 220, north - 205)
    source = write_features(tmp_path / "a.geojson", [feature(house, 1, height=12)])
    options = ImportOptions(crs="EPSG:32632", dem=dem, geoid=45.0, tolerance=0.1)
    model = import_scene(source, tmp_path / "a.xml", options)
    (building,) = model.buildings
    assert model.anchor is not None
    base = model.anchor.to_geodetic([*building.polygon.exterior.coords[0], building.ground])
    x, y = transform("EPSG:4326", "EPSG:32632", [np.degrees(base[1])], [np.degrees(base[0])])
    assert min(abs(x[0] - east - 200), abs(x[0] - east - 220)) < 0.01
    assert min(abs(y[0] - north + 220), abs(y[0] - north + 205)) < 0.01
    # the lowest ground is at the west wall: 500 + 0.1 * 200, and the geoid
    assert base[2] == pytest.approx(
        500 + 20 + 45, abs=0.01
    )  # tol: the tangent plane leaves the ellipsoid by 2 mm
    assert building.ridge - building.ground == pytest.approx(12)
    assert building.foot == pytest.approx(building.ground - 0.6)
    ground = next(v for part, _, v, _ in model.parts if part == "ground")
    assert len(ground) < 100  # a plane needs few triangles
    alone = import_scene(dem, tmp_path / "dem.xml", ImportOptions(tolerance=0.1))
    assert any("9 samples have no height" in note for note in alone.notes)
    far = write_features(tmp_path / "far.geojson", [feature(shapely.box(11, 48, 11.001, 48.001), 1)])
    with pytest.raises(SceneError, match="does not cover the buildings"):
        import_scene(far, tmp_path / "far.xml", ImportOptions(dem=dem))


@pytest.mark.parametrize("turn", [0.0, -360.0])
def test_towns_on_the_antimeridian_are_as_elsewhere(turn: float, tmp_path: Path) -> None:
    """Houses on both sides of 180 deg, as GeoJSON writes them, on a raster of any turn: the town of 20 deg east."""
    rng = np.random.default_rng(5)
    step = 1e-4
    heights = rng.uniform(100.0, 120.0, (60, 80))
    west, north = -40 * step, -16.5 + 30 * step
    boxes = [
        shapely.box(x, y, x + 2e-4, y + 1e-4)
        for x, y in rng.uniform([-1e-3, -16.501], [1e-3, -16.499], (6, 2))
    ]
    models = []
    for name, longitude, around in (("here", 20.0, 20.0), ("there", 180.0, 180.0 + turn)):
        dem = write_raster(tmp_path / f"{name}.tif", heights, west + around, north, step, "EPSG:4326")
        houses = [
            shapely.transform(
                box, lambda xy, at=longitude: np.column_stack([(xy[:, 0] + at + 180) % 360 - 180, xy[:, 1]])
            )
            for box in boxes
        ]
        features = [feature(house, i, height=9) for i, house in enumerate(houses)]
        source = write_features(tmp_path / f"{name}.geojson", features)
        models.append(import_scene(source, tmp_path / f"{name}.xml", ImportOptions(dem=dem, tolerance=0.1)))
    here, there = models
    assert here.anchor is not None and there.anchor is not None
    turned = np.degrees(there.anchor.longitude - here.anchor.longitude) % 360.0
    assert turned == pytest.approx(160.0, abs=2e-8)  # tol: anchors are rounded to 1e-8 deg
    for (part, _, vertices, _), (_, _, others, _) in zip(here.parts, there.parts, strict=True):
        if part == "ground" or part == "walls":
            # tol: the rounding of the anchor, 1 mm, and of coordinates in the file
            assert np.abs(np.sort(vertices, axis=0) - np.sort(others, axis=0)).max() < 0.01, part


def test_guesses_of_materials_by_tags_are_said_in_a_line(tmp_path: Path) -> None:
    tags = ["brick", "Wet_Brick", "plutonium", "plutonium", "Ziegel", ""]
    boxes = [shapely.box(11.0 + 5e-4 * i, 48.0, 11.0002 + 5e-4 * i, 48.0001) for i in range(len(tags))]
    features = [
        feature(box, i, height=9, **({"building:material": tag} if tag else {}))
        for i, (box, tag) in enumerate(zip(boxes, tags, strict=True))
    ]
    source = write_features(tmp_path / "a.geojson", features)
    model = import_scene(source, tmp_path / "a.xml")
    said = [note for note in model.notes if "materials of walls" in note]
    assert said == [
        "a.geojson: assumed for 2 materials of walls with unknown names, concrete taken (first: plutonium)",
        "a.geojson: assumed for 1 materials of walls, brick by a word in the name (first: Wet_Brick)",
    ]
    chosen = import_scene(source, tmp_path / "b.xml", ImportOptions(materials={"walls": "wood"}))
    assert not any("materials of walls" in note for note in chosen.notes)


def test_openstreetmap_extract(tmp_path: Path) -> None:
    """A way, and a multipolygon of two ways joined with a hole."""
    places = [(0, 0), (0, 2), (2, 2), (2, 0), (5, 0), (9, 0), (9, 4), (5, 4), (6, 1), (7, 1), (7, 2), (6, 2)]
    nodes = "".join(
        f'<node id="{i}" lat="{10 + 1e-4 * y}" lon="{20 + 1e-4 * x}"/>' for i, (x, y) in enumerate(places)
    )

    def way(number: int, refs: list[int], tags: str = "") -> str:
        return f'<way id="{number}">{"".join(f"<nd ref={chr(34)}{r}{chr(34)}/>" for r in refs)}{tags}</way>'

    ways = way(1, [0, 1, 2, 3, 0], '<tag k="building" v="house"/><tag k="height" v="10"/>')
    ways += way(2, [4, 5, 6]) + way(3, [4, 7, 6]) + way(4, [8, 9, 10, 11, 8])
    members = "".join(
        f'<member type="way" ref="{r}" role="{o}"/>' for r, o in ((2, "outer"), (3, "outer"), (4, "inner"))
    )
    relation = (
        f'<relation id="5">{members}<tag k="type" v="multipolygon"/><tag k="building" v="yes"/></relation>'
    )
    path = tmp_path / "a.osm"
    path.write_text(f"<osm>{nodes}{ways}{relation}</osm>")
    model = import_scene(path, tmp_path / "a.xml")
    unit = model.buildings[0].polygon.area / 4.0
    assert [b.polygon.area / unit for b in model.buildings] == pytest.approx(
        [4.0, 15.0], rel=1e-4
    )  # tol: latitude
    assert model.buildings[0].ridge == 10.0


def citygml(polygons: str, crs: str = "urn:ogc:def:crs:EPSG::25832") -> str:
    spaces = 'xmlns:gml="http://www.opengis.net/gml" xmlns:b="http://www.opengis.net/citygml/building/2.0"'
    return (
        f'<CityModel {spaces}><gml:Envelope srsName="{crs}"/><b:Building gml:id="h1"><b:lod1Solid><gml:Solid>'
        f"{polygons}</gml:Solid></b:lod1Solid></b:Building></CityModel>"
    )


def test_citygml(tmp_path: Path) -> None:
    """A box of 20 m x 10 m x 7 m in UTM: its volume on the ground, outsides outwards, roof by its slope."""
    corners = np.array([[x, y, z] for z in (500, 507) for y in (0, 10) for x in (0, 20)], dtype=np.float64)
    corners += [691000, 5334000, 0]
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6]]
    rings = [" ".join(f"{v:.3f}" for v in corners[[*f, f[0]]].ravel()) for f in faces]
    text = "".join(
        f"<gml:Polygon><gml:exterior><gml:LinearRing><gml:posList>{r}</gml:posList></gml:LinearRing></gml:exterior></gml:Polygon>"
        for r in rings
    )
    path = tmp_path / "a.gml"
    path.write_text(citygml(text))
    model = import_scene(path, tmp_path / "a.xml")
    scale = 0.9996 * (1 + (191e3 / 6.38e6) ** 2 / 2)  # of UTM there
    # tol: the mean height over the ellipsoid adds 2 * 500 m / 6380 km
    assert volume(model) == pytest.approx(1400 / scale**2, rel=5e-4)
    assert area_facing_up(model, "roofs") == pytest.approx(200 / scale**2, rel=5e-4)
    path.write_text(citygml(text, crs="").replace('srsName=""', ""))
    with pytest.raises(SceneError, match="names no coordinate system"):
        import_scene(path, tmp_path / "b.xml")
    assert volume(
        import_scene(path, tmp_path / "b.xml", ImportOptions(crs="local"), force=True)
    ) == pytest.approx(1400)


def test_folder_of_meshes(tmp_path: Path) -> None:
    """Boxes in centimetres with y up, materials by file names and by choice; the scene loads with any radar."""
    from sarmitsuba.scene.mesh.tessellate import cube

    folder = tmp_path / "city"
    folder.mkdir()
    v, f = cube()
    for i, name in enumerate(("brick_house", "thing")):
        box = v * [500.0, 900.0, 400.0] + [3000.0 * i, 900.0, 0.0]
        write_ply(folder / f"{name}.ply", box, f)
    options = ImportOptions(unit="cm", up="y", materials={"thing": "metal"}, ground=True)
    model = import_scene(folder, tmp_path / "city.xml", options)
    assert volume(model) == pytest.approx(2 * 10 * 18 * 8)
    assert model.parts.bounds()[1, 2] == pytest.approx(18.0)
    assert [(part, material) for part, material, _, _ in model.parts][:2] == [
        ("brick_house", "brick"),
        ("thing", "metal"),
    ]
    assert "y up as asked, unit cm" in model.notes[0]
    scene = load_scene(tmp_path / "city.xml", radar="airborne_x")
    assert scene.geometry.n_faces == 26


def test_objects_of_meshes_stay_apart(tmp_path: Path) -> None:
    """All walls of a town became one shape; a folder's files are objects where they name none."""
    from tests.loading.test_mesh_readers import TWO_HOUSES

    folder = tmp_path / "city"
    folder.mkdir()
    (folder / "town.obj").write_text(TWO_HOUSES)
    (folder / "shed.obj").write_text("v 0 0 0\nv 0 1 0\nv 1 0 4\nf 1 2 3\n")
    import_scene(folder, tmp_path / "city.xml", ImportOptions(up="z"))
    geometry = load_scene(tmp_path / "city.xml", radar="airborne_x").geometry
    assert set(geometry.mesh_names) == {
        "Haus 1/brick",
        "Haus 1/tiles",
        "Haus 2 alt/brick",
        "Haus 3/brick",
        "shed/shed",
    }
    assert set(geometry.object_names) == {"Haus 1", "Haus 2 alt", "Haus 3", "shed"}


def test_materials_units_and_outlines_of_parts(tmp_path: Path) -> None:
    tags = {"building:material": "brick", "height": "40 ft"}
    block, half = shapely.box(0, 0, 20, 20), shapely.box(0, 0, 20, 10)
    parts = [
        {
            **feature(shapely.affinity.translate(half, 0, y), 5, height=h),
            "properties": {"building:part": "yes", "height": h},
        }
        for y, h in ((0, 10), (10, 20))
    ]
    source = write_features(
        tmp_path / "a.geojson",
        [feature(shapely.box(50, 0, 60, 10), 1, **tags), feature(block, 2, height=20), *parts],
    )
    model = import_scene(source, tmp_path / "a.xml", ImportOptions(crs="local", materials={"roofs": "metal"}))
    assert [b.wall for b in model.buildings] == ["brick", "concrete", "concrete"]
    assert {b.roof for b in model.buildings} == {"metal"}
    assert model.buildings[0].ridge == pytest.approx(12.192)
    assert any("left out 1 outlines of buildings that their parts describe" in note for note in model.notes)
    kept = import_scene(source, tmp_path / "b.xml", ImportOptions(crs="local", radius=30.0))
    assert kept.n_buildings == 2


TURN = np.arange(30_000) / 4774.7
CIRCLE = 1e-4 * np.column_stack([np.cos(TURN), np.sin(TURN)])
SQUARE = [[0, 0], [1e-4, 0], [1e-4, 1e-4], [0, 1e-4], [0, 0]]


def one(coordinates: object, kind: str = "Polygon", **properties: object) -> str:
    row = {"type": "Feature", "properties": {"building": "yes", **properties}}
    return json.dumps(
        {
            "type": "FeatureCollection",
            "features": [{**row, "geometry": {"type": kind, "coordinates": coordinates}}],
        }
    )


def far(ring: list[list[float]], code: int) -> str:
    """One outline in a named system."""
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{code}"}}
    return json.dumps({**json.loads(one([ring])), "crs": crs})


HOSTILE = {
    "cut off": ('{"type": "FeatureCollection", "features": [', "malformed JSON"),
    "not text": ("\udcc3(", "is not UTF-8 text"),
    "a number": ("17", "no GeoJSON"),
    "nested": ("[" * 100_000, "nested too deeply"),
    "nan": (one([SQUARE]).replace("0.0001", "NaN"), "no JSON number"),
    "crossing": (
        one([[[0, 0], [1e-4, 1e-4], [1e-4, 0], [0, 1e-4], [0, 0]]]),
        "1 outlines that intersect themselves",
    ),
    "huge": (one([[[1e300, 0], [1, 0], [1, 1], [1e300, 0]]]), "outlines|no longitude"),
    "beyond the map": (far([[1e19, 0], [1e19, 10], [1e19 + 1e4, 10], [1e19, 0]], 3857), "no place on a map"),
    "beyond the degrees": (far([[2e3, 0], [2001, 0], [2001, 1], [2e3, 0]], 4258), "no place on a map"),
    "400 digits": (
        one([[[0, 0], [1, 0], [1, 1], [0, 0]]]).replace("[1, 1]", f"[1, {'9' * 400}]"),
        "no JSON number|corners|without numbers",
    ),
    "infinite": (one([[[0, 0], [1, 0], [1, 1], [0, 0]]]).replace("[1, 1]", "[1e999, 1]"), "without numbers"),
    "metres": (
        one([[[691000, 5334000], [691010, 5334000], [691010, 5334010], [691000, 5334000]]]),
        "--crs EPSG:n",
    ),
    "a continent": (one([[[-80, 0], [80, 0], [80, 60], [-80, 60], [-80, 0]]]), "km from the scene's origin"),
    "two corners": (one([[[0, 0], [1, 1]]]), "without a ring of at least three corners"),
    "strings": (one([["a", "b"]]), "without a ring of at least three corners"),
    "deep rings": (one([[[[0, 0]]]]), "without a ring of at least three corners"),
    "a dict": (one({"a": 1}), "without an area"),
    "many corners": (one([CIRCLE.tolist()]), "more than 20000 corners"),
    "no features": ('{"type": "FeatureCollection", "features": 3}', "holds no building"),
    "null geometry": (
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": null}, 5]}',
        "no building",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_footprints_end_in_one_line(name: str, tmp_path: Path) -> None:
    text, message = HOSTILE[name]
    path = tmp_path / "a.geojson"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(SarmitsubaError, match=message) as caught:
        import_scene(path, tmp_path / "a.xml")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert not (tmp_path / "a.xml").exists()
    assert not [p for p in tmp_path.iterdir() if p != path]


@pytest.mark.parametrize("step", [1e300, 1e15, float("nan")])
def test_rasters_beyond_the_map_end_in_one_line(step: float, tmp_path: Path) -> None:
    """PROJ would take time in proportion to the coordinates, ten minutes and more."""
    path = write_raster(tmp_path / "a.tif", np.ones((4, 5)), 0.0, 0.0, step, "EPSG:3857")
    with pytest.raises(
        SceneError, match=r"no place on a map|has no coordinate system|no readable raster"
    ) as caught:
        import_scene(path, tmp_path / "a.xml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("heights", [np.full((4, 5), np.nan), np.ones((1, 1)), np.ones((4, 1)), None])
def test_an_empty_raster_under_footprints_ends_in_one_line(heights: F64 | None, tmp_path: Path) -> None:
    source = write_features(tmp_path / "a.geojson", [feature(shapely.box(11, 48, 11.0001, 48.0001), 1)])
    path = tmp_path / "dem.tif"
    if heights is None:
        path.write_bytes(b"")
    else:
        write_raster(path, heights, 10.9999, 48.0002, 1e-4, "EPSG:4326")
    with pytest.raises(SceneError, match=r"no sample between|does not cover|no readable raster") as caught:
        import_scene(source, tmp_path / "a.xml", ImportOptions(dem=path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<!DOCTYPE x [<!ENTITY a "aaaa">]><osm>&a;</osm>', "declares a document type"),
        ('<!DOCTYPE x SYSTEM "file:///etc/passwd"><osm/>', "declares a document type"),
        ("<osm>&a;</osm>", "malformed XML"),
        (
            '<osm><node id="7" lat="nan" lon="1"/><way id="1"><nd ref="7"/><tag k="building" v="yes"/></way></osm>',
            "with missing or malformed corners",
        ),
        ("<osm", "malformed XML"),
        ("", "malformed XML"),
        ("<html/>", "not <osm>"),
        (
            '<osm><way id="1"><nd ref="7"/><nd ref="7"/><tag k="building" v="yes"/></way></osm>',
            "missing or malformed corners",
        ),
        ('<osm><way id="1"><tag k="building" v="yes"/></way></osm>', "missing or malformed corners"),
    ],
)
def test_hostile_xml_ends_in_one_line(text: str, message: str, tmp_path: Path) -> None:
    for encoding in ("utf-8", "utf-16"):
        path = tmp_path / "a.osm"
        path.write_bytes(text.encode(encoding) if text else b"")
        with pytest.raises(SceneError, match=message) as caught:
            import_scene(path, tmp_path / "a.xml")
        assert "\n" not in str(caught.value)


def test_odd_heights_are_said_and_not_believed(tmp_path: Path) -> None:
    odd: list[object] = ["tall", -3, "nan", 1e9, [5], True, "12 storeys"]
    features = [feature(shapely.box(30 * i, 0, 30 * i + 10, 10), i, height=h) for i, h in enumerate(odd)]
    upside_down = feature(shapely.box(0, 50, 10, 60), 99, height=5, min_height=6)
    model = import_scene(
        write_features(tmp_path / "a.geojson", [*features, upside_down]),
        tmp_path / "a.xml",
        ImportOptions(crs="local"),
    )
    assert {b.ridge for b in model.buildings} == {8.0}
    assert model.n_buildings == len(odd)
    said = " ".join(model.notes)
    assert f"assumed for {len(odd)} buildings without a height, 8 m taken (first: way/0)" in said
    assert "left out 1 buildings whose min_height is not below their height (first: way/99)" in said


def test_command(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    """The scene is written, what was found is said, and nothing is replaced unasked."""
    monkeypatch.chdir(tmp_path)
    write_features(tmp_path / "a.geojson", [feature(shapely.box(11.5, 48.1, 11.5002, 48.1001), 1, height=9)])
    command = [
        "import",
        "a.geojson",
        "-o",
        "b.xml",
        "--material",
        "walls=brick",
        "--facades",
        "windows",
        "--seed",
        "4",
    ]
    assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "1 buildings on" in said
    assert "windows and 0 balconies, seed 4" in said and "kerb" not in said
    plain = ["import", "a.geojson", "-o", "plain.xml"]
    assert cli.main(plain) == 0
    said = capsys.readouterr().out
    assert "a kerb of 0.12 m" in said and "--facades none leaves walls plain" in said
    assert cli.main([*plain, "--force", "--facades", "none"]) == 0
    assert "facades" not in capsys.readouterr().out
    assert cli.main(command) == 2
    assert "already exists" in capsys.readouterr().err
    assert cli.main([*command, "--force", "--anchor", "48.1,11.5,600"]) == 0
    anchor = load_scene(tmp_path / "b.xml").radar.anchor
    assert anchor == Anchor.of_degrees(48.1, 11.5, 600.0)
    for wrong, line in (
        (["--material", "wall=brick"], 'no material "wall"'),
        (["--material", "walls=bric"], "no known material"),
        (["--facades", "window"], 'did you mean "windows"'),
        (["--facades", "windows,none"], "or none alone"),
        (["--facades", "none", "--facade", "bay=3"], "not of none"),
        (["--facades", "windows", "--facade", "bay=x"], "is no number"),
        (["--facades", "windows", "--facade", "bay=0"], "outside 1 to 50"),
        (["--height", "nan"], "outside 0.1 to 2000"),
        (["--unit", "furlong"], 'unit "furlong" is unknown'),
        (["--dem", "none.tif"], "no readable raster"),
        (["--crs", "EPSG:1"], "cannot be converted"),
        (["--anchor", "10,10"], "km from the scene's origin"),
        (["--anchor", "10,10", "--radius", "100"], "1 buildings beyond the radius"),
    ):
        assert cli.main([*command, "--force", *wrong]) == 2
        error = capsys.readouterr().err
        assert line in error
        assert error.count("\n") == 1
    for source in ("none.geojson", "x" * 5000 + ".osm", "."):
        assert cli.main(["import", source, "-o", "c.xml"]) == 2
        assert len(capsys.readouterr().err) < 300
    with pytest.raises(OutputError, match=r"ends in \.xml"):
        import_scene(tmp_path / "a.geojson", tmp_path / "b.txt")


def test_text_that_memory_cannot_hold_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers of one digit in pairs take 14 times the file's size, empty XML elements 26 times."""
    from sarmitsuba.machine import memory

    monkeypatch.setattr(memory, "free_memory", lambda: 1_000_000)
    texts = {
        "a.geojson": '{"type": "FeatureCollection", "features": [' + "[1,1]," * 20_000 + "[1,1]]}",
        "a.osm": "<osm>" + "<a/>" * 20_000 + "</osm>",
    }
    for name, text in texts.items():
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(
            SarmitsubaError, match=r"reading its .* needs .* of memory, and 1 MB are free; cut"
        ):
            import_scene(path, tmp_path / "o.xml", ImportOptions())


def test_outlines_of_too_many_corners_are_left_out_without_being_converted(tmp_path: Path) -> None:
    ring = [[8.0, 50.0]] * 20_001
    path = write_features(
        tmp_path / "a.geojson",
        [
            {
                "type": "Feature",
                "properties": {"height": 9},
                "geometry": {"type": "Polygon", "coordinates": [ring]},
            }
        ],
    )
    with pytest.raises(SceneError, match="1 outlines of more than 20000 corners"):
        import_scene(path, tmp_path / "o.xml", ImportOptions())


def test_links_to_nowhere_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, words in (
        ("city.geojson", ["import", "-o", str(tmp_path / "o.xml")]),
        ("scene.xml", ["render", "-o", str(tmp_path / "o")]),
        ("image.tif", ["picture", "-o", str(tmp_path / "o.png")]),
    ):
        (tmp_path / name).symlink_to(tmp_path / "gone")
        assert cli.main([words[0], str(tmp_path / name), *words[1:]]) == 2
        assert "is a link to a file that does not exist" in capsys.readouterr().err
