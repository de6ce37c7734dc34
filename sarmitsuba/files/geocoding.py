"""Geocoding: outline of an image in degrees, and the magnitude on the grid of a map projection."""

import warnings
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from sarmitsuba.core.arrays import F32, F64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.signal.image import ImageGrid, SarImage, sliding_means

# bound of the error of an outline, pixels; most halvings of its edges, of use at a pole only; narrowest part, deg
_OUTLINE_ERROR, _HALVINGS, _LEAST_WIDTH = 0.05, 20, 1e-12
# iterations from a map position to the image plane, whose ellipsoidal height varies by the Earth's curvature
_PASSES = 3


def _corners(grid: ImageGrid) -> F64:
    """Corners of an image in the file's frame, m, (4, 3) float64, anticlockwise, half a pixel outside its pixels."""
    grid = grid.in_frame(np.zeros(3))
    # half a pixel outwards, since pixels have an area; no slant range is shorter than the antenna's height
    azimuth, ranges = (
        axis[[0, -1]] + 0.5 * spacing * np.array([-1.0, 1.0])
        for axis, spacing in ((grid.azimuth, grid.azimuth_spacing), (grid.range, grid.range_spacing))
    )
    if grid.kind == "slant":
        ranges = np.maximum(ranges, grid.origin[2] - grid.height)
    corners = replace(grid, azimuth=azimuth, range=ranges).positions().reshape(4, 3)[[0, 1, 3, 2]]
    (x0, y0), (x1, y1) = (corners[k, :2] - corners[:, :2].mean(axis=0) for k in (0, 1))
    return corners if x0 * y1 - x1 * y0 > 0.0 else corners[::-1]


