"""Edge diffraction of metal: Michaeli's equivalent fringe currents along sharp edges, added to physical optics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64
from sarmitsuba.backend import device_array, dr, mi
from sarmitsuba.materials.material import Material
from sarmitsuba.mesh.sharp_edges import DIRECTIONS, WIDEST_GAP, SharpEdges, sharp_edges
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.trace import field
from sarmitsuba.trace.intersector import intersector
from sarmitsuba.trace.leg import Leg
from sarmitsuba.trace.source import Scatterers
from sarmitsuba.trace.state import Kernel

# longest piece of an edge, wavelengths, unless the rays of surfaces are farther apart, or the resolution cell is
# smaller: visibility is decided piece by piece
LONGEST = 2.0
# distance from an edge (wavelengths, share of its piece) within which another object counts as touching it
REACH, REACH_SHARE = 0.02, 0.25
# corners of the closed path round an edge along which touching objects are searched
PROBES = 8
# bisection steps for the width of a sheet
BISECTIONS = 12
# least sine of the angle between wave and edge, and least angle in a wedge, rad: the formulas are held there
LEAST = 1e-3
# widths of the gap between two faces at which shadow rays from their edge start
GAPS = 2.0
# m, width used for a sheet of unknown width
FAR = 1e6
# places along all edges at which the widths of sheets are found, or one on each piece where there are fewer
SPANS = 20_000
# modulus below which the series of a difference of cotangents is used
SERIES = 0.2


def edges_of(
    geometry: Geometry,
    materials: tuple[Material, ...],
    wavelength: float,
    cell: float = np.inf,
    spacing: float = 0.0,
) -> SharpEdges:
    """Sharp metal edges of a scene, cut into pieces, without edges that touch another object and edges that move.

    Parameters
    ----------
    geometry, materials : of the scene
    wavelength : m
    cell : m, bound on the length of a piece
    spacing : m between the rays of surfaces: pieces are as long, or ``LONGEST`` wavelengths where that is more
    """
    visible = ~np.array([m.invisible for m in materials], dtype=bool)[geometry.face_material]
    moving = np.zeros(geometry.n_faces, dtype=bool)
    for _, faces in geometry.moving_meshes():
        moving[faces] = True
    corners = geometry.vertices[geometry.faces[visible]]
    metal = np.array([m.metallic for m in materials], dtype=bool)[geometry.face_material[visible]]
    metal &= ~moving[visible]
    if not metal.any():
        return sharp_edges(np.zeros((0, 3, 3)), np.zeros(0, dtype=bool))
    edges = sharp_edges(corners, metal, WIDEST_GAP * wavelength, geometry.face_mesh[visible])
    longest = min(max(LONGEST * wavelength, spacing), cell)
    scene = intersector(corners.astype(np.float32))
    edges = edges.cut(max(longest, float(edges.length.sum()) / SPANS))
    edges = replace(edges, span=spans(edges, scene, geometry.diameter)).cut(longest)
    return edges.of(uncovered(edges, scene, wavelength))


def spans(edges: SharpEdges, scene: mi.Scene, largest: float) -> F64:
    """Widths (n, DIRECTIONS), m, of the metal sheets behind rims, see :class:`sarmitsuba.mesh.sharp_edges.SharpEdges`.

    By bisection, with short rays across the sheet's plane: correct for sheets without holes.

    Parameters
    ----------
    edges : pieces of edges
    scene : intersection structure of everything that waves meet
    largest : m, upper bound of the width
    """
    out = np.full((edges.n, DIRECTIONS), np.inf)
    rims = np.flatnonzero(edges.angle == 2.0)
    if not rims.size:
        return out
    rim = edges.of(rims)
    turn = np.pi * ((np.arange(DIRECTIONS) + 0.5) / DIRECTIONS - 0.5)
    directions = np.cos(turn)[:, None] * rim.inward[:, None, 0] + np.sin(turn)[:, None] * rim.along[:, None]
    up = np.broadcast_to(rim.normal[:, None, 0], directions.shape)
    reach = max(1e-4 * largest, 16.0 * 2.0**-24 * float(np.abs(edges.middle).max()))
    low, high = np.zeros(directions.shape[:2]), np.full(directions.shape[:2], largest)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        place = rim.middle[:, None] + middle[..., None] * directions - reach * up
        there = _met(scene, place.reshape(-1, 3), (2.0 * reach * up).reshape(-1, 3)).reshape(middle.shape)
        low, high = np.where(there, middle, low), np.where(there, high, middle)
    out[rims] = 0.5 * (low + high)
    return out


def _met(scene: mi.Scene, start: F64, step: F64) -> NDArray[np.bool_]:
    """Whether (n,) straight steps (n, 3) from points (n, 3) meet a triangle."""
    origin, direction = (
        [device_array(mi.Float, np.ascontiguousarray(column, dtype=np.float32)) for column in rows.T]
        for rows in (start, step)
    )
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction), mi.Float(1.0), 0.0, [])
    return np.asarray(scene.ray_test(ray), dtype=bool)


def uncovered(edges: SharpEdges, scene: mi.Scene, wavelength: float) -> NDArray[np.bool_]:
    """Edges (n,) that touch no other object: a path round the middle of each, through its exterior, meets no triangle.

    Parameters
    ----------
    edges : pieces of edges
    scene : intersection structure of everything that waves meet
    wavelength : m
    """
    if not edges.n:
        return np.zeros(0, dtype=bool)
    rounding = 16.0 * 2.0**-24 * np.abs(edges.middle).max()
    reach = np.maximum(np.minimum(REACH * wavelength, REACH_SHARE * edges.length), rounding)
    reach = np.maximum(reach, GAPS * edges.gap)  # past a face that reaches over the other
    # from a sixteenth of the exterior off face a to as much off face b
    share = np.linspace(1.0 / 16.0, 15.0 / 16.0, PROBES)
    turn = np.pi * edges.angle[:, None] * share
    rim = (
        np.cos(turn)[..., None] * edges.inward[:, None, 0]
        + np.sin(turn)[..., None] * edges.normal[:, None, 0]
    )
    path = edges.middle[:, None] + reach[:, None, None] * rim
    start, step = path[:, :-1].reshape(-1, 3), np.diff(path, axis=1).reshape(-1, 3)
    met = _met(scene, start, step).reshape(edges.n, PROBES - 1)
    return np.asarray(~met.any(axis=1))


class FringeCurrents(Scatterers):
    r"""Michaeli's equivalent fringe currents of short straight edges, with the phase integral over each.

    .. math::
        \sqrt\sigma = \frac{j}{\sqrt\pi} l\, \mathrm{sinc}\left(\tfrac12 k l (\hat d - \hat s) \cdot \hat z\right)
        \mathbf q \cdot \sum_{a, b} \left[ \hat z \frac{E_z D_s + \cos\beta' H_z (\mu D_h - \frac1N + U)}
        {\sin^2\beta'} + \hat x \frac{H_z D_h}{\sin\beta'} \right]

    with H in units of the field. The coefficients of a face, lit (U = 1) or not,

    .. math::
        D_s = -\tfrac12 [C(\tfrac{\phi' + a}2) + C(\tfrac{\phi' - a}2)], \quad
        D_h = \frac{C(\tfrac{\phi' + a}2) - C(\tfrac{\phi' - a}2)}{2 \sin a}, \quad
        C(x) = \tfrac1N \cot\tfrac xN - U \cot x

    are finite where the exact and the physical-optics current both diverge, since their poles at x = 0 cancel. Where
    :math:`\mu = -\cos a` is below -1, a is imaginary and x complex. :func:`sarmitsuba.theory.fringe_strip` has the
    geometry. The mean of a path and of the reversed one is taken, so that ``S_HV = S_VH``.

    Parameters
    ----------
    edges : pieces

    Notes
    -----
    Of the interactions between edges the travelling wave along a sheet is included (electric field across the sheet),
    from the rim that it meets first to the other and back (:func:`sarmitsuba.theory.sheet_transition`).

    Ignores corners, other waves between edges, the curvature of edges and the roughness of the metal. Within a
    thousandth of the forward direction of a grazing wave, where the theory diverges, the value at that distance is
    taken.
    """

    def __init__(self, edges: SharpEdges) -> None:
        self.n = edges.n
        self._wedge: _Wedge | None = None
        self._middle = device_array(mi.Float64, edges.middle)
        rows = [
            np.column_stack([edges.inward[:, 0], edges.angle]),
            np.column_stack([edges.normal[:, 0], edges.length]),
            np.column_stack([edges.inward[:, 1], edges.weight]),
            np.column_stack([edges.normal[:, 1], np.maximum(edges.gap, 0.0)]),
        ]
        self._table = device_array(mi.Float, np.stack(rows, axis=1).astype(np.float32))
        self._span = device_array(mi.Float, np.minimum(edges.span, FAR).astype(np.float32))

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """See :class:`sarmitsuba.trace.source.Scatterers`."""
        return dr.gather(mi.Vector3d, self._middle, index)

    def departure(
        self, index: mi.UInt32, point: mi.Vector3f, direction: mi.Vector3f, clearance: mi.Float
    ) -> mi.Vector3f:
        """Start of a shadow ray, m: off both faces of the wedge and past the gap between them, along the direction."""
        first, second = self._row(index, 0), self._row(index, 2)
        clearance = clearance + GAPS * self._row(index, 3).w
        inward = mi.Vector3f(first.x + second.x, first.y + second.y, first.z + second.z)
        return point + (direction - dr.normalize(inward)) * clearance

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        """See the class."""
        if self._wedge is None or not self._wedge.sees(incident, scattered):
            # one wedge for all channels of two legs, and for the reversed path
            if self._wedge is not None and self._wedge.sees(scattered, incident):
                self._wedge = self._wedge.reversed
            else:
                rows = [self._row(index, i) for i in range(4)]
                self._wedge = _Wedge.of(
                    kernel, rows, incident, scattered, lambda leg: self._width(index, leg)
                )
        return self._wedge.amplitude(e, q)

    def _width(self, index: mi.UInt32, turn: mi.Float) -> mi.Float:
        """Width of the sheet behind a rim, m, in a direction ``turn`` off its inward normal."""
        part = mi.Int32((turn / dr.pi + 0.5) * DIRECTIONS)
        return dr.gather(
            mi.Float, self._span, index * DIRECTIONS + mi.UInt32(dr.clip(part, 0, DIRECTIONS - 1))
        )

    def _row(self, index: mi.UInt32, i: int) -> mi.Vector4f:
        return dr.gather(mi.Vector4f, self._table, index * 4 + i)


@dataclass(frozen=True, eq=False)
class _Wedge:
    """Diffraction coefficients of a piece of edge for an incident and a scattered wave.

    Parameters
    ----------
    legs : of the incident and of the scattered wave
    strips : fringe currents of both faces, for the path and for the reversed one
    gain : m, length of the piece times its normalised phase integral over twice the root of pi; 0 where either
        direction lies inside the metal
    along : transition factors of the waves that graze the sheet to and from the edge, electric field across the sheet
    """

    legs: tuple[Leg, Leg]
    strips: tuple[tuple[_Strip, _Strip], ...]
    gain: mi.Float
    along: tuple[mi.Complex2f, mi.Complex2f]

    @staticmethod
    def of(
        kernel: Kernel,
        rows: list[mi.Vector4f],
        incident: Leg,
        scattered: Leg,
        width: Callable[[mi.Float], mi.Float],
    ) -> _Wedge:
        """Wedge from the rows of the edge table, and the width of the sheet by the angle off the inward direction."""
        n, length = rows[0].w, rows[1].w
        faces = [
            _Face.of(mi.Vector3f(x.x, x.y, x.z), mi.Vector3f(y.x, y.y, y.z)) for x, y in (rows[:2], rows[2:])
        ]
        source, observer = incident.to_antenna, scattered.to_antenna
        strips, outside = [], mi.Bool(True)
        for face in faces:
            out = _Strip.of(face, n, source, observer)
            into = out if incident is scattered else _Strip.of(face, n, observer, source)
            outside &= out.outside & into.outside
            strips.append((out, into))
        turn = dr.dot(source + observer, faces[0].along) * (0.5 * kernel.constants.wavenumber) * length
        gain = (0.5 / float(np.sqrt(np.pi))) * length * rows[2].w * _sinc(turn)
        k = kernel.constants.wavenumber
        there = _along_sheet(faces[0], n, source, k, width)
        back = there if incident is scattered else _along_sheet(faces[0], n, observer, k, width)
        return _Wedge((incident, scattered), tuple(strips), dr.select(outside, gain, 0.0), (there, back))

    @property
    def reversed(self) -> _Wedge:
        """The same wedge for the reversed path."""
        incident, scattered = self.legs
        there, back = self.along
        strips = tuple((into, out) for out, into in self.strips)
        return _Wedge((scattered, incident), strips, self.gain, (back, there))

    def sees(self, incident: Leg, scattered: Leg) -> bool:
        """Whether the wedge was made for these two legs."""
        return self.legs[0] is incident and self.legs[1] is scattered

    def amplitude(self, e: field.ComplexVector, q: field.ComplexVector) -> mi.Complex2f:
        """Square root of the RCS with its phase, m: mean of the path and of the reversed one."""
        total, along = mi.Complex2f(0.0), self.along[0] * self.along[1]
        for out, into in self.strips:
            total += out.current(e, q, along) + into.current(q, e, along)
        return mi.Complex2f(-total.imag, total.real) * self.gain


def _sinc(x: mi.Float) -> mi.Float:
    small = dr.abs(x) < 1e-2
    return dr.select(small, 1.0 - dr.square(x) / 6.0, dr.sin(x) / dr.select(small, 1.0, x))


@dataclass(frozen=True, eq=False)
class _Face:
    """Frame of one face of a wedge: unit vectors into the face across the edge, normal to it, and along the edge."""

    inward: mi.Vector3f
    normal: mi.Vector3f
    along: mi.Vector3f

    @staticmethod
    def of(inward: mi.Vector3f, normal: mi.Vector3f) -> _Face:
        return _Face(inward, normal, dr.cross(inward, normal))


@dataclass(frozen=True, eq=False)
class _Strip:
    """Fringe current of a strip of one face, per metre of edge and unit field.

    Parameters
    ----------
    face : of the wedge
    outside : whether the wave comes through the exterior
    to_source : where the wave comes from
    cosine, sine : of the angle between the wave and the edge
    soft, hard, charge : D_s, D_h and mu D_h - 1 / N + U
    grazing : unit vector of the diffracted ray along the face
    lifted : across it, to the source's side of a sheet: there the observer is taken to be if it lies along that ray
    """

    face: _Face
    outside: mi.Bool
    to_source: mi.Vector3f
    cosine: mi.Float
    sine: mi.Float
    soft: mi.Float
    hard: mi.Float
    charge: mi.Float
    grazing: mi.Vector3f
    lifted: mi.Vector3f

    @staticmethod
    def of(face: _Face, n: mi.Float, to_source: mi.Vector3f, to_observer: mi.Vector3f) -> _Strip:
        across, off = dr.dot(to_source, face.inward), dr.dot(to_source, face.normal)
        cosine = -dr.dot(to_source, face.along)
        sine = dr.maximum(dr.sqrt(dr.square(across) + dr.square(off)), LEAST)
        phi = dr.atan2(off, across)
        # the middle of the interior separates exterior angles from angles slightly below face a
        phi = dr.select(phi < -(1.0 - 0.5 * n) * dr.pi, phi + 2.0 * dr.pi, phi)
        outside = (phi > -LEAST) & (phi < n * dr.pi + LEAST)
        phi = dr.clip(phi, 0.0, n * dr.pi)
        # sin(alpha / 2): half the length of the difference of the unit vectors
        grazing = face.inward * sine + face.along * cosine
        w = 0.5 * dr.norm(to_observer - grazing) / sine
        real = _spectra(n, phi, w)
        imaginary = _evanescent(n, phi, w)
        soft, hard = (dr.select(w <= 1.0, a, b) for a, b in zip(real, imaginary, strict=True))
        lit = dr.select(phi < dr.pi, mi.Float(1.0), 0.0)
        mu = 1.0 - 2.0 * dr.square(w)
        # along that ray D_h diverges while the current component across it vanishes: the limit depends on the side
        side = dr.select((phi < dr.pi) | (n < 2.0 - LEAST), mi.Float(1.0), -1.0)
        lifted = dr.select(w < 0.5 * LEAST, face.normal * (side * LEAST * sine), mi.Vector3f(0.0))
        charge = mu * hard - dr.rcp(n) + lit
        return _Strip(face, outside, to_source, cosine, sine, soft, hard, charge, grazing, lifted)

    def current(self, e: field.ComplexVector, q: field.ComplexVector, share: mi.Complex2f) -> mi.Complex2f:
        """Fringe current along q for an incident field e, with ``share`` of its magnetic component along the edge."""
        at = dr.squared_norm(self.lifted) > 0.0
        off = field.dot(q, dr.select(at, self.grazing + self.lifted, mi.Vector3f(0.0)))
        q = field.add(q, field.scale(-off, self.grazing))
        h = field.cross_left(-self.to_source, e)
        e_z, h_z = field.dot(e, self.face.along), field.dot(h, self.face.along) * share
        along = (e_z * self.soft + h_z * (self.cosine * self.charge)) * dr.rcp(dr.square(self.sine))
        across = h_z * (self.hard / self.sine)
        return along * field.dot(q, self.face.along) + across * field.dot(q, self.face.inward)


def _along_sheet(
    face: _Face, n: mi.Float, to: mi.Vector3f, wavenumber: mi.Float, width: Callable[[mi.Float], mi.Float]
) -> mi.Complex2f:
    """Transition factor T of :func:`sarmitsuba.theory.plate_along_its_sheet`; 1 for wedges and beyond the rim."""
    across, off = dr.dot(to, face.inward), dr.abs(dr.dot(to, face.normal))
    part = across * dr.rsqrt(dr.maximum(dr.square(across) + dr.square(off), LEAST**2))
    a = width(dr.atan2(dr.dot(to, face.along), across))
    # sin(gamma / 2) from the sine
    half = off * dr.rsqrt(2.0 + 2.0 * dr.sqrt(dr.maximum(1.0 - dr.square(off), 0.0)))
    t = _transition(dr.sqrt(2.0 * wavenumber * a) * half)
    sheet = (n > 2.0 - LEAST) & (part > 0.0) & (a < 0.5 * FAR)
    return dr.select(sheet, 1.0 + (t - 1.0) * dr.minimum(4.0 * part, 1.0), mi.Complex2f(1.0))


def _transition(w: mi.Float) -> mi.Complex2f:
    """Fresnel transition function ``(2 e^(j pi / 4) / sqrt(pi)) int_0^w e^(-j t^2) dt``, error below 0.004.

    Source: Abramowitz and Stegun 7.3.32 and 7.3.33.
    """
    x = w * float(np.sqrt(2.0 / np.pi))
    f = (1.0 + 0.926 * x) / (2.0 + x * (1.792 + x * 3.104))
    g = dr.rcp(2.0 + x * (4.142 + x * (3.492 + x * 6.670)))
    s, c = dr.sincos(dr.square(w))
    cosine, sine = 0.5 + f * s - g * c, 0.5 - f * c - g * s
    return mi.Complex2f(cosine + sine, cosine - sine)


def _spectra(n: mi.Float, phi: mi.Float, w: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Coefficients D_s and D_h where a is real: cos(a / 2) = w."""
    a = dr.clip(2.0 * dr.acos(dr.minimum(w, 1.0)), LEAST, dr.pi - LEAST)
    lit = phi < dr.pi
    plus, minus = _fringe(n, 0.5 * (phi + a), lit), _fringe(n, 0.5 * (phi - a), lit)
    return -0.5 * (plus + minus), 0.5 * (plus - minus) / dr.sin(a)


def _fringe(n: mi.Float, x: mi.Float, lit: mi.Bool) -> mi.Float:
    """Cotangent difference C(x); it has a pole at x = 0 where the face is not lit, and one at pi where it is."""
    x = dr.select(lit, dr.minimum(x, dr.pi - LEAST), dr.maximum(x, LEAST))
    small = lit & (dr.abs(x) < SERIES)
    safe = dr.select(small, 1.0, x)
    whole = _real_cot(safe / n) / n - dr.select(lit, _real_cot(safe), 0.0)
    first, third = _series(n)
    return dr.select(small, x * (first + third * dr.square(x)), whole)


def _real_cot(x: mi.Float) -> mi.Float:
    s, c = dr.sincos(x)
    return c / s


def _series(n: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Coefficients of x and x^3 in C(x)."""
    r2 = dr.square(dr.rcp(n))
    return (1.0 - r2) / 3.0, (1.0 - dr.square(r2)) / 45.0


def _evanescent(n: mi.Float, phi: mi.Float, w: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Coefficients D_s and D_h where a is imaginary: cosh(|a| / 2) = w; C(x) for both signs are complex conjugates."""
    w = dr.maximum(w, 1.0)
    eta = dr.maximum(2.0 * dr.log(w + dr.sqrt((w - 1.0) * (w + 1.0))), LEAST)
    lit = phi < dr.pi
    re, im = _cot(phi / n, eta / n)
    re_lit, im_lit = _cot(phi, eta)
    re = re / n - dr.select(lit, re_lit, 0.0)
    im = im / n - dr.select(lit, im_lit, 0.0)
    small = lit & (dr.square(phi) + dr.square(eta) < (2.0 * SERIES) ** 2)
    u, v = 0.5 * phi, 0.5 * eta
    first, third = _series(n)
    re = dr.select(small, u * (first + third * (dr.square(u) - 3.0 * dr.square(v))), re)
    im = dr.select(small, v * (first + third * (3.0 * dr.square(u) - dr.square(v))), im)
    return -re, im / dr.sinh(eta)


def _cot(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Real and imaginary part of cot((u + j v) / 2)."""
    bottom = 2.0 * (dr.square(dr.sinh(0.5 * v)) + dr.square(dr.sin(0.5 * u)))
    return dr.sin(u) / bottom, -dr.sinh(v) / bottom
