"""Synthetic aperture: geometry about the aim point, and the automatic track with consistent length, prf and pulses.

Pulse intervals are uniform, random, or a repeated (staggered) sequence. The footprint of a steered beam moves over the
scene, and the track is as long as the image needs to be lit.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import Value, one_line
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.bursts import BurstPlan
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.mode import MODES, AimGeometry, FlightPath, RadarMode, right_of
from sarmitsuba.radar.swath import Box, beam_bandwidth, doppler_bandwidth
from sarmitsuba.radar.track import Track, effective_velocity_ratio
from sarmitsuba.radar.waveform import Waveform

_LONGEST_SEQUENCE = 100_000


@dataclass(frozen=True)
class PulseIntervals:
    r"""Intervals between pulses over their mean 1 / prf.

    .. math:: T_i = \frac{c_{i \bmod M}}{f_p} (1 + \sigma e_i)

    Parameters
    ----------
    sequence : c, repeated intervals of mean 1; empty for uniform ones
    jitter : sigma, rms of the Gaussian interval errors
    seed : of e

    Notes
    -----
    Positions and echoes are those at the pulses' times, which the focuser knows.
    """

    sequence: tuple[float, ...] = ()
    jitter: float = 0.0
    seed: int = 0

    def times(self, prf: float, n_pulses: int) -> F64:
        """(n_pulses,) s; zero is halfway between the first and the last."""
        intervals = np.ones(max(n_pulses - 1, 0))
        if self.sequence:
            intervals = np.resize(np.asarray(self.sequence), intervals.size)
        if self.jitter > 0.0:
            noise = np.random.default_rng(self.seed).standard_normal(intervals.size)
            intervals = intervals * (1.0 + self.jitter * noise)
        time = np.concatenate([[0.0], np.cumsum(intervals)]) / prf
        return np.asarray(time - 0.5 * time[-1])

    def track(self, path: FlightPath, prf: float, n_pulses: int) -> Track:
        """Pulses along a path."""
        if not self.sequence and self.jitter == 0.0:
            return path.track(prf, n_pulses)
        time = self.times(prf, n_pulses)
        return Track(time, *path.states(time))


def pulse_intervals(given: RadarInput) -> PulseIntervals:
    """The intervals between pulses of a description.

    Raises
    ------
    RadarError
        ``pri_sequence`` is no list of intervals, or the seed has no effect.
    """
    s, where = given.sensor, given.where
    if "prf_jitter_seed" in given.sensor_given and s.prf_jitter == 0.0:
        raise RadarError(
            f"{where}: prf_jitter_seed has no effect without prf_jitter; set prf_jitter above 0 or leave it out"
        )
    return PulseIntervals(_sequence(s.pri_sequence, where), s.prf_jitter, s.prf_jitter_seed)


def _sequence(text: str, where: str) -> tuple[float, ...]:
    """Intervals over their mean; empty for an empty text."""
    if not text.strip():
        return ()
    wrong = RadarError(
        f'{where}: pri_sequence = "{one_line(text)}" is not a list of intervals above 0; give for example "0.9,1,1.1", '
        'or "ramp:40:0.3" for 40 intervals that fall evenly by 0.3 of their mean'
    )
    try:
        kind, *numbers = text.strip().split(":")
        if kind == "ramp":
            count, span = int(numbers[0]), float(numbers[1])
            if len(numbers) != 2 or not 2 <= count <= _LONGEST_SEQUENCE or not 0.0 < span < 2.0:
                raise wrong
            steps = np.linspace(1.0 + 0.5 * span, 1.0 - 0.5 * span, count)
        else:
            steps = np.array([float(cell) for cell in text.split(",")])
    except (ValueError, IndexError):
        raise wrong from None
    if steps.size < 2 or not np.isfinite(steps).all() or steps.min() <= 0.0:
        raise wrong
    return tuple(float(step) for step in steps / steps.mean())


# slant ranges on either side of mid-aperture within which the track is searched
_LONGEST = 50.0
# bisection steps, after which an interval is known to float64
_HALVINGS = 60


@dataclass(frozen=True, eq=False)
class BeamOverPath:
    """Beam steered by a mode along a path.

    Parameters
    ----------
    law : the mode
    path : flight path of the antenna
    geometry : about the aim point
    values : of the mode's parameters
    """

    law: RadarMode
    path: FlightPath
    geometry: AimGeometry
    values: Mapping[str, Value]

    def sines(self, time: F64, points: F64) -> tuple[F64, F64]:
        """Sines along the flight at (n,) times, s: of points (m, 3), giving (n, m), and of the boresight, (n,)."""
        track = Track(time, *self.path.states(time))
        forward = unit_rows(track.velocity)
        line = points[None] - track.position[:, None]
        sine = np.einsum("npc,nc->np", line, forward) / np.linalg.norm(line, axis=2)
        boresight = self.law.pointing(track, self.geometry, self.values).boresight
        return sine, np.einsum("nc,nc->n", boresight, forward)

    @cached_property
    def footprint_speed(self) -> float:
        r"""Speed of the footprint at the aim point over the antenna's: 1 for a beam fixed to the track, 0 in spotlight.

        .. math:: A = \left(1 - \frac{d s_{boresight}}{d s_{aim}}\right) \frac{V_{eff}^2}{V^2}

        over the sines s along the flight, and the effective velocity, V on a straight path; see
        `sarmitsuba.radar.radar.Radar.footprint_speed`.
        """
        step = 1e-3 * self.geometry.slant_range / self.path.speed
        time = np.array([-step, 0.0, step])
        aim, boresight = self.sines(time, self.geometry.aim[None])
        held = 1.0 - float(boresight[2] - boresight[0]) / float(aim[2, 0] - aim[0, 0])
        return held * effective_velocity_ratio(Track(time, *self.path.states(time)), self.geometry.aim, 1)

    def track_length(self, points: F64, half_aperture: float, where: str) -> float:
        """Length of track, centred on mid-aperture, whose beam passes over all points, m.

        Parameters
        ----------
        points : (n, 3) float64, m, scene frame
        half_aperture : largest sine off the boresight of pulses that are processed for a point
        where : start of an error

        Raises
        ------
        RadarError
            The beam never leaves a point on the expected side.
        """

        def passes(half: float) -> bool:
            time = np.array([-half, 0.0, half]) / self.path.speed
            sine, boresight = self.sines(time, points)
            offset = sine - boresight[:, None]
            return bool((offset[0] >= half_aperture).all() and (offset[2] <= -half_aperture).all())

        reach = self.geometry.slant_range
        high = 1e-4 * reach
        while not passes(high):
            high *= 1.25
            if high > _LONGEST * reach:
                raise RadarError(
                    f"{where}: the footprint moves at {self.footprint_speed:.3g} of the antenna's speed and never "
                    "passes over the whole image; let it move faster (sliding_factor), shrink the image or coarsen "
                    "azimuth_resolution"
                )
        low = high / 1.25
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if passes(middle) else (middle, high)
        return 2.0 * high


PRF_MARGIN = 1.25  # automatic prf over the Doppler bandwidth
MAX_PULSES = 10_000_000
MAX_APERTURE = 4.0  # largest length over slant range: the line of sight turns by 127 degrees
# a note says so where a track has this many times the pulses that the image needs, and at least this many: fewer are
# simulated in a second
SPARE_FACTOR, SPARE_FROM = 10, 1000
# deviation from 1 of the footprint's speed over the antenna's up to which a beam counts as fixed to a straight track:
# rounding
_FIXED = 1e-9
_REPLACED_BY_TRACK = (
    "slant_range",
    "look_angle_deg",
    "heading_deg",
    "squint_angle_deg",
    "speed",
    "prf",
    "prf_jitter",
    "prf_jitter_seed",
    "pri_sequence",
    "n_pulses",
    "azimuth_resolution",
    "orbit_altitude",
    "orbit_inclination_deg",
    "orbit_pass",
    "incidence_angle_deg",
    "state_vectors_file",
)


def geometry_from_angles(given: RadarInput, aim: F64) -> AimGeometry:
    """Mid-aperture position from slant range, look angle, heading and squint.

    Raises
    ------
    RadarError
        No line of sight has both the look angle and the squint.
    """
    s = given.sensor
    heading, look, squint = np.radians([s.heading_deg, s.look_angle_deg, s.squint_angle_deg])
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    across = right_of(along) if s.look_side == "right" else -right_of(along)
    side_square = np.sin(look) ** 2 - np.sin(squint) ** 2
    if side_square <= 0.0:
        raise RadarError(
            f"{given.where}: squint_angle_deg = {s.squint_angle_deg:g} deg is not smaller than "
            f"look_angle_deg = {s.look_angle_deg:g} deg, so that no line of sight has both; lower the "
            "squint or raise the look angle"
        )
    line = np.sin(squint) * along + np.sqrt(side_square) * across - np.cos(look) * np.array([0.0, 0.0, 1.0])
    return AimGeometry(aim, aim - s.slant_range * line, along, across)


def given_track(given: RadarInput, offset: F64) -> Track | None:
    """Track given in the description, in the scene frame; None when it follows from parameters.

    Raises
    ------
    RadarError
        The track cannot be read, is too long, or is given together with parameters that it replaces.
    """
    name = given.sensor.track_file
    if not name and given.track is None:
        return None
    what = "track_file" if name else "track"
    twice = ("track_file",) if name and given.track is not None else ()
    for other in (*_REPLACED_BY_TRACK, *MODES[given.sensor.mode].path_parameters, *twice):
        if other in given.sensor_given:
            raise RadarError(f"{given.where}: {other} has no effect beside {what}; leave one of them out")
    track = given.track
    if track is None:
        path = Path(name)
        track = Track.from_csv(path if path.is_absolute() else given.folder / path)
    if track.n_pulses > MAX_PULSES:
        raise RadarError(
            f"{name or given.where}: {track.n_pulses} pulses are more than {MAX_PULSES}; split the track"
        )
    return replace(track, position=track.position - offset)


def geometry_of_track(given: RadarInput, track: Track, aim: F64) -> AimGeometry:
    """Mid-aperture position of a given track, and the side on which the aim point lies.

    Raises
    ------
    RadarError
        The aim point lies on the track's vertical plane, or not on the side asked for.
    """
    right = right_of(track.along)
    side = float((aim - track.center_position) @ right)
    if side == 0.0:
        raise RadarError(
            f"{given.where}: the aim point lies straight below or ahead of the track; move aim_x, aim_y"
        )
    if "look_side" in given.sensor_given and (side > 0) != (given.sensor.look_side == "right"):
        raise RadarError(
            f"{given.where}: look_side = {given.sensor.look_side}, but the aim point lies {abs(side):g} m "
            "to the other side of the track; change look_side or the aim point"
        )
    return AimGeometry(aim, track.center_position, track.along, right * np.sign(side))


def known_azimuth_cell(
    given: RadarInput, geometry: AimGeometry, waveform: Waveform, track: Track | None, speed: float
) -> float:
    """Azimuth cell estimated before the track is known, at the antenna's speed (m/s), m."""
    s = given.sensor
    if s.azimuth_resolution > 0.0:
        return s.azimuth_resolution
    if track is not None and track.n_pulses > 1:
        length = float(np.linalg.norm(np.ptp(track.position, axis=0)))
    elif s.n_pulses > 1 and s.prf > 0.0:
        length = s.n_pulses * speed / s.prf
    else:
        return waveform.range_cell
    return MODES[s.mode].azimuth_cell(geometry, waveform.wavelength, max(length, 1e-9))


