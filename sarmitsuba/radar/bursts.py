r"""Bursts: what lies between a pulse and a run in the modes ``scansar`` and ``tops``.

The data that flows: a scene on the Earth -> the bursts of one sub-swath that light its image (:func:`bursts_in_sight`)
-> for each burst a whole radar with its own pulses, PRF, band, receive window and steering law (:func:`plan_burst` in
:func:`sarmitsuba.radar.builder.build_radar`) -> one run of the executor each -> images on one grid -> their mosaic.

The radar goes through its sub-swaths in turn, one burst each, and begins again after the cycle :math:`T_c`. Time zero
is when the aim point is abeam, at zero Doppler. The middle of burst n is at

.. math:: t_n = n T_c - t_o,

with the ``burst_offset`` :math:`t_o`: 0 puts the aim point in the middle of burst 0, :math:`T_c / 2` on the seam of
two. A place belongs to the burst whose middle is nearest to its own time of zero Doppler.

In a burst the beam's Doppler centroid runs at the rate :math:`k_s`, while a point's Doppler frequency falls at
:math:`k_a < 0`. In the focused image the centroid runs at

.. math:: k_t = \frac{k_a k_s}{k_a - k_s}.

References
----------
F. De Zan and A. Monti Guarnieri, "TOPSAR: Terrain Observation by Progressive Scans", IEEE Trans. Geosci. Remote Sens.
44 (9), 2006. N. Miranda, "Definition of the TOPS SLC deramping function", ESA COPE-GSEG-EOPG-TN-14-0025, 2014.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import Param, Value, did_you_mean, one_line
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.doppler import beam_doppler, doppler_history
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.mode import MODES, AimGeometry, FlightPath, RadarMode, TrackAxes, right_of
from sarmitsuba.radar.radar import Burst, Radar
from sarmitsuba.radar.track import Track, zero_doppler_delay

# numbers of a row of ``sub_swaths``, and the parameter of the sensor that each replaces
_OF_SENSOR = {
    "prf": "prf",
    "pulses": "n_pulses",
    "bandwidth": "bandwidth",
    "pulse_width": "pulse_width",
    "azimuth_resolution": "azimuth_resolution",
    "elevation_beamwidth_deg": "elevation_beamwidth_deg",
    "gain_db": "gain_db",
}
_LOOKS = ("near_deg", "far_deg")
_EXAMPLE = '"IW1: prf=1717, pulses=1400, near_deg=27.5, far_deg=32.5; IW2: ..."'

PARAMETERS = (
    Param(
        "sub_swaths",
        "string",
        "",
        "bursts in their order, as IW1: prf=1717, pulses=1400; IW2: ...; also bandwidth, pulse_width, "
        "azimuth_resolution, elevation_beamwidth_deg, gain_db, steering_rate_deg, near_deg, far_deg (off nadir)",
    ),
    Param("sub_swath", "string", "auto", "of the image; auto: that of the aim point"),
    Param(
        "burst",
        "string",
        "auto",
        "number of the only one, 0 about the aim point; auto: all in sight",
    ),
    Param(
        "burst_offset",
        "float",
        0.0,
        "from the middle of burst 0 to zero Doppler of the aim point",
        "s",
        -1e4,
        1e4,
    ),
    Param(
        "burst_cycle",
        "float",
        0.0,
        "from a burst to the next of its sub-swath; automatic: one of each",
        "s",
        0.0,
        1e4,
    ),
)
"""Parameters of all modes with bursts."""
STEERING = "steering_rate_deg"
"""Parameter of the modes that turn the beam, deg/s."""
BEAM = "beam_angle"
"""Value of a mode: direction of the beam's middle about the flight, rad, from horizontally right towards up."""


@dataclass(frozen=True)
class SubSwath:
    """Sub-swath and its bursts; NaN: not given.

    Parameters
    ----------
    name : such as ``IW1``
    prf : Hz
    pulses : of a burst
    bandwidth, pulse_width, azimuth_resolution : Hz, s, m
    elevation_beamwidth_deg, gain_db : of its beam; without a width, that of the antenna
    near_deg, far_deg : angles off nadir at its edges
    steering_rate_deg : turn of the beam, deg/s, positive forward
    """

    name: str
    prf: float = np.nan
    pulses: float = np.nan
    bandwidth: float = np.nan
    pulse_width: float = np.nan
    azimuth_resolution: float = np.nan
    elevation_beamwidth_deg: float = np.nan
    gain_db: float = np.nan
    near_deg: float = np.nan
    far_deg: float = np.nan
    steering_rate_deg: float = np.nan

    @property
    def duration(self) -> float:
        """Length of a burst, s."""
        return self.pulses / self.prf

    @property
    def placed(self) -> bool:
        """Whether its edges are given."""
        return self.near_deg < self.far_deg

    @property
    def middle_deg(self) -> float:
        """Angle off nadir of its middle."""
        return 0.5 * (self.near_deg + self.far_deg)


