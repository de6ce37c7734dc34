"""Receive chain of a radar: distortion of polarisations, oscillator, gain, quadrature demodulator, converter, coding.

These are its numbers; :mod:`sarmitsuba.signal.receive` applies them to echoes.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.core.units import power_from_db
from sarmitsuba.radar.description import RadarInput

# aliases of the phase noise that are summed one by one; the spectrum beyond is taken as white in slow time
_FOLDS = 64
_QUADRATURE = 4096  # points of integrals over the spectrum
# parameters that act only beside another one, and the values of it that they need
_BESIDE = {
    "baq_bits": ("raw_coding", ("baq",)),
    "baq_block": ("raw_coding", ("baq", "fdbaq")),
    "fdbaq_margin_db": ("raw_coding", ("fdbaq",)),
}


@dataclass(frozen=True)
class ReceiveChain:
    """Errors of a receiver; the defaults are those of an ideal one.

    Parameters
    ----------
    adc_bits : of the converter, for I and for Q; 0: none
    saturation_db : clipping of I and Q, over their rms; infinite: none
    raw_coding : ``none``, ``baq`` or ``fdbaq``
    baq_bits, baq_block : per I and per Q; samples of a block
    fdbaq_margin_db : least ratio of thermal to quantisation noise, where 4 bits reach it
    iq_gain_db, iq_phase_deg : gain of Q over that of I; angle of Q less 90 degrees
    iq_offset_i, iq_offset_q : constants added to I and Q, over the rms of both
    phase_noise : ``frequency:level`` in Hz and dBc/Hz, separated by commas; empty: none
    gain_drift_db, gain_jitter_db : change from the first to the last pulse; random change between pulses, rms
    dead_pulses : share of pulses that are lost
    transmit_gaps : whether the receiver is off while a pulse is transmitted
    pulse_filter : of range compression, ``flat``, ``matched`` or ``mismatched``
    transmit_distortion, receive_distortion : four complex numbers as text, see :meth:`distortion`; empty: none
    """

    adc_bits: int = 0
    saturation_db: float = float("inf")
    raw_coding: str = "none"
    baq_bits: int = 3
    baq_block: int = 128
    fdbaq_margin_db: float = 0.0
    iq_gain_db: float = 0.0
    iq_phase_deg: float = 0.0
    iq_offset_i: float = 0.0
    iq_offset_q: float = 0.0
    phase_noise: str = ""
    gain_drift_db: float = 0.0
    gain_jitter_db: float = 0.0
    dead_pulses: float = 0.0
    transmit_gaps: bool = False
    pulse_filter: str = "flat"
    transmit_distortion: str = ""
    receive_distortion: str = ""

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the parameters that change echoes; none of an ideal receiver."""
        return tuple(
            f.name for f in fields(self) if f.name not in _BESIDE and getattr(self, f.name) != f.default
        )

    @property
    def changes_samples(self) -> bool:
        """Whether anything acts on single samples of the chirped echoes, not on whole pulses."""
        quadrature = self.iq_gain_db or self.iq_phase_deg or self.iq_offset_i or self.iq_offset_q
        return bool(
            self.adc_bits
            or np.isfinite(self.saturation_db)
            or self.raw_coding != "none"
            or quadrature
            or self.transmit_gaps
            or self.pulse_filter != "flat"
        )

    @property
    def quadrature(self) -> tuple[complex, complex]:
        r"""Factors :math:`K_1, K_2` of an imbalanced demodulator, :math:`y = K_1 x + K_2 x^*`.

        .. math:: K_{1,2} = \tfrac12 (1 \pm g e^{\mp j \phi})

        for :math:`y = \mathrm{Re}\, x + j g\, \mathrm{Im}(x e^{-j \phi})`. Valkama, Renfors and Koivunen, IEEE Trans.
        Signal Processing 49 (10) 2001, eq. 2.
        """
        g = np.sqrt(power_from_db(self.iq_gain_db))
        phase = np.radians(self.iq_phase_deg)
        return complex(0.5 * (1.0 + g * np.exp(-1j * phase))), complex(0.5 * (1.0 - g * np.exp(1j * phase)))

    @cached_property
    def phase_spectrum(self) -> F64:
        """Points (n, 2) of the phase noise, Hz and dBc/Hz; (0, 2) where there is none."""
        return _spectrum_of(self.phase_noise, "phase_noise")

    def phase_density(self, frequency: F64, delay: float | None, pulse_width: float) -> F64:
        r"""One-sided spectrum of the phase of a compressed echo, rad^2/Hz.

        .. math:: S(f) = 2 L(f) \, 4 \sin^2(\pi f \tau) \, \mathrm{sinc}^2(f T_p)

        with the single-sideband noise L, straight in dB over the logarithm of f, constant below the first point and
        zero above the last. Two oscillators, of transmitter and receiver, have 2 in place of 4 sin^2.

        Parameters
        ----------
        frequency : Hz, above 0
        delay : tau, s, from transmission to reception; None: two oscillators
        pulse_width : T_p, s, over which the phase is averaged

        References
        ----------
        Krieger and Younis, IEEE GRSL 3 (3) 2006, eq. 3 to 6.
        """
        points = self.phase_spectrum
        if not points.size:
            return np.zeros_like(frequency)
        level = np.interp(np.log(frequency), np.log(points[:, 0]), points[:, 1])
        both = 2.0 if delay is None else 4.0 * np.sin(np.pi * frequency * delay) ** 2
        density = 2.0 * power_from_db(level) * both * np.sinc(frequency * pulse_width) ** 2
        return np.asarray(np.where(frequency <= points[-1, 0], density, 0.0))

    def folded_phase_density(self, n: int, prf: float, delay: float | None, pulse_width: float) -> F64:
        """Spectrum of :meth:`phase_density` sampled by pulses: (n,), rad^2/Hz, at ``prf / 2 k / n``, k = 1 ... n.

        Aliases are added; those beyond the 64th as white noise of their power.
        """
        f = 0.5 * prf * np.arange(1, n + 1) / n
        last = float(self.phase_spectrum[-1, 0]) if self.phase_spectrum.size else 0.0
        total = self.phase_density(f, delay, pulse_width)
        for m in range(1, min(_FOLDS, int(last / prf + 0.5)) + 1):
            total += self.phase_density(m * prf + f, delay, pulse_width)
            total += self.phase_density(np.maximum(m * prf - f, f[0]), delay, pulse_width)
        edge = (_FOLDS + 0.5) * prf
        if last > edge:
            total += 2.0 / prf * self._integral(edge, last, delay, pulse_width)
        return np.asarray(total)

    def phase_variance(self, lowest: float, delay: float | None, pulse_width: float) -> float:
        """Variance of the phase above the frequency ``lowest``, Hz, rad^2: the integral of :meth:`phase_density`."""
        if not self.phase_spectrum.size or lowest >= self.phase_spectrum[-1, 0]:
            return 0.0
        return self._integral(lowest, float(self.phase_spectrum[-1, 0]), delay, pulse_width)

    def _integral(self, low: float, high: float, delay: float | None, pulse_width: float) -> float:
        f = np.geomspace(low, high, _QUADRATURE)
        # sin^2 and sinc^2 turn faster than the points from some frequency on: midpoints of random place there
        shift = np.random.default_rng(0).random(f.size - 1)
        at = f[:-1] + shift * np.diff(f)
        return float(np.sum(self.phase_density(at, delay, pulse_width) * np.diff(f)))

    def distortion(self, side: str) -> C128:
        r"""Matrix (2, 2) of ``transmit`` or ``receive``, order H, V.

        .. math:: M = R S T, \quad
                  R = \begin{pmatrix} r_{HH} & r_{HV} \\ r_{VH} & r_{VV} \end{pmatrix}, \quad
                  T = \begin{pmatrix} t_{HH} & t_{HV} \\ t_{VH} & t_{VV} \end{pmatrix}

        with the scattering matrix S, received polarisation first, so that :math:`r_{VH}` is what the V channel
        receives of a wave in H, and :math:`t_{VH}` what is transmitted in V where H is meant (van Zyl, IEEE TGRS 28
        (3) 1990, eq. 1).
        """
        text = self.transmit_distortion if side == "transmit" else self.receive_distortion
        if not text:
            return np.eye(2, dtype=np.complex128)
        return np.array([complex(part.replace(" ", "")) for part in text.split(",")]).reshape(2, 2)

    @property
    def distorts(self) -> bool:
        """Whether polarisations are mixed or scaled."""
        return bool(self.transmit_distortion or self.receive_distortion)


