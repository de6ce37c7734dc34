"""Signal and flight of an image, as stored in its file: a few numbers in place of a radar.

The track is a polynomial of time.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import DEFAULT_EPOCH, utc_after, utc_of, utc_text

# degree of the polynomial: for an orbit over seconds and an aircraft's slow motion the rest is below a micrometre
_DEGREE = 5


class FlightFacts(TypedDict):
    """`Flight` as lists, for JSON."""

    center: list[float]
    velocity: list[float]
    span: list[float]
    coefficients: list[list[float]]
    epoch: str


@dataclass(frozen=True, eq=False)
class Flight:
    """Track as a polynomial of time, with exact mid-aperture state.

    Parameters
    ----------
    center : (3,) float64, m; mid-aperture
    velocity : (3,) float64, m/s; there
    span : first, middle and last pulse time, s
    coefficients : (n, 3) float64, m; Chebyshev series of the position less ``center`` over the span
    epoch : UTC of time zero, datetime64[ns]

    Notes
    -----
    Ignores vibration and turbulence: the polynomial is the smooth track through all pulses.
    """

    center: F64
    velocity: F64
    span: tuple[float, float, float]
    coefficients: F64
    epoch: np.datetime64 = DEFAULT_EPOCH

    @staticmethod
    def of(track: Track, offset: ArrayLike = (0.0, 0.0, 0.0)) -> "Flight":
        """Flight of a track, its positions shifted by an offset (m)."""
        n = track.n_pulses
        center = track.center_position
        first, last = float(track.time[0]), float(track.time[-1])
        middle = 0.5 * float(track.time[(n - 1) // 2] + track.time[n // 2])
        degree = min(_DEGREE, n - 1)
        fit = np.polynomial.chebyshev.chebfit(
            _scale_times(track.time, first, last), track.position - center, degree
        )
        place = np.asarray(center + np.asarray(offset, dtype=np.float64))
        return Flight(
            place,
            track.velocity[track.center_index],
            (first, middle, last),
            np.asarray(fit, dtype=np.float64),
            track.epoch,
        )

    def position(self, time: F64) -> F64:
        """Position (..., 3) float64, m, at times (...), s."""
        series = np.polynomial.chebyshev.chebval(
            _scale_times(time, self.span[0], self.span[2]), self.coefficients
        )
        return np.asarray(self.center + np.moveaxis(series, 0, -1))

    def velocity_at(self, time: F64) -> F64:
        """Velocity (..., 3) float64, m/s, of the polynomial at times (...), s; needs two pulses or more."""
        first, _, last = self.span
        slope = np.polynomial.chebyshev.chebder(self.coefficients) * (2.0 / (last - first))
        series = np.polynomial.chebyshev.chebval(_scale_times(time, first, last), slope)
        return np.asarray(np.moveaxis(series, 0, -1))

    def as_dict(self) -> FlightFacts:
        """JSON-able facts; `from_dict` reads them."""
        return {
            "center": self.center.tolist(),
            "velocity": self.velocity.tolist(),
            "span": list(self.span),
            "coefficients": self.coefficients.tolist(),
            "epoch": utc_text(self.epoch),
        }

    @staticmethod
    def from_dict(facts: FlightFacts) -> "Flight":
        """Flight from the dictionary of `as_dict`."""
        first, middle, last = (float(v) for v in facts["span"])
        center, velocity = np.asarray(facts["center"]), np.asarray(facts["velocity"])
        epoch = utc_of(facts.get("epoch", DEFAULT_EPOCH))
        return Flight(center, velocity, (first, middle, last), np.asarray(facts["coefficients"]), epoch)


def flight_facts(radar: Radar) -> dict[str, object]:
    """Metadata of an image's antennas, frame of the user's file: ``flight`` and, if separate, ``receiver_flight``."""
    facts: dict[str, object] = {"flight": Flight.of(radar.track, radar.offset).as_dict()}
    if radar.receiver is not None:
        facts["receiver_flight"] = Flight.of(radar.receiver, radar.offset).as_dict()
    return facts


def _scale_times(time: F64, first: float, last: float) -> F64:
    """Times as -1 ... 1 over the span."""
    return np.asarray((time - 0.5 * (first + last)) / max(0.5 * (last - first), 1e-300))


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
