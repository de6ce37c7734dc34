"""Expected level of the waves that pass from the edges of metal to other metal, and by way of it to the radar."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64, I64
from sarmitsuba.effects.omitted_waves import PLANE, MetalLines, soft_share
from sarmitsuba.mesh.connected import connected
from sarmitsuba.mesh.edge_pairs import edge_pairs
from sarmitsuba.mesh.pieces import SMOOTH_BEND
from sarmitsuba.mesh.welding import weld

# points on lines, faces, and products of both with directions that are examined at most
MOST_POINTS, MOST_FACES, MOST_PRODUCTS = 300, 400, 600_000
# wavelengths, least height of a point over a face that it does not belong to
ABOVE = 1e-3
# least sine of the angle at which a wave arrives at a face
GRAZING = 0.05
# lines that are examined for waves to other lines at most
MOST_PARALLEL = 300


@dataclass(frozen=True, eq=False)
class Faces:
    """Flat faces as rectangles, and curved surface as one for each triangle.

    Parameters
    ----------
    center : (n, 3) float64, m
    axes : (n, 3, 3) float64, unit vectors: two sides, and the normal, outward where closed
    half : (n, 2) float64, m, half the extents along the sides
    fill : (n,) float64, area over the rectangle's, times the number of like ones that it stands for
    closed : (n,) bool, of a body whose other side is never seen
    curved : (n,) bool
    body : (n,) number of the connected body
    """

    center: F64
    axes: F64
    half: F64
    fill: F64
    closed: NDArray[np.bool_]
    curved: NDArray[np.bool_]
    body: I64

    def of(self, rows: I64, times: float = 1.0) -> "Faces":
        """Selected faces, each for several."""
        return Faces(
            self.center[rows],
            self.axes[rows],
            self.half[rows],
            self.fill[rows] * times,
            self.closed[rows],
            self.curved[rows],
            self.body[rows],
        )


def metal_faces(corners: F64) -> Faces:
    """Faces of triangles (n, 3, 3), m: at most ``MOST_FACES``, the largest flat ones, and curved ones thinned out."""
    vertex = weld(corners.reshape(-1, 3))
    first, second = edge_pairs(vertex)
    a, b = first // 3, second // 3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(twice, 1e-300)[:, None]
    bend = np.abs(np.einsum("ei,ei->e", normal[a], normal[b]))
    n = len(corners)
    level = bend > 1.0 - 0.5 * PLANE**2
    part, body = connected(n, a[level], b[level]), connected(n, a, b)
    outward = _outward(corners, normal, twice, body, np.concatenate([first, second]))
    smooth = ~level & (bend > np.cos(SMOOTH_BEND))
    curved = np.zeros(n, dtype=bool)
    curved[a[smooth]] = curved[b[smooth]] = True
    order = np.argsort(part, kind="stable")
    begin = np.flatnonzero(np.diff(part[order], prepend=-1))
    lead = order[begin]
    up = normal[lead] * np.where(outward == 0.0, 1.0, outward)[lead][:, None]
    sides = (np.roll(corners, -1, axis=1) - corners)[lead]
    sides = sides / np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-300)
    half, center, axes = np.full((lead.size, 2), np.inf), np.zeros((lead.size, 3)), np.zeros((lead.size, 3, 3))
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
    found = Faces(center, axes, half, fill, outward[lead] != 0.0, curved[lead], body[lead])
    flat, bent = np.flatnonzero(~found.curved), np.flatnonzero(found.curved)
    flat = flat[np.argsort(-area[flat], kind="stable")[:MOST_FACES]]
    stride = -(-bent.size // MOST_FACES)
    if not bent.size:
        return found.of(flat)
    parts = found.of(flat), found.of(bent[::stride], stride)
    return Faces(*(np.concatenate([getattr(p, f) for p in parts]) for f in Faces.__dataclass_fields__))


def _outward(corners: F64, normal: F64, twice: F64, body: I64, shared: I64) -> F64:
    """(n,) 1 where the normal of a closed body's triangle points outwards, -1 where inwards, 0 for open bodies."""
    count = np.bincount(body)
    alone = np.ones(3 * len(corners))
    alone[shared] = 0.0
    middle = corners.mean(axis=1)
    middle = np.stack([np.bincount(body, middle[:, i]) for i in range(3)], axis=1) / count[:, None]
    total = np.stack([np.bincount(body, normal[:, i] * twice) for i in range(3)], axis=1)
    closed = (np.bincount(body, alone.reshape(-1, 3).sum(axis=1)) == 0.0) & (
        np.abs(total).max(axis=1) <= 1e-6 * np.bincount(body, twice)
    )
    height = np.einsum("ni,ni->n", corners[:, 0] - middle[body], normal) * twice
    return np.asarray((closed * np.sign(np.bincount(body, height)))[body])


