"""Error bars of ray sampling: from two independent subsets of a run's rays, or from several passes of rays."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import C64, F32, sum_energy
from sarmitsuba.core.constants import EMPTY_DB, SUBSET_SHARES
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import amplitude_from_db, db_from_power, power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.signal.image import SarImage, sliding_means
from sarmitsuba.signal.raw_data import Layer

Source = Literal["ray sampling, from two sets of rays", "ray sampling, from passes"]
SUBSETS: Source = "ray sampling, from two sets of rays"
PASSES: Source = "ray sampling, from passes"

# error of the mean of two subsets over half their difference, dB, at the edges of shadows, which dominate it: see
# estimate_error
SHARED_DB = 3.0
# rms difference of estimate and truth over all runs of that benchmark, dB
SHARED_SCATTER_DB = 1.9
# the same constant for passes: error of their weighted mean relative to the estimate from the last one for independent
# errors; median of random scenes (benchmarks/suite/error_bars.py)
PASSES_SHARED_DB = 4.0
# rms difference of that estimate and truth over the 21 runs of that benchmark, dB
PASSES_SCATTER_DB = 1.5
# number of pixels with a common error: reduces the number of independent ones
PIXELS_TOGETHER = 16.0


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Estimated error by ray sampling of an image (or of raw data).

    Parameters
    ----------
    channels : polarisation channels, without those that hold nothing but rounding (``EMPTY_DB``)
    error_db : of each channel, energy of the error over energy of the image, dB
    noise_db : measured quantity, dB: half the difference of two subsets, or the difference of the last pass from the
        mean of those before it, which is larger than the true error in 19 of 20 runs
    per_pixel : (n_channels, ...) float32, rms error in the unit of the data, from the half difference averaged over
        the square of ``window`` pixels about each one; from subsets only
    confidence_db : standard deviation of ``error_db``, dB: by the number of independent pixels, and by the scatter of
        the error common to both subsets
    source : of the estimate (subsets or passes)
    """

    channels: tuple[str, ...]
    error_db: tuple[float, ...]
    noise_db: tuple[float, ...]
    per_pixel: F32
    confidence_db: tuple[float, ...]
    source: Source = SUBSETS

    def as_dict(self) -> dict[str, dict[str, object]]:
        """JSON-able form, without the pixels."""
        measured = "noise_db" if self.source == SUBSETS else "at_most_db"
        return {
            channel: {
                "error_db": round(e, 2),
                measured: round(n, 2),
                "confidence_db": round(c, 2),
                "source": self.source,
            }
            for channel, e, n, c in zip(
                self.channels, self.error_db, self.noise_db, self.confidence_db, strict=True
            )
        }


def subset_planes(data: C64, layers: Sequence[Layer], channel: str) -> tuple[C64, C64]:
    """Estimate of a channel (sum of its subsets) and half the difference of the subsets' estimates, orders summed.

    Raises
    ------
    DataError
        The subsets were not kept.
    """
    planes = []
    for subset in (1, 2):
        picks = [i for i, la in enumerate(layers) if la.channel == channel and la.subset == subset]
        if not picks:
            raise DataError(
                f"error bars: channel {channel} has no subset {subset}; simulate with keep_subsets on"
            )
        planes.append(data[picks].sum(axis=0, dtype=np.complex64) if len(picks) > 1 else data[picks[0]])
    each = [np.float32(0.5 / SUBSET_SHARES[subset]) for subset in (1, 2)]
    return planes[0] + planes[1], planes[0] * each[0] - planes[1] * each[1]


