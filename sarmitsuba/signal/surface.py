"""Polynomial over two variables through values at scattered places."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from sarmitsuba.core.arrays import F64

_DEGREE = 6
Span = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Surface:
    """Polynomial of degree 6 in each of two variables, which are scaled to -1 ... 1.

    Parameters
    ----------
    spans : smallest value and extent of each variable
    table : (7, 7) float64, Chebyshev coefficients
    """

    spans: tuple[Span, Span]
    table: F64

    @staticmethod
    def fit(x: F64, y: F64, value: F64) -> "Surface":
        """Least squares through values at (n,) places."""
        first, second = ((float(axis.min()), float(max(np.ptp(axis), 1e-12))) for axis in (x, y))
        terms = chebyshev.chebvander2d(_scale(x, first), _scale(y, second), [_DEGREE, _DEGREE])
        found, *_ = np.linalg.lstsq(terms, value, rcond=1e-13)
        return Surface((first, second), np.asarray(found.reshape(_DEGREE + 1, _DEGREE + 1)))

    def at(self, x: F64, y: F64) -> F64:
        """Values at places (n,)."""
        return np.asarray(chebyshev.chebval2d(_scale(x, self.spans[0]), _scale(y, self.spans[1]), self.table))

    def on(self, x: F64, y: F64) -> F64:
        """Values at all pairs of x (n,) and y (m,), (n, m)."""
        return np.asarray(
            chebyshev.chebgrid2d(_scale(x, self.spans[0]), _scale(y, self.spans[1]), self.table)
        )


def chebyshev_nodes(n: int) -> F64:
    """Places (n,) from 0 to 1, denser at the ends, at which a polynomial is fitted without ripple."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(n) / (n - 1)))


def _scale(x: F64, span: Span) -> F64:
    return np.asarray((x - span[0]) * (2.0 / span[1]) - 1.0)
