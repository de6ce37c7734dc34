"""Focusing as a linear operator with its exact adjoint, for solvers of linear equations."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import scipy.sparse.linalg
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, LinearMap
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.machine.exclusive import backend_lock, exclusive
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.signal.focusing.autofocus import parse_autofocus
from sarmitsuba.signal.focusing.focus import prepare, raw_data
from sarmitsuba.signal.focusing.focuser import DEFAULT, Focuser, FocusTask
from sarmitsuba.signal.focusing.frequency_domain.row_costs import RowsFocuser
from sarmitsuba.signal.focusing.frequency_domain.turning import turns
from sarmitsuba.signal.focusing.motion_compensation import MotionCompensation
from sarmitsuba.signal.focusing.range_compression import RangeCompression
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pulse_motion import BoresightPhase
from sarmitsuba.signal.raw_data import Layer, RawData


class FocusingOperator(scipy.sparse.linalg.LinearOperator):
    r"""Focusing A as a linear operator: raw data in, image out, both flattened; ``A.H`` takes images to data.

    .. math:: \langle y, A x \rangle = \langle A^H y, x \rangle

    Made by :func:`sarmitsuba.focusing_operator`.

    Parameters
    ----------
    steps : linear maps, the one applied first at the front
    phase : rad, by which pixels are turned at last
    data_shape : (n_layers, n_pulses, n_fast) of the raw data, of which ``x`` is the flattened array
    grid : pixels
    layers : n_layers labels, of data and image alike
    focuser : the one used

    Attributes
    ----------
    image_shape : (n_layers, n_azimuth, n_range) of the image, of which ``A @ x`` is the flattened array
    shape : (pixels of all layers, samples of all layers)
    dtype : complex64; sums are in single precision, so that the equation above holds to about 1e-7
    """

    def __init__(
        self,
        steps: tuple[LinearMap, ...],
        phase: float,
        data_shape: tuple[int, ...],
        grid: ImageGrid,
        layers: tuple[Layer, ...],
        focuser: Focuser,
    ) -> None:
        self.data_shape, self.image_shape = tuple(data_shape), (len(layers), *grid.shape)
        self.grid, self.layers, self.focuser = grid, layers, focuser
        self._steps, self._turn = steps, np.complex64(np.exp(1j * phase))
        super().__init__(np.complex64, (int(np.prod(self.image_shape)), int(np.prod(self.data_shape))))

    def _matvec(self, x: NDArray[np.number]) -> C64:
        values = _single(x, "raw data").reshape(self.data_shape)
        with backend_lock():
            for step in self._steps:
                values = step.forward(values)
        return np.asarray(values * self._turn).reshape(-1)

    def _rmatvec(self, x: NDArray[np.number]) -> C64:
        values = _single(x, "image").reshape(self.image_shape) * self._turn.conj()
        with backend_lock():
            for step in reversed(self._steps):
                values = step.adjoint(values)
        return np.asarray(values).reshape(-1)


def _single(values: NDArray[np.number], what: str) -> C64:
    """Values as complex64.

    Raises
    ------
    DataError
        One is NaN, infinite or too large.
    """
    with np.errstate(over="ignore"):
        out = np.asarray(values).astype(np.complex64)
    if not np.isfinite(out).all():
        count = int(np.count_nonzero(~np.isfinite(out)))
        raise DataError(
            f"focusing operator: {count} of {out.size} values of the {what} are NaN, infinite or above 3.4e38"
        )
    return out


@exclusive
def focusing_operator(
    raw: RawData | Path | str,
    grid: ImageGrid | None = None,
    *,
    request: ImageRequest | Mapping[str, object] | None = None,
    focuser: str | Focuser = DEFAULT,
    range_window: str | Window = DEFAULT_WINDOW,
    azimuth_window: str | Window = DEFAULT_WINDOW,
    compression: Literal["flat", "matched"] = "flat",
    motion_compensation: str = "auto",
    autofocus: str | None = None,
    progress: Progress = silent,
) -> FocusingOperator:
    """Focusing of raw data of one radar onto one grid as a linear operator with its exact adjoint.

    ``A @ raw.data.ravel()`` is the image of :func:`sarmitsuba.focus` with the same arguments, flattened; ``A.H`` takes
    an image to raw data. Solvers of linear equations and of inverse problems take it as it is: SciPy's ``lsqr`` and
    ``lsmr``, and libraries that accept a :class:`scipy.sparse.linalg.LinearOperator`.

    Parameters
    ----------
    raw : data, or their file, of the radar, track, layers and domain, and to ``focuser="auto"`` of the error of its
        echoes; its values do not count otherwise
    grid, request, focuser, range_window, azimuth_window, compression, motion_compensation : as for
        :func:`sarmitsuba.focus`
    autofocus : None or ``none``; any other is refused, because it is not linear
    progress : called after every batch of every product

    Returns
    -------
    FocusingOperator : of shape (pixels, samples) of all layers, complex64; layers do not mix

    Raises
    ------
    DataError
        Data that :func:`sarmitsuba.focus` refuses, an autofocuser, or a focuser that states no adjoint: those in the
        frequency domain for beams that turn and from orbit. ``auto`` is backprojection there.

    Notes
    -----
    The adjoint is that of the computation, interpolation and calibration included, not of its ideal. Up to weights of
    pulses and of frequencies it gives the echoes of ideal points at the pixels. Where a frequency-domain focuser, or
    ``auto``, has no adjoint, backprojection has one.
    """
    if parse_autofocus(autofocus) is not None:
        raise DataError(
            f"focusing operator: autofocus {autofocus} is not linear in the data; leave it out, or correct the data "
            "before"
        )
    raw = raw_data(raw)
    windows = (range_window, azimuth_window)
    chain = prepare(raw, grid, request, focuser, windows, compression, motion_compensation, None)
    steps: list[LinearMap] = []
    if raw.domain == "chirped":
        steps.append(RangeCompression(raw.radar, compression))
    if raw.radar.delay is not None:
        steps.append(BoresightPhase(raw.radar))
    shape, radar = chain.raw.data.shape, chain.raw.radar
    if chain.compensation is not None:
        moved = MotionCompensation(chain.compensation[0])
        shape, radar = (shape[0], radar.track.n_pulses, moved.radar.window.n_samples), moved.radar
        steps.append(moved)
    if isinstance(chain.focuser, RowsFocuser) and turns(radar):
        if str(focuser).partition(",")[0] != DEFAULT:
            raise DataError(
                f"focusing operator: {chain.focuser.name} filters the echoes of a beam that turns, or of an orbit, for "
                "each pixel, and states no adjoint of that; take focuser backprojection or factorised"
            )
        return focusing_operator(
            raw,
            grid,
            request=request,
            focuser="backprojection",
            range_window=range_window,
            azimuth_window=azimuth_window,
            compression=compression,
            motion_compensation=motion_compensation,
            progress=progress,
        )
    # the geometry alone: the operator keeps no data
    bare = replace(chain.raw, data=np.broadcast_to(np.complex64(0.0), shape), radar=radar)
    steps.append(chain.focuser.imaging(FocusTask(bare, chain.grid, *chain.windows, progress)))
    return FocusingOperator(
        tuple(steps), chain.halfway, raw.data.shape, chain.grid, raw.layers, chain.focuser
    )
