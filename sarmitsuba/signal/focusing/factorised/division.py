"""Sections of the aperture and the levels of their subimages: sizes, polar grids, time and memory."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.signal.focusing.factorised.sampling import SubimageSampling

# processor seconds of one core: of a pulse at a sample, of a group merged into a sample, of the transforms of a
# subimage's sample, and of a section at a pixel by the taps of the last interpolation; benchmarks/suite/factorised.py
# measures their sum
_PULSE, _MERGE, _SAMPLE = 3e-9, 2.2e-9, 2.5e-8
PIXEL_SECONDS = {4: 7e-9, 6: 12e-9}
# of the transforms, and of the last interpolation, where that is along the image's rows
_ROW_SAMPLE, ROW_PIXEL_SECONDS = 1e-8, {4: 7e-9, 6: 8e-9}
# relative error of the arc tangent of a pixel's angle in float32
_ANGLE_ROUNDING = 6e-7
# of a section, independent of its size: each stage is traced again for its launch
_SECTION = 0.02


@dataclass(frozen=True)
class SubimageLevel:
    """Subimages of all groups of one size: polar grids of one common range axis.

    Parameters
    ----------
    n_pulses : of a group
    n_groups : subimages, those of padding included
    ratio : of the angular spacing to that of the level above; 1 for that of the section
    start_angle, angle_step : rad
    n_angles : samples
    """

    n_pulses: int
    n_groups: int
    ratio: int
    start_angle: float
    angle_step: float
    n_angles: int


@dataclass(frozen=True, eq=False)
class Section:
    """Section of the aperture: consecutive pulses with a common polar grid.

    Parameters
    ----------
    first, n_pulses : pulses of the radar
    origin : (3,) m, centre of the polar grid, mean antenna position
    axes : (3, 3) unit vectors: on the ground towards the image's middle, on the ground at right angles, up
    drop : m, height of the origin above the image's plane
    start_range, range_step : m, slant range from the origin
    n_ranges : samples
    levels : finest subimages first; the last is that of the whole section
    rows : of the image to which it contributes
    on_rows : whether pixels are interpolated in angle on the image's rows first and in range then, because the range
        changes along all rows; else in both at once
    """

    first: int
    n_pulses: int
    origin: F64
    axes: F64
    drop: float
    start_range: float
    range_step: float
    n_ranges: int
    levels: tuple[SubimageLevel, ...]
    rows: slice
    on_rows: bool

    def local(self, positions: F64) -> F64:
        """Positions (..., 3) in the section's frame, whose origin is that of the polar grid."""
        return np.asarray((positions - self.origin) @ self.axes.T)

    @property
    def samples(self) -> int:
        """Largest number of samples in two neighbouring levels together."""
        sizes = [level.n_groups * level.n_angles * self.n_ranges for level in self.levels]
        return max([sizes[-1], *(a + b for a, b in pairwise(sizes))])

    def seconds(self, width: int, n_columns: int) -> float:
        """Processor time."""
        pulses = self.levels[0].n_groups * self.levels[0].n_pulses
        work = _PULSE * pulses * self.n_ranges * self.levels[0].n_angles
        for low, high in pairwise(self.levels):
            work += _MERGE * low.n_groups * high.n_angles * self.n_ranges
        sample, pixel = (
            (_ROW_SAMPLE, ROW_PIXEL_SECONDS[width]) if self.on_rows else (_SAMPLE, PIXEL_SECONDS[width])
        )
        work += sample * self.n_ranges * self.levels[-1].n_angles
        return float(work + pixel * (self.rows.stop - self.rows.start) * n_columns + _SECTION)


@dataclass(frozen=True)
class Plan:
    """Sections of the aperture and the sampling of their subimages.

    Parameters
    ----------
    sections : in the order of the pulses
    sampling : common to all
    seconds : processor time of one layer
    edge_db : error by pixels' apertures that end within sections, dB
    """

    sections: tuple[Section, ...]
    sampling: SubimageSampling
    seconds: float
    edge_db: float

    @property
    def merges(self) -> int:
        """Mergers between pulses and pixels."""
        return max(len(section.levels) for section in self.sections) - 1

    @property
    def error_db(self) -> float:
        r"""Predicted rms error.

        A pixel's angle in single precision, off by :math:`\epsilon` of itself, is off by :math:`\epsilon n / 2` samples
        at the image's edge, where the band's edge turns by :math:`\pi / u` per sample; both are uniformly distributed.
        """
        angles = max(section.levels[-1].n_angles for section in self.sections)
        turned = _ANGLE_ROUNDING * 0.5 * angles * np.pi / self.sampling.upsampling / 3.0
        power = power_from_db(self.sampling.error_db(self.merges)) + power_from_db(self.edge_db)
        return db_from_power(power + turned**2)

    @property
    def n_bytes(self) -> int:
        """Bytes of one layer's subimages with the copies of their correction."""
        return max(
            8 * section.samples + 24 * section.n_ranges * section.levels[-1].n_angles
            for section in self.sections
        )
