"""Interferometric baseline: components about the line of sight, critical baseline, height of ambiguity."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.analysis.interferometry.viewpoint import Viewpoint
from sarmitsuba.core.arrays import F64

# distance of the transmitters, relative to that of the receivers, below which they count as one
_SAME = 1e-3


@dataclass(frozen=True)
class Baseline:
    r"""Interferometric baseline from the first image's antenna to the second's, for one point.

    In a single pass (p = 1) the transmitter is common and the baseline is that of the receivers; in two passes (p = 2)
    it is that of the phase centres.

    .. math:: h_a = \frac{\lambda R \sin\theta}{p B_\perp}, \qquad B_{crit} = \frac{\lambda R \tan\theta}{p \delta_r}

    Parameters
    ----------
    perpendicular : m; across the line of sight and the flight, positive upwards
    parallel : m; along the line of sight, positive towards the scene
    along : m; along the flight, across the line of sight
    passes : p
    slant_range : R, m
    incidence : theta, rad, at a level surface, in the plane across the flight
    range_cell : m of slant range, c / 2 bandwidth
    wavelength : m

    Notes
    -----
    Ignores the slope of the terrain. The critical baseline holds for range alone: along-track baselines also shift the
    Doppler bands.
    """

    perpendicular: float
    parallel: float
    along: float
    passes: int
    slant_range: float
    incidence: float
    range_cell: float
    wavelength: float

    @staticmethod
    def of(
        views: tuple[Viewpoint, Viewpoint], point: F64, wavelength: float, range_cell: float
    ) -> "Baseline":
        """Baseline for a point (3,), m, frame of the user's file."""
        first, second = (view.look(point) for view in views)
        passes, moved = 2, second.center - first.center
        receivers = second.receiver - first.receiver
        apart = float(np.linalg.norm(second.transmitter - first.transmitter))
        if apart < _SAME * float(np.linalg.norm(receivers)):
            passes, moved = 1, receivers
        line = point - first.center
        distance = float(np.linalg.norm(line))
        sight = line / distance
        forward = first.forward
        normal = np.cross(sight, forward)
        normal *= np.copysign(1.0, normal[2]) / np.linalg.norm(normal)
        flight = np.cross(normal, sight)
        flight *= np.copysign(1.0, float(flight @ forward))
        across = sight - float(sight @ forward) * forward
        return Baseline(
            float(moved @ normal),
            float(moved @ sight),
            float(moved @ flight),
            passes,
            distance,
            float(np.arccos(-across[2] / np.linalg.norm(across))),
            range_cell,
            wavelength,
        )

    @property
    def critical(self) -> float:
        """Critical perpendicular baseline, at which the range spectra of level ground do not overlap, m."""
        return float(
            self.wavelength * self.slant_range * np.tan(self.incidence) / (self.passes * self.range_cell)
        )

    @property
    def height_of_ambiguity(self) -> float:
        """Height of ambiguity: change of height for a phase of 2 pi, m; infinite without perpendicular baseline."""
        if self.perpendicular == 0.0:
            return float(np.inf)
        turn = self.wavelength * self.slant_range * np.sin(self.incidence)
        return float(turn / (self.passes * abs(self.perpendicular)))

    def as_dict(self) -> dict[str, object]:
        """Values for JSON, units in the names."""
        return {
            "perpendicular_m": self.perpendicular,
            "parallel_m": self.parallel,
            "along_m": self.along,
            "passes": self.passes,
            "slant_range_m": self.slant_range,
            "incidence_deg": float(np.degrees(self.incidence)),
            "critical_m": self.critical,
            "share_of_critical": abs(self.perpendicular) / self.critical,
            "height_of_ambiguity_m": self.height_of_ambiguity if self.perpendicular else None,
        }
