"""Conversion of external phase histories (samples over frequency and pulse) into raw data without resampling error.

MATLAB files (version 7 or older) are read as untrusted.
"""

import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError, SarmitsubaWarning
from sarmitsuba.core.parameters import one_line
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import DEFAULT_EPOCH
from sarmitsuba.radar.validity import FARTHEST
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.image import UNCALIBRATED
from sarmitsuba.signal.raw_data import AutofocusRecords, Layer, RawData

# samples per range cell of the profiles: a gap between the band and its repetition, for interpolation
_OVERSAMPLING = 1.25
# largest deviation of the frequencies from uniform steps, in steps: times pi the phase error at the swath's ends, rad
_UNEVEN = 1e-2
# assumed speed for missing pulse times, m/s; images do not depend on it
_NOMINAL_SPEED = 100.0
# share of the unambiguous swath covered by a default image
_SWATH_SHARE = 0.7
# complex samples transformed at once
_BATCH = 1 << 22


@dataclass(frozen=True, eq=False)
class PhaseHistory:
    r"""Echoes over frequency and pulse, referred to a range per pulse (motion-compensation range).

    .. math:: F_{kn} = \sum_p a_p e^{-j 4 \pi f_{kn} (R_{pn} - r_n) / c}

    with R half the path from the transmitter over the point to the receiver.

    Parameters
    ----------
    samples : (n_frequencies, n_pulses) complex
    frequency : (n_frequencies,) or (n_frequencies, n_pulses) float64, Hz, uniform steps
    position : (n_pulses, 3) float64, m, of the antenna
    reference_range : (n_pulses,) float64, m; the r_n above
    channel : polarisation, transmit first
    source : name for messages
    receiver : (n_pulses, 3) float64, m, of a separate receiver
    time : (n_pulses,) float64, s, strictly increasing, where it is known
    records : autofocus corrections of the provider, which ``samples`` do not have
    epoch : UTC of time zero, datetime64[ns]
    """

    samples: NDArray[np.number]
    frequency: F64
    position: F64
    reference_range: F64
    channel: str
    source: str
    receiver: F64 | None = None
    time: F64 | None = None
    records: AutofocusRecords | None = None
    epoch: np.datetime64 = DEFAULT_EPOCH

    def check(self) -> None:
        """Raise a DataError for inconsistent lengths, invalid numbers and non-uniform frequencies."""
        if self.samples.ndim != 2 or min(self.samples.shape) < 2:
            raise DataError(
                f"{self.source}: fp has the shape {self.samples.shape}; at least 2 frequencies x 2 pulses are needed"
            )
        n_frequencies, n_pulses = self.samples.shape
        if self.frequency.shape not in ((n_frequencies,), self.samples.shape):
            raise DataError(
                f"{self.source}: freq has the shape {self.frequency.shape}, fp holds {n_frequencies} frequencies x "
                f"{n_pulses} pulses"
            )
        if self.position.shape != (n_pulses, 3) or self.reference_range.shape != (n_pulses,):
            raise DataError(
                f"{self.source}: {self.position.shape[0]} positions and {self.reference_range.size} ranges r0 for "
                f"{n_pulses} pulses in fp"
            )
        bad = ~(
            np.isfinite(self.samples).all(axis=0)
            & np.isfinite(self.position).all(axis=1)
            & np.isfinite(self.reference_range)
        )
        if self.receiver is not None:
            bad |= ~np.isfinite(self.receiver).all(axis=1)
        if bad.any():
            raise DataError(
                f"{self.source}: {int(bad.sum())} of {n_pulses} pulses hold NaN or infinite numbers, the first is "
                f"pulse {int(np.flatnonzero(bad)[0])}; leave them out of fp, x, y, z and r0"
            )
        self._check_frequency()
        if not (self.reference_range > 0.0).all():
            raise DataError(f"{self.source}: r0 must be above 0 m at every pulse")
        places = [one for one in (self.position, self.receiver, self.reference_range) if one is not None]
        farthest = max(float(np.abs(one).max()) for one in places)
        if farthest > FARTHEST:
            raise DataError(
                f"{self.source}: positions or ranges r0 reach {farthest:g} m; at most {FARTHEST:g} m are possible"
            )

    def _check_frequency(self) -> None:
        f = self.frequency if self.frequency.ndim == 2 else self.frequency[:, None]
        if not (np.isfinite(f).all() and f.min() > 0.0):
            raise DataError(f"{self.source}: freq must be finite and above 0 Hz")
        step = (f[-1] - f[0]) / (f.shape[0] - 1)
        line = f[0] + step * np.arange(f.shape[0])[:, None]
        if not step.min() > 0.0:
            raise DataError(f"{self.source}: freq must increase from the first sample of a pulse to the last")
        uneven = max(float(np.abs(f - line).max()), float(np.ptp(step)) * (f.shape[0] - 1))
        if uneven > _UNEVEN * step.min():
            raise DataError(
                f"{self.source}: freq is off uniform steps of {step.mean():.6g} Hz by {uneven:.3g} Hz; resample fp to "
                "uniform steps, the same for every pulse"
            )


