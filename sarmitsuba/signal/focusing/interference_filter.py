"""Filters against interference, applied to range-compressed echoes before focusing, with what they cost the image.

A filter removes samples of a spectrum, and with them the part of every echo that lies there. What is left of a point's
echo is measured with points all over the window, and all echoes are divided by it: levels stay those of the scene.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.core.registry import Registry
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.focusing.focuser import WithOptions, option, parse_optional
from sarmitsuba.signal.focusing.range_compression import RangeCompression
from sarmitsuba.signal.raw_data import Layer, RawData

# pulses of which the cost of a filter is measured, distributed over the track
_MEASURED = 64
# part of the power of a sample's neighbourhood that is masked with it: leakage of the window of a transform
_BESIDE = 1
# mean power over the largest above which a cell of time and frequency is lit
_LIT = 0.1
# share of a spectrum above which nothing of the image is left
_MOST_REMOVED = 0.9


@dataclass(frozen=True)
class InterferenceFilter(WithOptions, ABC):
    """Filter: a frozen dataclass whose fields are its options; registered in ``INTERFERENCE_FILTERS``.

    Attributes
    ----------
    name : in commands and calls
    title : purpose in one line
    """

    kind: ClassVar[str] = "interference filter"
    name: ClassVar[str]
    title: ClassVar[str]

    @abstractmethod
    def clean(self, raw: RawData) -> tuple[RawData, float]:
        """Range-compressed data of one channel, without interference, and the removed share of the spectrum.

        The first layer decides what is removed; the others lose the same.
        """


INTERFERENCE_FILTERS: Registry[InterferenceFilter] = Registry("interference filter", InterferenceFilter)


@dataclass(frozen=True)
class Notch(InterferenceFilter):
    """Frequencies at which the mean power over all pulses is far above that of the band are removed."""

    name: ClassVar[str] = "notch"
    title: ClassVar[str] = (
        "narrow-band interference that lasts: removes frequencies of the band for all pulses"
    )

    threshold: float = option(8.0, "power over the median of the band, dB", within=(3.0, 60.0))

    def clean(self, raw: RawData) -> tuple[RawData, float]:
        """See the class."""
        n = raw.data.shape[2]
        spectrum = scipy.fft.fft(raw.data, axis=2, workers=-1)
        power = np.square(np.abs(spectrum[0])).mean(axis=0, dtype=np.float64)
        inside = _band(raw.radar, n)
        removed = inside & (power > power_from_db(self.threshold) * np.median(power[inside]))
        removed = scipy.ndimage.binary_dilation(
            np.fft.fftshift(removed), iterations=_BESIDE
        ) & np.fft.fftshift(inside)
        removed = np.fft.ifftshift(removed) if removed.any() else np.zeros(n, dtype=bool)
        spectrum[:, :, removed] = 0.0
        data = scipy.fft.ifft(spectrum, axis=2, workers=-1).astype(np.complex64)
        return replace(raw, data=data), float(removed.sum() / inside.sum())


@dataclass(frozen=True)
class TimeFrequency(InterferenceFilter):
    """Cells of every pulse's short-time spectrum far above the median of the pulse are removed, in chirped echoes."""

    name: ClassVar[str] = "time_frequency"
    title: ClassVar[str] = (
        "pulsed and chirped interference: removes cells of time and frequency, pulse by pulse"
    )

    threshold: float = option(12.0, "power over the median of a pulse, dB", within=(3.0, 60.0))
    length: int = option(64, "samples of a short-time spectrum", within=(8, 4096))

    def clean(self, raw: RawData) -> tuple[RawData, float]:
        """See the class."""
        if raw.radar.waveform.code:
            raise DataError(
                f"interference filter {self.name}: it needs a linear chirp, and the waveform is "
                f"{one_line(raw.radar.waveform.code)}; take notch"
            )
        chirped = to_chirped(raw).data
        n_pulses, n = chirped.shape[1:]
        lit, usual = self._lit_cells(raw.radar)
        taken = np.zeros((len(chirped), n_pulses, (len(lit) + 1) * self._hop), dtype=np.complex64)
        lost = 0.0
        for pulse in range(n_pulses):
            spectrum = self._spectra(chirped[:, pulse])
            power = np.square(np.abs(spectrum[0])) / usual
            removed = lit & (power > power_from_db(self.threshold) * np.median(power[lit]))
            lost += float(removed.sum() / lit.sum())
            spectrum[:, ~removed] = 0.0
            pieces = scipy.fft.ifft(spectrum, axis=2) * self._window
            for i in range(len(lit)):
                taken[:, pulse, i * self._hop : (i + 2) * self._hop] += pieces[:, i]
        taken = np.ascontiguousarray(taken[:, :, self._hop : self._hop + n])
        change = RangeCompression(raw.radar, "flat").forward(taken)
        return replace(raw, data=raw.data - change), lost / n_pulses

    @property
    def _hop(self) -> int:
        return self.length // 2

    @property
    def _window(self) -> F32:
        """Sine over two hops: its square is one together with that of the next piece, one hop later."""
        return np.sin(np.pi * (np.arange(2 * self._hop) + 0.5) / (2 * self._hop)).astype(np.float32)

    def _spectra(self, lines: C64) -> C64:
        """Short-time spectra (k, n_pieces, 2 hop) of chirped lines (k, n)."""
        hop, n = self._hop, lines.shape[1]
        n_pieces = -(-n // hop) + 1
        padded = np.zeros((len(lines), (n_pieces + 1) * hop), dtype=np.complex64)
        padded[:, hop : hop + n] = lines
        cut = np.lib.stride_tricks.sliding_window_view(padded, 2 * hop, axis=1)[:, ::hop]
        return np.asarray(scipy.fft.fft(cut * self._window, axis=2))

    def _lit_cells(self, radar: Radar) -> tuple[NDArray[np.bool_], F64]:
        """Cells (n_pieces, 2 hop) that echoes from the receive window reach, and the mean power of clutter there.

        Chirps from one window fill a diagonal band of the plane; what lies beside it is cut off by compression.
        """
        few = radar.of_pulses(slice(0, _MEASURED))
        shape = (1, few.track.n_pulses, few.window.n_samples, 2)
        drawn = np.random.default_rng(0).standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]
        spectra = self._spectra(to_chirped(RawData(drawn, (Layer("probe"),), "compressed", few)).data[0])
        usual = np.square(np.abs(spectra)).mean(axis=0, dtype=np.float64)
        lit = usual > _LIT * usual.max()
        return lit, np.where(lit, usual, usual.max())


