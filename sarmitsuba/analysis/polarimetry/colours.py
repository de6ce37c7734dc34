"""Colours from three powers, by one law for all pictures."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.analysis.polarimetry.coherency import hermitian
from sarmitsuba.core.arrays import U8
from sarmitsuba.core.errors import DataError

# range of the brightness from black to white, dB
SPAN_DB = 50.0
# percentile of the lit pixels shown as white
WHITE_PERCENTILE = 99.0


def colours(powers: ArrayLike, *, white_db: float | None = None, span_db: float = SPAN_DB) -> U8:
    r"""Red, green and blue of three powers, (rows, columns, 3) uint8.

    Brightness is the sum of the powers in dB, ``span_db`` from black to white; hue and saturation are those of the
    amplitudes:

    .. math:: c_i = 255\, b \sqrt{P_i / \max_k P_k}, \quad b = 1 + (10 \log_{10} \sum_k P_k - w) / s

    clipped to 0 ... 1. The hue is independent of the strength, and channels are not stretched separately.

    Parameters
    ----------
    powers : (rows, columns, 3), linear, not negative
    white_db : w, dB of the powers' unit; None: the 99th percentile of the sum over pixels with power
    span_db : s

    Raises
    ------
    DataError
        The shape of the powers differs, or ``span_db`` is not above 0.
    """
    p = np.asarray(powers, dtype=np.float64)
    if p.shape[-1:] != (3,):
        raise DataError(f"polarimetry: powers of shape {p.shape}; (rows, columns, 3) are needed")
    if not span_db > 0.0:
        raise DataError(f"polarimetry: span_db = {span_db:g} dB is not above 0; give for example {SPAN_DB:g}")
    total = p.sum(axis=-1)
    lit = total > 0.0
    if not lit.any():
        return np.zeros(p.shape, dtype=np.uint8)
    level = 10.0 * np.log10(np.where(lit, total, 1.0))
    white = float(np.percentile(level[lit], WHITE_PERCENTILE)) if white_db is None else white_db
    brightness = np.where(lit, np.clip(1.0 + (level - white) / span_db, 0.0, 1.0), 0.0)
    hue = np.sqrt(p / np.where(lit, p.max(axis=-1), 1.0)[..., None])
    return np.asarray(np.rint(255.0 * brightness[..., None] * hue), dtype=np.uint8)


def pauli_rgb(coherency: ArrayLike, *, white_db: float | None = None) -> U8:
    """Pauli colours of T3 (rows, columns, 3, 3): red T22 (even bounces), green T33, blue T11 (odd bounces)."""
    t = hermitian(coherency)
    return colours(np.stack([t[..., i, i].real for i in (1, 2, 0)], axis=-1), white_db=white_db)
