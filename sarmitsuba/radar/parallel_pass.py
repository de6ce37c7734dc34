"""Second pass of an interferometric pair: the track shifted by a constant baseline."""

from dataclasses import replace

import numpy as np

from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.mode import AimGeometry, right_of
from sarmitsuba.radar.track import Track


def parallel_pass(given: RadarInput, track: Track, geometry: AimGeometry) -> tuple[Track, AimGeometry]:
    """Track and geometry of the parallel pass of ``pass_offset_...``; unchanged without offsets.

    Pulses, their rate and the image stay those of the track without the offset. The beam points at the aim point from
    the shifted track; an offset along the track shifts the footprint of a beam fixed to the track.

    Parameters
    ----------
    given : the description
    track : without the offset, scene frame
    geometry : of that track
    """
    s = given.sensor
    if not (s.pass_offset_along or s.pass_offset_across or s.pass_offset_up):
        return track, geometry
    along = track.along
    sideways = s.pass_offset_across * right_of(along) + s.pass_offset_up * np.array([0.0, 0.0, 1.0])
    moved = track.moved(sideways + s.pass_offset_along * along)
    return moved, replace(geometry, center=geometry.center + sideways)
