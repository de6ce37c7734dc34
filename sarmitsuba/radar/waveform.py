"""Transmitted waveform, a linear frequency-modulated pulse; letters of radar bands with a usual frequency of each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError


@dataclass(frozen=True)
class Waveform:
    """LFM pulse, in complex baseband ``exp(j pi chirp_rate t^2)`` for ``|t| <= pulse_width / 2``.

    Parameters
    ----------
    center_frequency : Hz
    bandwidth : swept bandwidth, Hz
    pulse_width : s
    sweep : ``up`` or ``down``: direction of the frequency during the pulse
    """

    center_frequency: float
    bandwidth: float
    pulse_width: float
    sweep: Literal["up", "down"] = "up"

    def __post_init__(self) -> None:
        if not (self.center_frequency > 0 and self.bandwidth > 0 and self.pulse_width > 0):
            raise RadarError(
                f"waveform: center_frequency = {self.center_frequency:g} Hz, bandwidth = {self.bandwidth:g} Hz and "
                f"pulse_width = {self.pulse_width:g} s must be positive"
            )
        if self.sweep not in ("up", "down"):
            raise RadarError(f"waveform: sweep = {self.sweep!r} is neither up nor down")
        if self.bandwidth >= 2 * self.center_frequency:
            raise RadarError(
                f"waveform: bandwidth = {self.bandwidth:g} Hz must be below twice the "
                f"center_frequency = {self.center_frequency:g} Hz"
            )

    @property
    def wavelength(self) -> float:
        """Wavelength at the centre frequency, m."""
        return SPEED_OF_LIGHT / self.center_frequency

    @property
    def chirp_rate(self) -> float:
        """Sweep rate, Hz/s; negative for a down-chirp."""
        rate = self.bandwidth / self.pulse_width
        return rate if self.sweep == "up" else -rate

    @property
    def range_cell(self) -> float:
        """Slant-range cell c / (2 B), m; the unweighted -3 dB width is 0.886 of it."""
        return SPEED_OF_LIGHT / (2.0 * self.bandwidth)


# Hz, within IEEE Std 521: ALOS-2, NISAR's S band, Sentinel-1, TerraSAR-X, airborne Ku and Ka radars
BANDS: Mapping[str, float] = {
    "L": 1.2575e9,
    "S": 3.2e9,
    "C": 5.405e9,
    "X": 9.65e9,
    "Ku": 16.7e9,
    "Ka": 35.0e9,
}
