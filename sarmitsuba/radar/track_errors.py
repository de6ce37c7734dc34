"""Errors of track and pointing, unknown to the focuser, and coloured random series for them.

The focuser uses the recorded track: read from a file, or the flown track with an error model. Pointing errors turn the
true beam against the nominal one. A series has a given rms and power spectrum.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.mode import right_of
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import DEFAULT_EPOCH, utc_after


def wandering(time: F64, axes: int, rms: float, corner: float, slope: float, seed: int) -> F64:
    r"""Independent random series of mean zero with the power spectrum :math:`1 / (1 + (f / f_c)^q)`.

    Parameters
    ----------
    time : (n,) s
    axes : number of series
    rms : of each over its n samples
    corner, slope : f_c, Hz, and q; 2 is a Gauss-Markov process
    seed : of the series

    Returns
    -------
    (n, axes) in the unit of ``rms``
    """
    rng = np.random.default_rng(seed)
    n = 2 * time.size  # twice the track length, so that its ends are not correlated
    step = (time[-1] - time[0]) / max(time.size - 1, 1)
    frequency = np.fft.rfftfreq(n, step)
    level = np.sqrt(1.0 / (1.0 + (frequency / corner) ** slope))
    noise = rng.standard_normal((axes, 2, frequency.size)) * level
    series = np.fft.irfft(noise[:, 0] + 1j * noise[:, 1], n, axis=-1)[:, : time.size].T
    series = series - series.mean(axis=0)
    return np.asarray(rms * series / np.maximum(np.sqrt(np.mean(series**2, axis=0)), 1e-300))


_ERRORS = ("track_offset", "track_drift", "track_jitter")
_TRACK_JITTER_PARTS = ("track_jitter_corner", "track_jitter_slope", "track_jitter_seed")


@dataclass(frozen=True)
class TrackError:
    r"""Navigation error: recorded minus flown position, along the track, across it to the right, and up.

    .. math:: d(t) = o + v (t - t_0) + j(t), \quad S_j(f) \propto \frac{1}{1 + (f / f_c)^q}

    Parameters
    ----------
    offset : m, along each axis
    drift : m/s, along each axis, from the middle of the track
    jitter : m rms over the track, along each axis
    corner : Hz, f_c of the jitter's power spectrum
    slope : q; 2 is a Gauss-Markov process
    seed : of the jitter

    Notes
    -----
    Ignores errors of time; those of attitude are :class:`sarmitsuba.radar.track_errors.PointingError`.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    jitter: float = 0.0
    corner: float = 0.1
    slope: float = 4.0
    seed: int = 0

    def recorded(self, track: Track) -> Track:
        """Recorded track."""
        time = track.time - 0.5 * (track.time[0] + track.time[-1])
        error = np.asarray(self.offset) + time[:, None] * np.asarray(self.drift)
        if self.jitter > 0.0:
            error = error + wandering(track.time, 3, self.jitter, self.corner, self.slope, self.seed)
        axes = np.array([track.along, right_of(track.along), [0.0, 0.0, 1.0]])
        return Track.from_samples(track.time, track.position + error @ axes, track.epoch)


def recorded_track(given: RadarInput, flown: Track, offset: F64) -> Track | None:
    """Recorded track of a description in the scene frame; None where it equals the one flown.

    Parameters
    ----------
    given : the description
    flown : the true track, scene frame
    offset : (3,) float64, m; scene frame = file frame - offset

    Raises
    ------
    RadarError
        The file cannot be read or does not match the flown track's pulses, or parameters contradict each other.
    """
    s = given.sensor
    errors = {name for name in given.sensor_given if name.startswith(_ERRORS)}
    if s.recorded_track_file:
        if errors:
            raise RadarError(
                f"{given.where}: {sorted(errors)[0]} has no effect beside recorded_track_file; leave one of them out"
            )
        path = Path(s.recorded_track_file)
        track = Track.from_csv(path if path.is_absolute() else given.folder / path)
        track = replace(track, position=track.position - offset)
        return check_same_pulses(s.recorded_track_file, track, flown, "recorded")
    if errors & set(_TRACK_JITTER_PARTS) and s.track_jitter == 0.0:
        raise RadarError(
            f"{given.where}: {sorted(errors & set(_TRACK_JITTER_PARTS))[0]} has no effect without track_jitter; set "
            "track_jitter above 0 or leave it out"
        )
    model = TrackError(
        (s.track_offset_along, s.track_offset_across, s.track_offset_up),
        (s.track_drift_along, s.track_drift_across, s.track_drift_up),
        s.track_jitter,
        s.track_jitter_corner,
        s.track_jitter_slope,
        s.track_jitter_seed,
    )
    if not (any(model.offset) or any(model.drift) or model.jitter):
        return None
    if flown.n_pulses < 2:
        raise RadarError(
            f"{given.where}: a track of 1 pulse has no error model; leave {sorted(errors)[0]} out"
        )
    return model.recorded(flown)