@dataclass(frozen=True)
class Timeline:
    """Sub-swaths and times of their bursts.

    Parameters
    ----------
    sub_swaths : in the order of their bursts
    cycle : s, from a burst to the next of the same sub-swath
    offset : s, from the middle of burst 0 to zero Doppler of the aim point
    """

    sub_swaths: tuple[SubSwath, ...]
    cycle: float
    offset: float

    @property
    def nearest(self) -> int:
        """Number of the burst whose middle is nearest to zero Doppler of the aim point."""
        return round(self.offset / self.cycle)

    def middle(self, number: int) -> float:
        """Time of the middle of a burst, s."""
        return number * self.cycle - self.offset


def read_timeline(given: RadarInput) -> Timeline:
    """Sub-swaths and bursts of a description.

    Raises
    ------
    RadarError
        ``sub_swaths`` is no list of sub-swaths, lacks numbers, contradicts the sensor, or its bursts overlap in time.
    """
    s, where = given.sensor, given.where
    law = MODES[s.mode]
    values = law.filled(s.mode_parameters)
    rows = [row for row in str(values["sub_swaths"]).split(";") if row.strip()]
    swaths = [_read_row(row, where) for row in rows] or [SubSwath("swath")]
    if len({swath.name for swath in swaths}) < len(swaths):
        raise RadarError(f"{where}: sub_swaths names one sub-swath twice; give each a name of its own")
    for key, name in {**_OF_SENSOR, STEERING: STEERING}.items():
        own = values.get(STEERING, 0.0) if key == STEERING else getattr(s, name)
        in_rows = [np.isfinite(getattr(swath, key)) for swath in swaths]
        if all(in_rows) and name in given.sensor_given:
            raise RadarError(
                f"{where}: {name} has no effect beside {key} of sub_swaths; leave one of them out"
            )
        swaths = [
            swath if known else replace(swath, **{key: float(own)})  # type: ignore[arg-type]
            for swath, known in zip(swaths, in_rows, strict=True)
        ]
    for swath in swaths:
        _check_swath(swath, given, steered=STEERING in values)
    cycle, needed = float(values["burst_cycle"]), sum(swath.duration for swath in swaths)
    if 0.0 < cycle < needed * (1.0 - 1e-9):
        raise RadarError(
            f"{where}: burst_cycle = {cycle:g} s is shorter than its bursts together, {needed:.6g} s, so that they "
            f"overlap in time; give at least {needed:.6g} s, or 0"
        )
    return Timeline(tuple(swaths), cycle or needed, float(values["burst_offset"]))


def _read_row(row: str, where: str) -> SubSwath:
    name, colon, rest = row.partition(":")
    known = [field.name for field in fields(SubSwath)][1:]
    numbers: dict[str, float] = {}
    for pair in (part for part in rest.split(",") if part.strip()):
        key, _, text = (part.strip() for part in pair.partition("="))
        if key not in known:
            raise RadarError(
                f"{where}: sub_swaths: {one_line(key)!r} is no number of a sub-swath{did_you_mean(key, known)}; "
                f"it has {', '.join(known)}"
            )
        try:
            numbers[key] = float(text)
        except ValueError:
            numbers[key] = np.nan
        if not np.isfinite(numbers[key]):
            raise RadarError(f"{where}: sub_swaths: {key} = {one_line(text)!r} is no number; give {_EXAMPLE}")
    if not colon or not name.strip():
        raise RadarError(
            f"{where}: sub_swaths: {one_line(row.strip())!r} is no sub-swath; give for example {_EXAMPLE}"
        )
    return SubSwath(name.strip(), **numbers)


