"""Signal and flight of an image, as stored in its file: a few numbers in place of a radar."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.flight import Flight
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.utc import utc_after

_STRAIGHT = 1e-3  # m


@dataclass(frozen=True)
class Signal:
    """Transmitted signal and aperture of an image.

    Parameters
    ----------
    mode : of the radar
    look_side : ``left`` or ``right``
    pulses : number of them
    aperture : s, aperture time of a pixel; the whole time where one aperture serves all
    aim_point : (3,) m, frame of the user's file
    center_frequency, bandwidth, sampling_rate : Hz
    pulse_width : s
    """

    mode: str
    look_side: str
    pulses: int
    aperture: float
    aim_point: tuple[float, ...]
    center_frequency: float
    bandwidth: float
    sampling_rate: float
    pulse_width: float

    @staticmethod
    def of(radar: Radar) -> "Signal":
        """Signal of a radar."""
        track, wave = radar.track, radar.waveform
        aperture = float(track.time[-1] - track.time[0])
        if np.isfinite(radar.half_aperture):
            middle = track.center_index
            speed = float(np.linalg.norm(track.velocity[middle]))
            distance = float(np.linalg.norm(radar.aim_point - track.position[middle]))
            aperture = min(aperture, 2.0 * radar.half_turn * distance / speed)
        return Signal(
            mode=radar.mode,
            look_side=radar.look_side,
            pulses=track.n_pulses,
            aperture=aperture,
            aim_point=tuple(float(v) for v in radar.aim_point + radar.offset),
            center_frequency=wave.center_frequency,
            bandwidth=wave.bandwidth,
            sampling_rate=radar.window.sampling_rate,
            pulse_width=wave.pulse_width,
        )


@dataclass(frozen=True, eq=False)
class Collection:
    """Signal and flight of an image, in the frame of the user's file."""

    signal: Signal
    flight: Flight

    @staticmethod
    def read(facts: Mapping[str, object], what: str) -> "Collection":
        """Read from an image's metadata of focusing.

        Raises
        ------
        DataError
            The metadata have none: the image was focused elsewhere or by an older version.
        """
        signal, flight = facts.get("signal"), facts.get("flight")
        if not isinstance(signal, Mapping) or not isinstance(flight, Mapping):
            raise DataError(f"{what}: the image does not say how it was flown; focus its raw data again")
        return Collection(
            Signal(**{**signal, "aim_point": tuple(signal["aim_point"])}),
            Flight.from_dict(flight),  # type: ignore[arg-type]
        )

    @property
    def start(self) -> np.datetime64:
        """UTC of the first pulse, datetime64[ns]."""
        return utc_after(self.flight.epoch, self.flight.span[0])

    @property
    def duration(self) -> float:
        """Duration from the first to the last pulse, s."""
        return self.flight.span[2] - self.flight.span[0]

    @property
    def own_apertures(self) -> bool:
        """Whether every pixel has its own aperture time."""
        return self.signal.aperture < self.duration * (1.0 - 1e-9)

    @property
    def straight_and_level(self) -> bool:
        """Whether the flight is a straight horizontal line, to a millimetre."""
        rows = self.polynomial()
        bend = rows[2:] * self.duration ** np.arange(2, len(rows))[:, None]
        climb = float(rows[1, 2]) * self.duration if len(rows) > 1 else 0.0
        return bool(np.abs(bend).max(initial=0.0) < _STRAIGHT and abs(climb) < _STRAIGHT)

    @property
    def pulse_rate(self) -> float:
        """Mean pulse repetition frequency, Hz."""
        return (self.signal.pulses - 1) / self.duration

    def polynomial(self) -> F64:
        """(n, 3) float64: position in m over the time in s from the first pulse, lowest power first."""
        domain = [0.0, self.duration]
        rows = [
            np.polynomial.Chebyshev(one, domain=domain)
            .convert(kind=np.polynomial.Polynomial, domain=[-1, 1])
            .coef
            for one in self.flight.coefficients.T
        ]
        size = max(row.size for row in rows)
        out = np.stack([np.pad(row, (0, size - row.size)) for row in rows], axis=1)
        out[0] += self.flight.center
        return np.asarray(out)

    def state(self, time: float) -> tuple[F64, F64]:
        """Position (m) and velocity (m/s), (3,) float64, at a time in s from the first pulse."""
        rows = self.polynomial()
        slope = np.polynomial.polynomial.polyder(rows) if len(rows) > 1 else np.zeros((1, 3))
        position, velocity = (
            np.asarray(np.polynomial.polynomial.polyval(time, one)) for one in (rows, slope)
        )
        return position, velocity


def signal_facts(radar: Radar) -> dict[str, object]:
    """Metadata entry ``signal`` of an image, JSON-able."""
    return {"signal": asdict(Signal.of(radar))}
