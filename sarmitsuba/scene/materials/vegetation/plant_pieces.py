r"""Scattering and extinction of one leaf, needle or branch, by the angle between the wave and its axis.

A piece is a body of revolution. In the plane of its axis and the wave the field is *parallel*, else *across*; forwards
and backwards neither turns into the other. Amplitudes S are square roots of radar cross sections (m, with phase), in
unit vectors fixed in space; the far-field amplitude is :math:`f = S / \sqrt{4 \pi}`. Time convention exp(+j w t), so
that the optical theorem reads

.. math:: C_{ext} = -\frac{4 \pi}{k} \Im f(\text{forward}).

Polarisation of a thin dielectric rod by a plane wave: its integral equation in Legendre polynomials along the axis.

The field within is taken as even over the cross-section. Along the axis it obeys

.. math:: e = e_{inc} + (\epsilon - 1)\, S * e, \quad
    S_l(h) = -1 - j \pi J_1(\kappa a) H_1^{(2)}(\kappa a), \quad
    S_t(h) = \Big(\frac{k^2}{\kappa^2} - \tfrac12\Big) S_l - \tfrac12, \quad \kappa^2 = k^2 - h^2

along and across, with the operator's transform S over the wavenumber h: the mean, over two discs, of the Green
function's. Its static limits are the depolarisation of an endless needle, 0 and -1/2, and that of a short wave, -1 and
0; the imaginary part is the radiated power, so that the optical theorem holds.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy

from sarmitsuba.core.arrays import C128, F64

# number of polynomials, plus one per unit of half the length times the wavenumber; k l above which the rod is taken as
# endless
LEAST_ORDERS, LONGEST = 8, 60.0
# of the integrals over half length times wavenumber: step and least end of the even grid, nodes of the one beyond
_STEP, _EVEN, _BEYOND = 0.1, 200.0, 300


@dataclass(frozen=True, eq=False)
class ThinRod:
    """Mean polarisation of a rod over its volume and (eps - 1) E of the wave, along and across the axis.

    Parameters
    ----------
    half : k l / 2
    along, across : (orders, orders) matrices from moments of the incident field to the response
    endless : radius (m), wavenumber (rad/m) and permittivity
    """

    half: float
    along: C128
    across: C128
    endless: tuple[float, float, complex]

    def response(self, incident: F64, scattered: F64) -> tuple[C128, C128]:
        """Response along and across, (...,) complex, at cosines of the incident and scattered wave to the axis."""
        if not self.along.size:
            return self.of_endless(incident, scattered)
        incident, scattered = np.broadcast_arrays(incident, scattered)
        places = np.stack(
            [(incident / self._step + self._side).ravel(), (scattered / self._step + self._side).ravel()]
        )
        along, across = (
            (
                scipy.ndimage.map_coordinates(table.real, places, mode="nearest", prefilter=False)
                + 1j * scipy.ndimage.map_coordinates(table.imag, places, mode="nearest", prefilter=False)
            ).reshape(incident.shape)
            for table in self._tables
        )
        return along, across

    def of_endless(self, incident: F64, scattered: F64) -> tuple[C128, C128]:
        """Response with the field of an infinite rod, cut to the length."""
        radius, k, permittivity = self.endless
        form = np.sinc(self.half * (incident - scattered) / np.pi)
        along, across = symbols(k * incident, k, radius)
        chi = permittivity - 1.0
        return form / (1.0 - chi * along), form / (1.0 - chi * across)

    @property
    def _step(self) -> float:
        """Step of the tables in the cosine: at most a sixth of a radian of phase at the rod's ends."""
        return 1.0 / (32.0 + 6.0 * self.half)

    @property
    def _side(self) -> int:
        """Nodes from the middle of a table to its end, some beyond a cosine of 1."""
        return int(1.0 / self._step) + 8

    @cached_property
    def _tables(self) -> tuple[C128, C128]:
        """Spline coefficients of the response, along and across, over the incident and the scattered cosine."""
        moments = self._moments(
            np.asarray(self._step * np.arange(-self._side, self._side + 1), dtype=np.float64)
        )
        first, second = (
            scipy.ndimage.spline_filter(
                0.5 * (moments @ solved.T @ np.conj(moments.T)), mode="nearest", output=np.complex128
            )
            for solved in (self.along, self.across)
        )
        return first, second

    def _moments(self, cosine: F64) -> C128:
        """(..., orders) integrals of the wave's phase along the rod times Legendre polynomials."""
        n = np.arange(len(self.along))
        u = np.asarray(self.half * cosine)[..., None]
        return np.asarray(2.0 * (-1j) ** n * np.sign(u) ** n * scipy.special.spherical_jn(n, np.abs(u)))


