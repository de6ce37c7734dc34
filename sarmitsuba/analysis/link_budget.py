"""Link budget of a scene's radar, before tracing: signal and noise at a point of the image, timing, and findings.

Findings are impossible or unfavourable combinations of radar parameters, one line each.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import scipy

from sarmitsuba.analysis.pulse_timing import (
    PulseTiming,
    azimuth_ambiguity,
    earth_radius,
    pulse_timing,
    range_ambiguity,
    vantage_of,
)
from sarmitsuba.analysis.receiver_budget import ReceiverBudget, receiver_budget
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import DEFAULT_WINDOW, SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.memory import format_bytes
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.link_budget import nesz
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.focusing.aperture_weights import (
    direction_gain,
    flight,
    ground_cell_area,
    incidence_angle,
    look_directions,
    matched_weights,
    range_gradients,
)
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.summed_weights import noise_equivalent_rcs
from sarmitsuba.signal.focusing.windows import Window, parse_window

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
    nesz_received : noise-equivalent sigma0 with the noise and losses of the receive chain, and interference
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
    nesz_received: float = float("nan")
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


# least two-way power gain at the ends of an aperture relative to its middle: -20 dB
_HELD = 0.01
# tolerance of the gain over that of the beam's solid angle: rounding, and the half-power widths of a real antenna
_GAIN_SLACK = 1.26
# tolerated share of the swath's echoes overlapped by a pulse or the nadir echo: rounding
_SHARE = 1e-6
# fraction of the beam's half width within which an aperture counts as limited by the null
_CUT = 1e-6


@dataclass(frozen=True)
class Finding:
    """One remark about a radar.

    Parameters
    ----------
    name : one word
    text : place, problem, value with unit, bound, remedy
    impossible : whether the radar cannot work; else the finding is a disadvantage
    """

    name: str
    text: str
    impossible: bool


def findings(
    radar: Radar, timing: PulseTiming, places: Sequence[PlaceBudget], given: RadarInput | None
) -> tuple[Finding, ...]:
    """All remarks about a radar, the impossible first.

    Parameters
    ----------
    radar, timing : complete
    places : near, middle, far
    given : the user's radar parameters; None: the radar was built from its parts
    """
    where = given.where if given is not None else "radar"
    found = [
        *_check_pulses(where, timing, _remedy(timing)),
        *_check_antenna(where, radar, places[len(places) // 2]),
        *_check_aperture(where, radar, places[len(places) // 2], given),
    ]
    if radar.noise_temperature <= 0.0:
        found.append(
            Finding(
                "noise_temperature",
                f"{where}: noise_temperature = 0 K adds no noise, so that SNR and NESZ are undefined; give 290 K "
                "times the receiver's noise factor",
                False,
            )
        )
    return tuple(sorted(found, key=lambda finding: not finding.impossible))


def _remedy(timing: PulseTiming) -> str:
    free = timing.nearest_free_prf
    return f"take prf = {free:.5g} Hz" if free is not None else "shorten the swath or pulse_width"


def _check_pulses(where: str, t: PulseTiming, remedy: str) -> list[Finding]:
    found = []
    if t.prf < t.processed_bandwidth * (1.0 - 1e-9):
        found.append(
            Finding(
                "doppler",
                f"{where}: prf = {t.prf:.6g} Hz is below the Doppler bandwidth {t.processed_bandwidth:.6g} Hz; raise "
                "prf, coarsen azimuth_resolution or narrow the beam",
                True,
            )
        )
    elif t.prf < t.lowest_prf * (1.0 - 1e-9):
        found.append(
            Finding(
                "azimuth_ghosts",
                f"{where}: prf = {t.prf:.6g} Hz samples the Doppler bandwidth of the image, "
                f"{t.processed_bandwidth:.6g} Hz, but not that of the beam, {t.lowest_prf:.6g} Hz: echoes from outside "
                f"the image within the beam are aliased into it; with ground there, raise prf to {t.lowest_prf:.6g} Hz",
                False,
            )
        )
    if t.duty_cycle >= 1.0:
        found.append(
            Finding(
                "duty_cycle",
                f"{where}: pulse_width = {t.pulse_width:.6g} s at prf = {t.prf:.6g} Hz is a duty cycle of "
                f"{t.duty_cycle:.4g}, which must be below 1; shorten pulse_width or lower prf",
                True,
            )
        )
    elif t.prf > t.highest_prf * (1.0 + 1e-9):
        found.append(
            Finding(
                "swath",
                f"{where}: the echoes of one pulse last {1e6 * (t.echo_ends - t.echo_begins):.6g} us, and with the "
                f"next pulse of {1e6 * t.pulse_width:.6g} us do not fit into the interval of {1e6 / t.prf:.6g} us at "
                f"prf = {t.prf:.6g} Hz; lower prf to {t.highest_prf:.6g} Hz, or shorten the swath or pulse_width",
                True,
            )
        )
    elif t.blind_share > _SHARE:
        found.append(
            Finding(
                "blind_range",
                f"{where}: at prf = {t.prf:.6g} Hz a pulse is sent while {100.0 * t.blind_share:.3g} % of the swath's "
                f"echoes arrive ({1e6 * t.echo_begins:.6g} to {1e6 * t.echo_ends:.6g} us after their pulse); {remedy}",
                True,
            )
        )
    if t.nadir_share > _SHARE:
        found.append(
            Finding(
                "nadir",
                f"{where}: at prf = {t.prf:.6g} Hz the nadir echo ({1e6 * t.nadir_begins:.6g} us) overlaps "
                f"{100.0 * t.nadir_share:.3g} % of the swath's echoes; {remedy}",
                False,
            )
        )
    return found


def antenna_area(radar: Radar) -> float:
    """Area of the aperture with the antenna's half-power widths, m^2; a uniform one where the pattern names none."""
    antenna, wavelength = radar.antenna, radar.waveform.wavelength
    half = PATTERNS[antenna.pattern].half_power_sine or SINC_HALF_POWER
    length, height = (
        half * wavelength / float(np.sin(0.5 * width))
        for width in (antenna.azimuth_beamwidth, antenna.elevation_beamwidth)
    )
    return length * height


