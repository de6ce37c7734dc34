"""A point is at its place in every file format, read as the format's own readers do, and in every average of pixels."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import OpenEXR
import pytest
import scipy.io
from matplotlib.figure import Figure

from sarmitsuba.analysis.interferometry import block_grid
from sarmitsuba.analysis.polarimetry import average_pixels
from sarmitsuba.core.arrays import F64
from sarmitsuba.files import FORMATS, write_image, write_raw
from sarmitsuba.files.geocoding import north_up
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.simulation.execution.error_bars import estimate_error
from sarmitsuba.view import quicklook as pictures
from sarmitsuba.view.display import PictureOptions, prepare
from tests.support.geometries import singular_place
from tests.support.unweighted import focus

# in the file's frame, m, and the side of a pixel
Place = tuple[F64, float]
LIGHT = 299792458.0
SEEDS = [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 24))]
# tol: a twentieth of a pixel, what a user may expect of any file
SHARE = 0.05


def drawn(seed: int) -> tuple[RawData, SarImage, F64]:
    """Echoes and image of a point, in slant range and on the ground by turns; and its place in the file's frame.

    Heading, side, look, place on the Earth, offset, and pixels of unequal and odd ratios drawn; every second place is
    at an edge of maps, such as the antimeridian or a pole.
    """
    rng = np.random.default_rng([seed, 7])
    radar = ideal_radar(
        slant_range=rng.uniform(8e3, 15e3),
        resolution=rng.uniform(0.8, 1.5),
        look_angle=np.radians(rng.uniform(25.0, 55.0)),
        n_samples=128,
    )
    side = ("left", "right")[rng.integers(2)]
    heading = rng.uniform(0.0, 2.0 * np.pi)
    c, s = np.cos(heading), np.sin(heading)
    turn = np.diag([1.0 if side == "right" else -1.0, 1.0, 1.0]) @ np.array(
        [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    )
    track, p = radar.track, radar.pointing
    radar = replace(
        radar,
        track=Track(track.time, track.position @ turn, track.velocity @ turn),
        pointing=Pointing(p.boresight @ turn, p.azimuth_axis @ turn, p.elevation_axis @ turn),
        look_side=side,
        anchor=Anchor.of_degrees(rng.uniform(-80, 80), rng.uniform(-180, 180), rng.uniform(-50, 2000)),
        offset=np.round(rng.uniform(-900, 900, 3)),
    )
    if seed // 2 % 2 == 0:
        radar = replace(radar, anchor=singular_place(rng, 12.0), offset=np.zeros(3))
    point = np.array([*rng.uniform(-4.0, 4.0, 2), 0.0])
    raw = ideal_echoes(radar, point, 4.0, 0.7)
    steps = rng.permutation([0.5, rng.uniform(0.12, 0.5)])
    center, sides = rng.uniform(-3.0, 3.0, 2), rng.uniform(24.0, 27.0, 2)
    kind = ("ground", "slant")[seed % 2]
    request = ImageRequest(kind, *center, 0.0, *sides, *steps, offset=tuple(radar.offset))
    return raw, focus(raw, request=request, focuser="backprojection"), point + radar.offset


def middle(power: F64) -> tuple[float, float]:
    """Row and column of the centre of power, its own window moved onto it."""
    power = np.nan_to_num(np.asarray(power, dtype=np.float64))
    row, column = (float(v) for v in np.unravel_index(int(power.argmax()), power.shape))
    rows, columns = np.indices(power.shape)
    for _ in range(30):
        weight = power * np.exp(-(((rows - row) / 4.0) ** 2) - ((columns - column) / 4.0) ** 2)
        row, column = (float((weight * v).sum() / weight.sum()) for v in (rows, columns))
    return row, column


def finest(image: SarImage) -> float:
    """The shorter side of a pixel, m."""
    return min(image.grid.azimuth_spacing, image.grid.range_spacing)


def on_axes(grid: dict[str, F64], azimuth: float, distance: float, kind: str) -> F64:
    """Place of a pixel, as docs/files.md says."""
    x, y, z = grid["origin"]
    across = np.sqrt(distance**2 - (z - grid["height"]) ** 2) if kind == "slant" else distance
    return np.array([x, y, float(grid["height"])]) + azimuth * grid["along"] + float(across) * grid["across"]


def of_hdf5(path: Path, image: SarImage) -> Place:
    with h5py.File(path) as file:
        grid = {name: file[f"grid/{name}"][()] for name in file["grid"]}
        kind, power = file["grid"].attrs["kind"], np.abs(file["image/VV"][()]) ** 2
    row, column = middle(power)
    place = [np.interp(v, np.arange(grid[n].size), grid[n]) for v, n in ((row, "azimuth"), (column, "range"))]
    return on_axes(grid, *place, kind if isinstance(kind, str) else kind.decode()), finest(image)


def of_openexr(path: Path, image: SarImage) -> Place:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = dict(file.header())
        planes = {name: channel.pixels for name, channel in file.channels().items()}
    row, column = middle(planes["VV.re"].astype(np.float64) ** 2 + planes["VV.im"].astype(np.float64) ** 2)
    azimuth, distance = (
        header[name][0] + header[name][1] * at
        for name, at in (("row_azimuth_m", row), ("column_range_m", column))
    )
    grid = {name: header[name] for name in ("along", "across")}
    grid |= {"origin": header["origin_m"], "height": header["image_plane_origin_m"][2]}
    return on_axes(grid, azimuth, distance, header["grid"]), finest(image)


def of_geotiff(path: Path, image: SarImage) -> Place:
    rasterio = pytest.importorskip("rasterio", reason="reads GeoTIFF; in the extra formats")
    warp = pytest.importorskip("rasterio.warp")
    with rasterio.open(path) as file:
        row, column = middle(file.read(1).astype(np.float64) ** 2)
        x, y = rasterio.transform.xy(file.transform, row, column)
        pixel = file.transform.a
        (longitude,), (latitude,) = warp.transform(file.crs, "EPSG:4326", [x], [y])
    height = image.anchor.to_geodetic(image.grid.in_frame(np.zeros(3)).positions()[0, 0])[2]
    return image.anchor.from_geodetic([np.radians(latitude), np.radians(longitude), height]), pixel


def of_sicd(path: Path, image: SarImage) -> Place:
    sicd = pytest.importorskip("sarkit.sicd", reason="reads SICD; in the extra formats")
    projection = pytest.importorskip("sarkit.sicd.projection")
    with path.open("rb") as file, sicd.NitfReader(file) as reader:
        tree, pixels = reader.metadata.xmltree, np.asarray(reader.read_image()).astype(np.complex64)
    helper, model = sicd.XmlHelper(tree), projection.MetadataParams.from_xml(tree)
    scp = helper.load("{*}ImageData/{*}SCPPixel")
    spacing = [helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}SS") for name in ("Row", "Col")]
    sets = projection.compute_projection_sets(model, (np.array(middle(np.abs(pixels) ** 2)) - scp) * spacing)
    anchor = image.anchor
    ground = anchor.to_ecef([0.0, 0.0, image.grid.in_frame(np.zeros(3)).height])
    place = projection.r_rdot_to_ground_plane_mono(model.LOOK, sets, ground, anchor.axes[2])
    return anchor.from_ecef(place), min(spacing)


def of_outline(rings: list[F64], image: SarImage) -> Place:
    """Where the image's own point is within the outline, whose corners are half a pixel outside."""
    ring = np.concatenate(rings)
    corners = image.anchor.from_geodetic(np.column_stack([np.radians(ring[:, [1, 0]]), ring[:, 2]]))
    grid = image.grid.in_frame(np.zeros(3))
    pixels = grid.positions()
    low, near, far = (
        corners[np.linalg.norm(corners - pixels[at], axis=1).argmin()] for at in ((0, 0), (0, -1), (-1, 0))
    )
    row, column = middle(np.abs(image.total()) ** 2)
    distance = grid.range[0] + grid.range_spacing * np.array([-0.5, column, grid.range.size - 0.5])
    if grid.kind == "slant":
        distance = np.sqrt(distance**2 - (grid.origin[2] - grid.height) ** 2)
    share = (distance[1] - distance[0]) / (distance[2] - distance[0])
    return low + (row + 0.5) / grid.shape[0] * (far - low) + share * (near - low), finest(image)


