"""Ideal test data: a simple radar, and the exact range-compressed echoes of point scatterers."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.focusing.aperture_weights import direction_gain
from sarmitsuba.signal.raw_data import Layer, RawData


def ideal_radar(
    *,
    slant_range: float = 10e3,
    resolution: float = 1.0,
    bandwidth: float = 150e6,
    center_frequency: float = 9.6e9,
    look_angle: float = np.pi / 4,
    squint_angle: float = 0.0,
    n_samples: int = 256,
    prf_factor: float = 1.25,
    sampling_factor: float = 1.2,
    pulse_width: float = 10e-6,
    antenna: Antenna | None = None,
    mode: str = "spotlight",
) -> Radar:
    """Right-looking radar on a level straight track towards +y that aims at the origin.

    Parameters
    ----------
    slant_range : m, mid-aperture to the origin
    resolution : azimuth cell, m, which sets the aperture's length
    bandwidth, center_frequency : Hz
    look_angle, squint_angle : rad; from nadir, and forward of broadside in the slant plane
    n_samples : of the receive window, whose middle follows the origin to a whole sample
    prf_factor : pulse rate over the Doppler bandwidth of the aperture
    sampling_factor : sampling rate over the bandwidth
    pulse_width : s
    antenna : default isotropic
    mode : one of `sarmitsuba.radar.mode.MODES`, with its defaults
    """
    waveform = Waveform(center_frequency, bandwidth, pulse_width)
    cos = np.cos(squint_angle)
    length = waveform.wavelength * slant_range / (2.0 * resolution * cos)
    spacing = resolution * cos / prf_factor
    speed = 7500.0 if slant_range > 200e3 else 100.0
    look = np.array([np.sin(look_angle) * cos, np.sin(squint_angle), -np.cos(look_angle) * cos])
    track = Track.straight(
        -slant_range * look, [0.0, speed, 0.0], speed / spacing, max(8, round(length / spacing))
    )

    distance = np.linalg.norm(track.position, axis=1)
    geometry = AimGeometry(
        np.zeros(3), -slant_range * look, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    )

    sample = SPEED_OF_LIGHT / (2.0 * sampling_factor * bandwidth)
    start = (np.floor(distance / sample) - n_samples // 2) * sample
    return Radar(
        mode=mode,
        track=track,
        waveform=waveform,
        antenna=antenna or Antenna(),
        pointing=MODES[mode].pointing(track, geometry),
        window=ReceiveWindow(start, sample, n_samples),
    )


def ideal_echoes(radar: Radar, positions: ArrayLike, rcs: ArrayLike = 1.0, phase: ArrayLike = 0.0) -> RawData:
    r"""Exact range-compressed echoes of point scatterers, one layer.

    .. math:: s_t(r) = \sum_p K \sqrt{\sigma_p} \, g_t(p) \, e^{j \phi_p} R_{tp}^{-2} \,
              \mathrm{sinc}\left(\frac{r - R_{tp}}{c / 2B}\right) e^{-j 4 \pi f_c R_{tp} / c}

    Parameters
    ----------
    radar : gives track, window, waveform and antenna
    positions : (n, 3) or (3,) m, scene frame
    rcs : m^2, scalar or (n,)
    phase : rad, scalar or (n,)

    Notes
    -----
    Ignores visibility and everything but the direct path. Costs points x pulses x samples: for a few points.
    """
    points = np.atleast_2d(np.asarray(positions, dtype=np.float64))
    amplitude = np.broadcast_to(np.sqrt(rcs) * np.exp(1j * np.asarray(phase)), points.shape[:1])
    window, cell = radar.window, radar.waveform.range_cell
    samples = window.start_range[:, None] + window.sample_spacing * np.arange(window.n_samples)
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    data = np.zeros(samples.shape, dtype=np.complex128)
    for point, a in zip(points, amplitude, strict=True):
        line = point - radar.track.position
        r = np.linalg.norm(line, axis=1)
        gain = direction_gain(radar, slice(None), line / r[:, None])
        value = a * gain * radar.amplitude_constant / r**2 * np.exp(-1j * wavenumber * r)
        data += value[:, None] * np.sinc((samples - r[:, None]) / cell)
    return RawData(
        data=data[None].astype(np.complex64),
        layers=(Layer(radar.channels[0]),),
        domain="compressed",
        radar=radar,
        metadata={"source": "ideal point echoes"},
    )
