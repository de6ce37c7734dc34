"""The whole radar: track, waveform, antenna, polarisation, power and receive window."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.interference import Emitters
from sarmitsuba.radar.mode import MODES, RadarMode
from sarmitsuba.radar.receive_chain import ReceiveChain
from sarmitsuba.radar.track import Track, effective_velocity_ratio, numbers_of
from sarmitsuba.radar.utc import utc_after
from sarmitsuba.radar.waveform import Waveform


@dataclass(frozen=True, eq=False)
class ReceiveWindow:
    """Fast-time window of the receiver in one-way slant range, the same number of samples for every pulse.

    Parameters
    ----------
    start_range : (n_pulses,) float64, m; slant range of the first sample of each pulse (range compressed)
    sample_spacing : slant-range spacing of the samples, m: c / (2 sampling_rate); at most the range cell
    n_samples : samples per pulse of a range-compressed profile
    """

    start_range: F64
    sample_spacing: float
    n_samples: int

    @property
    def sampling_rate(self) -> float:
        """Complex sampling rate, Hz."""
        return SPEED_OF_LIGHT / (2.0 * self.sample_spacing)

    @property
    def extent(self) -> float:
        """Length of the window in slant range, m."""
        return self.n_samples * self.sample_spacing


@dataclass(frozen=True)
class Burst:
    """Place of a burst among the others, in the modes that have them.

    Parameters
    ----------
    sub_swath, sub_swaths : its sub-swath, and all, in the order of their bursts
    number : 0 about the aim point
    middle : s, time of its middle; zero is when the aim point is at zero Doppler
    cycle : s, from a burst to the next of the same sub-swath
    steering_rate : rad/s, turn of the beam, positive forward
    """

    sub_swath: str
    sub_swaths: tuple[str, ...]
    number: int
    middle: float
    cycle: float
    steering_rate: float


@dataclass(frozen=True, eq=False)
class Radar:
    """The sensor with all parameters for simulation and focusing.

    Parameters
    ----------
    mode : name of the beam steering, one of `sarmitsuba.radar.mode.MODES`
    track, waveform, antenna, pointing, window : see their classes
    channels : polarisation channels, transmit letter first, such as ``HV``, see :mod:`sarmitsuba.radar.polarisation`
    look_side : ``left`` or ``right`` of the flight direction
    aim_point : (3,) float64, m, scene frame; reference point of the geometry
    transmit_power : W
    noise_temperature : K; 0 adds no receiver noise
    losses : two-way system losses, linear power >= 1
    half_aperture : half the synthetic aperture of every pixel, in sines: pulses serve a pixel while the sine of its
        direction along the flight is within this of the boresight's; infinite: all pulses serve every pixel
    offset : (3,) float64, m; positions in the frame of the user's file are those here + offset
    recorded : track that the focuser uses, where it differs from ``track``, which is flown
    recorded_pointing : pointing that the focuser uses, where it differs from ``pointing``, the true one
    receiver : where the echoes are received elsewhere (bistatic data), where the receiver is when the echo of each
        pulse arrives, with the pulse times of ``track``, the transmitter's; slant range is half the path from there
        over the point to the receiver (so that both may change places)
    receiver_pointing : of the receiver's antenna, which has the transmitter's pattern; None: as ``pointing``
    delay : (n_pulses,) float64, s, from transmission to reception, where antennas move on meanwhile: ``receiver`` then
        has the positions after that delay; None: start-stop, antennas at rest during a pulse
    anchor : place on the Earth of the origin of the frame of the user's file
    burst : that the pulses are; None for modes without bursts
    chain : receive chain; None for an ideal one
    emitters : of interference; None without
    """

    mode: str
    track: Track
    waveform: Waveform
    antenna: Antenna
    pointing: Pointing
    window: ReceiveWindow
    channels: tuple[str, ...] = ("VV",)
    look_side: Literal["left", "right"] = "right"
    aim_point: F64 = field(default_factory=lambda: np.zeros(3))
    transmit_power: float = 1.0
    noise_temperature: float = 0.0
    losses: float = 1.0
    half_aperture: float = np.inf
    offset: F64 = field(default_factory=lambda: np.zeros(3))
    recorded: Track | None = None
    recorded_pointing: Pointing | None = None
    receiver: Track | None = None
    receiver_pointing: Pointing | None = None
    delay: F64 | None = None
    anchor: Anchor = field(default_factory=Anchor)
    burst: Burst | None = None
    chain: ReceiveChain | None = None
    emitters: Emitters | None = None

    def __post_init__(self) -> None:
        if self.receiver is not None and self.receiver.n_pulses != self.track.n_pulses:
            raise RadarError(
                f"radar: {self.receiver.n_pulses} positions of the receiver and {self.track.n_pulses} of the "
                "transmitter do not match"
            )
        if self.receiver is None and self.receiver_pointing is not None:
            raise RadarError("radar: receiver_pointing without a receiver; give its track or leave it out")
        if self.delay is not None and (self.receiver is None or self.delay.shape != self.track.time.shape):
            raise RadarError("radar: delay is that of the receiver's track, one for each pulse; give both")

    def __repr__(self) -> str:
        wave = f"{self.waveform.center_frequency / 1e9:.4g} GHz, {self.waveform.bandwidth / 1e6:.4g} MHz"
        distance = float(np.linalg.norm(self.aim_point - self.track.center_position))
        return (
            f"Radar({self.mode}: {wave}, {'/'.join(self.channels)}, {self.track.n_pulses} pulses from "
            f"{distance:.5g} m, look {self.look_side})"
        )

    @property
    def received(self) -> tuple[str, ...]:
        """Names of what changes echoes beside thermal noise; none with an ideal receiver and without emitters."""
        given = () if self.chain is None else self.chain.given
        return given if self.emitters is None else (*given, "interference_file")

    @property
    def mode_law(self) -> RadarMode:
        """The registered mode.

        Raises
        ------
        ExtensionError
            The radar came from a file and its mode is defined by a module that is not loaded.
        """
        return MODES[self.mode]

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Tracks of all antennas: the transmitter's, and that of a separate receiver."""
        return (self.track,) if self.receiver is None else (self.track, self.receiver)

    @property
    def pointings(self) -> tuple[Pointing, ...]:
        """Pointings of all antennas, as ``tracks``."""
        return (
            (self.pointing,)
            if self.receiver is None
            else (self.pointing, self.receiver_pointing or self.pointing)
        )

    @property
    def times(self) -> tuple[F64, ...]:
        """Times (n_pulses,), s, at which each antenna of ``tracks`` is there: reception may be later than the pulse."""
        time = self.track.time
        return (time, time if self.delay is None else time + self.delay)[: len(self.tracks)]

    def displaced(self, *offsets: F64) -> "Radar":
        """Radar with the antennas of ``tracks`` displaced by (n_pulses, 3) or (3,), m, each; velocities stay."""
        moved = [
            replace(track, position=track.position + offset)
            for track, offset in zip(self.tracks, offsets, strict=True)
        ]
        return replace(self, track=moved[0], receiver=moved[1] if len(moved) > 1 else None)

    def slant_range(self, point: F64, pulses: slice = slice(None)) -> F64:
        """Half the path from the transmitter over a point (3,), m, scene frame, to the receiver: (n_pulses,) m."""
        legs = [np.linalg.norm(point - track.position[pulses], axis=-1) for track in self.tracks]
        return np.asarray(legs[0] if len(legs) == 1 else 0.5 * (legs[0] + legs[1]))

    @property
    def footprint_speed(self) -> float:
        r"""Speed of the footprint at the aim point over the antenna's: 1 for a beam fixed to the track, 0 in spotlight.

        .. math:: A = \left(1 - \frac{d s_{boresight}}{d s_{aim}}\right) \frac{V_{eff}^2}{V^2}

        over the sines s along the flight, about mid-aperture, and the effective velocity, V on a straight track. From
        an orbit it is about 0.9 for a beam fixed to the satellite. 1 for one pulse. The beam is the nominal one,
        without pointing errors.
        """
        i, n = self.track.center_index, self.track.n_pulses
        pick = np.array([max(i - 1, 0), min(i + 1, n - 1)])
        speed = np.linalg.norm(self.track.velocity[pick], axis=1)[:, None]
        if n < 2 or not speed.all():
            return 1.0
        forward = self.track.velocity[pick] / speed
        line = self.aim_point - self.track.position[pick]
        aim = np.sum(line * forward, axis=1) / np.linalg.norm(line, axis=1)
        told = self.recorded_pointing or self.pointing
        boresight = np.sum(told.boresight[pick] * forward, axis=1)
        held = 1.0 - float(boresight[1] - boresight[0]) / float(aim[1] - aim[0])
        return held * effective_velocity_ratio(self.track, self.aim_point, i)

    @property
    def all_round(self) -> bool:
        """Whether the aim point is seen from opposite sides, so that an image has no single range axis or look."""
        line = (self.aim_point - self.track.position)[:, :2]
        return bool((line @ line[self.track.center_index] < 0.0).any())

    @property
    def half_turn(self) -> float:
        r"""Half the rotation of the line of sight over the aperture of a pixel at the aim point, in sines.

        :math:`s_t = s_a / A` with ``half_aperture`` and ``footprint_speed``: the azimuth resolution is
        :math:`\lambda / 4 s_t`. Infinite where all pulses serve every pixel.
        """
        return self.half_aperture / self.footprint_speed if np.isfinite(self.half_aperture) else np.inf

    def range_rate(self, point: F64, pulses: slice = slice(None)) -> F64:
        """Range rate of a point (3,), m, scene frame, at rest: (n_pulses,) m/s."""
        rates = []
        for track in self.tracks:
            leg = track.position[pulses] - point
            rates.append(np.einsum("ni,ni->n", leg, track.velocity[pulses]) / np.linalg.norm(leg, axis=1))
        return np.asarray(rates[0] if len(rates) == 1 else 0.5 * (rates[0] + rates[1]))

    @property
    def range_per_rate(self) -> float:
        r"""Range-Doppler coupling: range shift of echoes over their range rate, :math:`f_c T_p / B`, s.

        Negative for a down-chirp, 0 for the start-stop approximation.
        """
        if self.delay is None:
            return 0.0
        wave = self.waveform
        if wave.code:
            return wave.center_frequency / wave.chirp_rate
        sign = 1.0 if wave.sweep == "up" else -1.0
        return sign * wave.center_frequency * wave.pulse_width / wave.bandwidth

    @property
    def receives_itself(self) -> bool:
        """Whether the receiver is the transmitting antenna at the later time of reception."""
        return self.delay is not None and self.receiver_pointing is None

    def start_stop(self) -> "Radar":
        r"""Equivalent start-stop radar: at rest during a pulse, with nearly the same echoes.

        Its antenna is halfway between transmission and reception, and so is its UTC at mid-aperture. Slant ranges are
        those of both places to
        :math:`b^2 \cos^2\psi / 8 R`, for a path b meanwhile and a squint psi, the same for all that is seen. Its
        receive window begins nearer by the range-Doppler shift of an echo from the boresight. A start-stop radar is
        returned unchanged; separate antennas stay separate.

        Notes
        -----
        Ignores that echoes from elsewhere in the beam appear shifted by up to :math:`\kappa v s`, for the sine s of
        their angle off the boresight along the flight; over an aperture this blurs echoes in range without a shift.
        """
        if self.delay is None or self.receiver is None:
            return self
        sent, back = self.track, self.receiver
        rate = -np.einsum("ni,ni->n", sent.velocity, self.pointing.boresight)
        window = replace(self.window, start_range=self.window.start_range - self.range_per_rate * rate)
        if not self.receives_itself:
            return replace(self, window=window, delay=None)
        middle = Track(
            sent.time,
            0.5 * (sent.position + back.position),
            0.5 * (sent.velocity + back.velocity),
            utc_after(sent.epoch, 0.5 * float(self.delay[sent.center_index])),
        )
        return replace(self, track=middle, window=window, receiver=None, delay=None)

    @property
    def amplitude_constant(self) -> float:
        r"""Received amplitude of ``sqrt(rcs) / R^2``, sqrt(W) m.

        .. math:: K = \sqrt{P_t G^2 \lambda^2 / ((4 \pi)^3 L)}
        """
        lam = self.waveform.wavelength
        return float(
            np.sqrt(self.transmit_power / self.losses) * self.antenna.gain * lam / (4.0 * np.pi) ** 1.5
        )

    @property
    def across(self) -> F64:
        """Horizontal unit vector perpendicular to the flight direction, on the look side."""
        a = self.track.along
        right = np.array([a[1], -a[0], 0.0])
        return right if self.look_side == "right" else -right

    def of_pulses(self, pulses: slice | ArrayLike) -> "Radar":
        """Radar of selected pulses: a slice, pulse numbers or a mask.

        Raises
        ------
        RadarError : no pulse is left, or the pulses do not follow each other in time
        """
        pick = numbers_of(pulses, self.track.n_pulses)
        return replace(
            self,
            track=self.track.of_pulses(pick),
            recorded=self.recorded and self.recorded.of_pulses(pick),
            receiver=self.receiver and self.receiver.of_pulses(pick),
            pointing=self.pointing.of_pulses(pick),
            recorded_pointing=self.recorded_pointing and self.recorded_pointing.of_pulses(pick),
            receiver_pointing=self.receiver_pointing and self.receiver_pointing.of_pulses(pick),
            delay=None if self.delay is None else self.delay[pick],
            window=replace(self.window, start_range=self.window.start_range[pick]),
        )

    def as_recorded(self) -> "Radar":
        """Radar with the recorded track and pointing, which the focuser uses; the receive window is unchanged.

        Notes
        -----
        A separate receiver has the transmitter's position errors: the baseline between the two is known.
        """
        if self.recorded is None and self.recorded_pointing is None:
            return self
        receiver = self.receiver
        if receiver is not None and self.recorded is not None:
            error = self.recorded.position - self.track.position
            drift = self.recorded.velocity - self.track.velocity
            receiver = replace(
                self.recorded, position=receiver.position + error, velocity=receiver.velocity + drift
            )
        return replace(
            self,
            track=self.recorded or self.track,
            recorded=None,
            pointing=self.recorded_pointing or self.pointing,
            recorded_pointing=None,
            receiver=receiver,
        )

    def in_file_frame(self) -> "Radar":
        """Radar with positions in the frame of the user's file."""
        if not self.offset.any():
            return self
        track, recorded, receiver = (
            None if one is None else replace(one, position=one.position + self.offset)
            for one in (self.track, self.recorded, self.receiver)
        )
        assert track is not None
        return replace(
            self,
            track=track,
            recorded=recorded,
            receiver=receiver,
            aim_point=self.aim_point + self.offset,
            offset=np.zeros(3),
            emitters=None if self.emitters is None else self.emitters.moved(self.offset),
        )
