"""Focused complex image: pixel grid, bounds, shown axes, averages, radiometric quantities.

Grid and calibration are checked for every file before use. Axes are coordinates of the scene or of the radar; averages
are over adjacent blocks or a centred window. Images are calibrated against a target of known RCS.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.core.registry import late, png_of
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.validity import check_anchor, check_bounds
from sarmitsuba.signal.raw_data import Layer, channels_of, sum_of_channel


def block_means(values: NDArray[np.floating], block: tuple[int, int]) -> F64:
    """Means over blocks of rows and columns; incomplete blocks at the far ends are dropped.

    Their centres are those of :func:`block_middles`.
    """
    rows, columns = values.shape[0] // block[0], values.shape[1] // block[1]
    kept = np.asarray(values, dtype=np.float64)[: rows * block[0], : columns * block[1]]
    return np.asarray(kept.reshape(rows, block[0], columns, block[1]).mean(axis=(1, 3)))


def block_middles(axis: F64, n: int) -> F64:
    """Centres of blocks of n pixels, (size // n,), from the centres of the pixels, (size,)."""
    blocks = axis.size // n
    return np.asarray(axis[: blocks * n].reshape(blocks, n).mean(axis=1))


def sliding_means(
    values: NDArray[np.floating], widths: tuple[float, float], rim: Literal["nearest", "reflect"]
) -> F64:
    r"""Means over a window of ``widths`` pixels (rows, columns) centred on every pixel.

    .. math:: \bar x_i = \frac{1}{w} \sum_j x_j \, |[i - w/2, i + w/2] \cap [j - 1/2, j + 1/2]|

    A pixel at the window's end is weighted by its part inside, so that windows of an even or fractional number of
    pixels cause no shift.

    Parameters
    ----------
    values : (n_azimuth, n_range) real
    widths : pixels, at least 1
    rim : continuation beyond the edges: the last value repeated, or mirrored about the edge
    """
    means = np.asarray(values, dtype=np.float64)
    for axis, width in enumerate(widths):
        reach = int(np.ceil(0.5 * (width - 1.0)))
        if reach < 1:
            continue
        weights = np.ones(2 * reach + 1)
        weights[[0, -1]] = 0.5 * (width - (2 * reach - 1))
        means = scipy.ndimage.correlate1d(means, weights / width, axis=axis, mode=rim)
    return means


Quantity = Literal["sigma0", "rcs"]
# metadata of data of unknown gain, whose |pixel|^2 is an intensity in unknown units
UNCALIBRATED: Mapping[str, bool] = {"calibrated": False}


@dataclass(frozen=True, eq=False)
class ImageGrid:
    """Grid of pixel positions in the scene.

    ``slant``: zero-Doppler coordinates of a straight reference track: along-track position x from ``origin``
    (the mid-aperture antenna position) and slant range r of closest approach, on the horizontal plane z = ``height``.
    ``ground``: metres along and across track from ``origin`` (a scene point) in the plane z = ``height``.

    Parameters
    ----------
    kind : ``slant`` or ``ground``
    azimuth : (n_azimuth,) float64, m, uniform, increasing along the flight direction
    range : (n_range,) float64, m, uniform, increasing away from the radar (slant range, or across-track metres)
    origin : (3,) float64, m, scene frame
    along, across : (3,) float64 horizontal unit vectors, scene frame; across points to the look side
    height : m, scene frame
    offset : (3,) float64, m; positions in the frame of the user's file are these + offset
    anchor : geodetic position of the origin of the frame of the user's file
    """

    kind: Literal["slant", "ground"]
    azimuth: F64
    range: F64
    origin: F64
    along: F64
    across: F64
    height: float = 0.0
    offset: F64 = field(default_factory=lambda: np.zeros(3))
    anchor: Anchor = field(default_factory=Anchor)

    def in_frame(self, offset: F64) -> "ImageGrid":
        """Grid in the frame of another offset; zeros: the frame of the user's file.

        Parameters
        ----------
        offset : (3,) float64, m; that of the radar whose data are focused
        """
        shift = self.offset - offset
        if not shift.any():
            return self
        return replace(
            self, origin=self.origin + shift, height=self.height + float(shift[2]), offset=np.array(offset)
        )

    def __repr__(self) -> str:
        size = f"{self.shape[0]} x {self.shape[1]} pixels of {self.azimuth_spacing:.3g} m x {self.range_spacing:.3g} m"
        return f"ImageGrid({self.kind}: {size})"

    @property
    def shape(self) -> tuple[int, int]:
        """(n_azimuth, n_range)."""
        return (self.azimuth.size, self.range.size)

    @property
    def azimuth_spacing(self) -> float:
        """Pixel spacing in azimuth, m."""
        return float(self.azimuth[1] - self.azimuth[0]) if self.azimuth.size > 1 else 1.0

    @property
    def range_spacing(self) -> float:
        """Pixel spacing in range (slant or ground as ``kind``), m."""
        return float(self.range[1] - self.range[0]) if self.range.size > 1 else 1.0

    def across_distance(self) -> F64:
        """Horizontal across-track distance of each range column from ``origin``, (n_range,) float64, m."""
        if self.kind == "ground":
            return self.range
        drop = self.origin[2] - self.height
        square = self.range**2 - drop**2
        if (square < 0).any():
            raise DataError(
                f"image grid: slant range {self.range.min():.3f} m is shorter than the antenna's height "
                f"{drop:.3f} m above the image plane; start the image at a longer range"
            )
        return np.asarray(np.sqrt(square))

    def positions_on_line(self, row: int) -> F64:
        """Scene-frame positions of one azimuth row, (n_range, 3) float64, m."""
        flat = self.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, self.height])
        return np.asarray(
            flat + self.azimuth[row] * self.along + self.across_distance()[:, None] * self.across
        )

    def geodetic(self) -> F64:
        """WGS-84 latitude, longitude (rad) and height (m) of every pixel, (n_azimuth, n_range, 3) float64."""
        return self.anchor.to_geodetic(self.positions() + self.offset)

    def positions(self) -> F64:
        """Scene-frame position of every pixel, (n_azimuth, n_range, 3) float64, m."""
        flat = self.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, self.height])
        return np.asarray(
            flat
            + self.azimuth[:, None, None] * self.along
            + self.across_distance()[None, :, None] * self.across
        )


