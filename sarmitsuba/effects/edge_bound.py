"""Upper bounds of the fringe returns of sharp metal edges over an aperture, from the geometry alone."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.arrays import F64
from sarmitsuba.materials.wedge import fringe_bound
from sarmitsuba.mesh.sharp_edges import SharpEdges

# margin of the fringe coefficients between two examined positions, amplitude
MARGIN = 1.15


@dataclass(frozen=True, eq=False)
class Aperture:
    """Examined antenna positions in turn, and what a resolution cell holds.

    Parameters
    ----------
    places, receivers : (n, 3) float64, m, of both antennas; the same array where one flies
    azimuth : (n, 3) float64, unit vectors along the track
    wavenumber : rad/m
    azimuth_cell, range_cell : m, slant range; infinite where an image has no cells
    """

    places: F64
    receivers: F64
    azimuth: F64
    wavenumber: float
    azimuth_cell: float
    range_cell: float


def edge_bounds(edges: SharpEdges, aperture: Aperture, mirrors: tuple[bool, bool] = (False, False)) -> F64:
    r"""Upper bound of the RCS, m^2, that each edge adds to a resolution cell, from all examined positions.

    .. math:: \sigma \le \tfrac1\pi |S|^2 \min\left(l, l_\mathrm{cell}, \frac1{k |g|}\right)^2, \quad
        g = \tfrac12 \hat t \cdot (\hat u + \hat v)

    with the least :math:`|g|` at both ends of the edge and over all directions between two examined positions, and
    :math:`|S|` of :func:`sarmitsuba.materials.wedge.fringe_bound`. A cell holds the part :math:`l_\mathrm{cell}` of an
    edge, limited by its extent in range and along azimuth.

    Parameters
    ----------
    edges : whole edges
    aperture : see :class:`Aperture`
    mirrors : whether the leg from the transmitter, and that to the receiver, is mirrored in level ground, which
        reflects everything

    Notes
    -----
    Ignores shadowing, ground that is not level, and motion.
    """
    best, before = np.zeros(edges.n), None
    half = 0.5 * edges.length[:, None] * edges.along
    points = np.stack([edges.middle - half, edges.middle + half, edges.middle], axis=1)
    same = aperture.receivers is aperture.places and mirrors[0] == mirrors[1]
    for place, receiver, azimuth in zip(aperture.places, aperture.receivers, aperture.azimuth, strict=True):
        out = _looks(points, place, mirrors[0])
        home = out if same else _looks(points, receiver, mirrors[1])
        sums = 0.5 * (out + home)
        lean = np.einsum("nei,ni->ne", sums[:, :2], edges.along)
        both = lean if before is None else np.concatenate([lean, before], axis=1)
        before = lean
        low, high = both.min(axis=1), both.max(axis=1)
        least = np.where(low * high <= 0.0, 0.0, np.minimum(np.abs(low), np.abs(high)))
        middle = sums[:, 2]
        along = np.maximum(np.linalg.norm(middle, axis=1), 1e-9)
        sideways = azimuth - middle * ((middle @ azimuth) / np.square(along))[:, None]
        turned = np.abs(np.einsum("ni,ni->n", sideways, edges.along))
        part = np.minimum(edges.length, aperture.range_cell / np.maximum(least, 1e-12))
        part = np.minimum(part, aperture.azimuth_cell / np.maximum(turned, 1e-12))
        part = np.minimum(part, 1.0 / np.maximum(aperture.wavenumber * least, 1e-12))
        leaving, coming = out[:, 2], home[:, 2]
        size = (
            MARGIN
            * part
            * fringe_bound(edges.angle, edges.inward, edges.normal, leaving, leaving if same else coming)
        )
        best = np.maximum(best, np.square(size) / np.pi)
    return best


def _looks(points: F64, place: F64, mirrored: bool) -> F64:
    """Unit vectors (n, m, 3) from points to an antenna, or to its image in level ground."""
    look = place - points
    look /= np.linalg.norm(look, axis=2, keepdims=True)
    return look * np.array([1.0, 1.0, -1.0]) if mirrored else look
