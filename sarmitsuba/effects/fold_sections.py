"""Two metal faces that meet at a fold, in two dimensions: backscatter by moments, and by the rays of the simulator.

The difference of both, over the length of the fold, is the part that rays leave out: the edge of the beam that one face
reflects onto the other, the wave off the fold itself, and waves from rim to rim.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64, I64, unit_rows
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.core.witness import Witness
from sarmitsuba.effects.omitted_waves import polarisation_vectors
from sarmitsuba.radar.polarisation import linear_parts
from sarmitsuba.scene.mesh.sharp_edges import WIDEST_GAP
from sarmitsuba.scene.mesh.topology import edge_pairs, label_connected, weld

# rad, angles between two faces that are taken as a fold, and how near to a right angle rays are right
SHARPEST, FLATTEST, ABOUT_RIGHT = math.radians(20.0), math.radians(155.0), math.radians(0.25)
# facets that are examined, the largest ones, and wavelengths, least width of one and least length of a fold
MOST_FACETS, NARROWEST = 200, 0.4
# segments of a wavelength, and how many of a section there may be before they are fewer; wavelengths of both faces
# together that are solved
LEAST_SEGMENTS, MOST_SEGMENTS, PLENTY, WIDEST = 12, 30, 480, 60.0
# share of its rectangle that a face fills at least where its section is the same all along the fold
RECTANGULAR = 0.97
# bounces of rays
DEPTH = 10
# folds whose waves are tabulated, operations that their tables may take, and wavelengths along the line of sight
MOST_TABLES, MOST_OPERATIONS, MOST_LEANS = 6, 3e10, 8
# rad of phase between two entries of a table: by angle (cubic between), and by lean (linear between)
PHASE_STEP, LEAN_STEP = 0.5, 0.25
# sections that a statement solves, and wavelengths of both faces together up to which they are not scaled down
MOST_SECTIONS, WIDEST_STATED = 2, 30.0
# error of the section by rays that the simulator's have beside it, by grazing tubes, over the rms of the section
OF_RAYS = 0.015
# rad from a right angle within which the energy of these waves grows as the width of the faces
NEAR_RIGHT = math.radians(20.0)
# segments of the mesh by which the error of another one is measured over its own, in so many directions, and the
# difference that it leaves over the error: along the fold errors fall as the length of segments, across as its square
FINER, CHECKED = 1.5, 24
REST = (1.0 / (1.0 - 1.0 / FINER), 1.0 / (1.0 - 1.0 / FINER**2))
# segments beyond which the middle of another one stands for all of it, and Gauss points of nearer ones
NEAR, POINTS = 4, 4
_EULER = 0.5772156649015329
# rad, bend up to which two triangles are one plane
_PLANE = 1e-4
# positions that count as one, over the extent of the surface
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Folds:
    """Pairs of flat metal faces that meet at a line, one row each.

    Parameters
    ----------
    middle : (n, 3) float64, m, of the line
    along : (n, 3) float64, unit vectors of it
    length : (n,) float64, m, common to both faces
    arms : (n, 2, 3) float64, unit vectors from the line into both faces, across it
    width : (n, 2) float64, m, mean extent of the faces across the line
    closed : (n,) bool, one of the faces is that of a body, so that the reflex side is inside
    plain : (n,) bool, both faces are rectangles along the line, and neither has another fold
    """

    middle: F64
    along: F64
    length: F64
    arms: F64
    width: F64
    closed: NDArray[np.bool_]
    plain: NDArray[np.bool_]

    @property
    def n(self) -> int:
        """Number of folds."""
        return len(self.length)

    @property
    def angle(self) -> F64:
        """Angle between both faces, rad, (n,)."""
        cosine = np.einsum("ni,ni->n", self.arms[:, 0], self.arms[:, 1])
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)), dtype=np.float64)

    @property
    def square(self) -> NDArray[np.bool_]:
        """Folds at right angles, (n,), whose double bounces rays have."""
        return np.asarray(np.abs(self.angle - 0.5 * np.pi) < ABOUT_RIGHT)

    def of(self, rows: NDArray[np.bool_] | I64) -> "Folds":
        """Selected folds."""
        return Folds(*(getattr(self, f.name)[rows] for f in fields(self)))

    def cut(self, longest: float) -> "Folds":
        """Folds in pieces no longer than ``longest``, m."""
        count = np.maximum(np.ceil(self.length / longest - 1e-9), 1.0).astype(np.intp)
        row = np.repeat(np.arange(self.n), count)
        place = np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)
        found, n = self.of(row), count[row]
        step = found.length / n
        shift = (place - 0.5 * (n - 1.0)) * step
        return replace(found, middle=found.middle + shift[:, None] * found.along, length=step)

    def looks(self, directions: F64) -> tuple[F64, F64]:
        """Angle of directions (m, 3) from the bisector across the fold, rad, and share along the fold: (m, n) each.

        The angle is positive towards the second face.
        """
        lean = directions @ self.along.T
        middle = self.arms.sum(axis=1)
        middle = unit_rows(middle)
        side = self.arms[:, 1] - self.arms[:, 0]
        side = unit_rows(side)
        return np.arctan2(directions @ side.T, directions @ middle.T), lean


def find_folds(corners: F64, wavelength: float) -> Folds:
    """Folds between the flat faces of triangles (n, 3, 3), m, the largest ones.

    Coplanar neighbours are one face, however it is cut. Faces meet where both reach the line common to their planes,
    with or without common points; a face that goes on beyond the line has two sides.
    """
    facets = _flat_facets(corners, wavelength) if len(corners) else []
    found: list[Folds] = []
    pairs: list[tuple[int, int]] = []
    for pair in _near_pairs(facets, wavelength):
        met = _meeting(facets[pair[0]], facets[pair[1]], wavelength)
        found += met
        pairs += [pair] * len(met)
    if not found:
        none, no = np.zeros((0, 3)), np.zeros(0, dtype=bool)
        return Folds(none, none, np.zeros(0), np.zeros((0, 2, 3)), np.zeros((0, 2)), no, no)
    folds = Folds(*(np.concatenate([getattr(fold, f.name) for fold in found]) for f in fields(Folds)))
    pair_rows = np.array(pairs)
    count = np.bincount(pair_rows.ravel(), minlength=len(facets))
    return replace(folds, plain=folds.plain & (count[pair_rows] == 1).all(axis=1))


@dataclass(frozen=True, eq=False)
class _Facet:
    """Flat face: corners (n, 3), normal, outward where closed, area, m^2."""

    points: F64
    normal: F64
    area: float
    closed: bool


def coplanar_parts(corners: F64) -> I64:
    """Number (n,) of the flat part of each triangle (n, 3, 3): coplanar neighbours are one, however they are cut."""
    return _parts(corners)[0]


def _parts(corners: F64) -> tuple[I64, I64, I64, F64]:
    """Flat part and body of each triangle, its sides that others share, and twice its area times the normal."""
    grid = SAME * max(float(np.ptp(corners)), 1e-300)
    first, second = edge_pairs(weld(np.round(corners.reshape(-1, 3) / grid)))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = unit_rows(normal)
    a, b = first // 3, second // 3
    level = np.abs(np.einsum("ei,ei->e", unit[a], unit[b])) > 1.0 - 0.5 * _PLANE**2
    n = len(corners)
    return (
        label_connected(n, a[level], b[level]),
        label_connected(n, a, b),
        np.concatenate([first, second]),
        normal,
    )


def _flat_facets(corners: F64, wavelength: float) -> list[_Facet]:
    """Largest flat faces of triangles."""
    part, body, shared, normal = _parts(corners)
    twice = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(twice, 1e-300)[:, None]
    n, grid = len(corners), SAME * max(float(np.ptp(corners)), 1e-300)
    alone = np.ones(3 * n)
    alone[shared] = 0.0
    is_open = np.bincount(body, alone.reshape(-1, 3).sum(axis=1)) > 0.0
    volume = np.bincount(body, np.einsum("ni,ni->n", corners[:, 0] - corners.mean(axis=(0, 1)), normal))
    area = 0.5 * np.bincount(part, twice)
    count = np.bincount(part)
    order, start = np.argsort(part, kind="stable"), np.cumsum(count) - count
    found = []
    for k in np.argsort(-area, kind="stable")[:MOST_FACETS]:
        if area[k] < np.square(NARROWEST * wavelength):
            break
        rows = order[start[k] : start[k] + count[k]]
        closed = not is_open[body[rows[0]]]
        up = unit[rows[0]] * (np.sign(volume[body[rows[0]]]) if closed else 1.0)
        found.append(_Facet(np.unique(corners[rows].reshape(-1, 3), axis=0), up, float(area[k]), closed))
    return _join_facets(found, grid)


def _join_facets(facets: list[_Facet], gap: float) -> list[_Facet]:
    """Facets, of which those in one plane whose bounding boxes touch are one: sides cut at different places."""
    if len(facets) < 2:
        return facets
    normal = np.stack([f.normal for f in facets])
    low, high = (np.stack([get(f.points, axis=0) for f in facets]) for get in (np.min, np.max))
    place = np.stack([f.points[0] for f in facets])
    same = np.abs(np.einsum("ai,abi->ab", normal, place - place[:, None])) < gap
    same &= same.T & (np.abs(normal @ normal.T) > 1.0 - 0.5 * _PLANE**2)
    same &= (low[:, None] <= high + gap).all(axis=2) & (low <= high[:, None] + gap).all(axis=2)
    i, j = np.nonzero(np.tril(same, -1))
    part = label_connected(len(facets), i, j)
    found = []
    for k in range(int(part.max()) + 1):
        group = [facets[m] for m in np.flatnonzero(part == k)]
        points, area = np.concatenate([f.points for f in group]), sum(f.area for f in group)
        found.append(_Facet(points, group[0].normal, area, all(f.closed for f in group)))
    return sorted(found, key=lambda f: -f.area)


def _near_pairs(facets: list[_Facet], wavelength: float) -> list[tuple[int, int]]:
    """Pairs of faces at an angle whose bounding boxes touch."""
    if len(facets) < 2:
        return []
    normal = np.stack([f.normal for f in facets])
    low, high = (np.stack([get(f.points, axis=0) for f in facets]) for get in (np.min, np.max))
    margin = 2.0 * WIDEST_GAP * wavelength + 1e-6 * float(np.ptp(high))
    near = (low[:, None] <= high + margin).all(axis=2)
    near &= near.T & (np.abs(normal @ normal.T) < math.cos(SHARPEST))
    return [(int(i), int(j)) for i, j in zip(*np.nonzero(np.tril(near, -1)), strict=True)]


def _meeting(a: _Facet, b: _Facet, wavelength: float) -> list[Folds]:
    """Folds of two faces, each alone."""
    along = np.cross(a.normal, b.normal)
    sine = float(np.linalg.norm(along))
    if sine < math.sin(SHARPEST):
        return []
    along /= sine
    planes = np.stack([a.normal, b.normal, along])
    foot = np.linalg.solve(planes, [a.normal @ a.points[0], b.normal @ b.points[0], along @ a.points[0]])
    sides = []
    for facet in (a, b):
        across = np.cross(facet.normal, along)
        run, x = (facet.points - foot) @ along, (facet.points - foot) @ across
        touching = WIDEST_GAP * wavelength + 1e-6 * float(np.ptp(facet.points))
        if x.min() > touching or x.max() < -touching:
            return []
        both = min(-x.min(), x.max()) > touching
        kept = []
        for sign in (1.0, -1.0):
            reach = float((sign * x).max())
            extent = float(np.ptp(run))
            mean = reach if both else facet.area / max(extent, 1e-300)
            if mean > NARROWEST * wavelength and reach > touching:
                whole = float(np.ptp(x))
                kept.append((sign * across, mean, facet.area > RECTANGULAR * extent * whole))
        sides.append((run.min(), run.max(), kept))
    low, high = max(sides[0][0], sides[1][0]), min(sides[0][1], sides[1][1])
    if high - low < NARROWEST * wavelength:
        return []
    found: list[Folds] = []
    even = abs(sides[0][0] - sides[1][0]) + abs(sides[0][1] - sides[1][1]) < 0.1 * (high - low)
    for one, width, plain in sides[0][2]:
        for two, other, also in sides[1][2]:
            angle = math.acos(float(np.clip(one @ two, -1.0, 1.0)))
            inside = (a.closed and a.normal @ two < 0.0) or (b.closed and b.normal @ one < 0.0)
            if SHARPEST < angle < FLATTEST and not inside:
                middle = foot + 0.5 * (low + high) * along
                row = (middle, along, high - low, np.stack([one, two]), np.array([width, other]))
                kinds = (a.closed or b.closed, plain and also and even)
                found.append(Folds(*(np.asarray(part)[None] for part in (*row, *kinds))))
    return found


def section_by_moments(angle: float, width: F64, wavelength: float, azimuth: F64, finer: float = 1.0) -> C128:
    r"""Backscatter of two thin strips that meet at the origin, (2, m) for the field along and across, :math:`\sqrt m`.

    Galerkin's method for the electric field integral equation on segments of equal length: constant currents for the
    field along the fold, linear ones for that across. Within a strip the matrix depends on the distance of two segments
    alone. The modulus squared is the scattering width; a length b returns :math:`\sigma = 2 b^2 / \lambda` times it.

    Parameters
    ----------
    angle : between the strips, rad; their bisector is x
    width : (2,) float64, m
    wavelength : m
    azimuth : (m,) float64, rad, of the antenna from the bisector, towards the second strip
    finer : factor on the number of segments
    """
    k = 2.0 * np.pi / wavelength
    start, end = _segments(angle, width, wavelength / (finer * segments_of(width, wavelength)))
    length = np.linalg.norm(end - start, axis=1)
    unit = (end - start) / length[:, None]
    green = _pair_moments(start, end, k, int(np.count_nonzero(np.abs(unit @ unit[0] - 1.0) < 1e-9)))
    to = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    node, weight = _gauss()
    wave = np.zeros((2, len(start), len(to)), dtype=np.complex128)
    for t, w in zip(node, weight, strict=True):
        part = np.exp(1j * k * ((start + t * (end - start)) @ to.T)) * (w * length)[:, None]
        wave[0] += (1.0 - t) * part
        wave[1] += t * part
    out = np.empty((2, len(to)), dtype=np.complex128)
    source = wave.sum(axis=0)
    out[0] = np.einsum("nd,nd->d", source, np.linalg.solve(1j * k * green.sum(axis=(0, 1)), source))
    # rooftops rise on one segment and fall on the next
    rise, fall = slice(0, -1), slice(1, None)
    matrix = np.zeros((len(start) - 1,) * 2, dtype=np.complex128)
    source = np.zeros((len(start) - 1, len(to)), dtype=np.complex128)
    across = np.stack([-to[:, 1], to[:, 0]])
    whole = green.sum(axis=(0, 1))
    for i, p, up in ((rise, 1, 1.0), (fall, 0, -1.0)):
        source += wave[p, i] * (unit[i] @ across)
        for j, q, down in ((rise, 1, 1.0), (fall, 0, -1.0)):
            charge = up * down / np.outer(length[i], length[j]) * whole[i, j]
            matrix += 1j * k * ((unit[i] @ unit[j].T) * green[p, q][i, j] - charge / k**2)
    out[1] = np.einsum("nd,nd->d", source, np.linalg.solve(matrix, source))
    return np.asarray(0.5 * np.sqrt(k) * out)


def segments_of(width: F64, wavelength: float) -> float:
    """Segments of a wavelength for strips of widths (2,), m."""
    return float(np.clip(PLENTY * wavelength / width.sum(), LEAST_SEGMENTS, MOST_SEGMENTS))


def _gauss() -> tuple[F64, F64]:
    node, weight = np.polynomial.legendre.leggauss(POINTS)
    return 0.5 * (node + 1.0), 0.5 * weight


def _segments(angle: float, width: F64, step: float) -> tuple[F64, F64]:
    """Ends (n, 2) of the segments from the far end of the first strip to that of the second."""
    points = []
    for turn, w in zip((-0.5 * angle, 0.5 * angle), width, strict=True):
        n = max(2, math.ceil(w / step))
        points.append(w * np.arange(n + 1)[:, None] / n * [math.cos(turn), math.sin(turn)])
    line = np.concatenate([points[0][::-1], points[1][1:]])
    return line[:-1], line[1:]


def _pair_moments(start: F64, end: F64, k: float, n_first: int) -> C128:
    """(2, 2, n, n) integrals of ``-j/4 H0(k R)`` between two segments times the falling and rising hats of both."""
    n = len(start)
    length = np.linalg.norm(end - start, axis=1)
    middle = 0.5 * (start + end)
    out = np.empty((2, 2, n, n), dtype=np.complex128)
    for part in (slice(0, n_first), slice(n_first, n)):
        size = part.stop - part.start
        rows = np.zeros(size, dtype=np.intp) + part.start
        moments = _near_moments(start, end, k, rows, np.arange(part.start, part.stop))
        back = _near_moments(start, end, k, np.arange(part.start, part.stop), rows)
        apart = np.subtract.outer(np.arange(size), np.arange(size))
        out[:, :, part, part] = np.where(apart <= 0, moments[:, :, np.abs(apart)], back[:, :, np.abs(apart)])
    one, two = slice(0, n_first), slice(n_first, n)
    gap = np.linalg.norm(middle[one, None] - middle[None, two], axis=2)
    far = -0.25j * scipy.special.hankel2(0, k * gap) * np.outer(length[one], length[two]) * 0.25
    # the mean of the kernel over both segments, to the second order of their length
    far *= 1.0 - (k * k / 24.0) * 0.5 * (np.square(length[one])[:, None] + np.square(length[two]))
    block = np.broadcast_to(far, (2, 2, *far.shape)).copy()
    i, j = np.nonzero(gap < NEAR * float(length.max()))
    block[:, :, i, j] = _near_moments(start, end, k, i, j + n_first)
    out[:, :, one, two] = block
    out[:, :, two, one] = np.transpose(block, (1, 0, 3, 2))
    return out


def _near_moments(start: F64, end: F64, k: float, i: I64, j: I64) -> C128:
    """(2, 2, n) the same for pairs of segments: the logarithm in closed form over the second one."""
    node, weight = _gauss()
    hats = np.stack([1.0 - node, node])
    step, length = end[j] - start[j], np.linalg.norm(end[j] - start[j], axis=1)
    along, own = step / length[:, None], np.linalg.norm(end[i] - start[i], axis=1)
    out = np.zeros((2, 2, len(i)), dtype=np.complex128)
    limit = -0.25j - (math.log(0.5 * k) + _EULER) / (2.0 * np.pi)
    for p, t in enumerate(node):
        place = start[i] + t * (end[i] - start[i])
        values = np.zeros((2, len(i)), dtype=np.complex128)
        for q, u in enumerate(node):
            r = np.linalg.norm(place - start[j] - u * step, axis=1)
            safe = np.where(r > 0.0, r, 1.0)
            smooth = np.where(
                r > 1e-9 / k,
                -0.25j * scipy.special.hankel2(0, k * safe) + np.log(safe) / (2.0 * np.pi),
                limit,
            )
            values += weight[q] * length * smooth * hats[:, q, None]
        off = place - start[j]
        x = np.einsum("nc,nc->n", off, along)
        y = np.abs(off[:, 0] * along[:, 1] - off[:, 1] * along[:, 0])
        a, b = -x, length - x
        log_a, log_b = (np.log(np.maximum(v * v + y * y, 1e-300)) for v in (a, b))
        turn = np.arctan2(b, y) - np.arctan2(a, y)
        whole = 0.5 * (b * log_b - a * log_a) - (b - a) + y * turn
        first = 0.25 * ((b * b + y * y) * (log_b - 1.0) - (a * a + y * y) * (log_a - 1.0))
        rising = (first + x * whole) / length
        values -= np.stack([whole - rising, rising]) / (2.0 * np.pi)
        out += weight[p] * own * hats[:, p, None, None] * values
    return out


def section_by_rays(
    angle: float, width: F64, wavelength: float, azimuth: F64, *, edges: bool = True, sheets: bool = True
) -> C128:
    r"""The same by the simulator's rays in the limit of dense ones, (2, m), :math:`\sqrt m`.

    Plane waves mirrored from face to face, each part of them closed by physical optics where it hits; double bounces
    with the weights of :func:`sarmitsuba.tracing.scatterers.corners.metal_corners.corner_share`, whose reaches do not
    depend on the ray here; the fringe waves of the far ends, straight.

    Parameters
    ----------
    angle, width, wavelength, azimuth : see :func:`section_by_moments`
    edges : whether fringe waves are simulated
    sheets : whether both faces are sheets, whose fold the simulator takes for the other rim of waves along them
    """
    k = 2.0 * np.pi / wavelength
    to = np.stack([np.cos(azimuth), np.sin(azimuth)])
    turn = np.array([-0.5 * angle, 0.5 * angle])
    arms = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    normals = np.stack([-arms[:, 1], arms[:, 0]], axis=1) * [[1.0], [-1.0]]  # towards the other face
    lit = [_find_unshadowed(arms[i], arms[1 - i], width[i], width[1 - i], to) for i in (0, 1)]
    total = np.zeros((2, azimuth.size), dtype=np.complex128)
    for first in (0, 1):
        low, high = lit[first].copy(), np.full(azimuth.size, width[first])
        way, face = -to, first
        for order in range(1, DEPTH + 1):
            normal, arm = normals[face], arms[face]
            facing = way.T @ normal
            if order > 1:
                live = facing < 0.0  # the inner side of the other face
                high = np.where(live, high, low)
            sign = -np.sign(facing)
            begin, stop = np.maximum(low, lit[face]), high
            into, out = np.abs(facing), sign * (to.T @ normal)
            size = np.where(out > 0.0, np.maximum(stop - begin, 0.0), 0.0)
            phase = -k * ((way - to).T @ arm)
            beam = size * np.sinc(phase * size / (2.0 * np.pi)) * np.exp(0.5j * phase * (begin + stop))
            if order == 2:
                beam = beam * _corner_weight(arms, normals, width, first, to)
            total[0] += (-1.0) ** (order - 1) * into * beam
            total[1] += out * beam
            if order == DEPTH or not (high > low).any():
                break
            # from the outer side nothing meets the other face
            high = np.where(facing < 0.0, high, low)
            way = way - 2.0 * facing * normal[:, None]
            other = arms[1 - face]
            bottom = other[0] * way[1] - other[1] * way[0]
            ratio = (arm[0] * way[1] - arm[1] * way[0]) / np.where(np.abs(bottom) < 1e-12, 1e-12, bottom)
            there = (ratio > 0.0) & (((ratio[:, None] * other - arm) * way.T).sum(axis=1) > 0.0)
            low, high = ratio * low, np.minimum(ratio * high, width[1 - face])
            high = np.where(there & (high > low), high, 0.0)
            low = np.where(there & (high > low), low, 0.0)
            face = 1 - face
    total *= math.sqrt(k)
    if edges:
        total += _rims(arms, normals, width, to, lit, k, sheets)
    return total


def _find_unshadowed(arm: F64, other: F64, width: float, reach: float, to: F64) -> F64:
    """Distance (m,) from the fold from which on a face is seen past the other one."""
    top, bottom = other[0] * to[1] - other[1] * to[0], arm[0] * to[1] - arm[1] * to[0]
    ratio = top / np.where(np.abs(bottom) < 1e-12, 1e-12, bottom)
    ahead = ((other - ratio[:, None] * arm) * to.T).sum(axis=1) > 0.0
    return np.asarray(np.where((ratio > 0.0) & ahead, np.minimum(ratio * reach, width), 0.0))


def _corner_weight(arms: F64, normals: F64, width: F64, first: int, to: F64) -> F64:
    """Weight (m,) of a double bounce over face ``first`` against its reverse."""
    second = 1 - first
    n_a, n_b = normals[first], normals[second]
    cosine = float(n_a @ n_b)
    way = -to + 2.0 * (n_a @ to) * n_a[:, None]
    from_a, to_b = np.maximum(n_a @ way, 1e-7), np.maximum(-(n_b @ way), 1e-7)
    # distances from the fold are as the leg's components across the other face
    ratio = np.clip(width[second] / from_a / (width[first] / to_b), 1e-3, 1e3)
    from_b, to_a = n_b @ to, n_a @ to - 2.0 * (n_b @ to) * cosine
    back = np.clip(ratio * np.maximum(from_b, 0.0) * from_a / (np.maximum(to_a, 1e-7) * to_b), 1e-3, 1e3)
    own, other = np.power(ratio, 8.0), np.power(back, 8.0)
    return np.asarray(np.where(to_a > 0.0, 2.0 * (1.0 + other) / (1.0 + other * (2.0 + own)), 1.0))


def _rims(arms: F64, normals: F64, width: F64, to: F64, lit: list[F64], k: float, sheets: bool) -> C128:
    """Fringe waves (2, m) of both far ends, of a half plane each, and of the fold of sheets from outside."""
    total = np.zeros((2, to.shape[1]), dtype=np.complex128)
    for i in (0, 1):
        place = width[i] * arms[i]
        cosine = -(arms[i] @ to)
        soft, hard = _fringe(2.0, np.arctan2(np.abs(normals[i] @ to), cosine))
        along = _evaluate_sheet_factor(cosine, k * float(width[i])) if sheets else 1.0
        seen = lit[i] < width[i] * (1.0 - 1e-9)
        wave = np.where(seen, 1j / math.sqrt(k) * np.exp(2j * k * (place @ to)), 0.0)
        total += np.stack([soft * wave, -hard * along * wave])
    if sheets:
        half = math.acos(float(np.clip(arms[1, 0], -1.0, 1.0)))
        phi = np.arctan2(to[1], to[0]) % (2.0 * np.pi) - half
        outside = (phi > 0.0) & (phi < 2.0 * (np.pi - half))
        soft, hard = _fringe(2.0 * (1.0 - half / np.pi), np.where(outside, phi, 1.0))
        total += np.where(outside, 1j / math.sqrt(k), 0.0) * np.stack([soft, -hard])
    return total


def _fringe(n: float, phi: F64) -> tuple[F64, F64]:
    r"""Fringe coefficients (m,) of a wedge in backscatter, soft and hard: the exact wave less physical optics.

    .. math:: f = -\tfrac12 \sum_{a, b} \left[C(\tfrac\pi2) \pm C(\phi - \tfrac\pi2)\right], \quad
        C(x) = \tfrac1N \cot\tfrac xN - U \cot x

    the sum of :class:`sarmitsuba.tracing.scatterers.edges.diffraction.FringeCurrents` squarely to the edge, with the
    angle off each face.

    Parameters
    ----------
    n : exterior angle over pi
    phi : off the first face, rad
    """
    soft, hard = np.zeros_like(phi), np.zeros_like(phi)
    for angle in (phi, n * np.pi - phi):
        lit = angle < np.pi
        ahead = 1.0 / (n * np.tan(0.5 * np.pi / n))
        x = angle - 0.5 * np.pi
        small = np.abs(x) < 1e-4
        safe = np.where(small, 1.0, x)
        back = 1.0 / (n * np.tan(safe / n)) - np.where(lit, 1.0 / np.tan(safe), 0.0)
        back = np.where(small & lit, 0.0, back)
        soft -= 0.5 * (ahead + back)
        hard -= 0.5 * (ahead - back)
    return soft, hard


def _evaluate_sheet_factor(cosine: F64, width: float) -> C128:
    """Factor Q (m,) of :class:`.edges.diffraction.FringeCurrents` in backscatter off the rim of a sheet.

    ``cosine`` of the angle between direction and sheet, ``width`` of the sheet times the wavenumber.
    """
    t = scipy.special.erf(np.exp(0.25j * np.pi) * np.sqrt(width * (1.0 - cosine)))
    lost = (t - 1.0) * (0.5 + 0.5 * np.clip(4.0 * cosine, -1.0, 1.0))
    c, s = np.sqrt(np.maximum(0.5 + 0.5 * cosine, 1e-6)), np.sqrt(0.5 - 0.5 * cosine)
    return np.asarray(1.0 + (2.0 * lost / c + lost * lost) * (c + s) / c)


def waves_left_out(
    angle: float, width: F64, wavelength: float, azimuth: F64, *, edges: bool = True, sheets: bool = True
) -> C128:
    """Difference of moments of a section and rays, (2, m) for the field along and across the fold, square root of m."""
    exact = section_by_moments(angle, width, wavelength, azimuth)
    rays = section_by_rays(angle, width, wavelength, azimuth, edges=edges, sheets=sheets)
    return np.asarray(exact - rays)


@dataclass(frozen=True, eq=False)
class FoldGrid:
    r"""Directions in which the waves of a fold that rays leave out are tabulated.

    Entry (i, j) is at the angle ``first + j step`` across the fold and at the lean :math:`c_i` = ``lean_first + i
    lean_step``, where :math:`1 - c` is the sine of the angle between the fold and the line of sight.

    Parameters
    ----------
    row : of the fold
    first, step, n : rad, and number of angles
    lean_first, lean_step, n_leans : see above
    """

    row: int
    first: float
    step: float
    n: int
    lean_first: float
    lean_step: float
    n_leans: int

    def holds(self, azimuth: F64, lean: F64) -> NDArray[np.bool_]:
        """Whether directions (angle across the fold, rad, and share along it) lie within the grid."""
        j = (azimuth - self.first) / self.step
        i = (1.0 - np.sqrt(np.maximum(1.0 - lean * lean, 0.0)) - self.lean_first) / self.lean_step
        return np.asarray((j >= 1.0) & (j <= self.n - 2.0) & (i > -1.0) & (i < self.n_leans))

    def solve(self, folds: Folds, wavelength: float) -> C128:
        r"""Amplitudes (n_leans, n, 2), field along and across: :math:`\sqrt{2 / \lambda'}` times those of the section.

        The wavelength across the fold is :math:`\lambda' = \lambda / (1 - c_i)`.
        """
        place = np.asarray(self.first + self.step * np.arange(self.n), dtype=np.float64)
        values = np.zeros((self.n_leans, self.n, 2), dtype=np.complex128)
        for i in range(self.n_leans):
            across = wavelength / (1.0 - self.lean_first - i * self.lean_step)
            angle, width, sheets = folds.angle[self.row], folds.width[self.row], not folds.closed[self.row]
            found = waves_left_out(float(angle), width, across, place, sheets=sheets)
            values[i] = math.sqrt(2.0 / across) * found.T
        values[:, ~lies_within_fold(folds.of(np.array([self.row])), place[:, None])[:, 0]] = 0.0
        return values


def lies_within_fold(folds: Folds, azimuth: F64) -> NDArray[np.bool_]:
    """Whether an inner side of a face is seen from angles (m, n) across each fold; of bodies both."""
    angle = folds.angle
    return np.asarray(np.abs(azimuth) < np.where(folds.closed, 0.5 * angle, np.pi - 0.5 * angle))


def fold_grids(folds: Folds, wavelength: float, directions: F64) -> list[FoldGrid]:
    """Grids for the longest plain folds, for directions (m, 3) from which they are seen.

    Right angles have none, since rays have their double bounces; nor have folds of wide faces, or of more than
    ``MOST_OPERATIONS`` in all.
    """
    wanted = folds.plain & ~folds.square & (folds.width.sum(axis=1) <= WIDEST * wavelength)
    azimuth, lean = folds.looks(directions)
    seen = lies_within_fold(folds, azimuth)
    found: list[FoldGrid] = []
    left, k = MOST_OPERATIONS, 2.0 * np.pi / wavelength
    for row in np.flatnonzero(wanted)[np.argsort(-folds.length[wanted], kind="stable")]:
        rows = seen[:, row]
        if not rows.any() or len(found) == MOST_TABLES:
            continue
        reach = 2.0 * k * float(folds.width[row].max())
        step, lean_step = PHASE_STEP / reach, LEAN_STEP / reach
        low, high = float(azimuth[rows, row].min()), float(azimuth[rows, row].max())
        n = math.ceil((high - low) / step) + 5
        cosine = 1.0 - np.sqrt(1.0 - np.square(lean[rows, row]))
        least = float(cosine.min())
        n_leans = min(math.ceil((float(cosine.max()) - least) / lean_step) + 1, MOST_LEANS)
        unknowns = segments_of(folds.width[row], wavelength) * float(folds.width[row].sum()) / wavelength
        left -= n_leans * (6.0 * unknowns**3 + 16.0 * unknowns**2 * n)
        if left < 0.0:
            break
        found.append(FoldGrid(int(row), low - 2.0 * step, step, n, least, lean_step, n_leans))
    return found


@dataclass(frozen=True, eq=False)
class MeasuredFold:
    """Error of a fold's section in some directions, measured by moments: (2, m) for the field along and across.

    Parameters
    ----------
    error : float64, square root of m, of rays with the tabulated waves
    exact : complex128, square root of m
    scale : of the faces' widths that were solved over their own
    tabulated : whether rays have the waves of the table, and the error is that of its mesh
    """

    error: F64
    exact: C128
    scale: float
    tabulated: bool

    @staticmethod
    def of(
        folds: Folds, row: int, wavelength: float, azimuth: F64, *, tabulated: bool, edges: bool
    ) -> "MeasuredFold":
        """Fold in directions at angles (m,) across it, rad; at most ``CHECKED`` of them."""
        angle, width = float(folds.angle[row]), folds.width[row]
        scale = 1.0 if tabulated else min(1.0, WIDEST_STATED * wavelength / float(width.sum()))
        place = azimuth[:: -(-azimuth.size // CHECKED)]
        exact = section_by_moments(angle, scale * width, wavelength, place)
        if tabulated:
            fine = section_by_moments(angle, width, wavelength, place, FINER)
            error = np.square(np.abs(fine - exact) * np.array(REST)[:, None])
            error += np.square(OF_RAYS) * np.square(np.abs(exact)).mean(axis=1, keepdims=True)
            return MeasuredFold(np.sqrt(error), exact, scale, True)
        sheets = not folds.closed[row]
        rays = section_by_rays(angle, scale * width, wavelength, place, edges=edges, sheets=sheets)
        return MeasuredFold(np.abs(exact - rays), exact, scale, False)

    def witness(self, law_db: float) -> Witness:
        """Energy of the error over that of the section; ``law_db``: foretold, NaN without a law."""
        text = "two-dimensional moments of the strongest fold's section"
        if self.scale < 1.0:
            text += f", {self.scale:.2g} times its width"
        text += ", on a finer mesh" if self.tabulated else ""
        error, energy = np.square(self.error).ravel(), np.square(np.abs(self.exact)).ravel()
        return Witness.from_weighted(error, energy, 0, law_db=law_db, reference=text)


@dataclass(frozen=True, eq=False)
class FoldError:
    """Waves off folds that are left out.

    Parameters
    ----------
    energy : (m, n_channels) float64, m^2, as an RCS
    row : of the fold with most of it; -1 without one
    witness : error of the section of the longest fold into which some direction looks; None without one
    """

    energy: F64
    row: int
    witness: Witness | None


def fold_error(
    folds: Folds,
    grids: Sequence[FoldGrid],
    directions: F64,
    channels: Sequence[str],
    wavelength: float,
    *,
    edges: bool = True,
) -> FoldError:
    r"""Energy of the waves off folds that are left out, and the measured error of the longest one.

    .. math:: \sigma_{pq} = \frac{2}{\lambda} |(\hat p \cdot \hat s)(\hat q \cdot \hat s) D_s
        + (\hat p \cdot \hat h)(\hat q \cdot \hat h) D_h|^2 \min\left(l, \frac1{k |\hat d \cdot \hat t|}\right)^2

    with the waves :math:`D_s, D_h` of the fold's section, along :math:`\hat s` and across. Where these are
    tabulated and simulated, the mesh's error is left. Only the strongest folds are solved; others have the waves of
    the one whose angle is nearest. Sections of wide faces are scaled down, and the mean over some degrees is taken.
    Right angles count by :func:`~.theory_error.repeated_share`, whose law the witness then has.
    """
    energy = np.zeros((len(directions), len(channels)))
    azimuth, lean = folds.looks(directions)
    seen = lies_within_fold(folds, azimuth)
    shown = np.flatnonzero(seen.sum(axis=0))
    order = shown[np.argsort(-folds.length[shown], kind="stable")]
    if not order.size:
        return FoldError(energy, -1, None)
    k, best, most = 2.0 * np.pi / wavelength, -1, 0.0
    held = {g.row: np.asarray(g.holds(azimuth[:, g.row], lean[:, g.row]) & seen[:, g.row]) for g in grids}
    held = {row: which for row, which in held.items() if which.any()}
    rows = [int(row) for row in order if not folds.square[row]]
    solved = [row for row in rows if row not in held][:MOST_SECTIONS]
    measured = {
        row: MeasuredFold.of(folds, row, wavelength, azimuth[which, row], tabulated=True, edges=edges)
        for row, which in held.items()
    }
    spread: dict[int, _SpreadWaves] = {}
    for row in rows:
        amplitude = np.zeros((2, len(directions)), dtype=np.complex128)
        left = seen[:, row].copy()
        if row in held:
            left &= ~held[row]
            amplitude[:, held[row]] = np.sqrt(np.square(measured[row].error).mean(axis=1))[:, None]
        if left.any():
            known = np.array(solved or [row])
            alike = int(known[np.abs(folds.angle[known] - folds.angle[row]).argmin()])
            small = folds.width[row].sum() <= WIDEST_STATED * wavelength
            if alike == row and small:
                amplitude[:, left] = _section_waves(folds, row, wavelength, azimuth[left, row], edges=edges)
            else:
                if alike not in spread:
                    spread[alike] = _spread_waves(folds, alike, wavelength, edges=edges)
                amplitude[:, left] = spread[alike].at(azimuth[left, row], float(folds.width[row].sum()))
        size = np.minimum(folds.length[row], 1.0 / np.maximum(k * np.abs(lean[:, row]), 1e-12))
        returned = [_project_channel(amplitude, directions, folds.along[row], c) for c in channels]
        part = 2.0 / wavelength * np.square(size * np.abs(returned)).T
        energy += part
        if part.sum() > most:
            best, most = row, float(part.sum())
    # between both faces, where the law of repeated bounces is of the same
    inner = seen & (np.abs(azimuth) < 0.5 * folds.angle)
    between = [int(row) for row in order if inner[:, row].any()]
    if not between:
        return FoldError(energy, best, None)
    first = between[0]
    if first not in measured:
        place = azimuth[inner[:, first], first]
        measured[first] = MeasuredFold.of(folds, first, wavelength, place, tabulated=False, edges=edges)
    return FoldError(
        energy, best, measured[first].witness(_law_db(folds, first, wavelength, measured[first]))
    )


def _law_db(folds: Folds, row: int, wavelength: float, measured: MeasuredFold) -> float:
    """Share of double bounces at right angles by which ray optics is wrong, dB; NaN at other angles."""
    if not folds.square[row]:
        return math.nan
    return min(0.0, -db_from_amplitude(measured.scale * float(folds.width[row].min()) / wavelength))


@dataclass(frozen=True, eq=False)
class _SpreadWaves:
    """Energy of a section's waves by whole degrees, mean over some of them, (2, 360), m; total width, m; angle, rad."""

    square: F64
    width: float
    angle: float

    def at(self, azimuth: F64, width: float) -> C128:
        """Amplitudes (2, m) of a section alike of another total width, m.

        Waves of the double bounce's edges join with the whole beam the more the nearer to a right angle.
        """
        ratio = max(width / self.width, 1.0)
        grown = ratio if abs(self.angle - 0.5 * np.pi) < NEAR_RIGHT else math.sqrt(ratio)
        found = [np.sqrt(grown * np.interp(azimuth, _DEGREES, part)) for part in self.square]
        return np.stack(found).astype(np.complex128)


