"""Expected level of the waves from the edges of one metal body that reach the radar by way of another one."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.effects.omitted_waves import PLANE, MetalLines, coherent_square, soft_share
from sarmitsuba.scene.mesh.pieces import SMOOTH_BEND
from sarmitsuba.scene.mesh.sharp_edges import WIDEST_GAP
from sarmitsuba.scene.mesh.topology import edge_pairs, label_connected, weld

# points on lines, faces examined with all of them (the largest flat ones, and as many curved ones), other flat faces
# that are examined with the points nearest to them, and products of directions with pairs of both at most
MOST_POINTS, MOST_FACES, NEAREST, MOST_PRODUCTS = 300, 400, 16, 500_000
# wavelengths, least height of a point above the plane of another body's face
ABOVE = 1e-3
# least cosine of incidence on a face
GRAZING = 0.05
# cosine of the angle between two faces that keep a wave between them
FACING = 0.94


@dataclass(frozen=True)
class BetweenLaws:
    r"""Amplitudes of waves between bodies, for the electric field across an edge and along it.

    Those of edges over a mirror would be 1 by the theory of diffraction; all are fitted to the method of moments for
    drawn bodies of several parts (``benchmarks/studies/theory_error.py --set assemblies``).

    Parameters
    ----------
    mirrored : of edges by way of another body's face, as :func:`waves_between` has them
    edges : of an edge that is lit by another body's edge, at k d = 1; the electric field across both is weak
    zone : largest part of a Fresnel zone that a shadow's edge is worth
    """

    mirrored: tuple[float, float] = (1.1, 1.3)
    edges: float = 0.65
    zone: float = 0.7


LAWS = BetweenLaws()


@dataclass(frozen=True, eq=False)
class MetalFaces:
    """Curved surface as a rectangle for each triangle, and flat faces as rectangles, the largest first.

    Parameters
    ----------
    center : (n, 3) float64, m
    axes : (n, 3, 3) float64, unit vectors along two sides, and the normal, outward where closed
    half : (n, 2) float64, m, half the sides
    fill : (n,) float64, area over that of the rectangle, times the number of faces that it stands for
    closed : (n,) bool, of a body whose inside is never seen
    curved : (n,) bool
    body : (n,) int64, number of the connected body
    """

    center: F64
    axes: F64
    half: F64
    fill: F64
    closed: NDArray[np.bool_]
    curved: NDArray[np.bool_]
    body: I64

    @property
    def n(self) -> int:
        """Number of faces."""
        return len(self.fill)

    def of(self, rows: I64, times: float = 1.0) -> "MetalFaces":
        """Selected faces, each of which stands for several."""
        chosen = MetalFaces(*(getattr(self, f.name)[rows] for f in fields(self)))
        chosen.fill[:] *= times
        return chosen


@dataclass(frozen=True, eq=False)
class WavesBetween:
    """Energy of the waves between bodies, and how far apart these are.

    Parameters
    ----------
    energy : (n_directions, n_channels) float64, m^2, as an RCS
    gap : m, mean way of the waves from an edge to another body, geometric, by energy; infinite without such waves
    """

    energy: F64
    gap: float


def metal_faces(corners: F64) -> MetalFaces:
    """Faces of triangles (n, 3, 3), m; curved ones are thinned out to ``MOST_FACES``."""
    vertex = weld(corners.reshape(-1, 3))
    first, second = edge_pairs(vertex)
    a, b = first // 3, second // 3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(twice, 1e-300)[:, None]
    bend = np.abs(np.einsum("ei,ei->e", normal[a], normal[b]))
    level = bend > 1.0 - 0.5 * PLANE**2
    n = len(corners)
    part, body = label_connected(n, a[level], b[level]), label_connected(n, a, b)
    outward = _outward(corners, normal * twice[:, None], body, np.concatenate([first, second]))
    smooth = ~level & (bend > np.cos(SMOOTH_BEND))
    curved = np.zeros(n, dtype=bool)
    curved[a[smooth]] = curved[b[smooth]] = True
    order = np.argsort(part, kind="stable")
    begin = np.flatnonzero(np.diff(part[order], prepend=-1))
    lead = order[begin]
    up = normal[lead] * np.where(outward == 0.0, 1.0, outward)[lead][:, None]
    sides = (np.roll(corners, -1, axis=1) - corners)[lead]
    sides = unit_rows(sides)
    half, center, axes = (
        np.full((lead.size, 2), np.inf),
        np.zeros((lead.size, 3)),
        np.zeros((lead.size, 3, 3)),
    )
    for i in range(3):  # the smallest rectangle along a side of the first triangle
        frame = np.stack([sides[:, i], np.cross(up, sides[:, i]), up], axis=1)
        place = np.einsum("tci,tai->tca", corners[order], frame[part[order]])
        low = np.minimum.reduceat(place.min(axis=1), begin)
        high = np.maximum.reduceat(place.max(axis=1), begin)
        less = (high - low)[:, :2].prod(axis=1) < 4.0 * half.prod(axis=1) * (1.0 - 1e-9)
        half[less], axes[less] = 0.5 * (high - low)[less, :2], frame[less]
        center[less] = np.einsum("fa,fai->fi", 0.5 * (low + high), frame)[less]
    area = np.add.reduceat(0.5 * twice[order], begin)
    fill = area / np.maximum(4.0 * half.prod(axis=1), 1e-300)
    found = MetalFaces(center, axes, half, fill, outward[lead] != 0.0, curved[lead], body[lead])
    flat, bent = np.flatnonzero(~found.curved), np.flatnonzero(found.curved)
    flat = flat[np.argsort(-area[flat], kind="stable")]
    stride = max(1, -(-bent.size // MOST_FACES))
    kept = found.of(bent[::stride], stride), found.of(flat)
    return MetalFaces(*(np.concatenate([getattr(k, f.name) for k in kept]) for f in fields(MetalFaces)))


def gaps(faces: MetalFaces) -> F64:
    """Distance (n,) of the largest flat faces from the nearest one that each faces, m; infinite for others."""
    found = np.full(faces.n, np.inf)
    flat = np.flatnonzero(~faces.curved)[:MOST_FACES]
    if not flat.size:
        return found
    center, axes, half = faces.center[flat], faces.axes[flat], faces.half[flat]
    off = center[:, None] - center  # of the first above the second
    height = np.einsum("abi,bi->ab", off, axes[:, 2])
    beside = np.abs(np.einsum("abi,bji->abj", off, axes[:, :2]))
    cosine = axes[:, 2] @ axes[:, 2].T
    closed = faces.closed[flat]
    seen = (~closed | (height > 0.0)) & (~closed[:, None] | (height * cosine < 0.0))
    level = (np.abs(cosine) > FACING) & (beside <= half).all(axis=2)
    least = 1e-6 * float(np.ptp(center, axis=0).max())
    apart = np.where(level & seen & (np.abs(height) > least), np.abs(height), np.inf)
    found[flat] = np.minimum(apart.min(axis=1, initial=np.inf), apart.min(axis=0, initial=np.inf))
    return found


def _outward(corners: F64, area: F64, body: I64, shared: I64) -> F64:
    """(n,) 1 where the normal of a closed body's triangle points outwards, -1 where inwards, 0 for open bodies."""
    alone = np.ones(3 * len(corners))
    alone[shared] = 0.0
    sums, total = (
        np.stack([np.bincount(body, values[:, i]) for i in range(3)], axis=1)
        for values in (corners.mean(axis=1), area)
    )
    middle = sums / np.bincount(body)[:, None]
    size = np.bincount(body, np.linalg.norm(area, axis=1))
    open_sides = np.bincount(body, alone.reshape(-1, 3).sum(axis=1))
    closed = (open_sides == 0.0) & (np.abs(total).max(axis=1) <= 1e-6 * size)
    volume = np.bincount(body, np.einsum("ni,ni->n", corners[:, 0] - middle[body], area))
    return np.asarray((closed * np.sign(volume))[body])


