"""The image grid that a radar and a request imply."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.aperture import ground_cell_area, incidence_angle, look_directions, matched_weights
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]

# an image made without a request stays below this many cells along each axis
_MAX_CELLS = 1024
# largest pixel spacing as a part of the Nyquist spacing of the image's spectrum; half a cell of a plain geometry is 0.5
_NYQUIST_FILL = 0.8
# pulses weaker than this part of the strongest do not count for the spectrum's extent
_WEAK = 0.01


def image_request(
    raw: RawData | Radar, request: ImageRequest | Mapping[str, object] | None = None
) -> ImageRequest:
    """Which image to make: the one asked for, else the one that comes with the data, else one of our own.

    Parameters
    ----------
    raw : data, or only their radar
    request : an image request, or a mapping with its fields

    Returns
    -------
    the request; the last resort is a square about the aim point inside the receive window

    Raises
    ------
    DataError
        The mapping has fields that no image request has.
    """
    if request is None and isinstance(raw, RawData):
        request = raw.request
    if request is None:
        return _request_from_window(raw if isinstance(raw, Radar) else raw.radar)
    if isinstance(request, ImageRequest):
        return request
    known = {field.name for field in dataclasses.fields(ImageRequest)}
    unknown = sorted(set(request) - known)
    if unknown:
        raise DataError(f"image request: {', '.join(unknown)} unknown; it has {', '.join(sorted(known))}")
    values: dict[str, Any] = dict(request)
    return ImageRequest(**values)


def default_grid(
    raw: RawData | Radar, request: ImageRequest | Mapping[str, object] | None = None
) -> ImageGrid:
    """Make the grid of a request, or of the one that comes with the data, or one about the aim point.

    Parameters
    ----------
    raw, request : see :func:`image_request`; a pixel spacing of 0 stands for half a resolution cell, less where the
        image's spectrum asks for it

    Returns
    -------
    ImageGrid that has a pixel exactly at the request's centre

    Raises
    ------
    DataError
        No such grid: the centre on the wrong side, a spacing that is not positive.
    """
    radar = raw if isinstance(raw, Radar) else raw.radar
    request = image_request(raw, request)
    if request.grid not in ("slant", "ground"):
        raise DataError(f"image grid: kind {request.grid!r} is unknown; it is slant or ground")
    center = np.array([request.center_x, request.center_y, request.height])
    spacing_azimuth, spacing_range = natural_spacing(radar, center, request.grid)
    spacing_azimuth = request.spacing_azimuth or spacing_azimuth
    spacing_range = request.spacing_range or spacing_range
    if not (spacing_azimuth > 0.0 and spacing_range > 0.0):
        raise DataError(
            f"image grid: pixel spacings {spacing_azimuth:g} m and {spacing_range:g} m must be above 0"
        )
    along, across = radar.track.along, radar.across
    half_azimuth, half_range = 0.5 * request.extent_azimuth, 0.5 * request.extent_range
    if request.grid == "ground":
        return ImageGrid(
            kind="ground",
            azimuth=_axis(0.0, half_azimuth, half_azimuth, spacing_azimuth),
            range=_axis(0.0, half_range, half_range, spacing_range),
            origin=center,
            along=along,
            across=across,
            height=float(request.height),
            offset=radar.offset,
        )
    origin = radar.track.center_position
    ground = float((center - origin) @ across)
    if ground <= 0.0:
        raise DataError(
            f"image grid: its centre lies {-ground:g} m behind the radar, on the side it does not look to; change "
            "look_side or the "
            "image's centre"
        )
    drop = float(origin[2] - request.height)
    middle = float(np.hypot(ground, drop))
    near = float(np.hypot(max(ground - half_range, 0.0), drop))
    far = float(np.hypot(ground + half_range, drop))
    axis = _axis(middle, middle - near, far - middle, spacing_range)
    return ImageGrid(
        kind="slant",
        azimuth=_axis(float((center - origin) @ along), half_azimuth, half_azimuth, spacing_azimuth),
        range=axis[axis > abs(drop)],
        origin=origin,
        along=along,
        across=across,
        height=float(request.height),
        offset=radar.offset,
    )


def natural_spacing(radar: Radar, center: F64, kind: str) -> tuple[float, float]:
    """Pixel spacings (azimuth, range) in m: half a cell, or less where a turned spectrum (squint) needs it.

    Parameters
    ----------
    radar : gives track, antenna and waveform
    center : (3,) m, scene frame
    kind : ``slant`` or ``ground``
    """
    weights = matched_weights(radar, center)
    angle = float(incidence_angle(radar, center))
    cell_range = radar.waveform.range_cell
    cell_azimuth = ground_cell_area(radar, center, weights, "rectangular") * np.sin(angle) / cell_range
    seen = weights > _WEAK * weights.max()
    look = look_directions(radar, center)[seen]
    along = look @ radar.track.along
    if kind == "ground":
        cell_range /= np.sin(angle)
        across = look @ radar.across
    else:  # dR / d rho on the slant grid
        across = np.sqrt(1.0 - along**2)
    half = 0.5 * radar.waveform.bandwidth / radar.waveform.center_frequency
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength * np.array([1.0 - half, 1.0 + half])
    nyquist = [2.0 * np.pi / np.ptp(np.outer(axis, wavenumber)) for axis in (along, across)]
    return (
        float(min(0.5 * cell_azimuth, _NYQUIST_FILL * nyquist[0])),
        float(min(0.5 * cell_range, _NYQUIST_FILL * nyquist[1])),
    )


def _axis(center: float, below: float, above: float, spacing: float) -> F64:
    """Uniform axis with a sample at ``center`` that covers ``below`` and ``above`` it."""
    index = np.arange(-int(np.ceil(below / spacing - 1e-9)), int(np.ceil(above / spacing - 1e-9)) + 1)
    return np.asarray(center + spacing * index)


def _request_from_window(radar: Radar) -> ImageRequest:
    """Square on the ground about the aim point that stays inside the receive window and the unambiguous azimuth."""
    aim = radar.aim_point
    window, position = radar.window, radar.track.position
    r = np.linalg.norm(aim - position, axis=1)
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
    )


__all__ = ["default_grid", "image_request", "natural_spacing"]
