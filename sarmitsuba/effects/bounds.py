"""Upper bounds of coherent returns from the geometry alone: fringes of sharp metal edges, and rough faces.

Fringes are bounded over an aperture, faces in one resolution cell.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import PilotResult, SceneContext
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.wedge import LARGEST_FRINGE, fringe_bound
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges

# margin of the fringe coefficients between two examined positions, amplitude
MARGIN = 1.15
# fringe amplitudes computed at once: few edges from all positions, or many from one
_TOGETHER = 1 << 12


@dataclass(frozen=True, eq=False)
class Aperture:
    """Examined antenna positions in turn, and the size of a resolution cell.

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
    r"""Upper bounds of the contribution of each edge to a resolution cell and to the image.

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
    """Replace the largest fringe amplitudes (positions, n) of the edges with the largest bounds by computed ones."""
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

    By the displacement of :class:`sarmitsuba.tracing.scatterers.edges.edge_currents.PlateRim`, with :math:`b \ln(1 / b)
    < 0.4` for every sine b, and physical optics on the narrow face.
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


# nodes of the table of sigma0, 0 to 90 degrees
_NODES = 91


@dataclass(frozen=True, eq=False)
class FacetBound:
    """Largest coherent return of a resolution cell after one bounce, over all faces and the aperture.

    Parameters
    ----------
    cross_section : m^2
    over_own_clutter_db : over the diffuse return of the same face and area, dB
    specular : m^2, sum over all cells on faces that may be perpendicular to the line of sight
    specular_over_own_clutter_db : ``over_own_clutter_db`` of these faces alone
    """

    cross_section: float
    over_own_clutter_db: float
    specular: float
    specular_over_own_clutter_db: float


def angles_known(context: SceneContext) -> bool:
    """Whether the angles of the faces to the line of sight are known: one antenna, no motion, a thorough analysis."""
    scene = context.scene
    return context.shape.thorough and scene.radar.receiver is None and not scene.geometry.moves


def facet_bound(context: SceneContext, *, least_height: float = 0.0) -> FacetBound:
    r"""Bound of the physical-optics return of a resolution cell on a plane face.

    .. math:: \sigma \le \frac{4 \pi}{\lambda^2} \cos^2\theta \, e^{-4 (k s \cos\theta)^2}
        \min\left(A, \frac{\max(2 d, A p / A_f)}{2 k \sin\theta}\right)^2, \quad
        A = \delta_a \frac{\delta_r}{\sin\theta}

    The cell's part of the face has the area A and the diagonal d; it is as long as the scene at most, since all of a
    face perpendicular to the line of sight lies in one range cell. The phase integral over a polygon is at most its
    perimeter over the tangential wave vector (Green's theorem): two edges of a large face pass through the cell, or
    the perimeters ``p`` of all faces of area ``A_f`` in it. The angle is the least and the greatest within the face
    and between the examined antenna positions.

    Parameters
    ----------
    context : with its sampling
    least_height : m; faces of smaller rms height are left out

    Notes
    -----
    Ignores shadowing. Every angle counts where those of the faces are not known.
    """
    if context.sampling is None:
        return FacetBound(np.inf, np.inf, np.inf, np.inf)
    if not angles_known(context):
        return _bound_any_angle(context, least_height)
    shape = context.shape
    sine, nearest, farthest = shape.incidence_bounds
    largest, ratio, total, towards = 0.0, -np.inf, 0.0, -np.inf
    for index in np.unique(shape.material):
        of = (shape.material == index) & (shape.areas > 0)
        if not of.any() or _height(context, int(index)) < least_height:
            continue
        length = _length(context, sine[of])
        cell = length * _width(context)
        edges = np.maximum(
            2.0 * np.hypot(length, _width(context)), cell * shape.perimeters[of] / shape.areas[of]
        )
        with np.errstate(divide="ignore"):
            limited = edges / (2.0 * context.wavenumber * sine[of])
        sigma, own = _returns(context, int(index), np.minimum(cell, limited), farthest[of], nearest[of])
        largest, ratio = max(largest, float(sigma.max())), max(ratio, _worst_ratio_db(sigma, own * cell))
        whole = limited >= cell
        total += float((sigma * shape.areas[of] / cell)[whole].sum())
        if whole.any():
            towards = max(towards, _worst_ratio_db(sigma[whole], (own * cell)[whole]))
    return FacetBound(largest, ratio, total, towards)


def specular_db(context: SceneContext, pilot: PilotResult, bound: FacetBound) -> float:
    """Bound of the energy of specular faces over that of the clutter of the whole scene, dB."""
    clutter = mean_clutter(context, pilot)
    if context.sampling is None or not clutter > 0.0:
        return np.inf
    cells = max(1.0, float((np.ptp(context.box, axis=0)[:2] / context.sampling.cell).prod()))
    return db_from_power(max(bound.specular / (cells * clutter), 1e-30))


def mean_clutter(context: SceneContext, pilot: PilotResult) -> float:
    """Mean diffuse return of a resolution cell, by the pilot, m^2; 0 where it is not known."""
    if context.sampling is None or not pilot.clutter > 0.0:
        return 0.0
    return pilot.clutter / pilot.patch_area * context.sampling.cell_across


def flash_bound(context: SceneContext, bounces: int) -> float:
    r"""Bound (m^2) of the return of a cell where every bounce of a path of 2 to ``bounces`` is specular.

    The wave vectors that the bounces transfer add up to 2 k, and each costs its own roughness loss, so that together
    these are at least :math:`4 (k s)^2 / n` for n bounces on surfaces of rms height ``s`` or more.

    Parameters
    ----------
    context : with its sampling
    bounces : most of a path, at least 1
    """
    if context.sampling is None:
        return np.inf
    if bounces < 2:
        return 0.0
    least = min((m.rms_height for m in context.materials), default=0.0)
    loss = 4.0 * (_lowest_wavenumber(context) * least) ** 2 / bounces
    wavelength = context.scene.radar.waveform.wavelength
    area = float(_length(context, np.zeros(1))[0]) * _width(context)
    return float(4.0 * np.pi * area**2 / wavelength**2 * np.exp(-loss))


def _width(context: SceneContext) -> float:
    """Extent of a resolution cell along azimuth, m."""
    assert context.sampling is not None
    return max(context.sampling.azimuth_cell, context.sampling.ray_spacing)


def _length(context: SceneContext, sine: F64) -> F64:
    """Extent of a resolution cell on a face across azimuth, for sines of the incidence angle, m."""
    assert context.sampling is not None
    whole = float(np.linalg.norm(np.ptp(context.box, axis=0)))
    length = max(context.sampling.range_cell, context.sampling.ray_spacing) / np.maximum(sine, 1e-12)
    return np.asarray(np.minimum(length, whole))


def _lowest_wavenumber(context: SceneContext) -> float:
    """Wavenumber at the lower end of the band, rad/m."""
    waveform = context.scene.radar.waveform
    return context.wavenumber * (1.0 - 0.5 * waveform.bandwidth / waveform.center_frequency)


def _height(context: SceneContext, index: int) -> float:
    """Least rms height of a material and those of its maps, m."""
    return min(m.rms_height for m in list_with_parts([context.scene.materials[index]]))


def _bound_any_angle(context: SceneContext, least_height: float) -> FacetBound:
    """Bound where a face may have any angle up to the greatest of the scene."""
    low, cell = np.array([context.incidence_cosine[0]]), _length(context, np.zeros(1)) * _width(context)
    largest, ratio, total = 0.0, -np.inf, 0.0
    for index in np.unique(context.shape.material):
        if _height(context, int(index)) < least_height:
            continue
        sigma, own = _returns(context, int(index), cell, low, np.ones(1))
        largest, ratio = max(largest, float(sigma[0])), max(ratio, _worst_ratio_db(sigma, own * cell))
        total += float((sigma / cell)[0] * context.shape.areas[context.shape.material == index].sum())
    return FacetBound(largest, ratio, total, ratio)


def _returns(context: SceneContext, index: int, integral: F64, low: F64, high: F64) -> tuple[F64, F64]:
    """Bound of the coherent return, m^2, and the least sigma0, for phase integrals (m^2) and ranges of the cosine."""
    wavelength = context.scene.radar.waveform.wavelength
    fall = 4.0 * (_lowest_wavenumber(context) * _height(context, index)) ** 2
    square = (
        np.clip(1.0 / fall, low**2, high**2) if fall > 0.0 else high**2
    )  # where x exp(-fall x) is largest
    sigma = 4.0 * np.pi / wavelength**2 * np.square(integral) * square * np.exp(-fall * square)
    sigma0 = np.full(len(low), np.inf)
    for m in list_with_parts([context.scene.materials[index]]):
        table = diffuse_tables(m, wavelength, _NODES)
        power = np.square(np.minimum(table.amplitude_h, table.amplitude_v))
        first = np.searchsorted(table.theta, np.arccos(high), side="right") - 1
        last = np.searchsorted(table.theta, np.arccos(low))
        sigma0 = np.minimum(sigma0, _least_between(power, first, np.minimum(last, _NODES - 1)))
    return sigma, sigma0


def _least_between(values: F64, first: NDArray[np.int64], last: NDArray[np.int64]) -> F64:
    """Least of ``values[first : last + 1]`` for each pair."""
    least = np.full((len(values), len(values)), np.inf)
    for i in range(len(values)):
        least[i, i:] = np.minimum.accumulate(values[i:])
    return np.asarray(least[first, last])


def _worst_ratio_db(sigma: F64, own: F64) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(sigma > 0, sigma / own, 0.0)
        return db_from_power(float(ratio.max()))
