"""Phase histories of selected pixels: the terms of backprojection's sum, pulse by pulse."""

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.profiles import plan_profiles
from sarmitsuba.signal.focusing.windows import Window, parse_window

# (point, pulse) pairs processed at once
_BATCH = 1 << 19


def pulse_contributions(
    data: C64, radar: Radar, points: F64, range_window: str | Window, azimuth_window: str | Window
) -> C64:
    r"""Terms of backprojection's sum, :math:`b_{pt} = w_t g_t^2 R_t^2 s_t(R_t) e^{j k_c R_t}`, :math:`R_t = |p - A_t|`.

    Parameters
    ----------
    data : (n_pulses, n_samples) complex64, range compressed
    radar : gives track, window, antenna and waveform
    points : (n, 3) float64, m, scene frame
    range_window, azimuth_window : as in ``backproject``

    Returns
    -------
    (n, n_pulses) complex64, with one factor of the beam's gain more than the pixel, which reduces the weight of the
    beam's edge; zero for pulses that do not illuminate the point or whose window does not contain it
    """
    plan = plan_profiles(radar, parse_window(range_window), interpolation="kernel:4")
    kernel = plan.kernel
    profiles = plan.profiles(data)
    row = np.arange(radar.track.n_pulses) * plan.n_stored
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    out = np.empty((points.shape[0], radar.track.n_pulses), dtype=np.complex64)
    step = max(1, _BATCH // radar.track.n_pulses)
    for start in range(0, points.shape[0], step):
        point = points[start : start + step]
        distance = np.linalg.norm(point[:, None] - radar.track.position, axis=-1)
        place = (distance - radar.window.start_range) / plan.step
        inside = (place >= 0.0) & (place <= plan.last)
        place = np.where(inside, place, 0.0)
        base = np.floor(place)
        index = row + base.astype(np.int64)
        value = np.zeros(distance.shape, dtype=np.complex64)
        for k, tap in enumerate(kernel.taps(place - base)):
            value += profiles.ravel()[np.minimum(index + k, profiles.size - 1)] * tap.astype(np.float32)
        weight = matched_weights(radar, point, azimuth_window) * inside * distance**2
        out[start : start + step] = value * weight * np.exp(1j * np.mod(wavenumber * distance, 2.0 * np.pi))
    return out