def _check_swath(swath: SubSwath, given: RadarInput, *, steered: bool) -> None:
    start = f"{given.where}: mode = {given.sensor.mode}: sub-swath {swath.name}"
    for key in ("prf", "pulses"):
        if not getattr(swath, key) > 0.0:
            raise RadarError(
                f"{start} has no {key} of a burst; give {_OF_SENSOR[key]}, or {key} in sub_swaths"
            )
    if swath.pulses < 2 or swath.pulses != round(swath.pulses) or swath.pulses > 1e7:
        raise RadarError(f"{start}: pulses = {swath.pulses:g} is no whole number from 2 to 1e7")
    for key in ("bandwidth", "pulse_width", "elevation_beamwidth_deg", "azimuth_resolution"):
        if getattr(swath, key) < 0.0:
            raise RadarError(f"{start}: {key} = {getattr(swath, key):g} is below 0")
    if np.isfinite(swath.near_deg) != np.isfinite(swath.far_deg) or swath.near_deg >= swath.far_deg:
        raise RadarError(
            f"{start}: near_deg = {swath.near_deg:g} is not below far_deg = {swath.far_deg:g}; give both"
        )
    if steered and not 0.0 < swath.steering_rate_deg < 1e3:
        raise RadarError(
            f"{start} has no {STEERING} above 0 and below 1000 deg/s, by which its beam turns forward; mode = scansar "
            "has a beam at rest, sliding_spotlight one that turns back"
        )
    limit = float(given.sensor.mode_parameters.get("steering_limit_deg", 0.0))
    turned = 0.5 * swath.steering_rate_deg * swath.duration if steered else 0.0
    if turned > (limit or 60.0):
        raise RadarError(
            f"{start}: the beam turns by {turned:.4g} deg to either side, beyond the {limit or 60.0:g} deg up to which "
            "the antenna has no grating lobe; shorten its bursts or turn slower"
        )


@dataclass(frozen=True, eq=False)
class BurstPlan:
    """One burst: the description that makes its radar, and its pulses.

    Parameters
    ----------
    given : description with the numbers of the sub-swath
    geometry : about the aim point, from the middle of the burst
    values : of the mode, with the steering law
    burst : its place among the others
    """

    given: RadarInput
    geometry: AimGeometry
    values: Mapping[str, Value]
    burst: Burst

    @property
    def note(self) -> str:
        """The burst in one line."""
        s, one = self.given.sensor, self.burst
        return (
            f"{self.given.where}: {one.sub_swath}, burst {one.number}: {s.n_pulses} pulses at {s.prf:.6g} Hz"
        )


def plan_burst(
    given: RadarInput, geometry: AimGeometry, path: FlightPath, anchor: Anchor, offset: F64
) -> BurstPlan:
    """The burst that a description asks for: the given number, or the one nearest to the aim point.

    Parameters
    ----------
    given : description of a mode with bursts
    geometry, path : about the aim point, time zero at zero Doppler
    anchor, offset : place on the Earth and (3,) m of the scene frame; the Earth's centre gives the nadir in orbit

    Raises
    ------
    RadarError
        As :func:`read_timeline`; no such sub-swath or burst, or the aim point lies in none.
    """
    s = given.sensor
    line, values = read_timeline(given), MODES[s.mode].filled(s.mode_parameters)
    nadir = np.array([0.0, 0.0, -1.0])
    if s.orbit_altitude > 0.0 or s.state_vectors_file:
        center = anchor.from_ecef(np.zeros(3)) - offset - geometry.center
        nadir = center / np.linalg.norm(center)
    look = float(np.degrees(np.arccos(np.clip(geometry.line_of_sight @ nadir, -1.0, 1.0))))
    swath = _choose_swath(line, str(values["sub_swath"]), look, given.where)
    number = line.nearest if values["burst"] == "auto" else _read_number(str(values["burst"]), given.where)
    middle = line.middle(number)
    position, velocity = path.states(np.array([0.0, middle]))
    axes = TrackAxes.of(Track(np.array([0.0, 1.0]), position, velocity), geometry.along)
    side, up = (float(geometry.line_of_sight @ axis[0]) for axis in (axes.right, axes.over))
    outwards = np.radians(swath.middle_deg - look) if swath.placed else 0.0
    beam = float(np.arctan2(up, side) + np.sign(side) * outwards)
    level = velocity[1] * np.array([1.0, 1.0, 0.0])
    along = level / np.linalg.norm(level)
    across = right_of(along) * np.sign(float(geometry.across @ right_of(geometry.along)))
    own = {name: getattr(swath, key) for key, name in _OF_SENSOR.items()}
    own["n_pulses"] = int(own["n_pulses"])
    if (
        swath.elevation_beamwidth_deg > 0.0
    ):  # a beam broadened for the sub-swath, not that of the whole aperture
        own["antenna_height"] = 0.0
    return BurstPlan(
        replace(given, sensor=replace(s, **own)),
        AimGeometry(geometry.aim, position[1], along, across),
        {**values, BEAM: beam, **({STEERING: swath.steering_rate_deg} if STEERING in values else {})},
        Burst(
            sub_swath=swath.name,
            sub_swaths=tuple(one.name for one in line.sub_swaths),
            number=number,
            middle=middle,
            cycle=line.cycle,
            steering_rate=float(np.radians(swath.steering_rate_deg)) if STEERING in values else 0.0,
        ),
    )


