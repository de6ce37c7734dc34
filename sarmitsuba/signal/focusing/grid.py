"""Image grid from a radar and an image request, and conversion from a straight track's slant grid to a ground grid.

The conversion is band-limited interpolation over range.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F64, LinearMap
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.radar.image_request import MAX_PIXELS, ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import (
    ground_cell_area,
    incidence_angle,
    matched_weights,
    pulse_ranges,
    range_gradients,
)
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

# largest extent in cells of an image without a request
_MAX_CELLS = 1024
# largest pixel spacing as a part of the Nyquist spacing of the image's spectrum; half a cell of a plain geometry is 0.5
_NYQUIST_FILL = 0.8
# pulses weaker than this share of the strongest are ignored in the spectrum's extent
_WEAK = 0.01


def image_request(
    raw: RawData | Radar, request: ImageRequest | Mapping[str, object] | None = None
) -> ImageRequest:
    """Image request: that of the data, else a default one, with the requested changes.

    Parameters
    ----------
    raw : data, or only their radar
    request : a whole image request, or a mapping with the fields to change, such as ``{"grid": "ground"}``; an extent
        replaces a number of pixels. Centre and height are in the frame of the user's file, whatever the frame of the
        data

    Returns
    -------
    the request, in the frame of the radar; by default a square about the aim point inside the receive window

    Raises
    ------
    DataError
        The mapping has fields that no image request has.
    """
    radar = raw if isinstance(raw, Radar) else raw.radar
    if isinstance(request, ImageRequest):
        return request.in_frame(radar.offset)
    changes: dict[str, Any] = dict(request or {})
    known = {field.name for field in dataclasses.fields(ImageRequest)}
    unknown = sorted(set(changes) - known)
    if unknown:
        guess = did_you_mean(unknown[0], known)
        raise DataError(
            f"image request: {', '.join(unknown)} unknown{guess}; it has {', '.join(sorted(known))}"
        )
    for axis in ("azimuth", "range"):  # a new extent counts, not an earlier number of pixels
        if f"extent_{axis}" in changes:
            changes.setdefault(f"pixels_{axis}", 0)
    own = raw.request if isinstance(raw, RawData) else None
    if own is None:
        own = _request_from_window(radar)
    if not changes:
        return own.in_frame(radar.offset)
    counted = own.in_frame(changes.get("offset", (0.0, 0.0, 0.0)))
    return dataclasses.replace(counted, **changes).in_frame(radar.offset)


def default_grid(
    raw: RawData | Radar, request: ImageRequest | Mapping[str, object] | None = None
) -> ImageGrid:
    """Image grid of a request, of the data's request, or of a default one about the aim point.

    Parameters
    ----------
    raw, request : see :func:`image_request`; a pixel spacing of 0 means half a resolution cell, less where the image's
        spectrum is wider

    Returns
    -------
    ImageGrid that has a pixel exactly at the request's centre: in the middle, of an even number the one after it

    Raises
    ------
    DataError
        Invalid grid: the centre is on the wrong side or outside the recorded ranges, the plane is above the radar, an
        extent or spacing is not positive, or there are too many pixels.
    """
    radar = raw if isinstance(raw, Radar) else raw.radar
    request = image_request(raw, request)
    _check_request(radar, request)
    center = np.array([request.center_x, request.center_y, request.height])
    natural = natural_spacing(radar, center, request.grid)
    spacing_azimuth = request.spacing_azimuth or natural[0]
    spacing_range = request.spacing_range or natural[1]
    rows = request.pixels_azimuth or request.extent_azimuth / spacing_azimuth
    if rows * max(1.0, request.pixels_range or request.extent_range / spacing_range) > MAX_PIXELS:
        raise DataError(
            f"image grid: {request.extent_azimuth:g} m x {request.extent_range:g} m in pixels of {spacing_azimuth:g} m "
            f"x {spacing_range:g} m are more than {MAX_PIXELS} pixels; shrink the extents or widen the spacings"
        )
    along, across = radar.track.along, radar.across
    origin = radar.track.center_position
    ground = float((center - origin) @ across)
    if ground <= 0.0:
        raise DataError(
            f"image grid: its centre lies {-ground:g} m behind the radar, on the side it does not look to; change "
            "look_side or the "
            "image's centre"
        )
    _check_recorded(radar, request)
    half_azimuth, half_range = 0.5 * request.extent_azimuth, 0.5 * request.extent_range
    if request.grid == "ground":
        return ImageGrid(
            kind="ground",
            azimuth=_axis(0.0, half_azimuth, half_azimuth, spacing_azimuth, request.pixels_azimuth),
            range=_axis(0.0, half_range, half_range, spacing_range, request.pixels_range),
            origin=center,
            along=along,
            across=across,
            height=float(request.height),
            offset=radar.offset,
            anchor=radar.anchor,
        )
    drop = float(origin[2] - request.height)
    middle = float(np.hypot(ground, drop))
    near = float(np.hypot(max(ground - half_range, 0.0), drop))
    far = float(np.hypot(ground + half_range, drop))
    axis = _axis(middle, middle - near, far - middle, spacing_range, request.pixels_range)
    return ImageGrid(
        kind="slant",
        azimuth=_axis(
            float((center - origin) @ along),
            half_azimuth,
            half_azimuth,
            spacing_azimuth,
            request.pixels_azimuth,
        ),
        range=axis[axis > abs(drop)],
        origin=origin,
        along=along,
        across=across,
        height=float(request.height),
        offset=radar.offset,
        anchor=radar.anchor,
    )


def _check_request(radar: Radar, request: ImageRequest) -> None:
    """Raise a DataError for an invalid request."""
    if request.grid not in ("slant", "ground"):
        raise DataError(f"image grid: kind {request.grid!r} is unknown; it is slant or ground")
    for name in ("center_x", "center_y", "height"):
        if not np.isfinite(getattr(request, name)):
            raise DataError(f"image grid: {name} = {getattr(request, name)} m is not a finite number")
    extents = (request.extent_azimuth, request.extent_range)
    if not (min(extents) > 0.0 and np.isfinite(extents).all()):
        raise DataError(
            f"image grid: extents {extents[0]:g} m and {extents[1]:g} m must be finite and above 0"
        )
    if min(request.pixels_azimuth, request.pixels_range) < 0:
        raise DataError("image grid: a number of pixels is below 0; give 1 or more, or 0 for the extent")
    spacings = (request.spacing_azimuth, request.spacing_range)
    if not (min(spacings) >= 0.0 and np.isfinite(spacings).all()):
        raise DataError(
            f"image grid: pixel spacings {spacings[0]:g} m and {spacings[1]:g} m must be finite and above 0, or 0 for "
            "half a cell"
        )
    top = float(radar.track.center_position[2])
    if request.height >= top:
        raise DataError(
            f"image grid: its plane at height {request.height:g} m is not below the antenna at {top:g} m; lower it"
        )


def _check_recorded(radar: Radar, request: ImageRequest) -> None:
    """Raise a DataError where no pulse recorded any slant range of the image."""
    track, window = radar.track, radar.window
    share = np.linspace(-0.5, 0.5, 9)
    x, y = np.meshgrid(share * request.extent_azimuth, share * request.extent_range)
    middle = np.array([request.center_x, request.center_y, request.height])
    points = middle + x[..., None] * track.along + y[..., None] * radar.across
    pick = np.unique(np.linspace(0, track.n_pulses - 1, 65).astype(int))
    slant = pulse_ranges(radar, points.reshape(-1, 3), pick)
    start = window.start_range[pick]
    if not ((slant.max(axis=0) >= start) & (slant.min(axis=0) <= start + window.extent)).any():
        raise DataError(
            f"image grid: slant ranges of {slant.min():.6g} ... {slant.max():.6g} m were not recorded, only those of "
            f"{start.min():.6g} ... {start.max() + window.extent:.6g} m; move the image's centre"
        )


def natural_spacing(radar: Radar, center: F64, kind: str) -> tuple[float, float]:
    """Pixel spacings (azimuth, range) in m: half a cell, or less where a turned spectrum (squint) needs it.

    Half the Nyquist spacing where the track encircles the image.

    Parameters
    ----------
    radar : gives track, antenna and waveform
    center : (3,) m, scene frame
    kind : ``slant`` or ``ground``
    """
    weights = matched_weights(radar, center)
    angle = float(incidence_angle(radar, center))
    cell_range = radar.waveform.range_cell
    area = ground_cell_area(radar, center, weights, "rectangular", lit_alike=True)
    cell_azimuth = area * np.sin(angle) / cell_range
    seen = weights > _WEAK * weights.max()
    look = range_gradients(radar, center)[seen]
    along = look @ radar.track.along
    if kind == "ground":
        cell_range /= np.sin(angle)
        across = look @ radar.across
    else:  # dR / d rho on the slant grid
        across = np.sqrt(1.0 - along**2)
    half = 0.5 * radar.waveform.bandwidth / radar.waveform.center_frequency
    all_round = min(along.max(), -along.min(), across.max(), -across.min()) > 0.0
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength * np.array([1.0 - half, 1.0 + half])
    nyquist = [2.0 * np.pi / np.ptp(np.outer(axis, wavenumber)) for axis in (along, across)]
    if all_round:  # the spectrum is a ring, the same along both axes of the image
        return float(0.5 * nyquist[0]), float(0.5 * nyquist[1])
    return (
        float(min(0.5 * cell_azimuth, _NYQUIST_FILL * nyquist[0])),
        float(min(0.5 * cell_range, _NYQUIST_FILL * nyquist[1])),
    )


def _axis(center: float, below: float, above: float, spacing: float, count: int = 0) -> F64:
    """Uniform axis with a sample at ``center`` that covers ``below`` and ``above`` it, or of ``count`` samples."""
    if count:
        return np.asarray(center + spacing * (np.arange(count) - count // 2))
    index = np.arange(-int(np.ceil(below / spacing - 1e-9)), int(np.ceil(above / spacing - 1e-9)) + 1)
    return np.asarray(center + spacing * index)


def _request_from_window(radar: Radar) -> ImageRequest:
    """Square on the ground about the aim point that stays inside the receive window and the unambiguous azimuth."""
    aim = radar.aim_point
    window, position = radar.window, radar.track.position
    r = pulse_ranges(radar, aim)
    inside = float(min((r - window.start_range).min(), (window.start_range + window.extent - r).min()))
    if inside <= 0.0:
        raise DataError(
            "image grid: the aim point lies outside the receive window; give the image's centre and extents"
        )
    ground = 0.9 * 2.0 * inside / float(np.sin(incidence_angle(radar, aim)))
    weights = matched_weights(radar, aim)
    spacing = natural_spacing(radar, aim, "slant")
    if not weights.any():
        raise DataError(
            "image grid: the beam never reaches the aim point; give the image's centre and extents"
        )
    step = float(np.linalg.norm(np.diff(position, axis=0), axis=1).mean())
    ambiguity = radar.waveform.wavelength * float(r.mean()) / (2.0 * step)
    return ImageRequest(
        grid="slant",
        center_x=float(aim[0]),
        center_y=float(aim[1]),
        height=float(aim[2]),
        extent_azimuth=min(ground, 0.8 * ambiguity, 2 * _MAX_CELLS * spacing[0]),
        extent_range=min(ground, 2 * _MAX_CELLS * spacing[1]),
        spacing_azimuth=0.0,
        spacing_range=0.0,
        offset=(float(radar.offset[0]), float(radar.offset[1]), float(radar.offset[2])),
    )


# taps of the windowed sinc, and its Kaiser parameter: errors below -90 dB at the oversampling of 2.5 of slant_below
_TAPS, _BETA = 10, 9.0


def slant_below(radar: Radar, ground: ImageGrid) -> ImageGrid:
    """Slant grid that contains a ground grid's pixels, with half the natural column spacing.

    The columns' spacing is at most 0.4 of the Nyquist spacing of the image's spectrum, see
    :func:`sarmitsuba.signal.focusing.grid.natural_spacing`; rows are those of the ground grid.
    """
    origin = radar.track.center_position
    middle = ground.positions_on_line(ground.azimuth.size // 2)[ground.range.size // 2]
    spacing = 0.5 * natural_spacing(radar, middle, "slant")[1]
    rho = slant_ranges(radar, ground)
    first = int(np.floor(rho.min() / spacing)) - _TAPS
    columns = spacing * np.arange(first, int(np.ceil(rho.max() / spacing)) + _TAPS + 1)
    return ImageGrid(
        kind="slant",
        azimuth=ground.azimuth + float((ground.origin - origin) @ ground.along),
        range=columns[columns > abs(origin[2] - ground.height)],
        origin=origin,
        along=ground.along,
        across=ground.across,
        height=ground.height,
    )


def slant_ranges(radar: Radar, ground: ImageGrid) -> F64:
    """(n_range,) float64 closest-approach range of a ground grid's columns, m; negative behind the track."""
    origin = radar.track.center_position
    across = ground.range + float((ground.origin - origin) @ ground.across)
    return np.asarray(np.copysign(np.hypot(across, origin[2] - ground.height), across))