@lru_cache(maxsize=32)
def thin_rod(radius: float, length: float, wavenumber: float, permittivity: complex) -> ThinRod:
    """Solution of the integral equation of a thin rod, for waves from all directions.

    Parameters
    ----------
    radius, length : m
    wavenumber : rad/m
    permittivity : relative, eps' - j eps''

    Notes
    -----
    Ignores how the field changes over the cross-section, which comes into the amplitude in second order only, as the
    operator's mean is taken over both cross-sections (Galerkin), and currents that circle in the magnetic field. Up to
    ``k a sqrt(eps) = 0.5`` the extinction of an endless rod, wave in the plane of the axis, is within 0.3 dB of the
    series, and across it up to 1.1 dB below: `Stick` takes only the difference that the ends make.
    """
    half, chi = 0.5 * wavenumber * length, permittivity - 1.0
    none = np.zeros((0, 0), dtype=np.complex128)
    if 2.0 * half > LONGEST:
        return ThinRod(half, none, none, (radius, wavenumber, permittivity))
    orders = LEAST_ORDERS + int(half)
    n = np.arange(orders)
    # K_nm = (2 / pi) int j^n (-j)^m j_n(u) j_m(u) S(2 u / l) du, even in u; zero where n + m is odd
    end = max(_EVEN, 2.0 * orders**2)
    u: F64 = np.asarray((np.arange(int(end / _STEP)) + 0.5) * _STEP, dtype=np.float64)
    far = u[-1] + 0.5 * _STEP
    bessel = scipy.special.spherical_jn(n[:, None], u)
    weights = np.stack(symbols(2.0 * u / length, wavenumber, radius)) * _STEP
    # beyond, j_n j_m is (-1)^((n - m) / 2) / 2 u^2 on average
    t: F64 = np.asarray(
        np.geomspace(far, far * 1e4 * max(1.0, length / radius / far), _BEYOND), dtype=np.float64
    )
    rest_of = np.stack(symbols(2.0 * t / length, wavenumber, radius)) * 0.5 / t
    tail = [complex(np.trapezoid(row, np.log(t))) for row in rest_of]
    turn = np.real(1j ** (n[:, None] - n))
    same = np.abs(turn) > 0.5
    unity = np.diag(2.0 / (2.0 * n + 1.0))
    solved = []
    for weight, rest in zip(weights, tail, strict=True):
        operator = (4.0 / np.pi) * (turn * ((bessel * weight) @ bessel.T) + same * rest)
        solved.append(np.linalg.inv(unity - chi * operator))
    return ThinRod(half, solved[0], solved[1], (radius, wavenumber, permittivity))


def symbols(h: F64, wavenumber: float, radius: float) -> tuple[C128, C128]:
    """Transforms of the operator over the wavenumber h along the axis, along and across; see the module."""
    kappa = np.sqrt(wavenumber**2 - np.square(h) + 0j)
    x = np.where(kappa.imag > 0.0, -kappa, kappa) * radius
    x = np.where(np.abs(x) < 1e-7, 1e-7, x)
    with np.errstate(all="ignore"):
        along = -1.0 - 1j * np.pi * scipy.special.jv(1, x) * scipy.special.hankel2(1, x)
    deep = (np.abs(x.imag) > 50.0) | ~np.isfinite(along)
    along = np.where(deep, -1.0 + 1.0 / np.maximum(np.abs(x), 1.0), along)
    across = ((wavenumber * radius / x) ** 2 - 0.5) * along - 0.5
    return np.asarray(along), np.asarray(across)


