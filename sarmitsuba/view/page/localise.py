"""Localisation of an echo of given range and Doppler on the image plane."""

import numpy as np

from sarmitsuba.core.arrays import F64


def on_plane(
    position: F64, velocity: F64, slant_range: F64, range_rate: F64, height: float, across: F64
) -> F64:
    r"""Point of a horizontal plane that has a range and a range rate from a moving antenna.

    With P the antenna, v its velocity and X the point,

    .. math:: |P - X| = R, \qquad (P - X) \cdot v = \dot R R, \qquad X_z = h

    The second is a line in the plane, the first a circle; of their two intersections the one on the look side is
    returned.

    Parameters
    ----------
    position, velocity : (3,) float64, m and m/s; the antenna
    slant_range, range_rate : (n,) float64, m and m/s
    height : m, of the plane
    across : (3,) float64 horizontal unit vector to the look side

    Returns
    -------
    (n, 3) float64, m; NaN where circle and line do not intersect (the range is too short)
    """
    drop = position[2] - height
    level = velocity[:2]
    speed = float(np.hypot(*level))
    unit = level / speed
    # (P - X) = (-a unit - b side, drop): along and across in the plane
    along = (velocity[2] * drop - range_rate * slant_range) / speed
    side = across[:2] - (across[:2] @ unit) * unit
    side = side / np.hypot(*side)
    square = slant_range**2 - drop**2 - along**2
    with np.errstate(invalid="ignore"):
        beside = np.sqrt(np.where(square >= 0.0, square, np.nan))
    level_xy = position[:2] + along[:, None] * unit + beside[:, None] * side
    return np.column_stack([level_xy, np.full(len(level_xy), height)])
