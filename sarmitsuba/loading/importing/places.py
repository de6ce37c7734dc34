"""Conversion of a file's coordinates to the tangent plane at an anchor on the Earth."""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.geodesy import Anchor

if TYPE_CHECKING:
    from rasterio.crs import CRS

WGS84, LOCAL = "EPSG:4326", "local"
# largest distance from the origin, m: there the plane z = 0 is 200 m above the Earth's surface
WIDEST = 50e3
# largest coordinates on a map, m, and of angles, deg: beyond, PROJ takes time in proportion to them
_FARTHEST, _FARTHEST_ANGLE = 1e8, 1e3
_EPSG = re.compile(r"EPSG(?:/0/|/[\d.]+/|:[\d.]*:|:)(\d{4,6})")


def crs_named(text: str) -> str:
    """Coordinate system as ``EPSG:n``, from its name in GML and GeoJSON; of a compound system the horizontal one."""
    if text.strip().upper().endswith("CRS84"):
        return WGS84
    found = _EPSG.search(text)
    return f"EPSG:{found[1]}" if found else text.strip()


@dataclass(frozen=True)
class Places:
    """Conversion of a file's coordinates to longitude and latitude, or to metres in the scene's frame.

    Parameters
    ----------
    crs : ``EPSG:4326`` (x is longitude, y latitude, deg), ``local`` (metres east and north of the anchor), or a map
        projection that rasterio knows (x is east, y north)
    where : start of every error message
    """

    crs: str
    where: str

    def geodetic(self, points: ArrayLike) -> F64:
        """Longitude and latitude of coordinates (n, 2), deg.

        Raises
        ------
        SceneError : values out of range, the system is unknown, or rasterio is missing
        """
        xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        if self.crs != WGS84:
            xy = project_points(xy, self.crs, WGS84, self.where)
        bad = ~(np.isfinite(xy).all(axis=1) & (np.abs(xy[:, 0]) <= 360.0) & (np.abs(xy[:, 1]) <= 90.0))
        if bad.any():
            x, y = np.asarray(points, dtype=np.float64).reshape(-1, 2)[np.argmax(bad)]
            raise SceneError(
                f"{self.where}: {x:.6g}, {y:.6g} is no longitude and latitude in degrees; name the map projection with "
                "--crs EPSG:n, or --crs local for metres"
            )
        return xy


@lru_cache(maxsize=8)
def _system(crs: str) -> "CRS":
    """Coordinate system of a name."""
    import rasterio
    from rasterio.crs import CRS

    with rasterio.Env():  # its errors are raised, not printed
        return CRS.from_user_input(crs)


def project_points(points: F64, crs: str, wanted: str, where: str) -> F64:
    """Coordinates (n, 2) converted to another system.

    Raises
    ------
    SceneError : rasterio is missing, a system is unknown, or a point lies outside of it
    """
    try:
        import rasterio
        from rasterio._err import CPLE_BaseError  # not among rasterio's public errors, yet raised by it
        from rasterio.warp import transform
    except ImportError as error:
        raise SceneError(
            f"{where}: coordinates in {one_line(crs)} need the package rasterio ({error}); pip install "
            "'sarmitsuba[importing]'"
        ) from error
    try:
        check_map(points, crs, where)
        return np.column_stack(transform(_system(crs), _system(wanted), points[:, 0], points[:, 1]))
    except (rasterio.errors.RasterioError, CPLE_BaseError, ValueError, TypeError, RuntimeError) as error:
        raise SceneError(
            f"{where}: coordinates cannot be converted from {one_line(crs)} to {one_line(wanted)}: {one_line(error)}; "
            "name their system with --crs EPSG:n"
        ) from error


def check_map(points: F64, crs: str, where: str) -> None:
    """Raise a SceneError for coordinates (n, 2) that no map of the system has."""
    angles = bool(_system(crs).is_geographic)
    most, unit = (_FARTHEST_ANGLE, "deg") if angles else (_FARTHEST, "m")
    bad = ~(np.abs(points) <= most).all(axis=1)
    if bad.any():
        x, y = points[np.argmax(bad)]
        raise SceneError(
            f"{where}: the coordinates {x:.6g}, {y:.6g} are no place on a map, which ends at {most:g} {unit}; name "
            "their system with --crs EPSG:n, or --crs local for metres"
        )


def try_conversion(points: F64, crs: str, where: str) -> None:
    """Convert coordinates (n, 2) to longitude and latitude, and those back, in a process apart first.

    The system may be defined by a file, with any parameters.

    Raises
    ------
    SceneError : the conversion does not end, crashes, or needs excessive memory
    """
    if crs in (WGS84, LOCAL) or not len(points):
        return

    def convert() -> None:
        project_points(project_points(points, crs, WGS84, where), WGS84, crs, where)

    try:
        survive(points.nbytes, convert)
    except DataError as error:
        raise SceneError(f"{where}: coordinates in {one_line(crs)} cannot be converted: {error}") from None


def local_of_geodetic(anchor: Anchor, longitude_latitude: F64, height: float | F64) -> F64:
    """Scene coordinates (n, 3) float64, m, of longitude and latitude (deg) and height over the ellipsoid (m)."""
    lon, lat = np.radians(longitude_latitude.T)
    return anchor.from_geodetic(np.stack([lat, lon, np.broadcast_to(height, lat.shape)], axis=-1))


def project_onto_plane(anchor: Anchor, longitude_latitude: F64) -> F64:
    """Projection of longitude and latitude (deg) along the ellipsoid's normals onto the plane z = 0, (n, 2), m."""
    lon, lat = np.radians(longitude_latitude.T)
    up = (
        np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1) @ anchor.axes.T
    )
    foot = local_of_geodetic(anchor, longitude_latitude, anchor.height)
    return np.asarray(foot[:, :2] - foot[:, 2:] / up[:, 2:] * up[:, :2])


def unwrap_longitude(longitude: ArrayLike, reference: float) -> F64:
    """Longitudes, deg, within 180 deg of a reference: continuous across the antimeridian."""
    return np.asarray(reference + (np.asarray(longitude) - reference + 180.0) % 360.0 - 180.0)


def middle(longitude_latitude: F64, height: float = 0.0) -> Anchor:
    """Anchor in the middle of the bounds of points (deg), rounded as in scene files."""
    continuous = unwrap_longitude(longitude_latitude[:, 0], longitude_latitude[0, 0])
    lon, lat = (round(0.5 * float(v.min() + v.max()), 8) for v in (continuous, longitude_latitude[:, 1]))
    return Anchor.of_degrees(lat, float(unwrap_longitude(lon, 0.0)), round(height, 3))


def check_width(points: F64, where: str) -> None:
    """Raise a SceneError where points (n, 2 or 3) of the scene, m, lie too far from its origin."""
    far = float(np.abs(points[:, :2]).max()) if len(points) else 0.0
    if not far <= WIDEST:
        raise SceneError(
            f"{where}: extends {far / 1e3:.4g} km from the scene's origin, more than {WIDEST / 1e3:.0f} km; select a "
            "part with --anchor LAT,LON and --radius M"
        )
