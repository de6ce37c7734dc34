"""Geocoding: outline of an image in degrees, and the magnitude on a north-up map grid."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from sarmitsuba.arrays import F32, F64
from sarmitsuba.image.averaging import sliding_means
from sarmitsuba.image.sar_image import ImageGrid, SarImage

# iterations from a map position to the image plane, whose ellipsoidal height varies by the Earth's curvature
_PASSES = 3


def outline(grid: ImageGrid) -> F64:
    """Corners of an image: longitude and latitude (deg) and height (m), (5, 3) float64, closed, anticlockwise."""
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
    corners = corners if x0 * y1 - x1 * y0 > 0.0 else corners[::-1]
    geodetic = grid.anchor.to_geodetic(np.concatenate([corners, corners[:1]]))
    return np.column_stack([np.degrees(geodetic[:, 1]), np.degrees(geodetic[:, 0]), geodetic[:, 2]])


@dataclass(frozen=True, eq=False)
class NorthUp:
    """Geocoded magnitude of an image.

    Parameters
    ----------
    magnitude : (n_channels, rows, columns) float32, square root of sigma0; NaN outside the image
    zone : EPSG number of the UTM zone (WGS-84)
    west, north : m, upper left corner of the upper left pixel
    spacing : m
    """

    magnitude: F32
    zone: int
    west: float
    north: float
    spacing: float


def utm_zone(longitude: float, latitude: float) -> int:
    """EPSG number of the WGS-84 UTM zone of a position in degrees; beyond 84 deg of the polar stereographic zone."""
    if latitude > 84.0:
        return 32661
    if latitude < -80.0:
        return 32761
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return (32600 if latitude >= 0.0 else 32700) + zone


@dataclass(frozen=True, eq=False)
class MapGrid:
    """North-up grid of the UTM zone over an image.

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
        corners = outline(grid)
        zone = utm_zone(*corners[:4].mean(axis=0)[:2])
        code = f"EPSG:{zone}"
        east, north = (np.asarray(v) for v in transform("EPSG:4326", code, corners[:, 0], corners[:, 1]))
        west, top = np.floor(east.min() / spacing) * spacing, np.ceil(north.max() / spacing) * spacing
        columns, rows = (
            int(np.ceil((east.max() - west) / spacing)),
            int(np.ceil((top - north.min()) / spacing)),
        )
        x, y = np.meshgrid(
            west + spacing * (np.arange(columns) + 0.5), top - spacing * (np.arange(rows) + 0.5)
        )
        longitude, latitude = (np.asarray(v) for v in transform(code, "EPSG:4326", x.ravel(), y.ravel()))
        place = np.column_stack([np.radians(latitude), np.radians(longitude), np.full(x.size, corners[0, 2])])
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
    """Resample the magnitude to a north-up grid of the UTM zone.

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