@dataclass(frozen=True, eq=False)
class _Wanted:
    """Requirements of an automatic track.

    Parameters
    ----------
    given : description
    geometry : about the aim point
    box : of the image
    faded : box as long as the largest distance between a pixel and scatterers in the fade-out zone
    waveform, antenna : of the radar
    path : flight path of the antenna
    """

    given: RadarInput
    geometry: AimGeometry
    box: Box
    faded: Box
    waveform: Waveform
    antenna: Antenna
    path: FlightPath

    @property
    def longest(self) -> float:
        """Longest aperture allowed, m."""
        return MAX_APERTURE * self.geometry.slant_range

    @property
    def own_apertures(self) -> bool:
        """Whether pixels are illuminated one after the other, each by the aperture of the azimuth resolution.

        An isotropic antenna illuminates every pixel all the time, and a given number of pulses without a resolution is
        one aperture for all pixels.
        """
        s = self.given.sensor
        lit_in_turn = MODES[s.mode].own_apertures and self.antenna.directive
        return lit_in_turn and (s.n_pulses == 0 or s.azimuth_resolution > 0.0)

    @cached_property
    def beam(self) -> BeamOverPath:
        """Motion of the beam over the scene."""
        law = MODES[self.given.sensor.mode]
        return BeamOverPath(law, self.path, self.geometry, self.given.sensor.mode_parameters)

    def half_aperture(self) -> float:
        """Half the aperture of a pixel, in sines, at most to the first null; infinite for one common aperture."""
        if not self.own_apertures:
            return np.inf
        offset = self.geometry.aim - self.geometry.center
        x = float(offset @ self.geometry.along)
        closest = float(np.linalg.norm(offset - x * self.geometry.along))
        end = np.array([x - 0.5 * self.length(), x + 0.5 * self.length()])
        half = 0.5 * float(np.ptp(end / np.hypot(end, closest))) * self.beam.footprint_speed
        return min(half, self.geometry.cos_squint * self.antenna.nulls[0])

    def track_length(self, half_aperture: float) -> float:
        r"""Length of track, centred on mid-aperture, that contains the apertures of all pixels of the image, m.

        .. math:: x_t = x - \rho \tan(\arcsin(\sin\psi \pm s_a))

        for a pixel at azimuth x and closest range rho, squint psi and half aperture s_a, where the beam is fixed to the
        track.
        """
        if not np.isfinite(half_aperture):
            return self.length()
        if abs(self.beam.footprint_speed - 1.0) > _FIXED:
            points = self.box.samples() @ self.box.axes + self.box.origin
            return self.beam.track_length(points, half_aperture, self.given.where)
        offset = self.box.samples() + self.geometry.axes @ (self.geometry.aim - self.geometry.center)
        closest = np.hypot(offset[:, 1], offset[:, 2])
        sine = float(self.geometry.line_of_sight @ self.geometry.along)
        edge = np.clip(sine + np.array([-1.0, 1.0]) * half_aperture, -0.99, 0.99)
        ends = offset[:, :1] - closest[:, None] * edge / np.sqrt(1.0 - edge**2)
        return 2.0 * float(np.abs(ends).max())

    def length(self) -> float:
        """Aperture of the azimuth resolution, m."""
        s = self.given.sensor
        law, wavelength = MODES[s.mode], self.waveform.wavelength
        cell = s.azimuth_resolution or self.waveform.range_cell
        length = law.aperture_length(self.geometry, wavelength, cell)
        if length > self.longest and not (s.n_pulses and s.azimuth_resolution == 0.0):
            raise RadarError(
                f"{self.given.where}: azimuth_resolution = {cell:g} m needs an aperture of {length:g} m, more than "
                f"four slant ranges; give at least {law.azimuth_cell(self.geometry, wavelength, self.longest):g} m"
            )
        return length

    def prf(self, aperture: float, half_aperture: float = np.inf) -> float:
        """Pulse repetition frequency that samples the Doppler bandwidth of an aperture (m), Hz."""
        speed = self.path.speed
        ends, velocity = self.path.states(np.array([-0.5, 0.0, 0.5]) * (aperture / speed))
        at_once = MODES[self.given.sensor.mode].instantaneous_doppler
        wavelength = self.waveform.wavelength
        spread, faded = (
            doppler_bandwidth(ends, velocity, box, wavelength, instantaneous=at_once)
            for box in (self.box, self.faded)
        )
        beam = beam_bandwidth(self.antenna, speed, wavelength, half_aperture)
        return max(PRF_MARGIN * min(spread, beam), min(faded, PRF_MARGIN * beam))


