"""Monostatic scattering of small metal bodies by the boundary-element method: the electric field integral equation.

The matrix comes from the package bempp-cl (extra ``full-wave``); this file adds meshes, excitation, the mirror images
that make a perfectly conducting ground, and the splitting by symmetry that makes bodies of 10 wavelengths small enough
for a dense matrix. It imports nothing of the simulator. Lengths are in wavelengths.

``python -m benchmarks.support.full_wave_solver`` checks it: a sphere against the Mie series, the split solution
against the unsplit one, and mirror images against two plane waves that arrive together.
"""

import importlib.metadata
import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.special import spherical_jn, spherical_yn

from sarmitsuba.core.arrays import C64, C128, F64, I64

K = 2.0 * np.pi  # wavenumber, rad per wavelength
CHANNELS = ("HH", "HV", "VV")
# mirror planes as matrices
FLIP_X, FLIP_Y, FLIP_Z = (np.diag(d).astype(np.float64) for d in ([-1, 1, 1], [1, -1, 1], [1, 1, -1]))
SWAP_XY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# elements of the matrix that are made at a time, 8 bytes each, twice
BLOCK = 5e7
# local edges of a triangle in bempp-cl's order, and the corner opposite to each
EDGES = ((0, 1), (2, 0), (1, 2))
OPPOSITE = (2, 1, 0)

Patch = tuple[F64, I64]


def installed() -> str:
    """Versions of the solver's packages; empty where they are not installed."""
    try:
        return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("bempp-cl", "pyopencl"))
    except importlib.metadata.PackageNotFoundError:
        return ""


def rectangle(corner: ArrayLike, a: ArrayLike, b: ArrayLike, step: float) -> Patch:
    """Flat rectangle with edges a and b, cut into squares of about ``step`` and those into two triangles."""
    corner, a, b = (np.asarray(x, dtype=np.float64) for x in (corner, a, b))
    n, m = (max(1, round(float(np.linalg.norm(e)) / step)) for e in (a, b))
    u, v = np.meshgrid(np.arange(n + 1) / n, np.arange(m + 1) / m, indexing="ij")
    return (corner + u[..., None] * a + v[..., None] * b).reshape(-1, 3), _squares(n, m)


def barrel(center: ArrayLike, radius: float, height: float, step: float) -> Patch:
    """Half of an upright cylinder's wall, the one at larger x, from z = 0 up."""
    n = max(4, round(np.pi * radius / step))
    m = max(1, round(height / step))
    arc, z = np.meshgrid(np.pi * (np.arange(n + 1) / n - 0.5), height * np.arange(m + 1) / m, indexing="ij")
    wall = np.stack([radius * np.cos(arc), radius * np.sin(arc), z], axis=-1).reshape(-1, 3)
    return wall + np.asarray(center, dtype=np.float64), _squares(n, m)


def half_disc(center: ArrayLike, radius: float, step: float) -> Patch:
    """Half of a level disc, the one at larger x; its rim has the points of ``barrel``."""
    n = max(4, round(np.pi * radius / step))
    rings = max(2, round(radius / step))
    points, faces, before = [np.zeros((1, 3))], [], np.array([0])
    for i in range(1, rings + 1):
        count = n if i == rings else max(2, round(n * i / rings))
        arc = np.pi * np.arange(count + 1) / count - np.pi / 2
        r = radius * i / rings
        here = sum(p.shape[0] for p in points) + np.arange(count + 1)
        points.append(np.stack([r * np.cos(arc), r * np.sin(arc), 0 * arc], axis=-1))
        faces += list(_zip(before, here))
        before = here
    return np.concatenate(points) + np.asarray(center, dtype=np.float64), np.array(faces)