def outlines(grid: ImageGrid) -> list[F64]:
    """Outline of an image on the Earth, cut where it crosses the antimeridian.

    Returns
    -------
    closed rings, (n, 3) float64: longitude (-180 to 180 deg), latitude (deg) and height (m), anticlockwise. A ring
    about a pole goes along the antimeridian to it and back.

    Notes
    -----
    Edges are straight in longitude and latitude, as in GeoJSON: long ones, and those near a pole, have vertices between
    the corners, so that they follow the image to a twentieth of a pixel.

    References
    ----------
    RFC 7946, sections 3.1.1, 3.1.6 and 3.1.9.
    """
    corners = _corners(grid)
    bound = _OUTLINE_ERROR * min(grid.azimuth_spacing, grid.range_spacing)
    points = [corners[0]]
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points += _follow(grid.anchor, start, end, bound, _HALVINGS)
    latitude, longitude, height = grid.anchor.to_geodetic(np.array(points)).T
    ring = np.column_stack([np.unwrap(np.degrees(longitude), period=360.0), np.degrees(latitude), height])
    turn = ring[-1, 0] - ring[0, 0]
    if abs(turn) > 180.0:
        ring = _round_pole(ring[:-1], float(np.sign(turn)))
    first = int((ring[:, 0].min() + 180.0) // 360.0)
    last = int(-((180.0 - ring[:, 0].max()) // 360.0))
    parts = (_part_of_ring(ring - [360.0 * k, 0.0, 0.0]) for k in range(first, last + 1))
    return [part for part in parts if len(part) and np.ptp(part[:, 0]) > _LEAST_WIDTH]


def _round_pole(ring: F64, side: float) -> F64:
    """Closed ring of longitudes from -180 to 180 deg, of one (n, 3), not closed, that runs once round a pole.

    Parameters
    ----------
    ring : continuous longitudes, rising round the northern pole and falling round the southern one
    side : 1 north, -1 south
    """
    path = np.concatenate([ring + np.array([360.0 * turn, 0.0, 0.0]) for turn in range(-2, 3)])
    path = path[np.argsort(path[:, 0], kind="stable")]
    ends = np.column_stack([[-180.0, 180.0], *(np.interp([-180.0, 180.0], *path.T[[0, i]]) for i in (1, 2))])
    path = np.concatenate([ends[:1], path[np.abs(path[:, 0]) < 180.0], ends[1:]])[:: int(side)]
    pole = path[[-1, 0]] * [1.0, 0.0, 1.0] + [0.0, 90.0 * side, 0.0]
    return np.concatenate([path, pole, path[:1]])


def _follow(anchor: Anchor, start: F64, end: F64, bound: float, halvings: int) -> list[F64]:
    """Points after ``start`` to ``end`` (3,) between which longitude and latitude are linear to a bound, m."""
    middle = 0.5 * (start + end)
    geodetic = anchor.to_geodetic(np.stack([start, end]))
    geodetic[:, 1] = np.unwrap(geodetic[:, 1])
    off = (anchor.from_geodetic(geodetic.mean(axis=0)) - middle)[:2]
    if not halvings or np.linalg.norm(off) <= bound:
        return [end]
    return [
        *_follow(anchor, start, middle, bound, halvings - 1),
        *_follow(anchor, middle, end, bound, halvings - 1),
    ]


def _part_of_ring(ring: F64) -> F64:
    """Part of a closed ring (n, 3) between the longitudes -180 and 180 deg, closed; (0, 3) where there is none."""
    for side in (-1.0, 1.0):
        beyond = side * ring[:, 0] - 180.0  # positive outside
        kept = []
        for (a, x), (b, y) in pairwise(zip(ring, beyond, strict=True)):
            if x <= 0.0:
                kept.append(a)
            if min(x, y) < 0.0 < max(x, y):
                cut = a + x / (x - y) * (b - a)
                cut[0] = side * 180.0
                kept.append(cut)
        if not kept:
            return np.zeros((0, 3))
        ring = np.array([*kept, kept[0]])
    return ring


@dataclass(frozen=True, eq=False)
class NorthUp:
    """Geocoded magnitude of an image.

    Parameters
    ----------
    magnitude : (n_channels, rows, columns) float32, square root of sigma0; NaN outside the image
    zone : EPSG number of the projection, see `map_zone`
    west, north : m, upper left corner of the upper left pixel
    spacing : m
    """

    magnitude: F32
    zone: int
    west: float
    north: float
    spacing: float


def map_zone(longitude: float, latitude: float) -> int:
    """EPSG number of the map projection of a position in degrees, WGS-84.

    The UTM zone, with the wider zones of south-west Norway and Svalbard; beyond 84 deg north and 80 deg south polar
    stereographic (UPS).

    References
    ----------
    NGA.SIG.0012, "The universal grids and the transverse Mercator and polar stereographic map projections", 2014, 7.4.
    """
    if latitude > 84.0:
        return 32661
    if latitude < -80.0:
        return 32761
    longitude = (longitude + 180.0) % 360.0 - 180.0
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    if 56.0 <= latitude < 64.0 and 3.0 <= longitude < 12.0:
        zone = 32
    elif latitude >= 72.0 and 0.0 <= longitude < 42.0:
        zone = 31 + 2 * int((longitude + 3.0) // 12.0)
    return (32600 if latitude >= 0.0 else 32700) + zone


def warn_unplaced(anchor: Anchor) -> None:
    """Warn that a map or an outline has no place on the Earth: its scene states none."""
    if anchor.latitude == anchor.longitude == 0.0:
        warnings.warn(
            "the scene has no place on the Earth: map and outline are at 0 deg north, 0 deg east; give latitude_deg "
            "and longitude_deg of its sensor",
            SarmitsubaWarning,
            stacklevel=3,
        )


@dataclass(frozen=True, eq=False)
class MapGrid:
    """Grid of the map projection of `map_zone` over an image, the map's north up.

    Parameters
    ----------
    row, column : (rows, columns) float64, fractional pixel of the image at the centre of every pixel of the map
    widths : pixels of the image, azimuth and range, in one of the map
    zone, west, north, spacing : see `NorthUp`
    """

    row: F64
    column: F64
    widths: tuple[float, float]
    zone: int
    west: float
    north: float
    spacing: float

    @staticmethod
    def of(grid: ImageGrid, spacing: float = 0.0) -> "MapGrid":
        """Map of an anchored image; spacing in m, 0: the larger pixel spacing of the image on the ground.

        Notes
        -----
        Pixels are placed on the image plane: terrain and buildings are displaced by layover, as in the image.
        """
        from rasterio.warp import transform

        grid = grid.in_frame(np.zeros(3))
        across = np.diff(grid.across_distance())
        steps = np.array([grid.azimuth_spacing, float(across.mean()) if across.size else grid.range_spacing])
        spacing = spacing or float(steps.max())
        corners = _corners(grid)
        latitude, longitude, height = grid.anchor.to_geodetic([*corners, corners.mean(axis=0)]).T
        zone = map_zone(float(np.degrees(longitude[-1])), float(np.degrees(latitude[-1])))
        code = f"EPSG:{zone}"
        east, north = (
            np.asarray(v)
            for v in transform("EPSG:4326", code, np.degrees(longitude[:4]), np.degrees(latitude[:4]))
        )
        west, top = np.floor(east.min() / spacing) * spacing, np.ceil(north.max() / spacing) * spacing
        columns, rows = (
            int(np.ceil((east.max() - west) / spacing)),
            int(np.ceil((top - north.min()) / spacing)),
        )
        x, y = np.meshgrid(
            west + spacing * (np.arange(columns) + 0.5), top - spacing * (np.arange(rows) + 0.5)
        )
        longitude, latitude = (np.asarray(v) for v in transform(code, "EPSG:4326", x.ravel(), y.ravel()))
        place = np.column_stack([np.radians(latitude), np.radians(longitude), np.full(x.size, height[-1])])
        for _ in range(_PASSES):
            points = grid.anchor.from_geodetic(place)
            place[:, 2] += grid.height - points[:, 2]
        offset = points - (grid.origin * [1.0, 1.0, 0.0] + [0.0, 0.0, grid.height])
        distance = offset @ grid.across
        if grid.kind == "slant":
            distance = np.hypot(distance, grid.origin[2] - grid.height)
        return MapGrid(
            ((offset @ grid.along - grid.azimuth[0]) / grid.azimuth_spacing).reshape(rows, columns),
            ((distance - grid.range[0]) / grid.range_spacing).reshape(rows, columns),
            (float(spacing / steps[0]), float(spacing / steps[1])),
            zone,
            float(west),
            float(top),
            spacing,
        )


def north_up(image: SarImage, spacing: float = 0.0) -> NorthUp:
    """Resample the magnitude to the grid of the map projection, its north up.

    Parameters
    ----------
    image : on any grid, anchored
    spacing : of `MapGrid`, m

    Returns
    -------
    power, averaged over a map pixel that holds several image pixels, else interpolated linearly
    """
    on = MapGrid.of(image.grid, spacing)
    out = [
        scipy.ndimage.map_coordinates(
            sliding_means(image.sigma0(channel), on.widths, "nearest"),
            [on.row, on.column],
            order=1,
            cval=np.nan,
        )
        for channel in image.channels
    ]
    return NorthUp(np.sqrt(np.stack(out)).astype(np.float32), on.zone, on.west, on.north, on.spacing)