def automatic_track(
    given: RadarInput,
    geometry: AimGeometry,
    box: Box,
    faded: Box,
    waveform: Waveform,
    antenna: Antenna,
    path: FlightPath,
) -> tuple[Track, float]:
    """Track along a path with consistent aperture, prf and number of pulses, and half the aperture of a pixel in sines.

    Where the beam passes over the pixels one after the other, the track is as long as the aperture and the image
    together, so that every pixel has its whole aperture. The prf samples the Doppler bandwidth of the image, with a
    margin, and aliases no scatterer of the fade-out zone into the image.

    Parameters
    ----------
    given, geometry : description, and the geometry about the aim point
    box : of the image
    faded : box as long as the largest distance between a pixel and scatterers in the fade-out zone
    waveform, antenna, path : of the radar

    Raises
    ------
    RadarError
        The parameters contradict each other, or the aperture is too long.
    """
    s, where = given.sensor, given.where
    speed, n, prf = path.speed, s.n_pulses, s.prf
    whole = MODES[s.mode].path_length(geometry, MODES[s.mode].filled(s.mode_parameters))
    if whole > 0.0:
        return _whole_path(given, whole, (box, faded), waveform, antenna, path), np.inf
    if n and prf and s.azimuth_resolution > 0.0:
        raise RadarError(
            f"{where}: n_pulses = {n}, prf = {prf:g} Hz and azimuth_resolution = "
            f"{s.azimuth_resolution:g} m describe the aperture twice; set one of them to 0"
        )
    wanted = _Wanted(given, geometry, box, faded, waveform, antenna, path)
    half, longest = wanted.half_aperture(), wanted.longest
    length = wanted.track_length(half)
    if n and s.azimuth_resolution > 0.0:
        prf = n * speed / length
    elif n and not prf:
        prf = _prf_for_pulses(wanted.prf, n, speed, n * speed / longest)
    elif not prf:
        prf = max(wanted.prf(wanted.length(), half), speed / length)
    if not n:
        n = max(1, round(length * prf / speed)) + 2 * int(np.isfinite(half))
    if n > MAX_PULSES:
        raise RadarError(
            f"{where}: a track of {length:g} m at prf = {prf:g} Hz needs {n} pulses, more than "
            f"{MAX_PULSES}; coarsen azimuth_resolution, shrink the image or narrow the beam"
        )
    if n > 1 and not np.isfinite(half) and n * speed / prf > longest * (1.0 + 1e-9):
        raise RadarError(
            f"{where}: {n} pulses at prf = {prf:g} Hz and speed = {speed:g} m/s make an aperture of "
            f"{n * speed / prf:g} m, more than four slant ranges ({longest:g} m); raise prf or take fewer pulses"
        )
    return pulse_intervals(given).track(path, prf, n), half


