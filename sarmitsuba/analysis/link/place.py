"""Signal and noise at one point of the image: aperture, resolution, radar equation."""

from dataclasses import dataclass

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.link_budget import nesz
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import (
    direction_gain,
    ground_cell_area,
    incidence_angle,
    look_directions,
    matched_weights,
    range_gradients,
)
from sarmitsuba.signal.focusing.image_noise import noise_equivalent_rcs
from sarmitsuba.signal.focusing.windows import Window

# step and limit of the search for the half-power width of an impulse response, cells
_STEP, _REACH = 0.25, 4.0


@dataclass(frozen=True)
class PlaceBudget:
    """Link budget of one point on the image plane.

    Parameters
    ----------
    name : ``near``, ``middle`` or ``far`` in the swath
    position : (x, y, z) m, frame of the scene's file
    slant_range : from mid-aperture, m
    incidence_angle : from the vertical at mid-aperture, rad
    pattern : two-way power gain of the antenna relative to its peak, at the pulse with the highest gain
    held : the same at the weaker end of the aperture, relative to `pattern`
    n_pulses : pulses in the aperture of the point
    aperture_length, aperture_time : from the first to the last of them, m and s
    range_resolution, ground_range_resolution, azimuth_resolution : half-power widths with their windows, m
    azimuth_cell : noise-equivalent width, m
    cell_area : noise-equivalent area of the impulse response on the ground, m^2
    snr : signal-to-noise ratio of a point target of `rcs`; NaN without a noise temperature, as the next three
    snr_ground : signal-to-noise ratio of ground of `sigma0`
    nesz : noise-equivalent sigma0 of the image, linear; independent of a pointing error
    nesz_textbook : noise-equivalent sigma0 by the textbook form, for equal pulses at boresight
    rcs, sigma0 : of the signals, m^2 and linear
    azimuth_ambiguity : azimuth ambiguity-to-signal ratio of homogeneous ground; NaN: unknown
    range_ambiguity : range ambiguity-to-signal ratio of homogeneous ground; NaN: unknown
    """

    name: str
    position: tuple[float, float, float]
    slant_range: float
    incidence_angle: float
    pattern: float
    held: float
    n_pulses: int
    aperture_length: float
    aperture_time: float
    range_resolution: float
    ground_range_resolution: float
    azimuth_resolution: float
    azimuth_cell: float
    cell_area: float
    snr: float
    snr_ground: float
    nesz: float
    nesz_textbook: float
    rcs: float
    sigma0: float
    azimuth_ambiguity: float = float("nan")
    range_ambiguity: float = float("nan")


@dataclass(frozen=True)
class Processing:
    """Windows of the image, and signals for the signal-to-noise ratios.

    Parameters
    ----------
    range_window, azimuth_window : over band and aperture
    rcs : of a point, m^2
    sigma0 : of homogeneous ground, linear
    """

    range_window: Window
    azimuth_window: Window
    rcs: float = 1.0
    sigma0: float = 0.1


def place_budget(radar: Radar, name: str, point: F64, processing: Processing) -> PlaceBudget:
    """Link budget of a point, with the weights of backprojection, which other focusers share.

    Parameters
    ----------
    radar : with two pulses or more
    name, point : of the point, (3,) m, scene frame
    processing : windows and signals

    Raises
    ------
    DataError
        No pulse illuminates the point.

    Notes
    -----
    With the approximations of `noise_equivalent_rcs` and `ground_cell_area`.
    """
    told = radar.as_recorded()
    weights = matched_weights(told, point, processing.azimuth_window)
    area = ground_cell_area(told, point, weights, processing.range_window)
    angle = float(incidence_angle(radar, point))
    range_cell = radar.waveform.range_cell
    slant = float(np.linalg.norm(point - radar.track.center_position))
    gain = direction_gain(radar, slice(None), look_directions(radar, point))
    nominal = direction_gain(told, slice(None), look_directions(told, point))
    used = np.flatnonzero(weights > 0.0)
    # echoes of a beam with a pointing error unknown to the focuser, over those without
    seen = weights[used] * gain[used] / nominal[used]
    level, ground_level = (
        float((seen.sum() / weights.sum()) ** 2),
        float(np.sum(seen**2) / np.sum(weights**2)),
    )
    time = radar.track.time
    step = 1.0 / radar.track.prf
    flown = np.linalg.norm(np.diff(radar.track.position, axis=0), axis=1)[used[0] : used[-1]]
    width = half_power_width((np.arange(1024) + 0.5) / 1024 - 0.5, processing.range_window.aperture(1024))
    along = 2.0 / radar.waveform.wavelength * (range_gradients(told, point) @ radar.track.along)
    noise = textbook = float("nan")
    if radar.noise_temperature > 0.0:
        noise = noise_equivalent_rcs(told, point, weights, processing.range_window)
        textbook = _textbook_nesz(radar, slant, angle)
    azimuth_cell = area * float(np.sin(angle)) / (range_cell * processing.range_window.broadening)
    x, y, z = (float(v) for v in point + radar.offset)
    return PlaceBudget(
        name=name,
        position=(x, y, z),
        slant_range=slant,
        incidence_angle=angle,
        pattern=float(gain.max() ** 2),
        held=float((gain[used[[0, -1]]].min() / gain.max()) ** 2),
        n_pulses=int(used.size),
        aperture_length=float(flown.sum()) * used.size / max(used.size - 1, 1),
        aperture_time=float(time[used[-1]] - time[used[0]]) + step,
        range_resolution=width * range_cell,
        ground_range_resolution=width * range_cell / float(np.sin(angle)),
        azimuth_resolution=half_power_width(along, weights),
        azimuth_cell=azimuth_cell,
        cell_area=area,
        snr=level * processing.rcs / noise,
        snr_ground=ground_level * processing.sigma0 * area / noise,
        nesz=noise / area,
        nesz_textbook=textbook,
        rcs=processing.rcs,
        sigma0=processing.sigma0,
    )


def _textbook_nesz(radar: Radar, slant_range: float, angle: float) -> float:
    """Noise-equivalent sigma0 of pulses at boresight, for one metre of track: the aperture length cancels."""
    speed = float(np.linalg.norm(radar.track.velocity[radar.track.center_index]))
    azimuth_cell = radar.waveform.wavelength * slant_range / 2.0
    return nesz(radar, slant_range, angle, azimuth_cell, radar.track.prf / speed)


def half_power_width(frequency: F64, weights: F64) -> float:
    r"""Half-power width of :math:`|\sum_i W_i e^{j 2 \pi f_i x}|^2` about its peak at 0.

    Parameters
    ----------
    frequency : (n,) spatial frequencies, cycles per unit of the result
    weights : (n,) of the frequencies, not negative
    """
    seen = weights > 0.0
    f, w = frequency[seen], weights[seen]
    f = f - np.average(f, weights=w)
    spread = max(float(np.ptp(f)), 1e-300)

    def above_half(cells: float) -> float:
        return float(np.abs(np.exp(2j * np.pi / spread * cells * f) @ w) ** 2 / w.sum() ** 2) - 0.5

    last = _STEP
    while above_half(last) > 0.0:
        last += _STEP
        if last > _REACH:
            return float("inf")
    return 2.0 * float(scipy.optimize.brentq(above_half, last - _STEP, last, xtol=1e-6)) / spread