def estimate_error(data: C64, layers: Sequence[Layer], *, window: int = 5, pixels: bool = True) -> ErrorBars:
    r"""Sampling error of the sum of two subsets from their difference.

    Subsets are stored as their share (``SUBSET_SHARES``) of their own estimate, so that they add up to the mean of two
    independent estimates :math:`x_1, x_2`:

    .. math:: \epsilon^2 = s \sum |x_1 - x_2|^2 / 4 / \sum |d_1 + d_2|^2, \quad d_i = w_i x_i

    For independent errors without bias s would be one. The edge of a shadow is a staircase of tubes: a scatterer at the
    distance x d from it is on the wrong side with the chance P(x), so that an estimate has the bias P and the variance
    P (1 - P). Over a lattice whose rows are parallel to the edge, P = 1/2 - x and

    .. math:: \int P^2 dx : \int P (1 - P) dx = 1 : 2

    The mean of two estimates keeps the bias and half of the variance, half their difference has half of the variance
    alone: s = 2 (3 dB), and 1.86 where the rows are at 45 degrees. ``SHARED_DB`` is the former. Where errors have no
    bias the estimate is 3 dB too high.

    Parameters
    ----------
    data : (n_layers, n, m) complex64, subsets kept separately
    layers : labels of ``data``
    window : pixels along each axis over which ``per_pixel`` is averaged
    pixels : whether to compute ``per_pixel``

    Notes
    -----
    Error of ray sampling only: truncation of bounces, blocks of pulses (whose error is measured separately, see
    :mod:`sarmitsuba.simulation.execution.blocks`), gridding and the physical-optics model are not included. Errors
    common to lattices of both densities are included only by the constant s.
    """
    totals, spreads, maps, signals = {}, {}, {}, {}
    for channel in dict.fromkeys(layer.channel for layer in layers):
        mean, difference = subset_planes(data, layers, channel)
        power = difference.real**2 + difference.imag**2
        noise = float(power.sum(dtype=np.float64))
        signals[channel] = signal = sum_energy(mean)
        totals[channel] = db_from_power(max(noise, 1e-60) / max(signal, 1e-60))
        spreads[channel] = float(np.hypot(_chance_db(power), SHARED_SCATTER_DB))
        if pixels:
            mean_power = sliding_means(power, (window, window), "nearest")
            maps[channel] = np.sqrt(mean_power) * amplitude_from_db(SHARED_DB)
    channels = _channels_with_echoes(signals)
    stack = np.empty((0, *data.shape[1:]), np.float32)
    if pixels:
        stack = np.stack([maps[c] for c in channels]).astype(np.float32)
    return ErrorBars(
        channels=channels,
        error_db=tuple(totals[c] + SHARED_DB for c in channels),
        noise_db=tuple(totals[c] for c in channels),
        per_pixel=stack,
        confidence_db=tuple(spreads[c] for c in channels),
    )


def estimate_pass_error(change: C64, mean: C64, channels: tuple[str, ...], share: float) -> ErrorBars:
    r"""Sampling error of the weighted mean of passes, from the change by the last of them.

    Passes are weighted by their number of rays. For independent errors with variance inversely proportional to it, the
    error of the mean would be

    .. math:: \epsilon^2 = s \, a (1 - a) \sum |x - m|^2 / \sum |d|^2

    with x the last pass, m the mean of those before it, d that of all, a the weight of the last. Errors common to
    lattices of all densities increase it: s (``PASSES_SHARED_DB``), measured.

    Parameters
    ----------
    change : (n_channels, n, m) complex64, x - m
    mean : (n_channels, n, m) complex64, d
    channels : of both
    share : a

    Notes
    -----
    Error of ray sampling only, as for :func:`estimate_error`. The estimate depends on the random lattice of the last
    pass: where few pixels carry the error it scatters, and ``confidence_db`` is large.
    """
    less = db_from_power(max(share * (1.0 - share), 1e-60)) + PASSES_SHARED_DB
    signals = {channel: sum_energy(d) for channel, d in zip(channels, mean, strict=True)}
    of_channel = dict(zip(channels, change, strict=True))
    channels = _channels_with_echoes(signals)
    totals, spreads = [], []
    for channel in channels:
        x, signal = of_channel[channel], signals[channel]
        power = x.real**2 + x.imag**2
        noise = float(power.sum(dtype=np.float64))
        totals.append(db_from_power(max(noise, 1e-60) / max(signal, 1e-60)))
        spreads.append(np.hypot(np.sqrt(PIXELS_TOGETHER) * _chance_db(power), PASSES_SCATTER_DB))
    return ErrorBars(
        channels=channels,
        error_db=tuple(t + less for t in totals),
        noise_db=tuple(totals),
        per_pixel=np.empty((0, *change.shape[1:]), np.float32),
        confidence_db=tuple(float(s) for s in spreads),
        source=PASSES,
    )