def _check_antenna(where: str, radar: Radar, place: PlaceBudget) -> list[Finding]:
    if not radar.antenna.directive:
        return []
    found = []
    area, wavelength = antenna_area(radar), radar.waveform.wavelength
    most = 4.0 * np.pi * area / wavelength**2
    if radar.antenna.gain > _GAIN_SLACK * most:
        found.append(
            Finding(
                "gain",
                f"{where}: gain_db = {db_from_power(radar.antenna.gain):.4g} dB is above {db_from_power(most):.4g} dB, "
                f"that of an aperture of {area:.4g} m^2 with this beam; lower it or narrow the beam",
                True,
            )
        )
    speed = float(np.linalg.norm(radar.track.velocity[radar.track.center_index]))
    tan = float(np.tan(place.incidence_angle))
    least = 4.0 * speed * wavelength * place.slant_range * tan / SPEED_OF_LIGHT
    if area < least:
        found.append(
            Finding(
                "antenna_area",
                f"{where}: an antenna of {area:.4g} m^2 is below {least:.4g} m^2 (4 v lambda R tan(theta) / c): its "
                "whole beam cannot be free of both azimuth and range ambiguities; enlarge it, or keep swath and "
                "Doppler bandwidth below the beam's",
                False,
            )
        )
    return found


def _check_aperture(where: str, radar: Radar, place: PlaceBudget, given: RadarInput | None) -> list[Finding]:
    asked = given.sensor.azimuth_resolution if given is not None and given.track is None else 0.0
    own = np.isfinite(radar.half_aperture)
    squint = float(flight(radar)[1][radar.track.center_index])
    null = radar.antenna.nulls[0] * float(np.sqrt(max(1.0 - squint**2, 0.0)))
    if own and asked > 0.0 and radar.half_aperture >= null * (1.0 - _CUT):
        return [
            Finding(
                "aperture",
                f"{where}: azimuth_resolution = {asked:g} m asks for a longer aperture than the beam holds between its "
                f"nulls, {place.aperture_length:.4g} m, which gives an azimuth cell of {place.azimuth_cell:.4g} m with "
                "the window; shorten antenna_length or coarsen azimuth_resolution",
                True,
            )
        ]
    if not own and place.held < _HELD:
        return [
            Finding(
                "aperture",
                f"{where}: the beam leaves the image centre within the aperture of {place.aperture_length:.4g} m: its "
                f"two-way gain at the ends is {db_from_power(max(place.held, 1e-12)):.3g} dB; use fewer pulses, a "
                "steered mode, or a wider beam",
                True,
            )
        ]
    return []


