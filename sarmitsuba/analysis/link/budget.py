"""Link budget of a scene's radar, computed before tracing."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from sarmitsuba.analysis.link.findings import Finding, antenna_area, findings
from sarmitsuba.analysis.link.ghosts import azimuth_ambiguity, earth_radius, range_ambiguity, vantage_of
from sarmitsuba.analysis.link.place import PlaceBudget, Processing, place_budget
from sarmitsuba.analysis.link.prf_bounds import PulseTiming, pulse_timing
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.memory import in_bytes
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.windows import Window, parse_window

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
    For backprojection, which the other focusers match. Ignores the atmosphere, quantisation and clutter.
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
            f"{budget.data.samples:.4g} samples, {in_bytes(budget.data.bytes)}, {in_bytes(budget.data.rate)}/s for "
            f"{budget.data.seconds:.3g} s",
        ),
    ]
    width = max(len(name) for name, _ in (*radar, *pulses, *((label, "") for label, _ in _ROWS)))
    lines = [f"{budget.scene}:", *(f"  {name:<{width}}  {value}" for name, value in (*radar, *pulses))]
    columns = [[place.name, *(value(place) for _, value in _ROWS)] for place in budget.places]
    sizes = [max(len(cell) for cell in column) for column in columns]
    for i, label in enumerate(("swath", *(label for label, _ in _ROWS))):
        cells = "  ".join(f"{column[i]:>{size}}" for column, size in zip(columns, sizes, strict=True))
        lines.append(f"  {label:<{width}}  {cells}")
    lines += [
        f"  {'impossible' if finding.impossible else 'caution'}: {finding.text}"
        for finding in budget.findings
    ]
    return "\n".join(lines)


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
    ("NESZ, textbook (dB)", lambda p: _db(p.nesz_textbook)),
    ("azimuth ambiguity (dB)", lambda p: _db(p.azimuth_ambiguity)),
    ("range ambiguity (dB)", lambda p: _db(p.range_ambiguity)),
)
