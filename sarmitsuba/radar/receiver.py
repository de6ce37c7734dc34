"""Separate receiver of bistatic data: on the same platform or on another."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.mode import right_of
from sarmitsuba.radar.recorded import of_same_pulses
from sarmitsuba.radar.track import Track

_OFFSETS = ("receiver_offset_along", "receiver_offset_across", "receiver_offset_up")
# rad, largest tested bistatic angle at the aim point
LARGEST_ANGLE = float(np.radians(30.0))


def receiver_track(given: RadarInput, track: Track, aim: F64, offset: F64) -> Track | None:
    r"""Track of a separate receiver in the scene frame; None for monostatic data.

    .. math:: \mathbf r(t) = \mathbf x(t) + b_a \hat a + b_r \hat r + b_u \hat z

    with :math:`\hat a` the horizontal direction of flight at mid-aperture and :math:`\hat r` to its right.

    Parameters
    ----------
    given : the description
    track : of the transmitter, scene frame
    aim : (3,) m, scene frame; aim point
    offset : (3,) float64, m; scene frame = file frame - offset

    Raises
    ------
    RadarError
        The file cannot be read or does not match the transmitter's pulses, parameters contradict each other, or the
        bistatic angle is too large.
    """
    s = given.sensor
    if s.receiver_track_file:
        beside = sorted(given.sensor_given & set(_OFFSETS))
        if beside:
            raise RadarError(
                f"{given.where}: {beside[0]} has no effect beside receiver_track_file; leave one of them out"
            )
        path = Path(s.receiver_track_file)
        own = Track.from_csv(path if path.is_absolute() else given.folder / path)
        own = replace(own, position=own.position - offset)
        receiver = of_same_pulses(s.receiver_track_file, own, track, "received")
    else:
        baseline = np.array([s.receiver_offset_along, s.receiver_offset_across, s.receiver_offset_up])
        if not baseline.any():
            return None
        axes = np.array([track.along, right_of(track.along), [0.0, 0.0, 1.0]])
        receiver = replace(track, position=track.position + baseline @ axes)
    angle = float(bistatic_angle(track, receiver, aim).max())
    if angle > LARGEST_ANGLE:
        raise RadarError(
            f"{given.where}: the bistatic angle at the aim point is {np.degrees(angle):.3g} deg, more than "
            f"{np.degrees(LARGEST_ANGLE):.0f} deg; bring it nearer"
        )
    return receiver


def bistatic_angle(track: Track, receiver: Track, point: F64) -> F64:
    """Bistatic angle (n_pulses,), rad, between the lines of sight of two tracks to a point (3,), m."""
    a, b = (one.position - point for one in (track, receiver))
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(np.arctan2(sine, np.einsum("ni,ni->n", a, b)))