def octant(radius: float, step: float) -> Patch:
    """Eighth of a sphere, x, y, z >= 0."""
    n = max(2, round(np.pi / 2 * radius / step))
    points, rows, faces = [], [], []
    for i in range(n + 1):
        rows.append(len(points) + np.arange(i + 1))
        for j in range(i + 1):
            polar, azimuth = np.pi / 2 * i / n, np.pi / 2 * (j / i if i else 0.0)
            points.append([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
        if i:
            faces += list(_zip(rows[i - 1], rows[i]))
    return radius * np.array(points), np.array(faces)


def _squares(n: int, m: int) -> I64:
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    p = (i * (m + 1) + j).ravel()
    q = p + m + 1
    return np.concatenate([np.column_stack([p, q, q + 1]), np.column_stack([p, q + 1, p + 1])])


def _zip(inner: I64, outer: I64) -> Iterator[tuple[int, int, int]]:
    """Triangles of the strip between two rows of points of the same extent."""
    i = j = 0
    while i < len(inner) - 1 or j < len(outer) - 1:
        if i * (len(outer) - 1) < j * (len(inner) - 1) or j == len(outer) - 1:
            yield int(inner[i]), int(outer[j]), int(inner[i + 1])
            i += 1
        else:
            yield int(inner[i]), int(outer[j]), int(outer[j + 1])
            j += 1


@dataclass(frozen=True, eq=False)
class Body:
    """A metal body with mirror symmetries.

    Parameters
    ----------
    patches : of the part that the mirrors complete; triangles do not cross a mirror
    mirrors : planes through the origin, as (3, 3) matrices that commute
    liner : patches inside closed parts, of a resistive sheet (120 pi ohm). The metal hides them, so that the field
        outside stays what it is, and they damp the cavity's resonances, which the equation otherwise mixes in
    ground : a perfectly conducting plane z = 0; the mirror ``FLIP_Z`` must be the last of ``mirrors``
    """

    patches: tuple[Patch, ...]
    mirrors: tuple[F64, ...]
    liner: tuple[Patch, ...] = ()
    ground: bool = False


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Triangles of the whole body; copy g of fundamental triangle t is triangle ``g * n_part + t``."""

    vertices: F64
    faces: I64
    resistive: NDArray[np.bool_]
    n_part: int
    operations: tuple[F64, ...]


def _complete(body: Body) -> _Mesh:
    operations = [np.eye(3)]
    for mirror in body.mirrors:
        operations += [mirror @ op for op in operations]
    points, faces, offset = [], [], 0
    for patch in (*body.patches, *body.liner):
        points.append(patch[0])
        faces.append(patch[1] + offset)
        offset += patch[0].shape[0]
    part, n_liner = np.concatenate(faces), sum(p[1].shape[0] for p in body.liner)
    everything = np.concatenate([np.concatenate(points) @ op.T for op in operations])
    _, first, weld = np.unique(_rounded(everything), axis=0, return_index=True, return_inverse=True)
    copies = np.concatenate([part + g * offset for g in range(len(operations))])
    resistive = np.zeros(part.shape[0], dtype=bool)
    resistive[part.shape[0] - n_liner :] = n_liner > 0
    return _Mesh(
        everything[first],
        weld.reshape(-1)[copies],
        np.tile(resistive, len(operations)),
        part.shape[0],
        tuple(operations),
    )


def _rounded(points: F64) -> I64:
    return np.round(points * 1e6).astype(np.int64)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Rao-Wilton-Glisson functions of the mesh, as bempp-cl numbers them.

    Parameters
    ----------
    function, sign : (n_triangles, 3), of the local edges
    images, parity : (n_operations, n), the function that each becomes when mirrored, and with which sign
    """

    space: Any
    function: I64
    sign: F64
    images: I64
    parity: F64

    @property
    def n(self) -> int:
        return self.images.shape[1]


def _basis(mesh: _Mesh) -> _Basis:
    import bempp_cl.api as bempp

    grid = bempp.Grid(mesh.vertices.T.copy(), mesh.faces.T.astype(np.uint32))
    space = bempp.function_space(grid, "RWG", 0)
    function, sign = space.local2global.astype(np.int64), space.local_multipliers.astype(np.float64)
    plus = np.full((space.global_dof_count, 2), -1)
    t, i = np.nonzero(sign > 0)
    plus[function[t, i]] = np.stack([t, i], axis=1)
    images, parity = [], []
    n_copies = len(mesh.operations)
    for g in range(n_copies):
        # copies are numbered by the mirrors that made them: combining them is exclusive or
        copy, part = np.divmod(plus[:, 0], mesh.n_part)
        there = (copy ^ g) * mesh.n_part + part
        images.append(function[there, plus[:, 1]])
        parity.append(sign[there, plus[:, 1]])
    return _Basis(space, function, sign, np.array(images), np.array(parity))


def _rows(basis: _Basis, mesh: _Mesh, triangles: I64) -> tuple[I64, C64]:
    """Rows of the matrix for functions on some triangles: their numbers in the whole basis, and the values."""
    import bempp_cl.api as bempp

    grid, whole = basis.space.grid, basis.space
    test = bempp.function_space(
        grid, "SNC", 0, support_elements=triangles, include_boundary_dofs=True, truncate_at_segment_edge=False
    )
    operator = bempp.operators.boundary.maxwell.electric_field(
        whole, whole, test, K, precision="single", device_interface="opencl", assembler="dense"
    )
    values = operator.weak_form().A
    number = np.full(test.global_dof_count, -1)
    t, i = np.nonzero((test.local_multipliers != 0) & (basis.sign != 0))
    number[test.local2global[t, i]] = basis.function[t, i]
    # a rim's function has one triangle only and is none of the whole basis
    keep = number >= 0
    return number[keep], values[keep]


def _plane_wave(basis: _Basis, mesh: _Mesh, looks: F64, vectors: Sequence[F64]) -> C64:
    """(n, n_looks * n_vectors) integrals of each function times plane waves: one per direction and polarisation."""
    from bempp_cl.api.integration.triangle_gauss import rule
    from scipy.sparse import csr_matrix

    points, weights = rule(4)
    corner = mesh.vertices[mesh.faces]
    x = corner[:, :1] + np.einsum("qd,tdc->tqc", points.T, corner[:, 1:] - corner[:, :1])
    length = np.stack([np.linalg.norm(corner[:, i] - corner[:, j], axis=1) for i, j in EDGES], axis=1)
    triangle = np.repeat(np.arange(mesh.faces.shape[0]), 3)
    shape = (basis.n, mesh.faces.shape[0])

    def gather(values: F64) -> Any:
        return csr_matrix(
            ((basis.sign * length * values).ravel(), (basis.function.ravel(), triangle)), shape=shape
        )

    # l / (2 A) (x - opposite corner); the rule's weights sum to 1/2, an integral is 2 A times the sum
    constant = gather(np.ones_like(length))
    opposite = [gather(corner[:, OPPOSITE, c]) for c in range(3)]
    out = np.zeros((basis.n, looks.shape[0], len(vectors)), dtype=np.complex64)
    for start in range(0, looks.shape[0], 16):
        some = slice(start, start + 16)
        phase = (K * (x @ looks[some].T)).astype(np.float32)
        wave = (np.cos(phase) - 1j * np.sin(phase)) * weights.astype(np.float32)[:, None]
        flat = wave.sum(axis=1)
        first = np.stack([(wave * x[..., c, None].astype(np.float32)).sum(axis=1) for c in range(3)])
        for p, vector in enumerate(vectors):
            q = vector[some].T
            out[:, some, p] = constant @ (first * q[:, None, :]).sum(axis=0)
            for c in range(3):
                out[:, some, p] -= opposite[c] @ (flat * q[c])
    return out.reshape(basis.n, -1)


def _sheet(basis: _Basis, mesh: _Mesh) -> Any:
    """Sparse products of the liner's functions: what its resistance, in units of 120 pi ohm, adds to the matrix."""
    import bempp_cl.api as bempp
    from scipy.sparse import diags

    product = bempp.operators.boundary.sparse.identity(basis.space, basis.space, basis.space).weak_form().A
    on = np.zeros(basis.n)
    on[basis.function[mesh.resistive]] = 1.0
    return (diags(on) @ product).tocsr()


def polarisations(looks: F64) -> tuple[F64, F64]:
    """Horizontal and vertical unit vectors, (n, 3) each, across the directions ``looks``."""
    azimuth = np.arctan2(looks[:, 1], looks[:, 0])
    h = np.stack([-np.sin(azimuth), np.cos(azimuth), 0.0 * azimuth], axis=1)
    return h, np.cross(looks, h)


def amplitudes(
    body: Body, looks: ArrayLike, say: Callable[[str], None] = lambda text: None, split: bool = True
) -> C128:
    r"""Return the backscatter amplitudes of a body, \|S\|^2 the radar cross section in square wavelengths.

    .. math:: S_{pq} = \frac{k}{\sqrt{4\pi}}\; b_p^T Z^{-1} b_q

    Parameters
    ----------
    body : with its mirrors
    looks : (n, 3) unit vectors towards the radar
    say : is told how large the problem is
    split : by symmetry; without, all mirrors are solved as one problem

    Returns
    -------
    (n, 3) complex128 : of ``CHANNELS``, phase exp(-j k L) referred to the origin; a plate at the origin that is looked
        at squarely returns a positive number in its co-polar channels

    Notes
    -----
    Chew, Tong, Hu, Integral Equation Methods for Electromagnetic and Elastic Waves (2009), chapters 2 and 3.
    """
    looks = np.asarray(looks, dtype=np.float64)
    mesh = _complete(body)
    basis = _basis(mesh)
    say(f"{mesh.faces.shape[0]} triangles, {basis.n} unknowns, {len(mesh.operations)} symmetric parts")
    wave = _plane_wave(basis, mesh, looks, polarisations(looks))
    out = np.zeros((looks.shape[0], 2, 2), dtype=np.complex128)
    n_mirrors = len(body.mirrors)
    for characters, folded, part in _problems(body, mesh, basis, n_mirrors if split else 0):
        if not split and body.ground:
            # waves and their mirror images together; one operation flips z, with the last mirror
            g = len(mesh.operations) // 2
            source = wave - basis.parity[g][:, None] * wave[basis.images[g]]
            share = 1.0
        else:
            ops = range(len(characters))
            source = sum(
                characters[g] * basis.parity[g][part, None] * wave[basis.images[g][part]] for g in ops
            ) / len(characters)
            share = len(characters) * (2.0 if body.ground else 1.0)
        factors = lu_factor(folded, overwrite_a=True, check_finite=False)
        current = lu_solve(factors, source, check_finite=False)
        receive = source if split else wave
        shape = (part.size, looks.shape[0], 2)
        out += share * np.einsum(
            "ndp,ndq->dpq", receive.reshape(shape), current.reshape(shape), dtype=np.complex128
        )
        say(f"  solved for {part.size} unknowns")
    # bempp-cl has exp(-j w t)
    out = np.conj(out) * (K / np.sqrt(4.0 * np.pi))
    return np.stack([out[:, 0, 0], 0.5 * (out[:, 0, 1] + out[:, 1, 0]), out[:, 1, 1]], axis=1)


def _problems(
    body: Body, mesh: _Mesh, basis: _Basis, n_mirrors: int
) -> Iterator[tuple[list[float], C64, I64]]:
    """Independent problems: signs of the symmetric copies, folded matrix, functions that represent their copies."""
    n_ops = 2**n_mirrors
    part = np.unique(basis.images[:n_ops].min(axis=0))
    n_triangles = mesh.n_part if n_mirrors else mesh.faces.shape[0]
    # over a conductor currents and their images are odd
    last = (-1.0,) if body.ground else (1.0, -1.0)
    choices = [(1.0, -1.0)] * (n_mirrors - 1) + [last] if n_mirrors else []
    problems = []
    for signs in itertools.product(*choices):
        characters = [float(np.prod([s for i, s in enumerate(signs) if g >> i & 1])) for g in range(n_ops)]
        # a function that is its own copy with the wrong sign cancels
        stays = np.ones(part.size, dtype=bool)
        for g in range(n_ops):
            stays &= ~((basis.images[g][part] == part) & (characters[g] * basis.parity[g][part] < 0.0))
        n = int(stays.sum())
        problems.append((characters, stays, np.zeros((n, n), dtype=np.complex64)))
    sheet = _sheet(basis, mesh) if mesh.resistive.any() else None
    step = max(1, int(BLOCK / (1.5 * basis.n)))
    for start in range(0, n_triangles, step):
        numbers, rows = _rows(basis, mesh, np.arange(start, min(start + step, n_triangles)))
        here = np.isin(numbers, part)
        numbers, rows = numbers[here], rows[here]
        if sheet is not None:
            rows += sheet[numbers].toarray().astype(np.complex64)
        totals = [np.zeros((numbers.size, part.size), dtype=np.complex64) for _ in problems]
        for g in range(n_ops):
            copy = rows[:, basis.images[g][part]] * basis.parity[g][part].astype(np.float32)
            for (characters, _, _), total in zip(problems, totals, strict=True):
                (np.add if characters[g] > 0.0 else np.subtract)(total, copy, out=total)
        place = np.searchsorted(part, numbers)
        for (_, stays, folded), total in zip(problems, totals, strict=True):
            own = stays[place]
            folded[(np.cumsum(stays) - 1)[place[own]]] = total[own][:, stays]
    while problems:
        characters, stays, folded = problems.pop()
        yield characters, folded, part[stays]


def _db(amplitude: C128) -> F64:
    return 20.0 * np.log10(np.maximum(np.abs(amplitude), 1e-12))


def directions(azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> F64:
    """(n, 3) unit vectors, azimuth from +x to +y, elevation above z = 0."""
    az, el = np.broadcast_arrays(
        np.radians(np.asarray(azimuth_deg, float)), np.radians(np.asarray(elevation_deg, float))
    )
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)


def check(step: float = 1.0 / 8.0) -> list[tuple[str, float]]:
    """Largest errors, dB: sphere with and without liner, splitting, mirror images."""
    rng = np.random.default_rng(5)
    found = []
    flips = (FLIP_X, FLIP_Y, FLIP_Z)
    radius = 1.28  # ka = 8.04, no resonance of the cavity chosen or avoided
    looks = directions(rng.uniform(0, 90, 8), rng.uniform(0, 90, 8))
    exact = 10.0 * np.log10(np.pi * radius**2 * mie(K * radius))
    for name, liner in (("bare", ()), ("with a sheet inside", (octant(0.6 * radius, 2 * step),))):
        s = amplitudes(Body((octant(radius, step),), flips, liner), looks)
        found.append((f"sphere, {name}, against Mie", float(np.abs(_db(s[:, [0, 2]]) - exact).max())))
    small = Body((rectangle([0, 0, 0], [1.0, 0, 0], [0, 0, 0.75], step),), (SWAP_XY, FLIP_Z), ground=True)
    looks = directions(rng.uniform(-60, 150, 12), rng.uniform(10, 80, 12))
    one, other = amplitudes(small, looks), amplitudes(small, looks, split=False)
    scale = np.abs(other).max()
    found.append(
        ("corner on ground, split against unsplit", float(20 * np.log10(np.abs(one - other).max() / scale)))
    )
    return found


def mie(ka: float) -> float:
    """Backscatter cross section of a conducting sphere over pi a^2, from the series (Bohren and Huffman 1983)."""
    n = np.arange(1, int(ka + 4.0 * ka ** (1.0 / 3.0) + 10.0))
    j, dj = spherical_jn(n, ka), spherical_jn(n, ka, derivative=True)
    h = j - 1j * spherical_yn(n, ka)
    dh = dj - 1j * spherical_yn(n, ka, derivative=True)
    terms = (j + ka * dj) / (h + ka * dh) - j / h
    return float(np.abs(((-1.0) ** n * (2 * n + 1) * terms).sum()) ** 2 / ka**2)


if __name__ == "__main__":
    for text, value in check():
        print(f"{text}: {value:.3f} dB", flush=True)
    sys.exit(0)