def burst_track(
    plan: BurstPlan, box: Box, faded: Box, waveform: Waveform, antenna: Antenna, path: FlightPath
) -> tuple[Track, float]:
    """Pulses of one burst along a path, and half the aperture of a pixel in sines.

    A beam that turns gives every pixel its own aperture, of the azimuth resolution and within the beam's nulls; a beam
    at rest, that of the whole burst.

    Parameters
    ----------
    plan : of the burst
    box, faded, waveform, antenna, path : as for :func:`automatic_track`

    Raises
    ------
    RadarError
        The beam turns, and the antenna has none.
    """
    s, where = plan.given.sensor, plan.given.where
    time = pulse_intervals(plan.given).times(s.prf, s.n_pulses) + plan.burst.middle
    track = Track(time, *path.states(time))
    if not MODES[s.mode].instantaneous_doppler:
        return track, np.inf
    if not antenna.directive:
        raise RadarError(
            f"{where}: mode = {s.mode} turns a beam, and pattern = {s.pattern} has none; give one"
        )
    longest = replace(plan.given, sensor=replace(s, n_pulses=0))
    wanted = _Wanted(longest, plan.geometry, box, faded, waveform, antenna, path)
    wanted.__dict__["beam"] = BeamOverPath(MODES[s.mode], path, plan.geometry, plan.values)
    return track, wanted.half_aperture()