def check_same_pulses(name: str, track: Track, flown: Track, what: str) -> Track:
    """The track, checked for the pulse times of the one flown; else a RadarError that begins with ``name``."""
    if track.n_pulses != flown.n_pulses:
        raise RadarError(
            f"{name}: {track.n_pulses} pulses are {what} and {flown.n_pulses} flown; give one line per pulse"
        )
    span = float(flown.time[-1] - flown.time[0])
    late = float(np.abs((track.time - track.time[0]) - (flown.time - flown.time[0])).max())
    if late > 1e-6 * max(span, 1e-9) + 1e-9:
        raise RadarError(
            f"{name}: its pulse times differ by up to {late:.3g} s from those of the track flown; give "
            "the same pulses"
        )
    if track.epoch == DEFAULT_EPOCH:  # without dates: the same pulses are at the same time
        track = replace(track, epoch=utc_after(flown.epoch, float(flown.time[0] - track.time[0])))
    return track


_POINTING_JITTER_PARTS = ("pointing_jitter_corner", "pointing_jitter_slope", "pointing_jitter_seed")


@dataclass(frozen=True)
class PointingError:
    r"""True less nominal direction of the beam, in azimuth (forward) and elevation (upward).

    .. math:: d(t) = o + v (t - t_0) + j(t), \quad S_j(f) \propto \frac{1}{1 + (f / f_c)^q}

    Parameters
    ----------
    offset : rad, in azimuth and elevation
    drift : rad/s, in azimuth and elevation, from the middle of the track
    jitter : rad rms over the track, in each
    corner : Hz, f_c of the jitter's power spectrum
    slope : q; 2 is a Gauss-Markov process
    seed : of the jitter

    Notes
    -----
    Ignores rotation about the boresight and that a turned antenna moves its phase centre.
    """

    offset: tuple[float, float] = (0.0, 0.0)
    drift: tuple[float, float] = (0.0, 0.0)
    jitter: float = 0.0
    corner: float = 0.1
    slope: float = 4.0
    seed: int = 0

    @property
    def is_none(self) -> bool:
        """Whether there is no pointing error."""
        return not (any(self.offset) or any(self.drift) or self.jitter)

    def angles(self, time: F64) -> F64:
        """Pointing error (n_pulses, 2) rad, azimuth and elevation."""
        since = time - 0.5 * (time[0] + time[-1])
        error = np.asarray(self.offset) + since[:, None] * np.asarray(self.drift)
        if self.jitter > 0.0 and time.size > 1:
            error = error + wandering(time, 2, self.jitter, self.corner, self.slope, self.seed)
        return np.asarray(error)

    def flown(self, nominal: Pointing, time: F64) -> Pointing:
        """The true pointing."""
        return turn_axes(nominal, self.angles(time))


def turn_axes(nominal: Pointing, angles: F64) -> Pointing:
    """Pointing with the axes turned by angles (n_pulses, 2), rad: in azimuth, then in elevation."""
    azimuth, elevation = angles.T[..., None]
    ahead = np.cos(azimuth) * nominal.boresight + np.sin(azimuth) * nominal.azimuth_axis
    across = np.cos(azimuth) * nominal.azimuth_axis - np.sin(azimuth) * nominal.boresight
    boresight = np.cos(elevation) * ahead + np.sin(elevation) * nominal.elevation_axis
    over = np.cos(elevation) * nominal.elevation_axis - np.sin(elevation) * ahead
    return Pointing(boresight, across, over)


def pointing_error(given: RadarInput) -> PointingError:
    """The pointing error of a description.

    Raises
    ------
    RadarError
        Parameters have no effect.
    """
    s = given.sensor
    named = sorted(name for name in given.sensor_given if name.startswith("pointing_"))
    if s.pattern == "isotropic" and named:
        raise RadarError(
            f"{given.where}: {named[0]} has no effect with pattern = isotropic; give the antenna a "
            "pattern or leave it out"
        )
    parts = [name for name in named if name in _POINTING_JITTER_PARTS]
    if parts and s.pointing_jitter_deg == 0.0:
        raise RadarError(
            f"{given.where}: {parts[0]} has no effect without pointing_jitter_deg; set pointing_jitter_deg above 0 or "
            "leave it out"
        )
    offset = np.radians([s.pointing_error_azimuth_deg, s.pointing_error_elevation_deg])
    drift = np.radians([s.pointing_drift_azimuth_deg, s.pointing_drift_elevation_deg])
    return PointingError(
        (float(offset[0]), float(offset[1])),
        (float(drift[0]), float(drift[1])),
        float(np.radians(s.pointing_jitter_deg)),
        s.pointing_jitter_corner,
        s.pointing_jitter_slope,
        s.pointing_jitter_seed,
    )
