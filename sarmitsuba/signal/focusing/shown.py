"""Share of the echoes' energy that an image shows."""

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import antennas_gain
from sarmitsuba.signal.image.sar_image import ImageGrid
from sarmitsuba.signal.raw.raw_data import RawData, sum_of_channel

# largest number of pulses and rows from which energies are computed
ROWS = 512


def shown_share(
    raw: RawData,
    pixels: C64,
    grid: ImageGrid,
    cell: tuple[float, float],
    sine: float,
) -> float:
    r"""Share of the echoes' energy that an image contains.

    An ideal point at the middle of the image has in the echoes and in the image the energies

    .. math:: \frac{\delta_r}{\Delta r} \sum_t \left(\frac{K g_t}{R_t R_r}\right)^2, \quad
              \frac{\rho_a \rho_r}{\Delta_a \Delta_r \sin\theta}

    with range cell and sample spacing of the echoes, resolution cells and pixel spacings of the image; on a slant grid
    without the sine. Their quotient turns energies of echoes into energies of images.

    Parameters
    ----------
    raw : range-compressed
    pixels : (n_layers, n_azimuth, n_range) of its image
    grid : of the image
    cell : resolution cells in azimuth and slant range, m
    sine : of the incidence angle at the middle of the image

    Returns
    -------
    the least of all channels; NaN where there is no energy, or noise in the echoes

    Notes
    -----
    Ignores that gain and range differ over the image.
    """
    radar = raw.radar
    if radar.noise_temperature > 0.0:
        return float("nan")
    window = radar.window
    spacing = grid.azimuth_spacing * grid.range_spacing * (sine if grid.kind == "ground" else 1.0)
    middle = grid.positions_on_line(grid.azimuth.size // 2)[grid.range.size // 2]
    echo = float(np.sum(_amplitude(radar, middle) ** 2)) * radar.waveform.range_cell / window.sample_spacing
    image = cell[0] * cell[1] / spacing
    shares = []
    for channel in raw.channels:
        seen = _energy(pixels, raw, channel)
        sent = _energy(raw.data, raw, channel)
        if sent > 0.0 and echo > 0.0:
            shares.append(seen / image / (sent / echo))
    return min(shares, default=float("nan"))


def _amplitude(radar: Radar, place: F64) -> F64:
    """Amplitude of the echoes of a point of 1 m^2 in all pulses, (n_pulses,) sqrt(W)."""
    legs = [place - track.position for track in radar.tracks]
    ranges = [np.linalg.norm(leg, axis=1) for leg in legs]
    directions = [leg / distance[:, None] for leg, distance in zip(legs, ranges, strict=True)]
    gain = antennas_gain(radar, slice(None), directions)
    return np.asarray(radar.amplitude_constant * gain / (ranges[0] * ranges[-1]))


def _energy(data: C64, raw: RawData, channel: str) -> float:
    """Energy of a channel of (n_layers, n_rows, n), from a subset of the rows where there are many."""
    step = -(-data.shape[1] // ROWS)
    some = sum_of_channel(data[:, ::step], raw.layers, channel, "raw data")
    return float(np.vdot(some, some).real * data.shape[1] / some.shape[0])