@dataclass(frozen=True, eq=False)
class SarImage:
    """Calibrated complex image: ``|pixel|^2`` is the radar cross section, m^2, of a point target at its peak.

    Parameters
    ----------
    data : (n_layers, n_azimuth, n_range) complex64, m (square root of RCS)
    layers : n_layers labels
    grid : positions of the pixels
    wavelength : m
    azimuth_resolution_cell, range_resolution_cell : noise-equivalent widths of the impulse response, m; range in slant
        range
    incidence_angle : (n_range,) float64, rad, at mid-aperture on the grid's plane; converts RCS to sigma0
    metadata : values for JSON
    parts : images of the bursts that this is the mosaic of; not stored in files but those that keep bursts apart

    Notes
    -----
    ``sigma0 = |pixel|^2 / (azimuth_resolution_cell * range_resolution_cell / sin(incidence_angle))``: its mean over
    clutter on flat ground is the normalised cross section. Terrain slope is ignored.
    """

    data: C64
    layers: tuple[Layer, ...]
    grid: ImageGrid
    wavelength: float
    azimuth_resolution_cell: float
    range_resolution_cell: float
    incidence_angle: F64
    metadata: Mapping[str, Any] = field(default_factory=dict)
    parts: tuple["SarImage", ...] = ()

    def __repr__(self) -> str:
        grid = self.grid
        return (
            f"SarImage({'/'.join(self.channels)}: {grid.shape[0]} x {grid.shape[1]} pixels of "
            f"{grid.azimuth_spacing:.3g} m x {grid.range_spacing:.3g} m, {grid.kind}, cell "
            f"{self.azimuth_resolution_cell:.3g} m x {self.range_resolution_cell:.3g} m)"
        )

    def _repr_png_(self) -> bytes:
        """Quick-look of the first channel, for notebooks."""
        return png_of(self.plot())

    def save(self, path: Path | str, *, format: str | None = None) -> None:
        """Write to a file (``.h5`` holds all data), as :func:`sarmitsuba.write_image`."""
        late("sarmitsuba.files", "write_image")(self, path, format=format)

    @staticmethod
    def load(path: Path | str, *, format: str | None = None) -> "SarImage":
        """Read from a file, as :func:`sarmitsuba.read_image`."""
        image = late("sarmitsuba.files", "read_image")(path, format=format)
        assert isinstance(image, SarImage)
        return image

    def to_xarray(self) -> object:
        """Image as an ``xarray.DataArray`` (channel, azimuth, range), complex64, m (square root of RCS).

        Coordinates have units; every pixel has latitude and longitude (deg). Needs xarray (the extra ``formats``).
        """
        return late("sarmitsuba.files.labelled", "labelled_image")(self)

    def plot(self, path: Path | str | None = None, *, channel: str | None = None) -> object:
        """Quick-look of a channel (default: the first) as a Matplotlib ``Figure``, written to ``path`` if given.

        The figure opens no window; notebooks show it as the last line of a cell. For its options see
        :mod:`sarmitsuba.view.quicklook`.
        """
        return late("sarmitsuba.view.notebook", "image_figure")(self, path, channel)

    def to_db(self, channel: str | None = None, quantity: Quantity = "sigma0", floor: float = -np.inf) -> F64:
        """Intensity in dB of 1 (``sigma0``) or of 1 m^2 (``rcs``), at least ``floor``, (n_azimuth, n_range) float64."""
        return to_db(_power(self, channel, quantity), floor)

    def multilook(
        self, azimuth: int, range: int, channel: str | None = None, quantity: Quantity = "sigma0"
    ) -> "Multilook":
        """Mean power of blocks of ``azimuth`` x ``range`` pixels; incomplete blocks at the far ends are dropped.

        Raises
        ------
        DataError : fewer than one pixel, or more than the image has
        """
        shape = self.grid.shape
        if not (1 <= azimuth <= shape[0] and 1 <= range <= shape[1]):
            raise DataError(
                f"multilook: blocks of {azimuth} x {range} pixels of an image of {shape[0]} x {shape[1]}; give 1 or "
                "more, up to its size"
            )
        return Multilook(
            power=block_means(_power(self, channel, quantity), (azimuth, range)),
            azimuth=block_middles(self.grid.azimuth, azimuth),
            range=block_middles(self.grid.range, range),
            channel=channel or self.channels[0],
            quantity=quantity,
            calibrated=self.calibrated,
            grid=self.grid,
        )

    @property
    def anchor(self) -> Anchor:
        """Geodetic position of the origin of the file's frame."""
        return self.grid.anchor

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels in order of first appearance."""
        return channels_of(self.layers)

    def total(self, channel: str | None = None) -> C64:
        """Sum of all layers of a channel (default: the first), (n_azimuth, n_range) complex64."""
        return sum_of_channel(self.data, self.layers, channel, "image")

    def rcs(self, channel: str | None = None) -> F64:
        """Radar cross section: squared magnitude of every pixel, m^2."""
        return np.abs(self.total(channel).astype(np.complex128)) ** 2

    @property
    def calibrated(self) -> bool:
        """Whether ``|pixel|^2`` is in m^2; False for data from elsewhere of unknown gain."""
        return self.metadata.get("calibrated", True) is not False

    @property
    def cell_area(self) -> F64:
        """Ground area of the resolution cell, m^2, (n_azimuth, n_range) float64: sigma0 is RCS over this area.

        The azimuth cell is that of the image's centre, multiplied by its variation over range (for a fixed aperture the
        cell is proportional to range) and over rows (which may lack part of the aperture) if the focuser recorded it.
        """
        azimuth = np.full(self.grid.range.shape, self.azimuth_resolution_cell)
        fit = self.metadata.get("focus", {}).get("azimuth_cell_polynomial")
        if fit is not None:
            x = (self.grid.range - fit["center"]) / fit["scale"]
            azimuth *= np.polynomial.polynomial.polyval(x, np.asarray(fit["coefficients"], dtype=np.float64))
        line = np.asarray(azimuth * self.range_resolution_cell / np.sin(self.incidence_angle))
        table = self.metadata.get("focus", {}).get("azimuth_cell_rows")
        if table is None:
            return np.broadcast_to(line, self.grid.shape)
        nodes = np.array([np.interp(self.grid.range, table["range"], row) for row in table["ratio"]])
        ratio = [np.interp(self.grid.azimuth, table["azimuth"], column) for column in nodes.T]
        return np.asarray(np.transpose(ratio) * line)

    def sigma0(self, channel: str | None = None) -> F64:
        """Normalised radar cross section of flat ground, linear."""
        return np.asarray(self.rcs(channel) / self.cell_area)


def _power(image: SarImage, channel: str | None, quantity: Quantity) -> F64:
    if quantity not in ("sigma0", "rcs"):
        raise DataError(f"image: quantity {quantity!r} is unknown; choose sigma0 or rcs")
    return image.rcs(channel) if quantity == "rcs" else image.sigma0(channel)


def to_db(power: F64, floor: float = -np.inf) -> F64:
    """Power in dB, at least ``floor``."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.maximum(db_from_power(power), floor))