Pair = tuple[C128, C128]

# k a |sqrt(eps)| above which a cylinder's ground bounce uses its series, and k a up to which the field within a leaf is
# the static one
THIN, SMALL_LEAF = 0.2, 0.5
# an infinite cylinder along the wave has no solution: its series is evaluated no nearer than this, rad
_END_ON = 0.02
# directions of scattered waves over which the power scattered by small pieces is summed
_TILTS, _TURNS = 24, 48
# angles from the axis at which the series is summed
_NODES = 96


@dataclass(frozen=True, eq=False)
class OverGround:
    """Ground-bounce geometry: incident directly and scattered over level ground, or reciprocal, for axes (...,).

    Parameters
    ----------
    cosine : between the wave and the vertical; incident downwards along i and scattered downwards along s, turned about
    x, y, z : components of the axes' unit vectors: x in the plane of both legs, z upwards
    """

    cosine: float
    x: F64
    y: F64
    z: F64

    @property
    def sine(self) -> float:
        """Sine between the wave and the vertical."""
        return float(np.sqrt(1.0 - self.cosine**2))

    @property
    def along(self) -> tuple[F64, F64]:
        """Cosines between the axes and both directions."""
        return self.sine * self.x - self.cosine * self.z, -self.sine * self.x - self.cosine * self.z

    @property
    def turned(self) -> float:
        """Cosine between both directions."""
        return self.cosine**2 - self.sine**2

    @property
    def axis_on_field(self) -> tuple[F64, F64, F64]:
        """Parts of the axes along H, which is the same on both legs, V of the incident and V of the scattered leg."""
        return -self.y, self.cosine * self.x + self.sine * self.z, -self.cosine * self.x + self.sine * self.z

    def dyad(self, across: C128, along: C128) -> "Channels":
        """Amplitudes of a body with these responses across and along its axis."""
        h, v, out = self.axis_on_field
        change = along - across
        return (
            across + change * h * h,
            -self.turned * across + change * v * out,
            change * h * v,
            change * h * out,
        )


Channels = tuple[C128, C128, C128, C128]


class Piece(ABC):
    """Axially symmetric scatterer.

    Attributes
    ----------
    size : m, its largest extent
    """

    @property
    @abstractmethod
    def size(self) -> float:
        """Largest extent, m."""

    @abstractmethod
    def backscatter(self, angle: F64, wavelength: float, permittivity: complex) -> Pair:
        """S in backscatter, (n,) complex each, parallel and across, at angles (n,) rad from the axis, 0 to pi."""

    @abstractmethod
    def over_ground(self, view: OverGround, wavelength: float, permittivity: complex) -> Channels:
        """Ground-bounce amplitudes S: HH, VV, V to H and H to V, each (...,) complex, m."""

    @abstractmethod
    def extinction(self, angle: F64, wavelength: float, permittivity: complex) -> tuple[F64, F64]:
        """Extinction cross sections, (n,) m^2 each, parallel and across."""


