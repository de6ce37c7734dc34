"""Transmitted waveform: linear and nonlinear frequency modulation, phase codes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line

# longest phase code
MOST_CHIPS = 4096
# binary phases of the Barker codes, 1 for 180 degrees
_BARKER: Mapping[int, str] = {
    2: "01",
    3: "001",
    4: "0010",
    5: "00010",
    7: "0001101",
    11: "00011101101",
    13: "0000011001010",
}
_NODES = 4096  # of the frequency law of nonlinear modulation


@dataclass(frozen=True)
class Waveform:
    r"""Pulse of constant amplitude for ``|t| <= pulse_width / 2``; linear: ``exp(j pi chirp_rate t^2)`` in baseband.

    Other codes: ``nlfm:a``, whose spectrum is a raised cosine of pedestal a, by the principle of stationary phase

    .. math:: \frac{t(f)}{T_p} = \frac{f}{B} + \frac{1 - a}{2 \pi a} \sin \frac{2 \pi f}{B}

    and phase codes of chips of equal length: ``barker:n``; ``frank:n`` of n^2 chips; ``p4:n``; ``chips:`` and phases in
    degrees, separated by commas. Skolnik, Radar Handbook, 3rd ed., chapter 8.

    Parameters
    ----------
    center_frequency : Hz
    bandwidth : swept bandwidth, Hz
    pulse_width : s
    sweep : ``up`` or ``down``: direction of the frequency during the pulse
    code : of other waveforms than linear ones; empty: linear
    """

    center_frequency: float
    bandwidth: float
    pulse_width: float
    sweep: Literal["up", "down"] = "up"
    code: str = ""

    def __post_init__(self) -> None:
        if not (self.center_frequency > 0 and self.bandwidth > 0 and self.pulse_width > 0):
            raise RadarError(
                f"waveform: center_frequency = {self.center_frequency:g} Hz, bandwidth = {self.bandwidth:g} Hz and "
                f"pulse_width = {self.pulse_width:g} s must be positive"
            )
        if self.sweep not in ("up", "down"):
            raise RadarError(f"waveform: sweep = {self.sweep!r} is neither up nor down")
        if self.code:
            chips = self.chips
            if chips is None:
                _ = self._pedestal
            elif chips.size > self.bandwidth * self.pulse_width * (1.0 + 1e-9):
                raise RadarError(
                    f"waveform: {chips.size} chips in pulse_width = {self.pulse_width:g} s need a bandwidth of at "
                    f"least {chips.size / self.pulse_width:.6g} Hz, and it is {self.bandwidth:.6g} Hz"
                )
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
        """Sweep rate, Hz/s, in the middle of the pulse; negative for a down-chirp; infinite for a phase code."""
        rate = self.bandwidth / self.pulse_width
        if self.code:
            rate = float("inf") if self.chips is not None else rate * self._pedestal
        return rate if self.sweep == "up" else -rate

    @property
    def _pedestal(self) -> float:
        """Pedestal of the raised cosine of nonlinear modulation."""
        value = _number(self.code, self.code.partition(":")[2])
        if not 0.05 <= value <= 1.0:
            raise RadarError(
                f'waveform: "{self.code}" has a pedestal of {value:g}; give 0.05 to 1, such as nlfm:0.54'
            )
        return value

    @property
    def chips(self) -> F64 | None:
        """Phases (n,), rad, of the chips of a phase code; None for frequency modulation.

        Raises
        ------
        RadarError
            There is no such code.
        """
        kind, _, text = self.code.partition(":")
        if kind in ("", "nlfm"):
            return None
        if kind == "chips":
            return np.radians([_number(self.code, part) for part in text.split(",")])
        n = int(_number(self.code, text))
        if kind == "barker" and n in _BARKER:
            return np.pi * np.array([float(c) for c in _BARKER[n]])
        if kind == "frank" and 2 <= n <= 64:
            i = np.arange(n)
            return np.asarray(2.0 * np.pi / n * np.outer(i, i)).ravel()
        if kind == "p4" and 2 <= n <= MOST_CHIPS:
            i = np.arange(n)
            return np.asarray(np.pi * i * (i / n - 1.0))
        raise RadarError(
            f'waveform: "{one_line(self.code)}" is none of nlfm:0.54, barker:N with N of '
            f"{', '.join(map(str, _BARKER))}, frank:N to 64, p4:N to {MOST_CHIPS}"
        )

    def phase(self, time: F64) -> F64:
        """Phase (n,), rad, of the pulse in baseband at times (n,), s, from its middle."""
        sign = 1.0 if self.sweep == "up" else -1.0
        if not self.code:
            return np.asarray(np.pi * self.chirp_rate * time**2)
        if (chips := self.chips) is not None:
            number = np.floor((time / self.pulse_width + 0.5) * chips.size).astype(int)
            return np.asarray(sign * chips[np.clip(number, 0, chips.size - 1)])
        f = np.linspace(-0.5, 0.5, _NODES)
        a = self._pedestal
        at = f + (1.0 - a) / (2.0 * np.pi * a) * np.sin(2.0 * np.pi * f)
        # the integral of the frequency over time, by parts exact between nodes to second order
        turns = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * np.diff(at))])
        turns = np.interp(time / self.pulse_width, at, turns)
        return np.asarray(sign * 2.0 * np.pi * self.bandwidth * self.pulse_width * turns)

    @property
    def range_cell(self) -> float:
        """Slant-range cell c / (2 B), m; the unweighted -3 dB width is 0.886 of it."""
        return SPEED_OF_LIGHT / (2.0 * self.bandwidth)


def _number(code: str, text: str) -> float:
    """Number in a code's text."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise RadarError(f'waveform: "{one_line(code)}" has no number where "{one_line(text)}" stands')
    return value
