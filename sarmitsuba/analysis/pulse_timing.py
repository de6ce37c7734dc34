"""Pulse timing: bounds of the pulse repetition frequency, blind ranges, nadir echo, and ambiguities.

Ambiguity-to-signal ratios of homogeneous ground are closed forms of the antenna pattern, in azimuth and in range.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_RADIUS, SPEED_OF_LIGHT
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.mode import UP
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import Box, doppler_bandwidth
from sarmitsuba.signal.focusing.aperture_weights import flight, incidence_angle
from sarmitsuba.signal.image import ImageGrid

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
            position, velocity, _box(grid), wave.wavelength, instantaneous=_samples_one_instant(radar)
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


def _samples_one_instant(radar: Radar) -> bool:
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
            bands += _cut_nadir(band, t1 - nadir[0], t0 - nadir[0] - pulse_width)
        n += 1
    return tuple(bands)


def _cut_nadir(band: Interval, until: float, since: float) -> list[Interval]:
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


# relative one-way power gain over the sine of the angle off boresight, in the plane of one of the aperture's axes
Gain = Callable[[F64], F64]
_NODES = 4001


def azimuth_ambiguity_ratio(
    gain: Gain,
    wavelength: float,
    prf: float,
    speed: float,
    bandwidth: float,
    *,
    weighting: Literal["uniform", "matched"] = "uniform",
    squint: float = 0.0,
    pointing_error: float = 0.0,
    orders: int = 20,
) -> float:
    r"""Azimuth ambiguity-to-signal ratio of homogeneous ground in stripmap, power.

    .. math:: \frac{\sum_{m \ne 0} \int_{-B/2}^{B/2} W(f) G^2(f + m f_p) df}{\int_{-B/2}^{B/2} W(f) G^2(f) df}

    with G the one-way power gain over Doppler frequency and W the power weights of the processor: 1, or G^2 of the
    nominal beam if pulses are weighted by the antenna pattern, as in this program's backprojection.

    Parameters
    ----------
    gain : over the sine of the angle off boresight
    wavelength, prf, speed : m, Hz, m/s
    bandwidth : B, processed Doppler bandwidth, Hz
    weighting : W
    squint : of the nominal boresight, rad
    pointing_error : true minus nominal boresight in azimuth, rad
    orders : highest m; directions behind the aperture plane do not count

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    half = 0.25 * wavelength * bandwidth / speed
    sine = np.sin(squint) + np.linspace(-half, half, _NODES)
    weight = gain(_off_boresight(sine, squint)) ** 2 if weighting == "matched" else np.ones(_NODES)

    def energy(order: int) -> float:
        seen = sine + order * wavelength * prf / (2.0 * speed)
        visible = np.abs(seen) < 1.0
        return float(np.sum(weight * visible * gain(_off_boresight(seen, squint + pointing_error)) ** 2))

    return sum(energy(m) for m in range(-orders, orders + 1) if m) / energy(0)


def range_ambiguity_ratio(
    gain: Gain,
    slant_range: float,
    height: float,
    prf: float,
    look_angle: float,
    *,
    earth_radius: float = np.inf,
    sigma0: Callable[[F64], F64] | None = None,
    orders: int = 50,
) -> float:
    r"""Range ambiguity-to-signal ratio of homogeneous ground, power.

    .. math:: \frac{\sum_{j \ne 0} P(R_j)}{P(R)}, \quad
              P(R) = \frac{\sigma^0(\theta) G^2(\gamma - \gamma_0)}{R^3 \sin\theta}, \quad
              R_j = R + \frac{j c}{2 f_p}

    over the orders whose range lies between nadir and the horizon.

    Parameters
    ----------
    gain : in elevation, over the sine of the angle off boresight
    slant_range, height : R, and of the antenna above the ground, m
    prf : Hz
    look_angle : gamma_0 of the boresight, from nadir, rad
    earth_radius : m; infinite for flat ground
    sigma0 : over the incidence angle theta, rad; None: constant
    orders : highest j, if the sum does not end at the horizon

    Notes
    -----
    Ignores ground on the other side of the track, and the specular nadir echo.

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    horizon = np.inf if np.isinf(earth_radius) else np.sqrt(height * (2.0 * earth_radius + height))

    def power(distance: F64) -> F64:
        bulge = 0.0 if np.isinf(earth_radius) else (distance**2 - height**2) / (2.0 * earth_radius)
        # cosine of the incidence angle, and of the look angle, by the law of cosines without its cancellation
        cos_incidence = np.clip((height - bulge) / distance, 0.0, 1.0)
        ratio = 1.0 if np.isinf(earth_radius) else earth_radius / (earth_radius + height)
        sin_incidence = np.sqrt(1.0 - cos_incidence**2)
        look = np.arcsin(ratio * sin_incidence)
        level = sigma0(np.arcsin(sin_incidence)) if sigma0 is not None else 1.0
        return np.asarray(level * gain(np.sin(look - look_angle)) ** 2 / (distance**3 * sin_incidence))

    order = np.arange(-orders, orders + 1)
    distance = slant_range + order * SPEED_OF_LIGHT / (2.0 * prf)
    seen = (order != 0) & (distance > height * (1.0 + 1e-9)) & (distance < horizon)
    return float(power(distance[seen]).sum() / power(np.array([slant_range]))[0])


def _off_boresight(sine: F64, squint: float) -> F64:
    """Sine of the angle off a boresight at ``squint`` (rad) of directions whose sine along the flight is ``sine``."""
    clipped = np.clip(sine, -1.0, 1.0)
    return np.asarray(clipped * np.cos(squint) - np.sqrt(1.0 - clipped**2) * np.sin(squint))


@dataclass(frozen=True)
class Vantage:
    """Height and look angle of the antenna for a point on spherical or flat ground.

    Parameters
    ----------
    height : m over the ground
    look_angle : of the line of sight to the place, from the antenna's nadir, rad
    """

    height: float
    look_angle: float


def earth_radius(given: RadarInput | None) -> float:
    """Radius of the ground under the antenna, m; infinite for a flight along the scene's plane, not in an orbit."""
    if given is None:
        return float("inf")
    orbits = given.sensor.orbit_altitude > 0.0 or bool(given.sensor.state_vectors_file)
    return EARTH_RADIUS if orbits else float("inf")