def spare_pulses(
    given: RadarInput,
    geometry: AimGeometry,
    boxes: tuple[Box, Box],
    waveform: Waveform,
    antenna: Antenna,
    path: FlightPath,
    n_pulses: int,
    extent: float,
) -> tuple[str, ...]:
    """Note where the track has far more pulses than a spotlight of the image's extent and resolution needs.

    A mode in which the beam passes over the pixels samples the Doppler bandwidth of the whole beam for any image;
    pulses cost time in proportion. The ``prf`` of a spotlight is that of the radar it stands for: no note.

    Parameters
    ----------
    boxes : of the image, without and with the fade-out zone
    n_pulses : of the track
    extent : of the image in azimuth, m
    (the others as for :func:`automatic_track`)
    """
    s, mode = given.sensor, MODES[given.sensor.mode]
    settings = [f"mode = {s.mode}"] + [f"prf = {s.prf:g} Hz"] * (s.prf > 0.0)
    within_beam = extent <= antenna.nulls[0] * geometry.slant_range
    if s.n_pulses or not mode.own_apertures or mode.all_round or not within_beam:
        return ()
    spotlight = replace(given, sensor=replace(s, mode="spotlight", prf=0.0))
    wanted = _Wanted(spotlight, geometry, *boxes, waveform, antenna, path)
    length = wanted.length()
    enough = max(2, round(length * max(wanted.prf(length), path.speed / length) / path.speed))
    if n_pulses < max(SPARE_FACTOR * enough, SPARE_FROM):
        return ()
    return (
        f"{given.where}: {' and '.join(settings)} gives {n_pulses} pulses, where an image of "
        f"{extent:.3g} m in azimuth needs {enough} at the same resolution; for so "
        "small an image mode = spotlight without prf is faster",
    )


