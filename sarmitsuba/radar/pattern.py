"""Antenna patterns: relative one-way power gain over direction, from a few numbers or from tables.

A measured pattern is two cuts, with their beamwidths and their interpolation nodes in kernels.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64, Samples
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.registry import Registry
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.regular_files import read_text

# -3 dB half angle of sinc^2: sinc(pi u) = 1/sqrt(2) at u = 0.442946
SINC_HALF_POWER = 0.442946470689452
# half-power half-widths over which a pattern is measured, and their number; gain of a null
_REACH, _STEPS, _NULL = 8.0, 4000, 1e-3


class Pattern(ABC):
    """Shape of a beam about its boresight.

    A pattern is one module with one registered instance; it may be a user's extension module. It runs in NumPy and in
    the kernels, where its numbers are opaque: one kernel serves all beams of a shape.

    Attributes
    ----------
    name : in scene files
    doc : one phrase
    half_power_sine : sine of the half-power half-angle times the size of the aperture in wavelengths; None: the shape
        belongs to no aperture, and its widths have to be given
    measured : its numbers are those of a :class:`sarmitsuba.radar.pattern.PatternTable` read from a file, not
        the half-power widths
    """

    name: str
    doc: str
    half_power_sine: float | None = None
    measured: bool = False

    @abstractmethod
    def gain(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """Relative one-way power gain, which is the relative two-way amplitude; 1 at its peak.

        Parameters
        ----------
        sin_azimuth, sin_elevation : components of the unit direction along the aperture's axes
        numbers : :attr:`sarmitsuba.radar.antenna.Antenna.numbers`: one over the sines of the half-power half-angles in
            azimuth and elevation, or the table's
        xp : ``numpy`` or ``drjit``
        """

    def find_null(self) -> float | None:
        """Sine of the first null over that of the half-power half-angle; None: the gain has none."""
        gain = self._measure()
        least = np.flatnonzero((gain[1:-1] < _NULL) & (gain[1:-1] < gain[:-2]) & (gain[1:-1] <= gain[2:]))
        return float(_REACH * (least[0] + 1) / _STEPS) if least.size else None

    def find_bends(self) -> tuple[float, float]:
        """Largest first and second derivative of the gain over the sine in half-power half-widths."""
        gain, step = self._measure(), _REACH / _STEPS
        slope = np.abs(np.diff(gain)).max() / step
        return float(slope), float(np.abs(np.diff(gain, 2)).max() / step**2)

    def _measure(self) -> F64:
        """Gain of the cut in azimuth over ``_REACH`` half-power half-widths, (_STEPS + 1,)."""
        sine = np.linspace(0.0, _REACH, _STEPS + 1)
        return np.asarray(self.gain(sine, np.zeros_like(sine), (1.0, 1.0)), dtype=np.float64)


PATTERNS: Registry[Pattern] = Registry("antenna pattern", Pattern, "sarmitsuba.radar.patterns")


CUTS = ("azimuth", "elevation")
# nodes per half-power half-width: linear steps between them then err by -99 dB of the peak
_NODES_PER_WIDTH = 128
_FEWEST_NODES, _MOST_NODES = 1 << 10, 1 << 16
# least depth of a first null, one way; shallower ripple belongs to the main lobe
_CUT_NULL = 0.1
_NARROWEST = 1e-9  # smallest half-power half-width of a main lobe, in sines


@dataclass(frozen=True, eq=False)
class PatternTable:
    """Relative one-way power gain over the angle off boresight, separable in azimuth and elevation.

    Between the angles of a cut the gain follows a shape-preserving cubic (PCHIP) of the power gain over angle, which
    neither overshoots nor goes below zero; beyond its ends the last value holds.

    Parameters
    ----------
    azimuth_cut, elevation_cut : (n, 2) float64; angle, rad, strictly increasing, positive forward and upward; and gain
        over the cut's peak, linear power
    """

    azimuth_cut: F64
    elevation_cut: F64

    @cached_property
    def cuts(self) -> "tuple[PatternCut, PatternCut]":
        """Both cuts with their derived quantities."""
        return PatternCut(self.azimuth_cut), PatternCut(self.elevation_cut)

    @property
    def numbers(self) -> tuple[float | F64, ...]:
        """Numbers that the pattern ``table`` looks up: four of each cut."""
        return tuple(number for cut in self.cuts for number in cut.numbers)

    @staticmethod
    def from_csv(path: Path | str) -> "PatternTable":
        """Read one line per angle: ``cut, angle_deg, gain_db``, cut ``azimuth`` or ``elevation``.

        Commas separate, ``#`` begins a comment, and the first line may be a header. The gain is one way, and counts
        from each cut's peak.

        Raises
        ------
        RadarError
            The file cannot be read, or a cut is missing, not sorted, too coarse or lacks its main lobe.
        """
        path = Path(path)
        try:
            text = read_text(path, errors="strict")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise RadarError(f"{path}: cannot read the antenna pattern: {reason}") from error
        rows: dict[str, list[tuple[float, float]]] = {cut: [] for cut in CUTS}
        for number, line in enumerate(text.splitlines(), 1):
            cells = [cell.strip() for cell in line.partition("#")[0].split(",")]
            if cells == [""] or (cells[0] == "cut" and not any(rows.values())):
                continue
            try:
                cut, angle, gain = cells
                rows[cut].append((float(angle), float(gain)))
            except (ValueError, KeyError):
                raise RadarError(
                    f"{path}:{number}: every line needs cut, angle_deg, gain_db, the cut azimuth or elevation; "
                    f'this one is "{line.strip()[:60]}"'
                ) from None
        return PatternTable(*(_check_cut(path, cut, np.array(rows[cut]).reshape(-1, 2)) for cut in CUTS))


class PatternCut:
    """One cut of a table.

    Parameters
    ----------
    rows : (n, 2) float64, as of :class:`PatternTable`
    """

    def __init__(self, rows: F64) -> None:
        self.angle, self.gain = rows[:, 0], rows[:, 1]
        self._between = scipy.interpolate.PchipInterpolator(self.angle, self.gain)
        ends = np.sin(self.angle[[0, -1]])
        self.half_power = self._half_power()
        width = float(np.diff(np.sin(self.half_power))[0]) / 2.0
        if not _NARROWEST < width < np.inf:
            raise RadarError(
                f"pattern_file: the main lobe of a cut is {width:.3g} wide in sines, not above {_NARROWEST:g}; check "
                "its gains in dB, and give more angles over it"
            )
        wanted = _NODES_PER_WIDTH * float(ends[1] - ends[0]) / width
        n = int(np.clip(2 ** np.ceil(np.log2(wanted)), _FEWEST_NODES, _MOST_NODES))
        self.sine = np.linspace(ends[0], ends[1], n)
        angle = np.clip(np.arcsin(self.sine), self.angle[0], self.angle[-1])
        self.nodes = np.asarray(self._between(angle))

    @property
    def numbers(self) -> tuple[float, float, float, F64]:
        """Sine of the first node, nodes per sine, number of the last node, gain at the nodes."""
        n = self.sine.size
        return float(self.sine[0]), (n - 1) / float(self.sine[-1] - self.sine[0]), n - 1.0, self.nodes

    def _half_power(self) -> F64:
        """Half-power angles (2,) of the main lobe, rad; NaN where it does not fall to half power within the cut."""
        roots = np.asarray(self._between.solve(0.5, extrapolate=False))
        peak = float(self.angle[np.argmax(self.gain)])
        below, above = roots[roots < peak], roots[roots > peak]
        return np.array([below.max(initial=-np.inf), above.min(initial=np.inf)])

    @property
    def beamwidth(self) -> float:
        """Half-power width, rad."""
        return float(np.diff(self.half_power)[0])

    @property
    def null(self) -> float | None:
        """Sine of the first null, the larger of both sides; None where a side has none.

        A null is the first minimum of the gain beyond half power that is at least 10 dB below the peak.
        """
        found = []
        peak = int(np.argmax(self.gain))
        for side in (-1, 1):
            lobe = self.gain[peak::side]
            least = np.flatnonzero(
                (lobe[1:-1] < _CUT_NULL) & (lobe[1:-1] <= lobe[:-2]) & (lobe[1:-1] < lobe[2:])
            )
            if not least.size:
                return None
            found.append(abs(float(np.sin(self.angle[peak + side * (int(least[0]) + 1)]))))
        return max(found)

    def bends(self, width: float) -> tuple[float, float]:
        """Largest first and second derivative of the gain over the sine in ``width``, over steps of a quarter of it."""
        step = 0.25
        before, after = (
            np.interp(self.sine + shift * width, self.sine, self.nodes) for shift in (-step, step)
        )
        slope = np.abs(after - before).max() / (2.0 * step)
        bend = np.abs(after - 2.0 * self.nodes + before).max() / step**2
        return float(slope), float(bend)


def _check_cut(path: Path, name: str, rows: F64) -> F64:
    """Angles in rad and relative gains of one cut as read; RadarError where it is invalid."""
    where = f"{path}: the cut in {name}"
    angle, gain = rows.T
    if angle.size < 3 or not np.isfinite(rows).all():
        raise RadarError(f"{where} has {angle.size} angles with finite gains; give at least 3")
    if (np.diff(angle) <= 0.0).any() or angle[0] < -90.0 or angle[-1] > 90.0:
        raise RadarError(f"{where} does not rise strictly within -90 deg to 90 deg; sort its angles")
    power = power_from_db(gain - gain.max())
    checked = np.stack([np.radians(angle), power], axis=1)
    if power[0] >= 0.5 or power[-1] >= 0.5:
        raise RadarError(
            f"{where} does not fall to half power on both sides: {db_from_power(power[0]):.3g} dB at {angle[0]:g} deg, "
            f"{db_from_power(power[-1]):.3g} dB at {angle[-1]:g} deg; give it over a wider range of angles"
        )
    if not angle[0] <= 0.0 <= angle[-1]:
        raise RadarError(f"{where} leaves out the boresight, 0 deg; count its angles from there")
    return checked