def vantage(slant_range: float, incidence: float, radius: float) -> Vantage:
    r"""Height and look angle of an antenna at a slant range and incidence, by the law of cosines.

    .. math:: h = \frac{R^2 + 2 R R_e \cos\theta}{R_e + \sqrt{R_e^2 + R^2 + 2 R_e R \cos\theta}}, \qquad
              \sin\gamma = \frac{R_e}{R_e + h} \sin\theta

    Parameters
    ----------
    slant_range : R, m
    incidence : theta, rad
    radius : R_e of the ground, m; infinite for a plane
    """
    if np.isinf(radius):
        return Vantage(slant_range * float(np.cos(incidence)), incidence)
    square = slant_range**2 + 2.0 * slant_range * radius * float(np.cos(incidence))
    height = square / (radius + float(np.sqrt(radius**2 + square)))
    return Vantage(height, float(np.arcsin(radius / (radius + height) * np.sin(incidence))))


def vantage_of(radar: Radar, point: F64, radius: float) -> Vantage:
    """Height and look angle of mid-aperture for a point (3,), m, scene frame."""
    slant = float(np.linalg.norm(point - radar.track.center_position))
    return vantage(slant, float(incidence_angle(radar, point)), radius)


def azimuth_ambiguity(radar: Radar, prf: float, processed_bandwidth: float) -> float:
    """Azimuth ambiguity-to-signal ratio of homogeneous ground, power; NaN for an isotropic antenna.

    Parameters
    ----------
    radar : of the beam
    prf : Hz
    processed_bandwidth : of the aperture of a pixel, Hz; for a steered beam at its centre

    Notes
    -----
    Weights of backprojection, without a window. For a steered beam the ratio holds at its centre.
    """
    antenna, wavelength = radar.antenna, radar.waveform.wavelength
    if not antenna.directive:
        return float("nan")
    middle = radar.track.center_index

    def gain(sine: F64) -> F64:
        return np.asarray(antenna.two_way_amplitude(np.asarray(sine), np.zeros_like(sine)))

    return azimuth_ambiguity_ratio(
        gain,
        wavelength,
        prf,
        float(np.linalg.norm(radar.track.velocity[middle])),
        processed_bandwidth if np.isfinite(radar.half_aperture) else 0.0,
        weighting="matched",
        squint=float(np.arcsin(flight(radar)[1][middle])),
    )


def range_ambiguity(radar: Radar, prf: float, point: F64, radius: float) -> float:
    """Range ambiguity-to-signal ratio of homogeneous ground at a point (3,), power; NaN for an isotropic antenna.

    Parameters
    ----------
    radar : of the beam; its boresight looks at the aim point
    prf : Hz
    point : m, scene frame
    radius : of the ground, m, see :func:`earth_radius`

    Notes
    -----
    Ignores the other side of the track. The simulator itself adds no echoes of other pulses.
    """
    antenna = radar.antenna
    if not antenna.directive:
        return float("nan")

    def gain(sine: F64) -> F64:
        return np.asarray(antenna.two_way_amplitude(np.zeros_like(sine), np.asarray(sine)))

    slant = float(np.linalg.norm(point - radar.track.center_position))
    boresight = vantage_of(radar, radar.aim_point, radius)
    return range_ambiguity_ratio(
        gain, slant, boresight.height, prf, boresight.look_angle, earth_radius=radius
    )