def _spectrum_of(text: str, where: str) -> F64:
    """Points (n, 2) of ``frequency:level`` pairs, frequencies ascending."""
    if not text.strip():
        return np.zeros((0, 2))
    try:
        points = np.array([[float(x) for x in pair.split(":")] for pair in text.split(",")])
    except ValueError:
        points = np.zeros((0, 0))
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise RadarError(
            f'{where} = "{one_line(text)}" is no list of frequency:level, Hz and dBc/Hz; give for example '
            "10:-60,1000:-100"
        )
    if points[0, 0] <= 0.0 or (np.diff(points[:, 0]) <= 0.0).any() or points[:, 1].max() > 0.0:
        raise RadarError(
            f'{where} = "{one_line(text)}" needs ascending frequencies above 0 Hz and levels of at most 0 dBc/Hz'
        )
    return points


_LINEAR = frozenset("HV")
_AXES = ("along", "across", "up")


def receive_chain_of(given: RadarInput, channels: tuple[str, ...]) -> ReceiveChain | None:
    """Receive chain of a description; None for an ideal one.

    Parameters
    ----------
    given : the description
    channels : of the radar

    Raises
    ------
    RadarError
        Parameters contradict each other, have no effect, or mix polarisations that are not recorded.
    """
    s, where = given.sensor, given.where
    for name, (other, values) in _BESIDE.items():
        if name in given.sensor_given and getattr(s, other) not in values:
            raise RadarError(
                f"{where}: {name} has no effect with {other} = {getattr(s, other)}; take {other} = {values[0]} or "
                "leave it out"
            )
    names = [f.name for f in fields(ReceiveChain) if f.name not in ("saturation_db", "pulse_filter")]
    level, linear = s.saturation_db, s.pulse_form in ("up", "down")
    chain = ReceiveChain(
        saturation_db=float("inf") if level is None else level,
        pulse_filter=("flat" if linear else "matched") if s.pulse_filter == "auto" else s.pulse_filter,
        **{name: getattr(s, name) for name in names},
    )
    if not linear and chain.pulse_filter == "flat":
        raise RadarError(
            f"{where}: pulse_filter = flat divides by the spectrum of pulse_form = {s.pulse_form}, which has gaps; "
            "take matched or mismatched"
        )
    if not chain.given:
        return None
    if s.raw_coding != "none" and s.noise_temperature <= 0.0:
        raise RadarError(
            f"{where}: raw_coding = {s.raw_coding} is made for Gaussian noise in every block, and noise_temperature = "
            "0 K adds none; give noise_temperature, or leave raw_coding out"
        )
    apart = sorted(given.sensor_given & {"receiver_track_file", *(f"receiver_offset_{a}" for a in _AXES)})
    if s.transmit_gaps and apart:
        raise RadarError(
            f"{where}: transmit_gaps is of a receiver that shares its antenna with the transmitter; leave it or "
            f"{apart[0]} out"
        )
    check_chain(chain, channels, where)
    return chain


