"""Images on maps: pixels land on their latitude and longitude, outlines are where the corners are."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.echo.raw_data import Layer
from sarmitsuba.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.io import write_image
from sarmitsuba.radar.geodesy import Anchor
from tests.support.draws import few_of

MEAN_RADIUS = 6371008.8


def drawn(seed: int, kind: str) -> tuple[SarImage, tuple[int, int]]:
    """A dark image with one bright spot of 5 x 5 pixels; place, heading, side, sizes and height drawn."""
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
    grid = ImageGrid("ground", axis, axis, np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    rng = np.random.default_rng(0)
    data = (rng.normal(size=(1, n, n)) + 1j * rng.normal(size=(1, n, n))).astype(np.complex64)
    image = SarImage(data, (Layer("VV"),), grid, 0.03, 1.0, 1.0, np.full(n, 0.7))
    write_image(image, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.overviews(1) and file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        power = np.nanmean(file.read(1).astype(np.float64) ** 2)
    # tol: linear interpolation of power between pixels keeps its mean
    assert power == pytest.approx(image.sigma0().mean(), rel=0.02)


@pytest.mark.parametrize("kind", ["ground", "slant"])
def test_outlines_hold_the_corners(kind: str, tmp_path: Path) -> None:
    image, _ = drawn(3, kind)
    write_image(image, tmp_path / "outline.geojson")
    write_image(image, tmp_path / "outline.kml")
    (ring,) = json.loads((tmp_path / "outline.geojson").read_text())["geometry"]["coordinates"]
    ring = np.array(ring)
    assert ring.shape == (5, 3) and (ring[0] == ring[-1]).all()
    east, north = ring[:, 0] * np.cos(np.radians(ring[0, 1])), ring[:, 1]
    area = 0.5 * np.sum(east[:-1] * north[1:] - east[1:] * north[:-1])
    assert area > 0.0  # anticlockwise, as RFC 7946 wants
    corners = image.grid.geodetic()[[0, 0, -1, -1], [0, -1, -1, 0]]
    for corner in corners:
        off = np.radians(ring[:4, :2]) - corner[[1, 0]]
        metres = np.hypot(off[:, 0] * np.cos(corner[0]), off[:, 1]) * MEAN_RADIUS
        # tol: outlines are half a pixel outside of the middles of pixels
        assert metres.min() < np.hypot(image.grid.azimuth_spacing, image.grid.range_spacing)
    text = ET.parse(tmp_path / "outline.kml").find(".//{*}coordinates").text
    kml = np.array([[float(v) for v in part.split(",")] for part in text.split()])
    assert np.abs(kml - ring).max() < 1e-3 and np.abs(kml[:, :2] - ring[:, :2]).max() < 1e-8


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
