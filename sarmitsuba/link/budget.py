"""The link budget of a scene: what its radar will see, worked out before anything is traced."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from sarmitsuba.errors import RadarError
from sarmitsuba.focusing.grid import default_grid
from sarmitsuba.focusing.windows import Window, parse_window
from sarmitsuba.link.findings import Finding, antenna_area, findings
from sarmitsuba.link.place import PlaceBudget, Processing, place_budget
from sarmitsuba.link.pulses import PulseTiming, pulse_timing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.units import power_from_db

# bytes of a complex64 sample
_SAMPLE_BYTES = 8


@dataclass(frozen=True)
class DataVolume:
    """Raw data of a run as the program keeps them, complex64.

    Parameters
    ----------
    pulses : of the track
    samples_per_pulse : of the echo before range compression
    channels : polarisation channels
    seconds : that the data take to gather
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
        """Bytes of all of them."""
        return _SAMPLE_BYTES * self.samples

    @property
    def rate(self) -> float:
        """Bytes a second while data are gathered."""
        return self.bytes / self.seconds


@dataclass(frozen=True)
class LinkBudget:
    """What a radar can do on a scene; ``str`` of it is a readable table.

    Parameters
    ----------
    scene : its name
    mode, wavelength, speed : of the radar; m and m/s, in the frame of the scene
    gain, antenna_area : one-way, linear; m^2 (infinite: isotropic)
    losses, noise_temperature : linear; K, 0 where none is given
    range_window, azimuth_window : that the image is to be focused with
    timing : pulses, echoes and power
    places : near, middle and far end of the swath, on the middle of the image in azimuth
    data : raw data
    findings : what cannot be, or has a price
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
        """What cannot be."""
        return tuple(finding for finding in self.findings if finding.impossible)

    def as_dict(self) -> Mapping[str, object]:
        """JSON-able form; linear values and radians as in the fields, None for what is infinite or not known."""
        out: dict[str, object] = asdict(self)
        out["data"] = {**asdict(self.data), "samples": self.data.samples, "bytes": self.data.bytes}
        cleaned = _finite(out)
        assert isinstance(cleaned, dict)
        return cleaned

    def __str__(self) -> str:
        from sarmitsuba.link.text import table

        return table(self)


def link_budget(
    scene: Scene,
    *,
    range_window: str | Window = "taylor",
    azimuth_window: str | Window = "taylor",
    rcs: float = 1.0,
    sigma0_db: float = -10.0,
) -> LinkBudget:
    """Link budget of a scene's radar, on the image that it asks for.

    Parameters
    ----------
    scene : as loaded; its meshes and materials do not count
    range_window, azimuth_window : that the image will be focused with; the command line's default
    rcs : of the point whose signal-to-noise ratio is told, m^2
    sigma0_db : of the ground whose signal-to-noise ratio is told, dB

    Returns
    -------
    LinkBudget ; what cannot be is in its ``findings``, not an error

    Raises
    ------
    RadarError
        One pulse, or a receiver apart from the transmitter: there is no budget then.
    DataError
        No such window, or the beam does not reach the image.

    Notes
    -----
    Stated for backprojection, which the other focusers equal. Ignores the atmosphere, quantisation and clutter.
    """
    radar = scene.radar
    where = scene.description.where if scene.description is not None else scene.name
    if radar.track.n_pulses < 2:
        raise RadarError(
            f"{where}: one pulse makes no aperture, and so no link budget; give n_pulses of 2 or more"
        )
    if radar.receiver is not None:
        raise RadarError(
            f"{where}: the link budget is that of one antenna, and the receiver stands apart from the transmitter"
        )
    windows = parse_window(range_window), parse_window(azimuth_window)
    processing = Processing(*windows, rcs=rcs, sigma0=float(power_from_db(sigma0_db)))
    grid = default_grid(radar, scene.image)
    line = grid.positions_on_line(grid.azimuth.size // 2)
    places = tuple(
        place_budget(radar, name, line[column], processing)
        for name, column in (("near", 0), ("middle", grid.range.size // 2), ("far", grid.range.size - 1))
    )
    timing = pulse_timing(radar, grid)
    return LinkBudget(
        scene=scene.name,
        mode=radar.mode,
        wavelength=radar.waveform.wavelength,
        speed=float(np.linalg.norm(radar.track.velocity[radar.track.center_index])),
        gain=radar.antenna.gain,
        antenna_area=math.inf if radar.antenna.pattern == "isotropic" else antenna_area(radar),
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
    """The same with None in place of numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


__all__ = ["DataVolume", "LinkBudget", "link_budget"]
