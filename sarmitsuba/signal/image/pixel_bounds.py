"""Bounds of an image's grid and calibration, checked for every file before use."""

import numpy as np

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.radar.validity import check_anchor, check_bounds
from sarmitsuba.signal.image.sar_image import ImageGrid, SarImage

_FARTHEST = 1e10  # m
# relative tolerance of unit vectors, and of steps along an axis, which may be stored in float32
_ROUGH = 1e-3
# float64 rounding errors allowed in a step
_ROUNDING = 8.0 * np.finfo(np.float64).eps


def check_grid(grid: ImageGrid) -> None:
    """Raise a DataError where the positions of a grid are invalid.

    Parameters
    ----------
    grid : of any source

    Raises
    ------
    DataError, RadarError
        One line: name, value and bounds.
    """
    if grid.kind not in ("slant", "ground"):
        raise DataError(f'image grid: kind "{one_line(grid.kind)}" is unknown; choose slant or ground')
    for name in ("azimuth", "range"):
        axis = getattr(grid, name)
        if axis.ndim != 1 or not axis.size or not (np.abs(axis) <= _FARTHEST).all():
            raise DataError(f"image grid: {name} of shape {axis.shape} is not one axis of finite numbers, m")
        steps = np.diff(axis)
        if not steps.size:
            continue
        uneven = _ROUGH * steps.mean() + _ROUNDING * np.abs(axis).max()
        if not (steps > 0.0).all() or np.ptp(steps) > uneven:
            raise DataError(
                f"image grid: {name} has steps of {steps.min():g} to {steps.max():g} m; they must be uniform and "
                "above 0"
            )
    vectors = np.stack([grid.along, grid.across])
    if vectors.shape != (2, 3) or not np.allclose(vectors @ vectors.T, np.eye(2), rtol=0.0, atol=_ROUGH):
        raise DataError("image grid: along and across must be orthogonal unit vectors")
    if not (np.abs([*grid.origin, *grid.offset, grid.height]) <= _FARTHEST).all():
        raise DataError(f"image grid: origin, offset or height is beyond {_FARTHEST:g} m or not a number")
    check_anchor(grid.anchor)


def check_image(image: SarImage) -> None:
    """Raise a DataError where the calibration or the grid of an image is out of bounds."""
    check_grid(image.grid)
    check_bounds(
        "image",
        (
            ("wavelength", image.wavelength, 1e-4, 1e3, "m"),
            ("azimuth_resolution_cell", image.azimuth_resolution_cell, 1e-9, 1e9, "m"),
            ("range_resolution_cell", image.range_resolution_cell, 1e-9, 1e9, "m"),
        ),
    )
    angle = image.incidence_angle
    if not ((angle > 0.0) & (angle <= 0.5 * np.pi)).all():
        raise DataError(
            f"image: incidence angles from {angle.min():g} to {angle.max():g} rad; each must be above 0 and at most "
            "pi / 2"
        )
