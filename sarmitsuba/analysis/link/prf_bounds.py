"""Pulse timing: bounds of the pulse repetition frequency, blind ranges, nadir echo."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.mode import UP
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import Box, doppler_bandwidth
from sarmitsuba.signal.image.sar_image import ImageGrid

Interval = tuple[float, float]

# pulses at which the delays of the window are evaluated
_LOOKS = 33
# range of the diamond diagram, in intervals of the upper bound, and largest number of listed bands
_MOST_BANDS = 400


@dataclass(frozen=True)
class PulseTiming:
    """Timing of pulses and echoes.

    Parameters
    ----------
    prf : pulse repetition frequency, Hz
    pulse_width : s
    duty_cycle : share of time in which the transmitter is on
    peak_power, average_power : W
    processed_bandwidth : Doppler bandwidth of the image, Hz: that of a pixel's aperture, or for a steered beam the
        spread over the image at one instant; a lower prf cannot form the image
    beam_bandwidth : Doppler spread between the beam's half-power directions, Hz; infinite when isotropic
    lowest_prf : prf below which ground outside the image is aliased into it, Hz: `processed_bandwidth`, and for a beam
        steered over an image that fills a part of it, the bandwidth of the beam or of the pixels' apertures
    highest_prf : prf above which the echoes of one pulse exceed the free part of the interval, Hz
    echo_begins, echo_ends : delays after the start of the pulse of the first and after the last echo of the swath, s
    nadir_begins, nadir_ends : delays of the nadir echo, s; that of the same pulse is compressed to its own range,
        before the swath: only those of other pulses overlap it
    pulses_in_flight : pulses sent between a pulse and its first echo
    blind_share : part of the swath's echoes that arrive while a pulse is sent
    nadir_share : part of the swath's echoes that arrive with the nadir echo of another pulse
    free_prf : bands between `lowest_prf` and `highest_prf` without either overlap, (low, high) in Hz
    """

    prf: float
    pulse_width: float
    duty_cycle: float
    peak_power: float
    average_power: float
    processed_bandwidth: float
    beam_bandwidth: float
    lowest_prf: float
    highest_prf: float
    echo_begins: float
    echo_ends: float
    nadir_begins: float
    nadir_ends: float
    pulses_in_flight: int
    blind_share: float
    nadir_share: float
    free_prf: tuple[Interval, ...]

    @property
    def nearest_free_prf(self) -> float | None:
        """Free pulse repetition frequency closest to ``prf``, Hz; None: no free band."""
        inside = [min(max(self.prf, low), high) for low, high in self.free_prf]
        return min(inside, key=lambda f: abs(f - self.prf), default=None)


def pulse_timing(radar: Radar, grid: ImageGrid, height: float) -> PulseTiming:
    """Timing of a radar with at least two pulses.

    Parameters
    ----------
    radar : track, beam and pulse
    grid : of the image; its slant ranges are the swath
    height : of the antenna over the ground at nadir, m

    Notes
    -----
    Uses the delays of the swath at mid-aperture, and a point echo at nadir. Ignores receiver protection beyond the
    pulse length.
    """
    wave, track = radar.waveform, radar.track
    prf = radar.track.prf
    pick = np.unique(np.linspace(0, track.n_pulses - 1, _LOOKS).astype(int))
    position, velocity = track.position[pick], track.velocity[pick]
    corners = grid.positions_on_line(grid.azimuth.size // 2)[[0, -1]]
    slant = np.linalg.norm(corners - track.center_position, axis=1)
    begins, ends = (
        2.0 * float(slant.min()) / SPEED_OF_LIGHT,
        2.0 * float(slant.max()) / SPEED_OF_LIGHT + wave.pulse_width,
    )
    below = 2.0 * height / SPEED_OF_LIGHT
    nadir = (below, below + wave.pulse_width)
    speed = float(np.linalg.norm(track.velocity[track.center_index]))
    beam = _beam_bandwidth(radar, speed)
    used = (
        4.0 * speed / wave.wavelength * radar.half_aperture
    )  # of the beam, at every instant; infinite: all of it
    if np.isfinite(used) and not radar.mode_law.instantaneous_doppler:
        processed = used
    else:
        spread = doppler_bandwidth(
            position, velocity, _box(grid), wave.wavelength, instantaneous=_at_once(radar)
        )
        processed = min(used, spread)
    lowest = used if np.isfinite(used) else processed if np.isinf(beam) else beam
    highest = 1.0 / (ends - begins + wave.pulse_width)
    return PulseTiming(
        prf=prf,
        pulse_width=wave.pulse_width,
        duty_cycle=wave.pulse_width * prf,
        peak_power=radar.transmit_power,
        average_power=radar.transmit_power * wave.pulse_width * prf,
        processed_bandwidth=processed,
        beam_bandwidth=beam,
        lowest_prf=lowest,
        highest_prf=highest,
        echo_begins=begins,
        echo_ends=ends,
        nadir_begins=nadir[0],
        nadir_ends=nadir[1],
        pulses_in_flight=int(begins * prf),
        blind_share=overlap_share((begins, ends), (0.0, wave.pulse_width), prf),
        nadir_share=overlap_share((begins, ends), nadir, prf, earliest=1),
        free_prf=free_bands((begins, ends), nadir, wave.pulse_width, (lowest, highest)),
    )


def _box(grid: ImageGrid) -> Box:
    """The image's area, on its plane."""
    across = grid.across_distance()
    low = np.array([grid.azimuth[0], across.min(), 0.0])
    high = np.array([grid.azimuth[-1], across.max(), 0.0])
    foot = np.array([*grid.origin[:2], grid.height])
    return Box(foot, np.stack([grid.along, grid.across, UP]), low, high)


