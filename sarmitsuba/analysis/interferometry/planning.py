"""Planning of the second pass: a perpendicular baseline suitable for the scene."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sarmitsuba.radar.mode import right_of
from sarmitsuba.radar.radar import Radar

# automatic baseline: relief of the scene over the height of ambiguity, and share of the critical baseline
RELIEF_SHARE, LEAST_COHERENCE = 0.6, 0.8


@dataclass(frozen=True)
class PassOffset:
    """Offset of a parallel pass, or of a second receiver.

    Parameters
    ----------
    across, up : m, to the right of the track and upwards
    passes : 2, or 1 for two receivers and one transmission
    """

    across: float
    up: float
    passes: Literal[1, 2] = 2

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of ``sar_antenna``, by their names in scene files and ``RadarDescription``."""
        what = "pass_offset" if self.passes == 2 else "receiver_offset"
        return {f"{what}_across": self.across, f"{what}_up": self.up}


def second_pass(
    radar: Radar, relief: float, baseline: float | None = None, passes: Literal[1, 2] = 2
) -> PassOffset:
    r"""Offset of the second pass, normal to line of sight and flight at the aim point.

    .. math:: B_\perp = \min\left(\frac{0.6\, \lambda R \sin\theta}{p\, \Delta z}, 0.2\, B_{crit}\right)

    Parameters
    ----------
    radar : of the first pass
    relief : Delta z, m, height range of the scene; 0 for level ground
    baseline : perpendicular, m, positive upwards, in place of the automatic one
    passes : p: 2, or 1 with one transmission and two receivers
    """
    along = radar.track.along
    sight = radar.aim_point - radar.track.center_position
    distance = float(np.linalg.norm(sight))
    normal = np.cross(sight, along)
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    if baseline is None:
        drop = sight - (sight @ along) * along
        incidence = float(np.arccos(-drop[2] / np.linalg.norm(drop)))
        turn = radar.waveform.wavelength * distance / passes
        baseline = (1.0 - LEAST_COHERENCE) * turn * np.tan(incidence) / radar.waveform.range_cell
        if relief > 0.0:
            baseline = min(baseline, RELIEF_SHARE * turn * np.sin(incidence) / relief)
    return PassOffset(float(baseline * (normal @ right_of(along))), float(baseline * normal[2]), passes)
