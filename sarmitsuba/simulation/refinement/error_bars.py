"""Error bars from two independent sets of the rays (subsets, by three to one), at no extra tracing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from sarmitsuba.constants import SUBSET_SHARES
from sarmitsuba.echo.raw import Layer
from sarmitsuba.errors import DataError
from sarmitsuba.image.sar_image import SarImage

F32 = NDArray[np.float32]

# error of the weighted mean of two subsets over half their difference, dB: median of four scenes at three densities
# with their whole aperture (benchmarks/error_bars.py)
SHARED_DB = 2.5
# rms difference of estimate and truth over all runs of that benchmark, dB
SHARED_SCATTER_DB = 2.3


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Sampling error of an image (or of raw data) whose subsets were kept apart.

    Parameters
    ----------
    channels : polarisation channels
    error_db : of each channel, energy of the error over energy of the image, dB
    noise_db : the part of it that differs between the subsets, dB
    per_pixel : (n_channels, ...) float32, rms error in the data's own unit, from the half difference averaged over
        the square of ``window`` pixels about each one
    confidence_db : standard deviation of ``error_db``, dB: the number of independent pixels that carry it, and the
        scatter of the part that the subsets share
    """

    channels: tuple[str, ...]
    error_db: tuple[float, ...]
    noise_db: tuple[float, ...]
    per_pixel: F32
    confidence_db: tuple[float, ...]

    def as_dict(self) -> dict[str, object]:
        """JSON-able form, without the pixels."""
        return {
            channel: {"error_db": round(e, 2), "noise_db": round(n, 2), "confidence_db": round(c, 2)}
            for channel, e, n, c in zip(
                self.channels, self.error_db, self.noise_db, self.confidence_db, strict=True
            )
        }


def subset_planes(
    data: NDArray[np.complex64], layers: Sequence[Layer], channel: str
) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
    """Estimate of a channel (sum of its subsets) and half the difference of the subsets' own estimates, orders summed.

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


def estimate_error(
    data: NDArray[np.complex64], layers: Sequence[Layer], *, window: int = 5, pixels: bool = True
) -> ErrorBars:
    r"""Sampling error of the sum of two subsets from their difference.

    Subsets are stored as their share (``SUBSET_SHARES``) of their own estimate, so that they add up to the weighted
    mean of two independent estimates :math:`x_1, x_2`:

    .. math:: \epsilon^2 = s \sum |x_1 - x_2|^2 / 4 / \sum |d_1 + d_2|^2, \quad d_i = w_i x_i

    with s (``SHARED_DB``) measured. Independent errors alone would make it 1 dB for sets of equal error and -3 dB where
    the sparser one's is 8 dB larger; what both sets blur alike makes it more.

    Parameters
    ----------
    data : (n_layers, n, m) complex64, subsets kept apart
    layers : labels of ``data``
    window : pixels along each axis that ``per_pixel`` is averaged over
    pixels : off leaves ``per_pixel`` empty

    Notes
    -----
    Sampling with rays only: too few bounces, the blocks of pulses (whose error is measured apart, see
    :mod:`sarmitsuba.simulation.blocks`), gridding and physical optics itself are not in it. What lattices of both
    densities blur alike is in it only as the constant s.
    """
    channels = tuple(dict.fromkeys(layer.channel for layer in layers))
    totals, spreads, maps = [], [], []
    for channel in channels:
        mean, difference = subset_planes(data, layers, channel)
        power = difference.real**2 + difference.imag**2
        noise = float(power.sum(dtype=np.float64))
        signal = float(np.sum(mean.real**2 + mean.imag**2, dtype=np.float64))
        totals.append(10.0 * float(np.log10(max(noise, 1e-60) / max(signal, 1e-60))))
        # pixels that share the energy evenly would be this many
        effective = noise**2 / max(float(np.sum(power.astype(np.float64) ** 2)), 1e-60)
        spreads.append(np.hypot(10.0 / np.log(10.0) / np.sqrt(max(effective, 1.0)), SHARED_SCATTER_DB))
        if pixels:
            mean_power = np.maximum(uniform_filter(power, window, mode="nearest"), 0.0)
            maps.append(np.sqrt(mean_power) * 10.0 ** (SHARED_DB / 20.0))
    stack = np.stack(maps).astype(np.float32) if pixels else np.empty((0, *data.shape[1:]), np.float32)
    return ErrorBars(
        channels=channels,
        error_db=tuple(t + SHARED_DB for t in totals),
        noise_db=tuple(totals),
        per_pixel=stack,
        confidence_db=tuple(float(s) for s in spreads),
    )


def error_bars(image: SarImage, *, window: int = 5) -> ErrorBars:
    """Sampling error of an image with subsets; see :func:`estimate_error`."""
    return estimate_error(image.data, image.layers, window=window)


def has_subsets(layers: Sequence[Layer]) -> bool:
    """Whether every layer belongs to one of two ray subsets."""
    return bool(layers) and all(layer.subset in (1, 2) for layer in layers)


def with_error_bars(image: SarImage) -> SarImage:
    """The image with ``sampling_error`` in its metadata (by channel, dB); unchanged where subsets were not kept."""
    if not has_subsets(image.layers):
        return image
    bars = estimate_error(image.data, image.layers, pixels=False)
    return replace(image, metadata={**image.metadata, "sampling_error": bars.as_dict()})


__all__ = [
    "SHARED_DB",
    "SHARED_SCATTER_DB",
    "ErrorBars",
    "error_bars",
    "estimate_error",
    "has_subsets",
    "subset_planes",
    "with_error_bars",
]