def _at_once(radar: Radar) -> bool:
    """Whether only the Doppler spread of one instant must be sampled: the beam, or the focuser, tracks the point."""
    return radar.mode_law.instantaneous_doppler or not radar.track.is_straight


def _beam_bandwidth(radar: Radar, speed: float) -> float:
    """Doppler spread between the half-power directions, Hz."""
    if not radar.antenna.directive:
        return float("inf")
    return 4.0 * speed / radar.waveform.wavelength * float(np.sin(0.5 * radar.antenna.azimuth_beamwidth))


def overlap_share(window: Interval, event: Interval, prf: float, earliest: int | None = None) -> float:
    """Fraction of a time window covered by repetitions of an event.

    Parameters
    ----------
    window : begin and end, s
    event : begin and end of one event, s; it is repeated every interval, before and after
    prf : of the repetitions, Hz
    earliest : number of the first repetition, 0 is ``event`` itself; None: all
    """
    interval = 1.0 / prf
    length = min(event[1] - event[0], interval)
    first = int(np.floor((window[0] - event[0] - length) / interval))
    last = int(np.ceil((window[1] - event[0]) / interval))
    first = first if earliest is None else max(first, earliest)
    start = event[0] + interval * np.arange(first, last + 1)
    covered = np.minimum(start + length, window[1]) - np.maximum(start, window[0])
    return float(np.maximum(covered, 0.0).sum() / (window[1] - window[0]))


def free_bands(
    window: Interval, nadir: Interval, pulse_width: float, bounds: Interval
) -> tuple[Interval, ...]:
    r"""Bands of the pulse repetition frequency f in which no pulse and no nadir echo overlaps the swath's echoes.

    .. math:: \frac{n}{t_0 - \tau} \le f \le \frac{n + 1}{t_1}, \qquad
              f \notin \left( \frac{m}{t_1 - t_n}, \frac{m}{t_0 - t_n - \tau} \right)

    with the echoes from t_0 to t_1, the pulse's length tau, the nadir's echo from t_n, and whole numbers n and m > 0:
    the white parts of the "diamond" diagram.

    Parameters
    ----------
    window, nadir : begin and end of the swath's and of the nadir's echo, s
    pulse_width : s
    bounds : lowest and highest frequency of interest, Hz

    Returns
    -------
    bands, (low, high) in Hz, ascending
    """
    t0, t1 = window
    low, high = bounds
    if not (t0 > pulse_width and low < high and np.isfinite(high)):
        return ()
    bands: list[Interval] = []
    n = int(np.ceil(low * t1)) - 1
    while n / (t0 - pulse_width) <= high and len(bands) < _MOST_BANDS:
        band = (max(low, n / (t0 - pulse_width)), min(high, (n + 1) / t1))
        if band[0] < band[1]:
            bands += _without_nadir(band, t1 - nadir[0], t0 - nadir[0] - pulse_width)
        n += 1
    return tuple(bands)


def _without_nadir(band: Interval, until: float, since: float) -> list[Interval]:
    """Parts of a band in which the nadir echo of a later pulse does not overlap the echoes.

    Parameters
    ----------
    band : low and high, Hz
    until, since : delay from the begin of the nadir echo to the end of the swath's echoes, and from its end to their
        begin, s
    """
    if until <= 0.0:
        return [band]
    left = [band]
    for m in range(max(1, int(band[0] * since)), int(band[1] * until) + 2):
        # the echo comes m intervals late: m / f + t_n < t_1 and m / f + t_n + tau > t_0
        start = m / until
        stop = m / since if since > 0.0 else np.inf
        parts: list[Interval] = []
        for low, high in left:
            parts += [(a, b) for a, b in ((low, min(high, start)), (max(low, stop), high)) if a < b]
        left = parts
    return left