INTERFERENCE_FILTERS.register(Notch())
INTERFERENCE_FILTERS.register(TimeFrequency())


def parse_interference_filter(text: str | InterferenceFilter | None) -> InterferenceFilter | None:
    """Read a filter from its name and options; see :func:`sarmitsuba.signal.focusing.focuser.parse_optional`."""
    return parse_optional(text, INTERFERENCE_FILTERS)


def filter_interference(raw: RawData, method: InterferenceFilter) -> tuple[RawData, dict[str, object]]:
    """Range-compressed data without interference, at the level of the scene, and the filter's cost.

    What is removed is found for every channel apart.

    Returns
    -------
    data, and facts of the worst channel: ``removed_share`` of the spectrum, ``snr_loss_db`` of a point in noise, and
    ``islr_added_db``, energy of the point's echo that the filter spreads, over that of its peak

    Raises
    ------
    DataError
        The filter removes nearly everything.
    """
    radar, data = raw.radar, np.empty_like(raw.data)
    shares, gains, lobes = [], [], []
    probe = _probe(radar)
    for channel in raw.channels:
        own = [i for i, layer in enumerate(raw.layers) if layer.channel == channel]
        total = raw.data[own].sum(axis=0, dtype=np.complex64)
        layers = (Layer(channel), *(raw.layers[i] for i in own), Layer("probe"))
        stack = np.concatenate([total[None], raw.data[own], probe[None]])
        found, share = method.clean(replace(raw, data=stack, layers=layers))
        pick = np.linspace(0, len(probe) - 1, min(_MEASURED, len(probe))).astype(int)
        before, after = probe[pick], found.data[-1][pick]
        gain = complex(np.vdot(before, after) / np.vdot(before, before))
        if share > _MOST_REMOVED or abs(gain) < 1.0 - _MOST_REMOVED:
            raise DataError(
                f"interference filter {method.name}: {100.0 * share:.0f} % of the spectrum of {channel} is above the "
                "threshold; raise it"
            )
        rest = float(np.sum(np.abs(after - gain * before) ** 2) / np.sum(np.abs(gain * before) ** 2))
        data[own] = found.data[1:-1] / np.complex64(gain)
        shares.append(share)
        gains.append(abs(gain))
        lobes.append(rest)
    worst = int(np.argmin(gains))
    noise = max(1.0 - shares[worst], 1e-9)
    facts: dict[str, object] = {
        "method": method.name,
        **method.options,
        "removed_share": max(shares),
        "snr_loss_db": float(db_from_power(noise / gains[worst] ** 2)),
        "islr_added_db": float(db_from_power(max(max(lobes), 1e-12))),
    }
    return replace(raw, data=data), facts


def _band(radar: Radar, n: int) -> NDArray[np.bool_]:
    """Samples (n,) of a transform within the band."""
    half = 0.5 * radar.waveform.bandwidth / radar.window.sampling_rate
    return np.asarray(np.abs(scipy.fft.fftfreq(n)) <= half)


def _probe(radar: Radar) -> C64:
    """Compressed echoes (n_pulses, n_samples) of amplitude 1, in every pulse of a point elsewhere in the window."""
    n = radar.window.n_samples
    place = np.random.default_rng(0).uniform(0.1 * n, 0.9 * n, (radar.track.n_pulses, 1))
    offset = (np.arange(n) - place) * radar.window.sample_spacing
    return np.asarray(np.sinc(offset / radar.waveform.range_cell), dtype=np.complex64)