@dataclass(frozen=True)
class Leaf(Piece):
    r"""Thin round disc; its axis is its normal.

    Small against the wave, :math:`k a < 1/2`: generalised Rayleigh-Gans, the static field of a flat spheroid within.
    Else the disc is a resistive sheet with the current of an endless one,

    .. math:: \alpha_t = \frac{V (\epsilon - 1)}{1 + \tfrac12 j k t (\epsilon - 1) g}, \quad
        g = 1 / \cos\beta \text{ (across)}, \ \cos\beta \text{ (parallel)},

    and both have :math:`S = k^2 \alpha / \sqrt{4 \pi} \cdot 2 J_1(Q) / Q, Q = 2 k a \sin\beta`.

    Parameters
    ----------
    radius, thickness : m

    Notes
    -----
    Ignores the outline (a disc has no stalk and no teeth), bending, the current's change at the edge, and layers within
    the leaf. The static field breaks the optical theorem: the forward amplitude of a small piece holds absorption only.
    Its extinction is therefore absorption plus the power that it scatters, summed over all directions. The sheet keeps
    the theorem.

    References
    ----------
    Karam, Fung & Antar 1988, IEEE TGRS 26, 799-808 (Rayleigh-Gans). Senior, Sarabandi & Ulaby 1987, Radio Science 22,
    1109-1116 (resistive sheet).
    """

    radius: float
    thickness: float

    @property
    def size(self) -> float:
        """Diameter, m."""
        return 2.0 * self.radius

    @property
    def volume(self) -> float:
        """m^3."""
        return float(np.pi * self.radius**2 * self.thickness)

    def backscatter(self, angle: F64, wavelength: float, permittivity: complex) -> Pair:
        """See the class."""
        k = 2.0 * np.pi / wavelength
        q = 2.0 * k * self.radius * np.sin(angle)
        form = np.where(q > 1e-6, 2.0 * scipy.special.j1(q) / np.where(q > 1e-6, q, 1.0), 1.0)
        gain = k**2 / np.sqrt(4.0 * np.pi) * form
        tangential, across, normal = self._response(angle, k, permittivity)
        parallel = tangential * np.cos(angle) ** 2 + normal * np.sin(angle) ** 2
        return gain * parallel, gain * across

    def over_ground(self, view: OverGround, wavelength: float, permittivity: complex) -> Channels:
        """See the class; the sheet's current is that of the mean of both angles."""
        k = 2.0 * np.pi / wavelength
        incident, scattered = view.along
        tangential, across, normal = self._response(
            np.arccos(0.5 * (np.abs(incident) + np.abs(scattered))), k, permittivity
        )
        q = k * self.radius * np.sqrt(np.maximum(2.0 - 2.0 * view.turned - (incident - scattered) ** 2, 0.0))
        gain = (
            k**2
            / np.sqrt(4.0 * np.pi)
            * np.where(q > 1e-6, 2.0 * scipy.special.j1(q) / np.where(q > 1e-6, q, 1.0), 1.0)
        )
        return view.dyad(gain * 0.5 * (tangential + across), gain * normal)

    def extinction(self, angle: F64, wavelength: float, permittivity: complex) -> tuple[F64, F64]:
        """See the class."""
        k = 2.0 * np.pi / wavelength
        tangential, across, normal = self._response(angle, k, permittivity)
        parallel = tangential * np.cos(angle) ** 2 + normal * np.sin(angle) ** 2
        taken = -k * parallel.imag, -k * across.imag
        if not self._is_small(k):
            return taken
        scattered = _scatter_piece(
            angle, k, complex(tangential[0]), complex(normal[0]), lambda way: _disc_form(k * self.radius, way)
        )
        return taken[0] + scattered[0], taken[1] + scattered[1]

    def _is_small(self, k: float) -> bool:
        return k * self.radius < SMALL_LEAF

    def _response(self, angle: F64, k: float, permittivity: complex) -> tuple[C128, C128, C128]:
        """Polarisabilities (m^3): tangential in the plane of axis and wave, tangential across it, normal."""
        chi = permittivity - 1.0
        volume, one = self.volume, np.ones(angle.shape, dtype=np.complex128)
        if self._is_small(k):
            side = 0.25 * np.pi * self.thickness / (2.0 * self.radius)  # of a flat spheroid, first order
            tangential = one * volume * chi / (1.0 + side * chi)
            return tangential, tangential, one * volume * chi / (1.0 + (1.0 - 2.0 * side) * chi)
        cosine = np.maximum(np.abs(np.cos(angle)), 1e-3) * one
        sheet = 0.5j * k * self.thickness * chi
        whole = volume * chi * one
        return whole / (1.0 + sheet * cosine), whole / (1.0 + sheet / cosine), whole / permittivity