def of_geojson(path: Path, image: SarImage) -> Place:
    geometry = json.loads(path.read_text())["geometry"]
    parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    return of_outline([np.array(ring) for (ring,) in parts], image)


def of_kml(path: Path, image: SarImage) -> Place:
    texts = [element.text for element in ET.parse(path).iterfind(".//{*}coordinates")]
    return of_outline(
        [np.array([[float(v) for v in part.split(",")] for part in text.split()]) for text in texts], image
    )


IMAGES: dict[str, Callable[[Path, SarImage], Place]] = {
    "hdf5": of_hdf5,
    "openexr": of_openexr,
    "geotiff": of_geotiff,
    "sicd": of_sicd,
    "geojson": of_geojson,
    "kml": of_kml,
}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_point_is_at_its_place_in_every_image_format(seed: int, tmp_path: Path) -> None:
    _, image, truth = drawn(seed)
    # a product of Sentinel-1 holds images from orbit alone: tests/files/test_safe.py
    own = set(FORMATS.own_names) - {"safe"}
    formats = [entry for entry in FORMATS if entry.write_image and entry.name in own]
    assert {entry.name for entry in formats} == set(IMAGES)  # a new format needs a reader here
    for entry in formats:
        path = tmp_path / f"point{entry.suffixes[0]}"
        write_image(image, path, format=entry.name)
        place, pixel = IMAGES[entry.name](path, image)
        assert np.linalg.norm((place - truth)[:2]) < SHARE * pixel, (entry.name, place - truth, pixel)


