"""Positions of the returns of a building and of a bridge in a radar image, in the far field."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64


@dataclass(frozen=True)
class BuildingReturns:
    """Extents of a flat-roofed building on flat ground; zero is the foot of the near wall, away is positive.

    ``*_ground`` are ground-range lengths along the look direction, ``*_slant`` slant-range lengths, m.

    Parameters
    ----------
    layover_ground, layover_slant : how far ahead of its foot the top of the wall appears
    shadow_ground : length of the ground in shadow behind the far wall
    shadow_slant : dark interval in slant range from the far roof edge to the first lit ground
    roof_in_layover : the whole roof lies ahead of the wall's foot
    roof_slant : (near, far) slant range of the roof's edges
    lit_ground_slant : slant range where ground behind the building is lit again
    triple_ground : extent of the wall-ground-wall return behind the foot, cut by nothing but the wall's
        height
    dihedral_slant : slant range of the wall-ground double bounce
    """

    layover_ground: float
    layover_slant: float
    shadow_ground: float
    shadow_slant: float
    roof_in_layover: bool
    roof_slant: tuple[float, float]
    lit_ground_slant: float
    triple_ground: float
    dihedral_slant: float


def building_returns(
    height: float, width: float, incidence_angle: float, wall_angle: float = 0.0
) -> BuildingReturns:
    r"""Return where a building's layover, roof, shadow, dihedral line and triple bounce lie.

    .. math:: \Delta R = x \sin\theta - z \cos\theta

    Parameters
    ----------
    height, width : of the building, m; the width is measured across the wall
    incidence_angle : theta from the vertical on flat ground, rad
    wall_angle : azimuth between the horizontal look direction and the wall's normal, rad (0: parallel to the
    track,
        and not squinted); look side does not matter

    Notes
    -----
    Ignores the curvature of the wave front, the ends of the building and its windows.
    """
    s, c = np.sin(incidence_angle), np.cos(incidence_angle)
    along_look = width / np.cos(wall_angle)
    near_roof = -height * c
    far_roof = along_look * s - height * c
    lit = (along_look + height * s / c) * s
    return BuildingReturns(
        layover_ground=float(height * c / s),
        layover_slant=float(height * c),
        shadow_ground=float(height * s / c),
        shadow_slant=float(lit - far_roof),
        roof_in_layover=bool(far_roof < 0.0),
        roof_slant=(float(near_roof), float(far_roof)),
        lit_ground_slant=float(lit),
        triple_ground=float(height * s / c),
        dihedral_slant=0.0,
    )


@dataclass(frozen=True)
class BridgeReturns:
    """Slant range of a bridge's line-like returns relative to the water below its edge, m.

    Parameters
    ----------
    single, double, triple : deck edge itself; deck side and water; water, deck side, water
    under_deck : further ghosts, out and back through 2, 3 ... reflections in the water each
    slant_spacing, ground_spacing : between neighbouring orders one to three
    """

    single: float
    double: float
    triple: float
    under_deck: tuple[float, ...]
    slant_spacing: float
    ground_spacing: float


def bridge_returns(
    height: float, incidence_angle: float, ground_range: float = 0.0, n_ghosts: int = 2
) -> BridgeReturns:
    r"""Return where single, double, triple and higher returns of a bridge over water lie.

    .. math:: \Delta R = y \sin\theta + (w - 1) h \cos\theta

    with w the number of reflections in the water: 0 (single), 1 (double), 2 (triple), and 4, 6 ... for a point
    under the deck seen out and back through the same 2, 3 ... reflections in the water (7, 11 ... bounces in
    all). There the underside has been a mirror too, so y is at least ``2 h tan(theta)`` behind the edge each time.

    Parameters
    ----------
    height : of the deck above the water, m
    incidence_angle : theta from the vertical, rad
    ground_range : y of the deck edge, m, away is positive
    n_ghosts : how many under-deck orders

    Notes
    -----
    Ignores the deck's thickness and width, waves, and the curvature of the wave front.
    """
    start = ground_range * np.sin(incidence_angle)
    step = height * np.cos(incidence_angle)
    return BridgeReturns(
        single=float(start - step),
        double=float(start),
        triple=float(start + step),
        under_deck=tuple(float(start + (3 + 2 * i) * step) for i in range(n_ghosts)),
        slant_spacing=float(step),
        ground_spacing=float(step / np.sin(incidence_angle)),
    )


def slant_offset(point: ArrayLike, look_direction: ArrayLike) -> F64:
    """Return the slant range of points relative to the origin for a far antenna, m.

    Parameters
    ----------
    point : (..., 3) m, scene frame
    look_direction : (3,) unit vector from the antenna to the scene

    Notes
    -----
    Ignores the curvature of the wave front: R^2 / (2 range).
    """
    return np.asarray(np.asarray(point, dtype=np.float64) @ np.asarray(look_direction, dtype=np.float64))


def foreshortening(slope: float, incidence_angle: float) -> float:
    r"""Return slant-range length over true length of a slope facing the radar (negative: laid over).

    .. math:: \sin(\theta - \alpha)

    Parameters
    ----------
    slope : alpha, rad, positive when tilted towards the radar
    incidence_angle : theta on flat ground, rad
    """
    return float(np.sin(incidence_angle - slope))
