r"""Mosaic of the images of bursts, and the azimuth phase ramp that turning beams leave in them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.bursts import azimuth_rates
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import zero_doppler_delay
from sarmitsuba.signal.image import ImageGrid, SarImage

# pixels of a row, and rows, at which times of zero Doppler are computed; bilinear between them
_NODES = 17


def zero_doppler_times(radar: Radar, grid: ImageGrid) -> F64:
    """Times, s, from the middle of a burst until the pixels are at zero Doppler, (n_azimuth, n_range) float64.

    Bilinear between 17 x 17 pixels: the surface is smooth, to microseconds over a burst.
    """
    rows, columns = (np.unique(np.linspace(0, n - 1, _NODES).astype(int)) for n in grid.shape)
    nodes = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns]).positions()
    times = zero_doppler_delay(radar.track, nodes.reshape(-1, 3)).reshape(nodes.shape[:2])
    lines = np.array([np.interp(grid.range, grid.range[columns], line) for line in times])
    return np.array([np.interp(grid.azimuth, grid.azimuth[rows], line) for line in lines.T]).T


def nearest_burst(radars: Sequence[Radar], grid: ImageGrid) -> NDArray[np.intp]:
    """Index of the burst that every pixel is taken from, (n_azimuth, n_range): nearest in time to zero Doppler.

    The seam lies in the middle of the overlap of two bursts.
    """
    away = np.stack([np.abs(zero_doppler_times(radar, grid)) for radar in radars])
    return np.asarray(np.argmin(away, axis=0))


def ramp_phase(radar: Radar, grid: ImageGrid) -> F64:
    r"""Phase, rad, over the pixels that the turning beam of a burst leaves, (n_azimuth, n_range) float64.

    .. math:: \phi = \pi k_t t^2,

    with the time t from the middle of the burst to zero Doppler. Pixels times :math:`e^{-j \phi}` (deramping) are at
    base band in azimuth; without a turning beam the phase is zero.

    Parameters
    ----------
    radar : of the data; where the antenna moves on until the echoes arrive, the halfway antenna counts
    grid : of the image

    Notes
    -----
    k_t is that of the middle of every 17th part of the swath, linear between them. Ignores its change over azimuth.
    """
    radar = radar.start_stop()
    columns = np.unique(np.linspace(0, grid.shape[1] - 1, _NODES).astype(int))
    points = grid.positions_on_line(grid.shape[0] // 2)[columns]
    rates = np.interp(
        grid.range, grid.range[columns], [azimuth_rates(radar, point).image for point in points]
    )
    return np.asarray(np.pi * rates * zero_doppler_times(radar, grid) ** 2)


def mosaic_bursts(images: Sequence[SarImage], radars: Sequence[Radar]) -> SarImage:
    """One image of the images of bursts on the same grid, each pixel of the burst nearest to it in time.

    Phases stay those of each burst; what does not belong to pixels is that of the burst nearest to the middle.

    Parameters
    ----------
    images : on one grid, in the order of time
    radars : of the bursts

    Raises
    ------
    DataError
        The grids differ.
    """
    grid = images[0].grid
    if any(image.grid.shape != grid.shape or image.layers != images[0].layers for image in images):
        raise DataError(
            "mosaic: the images of the bursts differ in their pixels or layers; focus them on one grid"
        )
    owner = nearest_burst(radars, grid)
    data: C64 = np.zeros_like(images[0].data)
    for i, image in enumerate(images):
        mine = owner == i
        data[:, mine] = image.data[:, mine]
    middle = images[int(owner[owner.shape[0] // 2, owner.shape[1] // 2])]
    facts = [image.metadata.get("burst", {}) for image in images]
    notes = list(dict.fromkeys(note for image in images for note in image.metadata.get("notes", ())))
    metadata = {**middle.metadata, "bursts": facts, "notes": notes}
    return replace(middle, data=data, metadata=metadata, parts=tuple(images))