def _whole_path(
    given: RadarInput,
    length: float,
    boxes: tuple[Box, Box],
    waveform: Waveform,
    antenna: Antenna,
    path: FlightPath,
) -> Track:
    """Track of a length (m) given by the mode; on a closed path the last pulse is one step before the first.

    ``boxes`` : of the image, without and with the fade-out zone.
    """
    s, where = given.sensor, given.where
    if s.n_pulses and s.prf:
        raise RadarError(
            f"{where}: n_pulses = {s.n_pulses} and prf = {s.prf:g} Hz set the length of the track, which "
            f"mode = {s.mode} sets to {length:g} m; set one of them to 0"
        )
    if s.azimuth_resolution > 0.0:
        own = ", ".join(MODES[s.mode].path_parameters)
        raise RadarError(
            f"{where}: azimuth_resolution = {s.azimuth_resolution:g} m has no effect with mode = {s.mode}, whose {own} "
            "sets the track; leave it out"
        )
    n = s.n_pulses
    if not n:
        position, velocity = path.states(np.linspace(-0.5, 0.5, 65) * (length / path.speed))
        spread, faded = (
            doppler_bandwidth(position, velocity, box, waveform.wavelength, instantaneous=True)
            for box in boxes
        )
        beam = beam_bandwidth(antenna, path.speed, waveform.wavelength)
        needed = max(PRF_MARGIN * min(spread, beam), min(faded, PRF_MARGIN * beam))
        n = max(2, int(np.ceil(length * (s.prf or needed) / path.speed)))
    if n > MAX_PULSES:
        raise RadarError(
            f"{where}: a track of {length:g} m needs {n} pulses, more than {MAX_PULSES}; shrink the image, narrow "
            "the beam or fly a shorter arc"
        )
    return pulse_intervals(given).track(path, n * path.speed / length, n)


def _prf_for_pulses(needed: Callable[[float], float], n: int, speed: float, lowest: float) -> float:
    """Lowest prf that samples the Doppler bandwidth of the aperture n speed / prf (bisection), Hz."""
    low, high = lowest, 1e6 * lowest + 1e9
    for _ in range(100):
        prf = float(np.sqrt(low * high))
        if needed(n * speed / prf) > prf:
            low = prf
        else:
            high = prf
    return high
