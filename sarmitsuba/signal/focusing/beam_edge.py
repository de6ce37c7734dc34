"""Image rows at the edge of a steered beam, where side lobes of brighter ground exceed the local clutter."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import aperture_weights, matched_weights
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image.sar_image import ImageGrid

# rows at which the beam is evaluated, over three times the image's extent
_NODES = 385
# azimuth cells of side lobes that are included, and samples per cell
_LOBES, _FINE = 512, 9
# level error above which rows are named in a warning, dB
_FALSE_LEVEL_DB = 0.2


def false_level(radar: Radar, grid: ImageGrid, window: Window, cell: float) -> F64:
    r"""Level error of homogeneous clutter in every row, linear ratio to the truth, (n_azimuth,) float64.

    Focusing divides by the beam's gain, which also raises the side lobes of other rows:

    .. math:: l(x) = \frac{\sum_m P(x + m \delta) |h_m|^2}{P(x) \sum_m |h_m|^2}

    Parameters
    ----------
    radar, grid : beam and image
    window : over the aperture; its transform is h
    cell : m, noise-equivalent azimuth cell

    Notes
    -----
    P is the mean two-way power gain over the pixel's aperture at the image's middle column. Ignores azimuth
    ambiguities and the gain's change over the aperture.
    """
    middle = grid.positions_on_line(grid.azimuth.size // 2)[grid.range.size // 2]
    half = max(1.5 * float(np.ptp(grid.azimuth)), cell)
    center = float(grid.azimuth[grid.azimuth.size // 2])
    node = np.linspace(-half, half, _NODES)
    power = np.empty(_NODES)
    for i, x in enumerate(node):
        point = middle + x * grid.along
        weights = aperture_weights(radar, point, window)
        power[i] = matched_weights(radar, point, window).sum() / max(float(weights.sum()), 1e-300)
    power = np.maximum(power, 1e-12)

    n = 2 * _LOBES
    response = np.abs(np.fft.fft(window((np.arange(n) + 0.5) / n - 0.5), n * _FINE)) ** 2
    lobes = response[: _LOBES * _FINE]
    lobes = np.concatenate([lobes[:0:-1], lobes])  # from -512 to 512 cells
    share = np.convolve(lobes, np.ones(_FINE), "same")[(_LOBES * _FINE - 1) % _FINE :: _FINE]
    x = np.arange(-half, half, cell / window.broadening)
    dense = np.interp(x, node, power)
    whole = np.convolve(np.pad(dense, share.size // 2, mode="edge"), share / share.sum(), "valid")
    return np.asarray(np.interp(grid.azimuth - center, x, whole[: x.size] / dense))


def beam_edge_warning(radar: Radar, grid: ImageGrid, window: Window, cell: float) -> str:
    """Warning about rows so far off the centre of a steered beam that their level is wrong; empty when none are."""
    if not radar.antenna.directive or radar.mode_law.own_apertures or radar.track.n_pulses < 2:
        return ""
    level = 10.0 * np.log10(false_level(radar, grid, window, cell))
    wrong = level > _FALSE_LEVEL_DB
    if not wrong.any():
        return ""
    azimuth = grid.azimuth
    parts = [azimuth[half & wrong] for half in (azimuth < azimuth.mean(), azimuth >= azimuth.mean())]
    spans = " and ".join(f"{part[0]:.4g} to {part[-1]:.4g} m" for part in parts if part.size)
    return (
        f"the rows at azimuth {spans} lie at the edge of the beam or outside it: side lobes and ambiguities of "
        f"illuminated ground raise their level by {level[wrong].min():.2g} dB to {level.max():.3g} dB or more; "
        "shrink image_extent_azimuth, widen the beam, or use an azimuth window of low side lobes"
    )
