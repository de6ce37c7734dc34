"""WGS-84 coordinates: geodetic, Earth-centred Earth-fixed (ECEF), and the tangent plane of a scene."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_FLATTENING, EARTH_RADIUS

_ECCENTRICITY_SQUARE = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)
# Bowring's step gains four digits or more outside the Earth's core
_STEPS = 4


def ecef_of_geodetic(geodetic: ArrayLike) -> F64:
    r"""Earth-centred Earth-fixed positions of geodetic coordinates.

    .. math::
        x = (N + h) \cos\varphi \cos\lambda, \quad y = (N + h) \cos\varphi \sin\lambda, \quad
        z = (N (1 - e^2) + h) \sin\varphi, \quad N = a / \sqrt{1 - e^2 \sin^2\varphi}

    Parameters
    ----------
    geodetic : (..., 3) float; latitude and longitude in rad, height over the ellipsoid in m

    Returns
    -------
    (..., 3) float64, m
    """
    latitude, longitude, height = np.moveaxis(np.asarray(geodetic, dtype=np.float64), -1, 0)
    normal = EARTH_RADIUS / np.sqrt(1.0 - _ECCENTRICITY_SQUARE * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = (normal * (1.0 - _ECCENTRICITY_SQUARE) + height) * np.sin(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def geodetic_of_ecef(position: ArrayLike) -> F64:
    r"""Geodetic coordinates of Earth-centred Earth-fixed positions.

    With the reduced latitude beta, repeated:

    .. math::
        \tan\beta = (1 - f) \tan\varphi, \quad
        \tan\varphi = \frac{z + e^2 b / (1 - e^2) \sin^3\beta}{\rho - e^2 a \cos^3\beta}

    Parameters
    ----------
    position : (..., 3) float, m

    Returns
    -------
    (..., 3) float64; latitude and longitude (-pi to pi) in rad, height over the ellipsoid in m

    Notes
    -----
    Exact to rounding from 1000 km below the surface upwards; ignores that nearer to the Earth's centre the nearest
    point of the ellipsoid is not the only one.

    References
    ----------
    B. R. Bowring, Survey Review 23 (1976), 323.
    """
    x, y, z = np.moveaxis(np.asarray(position, dtype=np.float64), -1, 0)
    level = np.hypot(x, y)
    minor = EARTH_RADIUS * (1.0 - EARTH_FLATTENING)
    swell = _ECCENTRICITY_SQUARE / (1.0 - _ECCENTRICITY_SQUARE) * minor
    latitude = np.arctan2(z, level * (1.0 - _ECCENTRICITY_SQUARE))
    for _ in range(_STEPS):
        reduced = np.arctan2((1.0 - EARTH_FLATTENING) * np.sin(latitude), np.cos(latitude))
        latitude = np.arctan2(
            z + swell * np.sin(reduced) ** 3,
            level - _ECCENTRICITY_SQUARE * EARTH_RADIUS * np.cos(reduced) ** 3,
        )
    root = np.sqrt(1.0 - _ECCENTRICITY_SQUARE * np.sin(latitude) ** 2)
    height = level * np.cos(latitude) + z * np.sin(latitude) - EARTH_RADIUS * root
    return np.stack([latitude, np.arctan2(y, x), height], axis=-1)


@dataclass(frozen=True)
class Anchor:
    """Place on the Earth of the origin of the file's frame: z = 0 is the tangent plane, x east, y north.

    Parameters
    ----------
    latitude, longitude : rad, geodetic, WGS-84
    height : m over the ellipsoid
    """

    latitude: float = 0.0
    longitude: float = 0.0
    height: float = 0.0

    @staticmethod
    def of_degrees(latitude: float, longitude: float, height: float = 0.0) -> "Anchor":
        """Anchor from latitude and longitude in degrees and height in m."""
        return Anchor(float(np.radians(latitude)), float(np.radians(longitude)), height)

    def __repr__(self) -> str:
        return (
            f"Anchor({np.degrees(self.latitude):.7g} deg north, {np.degrees(self.longitude):.7g} deg east, "
            f"{self.height:.6g} m)"
        )

    @cached_property
    def origin(self) -> F64:
        """(3,) float64, m, ECEF position of the frame's origin."""
        return ecef_of_geodetic([self.latitude, self.longitude, self.height])

    @cached_property
    def axes(self) -> F64:
        """(3, 3) float64; rows are the unit vectors east, north and up in ECEF."""
        sin_lat, cos_lat = np.sin(self.latitude), np.cos(self.latitude)
        sin_lon, cos_lon = np.sin(self.longitude), np.cos(self.longitude)
        return np.array(
            [
                [-sin_lon, cos_lon, 0.0],
                [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
            ]
        )

    def to_ecef(self, points: ArrayLike) -> F64:
        """(..., 3) float64 ECEF positions of points in the file's frame, m."""
        return np.asarray(self.origin + np.asarray(points, dtype=np.float64) @ self.axes)

    def from_ecef(self, position: ArrayLike) -> F64:
        """(..., 3) float64 points in the file's frame of ECEF positions, m."""
        return np.asarray((np.asarray(position, dtype=np.float64) - self.origin) @ self.axes.T)

    def to_geodetic(self, points: ArrayLike) -> F64:
        """Latitude and longitude in rad and height in m, (..., 3) float64, of points in the file's frame, m."""
        return geodetic_of_ecef(self.to_ecef(points))

    def from_geodetic(self, geodetic: ArrayLike) -> F64:
        """Points in the file's frame, (..., 3) float64 m, of latitude and longitude in rad and height in m."""
        return self.from_ecef(ecef_of_geodetic(geodetic))
