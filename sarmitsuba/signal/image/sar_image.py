"""Focused complex image and its pixel grid."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.registry import late, png_of
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.signal.image.averaging import block_means, block_middles
from sarmitsuba.signal.raw.raw_data import Layer, channels_of, sum_of_channel

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
        return np.asarray(np.maximum(10.0 * np.log10(power), floor))


@dataclass(frozen=True, eq=False)
class Multilook:
    """Multi-looked power of an image.

    Parameters
    ----------
    power : (n_azimuth, n_range) float64, linear
    azimuth, range : float64, m, centres of the blocks on the image's axes
    channel, quantity : polarisation; ``sigma0``, or ``rcs`` in m^2
    calibrated : whether the quantity's unit holds, see `SarImage.calibrated`
    grid : of the image, for pictures in coordinates of the scene; None: pictures have the image's own axes
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
