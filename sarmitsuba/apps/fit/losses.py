"""Losses of raw data with their derivatives, for :func:`sarmitsuba.gradient`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image import block_means
from sarmitsuba.signal.raw_data import RawData, sum_layers

if TYPE_CHECKING:
    from sarmitsuba.signal.focusing.operator import FocusingOperator

# function of raw data (channels, pulses, samples): a value L and adjoint data, dL = Re sum conj(adjoint) d(data)
Loss: TypeAlias = "Callable[[C64], tuple[float, C64]]"


@dataclass(frozen=True, eq=False)
class SquaredDifference:
    r"""Half the squared difference from measured raw data.

    .. math:: L = \tfrac12 \sum_i w_i |d_i - m_i|^2, \quad \text{adjoint} = w (d - m)

    Parameters
    ----------
    measured : raw data, range compressed, whose channels are those of the scene's radar in any order; or their array
        (channels, pulses, samples) in the order of the radar. Layers of a channel are summed.
    weights : at least 0, of a shape that broadcasts to that of the data, such as one over the variance of the noise,
        1/W; None: one
    """

    measured: RawData | C64
    weights: F64 | None = None
    _planes: C64 = field(init=False, repr=False)

    def __post_init__(self) -> None:
        measured = self.measured
        planes = _sum_layers(measured) if isinstance(measured, RawData) else np.asarray(measured)
        if planes.dtype.kind not in "fiuc":
            raise DataError(
                f"loss: measured is {_kind(measured)}; give raw data, or an array of complex numbers"
            )
        if not np.isfinite(planes).all():
            raise DataError("loss: the measured raw data are not finite; leave out or repair their samples")
        if self.weights is not None and np.asarray(self.weights).dtype.kind not in "fiu":
            raise DataError(f"loss: weights are {_kind(self.weights)}; give real numbers of at least 0")
        if self.weights is not None and not (np.asarray(self.weights) >= 0.0).all():
            raise DataError("loss: a weight is below 0 or no number; give weights of at least 0")
        object.__setattr__(self, "_planes", planes)

    def in_order(self, channels: tuple[str, ...]) -> SquaredDifference:
        """The same for data of some channels in this order; an array has none, and stays as it is.

        Raises
        ------
        DataError : the measured raw data are of other channels
        """
        raw = self.measured
        if not isinstance(raw, RawData) or raw.channels == channels:
            return self
        if set(raw.channels) != set(channels):
            raise DataError(
                f"loss: measured raw data of channels {', '.join(raw.channels)} and a radar of {', '.join(channels)}; "
                "give the scene the polarisation of the data"
            )
        order = [raw.channels.index(channel) for channel in channels]
        weights = None if self.weights is None else np.asarray(self.weights)
        if weights is not None and weights.ndim == self._planes.ndim and len(weights) == len(order):
            weights = weights[order]
        return SquaredDifference(self._planes[order], weights)

    def __call__(self, data: C64) -> tuple[float, C64]:
        """Value and adjoint data."""
        if data.shape != self._planes.shape:
            raise DataError(
                f"loss: measured raw data of the shape {self._planes.shape} and a scene's of {data.shape} (channels, "
                "pulses, samples); give the scene the radar of the data"
            )
        difference = data.astype(np.complex128) - self._planes
        weights = np.ones(()) if self.weights is None else np.asarray(self.weights)
        if weights.ndim > data.ndim or any(
            own not in (1, n) for own, n in zip(weights.shape[::-1], data.shape[::-1], strict=False)
        ):
            raise DataError(
                f"loss: weights of the shape {weights.shape} do not broadcast to that of the data, {data.shape}"
            )
        weighted = difference if self.weights is None else difference * self.weights
        return 0.5 * float(np.vdot(difference, weighted).real), weighted.astype(np.complex64)


@dataclass(frozen=True, eq=False)
class MultilookDifference:
    r"""Half the squared difference from a measured multilooked image, of intensity or amplitude: without its phase.

    With the image :math:`z = A d`, means over blocks of N pixels, and measured values J,

    .. math:: L = \tfrac12 \sum_k (I_k - J_k)^2, \quad I_k = \frac1N \sum_{i \in k} |z_i|^2

    and the adjoint data :math:`A^H y` with :math:`y_i = \tfrac2N (I_k - J_k) z_i`; for amplitudes,
    :math:`V_k = \sqrt{I_k}` in place of I, :math:`y_i = (V_k - J_k) z_i / N V_k`.

    Parameters
    ----------
    operator : focusing A, see :func:`sarmitsuba.focusing_operator`
    measured : (layers, rows, columns) float64, means over blocks, as from :meth:`multilooked`
    looks : pixels of a block along azimuth and range; incomplete blocks at the far ends are left out
    amplitude : compare roots of mean intensities
    """

    operator: FocusingOperator
    measured: F64
    looks: tuple[int, int] = (1, 1)
    amplitude: bool = False

    def multilooked(self, image: C64) -> F64:
        """Values (layers, rows, columns) of a focused image (layers, azimuth, range) to compare."""
        return average_looks(image, self.looks, amplitude=self.amplitude)

    def __call__(self, data: C64) -> tuple[float, C64]:
        """Value and adjoint data."""
        operator, (rows, columns) = self.operator, self.looks
        if data.shape != operator.data_shape:
            raise DataError(
                f"loss: the focusing operator takes data of the shape {operator.data_shape}, and the scene's have "
                f"{data.shape}; make the operator from the scene's raw data"
            )
        image = (operator @ data.reshape(-1)).reshape(operator.image_shape)
        found = self.multilooked(image)
        if found.shape != self.measured.shape:
            raise DataError(
                f"loss: the measured image has the shape {self.measured.shape}, and {found.shape} after {rows} x "
                f"{columns} looks of the scene's; give it the same grid and looks"
            )
        difference = found - self.measured
        per_pixel = difference * (2.0 / (rows * columns))
        if self.amplitude:
            dark = found <= 0.0
            per_pixel = np.where(dark, 0.0, 0.5 * per_pixel / np.where(dark, 1.0, found))
        spread = np.zeros(image.shape)
        within = spread[:, : found.shape[1] * rows, : found.shape[2] * columns]
        within[...] = np.repeat(np.repeat(per_pixel, rows, axis=1), columns, axis=2)
        adjoint = (operator.H @ (spread * image).astype(np.complex64).reshape(-1)).reshape(data.shape)
        return 0.5 * float(np.sum(difference**2)), adjoint


def average_looks(image: C64, looks: tuple[int, int], *, amplitude: bool = False) -> F64:
    """Mean intensities of an image (layers, azimuth, range) over blocks of looks, or their roots, float64."""
    power = np.square(image.real, dtype=np.float64) + np.square(image.imag, dtype=np.float64)
    means = np.stack([block_means(layer, looks) for layer in power])
    return np.sqrt(means) if amplitude else means


def check_loss(loss: Loss, data: C64) -> tuple[float, C128]:
    """Value and adjoint data of a loss.

    Raises
    ------
    DataError : the result is no pair, the value is no finite real number, or the adjoint data are no numbers, have
        another shape or are not finite
    """
    both = loss(data)
    if not isinstance(both, tuple | list) or len(both) != 2:
        raise DataError(
            f"loss: it returns {_kind(both)}; return its value and the adjoint data, (number, array)"
        )
    value, adjoint = both[0], np.asarray(both[1])
    real = np.asarray(value)
    if real.ndim or real.dtype.kind not in "fiu":
        raise DataError(f"loss: its value is {_kind(value)}; return a real number")
    value = float(value)
    if adjoint.dtype.kind not in "fiuc":
        raise DataError(
            f"loss: its adjoint is {_kind(both[1])}; return complex numbers of the shape {data.shape}"
        )
    if not np.isfinite(value):
        raise DataError(f"loss: its value is {value:g}; return a finite number")
    if adjoint.shape != data.shape:
        raise DataError(
            f"loss: its adjoint has the shape {adjoint.shape}, the data have {data.shape}; return one each"
        )
    if not np.isfinite(adjoint).all():
        raise DataError("loss: its adjoint is not finite; return finite numbers")
    # double precision: of a loss without weights, or with large ones, float32 holds nothing
    return value, adjoint.astype(np.complex128)


def _kind(given: object) -> str:
    """Description of an object, for a message."""
    if isinstance(given, np.ndarray):
        return f"an array of {given.dtype} of the shape {given.shape}"
    return "nothing (None)" if given is None else f"a value of type {type(given).__name__}"


def _sum_layers(raw: RawData) -> C64:
    """Array (channels, pulses, samples) of range-compressed raw data, layers of a channel summed."""
    if raw.domain != "compressed":
        raise DataError(f"loss: raw data are {raw.domain}; take range-compressed ones, as simulate() gives")
    return sum_layers(raw.data, raw.layers)
