"""Surface maps: placement of bitmaps on surfaces, and the gamma texture of clutter."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import SceneError

# texels of the lookup for a mesh attribute of 0 to 1
ATTRIBUTE_TEXELS = 256
# tolerance of an attribute's bounds: rounding of float32
_ATTRIBUTE_SLACK = 1e-5
# bounds of the shape parameter: below, one cell in a million holds the power; above, the texture is negligible (-30 dB)
LEAST_SHAPE, GREATEST_SHAPE = 0.05, 1e3


@dataclass(frozen=True, eq=False)
class Placement:
    r"""Placement of a bitmap on a surface.

    .. math:: (u, v) = M (a, b, 1)^T

    with a and b east and north in the scene frame (m), or attributes of the mesh. The bitmap covers the unit square;
    its first row begins at v = 0.

    Parameters
    ----------
    matrix : (2, 3) float64
    attributes : of the mesh, which give a and b: ``("uv",)``, or one or two scalar ones; empty: plan view from above
    """

    matrix: F64
    attributes: tuple[str, ...] = ()

    def at(self, triangles: F64, values: Mapping[str, F64]) -> F64:
        """Coordinates u and v of the corners of triangles, (n, 3, 2) float64.

        Parameters
        ----------
        triangles : (n, 3, 3) float64, m, scene frame
        values : of attributes at the same corners, (n, 3, 2) for ``uv`` and (n, 3, 1) for scalar ones

        Raises
        ------
        SceneError : the mesh lacks an attribute, or one leaves 0 ... 1
        """
        parts = [triangles[..., :2]] if not self.attributes else []
        for name in self.attributes:
            given = values.get(name)
            if given is None or np.isnan(given).any():
                raise SceneError(
                    f'a map needs the mesh attribute "{name}", which the mesh lacks; add it to every mesh of the '
                    "material, or give map_extent"
                )
            if name != "uv" and not (np.abs(given - 0.5) <= 0.5 + _ATTRIBUTE_SLACK).all():
                low, high = float(given.min()), float(given.max())
                raise SceneError(
                    f'the attribute "{name}" has values from {low:g} to {high:g}, outside 0 to 1; scale it, and set '
                    "the map's range to the values of 0 and 1"
                )
            parts.append(given)
        ab = np.concatenate([*parts, np.zeros((*triangles.shape[:2], 2))], axis=-1)[..., :2]
        return np.asarray(ab @ self.matrix[:, :2].T + self.matrix[:, 2])

    def moved(self, offset: F64) -> "Placement":
        """Placement in a scene frame whose origin is at ``offset``, (3,) m."""
        if self.attributes:
            return self
        matrix = self.matrix.copy()
        matrix[:, 2] += matrix[:, :2] @ offset[:2]
        return replace(self, matrix=matrix)


def place_in_plan(extent: Sequence[float], transform: ArrayLike | None = None) -> "Placement":
    """Placement of a bitmap over the scene in plan view, its first row along the northern edge.

    Parameters
    ----------
    extent : x and y of its south-western corner, then of its north-eastern one, m, file frame
    transform : (3, 3) applied to u and v afterwards, as Mitsuba's ``to_uv``

    Raises
    ------
    SceneError : the extent has no area
    """
    west, south, east, north = (float(x) for x in extent)
    if not (east > west and north > south and np.isfinite([west, south, east, north]).all()):
        raise SceneError(
            f"map extent {west:g} {south:g} {east:g} {north:g} m has no area; give x and y of the south-western "
            "corner, then of the north-eastern one"
        )
    width, height = east - west, north - south
    plain = np.array(
        [[1.0 / width, 0.0, -west / width], [0.0, -1.0 / height, north / height], [0.0, 0.0, 1.0]]
    )
    return Placement(_transform_plain(plain, transform))


def place_on_mesh(attributes: tuple[str, ...], transform: ArrayLike | None = None) -> "Placement":
    """Placement of a bitmap by the texture coordinates of the mesh (``("uv",)``), or by its scalar attributes."""
    return Placement(_transform_plain(np.eye(3), transform), attributes)


def _transform_plain(plain: F64, transform: ArrayLike | None) -> F64:
    after = np.eye(3) if transform is None else np.asarray(transform, dtype=np.float64)
    return np.asarray((after @ plain)[:2])


@dataclass(frozen=True, eq=False)
class Bitmap:
    """Bitmap of values over a surface.

    Parameters
    ----------
    values : (n_rows, n_columns), first row at v = 0
    placement : of its texels
    repeat : periodic beyond its edges; else continued with its outermost texels
    smooth : bilinear between the texel centres; else constant within each
    """

    values: F64 | I64
    placement: Placement
    repeat: bool = False
    smooth: bool = False


# ---- gamma texture

# range of the normal field in the table of its gamma quantiles, and nodes
FIELD_LIMIT, QUANTILE_NODES = 6.0, 1024


def texture_amplitudes(shape: float) -> F64:
    r"""Square root of the gamma texture as a function of the normal field, (``QUANTILE_NODES``,) float64.

    .. math:: \tau = F_\nu^{-1}(\Phi(g))

    with the gamma distribution F of unit mean and shape nu: whatever the field's correlation, a texture made from
    standard normal numbers g follows the gamma law exactly. Nodes are uniform in g from ``-FIELD_LIMIT`` to
    ``FIELD_LIMIT``.

    References
    ----------
    Tough and Ward, "The correlation properties of gamma and other non-Gaussian processes generated by memoryless
    nonlinear transformation", J. Phys. D 32 (1999) 3075, section 2.
    """
    g = np.linspace(-FIELD_LIMIT, FIELD_LIMIT, QUANTILE_NODES)
    return np.sqrt(_texture(g, shape))


def _texture(g: F64, shape: float) -> F64:
    # from the tail of small probability: 1 - Phi(6) = 1e-9 would be lost to rounding in Phi(6)
    low = scipy.special.gammaincinv(shape, scipy.special.ndtr(np.minimum(g, 0.0)))
    high = scipy.special.gammainccinv(shape, scipy.special.ndtr(-np.maximum(g, 0.0)))
    return np.asarray(np.where(g < 0.0, low, high) / shape)


def spline_weights(t: F64) -> F64:
    """Weights (..., 3) of the nodes before, at and after the nearest one, ``t`` = -1/2 ... 1/2 from it.

    Quadratic B-spline over the root of the sum of the squares: the field then has unit variance at every place.
    """
    w = np.stack([0.5 * (0.5 - t) ** 2, 0.75 - t * t, 0.5 * (0.5 + t) ** 2], axis=-1)
    return np.asarray(w / np.sqrt(np.square(w).sum(axis=-1, keepdims=True)))


@cache
def node_spacing(shape: float) -> float:
    """Distance between the nodes of the field over the texture's correlation length, where it falls to 1/e.

    Mean over places and directions; the field's correlation is that of the splines, the texture's follows from it by
    the Hermite series of Tough and Ward, equation 13.
    """
    lag = np.linspace(0.0, 2.5, 101)
    field = _field_correlation(lag)
    g = np.linspace(-8.0, 8.0, 4001)
    density = np.exp(-0.5 * g * g) / np.sqrt(2.0 * np.pi) * (g[1] - g[0])
    tau = _texture(g, shape)
    # a_n = E[tau h_n] with normalised Hermite polynomials h_n
    before, this, series = np.zeros_like(g), np.ones_like(g), []
    for n in range(60):
        series.append(float(np.sum(density * tau * this)))
        before, this = this, (g * this - np.sqrt(n) * before) / np.sqrt(n + 1.0)
    power = np.square(series[1:])
    rho = (power * np.power.outer(field, np.arange(1, 60))).sum(axis=-1) / power.sum()
    at = float(np.interp(-np.exp(-1.0), -rho, lag))
    return 1.0 / at


def _field_correlation(lag: F64) -> F64:
    """Correlation of the normal field at lags in spacings of its nodes, mean over places and directions."""
    place = np.asarray((np.arange(16) + 0.5) / 16.0 - 0.5, dtype=np.float64)
    total = np.zeros_like(lag)
    angles = np.radians(np.arange(3.75, 45.0, 7.5))  # the lattice is symmetric beyond
    for angle in angles.tolist():
        along, across = (_line_correlation(place, lag * part) for part in (math.cos(angle), math.sin(angle)))
        total += along * across
    return total / len(angles)


def _line_correlation(place: F64, lag: F64) -> F64:
    """Correlation along one axis, mean over places: sum over common nodes of the products of both weights."""
    ends = place[:, None] + lag
    node = np.rint(ends)
    one, other = spline_weights(place), spline_weights(ends - node)
    total = np.zeros(ends.shape)
    for i in range(3):
        for j in range(3):
            common = node + j == i
            total += np.where(common, one[:, None, i] * other[..., j], 0.0)
    return np.asarray(total.mean(axis=0))


def check_texture(shape: float, length: float, where: str) -> None:
    """Raise a SceneError unless shape and correlation length (m) are both given or both 0."""
    if (shape > 0.0) != (length > 0.0):
        given, missing = (
            ("texture_shape", "texture_length") if shape > 0.0 else ("texture_length", "texture_shape")
        )
        raise SceneError(f"{where}: {given} is given without {missing}; give both, or none")
    if shape > 0.0 and not LEAST_SHAPE <= shape <= GREATEST_SHAPE:
        raise SceneError(
            f"{where}: texture_shape = {shape:g} is not between {LEAST_SHAPE:g} and {GREATEST_SHAPE:g}; give one "
            "within, or leave the texture out for a homogeneous surface"
        )
