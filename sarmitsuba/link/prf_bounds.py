"""Pulse timing: bounds of the pulse repetition frequency, blind ranges, nadir echo."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.mode import UP
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import Box, doppler_bandwidth

Interval = tuple[float, float]

# pulses at which the window's delays are looked at
_LOOKS = 33
# the diamond is worked out up to this many times the upper bound's interval, and lists no more than so many bands
_MOST_BANDS = 400


@dataclass(frozen=True)
class PulseTiming:
    """Pulses and echoes in time.

    Parameters
    ----------
    prf : pulse repetition frequency, Hz
    pulse_width : s
    duty_cycle : share of the time that the transmitter is on
    peak_power, average_power : W
    processed_bandwidth : Doppler bandwidth that the image is made of: of every pixel's own aperture, or what the image
        spreads over at one instant where the beam is steered, Hz; no prf below it makes the image
    beam_bandwidth : Doppler spread between the beam's half-power directions, Hz; infinite when isotropic
    lowest_prf : below it ground beside the image folds into it, Hz: `processed_bandwidth`, and where a beam is steered
        over an image that fills a part of it, the bandwidth of the beam or, of pixels with apertures of their own, of
        these
    highest_prf : above it the echoes of one pulse last longer than the interval leaves free, Hz
    echo_begins, echo_ends : delay after the pulse's start of the first and after the last echo of the swath, s
    nadir_begins, nadir_ends : that of the echo from straight below, s; its own pulse's is compressed to its own range,
        ahead of the swath, and only later pulses' count
    pulses_in_flight : sent between a pulse and its first echo
    blind_share : part of the swath's echoes that arrive while a pulse leaves
    nadir_share : part of the swath's echoes that arrive with the nadir's echo of another pulse
    free_prf : bands between `lowest_prf` and `highest_prf` in which neither happens, (low, high) in Hz
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
        """The free pulse repetition frequency next to ``prf``, Hz; None where there is none."""
        inside = [min(max(self.prf, low), high) for low, high in self.free_prf]
        return min(inside, key=lambda f: abs(f - self.prf), default=None)


def pulse_timing(radar: Radar, grid: ImageGrid, height: float) -> PulseTiming:
    """Timing of a radar with at least two pulses.

    Parameters
    ----------
    radar : whose track, beam and pulse count
    grid : of the image; its slant ranges are the swath
    height : of the antenna over the ground straight below, m

    Notes
    -----
    Takes the swath's delays at mid-aperture, and the nadir's echo as that of a point. Ignores receiver protection
    beyond the pulse's own length.
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
    """Whether only the Doppler spread of one instant has to fit: the beam, or the focuser, follows the place."""
    return radar.mode_law.instantaneous_doppler or not radar.track.is_straight


def _beam_bandwidth(radar: Radar, speed: float) -> float:
    """Doppler spread between the half-power directions, Hz."""
    if radar.antenna.pattern == "isotropic":
        return float("inf")
    return 4.0 * speed / radar.waveform.wavelength * float(np.sin(0.5 * radar.antenna.azimuth_beamwidth))


def overlap_share(window: Interval, event: Interval, prf: float, earliest: int | None = None) -> float:
    """Part of a time window that repetitions of an event cover.

    Parameters
    ----------
    window : begin and end, s
    event : begin and end of one of them, s; it comes again every interval, before and after
    prf : how often, Hz
    earliest : number of the first repetition that counts, 0 is ``event`` itself; None: all
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
    r"""Bands of the pulse repetition frequency f in which no pulse and no nadir echo meets the swath's echoes.

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
    bands, (low, high) in Hz, in rising order
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
    """A band less the frequencies at which the nadir's echo of a later pulse falls among the echoes.

    Parameters
    ----------
    band : low and high, Hz
    until, since : delays of the end of the swath's echoes after the nadir's begin, and of their begin after its end, s
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
