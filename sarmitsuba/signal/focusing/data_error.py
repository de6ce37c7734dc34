"""Error of simulated echoes, known before they are focused."""

import math
from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.signal.raw.raw_data import RawData

# pulses at a time
_PULSES = 64


def data_error_db(raw: RawData) -> float:
    r"""Measured error of echoes relative to their energy, dB: NaN where none is known, -inf where there is none.

    The sum of what is measured before focusing: blocks of pulses, and ray sampling by the difference of two ray
    subsets, in the worst channel,

    .. math:: \epsilon^2 = \frac{1}{4} \sum |x_1 - x_2|^2 / \sum |w_1 x_1 + w_2 x_2|^2

    Ideal points alone, of which nothing is traced, have no error.

    Notes
    -----
    Ignores the errors of which only bounds are known, so that the true one is larger.
    """
    blocks = _number(_part(raw.metadata, "sampling"), "block_error_db")
    rays = _subsets_db(raw)
    known = [10.0 ** (0.1 * error) for error in (blocks, rays) if not math.isnan(error)]
    if known:
        return 10.0 * math.log10(max(sum(known), 1e-60))
    return -math.inf if _number(_part(raw.metadata, "statistics"), "rays") == 0.0 else math.nan


def _subsets_db(raw: RawData) -> float:
    """Error of ray sampling, dB, in the worst channel; NaN where subsets were not kept."""
    errors = []
    for channel in raw.channels:
        picks = [
            [i for i, la in enumerate(raw.layers) if la.channel == channel and la.subset == subset]
            for subset in (1, 2)
        ]
        if not all(picks):
            return math.nan
        apart = energy = 0.0
        for start in range(0, raw.data.shape[1], _PULSES):
            some = raw.data[:, start : start + _PULSES]
            first, second = (some[i].sum(axis=0, dtype=np.complex64) for i in picks)
            energy += _energy(first + second)
            apart += _energy(first / (2.0 * SUBSET_SHARES[1]) - second / (2.0 * SUBSET_SHARES[2]))
        if energy > 0.0:
            errors.append(10.0 * math.log10(max(apart / energy, 1e-60)))
    return max(errors, default=math.nan)


def _energy(data: C64) -> float:
    return float(np.vdot(data, data).real)


def _part(metadata: Mapping[str, object], name: str) -> Mapping[str, object]:
    found = metadata.get(name)
    return found if isinstance(found, Mapping) else {}


def _number(facts: Mapping[str, object], name: str) -> float:
    value = facts.get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
