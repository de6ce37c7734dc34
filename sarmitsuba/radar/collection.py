"""What an image's file says of the flight it was made from: a few numbers and polynomials in place of a track."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.errors import DataError
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]

_DEGREE = 5  # of the position over time: from orbit within a micrometre over 30 s


@dataclass(frozen=True)
class Collection:
    """The flight and the signal that an image was made from.

    Parameters
    ----------
    mode : of the radar
    look_side : ``left`` or ``right``
    start, duration : s; time of the first pulse, and to the last one
    pulse_rate : mean pulse repetition frequency, Hz
    position : degree + 1 rows of three; polynomial of the antenna's position in m, in the frame of the user's file, over
        time in s from ``start``, lowest power first
    aim_point : (3,) m, frame of the user's file
    aperture : s, for which a pixel was seen; the duration where one aperture serves all
    center_frequency, bandwidth : Hz
    pulse_width : s
    sampling_rate : Hz
    """

    mode: str
    look_side: str
    start: float
    duration: float
    pulse_rate: float
    position: tuple[tuple[float, ...], ...]
    aim_point: tuple[float, ...]
    aperture: float
    center_frequency: float
    bandwidth: float
    pulse_width: float
    sampling_rate: float

    @staticmethod
    def of(radar: Radar) -> "Collection":
        """What a radar flew, as recorded."""
        radar = radar.in_file_frame()
        track, wave = radar.track, radar.waveform
        time = track.time - track.time[0]
        duration = float(time[-1])
        degree = min(_DEGREE, track.n_pulses - 1)
        scale = max(duration, 1e-12)
        fit = np.polynomial.polynomial.polyfit(time / scale, track.position, degree)
        rows = fit / scale ** np.arange(degree + 1)[:, None]
        aperture = duration
        if np.isfinite(radar.half_aperture):
            middle = track.center_index
            speed = float(np.linalg.norm(track.velocity[middle]))
            distance = float(np.linalg.norm(radar.aim_point - track.position[middle]))
            aperture = min(duration, 2.0 * radar.half_aperture * distance / speed)
        return Collection(
            mode=radar.mode,
            look_side=radar.look_side,
            start=float(track.time[0]),
            duration=duration,
            pulse_rate=float((track.n_pulses - 1) / scale) if track.n_pulses > 1 else 0.0,
            position=tuple(tuple(float(v) for v in row) for row in rows),
            aim_point=tuple(float(v) for v in radar.aim_point),
            aperture=aperture,
            center_frequency=wave.center_frequency,
            bandwidth=wave.bandwidth,
            pulse_width=wave.pulse_width,
            sampling_rate=radar.window.sampling_rate,
        )

    @property
    def own_apertures(self) -> bool:
        """Whether every pixel was seen during a time of its own."""
        return self.aperture < self.duration * (1.0 - 1e-9)

    def facts(self) -> dict[str, object]:
        """As JSON-able facts, for an image's metadata."""
        return asdict(self)

    @staticmethod
    def read(metadata: Mapping[str, object], what: str) -> "Collection":
        """From an image's metadata.

        Raises
        ------
        DataError
            There is none: the image was focused elsewhere or by an older version.
        """
        found = metadata.get("collection")
        if not isinstance(found, Mapping):
            raise DataError(f"{what}: the image does not say how it was flown; focus its raw data again")
        rows = tuple(tuple(float(v) for v in row) for row in found["position"])
        return Collection(**{**found, "position": rows, "aim_point": tuple(found["aim_point"])})

    def states(self, time: F64) -> tuple[F64, F64]:
        """Position (m) and velocity (m/s), two (n, 3) float64, at (n,) times in s from the first pulse."""
        rows = np.asarray(self.position)
        slope = np.polynomial.polynomial.polyder(rows) if len(rows) > 1 else np.zeros((1, 3))
        values = (np.polynomial.polynomial.polyval(time, one).T for one in (rows, slope))
        position, velocity = values
        return position, velocity


__all__ = ["Collection"]