def join_parts(parts: Sequence[PhaseHistory]) -> PhaseHistory:
    """Concatenate phase histories along the track.

    Raises
    ------
    DataError
        They have different numbers of frequencies or different frequency steps.
    """
    first = parts[0]
    for part in parts:
        part.check()
        if part.samples.shape[0] != first.samples.shape[0]:
            raise DataError(
                f"{part.source}: {part.samples.shape[0]} frequencies, {first.source} has {first.samples.shape[0]}; "
                "focus them separately"
            )
    if len(parts) == 1:
        return first
    apart = [p.receiver for p in parts if p.receiver is not None]
    if apart and len(apart) < len(parts):
        raise DataError(
            f"{first.source} ... {parts[-1].source}: bistatic and monostatic files are mixed; focus them separately"
        )
    same = all(p.frequency.ndim == 1 and np.array_equal(p.frequency, first.frequency) for p in parts)
    records = [part.records for part in parts if part.records is not None]
    if records and len(records) < len(parts):
        bare = next(part for part in parts if part.records is None)
        raise DataError(
            f"{bare.source}: has no autofocus records (data.af), other files have; focus them separately"
        )
    frequency = (
        first.frequency
        if same
        else np.concatenate([np.broadcast_to(p.frequency.T, p.samples.shape[::-1]) for p in parts]).T
    )
    whole = replace(
        first,
        samples=np.concatenate([p.samples for p in parts], axis=1),
        frequency=frequency,
        position=np.concatenate([p.position for p in parts]),
        reference_range=np.concatenate([p.reference_range for p in parts]),
        source=f"{first.source} ... {parts[-1].source}",
        receiver=np.concatenate(apart) if apart else None,
        time=None,
        records=AutofocusRecords(
            np.concatenate([one.range_correction for one in records]),
            np.concatenate([one.phase_correction for one in records]),
        )
        if records
        else None,
    )
    whole.check()
    return whole