@dataclass(frozen=True, eq=False)
class Multilook:
    """Multi-looked power of an image.

    Parameters
    ----------
    power : (n_azimuth, n_range) float64, linear
    azimuth, range : float64, m, centres of the blocks on the image's axes
    channel, quantity : polarisation; ``sigma0``, or ``rcs`` in m^2
    calibrated : whether the quantity's unit holds, see `SarImage.calibrated`
    grid : of the image, for pictures in coordinates of the scene; None: pictures have the image's axes
    """

    power: F64
    azimuth: F64
    range: F64
    channel: str
    quantity: Quantity
    calibrated: bool = True
    grid: ImageGrid | None = None

    def __repr__(self) -> str:
        return f"Multilook({self.channel} {self.quantity}: {self.azimuth.size} x {self.range.size} blocks)"

    def _repr_png_(self) -> bytes:
        """Picture of the power in dB, for notebooks."""
        return png_of(self.plot())

    def plot(self) -> object:
        """Power in dB as a Matplotlib ``Figure``, which notebooks show."""
        return late("sarmitsuba.view.notebook", "multilook_figure")(self)

    def to_db(self, floor: float = -np.inf) -> F64:
        """Power in dB, at least ``floor``."""
        return to_db(self.power, floor)


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
    and the number counts from the scene's origin (0, 0) along the axis. In the frame ``radar`` the grid's
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
            return ShownAxes("radar", (1.0, 0.0), (1.0, 0.0), "slant range (m)", "azimuth from mid-track (m)")
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