NAMES = ("pole", "plain", "own pole", "own plain", "edges", "edges 2", "gap", "own gap")


def features(
    lines: MetalLines, faces: Faces, directions: F64, channels: Sequence[str], wavelength: float
):
    """(n_directions, n_channels, len(NAMES), 2)"""
    k = 2.0 * np.pi / wavelength
    out = np.zeros((len(directions), len(channels), len(NAMES), 2))
    if not lines.n or not len(faces.center):
        return out
    row, point, weight = _points(lines)
    body = _body_of(lines, faces)
    rel = point[:, None] - faces.center
    height = np.einsum("pfi,fi->pf", rel, faces.axes[:, 2])
    seen = (np.abs(height) > ABOVE * wavelength) & (~faces.closed | (height > 0.0))
    toward = -np.sign(height)[..., None] * faces.axes[:, 2]
    free = ~lines.normal.any(axis=(1, 2))
    p, f = np.nonzero(seen)
    most = max(1, MOST_PRODUCTS // len(directions))
    if p.size > most:
        solid = (faces.half[f].prod(axis=1) * np.abs(height[p, f])) / np.linalg.norm(rel[p, f], axis=1) ** 3
        pick = np.argpartition(-solid, most)[:most]
        p, f = p[pick], f[pick]
    if p.size:
        i = row[p]
        n = -toward[p, f]
        h = np.abs(height[p, f])
        flat = np.einsum("pi,pai->pa", rel[p, f], faces.axes[f, :2])
        rise = directions @ n.T
        tangent = directions[:, None] - rise[..., None] * n
        sent = tangent - rise[..., None] * n
        sides = np.einsum("di,pji->dpj", directions, lines.normal[i]) > 1e-6
        out_there = free[i] | (np.einsum("dpi,pji->dpj", sent, lines.normal[i]) > 1e-6).any(axis=2)
        lit = free[i] | sides.any(axis=2)
        rim = free[i] | ~sides.all(axis=2)
        d = h / np.maximum(rise, GRAZING)
        foot = np.einsum("dpi,pai->dpa", tangent, faces.axes[f, :2]) * d[..., None] + flat
        miss = np.square(np.maximum(np.abs(foot) - faces.half[f], 0.0)).sum(axis=2)
        zone = wavelength * d
        cover = 1.0 / np.square(1.0 + 4.0 * miss / zone)
        narrow = np.minimum(1.0, 2.0 * faces.half[f] / np.sqrt(zone)[..., None]).prod(axis=2) * faces.fill[f]
        cover *= np.where(faces.curved[f], narrow, narrow**2)
        cover = cover * ((rise > GRAZING) & out_there & lit) * weight[p]
        along = np.abs(np.einsum("dpi,pi->dp", tangent, lines.along[i]))
        reach = 1.0 / np.maximum(k * along, 1e-12)
        cover *= np.minimum(lines.length[i], reach) * np.minimum(np.maximum(lines.coherent, lines.length)[i], reach) / np.pi
        across = np.sqrt(np.maximum(np.square(tangent).sum(axis=2) - along**2, 1e-12))
        own = lines.width[i].min(axis=1)
        # own plane parallel: the wave stays between both
        own_n = np.where(lines.sheet[i].any(axis=1)[:, None], lines.sheet[i], lines.normal[i, 0])
        facing = np.maximum(np.abs(np.einsum("pi,pi->p", own_n, n)), np.abs(np.einsum("pi,pi->p", lines.normal[i, 1], n))) > 0.94
        over = np.linalg.norm(np.maximum(np.abs(flat) - faces.half[f], 0.0), axis=1) < h
        facing &= over
        way = np.where(facing, np.hypot(d, np.where(np.isfinite(own), own, 0.0)), d)
        pole = np.square(np.minimum(1.0 / across, k * np.minimum(0.5 * np.sqrt(wavelength * way), own)))
        other = (body[i] != faces.body[f])
        for c, channel in enumerate(channels):
            soft = soft_share(directions, channel, lines.along, np.abs(directions @ lines.along.T))[:, i]
            lean = np.abs(directions @ lines.along[i].T)
            r2 = 1.0 / np.maximum(k * lean, 1e-12)
            gapsize = np.minimum(lines.length[i], r2) * np.minimum(np.maximum(lines.coherent, lines.length)[i], r2) / np.pi * weight[p]*facing
            for w, which in enumerate((other, ~other)):
                x = gapsize*which
                s = (x * soft).sum(axis=1)
                out[:, c, 6+w] = np.stack([x.sum(axis=1) - s, s], axis=1)
            for m, kind in enumerate((cover * pole * rim, cover)):
                for w, which in enumerate((other, ~other)):
                    x = kind * which
                    s = (x * soft).sum(axis=1)
                    out[:, c, 2 * w + m] = np.stack([x.sum(axis=1) - s, s], axis=1)
    # edge to edge
    sharp = np.flatnonzero(lines.radius == 0.0)[:MOST_PARALLEL]
    if sharp.size and faces.body.max() > 0:
        m, t, sh = lines.middle[sharp], lines.along[sharp], lines.sheet[sharp]
        off = m[:, None] - m
        al = np.einsum("abi,ai->ab", off, t)
        perp = off - al[..., None] * t[:, None]
        pd = np.linalg.norm(perp, axis=2)
        d = np.hypot(pd, np.maximum(np.abs(al) - 0.5 * (lines.length[sharp][:, None] + lines.length[sharp]), 0.0))
        u = perp / np.maximum(pd, 1e-12)[..., None]
        fa = np.where(sh.any(axis=1)[:, None], np.einsum("abi,ai->ab", u, sh) ** 2, 1.0)
        fb = np.where(sh.any(axis=1), np.einsum("abi,bi->ab", u, sh) ** 2, 1.0)
        w = np.square(t @ t.T) * (body[sharp][:, None] != body[sharp])
        kd = np.maximum(k * d, 0.5)
        lean = np.abs(directions @ t.T)
        reach = 1.0 / np.maximum(k * lean, 1e-12)
        size = np.minimum(lines.length[sharp], reach) * np.minimum(np.maximum(lines.coherent, lines.length)[sharp], reach) / np.pi
        for c, channel in enumerate(channels):
            soft = soft_share(directions, channel, t, lean)
            for q, pw in enumerate((1, 2)):
                out[:, c, 4 + q, 0] = (size * (1 - soft)) @ (w * fa * fb / kd**pw).sum(1)
                out[:, c, 4 + q, 1] = (size * soft) @ (w / kd**pw).sum(1)
    return out


def _body_of(lines: MetalLines, faces: Faces) -> I64:
    rel = lines.middle[:, None] - faces.center
    q = np.abs(np.einsum("lfi,fai->lfa", rel, faces.axes))
    q[..., :2] = np.maximum(q[..., :2] - faces.half, 0.0)
    return faces.body[np.square(q).sum(axis=2).argmin(axis=1)]


def _points(lines: MetalLines) -> tuple[I64, F64, F64]:
    """Row of the line, place (n, 3), and share of the line's energy of points on all lines."""
    if 3 * lines.n <= MOST_POINTS:
        row = np.repeat(np.arange(lines.n), 3)
        place = np.tile([-1.0 / 3.0, 0.0, 1.0 / 3.0], lines.n)
        weight = np.full(row.size, 1.0 / 3.0)
    else:
        end = np.cumsum(lines.length)
        mark = end[-1] * (np.arange(MOST_POINTS) + 0.5) / MOST_POINTS
        row = np.minimum(np.searchsorted(end, mark), lines.n - 1)
        place = (mark - end[row]) / lines.length[row] + 0.5
        weight = end[-1] / MOST_POINTS / lines.length[row]
    return row, lines.middle[row] + (place * lines.length[row])[:, None] * lines.along[row], weight
