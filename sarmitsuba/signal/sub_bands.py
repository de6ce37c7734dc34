"""Wide bands: amplitudes traced at a few frequencies and interpolated by a polynomial in between."""

from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
import scipy
from numpy.polynomial import legendre

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT


class RangeFilter(Protocol):
    """Factor on the spectrum of range profiles."""

    def __call__(self, cycles_per_metre: F64) -> F64 | C128:
        """Factor at frequencies of the baseband profile along slant range, 1/m, of the same shape."""


@dataclass(frozen=True)
class SubBands:
    r"""Frequencies at which the scene is traced, and the share of each in the spectrum.

    Without the phase :math:`e^{-j 4 \pi f R / c}` of its slant range, the amplitude A(f) of an echo is smooth.
    It is traced at the Chebyshev points of the band,

    .. math:: f_i = f_c + \tfrac B 2 \cos(\pi (2 i + 1) / 2 n), \quad
              A(f) = \sum_i A(f_i) \, \ell_i(f), \quad \ell_i(f) = \prod_{j \ne i} \frac{f - f_j}{f_i - f_j}

    Powers of f up to :math:`f^{n-1}` are exact. One frequency is the carrier.

    Parameters
    ----------
    center_frequency, bandwidth : Hz
    count : n
    """

    center_frequency: float
    bandwidth: float
    count: int = 1

    @property
    def frequencies(self) -> F64:
        """Traced frequencies (n,), Hz, ascending; the carrier if there is only one."""
        return self.center_frequency + 0.5 * self.bandwidth * self._nodes

    @property
    def _nodes(self) -> F64:
        return np.asarray(-np.cos(np.pi * (2 * np.arange(self.count) + 1) / (2 * self.count)))

    def shares(self, frequency: F64) -> F64:
        """Share (n, m) of each traced frequency at m frequencies, Hz; constant beyond the band's edges."""
        u = np.clip((frequency - self.center_frequency) / (0.5 * self.bandwidth), -1.0, 1.0)
        nodes, out = self._nodes, np.ones((self.count, len(u)))
        for i, node in enumerate(nodes):
            others = np.delete(nodes, i)
            out[i] = np.prod((u[:, None] - others) / (node - others), axis=1)
        return out

    def response(self, index: int, cells: F64) -> C128:
        r"""Range-compressed response to one traced frequency's share of the band, at distances in range cells.

        With the Legendre series of the share, and spherical Bessel functions,

        .. math:: \ell_i(f) = \sum_k a_k P_k(u), \quad \tfrac12 \int_{-1}^1 \ell_i e^{j \pi u x} du
                  = \sum_k a_k j^k j_k(\pi x)
        """
        series = legendre.legfit(self._nodes, np.eye(self.count)[index], self.count - 1)
        out = np.zeros(cells.shape, dtype=np.complex128)
        for k, a in enumerate(series):
            value = scipy.special.spherical_jn(k, np.pi * np.abs(cells))
            out += a * 1j**k * np.where(cells < 0.0, (-1.0) ** k, 1.0) * value
        return out

    def range_filter(self, index: int) -> RangeFilter | None:
        """Share of one traced frequency as a factor on the spectrum of range profiles; None for a single frequency."""
        return None if self.count == 1 else partial(self._phase_of_range, index)

    def _phase_of_range(self, index: int, cycles_per_metre: F64) -> F64:
        every = self.shares(self.center_frequency + 0.5 * SPEED_OF_LIGHT * cycles_per_metre)
        return np.asarray(every[index])