RadiometricQuantity = Literal["rcs", "sigma0", "beta0", "gamma0"]
QUANTITIES: tuple[str, ...] = ("rcs", "sigma0", "beta0", "gamma0")


def backscatter(image: SarImage, quantity: RadiometricQuantity = "sigma0", channel: str | None = None) -> F64:
    r"""Intensity of an image as a radiometric quantity, linear, (n_azimuth, n_range) float64.

    ``rcs``: of a point at its peak, m^2; ``sigma0``: per ground area, :math:`\sigma^0 = |I|^2 / A`;
    ``beta0``: per slant-plane area, :math:`\beta^0 = \sigma^0 / \sin\theta_i`; ``gamma0``: per area across the line of
    sight, :math:`\gamma^0 = \sigma^0 / \cos\theta_i`.

    Notes
    -----
    Ignores terrain: incidence is that of the image's horizontal plane.

    References
    ----------
    Raney et al., A plea for radar brightness, IGARSS 1994.
    """
    if quantity not in QUANTITIES:
        guess = did_you_mean(quantity, QUANTITIES)
        raise DataError(f"backscatter {quantity!r}: unknown{guess}; choose one of {', '.join(QUANTITIES)}")
    if quantity == "rcs":
        return image.rcs(channel)
    sigma0 = image.sigma0(channel)
    if quantity == "beta0":
        return np.asarray(sigma0 / np.sin(image.incidence_angle))
    if quantity == "gamma0":
        return np.asarray(sigma0 / np.cos(image.incidence_angle))
    return sigma0


def calibrate(image: SarImage, measured_rcs: float, known_rcs: float) -> SarImage:
    """Scale an image so that a reference target's measured peak becomes its known RCS (both m^2).

    Needed only for images from external raw data of unknown gain.
    """
    if not (measured_rcs > 0.0 and known_rcs > 0.0):
        raise DataError(
            f"calibration: measured_rcs = {measured_rcs:g} and known_rcs = {known_rcs:g} m^2 must be above 0"
        )
    factor = np.sqrt(known_rcs / measured_rcs)
    total = float(factor) * float(image.metadata.get("calibration_factor", 1.0))
    facts = {**image.metadata, "calibration_factor": total, "calibrated": True}
    return replace(image, data=(image.data * np.float32(factor)).astype(np.complex64), metadata=facts)
