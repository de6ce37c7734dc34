"""Coordinates along the axes of a picture: of the scene, or of the radar."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.signal.image.sar_image import ImageGrid

Frame = Literal["scene", "radar"]
FRAMES: tuple[str, ...] = get_args(Frame)

# largest angle between an axis of the image and x or y of the scene that counts as none: its sine, 1 mm in 1 km
_PARALLEL = 1e-6


@dataclass(frozen=True)
class ShownAxes:
    r"""Coordinates of an image as its picture shows them: range to the right, azimuth upwards.

    On a ground grid a pixel at (a, r) of the grid lies at :math:`P = O + a\,\hat a + r\,\hat r` of the scene's file,
    with the grid's origin O, and is shown at

    .. math:: \text{across} = s_r\,\hat r \cdot P, \qquad \text{up} = s_a\,\hat a \cdot P

    If an axis is parallel to x or y of the scene, its sign s makes the shown number that coordinate; otherwise s = 1
    and the number counts from the scene's origin (0, 0) along the axis. In the frame ``radar`` the grid's own
    coordinates are shown.

    Parameters
    ----------
    frame : ``scene`` or ``radar``
    range, azimuth : sign and shift of each axis, m: shown = sign * grid + shift
    range_label, azimuth_label : of the axes
    """

    frame: Frame
    range: tuple[float, float]
    azimuth: tuple[float, float]
    range_label: str
    azimuth_label: str

    @staticmethod
    def of(grid: ImageGrid, frame: str | None = None) -> "ShownAxes":
        """Axes of a grid's picture.

        Parameters
        ----------
        grid : the image's
        frame : ``scene`` or ``radar``; None: ``scene`` for ground grids, ``radar`` for slant-range grids

        Raises
        ------
        DataError
            There is no such frame, or scene coordinates are wanted of a slant-range image.
        """
        if frame is not None and frame not in FRAMES:
            raise DataError(
                f'picture: axes "{frame}" are unknown{did_you_mean(frame, FRAMES)}; choose scene or radar'
            )
        if grid.kind == "slant":
            if frame == "scene":
                raise DataError(
                    "picture: an image in slant range has no axes of the scene, because range is no coordinate of it; "
                    "leave --axes out, or make the image on the ground (grid = ground)"
                )
            return ShownAxes("radar", (1.0, 0.0), (1.0, 0.0), "slant range (m)", "azimuth (m)")
        if frame == "radar":
            middle = "from the image's centre (m)"
            return ShownAxes("radar", (1.0, 0.0), (1.0, 0.0), f"ground range {middle}", f"azimuth {middle}")
        place = grid.origin + grid.offset
        across, range_label = _axis(grid.across, place, "ground range")
        along, azimuth_label = _axis(grid.along, place, "azimuth")
        return ShownAxes("scene", across, along, range_label, azimuth_label)

    def shown(self, azimuth: F64 | float, range_: F64 | float) -> tuple[F64, F64]:
        """Shown coordinates (across, up) of the grid's azimuth and range, m."""
        return (
            np.asarray(self.range[0] * np.asarray(range_) + self.range[1]),
            np.asarray(self.azimuth[0] * np.asarray(azimuth) + self.azimuth[1]),
        )

    def grid_coordinates(self, across: F64 | float, up: F64 | float) -> tuple[F64, F64]:
        """Azimuth and range of the grid at shown coordinates, m."""
        return (
            np.asarray(self.azimuth[0] * (np.asarray(up) - self.azimuth[1])),
            np.asarray(self.range[0] * (np.asarray(across) - self.range[1])),
        )

    def extent(self, grid: ImageGrid, block: tuple[int, int] = (1, 1)) -> tuple[float, float, float, float]:
        """Shown coordinates of the left, right, lower and upper edge of the whole blocks of pixels, m.

        Left is near range and below is early azimuth, whichever sign an axis has.
        """
        rows, columns = grid.shape[0] // block[0], grid.shape[1] // block[1]
        r0 = float(grid.range[0]) - 0.5 * grid.range_spacing
        a0 = float(grid.azimuth[0]) - 0.5 * grid.azimuth_spacing
        x, y = self.shown(
            np.array([a0, a0 + rows * block[0] * grid.azimuth_spacing]),
            np.array([r0, r0 + columns * block[1] * grid.range_spacing]),
        )
        return float(x[0]), float(x[1]), float(y[0]), float(y[1])


def _axis(direction: F64, place: F64, name: str) -> tuple[tuple[float, float], str]:
    """Sign and shift of an axis of a ground grid, and its label."""
    for index, letter in enumerate("xy"):
        if abs(direction[1 - index]) < _PARALLEL:
            sign = float(np.sign(direction[index]))
            return (sign, float(place[index])), f"{letter} of the scene (m), {name}"
    return (1.0, float(place[:2] @ direction[:2])), f"{name} from the scene's origin (m)"