def raw_of(histories: Sequence[PhaseHistory]) -> RawData:
    r"""Raw data of phase histories, one per polarisation.

    Every pulse becomes a range profile that starts at :math:`r_n - P / 2`, with the unambiguous swath
    :math:`P = c / (2 \Delta f)`, so that an inverse transform on whole samples is exact for any r_n:

    .. math:: s_n(r) = \frac{K}{r_n^2} e^{-j 4 \pi f_c r_n / c} \frac{1}{N}
              \sum_k F_{kn} e^{j 4 \pi (f_{kn} - f_c) (r - r_n) / c}

    Parameters
    ----------
    histories : of different channels, same pulses

    Returns
    -------
    RawData, range compressed, with isotropic antennas, that of the longer track first; a focused pixel has the
    amplitude of F, so that |pixel|^2 is in m^2 only if |F|^2 is (:func:`sarmitsuba.signal.image.calibrate`)

    Raises
    ------
    DataError
        The numbers are inconsistent, or the pulses are not in the order of flight.

    Notes
    -----
    Ignores the antenna pattern. Echoes from beyond the unambiguous swath are aliased in the data. Missing pulse times
    are replaced by nominal ones. The spreading loss R^2 is taken at r_n, for two antennas at the reference point of the
    ranges.
    """
    for history in histories:
        history.check()
    first = histories[0]
    for other in histories[1:]:
        if other.position.shape != first.position.shape or not (
            np.array_equal(other.position, first.position)
            and _same(other.receiver, first.receiver)
            and np.array_equal(other.reference_range, first.reference_range)
            and np.array_equal(other.frequency, first.frequency)
        ):
            raise DataError(
                f"{other.source}: pulses or frequencies differ from those of {first.source}; focus them separately"
            )
    histories = [_leading(history) for history in histories]
    first = histories[0]
    _check_order(first)
    radar = _radar(first, tuple(history.channel for history in histories))
    data = np.stack([_profiles(history, radar) for history in histories])
    swath = radar.window.extent
    aim = radar.aim_point
    request = ImageRequest(
        grid="ground",
        center_x=float(aim[0]),
        center_y=float(aim[1]),
        height=float(aim[2]),
        extent_azimuth=_SWATH_SHARE * swath,
        extent_range=_SWATH_SHARE * swath,
    )
    facts = {"source": first.source, "unambiguous_swath_m": swath, **UNCALIBRATED}
    return RawData(
        data,
        tuple(Layer(history.channel) for history in histories),
        "compressed",
        radar,
        facts,
        request,
        autofocus_records={one.channel: one.records for one in histories if one.records is not None},
    )


def _same(one: F64 | None, other: F64 | None) -> bool:
    """Whether two histories have the same receiver, or both are monostatic."""
    return one is other if one is None or other is None else np.array_equal(one, other)


def _leading(history: PhaseHistory) -> PhaseHistory:
    """Phase history with the antenna of the longer track first; ranges are reciprocal."""
    if history.receiver is None:
        return history
    lengths = [
        float(np.linalg.norm(np.diff(at, axis=0), axis=1).sum())
        for at in (history.position, history.receiver)
    ]
    if lengths[0] >= lengths[1]:
        return history
    return replace(history, position=history.receiver, receiver=history.position)


def _check_order(history: PhaseHistory) -> None:
    """Raise a DataError where the antenna reverses or does not move from one pulse to the next."""
    step = np.diff(history.position, axis=0)
    still = np.flatnonzero(np.linalg.norm(step, axis=1) == 0.0)
    if still.size:
        raise DataError(
            f"{history.source}: pulses {still[0]} and {still[0] + 1} have the same position; leave one of them out"
        )
    back = np.flatnonzero(np.einsum("ij,ij->i", step[:-1], step[1:]) < 0.0)
    if back.size:
        raise DataError(
            f"{history.source}: the track reverses at {back.size} of {len(step)} steps, first at pulse "
            f"{back[0] + 1}; sort the pulses in the order of flight, or focus passes separately"
        )