@dataclass(frozen=True)
class Stick(Piece):
    r"""A round cylinder: needle, twig or branch.

    The current of an endless cylinder, cut to the length,

    .. math:: S = \frac{2 l}{\sqrt \pi} T(\beta) \, \mathrm{sinc}(k l \cos\beta)

    with the series T of the endless cylinder at oblique incidence, and the change by the ends: the difference of
    the polarisations of a thin rod of that length and of an endless one, of `thin_rod`,

    .. math:: S_{ends} = \frac{k^2}{\sqrt{4 \pi}} V (\epsilon - 1) (q_l - q_\infty)

    That difference counts in full up to :math:`k a |\sqrt\epsilon| = 1` and :math:`k l = 40`, less beyond, and not from
    2 and 60 on.

    Parameters
    ----------
    radius, length : m

    Notes
    -----
    Ignores the ends of thick pieces, bark and bends. The optical theorem holds for both parts.

    References
    ----------
    Bohren & Huffman 1983, section 8.4, equations 8.29 to 8.36 (series); Seker & Schneider 1988, IEEE TAP 36, 303-307
    (finite cylinder with the field of the endless one).
    """

    radius: float
    length: float

    @property
    def size(self) -> float:
        """Length, m."""
        return self.length

    @property
    def volume(self) -> float:
        """m^3."""
        return float(np.pi * self.radius**2 * self.length)

    def backscatter(self, angle: F64, wavelength: float, permittivity: complex) -> Pair:
        """See the class."""
        k = 2.0 * np.pi / wavelength
        form = np.sinc(k * self.length * np.cos(angle) / np.pi)
        parallel, perpendicular = _series(angle, k * self.radius, permittivity, np.pi)
        gain = 2.0 * self.length / np.sqrt(np.pi) * form
        along, across = self._ends(k, permittivity, np.cos(angle), -np.cos(angle))
        # the series is that of the cone's far side, where what is polarised across the axis counts the other way round
        turned = 2.0 * self._cut(k, permittivity, np.cos(angle), -np.cos(angle))[1]
        # the series' unit vector across turns with the scattered wave
        return (
            gain * parallel + along * np.sin(angle) ** 2 + (across + turned) * np.cos(angle) ** 2,
            -gain * perpendicular + across,
        )

    def over_ground(self, view: OverGround, wavelength: float, permittivity: complex) -> Channels:
        """See the class; a thin piece by its polarisation alone.

        The series is taken on the cone between both angles, without the coupling of both parts off broadside. Between
        ``THIN`` and half of it both are mixed.
        """
        k = 2.0 * np.pi / wavelength
        incident, scattered = view.along
        size = self._thickness(k, permittivity)
        share = float(np.clip(2.0 * size / THIN - 1.0, 0.0, 1.0))  # of the series
        along, across = self._ends(k, permittivity, incident, scattered)
        if share < 1.0:
            endless = self._cut(k, permittivity, incident, scattered)
            along, across = along + (1.0 - share) * endless[0], across + (1.0 - share) * endless[1]
        if share == 0.0:
            return view.dyad(across, along)
        form = np.sinc(0.5 * k * self.length * (incident - scattered) / np.pi)
        s_in, s_out = (np.sqrt(np.maximum(1.0 - c**2, _END_ON**2)) for c in (incident, scattered))
        turn = np.arccos(np.clip((view.turned - incident * scattered) / (s_in * s_out), -1.0, 1.0))
        cone = np.arcsin(np.minimum(np.sqrt(s_in * s_out), 1.0))
        parallel, perpendicular = _series(cone, k * self.radius, permittivity, turn)
        gain = share * 2.0 * self.length / np.sqrt(np.pi) * form / (s_in * s_out)
        h, v, out = view.axis_on_field
        # unit vectors in the plane of axis and wave, and across it, on H and V of both legs
        series = (
            gain * (parallel * h * h - perpendicular * v * out),
            gain * (parallel * v * out - perpendicular * h * h),
            gain * (parallel * v * h + perpendicular * h * out),
            gain * (parallel * h * out + perpendicular * v * h),
        )
        ends = view.dyad(across, along)
        return series[0] + ends[0], series[1] + ends[1], series[2] + ends[2], series[3] + ends[3]

    def extinction(self, angle: F64, wavelength: float, permittivity: complex) -> tuple[F64, F64]:
        """See the class."""
        k = 2.0 * np.pi / wavelength
        forward = _series(angle, k * self.radius, permittivity, 0.0)
        gain = 4.0 * np.pi / k * self.length / np.pi
        along, across = self._ends(k, permittivity, np.cos(angle), np.cos(angle))
        ends = along * np.sin(angle) ** 2 + across * np.cos(angle) ** 2, across
        parallel, perpendicular = (
            -gain * amplitude.imag - np.sqrt(4.0 * np.pi) / k * end.imag
            for amplitude, end in zip(forward, ends, strict=True)
        )
        return parallel, perpendicular

    def _thickness(self, k: float, permittivity: complex) -> float:
        """Circumference over the wavelength within."""
        return float(k * self.radius * np.sqrt(abs(permittivity)))

    def _rod(self, k: float, permittivity: complex) -> ThinRod:
        return thin_rod(self.radius, self.length, k, permittivity)

    def _gain(self, k: float, permittivity: complex) -> complex:
        """S over the mean polarisation, m: the share of it that counts of thick pieces."""
        share = float(np.clip(2.0 - self._thickness(k, permittivity), 0.0, 1.0))
        return complex(share * k**2 / np.sqrt(4.0 * np.pi) * self.volume * (permittivity - 1.0))

    def _cut(self, k: float, permittivity: complex, incident: F64, scattered: F64) -> Pair:
        """S of a thin endless rod cut to the length, along and across the axis, m."""
        gain = self._gain(k, permittivity)
        if gain == 0.0:
            none = np.zeros(np.shape(incident), dtype=np.complex128)
            return none, none
        along, across = self._rod(k, permittivity).of_endless(incident, scattered)
        return gain * along, gain * across

    def _ends(self, k: float, permittivity: complex, incident: F64, scattered: F64) -> Pair:
        """End correction of the amplitude."""
        endless, gain = self._cut(k, permittivity, incident, scattered), self._gain(k, permittivity)
        share = float(np.clip(3.0 - 3.0 * k * self.length / LONGEST, 0.0, 1.0))
        if gain == 0.0 or share == 0.0:
            return 0.0 * endless[0], 0.0 * endless[1]
        whole = self._rod(k, permittivity).response(incident, scattered)
        return share * (gain * whole[0] - endless[0]), share * (gain * whole[1] - endless[1])