# number of listed bands of free pulse repetition frequencies
_FREE_SHOWN = 5
# bytes of a complex64 sample
_SAMPLE_BYTES = 8


@dataclass(frozen=True)
class DataVolume:
    """Volume of the raw data of a run, complex64.

    Parameters
    ----------
    pulses : of the track
    samples_per_pulse : of the echo before range compression
    channels : polarisation channels
    seconds : acquisition time
    """

    pulses: int
    samples_per_pulse: int
    channels: int
    seconds: float

    @property
    def samples(self) -> int:
        """Complex samples of all pulses and channels."""
        return self.pulses * self.samples_per_pulse * self.channels

    @property
    def bytes(self) -> int:
        """Bytes of all samples."""
        return _SAMPLE_BYTES * self.samples

    @property
    def rate(self) -> float:
        """Bytes per second during the acquisition."""
        return self.bytes / self.seconds


@dataclass(frozen=True)
class LinkBudget:
    """Link budget of a radar on a scene; its ``str`` is a readable table.

    Parameters
    ----------
    scene : its name
    mode, wavelength, speed : of the radar; m and m/s, in the frame of the scene
    gain, antenna_area : one-way, linear; m^2 (infinite: isotropic)
    losses, noise_temperature : linear; K, 0: not given
    range_window, azimuth_window : of the image
    timing : pulses, echoes and power
    places : near end, middle and far end of the swath, at the image's centre in azimuth
    data : raw data
    receiver : losses of the receive chain and interference; None without
    findings : inconsistencies and disadvantages
    """

    scene: str
    mode: str
    wavelength: float
    speed: float
    gain: float
    antenna_area: float
    losses: float
    noise_temperature: float
    range_window: str
    azimuth_window: str
    timing: PulseTiming
    places: tuple[PlaceBudget, ...]
    data: DataVolume
    receiver: ReceiverBudget | None
    findings: tuple[Finding, ...]

    @property
    def middle(self) -> PlaceBudget:
        """The place at mid-swath."""
        return self.places[len(self.places) // 2]

    @property
    def impossible(self) -> tuple[Finding, ...]:
        """Findings of an impossible radar."""
        return tuple(finding for finding in self.findings if finding.impossible)

    def as_dict(self) -> Mapping[str, object]:
        """Values for JSON; linear values and radians as in the fields, None for infinite or unknown values."""
        out: dict[str, object] = asdict(self)
        out["data"] = {**asdict(self.data), "samples": self.data.samples, "bytes": self.data.bytes}
        cleaned = _finite(out)
        assert isinstance(cleaned, dict)
        return cleaned

    def __str__(self) -> str:
        return _table(self)


@exclusive
def link_budget(
    scene: SceneLike,
    *,
    range_window: str | Window = DEFAULT_WINDOW,
    azimuth_window: str | Window = DEFAULT_WINDOW,
    rcs: float = 1.0,
    sigma0_db: float = -10.0,
) -> LinkBudget:
    """Link budget of a scene's radar for the requested image.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene; its meshes and materials have no influence
    range_window, azimuth_window : of the image; default: that of the command line
    rcs : of the point target for the signal-to-noise ratio, m^2
    sigma0_db : of the ground for the signal-to-noise ratio, dB

    Returns
    -------
    LinkBudget; inconsistencies are in its ``findings`` and raise no error

    Raises
    ------
    RadarError
        One pulse, a bistatic radar, or a full circular aperture: the budget is undefined.
    DataError
        Unknown window, or the beam does not illuminate the image.

    Notes
    -----
    For backprojection, which the other focusers match. Ignores the atmosphere and clutter.
    """
    scene = Scene.of(scene)
    radar = scene.radar
    where = scene.description.where if scene.description is not None else scene.name
    if radar.track.n_pulses < 2:
        raise RadarError(
            f"{where}: the link budget needs an aperture of at least 2 pulses; raise n_pulses = 1"
        )
    if radar.receiver is not None:
        raise RadarError(
            f"{where}: the link budget is for monostatic radars; this one has a separate receiver"
        )
    if radar.all_round:
        raise RadarError(
            f"{where}: the link budget is undefined for a circular aperture, which has no separate range and azimuth "
            "cells; choose another mode"
        )
    windows = parse_window(range_window), parse_window(azimuth_window)
    processing = Processing(*windows, rcs=rcs, sigma0=float(power_from_db(sigma0_db)))
    grid = default_grid(radar, scene.image)
    line = grid.positions_on_line(grid.azimuth.size // 2)
    ground = earth_radius(scene.description)
    middle = line[grid.range.size // 2]
    timing = pulse_timing(radar, grid, vantage_of(radar, middle, ground).height)
    ghosts = azimuth_ambiguity(radar, timing.prf, timing.processed_bandwidth)
    places = tuple(
        replace(
            place_budget(radar, name, point, processing),
            azimuth_ambiguity=ghosts,
            range_ambiguity=range_ambiguity(radar, timing.prf, point, ground),
        )
        for name, point in (("near", line[0]), ("middle", middle), ("far", line[-1]))
    )
    receiver = None
    if radar.received:
        center = places[len(places) // 2]
        receiver = receiver_budget(radar, grid, processing.sigma0, center.aperture_time)
        raised = receiver.raise_noise(radar.noise_temperature)
        places = tuple(replace(place, nesz_received=place.nesz * raised) for place in places)
    return LinkBudget(
        scene=scene.name,
        mode=radar.mode,
        wavelength=radar.waveform.wavelength,
        speed=float(np.linalg.norm(radar.track.velocity[radar.track.center_index])),
        gain=radar.antenna.gain,
        antenna_area=math.inf if not radar.antenna.directive else antenna_area(radar),
        losses=radar.losses,
        noise_temperature=radar.noise_temperature,
        range_window=str(windows[0]),
        azimuth_window=str(windows[1]),
        timing=timing,
        places=places,
        data=_data(radar),
        receiver=receiver,
        findings=findings(radar, timing, places, scene.description),
    )


def _data(radar: Radar) -> DataVolume:
    time = radar.track.time
    chirp = math.ceil(radar.waveform.pulse_width * radar.window.sampling_rate)
    return DataVolume(
        pulses=radar.track.n_pulses,
        samples_per_pulse=radar.window.n_samples + chirp,
        channels=len(radar.channels),
        seconds=float(time[-1] - time[0]) * time.size / (time.size - 1),
    )


def _finite(value: object) -> object:
    """Value with None in place of NaN and infinity."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _table(budget: LinkBudget) -> str:
    t, middle = budget.timing, budget.middle
    radar = [
        ("mode", f"{budget.mode}, {middle.n_pulses} pulses in an aperture"),
        ("wavelength, speed", f"{budget.wavelength:.5g} m, {budget.speed:.5g} m/s"),
        (
            "peak, average power",
            f"{t.peak_power:.4g} W, {t.average_power:.4g} W (duty cycle {100 * t.duty_cycle:.3g} %)",
        ),
        (
            "gain, losses",
            f"{db_from_power(budget.gain):.2f} dB one way, {db_from_power(budget.losses):.2f} dB two-way",
        ),
        ("antenna", "isotropic" if np.isinf(budget.antenna_area) else f"{budget.antenna_area:.4g} m^2"),
        (
            "noise temperature",
            f"{budget.noise_temperature:.4g} K" if budget.noise_temperature else "not given",
        ),
        ("windows", f"range {budget.range_window}, azimuth {budget.azimuth_window}"),
    ]
    pulses = [
        ("prf", f"{t.prf:.6g} Hz, interval {1e6 / t.prf:.5g} us"),
        ("PRF bounds", f"{t.lowest_prf:.5g} Hz (Doppler) to {t.highest_prf:.5g} Hz (swath)"),
        (
            "Doppler bandwidth",
            f"processed {t.processed_bandwidth:.5g} Hz, beam {_or(t.beam_bandwidth, '.5g')} Hz",
        ),
        (
            "echoes arrive",
            f"{1e6 * t.echo_begins:.6g} to {1e6 * t.echo_ends:.6g} us, {t.pulses_in_flight} pulses in flight",
        ),
        ("nadir's echo", f"{1e6 * t.nadir_begins:.6g} us"),
        ("free prf", _bands(t.free_prf, t.prf)),
        (
            "raw data",
            f"{budget.data.samples:.4g} samples, {format_bytes(budget.data.bytes)}, {format_bytes(budget.data.rate)}/s "
            f"for {budget.data.seconds:.3g} s",
        ),
    ]
    if budget.receiver is not None:
        pulses += _receiver_lines(budget.receiver)
    rows = _ROWS if budget.receiver is not None else tuple(row for row in _ROWS if row[0] != _RECEIVED)
    width = max(len(name) for name, _ in (*radar, *pulses, *((label, "") for label, _ in rows)))
    lines = [f"{budget.scene}:", *(f"  {name:<{width}}  {value}" for name, value in (*radar, *pulses))]
    columns = [[place.name, *(value(place) for _, value in rows)] for place in budget.places]
    sizes = [max(len(cell) for cell in column) for column in columns]
    for i, label in enumerate(("swath", *(label for label, _ in rows))):
        cells = "  ".join(f"{column[i]:>{size}}" for column, size in zip(columns, sizes, strict=True))
        lines.append(f"  {label:<{width}}  {cells}")
    lines += [
        f"  {'impossible' if finding.impossible else 'caution'}: {finding.text}"
        for finding in budget.findings
    ]
    return "\n".join(lines)


def _receiver_lines(receiver: ReceiverBudget) -> list[tuple[str, str]]:
    """Lines of the table about the receive chain."""
    coding = f", coded with {receiver.bits} bits" if receiver.bits else ""
    return [
        (
            "receiver",
            f"signal to quantisation noise {_db(receiver.quantisation_ratio)} dB{coding}, level "
            f"{_db(receiver.gain)} dB",
        ),
        (
            "pulses' errors",
            f"SNR {_db(1.0 / receiver.pulse_loss)} dB, filter {_db(1.0 / receiver.filter_loss)} dB, side lobes added "
            f"{_db(receiver.added_islr)} dB, phase noise "
            f"{receiver.phase_noise:.3g} rad",
        ),
        (
            "as temperature",
            f"ground's echoes {receiver.echo_temperature:.4g} K, receive chain {receiver.added_temperature:.4g} K, "
            f"interference {receiver.interference_temperature:.4g} K",
        ),
    ]


def _or(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _db(value: float) -> str:
    return _or(float(db_from_power(value)), ".2f") if value > 0.0 else "-"


def _bands(bands: tuple[tuple[float, float], ...], prf: float) -> str:
    """Text of the free bands closest to the pulse repetition frequency."""
    if not bands:
        return "none"
    near = sorted(bands, key=lambda band: max(band[0] - prf, prf - band[1]))[:_FREE_SHOWN]
    shown = ", ".join(f"{low:.5g} to {high:.5g}" for low, high in sorted(near))
    return f"{shown} Hz{f' ({len(bands)} bands in all)' if len(bands) > len(near) else ''}"


_RECEIVED = "NESZ, received (dB)"
_ROWS: tuple[tuple[str, Callable[[PlaceBudget], str]], ...] = (
    ("slant range (m)", lambda p: f"{p.slant_range:.7g}"),
    ("incidence (deg)", lambda p: f"{np.degrees(p.incidence_angle):.3f}"),
    ("two-way pattern (dB)", lambda p: _db(p.pattern)),
    ("aperture (m)", lambda p: f"{p.aperture_length:.5g}"),
    ("aperture (s)", lambda p: f"{p.aperture_time:.4g}"),
    ("range resolution (m)", lambda p: f"{p.range_resolution:.4g}"),
    ("on the ground (m)", lambda p: f"{p.ground_range_resolution:.4g}"),
    ("azimuth resolution (m)", lambda p: f"{p.azimuth_resolution:.4g}"),
    ("SNR of the point (dB)", lambda p: _db(p.snr)),
    ("SNR of the ground (dB)", lambda p: _db(p.snr_ground)),
    ("NESZ (dB)", lambda p: _db(p.nesz)),
    (_RECEIVED, lambda p: _db(p.nesz_received)),
    ("NESZ, textbook (dB)", lambda p: _db(p.nesz_textbook)),
    ("azimuth ambiguity (dB)", lambda p: _db(p.azimuth_ambiguity)),
    ("range ambiguity (dB)", lambda p: _db(p.range_ambiguity)),
)
