"""Images on maps: pixels land on their latitude and longitude, outlines are where the corners are."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.files import write_image
from sarmitsuba.files.geocoding import map_zone, outlines
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from tests.support.draws import few_of
from tests.support.geometries import singular_place

MEAN_RADIUS = 6371008.8


def drawn(seed: int, kind: str) -> tuple[SarImage, tuple[int, int]]:
    """A dark image with one bright spot of 5 x 5 pixels; place, heading, side, sizes and height drawn.

    Images of odd seeds lie at an edge of maps, such as the antimeridian or a pole.
    """
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    across = np.array([along[1], -along[0], 0.0]) * rng.choice([-1.0, 1.0])
    shape = tuple(int(n) for n in rng.integers(60, 120, 2))
    height = rng.uniform(-20.0, 60.0)
    step = rng.uniform(0.4, 2.0, 2)
    azimuth, ranges = ((np.arange(n) - n // 2) * d for n, d in zip(shape, step, strict=True))
    origin = np.array([*rng.uniform(-500, 500, 2), height])
    if kind == "slant":
        origin = origin - 5000.0 * across + np.array([0.0, 0.0, 5000.0])
        ranges = ranges + np.hypot(5000.0, 5000.0)
    anchor = Anchor.of_degrees(rng.uniform(-79, 83), rng.uniform(-180, 180), rng.uniform(0, 1500))
    offset = np.round(rng.uniform(-5e3, 5e3, 3))
    if seed % 2:
        anchor, offset, origin = singular_place(rng, 50.0), np.zeros(3), origin - [*origin[:2], 0.0]
        if kind == "slant":
            origin = origin - 5000.0 * across
    grid = ImageGrid(kind, azimuth, ranges, origin, along, across, height, offset, anchor=anchor)
    spot = (int(rng.integers(10, shape[0] - 10)), int(rng.integers(10, shape[1] - 10)))
    data = np.full((1, *shape), 0.01, np.complex64)
    data[0, spot[0] - 2 : spot[0] + 3, spot[1] - 2 : spot[1] + 3] = 1.0
    return SarImage(data, (Layer("VV"),), grid, 0.03, 1.0, 1.0, np.full(shape[1], 0.7)), spot


@pytest.mark.parametrize("kind", ["ground", "slant"])
@pytest.mark.parametrize("seed", few_of(range(5)))
def test_a_bright_spot_is_on_its_place_of_the_map(seed: int, kind: str, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="writes GeoTIFF; in the extra formats")
    warp = pytest.importorskip("rasterio.warp")
    image, spot = drawn(seed, kind)
    write_image(image, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        band = file.read(1).astype(np.float64)
        weight = np.where(np.nan_to_num(band) > 0.3 * np.nanmax(band), np.nan_to_num(band), 0.0)
        rows, columns = np.indices(band.shape)
        row, column = ((weight * v).sum() / weight.sum() for v in (rows, columns))
        x, y = (
            file.transform @ (column + 0.5, row + 0.5)
            if hasattr(file.transform, "__matmul__")
            else file.transform
            * (
                column + 0.5,
                row + 0.5,
            )
        )
        (longitude,), (latitude,) = warp.transform(file.crs, "EPSG:4326", [x], [y])
        spacing = file.transform.a
        assert file.descriptions == ("VV",) and np.isnan(file.nodata)
        # outside stays empty, and nothing inside does
        assert 0.2 < np.isfinite(band).mean() <= 1.0
    want = image.grid.geodetic()[spot]
    off = np.array(
        [np.radians(latitude) - want[0], (np.radians(longitude) - want[1] + np.pi) % (2 * np.pi) - np.pi]
    )
    # tol: the spot's middle is found to a tenth of its five pixels; a third of a map pixel
    assert np.hypot(off[0], off[1] * np.cos(want[0])) * MEAN_RADIUS < 0.35 * spacing + 0.1


def test_overviews_and_levels(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="writes GeoTIFF; in the extra formats")
    n = 700
    axis = np.arange(n) * 0.5
    grid = ImageGrid(
        *("ground", axis, axis, np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])),
        anchor=Anchor.of_degrees(48.0, 11.5),
    )
    rng = np.random.default_rng(0)
    data = (rng.normal(size=(1, n, n)) + 1j * rng.normal(size=(1, n, n))).astype(np.complex64)
    image = SarImage(data, (Layer("VV"),), grid, 0.03, 1.0, 1.0, np.full(n, 0.7))
    write_image(image, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.overviews(1) and file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        power = np.nanmean(file.read(1).astype(np.float64) ** 2)
    # tol: linear interpolation of power between pixels keeps its mean
    assert power == pytest.approx(image.sigma0().mean(), rel=0.02)


def rings_of(path: Path) -> list[np.ndarray]:
    """Rings (n, 3) of a file of an outline."""
    if path.suffix == ".kml":
        texts = [element.text for element in ET.parse(path).iterfind(".//{*}coordinates")]
        return [np.array([[float(v) for v in part.split(",")] for part in text.split()]) for text in texts]
    geometry = json.loads(path.read_text())["geometry"]
    parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    return [np.array(ring) for (ring,) in parts]


def check_outline(image: SarImage, rings: list[np.ndarray]) -> None:
    """Rings follow the image's rim, are those of RFC 7946, and hold as much ground as the image."""
    grid = image.grid.in_frame(np.zeros(3))
    finest = min(grid.azimuth_spacing, grid.range_spacing)
    across = grid.across_distance()
    # tol: half a pixel in slant range is not half a step between pixels on the ground
    half = 0.5 * np.array([grid.azimuth_spacing, np.diff(across).mean()])
    low, high = np.array([grid.azimuth[0], across[0]]) - half, np.array([grid.azimuth[-1], across[-1]]) + half
    area = 0.0
    for ring in rings:
        assert (ring[0] == ring[-1]).all() and len(ring) >= 4
        assert np.abs(ring[:, 0]).max() <= 180.0 and np.abs(ring[:, 1]).max() <= 90.0
        start, step = ring[:-1], np.diff(ring, axis=0)
        turn = np.sum(ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1])
        assert turn > 0.0  # anticlockwise, as RFC 7946 wants
        line = start[:, None] + np.linspace(0.0, 1.0, 41)[:, None] * step[:, None]
        line = line.reshape(-1, 3)
        ground = image.anchor.from_geodetic(np.column_stack([np.radians(line[:, [1, 0]]), line[:, 2]]))
        area += 0.5 * np.sum(ground[:-1, 0] * ground[1:, 1] - ground[1:, 0] * ground[:-1, 1])
        offset = ground - grid.origin
        place = np.column_stack([offset @ grid.along, offset @ grid.across])
        inside = np.minimum(place - low, high - place).min(axis=1)  # negative outside
        cut = (np.abs(line[:, 0]) > 180.0 - 1e-9) | (np.abs(line[:, 1]) == 90.0)
        assert inside[cut].min(initial=0.0) > -0.1 * finest
        assert np.abs(inside[~cut]).max() < 0.1 * finest
    size = np.prod(high - low)
    assert area == pytest.approx(size, abs=0.1 * finest * 2.0 * (high - low).sum())