def _radar(history: PhaseHistory, channels: tuple[str, ...]) -> Radar:
    """Radar implied by the data: isotropic antenna, boresight on the reference point of the ranges."""
    n_frequencies = history.samples.shape[0]
    step, center, bandwidth = _band(history)
    swath = SPEED_OF_LIGHT / (2.0 * step)
    n_samples = int(scipy.fft.next_fast_len(int(np.ceil(_OVERSAMPLING * bandwidth / step))))
    n_samples = max(n_samples, n_frequencies)
    time = history.time
    if time is None:
        path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(history.position, axis=0), axis=1))])
        time = path / _NOMINAL_SPEED
    track = Track.from_samples(time, history.position, history.epoch)
    aim = _aim_point(history, swath)
    to_aim = (aim - track.center_position) * np.array([1.0, 1.0, 0.0])
    right = np.array([track.along[1], -track.along[0], 0.0])
    side = "right" if float(to_aim @ right) >= 0.0 else "left"
    across = right if side == "right" else -right
    return Radar(
        mode="spotlight",
        track=track,
        # the pulse is compressed: its width affects noise only
        waveform=Waveform(center, bandwidth, 1.0 / step),
        antenna=Antenna(),
        pointing=MODES["spotlight"].pointing(
            track, AimGeometry(aim, track.center_position, track.along, across)
        ),
        window=ReceiveWindow(
            history.reference_range - (n_samples // 2) * swath / n_samples, swath / n_samples, n_samples
        ),
        channels=channels,
        look_side="right" if side == "right" else "left",
        aim_point=aim,
        receiver=None
        if history.receiver is None
        else Track.from_samples(time, history.receiver, history.epoch),
    )


def _band(history: PhaseHistory) -> tuple[float, float, float]:
    """Frequency step, and centre and width of the band of all pulses, Hz."""
    f = history.frequency if history.frequency.ndim == 2 else history.frequency[:, None]
    step = float(np.mean((f[-1] - f[0]) / (f.shape[0] - 1)))
    return step, 0.5 * float(f.min() + f.max()), float(f.max() - f.min()) + step


def _aim_point(history: PhaseHistory, swath: float) -> F64:
    """Point at height 0 whose distances are the reference ranges: the origin, else the best fit."""
    wanted = history.reference_range
    antennas = [one for one in (history.position, history.receiver) if one is not None]

    def miss(place: F64) -> F64:
        point = np.array([place[0], place[1], 0.0])
        legs = [np.linalg.norm(position - point, axis=1) for position in antennas]
        return np.asarray(sum(legs) / len(legs) - wanted)

    if float(np.abs(miss(np.zeros(2))).max()) < 0.01 * swath:
        return np.zeros(3)
    scale = float(np.median(wanted))
    found = scipy.optimize.least_squares(
        miss, np.zeros(2), x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-14
    ).x
    if float(np.abs(miss(found)).max()) > 0.5 * swath:
        warnings.warn(
            f"{history.source}: no point at height 0 lies at the distances r0 (they are off by up to "
            f"{float(np.abs(miss(found)).max()):.3g} m); give the image's centre, --center, and --height",
            SarmitsubaWarning,
            stacklevel=2,
        )
    return np.array([found[0], found[1], 0.0])


def _profiles(history: PhaseHistory, radar: Radar) -> C64:
    """(n_pulses, n_samples) complex64 range profiles, see :func:`raw_of`."""
    n_frequencies, n_pulses = history.samples.shape
    window, center = radar.window, radar.waveform.center_frequency
    n = window.n_samples
    offset = window.sample_spacing * (np.arange(n) - n // 2)  # r - r_n
    start = history.frequency[0] if history.frequency.ndim == 2 else history.frequency[:1]
    start = np.broadcast_to(start, (n_pulses,)) - center
    wave = 4.0 * np.pi / SPEED_OF_LIGHT
    reference = history.reference_range
    spread = reference**2
    if history.receiver is not None:
        legs = [np.linalg.norm(radar.aim_point - at, axis=1) for at in (history.position, history.receiver)]
        spread = legs[0] * legs[1]
    level = radar.amplitude_constant / (spread * n_frequencies)
    data = np.empty((n_pulses, n), dtype=np.complex64)
    size = max(1, _BATCH // n)
    for first in range(0, n_pulses, size):
        pick = slice(first, first + size)
        line = scipy.fft.ifft(history.samples[:, pick].T, n=n, axis=1, workers=-1) * n
        line = np.roll(line, n // 2, axis=1) * np.exp(1j * wave * np.outer(start[pick], offset))
        turn = level[pick] * np.exp(-1j * wave * center * reference[pick])
        data[pick] = line * turn[:, None]
    return data


def load_mat(path: Path, names: Sequence[str] | None = None) -> dict[str, Any]:
    """Variables of these names, or all.

    Raises
    ------
    DataError
        The file has another version or is damaged.
    """
    try:
        found: dict[str, Any] = scipy.io.loadmat(path, variable_names=names)
    except NotImplementedError as error:
        raise DataError(f"{path}: has MATLAB version 7.3; save it in MATLAB with -v7") from error
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        LookupError,
        MemoryError,
        NameError,
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
        zlib.error,
        scipy.io.matlab.MatReadError,
    ) as error:  # exceptions of loadmat for damaged files
        reason = one_line(error, 300)
        raise DataError(
            f"{path}: cannot be read as a MATLAB file, it may be damaged: {reason or type(error).__name__}"
        ) from error
    return found
