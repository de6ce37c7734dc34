"""Pointing errors: true beam direction against the nominal one that the focuser uses."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.jitter import wandering

_JITTER_PARTS = ("pointing_jitter_corner", "pointing_jitter_slope", "pointing_jitter_seed")


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
        return turned(nominal, self.angles(time))


def turned(nominal: Pointing, angles: F64) -> Pointing:
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
    parts = [name for name in named if name in _JITTER_PARTS]
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