def check_chain(chain: ReceiveChain, channels: tuple[str, ...], where: str = "radar") -> None:
    """Raise a RadarError where texts of a receive chain are unreadable, or it mixes channels that are not recorded."""
    _spectrum_of(chain.phase_noise, f"{where}: phase_noise")
    for side in ("transmit", "receive"):
        _check_distortion(chain, side, channels, where)


def _check_distortion(chain: ReceiveChain, side: str, channels: tuple[str, ...], where: str) -> None:
    """Raise a RadarError for a text that is no matrix, and for a mixture of channels that are not recorded."""
    name = f"{side}_distortion"
    text = getattr(chain, name)
    if not text:
        return
    try:
        matrix = chain.distortion(side)
    except ValueError:
        matrix = np.zeros((2, 2), dtype=np.complex128)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-6:
        raise RadarError(
            f'{where}: {name} = "{one_line(text)}" is no invertible matrix of four numbers HH,HV,VH,VV; give for '
            "example 1,0.02+0.01j,0.03j,1.1"
        )
    letter = 0 if side == "transmit" else 1
    if not set(channels).issubset({a + b for a in "HVRLD" for b in "HV"}) or (
        letter == 0 and any(channel[0] not in _LINEAR for channel in channels)
    ):
        raise RadarError(
            f"{where}: {name} needs waves transmitted in H and V; the channels are {', '.join(channels)}"
        )
    others = [channel[:letter] + _swap(channel[letter]) + channel[letter + 1 :] for channel in channels]
    missing = sorted(set(others) - set(channels))
    if missing and (matrix[0, 1] or matrix[1, 0]):
        raise RadarError(
            f"{where}: {name} mixes channels with {', '.join(missing)}, which polarisation = {','.join(channels)} "
            "leaves out; add them, or give a diagonal matrix"
        )


def _swap(letter: str) -> str:
    return "V" if letter == "H" else "H"
