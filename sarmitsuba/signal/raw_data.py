"""Raw data: the recorded echoes of all pulses, with the parameters needed to focus them.

Data from providers may have an autofocus record: corrections of range and phase, pulse by pulse.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.registry import late, png_of
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track, numbers_of


@dataclass(frozen=True, eq=False)
class AutofocusRecords:
    r"""Corrections of range and phase that a data provider's autofocus found.

    Corrected samples over frequency are

    .. math:: F'_{kn} = F_{kn} e^{j \phi_n} e^{-j 4 \pi f_{kn} \rho_n / c}

    so that an echo of the range R in the data stands at :math:`R + \rho_n` after the correction.

    Parameters
    ----------
    range_correction : (n_pulses,) float64, m; :math:`\rho_n`
    phase_correction : (n_pulses,) float64, rad; :math:`\phi_n`, of all samples of the pulse

    Raises
    ------
    DataError
        The two differ in length, or hold NaN or infinite numbers.
    """

    range_correction: F64
    phase_correction: F64

    def __post_init__(self) -> None:
        shapes = self.range_correction.shape, self.phase_correction.shape
        if shapes[0] != shapes[1] or len(shapes[0]) != 1:
            raise DataError(
                f"autofocus records: {shapes[0]} range and {shapes[1]} phase corrections; give one for each pulse"
            )
        if not (np.isfinite(self.range_correction).all() and np.isfinite(self.phase_correction).all()):
            raise DataError("autofocus records: corrections must be finite numbers")

    def of_pulses(self, pick: NDArray[np.intp]) -> "AutofocusRecords":
        """Records of the pulses of these numbers."""
        return AutofocusRecords(self.range_correction[pick], self.phase_correction[pick])

    def range_error(self, wavelength: float) -> F64:
        r"""Range error (n_pulses,), m, with the same phase at the carrier: :math:`\lambda \phi / 4 \pi - \rho`.

        The sign is that of `sarmitsuba.signal.focusing.autofocus.Autofocuser.estimate`: true minus recorded range. As
        the phase repeats itself every half wavelength, the range corrections of measured data (AFRL's Gotcha set) jump
        by multiples of it from pulse to pulse. The result does not: it changes by a quarter of a wavelength at most
        from pulse to pulse, and its mean is as close as such multiples allow to that of :math:`-\rho`.
        """
        half = 0.5 * wavelength
        error = np.unwrap(self.phase_correction * half / (2.0 * np.pi) - self.range_correction, period=half)
        return np.asarray(error - half * np.round(np.mean(error + self.range_correction) / half))


# metadata: file beside the one that was read, which holds the samples
DATA_FILE = "data_file"


@dataclass(frozen=True)
class Layer:
    """Label of one plane of the data (channel, order, subset); the planes of one channel add up to that channel.

    Parameters
    ----------
    channel : polarisation such as ``HV`` or ``RH`` (transmit first)
    order : number of bounces, or 0 when all orders are summed
    subset : 0 for all rays, or 1 / 2 for one of two independent sets, by its share
        ``sarmitsuba.core.constants.SUBSET_SHARES``
    """

    channel: str
    order: int = 0
    subset: int = 0


def channels_of(layers: Sequence[Layer]) -> tuple[str, ...]:
    """Channels in order of first appearance."""
    return tuple(dict.fromkeys(layer.channel for layer in layers))


def sum_of_channel(data: C64, layers: Sequence[Layer], channel: str | None, what: str) -> C64:
    """Sum of all layers of a channel (default: the first).

    Parameters
    ----------
    data : (n_layers, ...) complex64
    layers : n_layers labels
    channel : name, or None for the first
    what : name of the data in error messages

    Raises
    ------
    DataError
        No such channel.
    """
    channels = channels_of(layers)
    name = channel or channels[0]
    picks = [i for i, layer in enumerate(layers) if layer.channel == name]
    if not picks:
        raise DataError(f"{what}: no channel {name!r}; there are {', '.join(channels)}")
    return np.asarray(data[picks].sum(axis=0, dtype=np.complex64))


def sum_layers(data: C64, layers: Sequence[Layer]) -> C64:
    """Sum (n_channels, ...) of the layers (n_layers, ...) of every channel."""
    return np.stack([sum_of_channel(data, layers, c, "layers") for c in channels_of(layers)])


@dataclass(frozen=True, eq=False)
class RawData:
    r"""Raw data: echoes of every pulse, with radar and metadata.

    Parameters
    ----------
    data : (n_layers, n_pulses, n_fast) complex64, sqrt(W)
    layers : n_layers labels
    domain : ``compressed``: range profiles on ``radar.window``; a point target of unit RCS at slant range R
        has the value ``K / R^2 sinc((r - R) / range_cell) exp(-j 4 pi fc R / c)`` with K the radar's
        ``amplitude_constant``.
        ``chirped``: LFM echoes at baseband; sample i of pulse t is at the fast time
        ``2 start_range[t] / c - pulse_width / 2 + i / sampling_rate`` and
        ``n_fast = n_samples + ceil(pulse_width * sampling_rate)``.
    radar : the radar that recorded it, with the track as recorded
    metadata : JSON-able facts: parameters, versions, seed, timings, warnings
    request : default image to focus
    flown : the true track, in the frame of ``radar``, where it is not the recorded one; not used by focusers
    autofocus_records : by channel, a provider's autofocus corrections that came with the data and are not applied to
        them, see :func:`sarmitsuba.signal.focusing.apply_autofocus_records`; empty: none

    Notes
    -----
    Phase is that of demodulation by the carrier: ``exp(-j 4 pi fc R / c)``, time convention exp(+j w t).
    """

    data: C64
    layers: tuple[Layer, ...]
    domain: Literal["compressed", "chirped"]
    radar: Radar
    metadata: Mapping[str, Any] = field(default_factory=dict)
    request: ImageRequest | None = None
    flown: Track | None = None
    autofocus_records: Mapping[str, AutofocusRecords] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.data.ndim != 3 or self.data.shape[0] != len(self.layers):
            raise DataError(f"raw data: shape {self.data.shape} does not match {len(self.layers)} layers")
        if self.flown is not None and self.flown.n_pulses != self.radar.track.n_pulses:
            raise DataError(
                f"raw data: {self.flown.n_pulses} pulses flown and {self.radar.track.n_pulses} recorded do not match"
            )
        for channel, records in self.autofocus_records.items():
            if records.range_correction.size != self.radar.track.n_pulses or channel not in self.channels:
                raise DataError(
                    f"raw data: autofocus records of {records.range_correction.size} pulses, channel {channel}, do not "
                    f"match {self.radar.track.n_pulses} pulses of {', '.join(self.channels)}"
                )
        if self.data.shape[1] != self.radar.track.n_pulses:
            raise DataError(
                f"raw data: {self.data.shape[1]} pulses in the data, {self.radar.track.n_pulses} in the track"
            )

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels in order of first appearance."""
        return channels_of(self.layers)

    @property
    def calibrated(self) -> bool:
        """Whether echoes are in sqrt(W) of the radar's power and gain; False for data of unknown gain."""
        return self.metadata.get("calibrated", True) is not False

    @property
    def anchor(self) -> Anchor:
        """Position on the Earth of the origin of the file's frame."""
        return self.radar.anchor

    def __repr__(self) -> str:
        _, pulses, samples = self.data.shape
        frequency = self.radar.waveform.center_frequency / 1e9
        size = f"{pulses} pulses x {samples} samples"
        return f"RawData({'/'.join(self.channels)}: {size}, {self.domain}, {frequency:.4g} GHz)"

    def _repr_png_(self) -> bytes:
        """Picture of the first channel's echoes, for notebooks."""
        return png_of(self.plot())

    def plot(self, *, channel: str | None = None) -> object:
        """Level of a channel's echoes (default: the first) as a Matplotlib ``Figure``, which notebooks show."""
        return late("sarmitsuba.view.charts", "echoes_figure")(self, channel)

    def save(self, path: Path | str, *, format: str | None = None) -> None:
        """Write to a file, as :func:`sarmitsuba.write_raw` does."""
        late("sarmitsuba.files", "write_raw")(self, path, format=format)

    @staticmethod
    def load(path: Path | str, *, format: str | None = None) -> "RawData":
        """Read from a file, as :func:`sarmitsuba.read_raw` does."""
        raw = late("sarmitsuba.files", "read_raw")(path, format=format)
        assert isinstance(raw, RawData)
        return raw

    def of_pulses(self, pulses: slice | ArrayLike) -> "RawData":
        """Raw data of some pulses only: a slice, pulse numbers or a mask.

        ``raw.of_pulses(slice(None, None, 2))`` leaves out every second pulse, ``raw.of_pulses(slice(100, -100))``
        shortens the aperture. ``azimuth_resolution`` and ``prf`` in the metadata stay those of the whole flight.

        Raises
        ------
        RadarError : no pulse is left, or the pulses do not follow each other in time
        """
        pick = numbers_of(pulses, self.radar.track.n_pulses)
        return replace(
            self,
            data=np.ascontiguousarray(self.data[:, pick]),
            radar=self.radar.of_pulses(pick),
            flown=self.flown and self.flown.of_pulses(pick),
            autofocus_records={name: one.of_pulses(pick) for name, one in self.autofocus_records.items()},
        )

    def to_xarray(self) -> object:
        """The channels as an ``xarray.DataArray`` (channel, pulse, sample), complex64, sqrt(W).

        Coordinates carry their units: pulse times, antenna positions, slant range or fast time. Needs xarray (the extra
        ``formats``).
        """
        return late("sarmitsuba.files.labelled", "labelled_raw")(self)

    def total(self, channel: str | None = None) -> C64:
        """Sum of all layers of a channel (default: the first), (n_pulses, n_fast) complex64."""
        return sum_of_channel(self.data, self.layers, channel, "raw data")