def _disc_form(size: float, change: F64) -> F64:
    """Form factor of a disc; ``change`` (3, ...): difference of both directions' unit vectors, axis last."""
    q = size * np.hypot(change[0], change[1])
    return np.where(q > 1e-6, 2.0 * scipy.special.j1(q) / np.where(q > 1e-6, q, 1.0), 1.0)


def _scatter_piece(
    angle: F64, k: float, across: complex, along: complex, form: Callable[[F64], F64]
) -> tuple[F64, F64]:
    """Scattering cross sections of a small piece, (n,) m^2, parallel and across.

    Parameters
    ----------
    angle : (n,) rad, from the axis
    across, along : polarisabilities, m^3
    form : form factor from the difference (3, n, tilts, turns) of both directions' unit vectors, axis last
    """
    cosine, weight = np.polynomial.legendre.leggauss(_TILTS)
    turn = (np.arange(_TURNS) + 0.5) * (2.0 * np.pi / _TURNS)
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    out = np.stack(
        [sine * np.cos(turn), sine * np.sin(turn), np.broadcast_to(cosine[:, None], (_TILTS, _TURNS))]
    )
    c, s, none = np.cos(angle), np.sin(angle), np.zeros(angle.shape)
    incident = np.stack([s, none, c])
    shape = np.square(form(incident[:, :, None, None] - out[:, None]))
    found = []
    for x, y, z in ((across * c, none, -along * s), (none, across * np.ones(angle.shape), none)):
        moment = np.stack([x, y, z])
        lost = np.abs(np.tensordot(moment, out, axes=(0, 0))) ** 2
        power = np.sum(np.abs(moment) ** 2, axis=0)[:, None, None] - lost
        found.append(k**4 / (8.0 * np.pi * _TURNS) * np.einsum("ntu,ntu,t->n", power, shape, weight))
    return found[0], found[1]