def _channels_with_echoes(energy: Mapping[str, float]) -> tuple[str, ...]:
    """Channels that hold more than rounding, by the energy of each; all where none has any."""
    least = power_from_db(EMPTY_DB) * max(energy.values(), default=0.0)
    return tuple(channel for channel, own in energy.items() if own >= least)


def _chance_db(power: F32) -> float:
    """Standard deviation, dB, of the energy, from the effective number of independent pixels."""
    total = float(power.sum(dtype=np.float64))
    effective = total**2 / max(float(np.sum(power.astype(np.float64) ** 2)), 1e-60)
    return float(10.0 / np.log(10.0) / np.sqrt(max(effective, 1.0)))


def error_bars(image: SarImage, *, window: int = 5) -> ErrorBars:
    """Error bars of an image with ray subsets; see :func:`estimate_error`."""
    return estimate_error(image.data, image.layers, window=window)


def has_subsets(layers: Sequence[Layer]) -> bool:
    """Whether every layer belongs to one of two ray subsets."""
    return bool(layers) and all(layer.subset in (1, 2) for layer in layers)


def add_error_bars(image: SarImage) -> SarImage:
    """The image with ``sampling_error`` in its metadata (by channel, dB).

    An estimate from passes is kept. Unchanged where there is none and subsets were not kept.
    """
    passes = image.metadata.get("refinement", {}).get("sampling_error")
    if passes:
        return replace(image, metadata=_add_sampling_error(image.metadata, passes))
    if not has_subsets(image.layers):
        return image
    bars = estimate_error(image.data, image.layers, pixels=False)
    return replace(image, metadata=_add_sampling_error(image.metadata, bars.as_dict()))


def add_two_sets(change_db: float, two_sets_db: float) -> float:
    r"""Error of the mean of two ray sets, dB, from the change of one by finer rays, and from their difference.

    With the bias b and the scatter v of one set the change has the energy :math:`b^2 + v^2`, the error of the mean
    :math:`b^2 + v^2 / 2`. Two sets state :math:`v^2`, see :func:`estimate_error`, and their statement is the least.

    Parameters
    ----------
    change_db, two_sets_db : dB; the latter NaN: there is one set
    """
    if math.isnan(two_sets_db):
        return change_db
    beyond = power_from_db(change_db) - 0.5 * power_from_db(two_sets_db)
    return max(db_from_power(max(beyond, 1e-30)), two_sets_db)


def exchange_two_sets(found: Witness, two_sets_db: float) -> Witness:
    """Witness of the rays with another error by the scatter of ray sets, dB, such as that of the image or of passes."""
    old, new = (0.0 if math.isnan(level) else power_from_db(level) for level in (found.law_db, two_sets_db))

    def level(error_db: float) -> float:
        bias = power_from_db(error_db) - 0.5 * old if not error_db <= found.law_db else 0.0
        energy = max(bias + 0.5 * new, new)
        return db_from_power(energy) if energy > 0.0 else -math.inf

    return replace(found, error_db=level(found.error_db), upper_db=level(found.upper_db), law_db=two_sets_db)


def _add_sampling_error(
    metadata: Mapping[str, object], errors: Mapping[str, Mapping[str, object]]
) -> dict[str, object]:
    """Metadata with the error bars of an image, in place of those of the echoes also in the witness of the rays."""
    out = {**metadata, "sampling_error": errors}
    witnesses = metadata.get("witnesses")
    found = Witness.read(witnesses.get("rays")) if isinstance(witnesses, Mapping) else None
    if found is None or not isinstance(witnesses, Mapping):
        return out
    worst = max(float(error["error_db"]) for error in errors.values())  # type: ignore[arg-type]
    reference = f"{found.reference.partition(',')[0]}, and {next(iter(errors.values())).get('source', '')}"
    both = replace(exchange_two_sets(found, worst), reference=reference)
    return {**out, "witnesses": {**witnesses, "rays": both.as_dict()}}