def summed(raw_samples: F64, frequency: F64, late: Callable[[F64], F64], around: F64) -> F64:
    """Place (3,) on the plane z of ``around`` where the bare samples add up to most: the peak of a parabola."""
    step = 0.2  # m, of a cell of about one

    def power(x: float, y: float) -> float:
        phase = 2.0 * np.pi * frequency * late(around + np.array([x, y, 0.0]))[:, None]
        return float(np.abs((raw_samples * np.exp(1j * phase)).sum()) ** 2)

    values = np.log([[power(step * i, step * j) for j in (-1, 0, 1)] for i in (-1, 0, 1)])
    # log power = a + g . x + x H x / 2 about its middle
    g = np.array([values[2, 1] - values[0, 1], values[1, 2] - values[1, 0]]) / 2.0
    hxy = (values[2, 2] - values[2, 0] - values[0, 2] + values[0, 0]) / 4.0
    h = np.array(
        [
            [values[2, 1] - 2 * values[1, 1] + values[0, 1], hxy],
            [hxy, values[1, 2] - 2 * values[1, 1] + values[1, 0]],
        ]
    )
    return around + np.array([*(-step * np.linalg.solve(h, g)), 0.0])


def raw_of_hdf5(path: Path, raw: RawData, near: F64) -> F64:
    with h5py.File(path) as file:
        echoes, position = file["echoes/VV"][()], file["track/position"][()]
        start, spacing = (file[f"radar/window/{name}"][()] for name in ("start_range", "sample_spacing"))
        carrier = file["radar/waveform/center_frequency"][()]
    f = np.fft.fftfreq(echoes.shape[1], 2.0 * spacing / LIGHT)
    spectrum = np.fft.fft(echoes, axis=1) * np.exp(-4j * np.pi * f * start[:, None] / LIGHT)
    return summed(spectrum, carrier + f, lambda p: 2.0 * np.linalg.norm(position - p, axis=1) / LIGHT, near)


def raw_of_cphd(path: Path, raw: RawData, near: F64) -> F64:
    cphd = pytest.importorskip("sarkit.cphd", reason="reads CPHD; in the extra formats")
    with path.open("rb") as file, cphd.Reader(file) as reader:
        signal, vectors = reader.read_channel("VV")
    f = vectors["SC0"][:, None] + vectors["SCSS"][:, None] * np.arange(signal.shape[1])

    def delay(place: F64) -> F64:
        ways = (np.linalg.norm(vectors[name] - place, axis=1) for name in ("TxPos", "RcvPos"))
        return sum(ways) / LIGHT

    anchor = raw.radar.anchor
    return summed(signal, f, lambda p: delay(anchor.to_ecef(p)) - delay(vectors["SRPPos"]), near)


RAW: dict[str, Callable[[Path, RawData, F64], F64]] = {"hdf5": raw_of_hdf5, "cphd": raw_of_cphd}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_point_is_at_its_place_in_every_format_of_raw_data(seed: int, tmp_path: Path) -> None:
    raw, image, truth = drawn(seed)
    rng = np.random.default_rng([seed, 8])
    formats = [entry for entry in FORMATS if entry.write_raw and entry.name in FORMATS.own_names]
    assert {entry.name for entry in formats} == set(RAW)  # a new format needs a reader here
    for entry in formats:
        path = tmp_path / f"point{entry.suffixes[0]}"
        write_raw(raw, path, format=entry.name)
        off = RAW[entry.name](path, raw, truth + np.array([*rng.uniform(-0.1, 0.1, 2), 0.0])) - truth
        assert np.linalg.norm(off) < SHARE * 0.5 * image.azimuth_resolution_cell, (entry.name, off)