def cylinder_series(angle: F64, size: float, permittivity: complex, turn: float) -> Pair:
    r"""Amplitude T of an endless dielectric cylinder at oblique incidence, parallel and across.

    Scaled so that a length l of it has the far-field amplitude :math:`f = (l / \pi) T`.

    Parameters
    ----------
    angle : (n,) rad, between wave and axis, 0 to pi
    size : k a
    permittivity : ``eps' - j eps''``
    turn : rad, azimuth of the scattered wave on its cone; 0 forward, pi back
    """
    weight = np.cos(np.arange(_orders(size)) * turn)
    parallel, across = cylinder_coefficients(angle, size, permittivity)
    return parallel @ weight, across @ weight


def _orders(size: float) -> int:
    return int(size + 4.0 * np.cbrt(size) + 4.0)


def cylinder_coefficients(angle: F64, size: float, permittivity: complex) -> Pair:
    r"""Coefficients (n, orders) of :math:`T = \sum_n c_n \cos n \phi`, parallel and across; see `cylinder_series`.

    References
    ----------
    Bohren & Huffman 1983, Absorption and scattering of light by small particles, equations 8.29 to 8.36, theirs under
    exp(-i w t).
    """
    m2 = np.conj(permittivity)
    angle = np.clip(angle, _END_ON, np.pi - _END_ON)
    cosine, xi = np.cos(angle), size * np.sin(angle)
    eta = size * np.sqrt(m2 - cosine**2 + 0j)
    parallel, across = [], []
    for n in range(_orders(size)):
        j_out, j_in, h = scipy.special.jv(n, xi), scipy.special.jv(n, eta), scipy.special.hankel1(n, xi)
        slope_out, slope_in, slope_h = (
            (scipy.special.jv(n - 1, xi) - scipy.special.jv(n + 1, xi)) / 2.0,
            (scipy.special.jv(n - 1, eta) - scipy.special.jv(n + 1, eta)) / 2.0,
            (scipy.special.hankel1(n - 1, xi) - scipy.special.hankel1(n + 1, xi)) / 2.0,
        )
        mixing = n * cosine * eta * j_in * (xi**2 / eta**2 - 1.0)
        d, c = mixing * h, mixing * j_out
        b = xi * (m2 * xi * slope_in * j_out - eta * j_in * slope_out)
        v = xi * (m2 * xi * slope_in * h - eta * j_in * slope_h)
        w = 1j * xi * (eta * j_in * slope_h - xi * slope_in * h)
        a = 1j * xi * (xi * slope_in * j_out - eta * j_in * slope_out)
        scale = (1.0 if n == 0 else 2.0) / (w * v + 1j * d**2)
        parallel.append(scale * (w * b + 1j * d * c))
        across.append(-scale * (a * v - 1j * c * d))
    return np.conj(1j * np.stack(parallel, axis=-1)), np.conj(1j * np.stack(across, axis=-1))


def _series(angle: F64, size: float, permittivity: complex, turn: float | F64) -> Pair:
    """`cylinder_series` at angles (...,) and as many turns, between nodes: it varies slowly, unlike a piece's lobes."""
    folded = np.minimum(angle, np.pi - angle)
    weight = np.cos(np.multiply.outer(turn, np.arange(_orders(size))))
    first, second = (np.sum(spline(folded) * weight, axis=-1) for spline in _splines(size, permittivity))
    return first, second


@lru_cache(maxsize=16)
def _splines(
    size: float, permittivity: complex
) -> "tuple[scipy.interpolate.CubicSpline, scipy.interpolate.CubicSpline]":
    """Spline coefficients of the series, cached for all angles of a piece."""
    nodes = np.linspace(0.0, 0.5 * np.pi, _NODES)
    first, second = (
        scipy.interpolate.CubicSpline(nodes, table)
        for table in cylinder_coefficients(nodes, size, permittivity)
    )
    return first, second
