"""Expected level of the waves that physical optics and edge waves leave out, from the shape of the metal alone."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.mesh.pieces import SMOOTH_BEND, piece_of
from sarmitsuba.scene.mesh.sharp_edges import ONE_EDGE, WIDEST_GAP, SharpEdges, sharp_edges
from sarmitsuba.scene.mesh.smooth_surface import facet_curvature
from sarmitsuba.scene.mesh.topology import edge_pairs, label_connected, weld
from sarmitsuba.scene.scene import Scene

# lines that are evaluated at most: of more, curved ones are thinned out
MOST_LINES = 3000
# energy of a sheet's waves over the share of both fields in its plane: full where the field leans by 45 degrees
GRAZING = 4.0
# products of lines and directions at a time
_BLOCK = 400_000
# triangles of a piece of surface beyond which its extent is taken from those that reach farthest in so many directions
_PIECE, _OUTERMOST = 1000, 64
# k times a radius, below which it acts as an edge
AS_EDGE = 1.26
# rad, bend up to which two triangles are one plane
PLANE = 1e-4
# the effect of the waves of sharp metal edges, and its flag
EDGES = "edge_diffraction"
# causes
EDGES_OFF, BETWEEN, ONE_RIM = "edges left out", "between edges", "two edges as one"
BENT = "bent sheets"
ROUNDED, CURVED = "rounded edges", "curved surface"


@dataclass(frozen=True)
class WaveLaws:
    r"""Amplitudes D of the waves left out, relative to Keller's edge wave of unit coefficient.

    Hard is for the electric field across the line, soft for that along it; w is the width of a face, k the wavenumber,
    :math:`\rho` a radius of curvature. Fitted to the method of moments for 50 drawn bodies
    (``benchmarks/studies/theory_error.py``), the powers above :math:`k w = 1` and those of :math:`k \rho` are set:

    .. math:: D = D_1 (k w)^{-p}, \quad D = \frac{D_0}{\sqrt{1 + (k \rho)^2}}

    Double diffraction at grazing incidence has p = 1/2 for hard and 3/2 for soft edges (here 1: edges lean), and the
    false return of a sphere's shadow boundary in physical optics is 1 / (k rho) of its echo.

    Parameters
    ----------
    hard, soft : of waves between the edges of a face, at k w = 1; of wedges, and of rims of sheets
    power : p above k w = 1, hard and soft
    narrow : p below
    tip : of the two ends of a straight edge, in units of 1 / k; of wedges, and of rims
    fringe : of an edge that is not simulated
    dark : energy of edges of which both faces are turned away
    curved : of curved surface, hard and soft
    bent : of rims of sheets whose waves go on over bends, hard
    doubly : energy of surface curved alike in both directions over that of a cylinder's, less 1: from the Mie series of
        spheres, all of whose shadow boundary returns in phase
    mixed : share of the energy that does not keep the polarisation
    """

    hard: tuple[float, float] = (1.27, 1.18)
    soft: tuple[float, float] = (0.47, 0.18)
    power: tuple[float, float] = (0.5, 1.0)
    narrow: tuple[float, float] = (0.41, 0.06)
    hard_tip: tuple[float, float] = (0.93, 1.13)
    soft_tip: tuple[float, float] = (1.19, 2.86)
    fringe: float = 0.5
    dark: float = 0.5
    curved: tuple[float, float] = (0.75, 1.37)
    bent: float = 0.9
    doubly: float = 6.0
    mixed: float = 0.65


@dataclass(frozen=True)
class SimulatedWaves:
    """Waves beyond physical optics that a run follows.

    Parameters
    ----------
    edges : fringe waves of sharp metal edges; those of other surfaces are never simulated
    between_rims : waves diffracted twice, between the rims of a sheet
    one_rim : the two edges of a thin plate act as one rim
    folds : waves off folds between two faces, as far as they are tabulated
    """

    edges: bool = True
    between_rims: bool = False
    one_rim: bool = False
    folds: bool = False

    @staticmethod
    def of(scene: Scene, flags: KernelFlags) -> "SimulatedWaves":
        """Those of a run with these flags: all by the effect of edges, those of folds with one antenna."""
        edges = flags.on(EDGES)
        folds = edges and flags.coherent and flags.multi_bounce and scene.radar.receiver is None
        return SimulatedWaves(edges=edges, between_rims=edges, one_rim=edges, folds=folds)


LAWS = WaveLaws()


@dataclass(frozen=True, eq=False)
class MetalLines:
    """Lines from which waves go out that are not simulated: sharp edges, and curved surface as a sum of rounded edges.

    Parameters
    ----------
    middle : (n, 3) float64, m
    along : (n, 3) float64, unit vectors
    length : (n,) float64, m, of the straight piece
    coherent : (n,) float64, m, that at most adds in phase
    normal : (n, 2, 3) float64, outward normals of both faces; zero where waves go all ways
    sheet : (n, 3) float64, normal of the sheet whose rim it is; zero for others
    width : (n, 2) float64, m, of both faces across the line; infinite for curved surface
    lone : (n,) bool, rims of a plane sheet without edges to other faces
    onward : (n,) float64, of rims, share of the energy of a wave along their sheet that goes on over a bend of it
    radius : (n,) float64, m, of curvature across the line; 0 for sharp edges
    reflection : (n,) float64, amplitude reflected by the surface at normal incidence; 1 for metal
    """

    middle: F64
    along: F64
    length: F64
    coherent: F64
    normal: F64
    sheet: F64
    width: F64
    lone: NDArray[np.bool_]
    onward: F64
    radius: F64
    reflection: F64

    @property
    def face_width(self) -> float:
        """Mean width of the faces between sharp edges, m: geometric, of the narrower one; infinite without edges."""
        sharp = self.radius == 0.0
        if not sharp.any():
            return float("inf")
        narrow = np.log(np.maximum(self.width[sharp].min(axis=1), 1e-12))
        return float(np.exp(np.average(narrow, weights=self.length[sharp])))

    @property
    def n(self) -> int:
        """Number of lines."""
        return int(self.length.size)


def metal_lines(corners: F64, reflection: F64, wavelength: float) -> MetalLines:
    """Lines of triangles, see :class:`MetalLines`.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    reflection : (n,) float64, amplitude reflected at normal incidence, 1 for metal
    wavelength : m

    Notes
    -----
    Ignores bodies that hide a line, and which faces touch others that do not share their edges. Every triangle counts
    with its own smooth piece of surface; a piece of several materials reflects as its mean.
    """
    corners = np.asarray(corners, dtype=np.float64)
    vertex = weld(corners.reshape(-1, 3))
    pairs = edge_pairs(vertex)
    piece = piece_of(corners, vertex, pairs)
    edges = sharp_edges(corners, np.ones(len(corners), dtype=bool), WIDEST_GAP * wavelength)
    parts = (
        _collect_edges(edges, corners, piece, reflection, _onward(corners, vertex, piece, pairs)),
        _round_edges(corners, vertex, piece, reflection, wavelength),
    )
    return MetalLines(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(MetalLines)))


def _onward(corners: F64, vertex: I64, piece: I64, pairs: tuple[I64, I64]) -> F64:
    """Square of the cosine of the least bend in each piece of surface and at its edges to others; -1 without any."""
    a, b = pairs
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = unit_rows(normal)
    alike = np.where(vertex[a] == vertex[b], -1.0, 1.0)
    level = alike * np.einsum("ei,ei->e", normal[a // 3], normal[b // 3])
    bent = np.abs(level) < 1.0 - 0.5 * PLANE**2
    share = np.full(int(piece.max(initial=-1)) + 1, -1.0)
    for side in pairs:
        np.maximum.at(share, piece[side[bent] // 3], np.square(np.maximum(level[bent], 0.0)))
    return share


def _collect_edges(edges: SharpEdges, corners: F64, piece: I64, reflection: F64, onward: F64) -> MetalLines:
    """Sharp edges, their collinear pieces joined; ``onward``: of :func:`_onward`."""
    if not edges.n:
        return _none()
    along = edges.along
    half = 0.5 * edges.length[:, None] * along
    grid = max(float(np.ptp(corners)), 1e-9) * 1e-6
    ends = np.round(np.concatenate([edges.middle - half, edges.middle + half]) / grid)
    _, node = np.unique(ends, axis=0, return_inverse=True)
    node = node.reshape(-1)
    # pieces that go on: two at an end, bent by less than a smooth surface
    order = np.argsort(node, kind="stable")
    first = np.flatnonzero(np.diff(node[order], prepend=-1))
    two = first[np.diff(first, append=node.size) == 2]
    a, b = order[two] % edges.n, order[two + 1] % edges.n
    on = np.abs(np.einsum("ei,ei->e", along[a], along[b])) > np.cos(SMOOTH_BEND)
    chain = label_connected(edges.n, a[on], b[on])
    straight = np.abs(np.einsum("ei,ei->e", along[a], along[b])) > 1.0 - 1e-6
    line = label_connected(edges.n, a[straight], b[straight])
    whole = np.asarray(np.bincount(line, edges.length), dtype=np.float64)
    _, pick = np.unique(line, return_index=True)
    coherent = np.asarray(np.bincount(chain, edges.length)[chain][pick], dtype=np.float64)
    normal = edges.normal[pick].copy()
    rim = edges.angle[pick] > 2.0 - 1e-9
    sheet = np.where(rim[:, None], normal[:, 0], 0.0)
    normal[rim] = 0.0
    faces, width = _widths(edges, corners, piece)
    own = (np.bincount(piece, reflection) / np.bincount(piece))[faces].max(axis=1)
    beyond = onward[faces[pick]].max(axis=1)
    widths = (
        np.stack([np.bincount(line, width[:, i] * edges.length) for i in range(2)], axis=1) / whole[:, None]
    )
    sums = [np.bincount(line, edges.middle[:, i] * edges.length) for i in range(3)]
    middle = np.asarray(np.stack(sums, axis=1) / whole[:, None], dtype=np.float64)
    return MetalLines(
        middle,
        along[pick],
        whole,
        coherent,
        normal,
        sheet,
        widths,
        rim & (beyond < 0.0),
        np.where(rim, np.maximum(beyond, 0.0), 0.0),
        np.zeros(pick.size),
        own[pick],
    )


def _widths(edges: SharpEdges, corners: F64, piece: I64) -> tuple[I64, F64]:
    """Number (n, 2) of the smooth piece of surface on both sides of each edge, and its mean extent across it, m."""
    area = np.bincount(
        piece,
        0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1),
    )
    # triangle of each side of each edge: that whose middle is nearest across it
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = unit_rows(normals)
    sides = 0.5 * (corners + np.roll(corners, -1, axis=1)).reshape(-1, 3)
    tree = scipy.spatial.cKDTree(sides)
    _, near = tree.query(edges.middle, k=min(6, len(sides)))
    near = near.reshape(edges.n, -1)
    found = np.zeros((edges.n, 2), dtype=np.int64)
    for i in range(2):
        inside = np.einsum(
            "eki,ei->ek", corners[near // 3].mean(axis=2) - edges.middle[:, None], edges.inward[:, i]
        )
        level = np.abs(np.einsum("eki,ei->ek", normals[near // 3], edges.normal[:, i]))
        off = np.linalg.norm(sides[near] - edges.middle[:, None], axis=2)
        cost = off + 1e3 * ((inside <= 0.0) | (level < 0.99)) * (1.0 + np.ptp(corners))
        found[:, i] = piece[near[np.arange(edges.n), cost.argmin(axis=1)] // 3]
    order = _outermost(corners, piece)
    count = np.bincount(piece[order], minlength=len(area))
    start = np.cumsum(count) - count
    width = np.empty((edges.n, 2))
    step = _BLOCK // _PIECE
    for i in range(2):
        for first in range(0, edges.n, step):
            rows = slice(first, first + step)
            of, across, along = found[rows, i], edges.inward[rows, i], edges.along[rows]
            taken = count[of]
            row = np.repeat(np.arange(of.size), taken)
            begin = np.cumsum(taken) - taken
            triangle = order[start[of][row] + np.arange(row.size) - begin[row]]
            points = corners[triangle]
            depth = np.maximum.reduceat(np.einsum("tci,ti->tc", points, across[row]).max(axis=1), begin)
            depth = depth - np.einsum("ei,ei->e", edges.middle[rows], across)
            place = np.einsum("tci,ti->tc", points, along[row])
            run = np.maximum.reduceat(place.max(axis=1), begin) - np.minimum.reduceat(
                place.min(axis=1), begin
            )
            mean = area[of] / np.maximum(run, 1e-300)
            width[rows, i] = np.clip(mean, 1e-12, np.maximum(depth, 1e-12))
    return found, width


def _outermost(corners: F64, piece: I64) -> I64:
    """Triangles piece by piece; of large pieces those that reach farthest, in ``_OUTERMOST`` directions all round."""
    order = np.argsort(piece, kind="stable")
    count = np.bincount(piece)
    if (count <= _PIECE).all():
        return order
    place = np.arange(_OUTERMOST) + 0.5
    height, turn = 1.0 - 2.0 * place / _OUTERMOST, np.pi * (1.0 + np.sqrt(5.0)) * place
    level = np.sqrt(1.0 - height * height)
    directions = np.stack([level * np.cos(turn), level * np.sin(turn), height])
    start = np.cumsum(count) - count
    kept = []
    for first, n in zip(start, count, strict=True):
        rows = order[first : first + n]
        if n > _PIECE:
            points = corners[rows].reshape(-1, 3)
            far = [int((points @ directions[:, i]).argmax()) // 3 for i in range(_OUTERMOST)]
            rows = rows[np.unique(far)]
        kept.append(rows)
    return np.concatenate(kept)


def _round_edges(corners: F64, vertex: I64, piece: I64, reflection: F64, wavelength: float) -> MetalLines:
    """Curved surface as rounded edges: each triangle turns by a share of half a turn over its area."""
    shape = facet_curvature(corners, piece, wavelength, vertex)
    if shape is None:
        return _none()
    rows = np.flatnonzero(np.abs(shape[:, :6]).max(axis=1) > 0.0)
    stride = -(-rows.size // MOST_LINES)
    rows = rows[::stride]
    s = shape[rows]
    operator = np.stack([s[:, [0, 3, 4]], s[:, [3, 1, 5]], s[:, [4, 5, 2]]], axis=1)
    normal = np.cross(corners[rows, 1] - corners[rows, 0], corners[rows, 2] - corners[rows, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= np.maximum(2.0 * area, 1e-300)[:, None]
    value, vector = np.linalg.eigh(operator)
    order = np.argsort(-np.abs(value), axis=1)
    bend = np.abs(np.take_along_axis(value, order, axis=1))  # the least is that of the normal, 0
    strongest = np.take_along_axis(vector, order[:, None, :1], axis=2)[:, :, 0]
    along = np.cross(normal, strongest)
    radius = 1.0 / np.maximum(bend[:, 0], 1e-12)
    extent = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    other = np.sqrt(wavelength / np.maximum(bend[:, 1], 1e-12))
    return MetalLines(
        corners[rows].mean(axis=1),
        along,
        stride * area * bend[:, 0] / (2.0 * np.pi) * (1.0 + LAWS.doubly * bend[:, 1] * radius),
        np.minimum(other, extent),
        np.zeros((rows.size, 2, 3)),
        np.zeros((rows.size, 3)),
        np.full((rows.size, 2), np.inf),
        np.zeros(rows.size, dtype=bool),
        np.zeros(rows.size),
        radius,
        reflection[rows],
    )


def _none() -> MetalLines:
    e = np.zeros(0)
    return MetalLines(
        np.zeros((0, 3)),
        np.zeros((0, 3)),
        e,
        e,
        np.zeros((0, 2, 3)),
        np.zeros((0, 3)),
        np.zeros((0, 2)),
        e > 0.0,
        e,
        e,
        e,
    )


def omitted_energy(
    lines: MetalLines, directions: F64, channels: Sequence[str], wavelength: float, waves: SimulatedWaves
) -> dict[str, F64]:
    r"""Energy of the waves left out by cause, (n_directions, n_channels) float64 each, m^2, as an RCS.

    Every line returns, for its straight length :math:`l` and the length :math:`l_c` that may add in phase,

    .. math:: \sigma = \frac{D^2}{\pi} \min\left(l, \frac1{k |\hat s \cdot \hat t|}\right)
        \min\left(l_c, \frac1{k |\hat s \cdot \hat t|}\right)

    with the coefficients of :class:`WaveLaws`; of rims less where the electric field is nearly across their sheet, in
    which it drives no current. Lines add as energies, since their phases are unknown.

    Parameters
    ----------
    lines : of the metal
    directions : (n, 3) float64, unit vectors to the radar
    channels : such as HH
    wavelength : m
    waves : that are simulated
    """
    k = 2.0 * np.pi / wavelength
    law = LAWS
    weights = _weights(lines, k, waves)
    out = {name: np.zeros((len(directions), len(channels))) for name in weights}
    tip = lines.coherent < 1.001 * lines.length
    all_round = ~lines.normal.any(axis=(1, 2))
    step = max(1, _BLOCK // max(lines.n, 1))
    for first in range(0, len(directions), step):
        s = directions[first : first + step]
        lean = np.abs(s @ lines.along.T)
        size = coherent_square(lines, np.arange(lines.n), lean, k)
        lit = all_round | (np.einsum("di,nfi->dnf", s, lines.normal) > 1e-3).any(axis=2)
        shown = np.where(lit, 1.0, law.dark)
        straight = np.stack([soft_share(s, c, lines.along, lean) for c in channels], axis=2)
        # a field across a sheet drives no current in it
        driven = np.stack([_weigh_by_sheet(s, c, lines.sheet) for c in channels], axis=2)
        # curved edges and ends turn the polarisation
        mixed = (1.0 - law.mixed) * straight + law.mixed * straight.mean(axis=2, keepdims=True)
        for name, (hard_d, soft_d, hard_tip, soft_tip) in weights.items():
            if not (hard_d.any() or soft_d.any()):
                continue
            ends = np.where(tip, 1.0 / (np.pi * k * k), 0.0)
            hard_e, soft_e = size * hard_d + ends * hard_tip, size * soft_d + ends * soft_tip
            # a wave along a bent sheet ends at a rim in another plane
            soft, seen = (straight, 1.0) if name == BENT else (mixed, driven)
            total = shown[..., None] * (hard_e[..., None] * (1.0 - soft) + soft_e[..., None] * soft)
            out[name][first : first + step] += (total * seen).sum(axis=1)
    return out


def coherent_square(lines: MetalLines, rows: I64, lean: F64, k: float) -> F64:
    """Square of the length of lines that adds in phase, over pi, m^2, for components ``lean`` (n, rows) along them."""
    reach = 1.0 / np.maximum(k * lean, 1e-12)
    length, coherent = lines.length[rows], lines.coherent[rows]
    return np.asarray(np.minimum(length, reach) * np.minimum(np.maximum(coherent, length), reach) / np.pi)


def _weights(lines: MetalLines, k: float, waves: SimulatedWaves) -> dict[str, tuple[F64, F64, F64, F64]]:
    """Squared coefficients of every line by cause: hard and soft, and of its ends hard and soft, (n,) each."""
    law, sharp = LAWS, lines.radius == 0.0
    rim = lines.sheet.any(axis=1).astype(np.int64)
    power = np.square(lines.reflection)
    kw = k * np.maximum(lines.width, 1e-9)
    nothing = np.zeros(lines.n)
    found = {}
    simulated = waves.edges & (lines.reflection > 1.0 - 1e-9)
    fringe = np.where(sharp & ~simulated, law.fringe**2, 0.0) * power
    found[EDGES_OFF] = (fringe, fringe, nothing, nothing)

    def between(which: NDArray[np.bool_], start: tuple[float, float], of: int) -> F64:
        """Sum over both faces of the squared coefficient of waves over those of some widths."""
        p = np.where(kw > 1.0, law.power[of], law.narrow[of])
        d = np.array(start)[rim][:, None] * kw**-p
        if waves.between_rims:  # those that cross the sheet twice are left
            d = d * np.where(lines.lone[:, None], np.minimum(1.0, d), 1.0)
        return np.asarray(np.where(which & sharp[:, None], np.square(d), 0.0).sum(axis=1) * power)

    wide = kw >= 2.0 * np.pi * ONE_EDGE
    tips = tuple(np.square(np.array(t)[rim]) * sharp * power for t in (law.hard_tip, law.soft_tip))
    found[BETWEEN] = (between(wide, law.hard, 0), between(wide, law.soft, 1), *tips)
    if not waves.one_rim:
        found[ONE_RIM] = (
            between(~wide, law.hard, 0),
            between(~wide, law.soft, 1),
            nothing,
            nothing,
        )
    onward = law.bent**2 * lines.onward * power
    found[BENT] = (onward, nothing, nothing, nothing)
    bent = ~sharp / (1.0 + np.square(k * lines.radius)) * power
    for name, which in (
        (ROUNDED, k * lines.radius < AS_EDGE),
        (CURVED, k * lines.radius >= AS_EDGE),
    ):
        found[name] = (law.curved[0] ** 2 * bent * which, law.curved[1] ** 2 * bent * which, nothing, nothing)
    return found


def _weigh_by_sheet(directions: F64, channel: str, sheet: F64) -> F64:
    """(n_directions, n) factor of a channel's energy: from 0 where the field is across the sheet of a rim, to 1."""
    vectors = dict(zip("HV", polarisation_vectors(directions), strict=True))
    shares = []
    for letter in channel:
        parts = [vectors[letter]] if letter in vectors else list(vectors.values())
        shares.append(np.mean([1.0 - np.square(v @ sheet.T) for v in parts], axis=0))
    return np.asarray(np.minimum(1.0, GRAZING * np.prod(shares, axis=0)))


def soft_share(directions: F64, channel: str, along: F64, lean: F64) -> F64:
    """(n_directions, n) share of a channel's energy with the electric field along each line."""
    vectors = dict(zip("HV", polarisation_vectors(directions), strict=True))
    across = np.maximum(1.0 - lean * lean, 1e-12)
    shares = []
    for letter in channel:
        parts = [vectors[letter]] if letter in vectors else list(vectors.values())
        shares.append(np.mean([np.square(v @ along.T) for v in parts], axis=0) / across)
    return np.asarray(np.clip(np.mean(shares, axis=0), 0.0, 1.0))


def polarisation_vectors(directions: F64, up: ArrayLike = (0.0, 0.0, 1.0)) -> tuple[F64, F64]:
    """Horizontal and vertical unit vectors (n, 3) across directions (n, 3); ``up``: (3,) or (n, 3), the vertical."""
    h = np.cross(np.asarray(up, dtype=np.float64), directions)
    size = np.linalg.norm(h, axis=1, keepdims=True)
    h = np.where(size > 1e-9, h / np.maximum(size, 1e-9), [0.0, 1.0, 0.0])
    return h, np.cross(directions, h)