def waves_between(
    lines: MetalLines, faces: MetalFaces, directions: F64, channels: Sequence[str], wavelength: float
) -> WavesBetween:
    r"""Energy of the waves from the edges of one body by way of others, which rays do not follow.

    A face mirrors the wave of another body's edge to the radar where the ray from the edge towards the mirrored radar
    meets it. Near the boundary of the edge's shadow this wave and its reverse, which is as strong, have together

    .. math:: D = \frac1{\sin(\delta / 2)} \leq k \min\left(c \sqrt{\lambda d}, w\right)

    with :math:`\delta` the angle between it and the wave that goes straight on over the edge, d its way to the face,
    and w the width of the edge's face; where this face and the mirror face each other the wave stays between them
    over the whole width, which counts as its way. The line returns :math:`D^2` over
    :math:`\pi` times the square of its coherent length, as those of :func:`~.omitted_waves.omitted_energy`. The part
    that counts is 1 within the mirror and 1/2 half a Fresnel zone :math:`\sqrt{\lambda d}` beside it; narrower mirrors
    return the square of their share of the zone. The triangles of curved mirrors return that share itself, which adds
    up to the spreading :math:`\rho / (\rho + 2 d)`. Only silhouettes count: rims, limbs, and edges of which one face is
    lit. An edge lit by a parallel one of another body returns :math:`D^2 = D_1^2 / (k d)` with the electric field along
    both.

    Parameters
    ----------
    lines, faces : of the metal
    directions : (n, 3) float64, unit vectors to the radar
    channels : such as HH
    wavelength : m

    Notes
    -----
    Ignores bodies between an edge and the face, and before the face; faces of the edge's body; the electric
    field across two edges; more than two reflections but between two faces.
    """
    energy = np.zeros((len(directions), len(channels)))
    if not lines.n or not faces.n or not faces.body.any():
        return WavesBetween(energy, float("inf"))
    row, place, weight = _points(lines)
    near = _near(place, faces)
    own, body = _bodies(place, faces, near, WIDEST_GAP * wavelength)
    if not body.any():
        return WavesBetween(energy, float("inf"))
    ways = []
    pairs = _pairs(place, own, faces, body, near, wavelength, MOST_PRODUCTS // len(directions))
    for found, way in (
        _mirror_lines(lines, row, weight, faces, pairs, directions, channels, wavelength),
        _edges(lines, row, own, weight, directions, channels, wavelength),
    ):
        energy += found
        ways.append((float(found.sum()), way))
    total = sum(part for part, _ in ways)
    if total <= 0.0:
        return WavesBetween(energy, float("inf"))
    return WavesBetween(energy, float(np.exp(sum(part * np.log(way) for part, way in ways if part) / total)))


def _points(lines: MetalLines) -> tuple[I64, F64, F64]:
    """Points on the lines, three a line if few: line (n,), place (n, 3), and share of the line's energy."""
    if 3 * lines.n <= MOST_POINTS:
        row = np.repeat(np.arange(lines.n), 3)
        along = np.tile([-1.0 / 3.0, 0.0, 1.0 / 3.0], lines.n)
        weight = np.full(row.size, 1.0 / 3.0)
    else:  # evenly over the length of all lines
        end = np.cumsum(lines.length)
        mark = end[-1] * (np.arange(MOST_POINTS) + 0.5) / MOST_POINTS
        row = np.minimum(np.searchsorted(end, mark), lines.n - 1)
        along = (mark - end[row]) / lines.length[row] + 0.5
        weight = end[-1] / MOST_POINTS / lines.length[row]
    return row, lines.middle[row] + (along * lines.length[row])[:, None] * lines.along[row], weight


def _near(place: F64, faces: MetalFaces) -> tuple[I64, I64]:
    """Pairs (n,) of points and faces that are examined, by points."""
    first = int(faces.curved.sum()) + MOST_FACES
    face = np.tile(np.arange(min(first, faces.n)), (len(place), 1))
    if faces.n > first:
        tree = scipy.spatial.cKDTree(faces.center[first:])
        nearest = tree.query(place, k=min(NEAREST, faces.n - first))[1].reshape(len(place), -1)
        face = np.concatenate([face, nearest + first], axis=1)
    return np.repeat(np.arange(len(place)), face.shape[1]), face.ravel()


def _bodies(place: F64, faces: MetalFaces, near: tuple[I64, I64], touching: float) -> tuple[I64, I64]:
    """Body of each point and of each face, where bodies with points on a face of another one are one."""
    p, f = near
    off = np.abs(np.einsum("pi,pai->pa", place[p] - faces.center[f], faces.axes[f]))
    off[:, :2] = np.maximum(off[:, :2] - faces.half[f], 0.0)
    distance = np.linalg.norm(off, axis=1)
    nearest = distance.reshape(len(place), -1).argmin(axis=1)
    own = faces.body[f.reshape(len(place), -1)[np.arange(len(place)), nearest]]
    close = distance < touching
    joined = label_connected(int(faces.body.max()) + 1, own[p[close]], faces.body[f[close]])
    return joined[own], joined[faces.body]


@dataclass(frozen=True, eq=False)
class _PointsOverFaces:
    """Points over the faces of other bodies: numbers, height, m, place along the face's sides, m, and its normal."""

    point: I64
    face: I64
    height: F64
    beside: F64
    normal: F64


def _pairs(
    place: F64, own: I64, faces: MetalFaces, body: I64, near: tuple[I64, I64], wavelength: float, most: int
) -> _PointsOverFaces:
    """Pairs of points and faces that see each other, those with the largest solid angles."""
    p, f = near
    off = place[p] - faces.center[f]
    height = np.einsum("pi,pi->p", off, faces.axes[f, 2])
    seen = (np.abs(height) > ABOVE * wavelength) & (~faces.closed[f] | (height > 0.0)) & (own[p] != body[f])
    kept, most = np.flatnonzero(seen), max(most, 1)
    if kept.size > most:
        angle = faces.half[f[kept]].prod(axis=1) * np.abs(height[kept])
        angle /= np.linalg.norm(off[kept], axis=1) ** 3
        kept = np.sort(kept[np.argpartition(-angle, most)[:most]])
    p, f, off, height = p[kept], f[kept], off[kept], height[kept]
    beside = np.einsum("pi,pai->pa", off, faces.axes[f, :2])
    return _PointsOverFaces(p, f, np.abs(height), beside, np.sign(height)[:, None] * faces.axes[f, 2])


def _mirror_lines(
    lines: MetalLines,
    row: I64,
    weight: F64,
    faces: MetalFaces,
    pairs: _PointsOverFaces,
    directions: F64,
    channels: Sequence[str],
    wavelength: float,
) -> tuple[F64, float]:
    """Energy (n_directions, n_channels), m^2, of edges by way of faces, and their mean height over these, m."""
    k = 2.0 * np.pi / wavelength
    i, f, up = row[pairs.point], pairs.face, pairs.normal
    rise = directions @ up.T
    along_face = directions[:, None] - rise[..., None] * up
    sent = along_face - rise[..., None] * up
    towards = np.einsum("di,pji->dpj", directions, lines.normal[i]) > 1e-6
    free = ~lines.normal[i].any(axis=(1, 2))
    silhouette = free | (towards.any(axis=2) & ~towards.all(axis=2))
    outside = free | (np.einsum("dpi,pji->dpj", sent, lines.normal[i]) > 1e-6).any(axis=2)
    # where the ray from the edge to the mirrored radar meets the face's plane, and how far beside it
    way = pairs.height / np.maximum(rise, GRAZING)
    foot = np.einsum("dpi,pai->dpa", along_face, faces.axes[f, :2]) * way[..., None] + pairs.beside
    zone = wavelength * way
    miss = np.square(np.maximum(np.abs(foot) - faces.half[f], 0.0)).sum(axis=2)
    share = np.minimum(1.0, 2.0 * faces.half[f] / np.sqrt(zone)[..., None]).prod(axis=2)
    share = faces.fill[f] * np.where(faces.curved[f], share, np.square(share))
    share = share / (1.0 + 4.0 * miss / zone) * (silhouette & outside & (rise > GRAZING))
    # between two faces that face each other
    own = np.concatenate([lines.sheet[i][:, None], lines.normal[i]], axis=1)
    level = (np.abs(np.einsum("pji,pi->pj", own, up)) > FACING).any(axis=1)
    over = np.linalg.norm(np.maximum(np.abs(pairs.beside) - faces.half[f], 0.0), axis=1) < pairs.height
    width = lines.width[i].min(axis=1)
    kept = np.where(level & over & np.isfinite(width), width, 0.0)
    lean = np.abs(np.einsum("dpi,pi->dp", along_face, lines.along[i]))
    half_sine = np.sqrt(np.maximum(np.square(along_face).sum(axis=2) - np.square(lean), 1e-12))
    most = k * np.minimum(LAWS.zone * np.sqrt(wavelength * np.hypot(way, kept)), width)
    sent_energy = share * np.square(np.minimum(1.0 / half_sine, most)) * weight[pairs.point]
    sent_energy *= coherent_square(lines, i, lean, k)
    hard, soft = np.square(LAWS.mirrored)
    some, back = np.unique(i, return_inverse=True)
    axis = lines.along[some]
    energy = np.zeros((len(directions), len(channels)))
    for c, channel in enumerate(channels):
        part = soft_share(directions, channel, axis, np.abs(directions @ axis.T))[:, back.reshape(-1)]
        energy[:, c] = (sent_energy * (hard * (1.0 - part) + soft * part)).sum(axis=1)
    of_pair = sent_energy.sum(axis=0)
    mean = np.log(pairs.height) @ of_pair / max(float(of_pair.sum()), 1e-300)
    return energy, float(np.exp(mean))


def _edges(
    lines: MetalLines,
    row: I64,
    own: I64,
    weight: F64,
    directions: F64,
    channels: Sequence[str],
    wavelength: float,
) -> tuple[F64, float]:
    """Energy (n_directions, n_channels), m^2, of edges lit by other bodies' edges, and their mean distance, m."""
    k = 2.0 * np.pi / wavelength
    some, first = np.unique(row, return_index=True)
    sharp = lines.radius[some] == 0.0
    some, first = some[sharp], first[sharp]
    # lines that stand for others, where not all are examined
    times = np.bincount(row, weight)[some]
    middle, along, length = lines.middle[some], lines.along[some], lines.length[some]
    off = middle[:, None] - middle
    run = np.einsum("abi,ai->ab", off, along)
    beyond = np.maximum(np.abs(run) - 0.5 * (length[:, None] + length), 0.0)
    distance = np.sqrt(np.maximum(np.square(off).sum(axis=2) - np.square(run), 0.0) + np.square(beyond))
    lit = np.square(along @ along.T) * (own[first][:, None] != own[first])
    lit = lit * LAWS.edges**2 / np.maximum(k * distance, 0.5) * times
    lean = np.abs(directions @ along.T)
    sent = coherent_square(lines, some, lean, k) * times * lit.sum(axis=1)
    energy = np.stack([(sent * soft_share(directions, c, along, lean)).sum(axis=1) for c in channels], axis=1)
    mean = float((lit * np.log(np.maximum(distance, 1e-12))).sum() / max(float(lit.sum()), 1e-300))
    return energy, float(np.exp(mean))
