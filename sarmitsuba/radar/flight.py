"""Track of an antenna as a polynomial of time, compact enough for an image's metadata."""

from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import DEFAULT_EPOCH, utc_of, utc_text

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
            _scaled(track.time, first, last), track.position - center, degree
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
        series = np.polynomial.chebyshev.chebval(_scaled(time, self.span[0], self.span[2]), self.coefficients)
        return np.asarray(self.center + np.moveaxis(series, 0, -1))

    def velocity_at(self, time: F64) -> F64:
        """Velocity (..., 3) float64, m/s, of the polynomial at times (...), s; needs two pulses or more."""
        first, _, last = self.span
        slope = np.polynomial.chebyshev.chebder(self.coefficients) * (2.0 / (last - first))
        series = np.polynomial.chebyshev.chebval(_scaled(time, first, last), slope)
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
        """Flight of what `as_dict` made."""
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


def _scaled(time: F64, first: float, last: float) -> F64:
    """Times as -1 ... 1 over the span."""
    return np.asarray((time - 0.5 * (first + last)) / max(0.5 * (last - first), 1e-300))
