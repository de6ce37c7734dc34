"""Upper bounds of the fringe returns of sharp metal edges over an aperture, from the geometry alone."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.scene.materials.wedge import LARGEST_FRINGE, fringe_bound
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges

# margin of the fringe coefficients between two examined positions, amplitude
MARGIN = 1.15
# fringe amplitudes computed at once: few edges from all positions, or many from one
_TOGETHER = 1 << 12


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


@dataclass(frozen=True, eq=False)
class EdgeBounds:
    """Upper bounds of the returns of edges, m^2, (n,) float64 each.

    Parameters
    ----------
    cell : RCS in a resolution cell, the largest from any examined position
    energy : of the whole edge in the image, in resolution cells times m^2: mean over the aperture of its echo's RCS
    """

    cell: F64
    energy: F64


def edge_bounds(
    edges: SharpEdges,
    aperture: Aperture,
    mirrors: tuple[bool, bool] = (False, False),
    *,
    examined: int | None = None,
) -> EdgeBounds:
    r"""Upper bounds of what each edge adds to a resolution cell and to the image.

    .. math:: \sigma \le \tfrac1\pi |S|^2 \min\left(l, l_\mathrm{cell}, \frac1{k |g|}\right)^2, \quad
        E \le \tfrac1\pi \left\langle |S|^2 \min\left(l^2, \frac1{(k g)^2}, \frac{\pi l}{k |\Delta g|}\right)
        \right\rangle, \quad g = \tfrac12 \hat t \cdot (\hat u + \hat v)

    with the least :math:`|g|` at both ends of the edge and over all directions between two examined positions, and
    :math:`|S|` of :func:`sarmitsuba.scene.materials.wedge.fringe_bound`. A cell holds the part :math:`l_\mathrm{cell}`
    of an
    edge, limited by its extent in range and along azimuth. The energy is the mean over the intervals between examined
    positions, in which g changes by :math:`\Delta g`: by Parseval's theorem the mean of :math:`l^2
    \mathrm{sinc}^2(k g l)` over g is at most :math:`\pi l / (k |\Delta g|)`.

    Parameters
    ----------
    edges : whole edges
    aperture : see :class:`Aperture`
    mirrors : whether the leg from the transmitter, and that to the receiver, is mirrored in level ground, which
        reflects everything
    examined : number of edges, those with the largest bounds, whose :math:`|S|` is computed; others have
        :math:`|S| \le 3.6 / |\hat u + \hat v|`. None: all. Rims of plates have more by their thickness

    Notes
    -----
    Ignores shadowing, ground that is not level, and motion. Edges count as if their energies added up.
    """
    half = 0.5 * edges.length[:, None] * edges.along
    points = np.stack([edges.middle - half, edges.middle + half, edges.middle], axis=1)
    same = aperture.receivers is aperture.places and mirrors[0] == mirrors[1]
    count = len(aperture.places)
    part, whole, size = (np.empty((count, edges.n)) for _ in range(3))
    added = _plate(edges, aperture.wavenumber)
    before = None
    for i, (place, receiver, azimuth) in enumerate(
        zip(aperture.places, aperture.receivers, aperture.azimuth, strict=True)
    ):
        sums = _looks(points, place, mirrors[0])
        if not same:
            sums = 0.5 * (sums + _looks(points, receiver, mirrors[1]))
        lean = np.einsum("nei,ni->en", sums, edges.along)
        low, high = np.minimum(lean[0], lean[1]), np.maximum(lean[0], lean[1])
        swept = 0.0
        if before is not None:
            low, high = np.minimum(low, before[0]), np.maximum(high, before[1])
            swept = np.abs(lean[2] - before[2])
        before = np.minimum(lean[0], lean[1]), np.maximum(lean[0], lean[1]), lean[2]
        least = np.where(low * high <= 0.0, 0.0, np.minimum(np.abs(low), np.abs(high)))
        middle = sums[:, 2]
        along = np.maximum(np.linalg.norm(middle, axis=1), 1e-9)
        turned = np.abs(edges.along @ azimuth - lean[2] * (middle @ azimuth) / np.square(along))
        reach = np.minimum(edges.length, 1.0 / np.maximum(aperture.wavenumber * least, 1e-12))
        part[i] = np.minimum(reach, aperture.range_cell / np.maximum(least, 1e-12))
        part[i] = np.minimum(part[i], aperture.azimuth_cell / np.maximum(turned, 1e-12))
        passed = np.pi * edges.length / np.maximum(aperture.wavenumber * swept, 1e-12)
        whole[i] = np.minimum(np.square(reach), passed)
        size[i] = LARGEST_FRINGE / along + added
    _examine(edges, aperture, mirrors, part, size, edges.n if examined is None else examined)
    between = np.maximum(size[1:], size[:-1]) if count > 1 else size
    cell = np.square(MARGIN * size * part).max(axis=0) / np.pi
    energy = (np.square(MARGIN * between) * whole[-len(between) :]).mean(axis=0) / np.pi
    return EdgeBounds(cell, energy)


def _examine(
    edges: SharpEdges, aperture: Aperture, mirrors: tuple[bool, bool], part: F64, size: F64, most: int
) -> None:
    """Replace the largest fringe amplitudes (positions, n) of the edges with the largest bounds by their own."""
    rank = (size * part).max(axis=0, initial=0.0)
    rows = np.arange(edges.n) if most >= edges.n else np.argpartition(-rank, most)[:most]
    if not rows.size:
        return
    chosen, middle = edges.of(rows), edges.middle[None, rows]
    same = aperture.receivers is aperture.places and mirrors[0] == mirrors[1]
    step = max(1, _TOGETHER // rows.size)
    for first in range(0, len(size), step):
        some = slice(first, first + step)
        out = _looks(middle, aperture.places[some, None], mirrors[0])
        count, out = len(out), out.reshape(-1, 3)
        home = out
        if not same:
            home = _looks(middle, aperture.receivers[some, None], mirrors[1]).reshape(-1, 3)
        angle, inward, normal = (
            np.concatenate([values] * count) for values in (chosen.angle, chosen.inward, chosen.normal)
        )
        found = fringe_bound(angle, inward, normal, out, home).reshape(count, -1)
        size[some, rows] = found + _plate(chosen, aperture.wavenumber)


def _plate(edges: SharpEdges, wavenumber: float) -> F64:
    r"""Largest amplitude (n,) that the thickness of plates adds to their rims, unit of ``fringe_bound``.

    By the displacement of :class:`sarmitsuba.tracing.scatterers.edges.plate_rims.PlateRim`, with :math:`b \ln(1 / b) <
    0.4` for every sine b, and physical optics on the narrow face.
    """
    t = wavenumber * edges.thickness
    thick = np.where(t > 0.0, t, 1.0)
    displaced = t / np.pi * (1.0 + np.abs(np.log(2.0 * np.pi / thick)) + 0.4 + 0.5 * np.pi)
    return np.asarray(np.where(t > 0.0, displaced * edges.parts[:, 0] + t * edges.parts.max(axis=1), 0.0))


def _looks(points: F64, place: F64, mirrored: bool) -> F64:
    """Unit vectors (n, m, 3) from points to an antenna, or to its image in level ground; both may be broadcast."""
    look = place - points
    look = unit_rows(look)
    return look * np.array([1.0, 1.0, -1.0]) if mirrored else look