@dataclass(frozen=True, eq=False)
class RangeInterpolation(LinearMap):
    """Interpolation of an image's rows at other ranges.

    Parameters
    ----------
    slant : oversampled at least 2.5 times
    rho : (n_range,) float64, m, where pixels are wanted
    carrier : rad/m, middle of the spectrum over range
    """

    slant: ImageGrid
    rho: F64
    carrier: float

    def forward(self, values: C64) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) of those on ``slant``, (n_layers, n_azimuth, n_slant)."""
        return self._apply_matrix(self._matrix, values)

    def adjoint(self, values: C64) -> C64:
        """Pixels on ``slant`` from those at the other ranges."""
        return self._apply_matrix(self._matrix.conj().T, values)

    @staticmethod
    def _apply_matrix(matrix: "scipy.sparse.sparray", values: C64) -> C64:
        flat = values.reshape(-1, values.shape[-1])
        return np.asarray((matrix @ flat.T).T, dtype=np.complex64).reshape(*values.shape[:-1], -1)

    @cached_property
    def _matrix(self) -> "scipy.sparse.csr_array":
        slant, rho, carrier = self.slant, self.rho, self.carrier
        at = (rho - slant.range[0]) / slant.range_spacing
        base = np.floor(at).astype(np.int64)
        column = base[:, None] + np.arange(_TAPS) - (_TAPS // 2 - 1)
        offset = at[:, None] - column
        window = np.i0(_BETA * np.sqrt(np.clip(1.0 - (2.0 * offset / _TAPS) ** 2, 0.0, None))) / np.i0(_BETA)
        # interpolated in baseband; the carrier is applied again at the new ranges
        turn = np.exp(1j * carrier * slant.range_spacing * offset)
        value = (np.sinc(offset) * window * turn).astype(np.complex64)
        there = (column >= 0) & (column < slant.range.size)
        row = np.broadcast_to(np.arange(rho.size)[:, None], column.shape)
        return scipy.sparse.csr_array(
            (value[there], (row[there], column[there])), shape=(rho.size, slant.range.size)
        )