def blob(seed: int) -> tuple[SarImage, tuple[float, float]]:
    """An image of drawn sizes and pixels whose power is a Gaussian about a drawn place; its azimuth and range.

    It spans many pixels: the samples of any average of it have the same centre, whatever their spacing.
    """
    rng = np.random.default_rng([seed, 9])
    shape = tuple(int(n) for n in rng.integers(90, 130, 2))
    steps = rng.permutation([0.5, rng.uniform(0.12, 0.5)])
    side = rng.choice([-1.0, 1.0])
    heading = rng.uniform(0.0, 2.0 * np.pi)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    across = side * np.array([along[1], -along[0], 0.0])
    azimuth, ranges = ((np.arange(n) - n // 2) * d for n, d in zip(shape, steps, strict=True))
    kind = ("ground", "slant")[seed % 2]
    origin = np.zeros(3)
    if kind == "slant":
        origin = -9e3 * across + np.array([0.0, 0.0, 9e3])
        ranges = ranges + np.hypot(9e3, 9e3)
    anchor = Anchor.of_degrees(rng.uniform(-79, 83), rng.uniform(-180, 180), rng.uniform(0, 1500))
    if seed // 2 % 2:
        anchor = singular_place(rng, 30.0)
    grid = ImageGrid(kind, azimuth, ranges, origin, along, across, anchor=anchor)
    place = tuple(
        float(rng.uniform(axis[size // 2 - 9], axis[size // 2 + 9]))
        for axis, size in zip((azimuth, ranges), shape, strict=True)
    )
    u, v = (
        (axis - at) / (6.0 * step) for axis, at, step in zip((azimuth, ranges), place, steps, strict=True)
    )
    data = np.exp(-0.25 * (u[:, None] ** 2 + v**2))[None]
    image = SarImage(data.astype(np.complex64), (Layer("VV"),), grid, 0.03, 1.0, 1.0, np.full(shape[1], 0.7))
    return image, (place[0], place[1])


def centre(power: F64, azimuth: F64, ranges: F64) -> tuple[float, float]:
    """Azimuth and range of the centre of all power."""
    power = np.nan_to_num(power)
    return (
        float((power.sum(axis=1) * azimuth).sum() / power.sum()),
        float((power.sum(axis=0) * ranges).sum() / power.sum()),
    )


def in_picture(figure: Figure) -> tuple[float, float]:
    """Azimuth and range of the centre of what a figure's screen pixels show bright, by the labels of its axes."""
    axes = figure.axes[0]
    shown = pictures.pixels(figure)[::-1].astype(np.float64).mean(axis=2)
    box = axes.bbox.extents
    part = shown[round(box[1]) : round(box[3]), round(box[0]) : round(box[2])]
    rows, columns = (np.arange(n) + 0.5 + round(at) for n, at in zip(part.shape, box[[1, 0]], strict=True))
    at = centre(part, rows, columns)
    x, y = axes.transData.inverted().transform((at[1], at[0]))
    return float(y), float(x)


@pytest.mark.parametrize("seed", SEEDS)
def test_averages_are_centred_on_what_they_average(seed: int) -> None:
    """Blocks, sliding windows, error maps, pictures and maps; windows of odd and even numbers of pixels."""
    image, place = blob(seed)
    grid, power = image.grid, image.rcs()
    steps = np.array([grid.azimuth_spacing, grid.range_spacing])
    rng = np.random.default_rng([seed, 10])

    def off(found: tuple[float, float], pixel: F64) -> float:
        return float((np.abs(np.subtract(found, place)) / pixel).max())

    for _ in range(4):
        looks = (int(rng.integers(1, 8)), int(rng.integers(1, 8)))
        if looks == (1, 1):
            continue
        pixel = steps * looks
        blocks = image.multilook(*looks, quantity="rcs")
        assert off(centre(blocks.power, blocks.azimuth, blocks.range), pixel) < SHARE, ("multilook", looks)
        coarse = block_grid(grid, looks)
        means = average_pixels(power + 0j, looks, sliding=False).real
        assert off(centre(means, coarse.azimuth, coarse.range), pixel) < SHARE, ("interferogram", looks)
        means = average_pixels(power + 0j, looks, sliding=True).real
        assert off(centre(means, grid.azimuth, grid.range), steps) < SHARE, ("sliding", looks)
        shown = prepare(image, PictureOptions(quantity="amplitude", looks=looks, limits=(0.0, 1.0)), 1600)
        low_r, _, low_a, _ = shown.extent
        edges = [
            low + pixel[axis] * (np.arange(shown.values.shape[axis]) + 0.5)
            for axis, low in enumerate((low_a, low_r))
        ]
        assert off(centre(shown.values**2, *edges), pixel) < SHARE, ("picture", looks)
        figure = pictures.quicklook(
            image, PictureOptions(quantity="amplitude", looks=looks, limits=(0.0, 1.0))
        )
        # tol: a screen pixel and 256 greys
        assert off(in_picture(figure), pixel) < SHARE + 0.05, ("screen", looks)
    window = int(rng.integers(2, 7))
    halves = np.stack([0.75 * image.data[0] * 1.1, 0.25 * image.data[0] * 0.7])
    subsets = (Layer("VV", subset=1), Layer("VV", subset=2))
    bars = estimate_error(halves.astype(np.complex64), subsets, window=window).per_pixel[0]
    assert off(centre(bars.astype(np.float64) ** 2, grid.azimuth, grid.range), steps) < SHARE


@pytest.mark.parametrize("seed", SEEDS)
def test_maps_are_centred_whatever_their_pixels(seed: int) -> None:
    warp = pytest.importorskip("rasterio.warp", reason="puts images on maps; in the extra formats")
    image, place = blob(seed)
    truth = image.grid.origin * [1.0, 1.0, 0.0] + place[0] * image.grid.along
    across = np.interp(place[1], image.grid.range, image.grid.across_distance())
    truth = truth + across * image.grid.across
    for spacing in (0.0, *np.random.default_rng([seed, 11]).uniform(0.15, 3.0, 2)):
        shown = north_up(image, spacing)
        # sigma0 of slant pixels is that of a constant cell here: power in proportion
        power = np.nan_to_num(shown.magnitude[0].astype(np.float64)) ** 2
        rows, columns = (shown.spacing * (np.arange(n) + 0.5) for n in power.shape)
        north, east = centre(power, rows, columns)
        (longitude,), (latitude,) = warp.transform(
            f"EPSG:{shown.zone}", "EPSG:4326", [shown.west + east], [shown.north - north]
        )
        found = image.anchor.from_geodetic(
            [np.radians(latitude), np.radians(longitude), image.anchor.to_geodetic(truth)[2]]
        )
        assert np.linalg.norm((found - truth)[:2]) < SHARE * shown.spacing, spacing


def test_phase_histories_of_others_focus_to_the_point(tmp_path: Path) -> None:
    """A MATLAB file as the Gotcha set is stored, written here from distances alone."""
    from sarmitsuba.files import read_raw

    rng = np.random.default_rng(12)
    point = np.array([*rng.uniform(-3.0, 3.0, 2), 0.0])
    angle = np.radians(np.linspace(40.0, 41.0, 120))
    antenna = 7000.0 * np.stack([np.cos(angle), np.sin(angle), np.full(angle.size, 0.9)], axis=1)
    frequency = 9.6e9 + np.arange(96) * 1.5e6
    r0 = np.linalg.norm(antenna, axis=1)
    late = np.linalg.norm(antenna - point, axis=1) - r0
    scipy.io.savemat(
        tmp_path / "h_VV.mat",
        {
            "data": {
                "fp": np.exp(-4j * np.pi * frequency[:, None] * late / LIGHT),
                "freq": frequency[:, None],
                **{name: antenna[:, i] for i, name in enumerate("xyz")},
                "r0": r0,
            }
        },
    )
    image = focus(read_raw(tmp_path / "h_VV.mat"), request=ImageRequest("ground", 0, 0, 0, 16, 16, 0.4, 0.4))
    row, column = middle(np.abs(image.total()) ** 2)
    grid = image.grid.in_frame(np.zeros(3))
    place = (
        grid.origin
        + (grid.azimuth[0] + 0.4 * row) * grid.along
        + (grid.range[0] + 0.4 * column) * grid.across
    )
    assert np.linalg.norm((place - point)[:2]) < SHARE * 0.4