def _choose_swath(line: Timeline, name: str, look: float, where: str) -> SubSwath:
    names = [swath.name for swath in line.sub_swaths]
    if name != "auto":
        if name not in names:
            raise RadarError(
                f"{where}: there is no sub_swath {one_line(name)!r}{did_you_mean(name, names)}; there are "
                f"{', '.join(names)}"
            )
        return line.sub_swaths[names.index(name)]
    if not all(swath.placed for swath in line.sub_swaths):
        if len(names) > 1:
            raise RadarError(
                f"{where}: sub_swaths: give near_deg and far_deg of each, or the name of a sub_swath"
            )
        return line.sub_swaths[0]
    seen = [swath for swath in line.sub_swaths if swath.near_deg <= look <= swath.far_deg]
    if not seen:
        spans = ", ".join(f"{one.name} {one.near_deg:g} to {one.far_deg:g}" for one in line.sub_swaths)
        raise RadarError(
            f"{where}: the aim point is seen {look:.4g} deg off nadir, in no sub-swath ({spans} deg); change the "
            "incidence or look angle, or name a sub_swath"
        )
    return min(seen, key=lambda swath: abs(swath.middle_deg - look))


def _read_number(text: str, where: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise RadarError(
            f"{where}: burst = {one_line(text)!r} is no number of a burst, and not auto"
        ) from None


class BurstMode(RadarMode):
    """Mode whose pulses come in bursts: the beam is steady in elevation, and may turn forward in azimuth.

    ``STEERING`` among the mode's parameters is the rate at which it turns.
    """

    own_apertures = True
    squints = False
    bursts = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        r"""Beam turned forward at a steady rate about the middle of a burst, (n_pulses, 3) unit vectors.

        .. math:: b = \sin(\dot\psi t) \, a + \cos(\dot\psi t) \, e

        with the direction of flight a and the beam's middle e square to it, which ``geometry`` gives where ``values``
        have no ``beam_angle``.
        """
        rate = float(np.radians(float(values.get(STEERING, 0.0))))
        middle = 0.5 * (track.time[0] + track.time[-1])
        if BEAM in values:
            angle = float(values[BEAM])
        else:
            i = track.center_index
            sine, cosine = (float(geometry.line_of_sight @ axis[i]) for axis in (axes.over, axes.right))
            angle = float(np.arctan2(sine, cosine))
        turn = (rate * (track.time - middle))[:, None]
        side = np.cos(angle) * axes.right + np.sin(angle) * axes.over
        return unit_rows(np.sin(turn) * axes.forward + np.cos(turn) * side)


def bursts_in_sight(given: RadarInput | None, radar: Radar, image: ImageRequest) -> tuple[int, ...]:
    """Numbers of the bursts that image a scene, in the order of time; empty where that is the radar's own, or fixed.

    Parameters
    ----------
    given : description of the radar
    radar : of the burst nearest to the aim point
    image : to be made
    """
    burst = radar.burst
    if burst is None or given is None or given.sensor.mode_parameters.get("burst", "auto") != "auto":
        return ()
    here = image.in_frame(radar.offset)
    ends = np.array([-0.5, 0.0, 0.5])
    x, y = (part.ravel() for part in np.meshgrid(ends * here.extent_azimuth, ends * here.extent_range))
    middle = np.array([here.center_x, here.center_y, here.height])
    points = middle + x[:, None] * radar.track.along + y[:, None] * radar.across
    away = np.rint(zero_doppler_delay(radar.track, points) / burst.cycle).astype(int)
    numbers = tuple(range(burst.number + int(away.min()), burst.number + int(away.max()) + 1))
    return () if numbers == (burst.number,) else numbers


@dataclass(frozen=True)
class AzimuthRates:
    """Rates of Doppler frequencies of a burst, Hz/s.

    Parameters
    ----------
    point : k_a, of a point at rest; negative
    beam : k_s, of the beam's centroid over the burst; 0 for a beam at rest
    """

    point: float
    beam: float

    @property
    def image(self) -> float:
        """k_t, of the centroid in the focused image."""
        return self.point * self.beam / (self.point - self.beam)

    @property
    def stretch(self) -> float:
        """Zero-Doppler time that the beam passes over, per time of the burst: 1 - k_s / k_a."""
        return 1.0 - self.beam / self.point


def azimuth_rates(radar: Radar, point: ArrayLike) -> AzimuthRates:
    """Rates in the middle of a burst for a point (3,), m, scene frame."""
    i, track = radar.track.center_index, radar.track
    near = slice(max(i - 1, 0), i + 2)
    beam = np.gradient(beam_doppler(radar)[near], track.time[near])
    history = doppler_history(track, point, radar.waveform.wavelength)
    return AzimuthRates(float(history.rate[i]), float(beam[len(beam) // 2]))
