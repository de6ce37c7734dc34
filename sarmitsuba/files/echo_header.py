"""Header of chirped echoes from elsewhere: a few numbers in a JSON or TOML file beside the data; see docs/files.md."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean, printable
from sarmitsuba.files.table_file import read_table
from sarmitsuba.machine.regular_files import is_inside
from sarmitsuba.radar.polarisation import CHANNELS
from sarmitsuba.radar.utc import utc_of

AUTO = "auto"
_MOST_BYTES = 1 << 16
# name: lowest and highest value; RADARSAT-1's are in the middle of each, airborne and laboratory radars at the ends
_NUMBERS = {
    "carrier_hz": (1e6, 1e12),
    "sampling_rate_hz": (1e3, 1e11),
    "chirp_rate_hz_per_s": (-1e18, 1e18),
    "pulse_length_s": (1e-9, 1.0),
    "prf_hz": (1e-3, 1e7),
    "effective_velocity_m_per_s": (1e-3, 1e6),
}
_CENTROID = "doppler_centroid_hz"
_START = {"first_sample_time_s": (0.0, 100.0), "first_range_m": (0.0, 1e10)}
_OPTIONAL = {"doppler_bandwidth_hz": (1e-3, 1e7), "incidence_angle_deg": (1.0, 89.0)}
_TEXTS = {
    "data": "",
    "variable": "",
    "pulses_along": "rows",
    "look_side": "right",
    "channel": "VV",
    "first_pulse_utc": "",
}
_CHOICES = {"pulses_along": ("rows", "columns"), "look_side": ("left", "right"), "channel": CHANNELS}
# share of the pulse rate processed unless the header says how wide the beam's Doppler band is: its rest is ambiguous
_PROCESSED = 0.8
# assumed at mid-swath unless told; slant-range images do not depend on it
_INCIDENCE = 45.0
# largest sine of the squint angle of echoes that a straight effective track describes
_SQUINT = 0.7


@dataclass(frozen=True)
class EchoHeader:
    """Parameters of chirped echoes, SI units.

    Parameters
    ----------
    source : path of the header, for messages
    data : file of the echoes, relative to the header's folder
    variable : of a MATLAB file; empty: its only complex matrix
    pulses_along : ``rows`` or ``columns`` of the matrix
    carrier, sampling_rate, prf : Hz
    chirp_rate : Hz/s, negative: the frequency falls during the pulse
    pulse_length : s
    first_sample_time : s, of the first sample after the beginning of the pulse's transmission
    effective_velocity : m/s
    doppler_centroid : Hz, absolute; None: estimated from the echoes
    doppler_bandwidth : Hz, processed about the centroid
    incidence_angle : rad, at mid-swath
    look_side, channel : of the radar
    first_pulse : UTC of the first pulse, datetime64[ns]; None: not given
    """

    source: str
    data: str
    variable: str
    pulses_along: str
    carrier: float
    sampling_rate: float
    chirp_rate: float
    pulse_length: float
    prf: float
    first_sample_time: float
    effective_velocity: float
    doppler_centroid: float | None
    doppler_bandwidth: float
    incidence_angle: float
    look_side: str
    channel: str
    first_pulse: np.datetime64 | None

    @property
    def bandwidth(self) -> float:
        """Swept bandwidth, Hz."""
        return abs(self.chirp_rate) * self.pulse_length

    @property
    def wavelength(self) -> float:
        """Wavelength at the carrier, m."""
        return SPEED_OF_LIGHT / self.carrier

    def sine(self, doppler: float) -> float:
        """Sine along the flight of the direction with a Doppler frequency, Hz."""
        return 0.5 * doppler * self.wavelength / self.effective_velocity

    def check_centroid(self, doppler: float) -> None:
        """Raise a DataError where a Doppler centroid, Hz, is too large for a straight track."""
        edge = abs(doppler) + 0.5 * self.doppler_bandwidth
        if self.sine(edge) > _SQUINT:
            raise DataError(
                f"{self.source}: {_CENTROID} = {doppler:g} Hz with a band of {self.doppler_bandwidth:g} Hz is a squint "
                f"sine of {self.sine(edge):.3g} at effective_velocity_m_per_s = {self.effective_velocity:g}; at most "
                f"{_SQUINT}"
            )


def read_header(path: Path) -> EchoHeader:
    """Header of a JSON or TOML file.

    Raises
    ------
    DataError
        The file cannot be read, or a value is missing, unknown, of another type, out of bounds or contradicts another.
    """
    content = read_table(path, "a header", _MOST_BYTES)
    known = {*_NUMBERS, _CENTROID, *_START, *_OPTIONAL, *_TEXTS}
    for name in content:
        if name not in known:
            raise DataError(
                f'{path}: "{printable(str(name))[:60]}" is unknown{did_you_mean(str(name), sorted(known))}'
            )
    texts = {name: _text(path, content, name, default) for name, default in _TEXTS.items()}
    if not is_inside(texts["data"], path.parent) or Path(texts["data"]).suffix.lower() not in (
        ".npy",
        ".mat",
    ):
        raise DataError(
            f'{path}: data = "{printable(texts["data"])[:200]}" is not a .npy or .mat file in the folder of the header'
        )
    number = {name: _number(path, content, name, *bounds) for name, bounds in _NUMBERS.items()}
    starts = [name for name in _START if name in content]
    if len(starts) != 1:
        raise DataError(f"{path}: give one of {' and '.join(_START)}, not {len(starts)} of them")
    first = _number(path, content, starts[0], *_START[starts[0]])
    centroid = content.get(_CENTROID)
    header = EchoHeader(
        source=str(path),
        data=texts["data"],
        variable=texts["variable"],
        pulses_along=texts["pulses_along"],
        carrier=number["carrier_hz"],
        sampling_rate=number["sampling_rate_hz"],
        chirp_rate=number["chirp_rate_hz_per_s"],
        pulse_length=number["pulse_length_s"],
        prf=number["prf_hz"],
        first_sample_time=first if starts[0] == "first_sample_time_s" else 2.0 * first / SPEED_OF_LIGHT,
        effective_velocity=number["effective_velocity_m_per_s"],
        doppler_centroid=None if centroid == AUTO else _number(path, content, _CENTROID, -1e9, 1e9),
        doppler_bandwidth=_optional(path, content, "doppler_bandwidth_hz", _PROCESSED * number["prf_hz"]),
        incidence_angle=math.radians(_optional(path, content, "incidence_angle_deg", _INCIDENCE)),
        look_side=texts["look_side"],
        channel=texts["channel"],
        first_pulse=_utc(path, texts["first_pulse_utc"]),
    )
    _check_together(path, header)
    return header


def _text(path: Path, content: Mapping[str, object], name: str, default: str) -> str:
    value = content.get(name, default)
    if not isinstance(value, str) or (name == "data" and not value):
        raise DataError(f"{path}: {name} {'is missing' if name not in content else 'is not a text'}")
    choices = _CHOICES.get(name)
    if choices and value not in choices:
        raise DataError(f'{path}: {name} = "{printable(value)[:60]}" is none of {", ".join(choices)}')
    return value


def _utc(path: Path, text: str) -> np.datetime64 | None:
    try:
        return utc_of(text) if text else None
    except ValueError as error:
        raise DataError(f"{path}: first_pulse_utc = {error}") from None


def _number(path: Path, content: Mapping[str, object], name: str, low: float, high: float) -> float:
    value = content.get(name)
    if value is None:
        raise DataError(f"{path}: {name} is missing")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise DataError(f"{path}: {name} = {printable(str(value))[:60]} is not a number")
    if not low <= value <= high:  # NaN neither
        raise DataError(f"{path}: {name} = {value:g} is out of bounds ({low:g} to {high:g})")
    return float(value)


def _optional(path: Path, content: Mapping[str, object], name: str, default: float) -> float:
    return _number(path, content, name, *_OPTIONAL[name]) if name in content else default


def _check_together(path: Path, header: EchoHeader) -> None:
    """Raise a DataError for numbers that contradict each other."""
    if not 1e3 <= header.bandwidth < header.carrier:
        raise DataError(
            f"{path}: chirp_rate_hz_per_s = {header.chirp_rate:g} over pulse_length_s = {header.pulse_length:g} sweeps "
            f"{header.bandwidth:g} Hz; it must be from 1000 Hz to the carrier's {header.carrier:g}"
        )
    if header.sampling_rate < header.bandwidth:
        raise DataError(
            f"{path}: sampling_rate_hz = {header.sampling_rate:g} is below the pulse's bandwidth "
            f"{header.bandwidth:g} Hz; complex samples need at least that"
        )
    if header.pulse_length * header.prf >= 1.0:
        raise DataError(f"{path}: pulse_length_s = {header.pulse_length:g} is not shorter than 1 / prf_hz")
    if header.doppler_bandwidth > header.prf:
        raise DataError(
            f"{path}: doppler_bandwidth_hz = {header.doppler_bandwidth:g} is above prf_hz = {header.prf:g}"
        )
    nearest = 0.5 * SPEED_OF_LIGHT * header.first_sample_time
    if nearest < 1.0:
        raise DataError(f"{path}: the first sample is of the range {nearest:g} m; at least 1 m is needed")
    header.check_centroid(0.0 if header.doppler_centroid is None else header.doppler_centroid)
    if not np.isfinite(header.sine(header.doppler_bandwidth)):
        raise DataError(f"{path}: effective_velocity_m_per_s = {header.effective_velocity:g} is too small")
