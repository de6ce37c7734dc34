"""Ray tubes: the footprint of a ray on a facet and the phase integral over it."""

from typing import Any

Vector = Any


def footprint(edge: Vector, d: Vector, n: Vector, cos_theta: Any, dr: Any) -> Vector:
    """Project a tube's edge vector along the ray ``d`` onto the tangent plane of normal ``n``.

    ``cos_theta = -d . n > 0``.
    """
    return edge + d * (dr.dot(edge, n) / cos_theta)


def sinc(x: Any, dr: Any) -> Any:
    """``sin x / x`` with a series near zero, where the quotient loses digits."""
    small = dr.abs(x) < 1e-2
    safe = dr.select(small, 1.0, x)
    x2 = x * x
    return dr.select(small, 1.0 - x2 * (1.0 / 6.0) * (1.0 - x2 * 0.05), dr.sin(safe) / safe)


def phase_integral(q: Vector, u: Vector, v: Vector, dr: Any) -> Any:
    """Mean of ``exp(j q . r)`` over the parallelogram of edges ``u, v`` about its centre."""
    return sinc(0.5 * dr.dot(q, u), dr) * sinc(0.5 * dr.dot(q, v), dr)