_DEGREES = np.radians(np.arange(-180.0, 180.0, 1.0))


def _section_waves(folds: Folds, row: int, wavelength: float, azimuth: F64, *, edges: bool) -> C128:
    """Waves (2, m) of a fold's section."""
    angle, sheets = float(folds.angle[row]), not folds.closed[row]
    return waves_left_out(angle, folds.width[row], wavelength, azimuth, edges=edges, sheets=sheets)


def _spread_waves(folds: Folds, row: int, wavelength: float, *, edges: bool) -> _SpreadWaves:
    """Waves of a fold's section, scaled down where it is wide."""
    angle, width, sheets = float(folds.angle[row]), folds.width[row], not folds.closed[row]
    width = min(1.0, WIDEST_STATED * wavelength / float(width.sum())) * width
    found = waves_left_out(angle, width, wavelength, _DEGREES, edges=edges, sheets=sheets)
    turned = [np.roll(np.square(np.abs(found)), shift, axis=1) for shift in (-2, -1, 0, 1, 2)]
    return _SpreadWaves(np.mean(turned, axis=0), float(width.sum()), angle)


def _project_channel(amplitude: C128, directions: F64, along: F64, channel: str) -> C128:
    """Amplitude (m,) of a channel from those with the field along a line and across it (2, m)."""
    vectors = dict(zip("HV", polarisation_vectors(directions), strict=True))
    lean = directions @ along
    soft = along - lean[:, None] * directions
    soft /= np.maximum(np.linalg.norm(soft, axis=1, keepdims=True), 1e-12)
    hard = np.cross(directions, soft)
    total = np.zeros(len(directions), dtype=np.complex128)
    for factor, pair in linear_parts(channel):
        p, q = vectors[pair[0]], vectors[pair[1]]
        for field, value in zip((soft, hard), amplitude, strict=True):
            total += factor * (p * field).sum(axis=1) * (q * field).sum(axis=1) * value
    return total