@pytest.mark.parametrize("kind", ["ground", "slant"])
@pytest.mark.parametrize("seed", range(12))
def test_outlines_follow_the_image_at_every_place(seed: int, kind: str, tmp_path: Path) -> None:
    image, _ = drawn(seed, kind)
    for suffix in (".geojson", ".kml"):
        write_image(image, tmp_path / f"outline{suffix}")
        check_outline(image, rings_of(tmp_path / f"outline{suffix}"))


@pytest.mark.parametrize(
    ("latitude", "longitude", "parts"),
    [
        (-77.9, 179.9995, 2),
        (10.0, -180.0, 2),
        (90.0, 30.0, 1),
        (-90.0, 0.0, 1),
        (45.0, 179.9, 1),
        (89.0, 0.0, 1),
    ],
)
def test_outlines_do_not_run_round_the_earth(latitude: float, longitude: float, parts: int) -> None:
    """A large image, whose edges are curves of longitude and latitude: 10 km, with pixels of 1 m."""
    axis = np.arange(-5000.0, 5000.0)
    grid = ImageGrid(
        *("ground", axis, axis, np.zeros(3), np.array([0.6, 0.8, 0.0]), np.array([0.8, -0.6, 0.0])),
        anchor=Anchor.of_degrees(latitude, longitude),
    )
    image = SarImage(np.ones((1, 1, 1), np.complex64), (Layer("VV"),), grid, 0.03, 1.0, 1.0, np.full(1, 0.7))
    rings = outlines(grid)
    assert len(rings) == parts
    check_outline(image, rings)


@pytest.mark.parametrize(
    ("latitude", "longitude", "zone"),
    [
        *((-77.9, 179.9995, 32760), (-77.9, 180.0, 32701), (-77.9, -180.0, 32701), (0.0, 0.0, 32631)),
        *((60.0, 2.9, 32631), (60.0, 3.1, 32632), (64.0, 3.1, 32631), (55.9, 5.0, 32631)),
        *((78.0, 8.9, 32631), (78.0, 9.0, 32633), (78.0, 20.9, 32633), (78.0, 21.0, 32635)),
        *((78.0, 33.0, 32637), (78.0, 41.9, 32637), (78.0, 42.0, 32638), (71.9, 8.0, 32632)),
        *((84.1, 10.0, 32661), (84.0, 10.0, 32633), (-80.1, 10.0, 32761), (-80.0, 10.0, 32732)),
    ],
)
def test_zones_of_maps(latitude: float, longitude: float, zone: int) -> None:
    assert map_zone(longitude, latitude) == zone == map_zone(longitude - 360.0, latitude)


def test_images_without_a_place_say_so(tmp_path: Path) -> None:
    image, _ = drawn(0, "ground")
    nowhere = replace(image, grid=replace(image.grid, anchor=Anchor(height=300.0)))
    for suffix in (".geojson", ".kml", ".tif"):
        with pytest.warns(
            SarmitsubaWarning, match=r"no place on the Earth: .* latitude_deg and longitude_deg"
        ):
            write_image(nowhere, tmp_path / f"map{suffix}")


def test_labelled_arrays_hold_the_channels_and_their_axes() -> None:
    pytest.importorskip("xarray", reason="labelled arrays; in the extra formats")
    image, spot = drawn(0, "slant")
    array = image.to_xarray()
    assert array.dims == ("channel", "azimuth", "range") and array.attrs["units"] == "m"
    assert np.array_equal(array.sel(channel="VV").values, image.total("VV"))
    latitude, longitude, _ = image.grid.geodetic()[spot]
    assert float(array.latitude[spot]) == pytest.approx(np.degrees(latitude), abs=1e-12)
    assert float(array.longitude[spot]) == pytest.approx(np.degrees(longitude), abs=1e-12)
    radar = ideal_radar(n_samples=64, resolution=3.0)
    raw = ideal_echoes(radar, [0.0, 0.0, 0.0])
    echoes = raw.to_xarray()
    assert echoes.dims == ("channel", "pulse", "sample")
    brightest = np.unravel_index(np.abs(echoes.values[0]).argmax(), echoes.shape[1:])
    distance = np.linalg.norm([echoes[f"position_{name}"][brightest[0]] for name in ("east", "north", "up")])
    assert float(echoes.slant_range[brightest]) == pytest.approx(distance, abs=radar.window.sample_spacing)
