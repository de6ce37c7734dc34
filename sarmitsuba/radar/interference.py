"""Interference: emitters on the ground with beams of their own, whose signals the radar receives beside its echoes."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.regular_files import read_rows
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.waveform import Waveform

# kinds by their number in `Emitters.kind`
KINDS = ("narrow", "chirp", "pulse")
_NARROW, _CHIRP, _PULSE = range(3)
_COLUMNS: dict[str, float | None] = {
    "x_m": None,
    "y_m": None,
    "z_m": None,
    "eirp_w": None,
    "frequency_hz": None,
    "bandwidth_hz": 0.0,
    "pulse_width_s": 0.0,
    "prf_hz": 0.0,
    "azimuth_deg": 0.0,
    "elevation_deg": 0.0,
    "beamwidth_deg": 360.0,
}


@dataclass(frozen=True, eq=False)
class Emitters:
    """Emitters at rest, one row each.

    Parameters
    ----------
    kind : (n,) number in `KINDS`: narrow-band and continuous; linear chirps; pulses of one frequency
    position : (n, 3) float64, m, scene frame
    eirp : (n,) W, peak power times the gain at the middle of the beam
    frequency, bandwidth : (n,) Hz; middle, and width of a narrow band or of a chirp
    pulse_width, repetition : (n,) s and Hz, of chirps and pulses
    beam : (n, 3) unit vectors of the middle of the beams
    beamwidth : (n,) rad, half power, of a Gaussian beam round its middle; 2 pi: isotropic
    """

    kind: F64
    position: F64
    eirp: F64
    frequency: F64
    bandwidth: F64
    pulse_width: F64
    repetition: F64
    beam: F64
    beamwidth: F64

    def moved(self, offset: F64) -> "Emitters":
        """Emitters at positions + offset (3,), m."""
        return replace(self, position=self.position + offset)

    def gain(self, row: int, direction: F64) -> F64:
        r"""Power gain (...) towards unit vectors (..., 3), over that at the middle of the beam.

        .. math:: g = 2^{-(2 \theta / \theta_{3dB})^2}
        """
        if self.beamwidth[row] >= 2.0 * np.pi - 1e-9:
            return np.ones(direction.shape[:-1])
        angle = np.arccos(np.clip(direction @ self.beam[row], -1.0, 1.0))
        return np.asarray(np.exp2(-((2.0 * angle / self.beamwidth[row]) ** 2)))

    def duty(self, row: int) -> float:
        """Share of the time during which an emitter is on."""
        if self.kind[row] == _NARROW:
            return 1.0
        return min(1.0, float(self.pulse_width[row] * self.repetition[row]))


def emitters_of(given: RadarInput, waveform: Waveform, offset: F64) -> Emitters | None:
    """Emitters of a description's ``interference_file``, in the scene frame; None where there is none.

    Parameters
    ----------
    given : the description
    waveform : of the radar
    offset : (3,) float64, m; scene frame = file frame - offset

    Raises
    ------
    RadarError
        The file cannot be read, or an emitter has no pulses, or its signal lies outside the radar's band.
    """
    if not given.sensor.interference_file:
        return None
    path = Path(given.sensor.interference_file)
    path = path if path.is_absolute() else given.folder / path
    rows = read_rows(path, "emitters", ("kind",), _COLUMNS, RadarError)
    for number, row in enumerate(rows, 1):
        _check_row(f"{path}: emitter {number}", row, waveform)
    table = {name: np.array([float(row[name]) for row in rows]) for name in _COLUMNS}
    azimuth, elevation = np.radians(table["azimuth_deg"]), np.radians(table["elevation_deg"])
    level = np.cos(elevation)
    return Emitters(
        kind=np.array([float(KINDS.index(str(row["kind"]))) for row in rows]),
        position=np.stack([table[f"{axis}_m"] for axis in "xyz"], axis=1) - offset,
        eirp=table["eirp_w"],
        frequency=table["frequency_hz"],
        bandwidth=table["bandwidth_hz"],
        pulse_width=table["pulse_width_s"],
        repetition=table["prf_hz"],
        beam=np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=1),
        beamwidth=np.radians(table["beamwidth_deg"]),
    )


def _check_row(where: str, row: dict[str, str | float], waveform: Waveform) -> None:
    """Raise a RadarError for an emitter that cannot be."""
    if row["kind"] not in KINDS:
        raise RadarError(f'{where}: kind "{one_line(row["kind"])}" is none of {", ".join(KINDS)}')
    value = {name: float(row[name]) for name in _COLUMNS}
    negative = [name for name in ("eirp_w", "bandwidth_hz", "pulse_width_s", "prf_hz") if value[name] < 0.0]
    if negative or not 0.0 < value["beamwidth_deg"] <= 360.0:
        name = negative[0] if negative else "beamwidth_deg"
        raise RadarError(
            f"{where}: {name} = {value[name]:g} must be {'at least 0' if negative else '0 to 360'}"
        )
    if row["kind"] != "narrow" and not (value["pulse_width_s"] > 0.0 and value["prf_hz"] > 0.0):
        raise RadarError(f"{where}: a {row['kind']} needs pulse_width_s and prf_hz above 0")
    distance = abs(value["frequency_hz"] - waveform.center_frequency)
    if distance - 0.5 * value["bandwidth_hz"] >= 0.5 * waveform.bandwidth:
        raise RadarError(
            f"{where}: frequency_hz = {value['frequency_hz']:.9g} Hz is outside the radar's band of "
            f"{waveform.bandwidth:.6g} Hz about {waveform.center_frequency:.9g} Hz, so that it has no effect"
        )
