"""Canopy: scattering medium of leaves, needles and branches, averaged over sizes and orientations.

The permittivity of plant matter follows from its moisture. A medium has extinction and backscatter per metre, by
polarisation and angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.registry import Registry
from sarmitsuba.scene.materials.change import coherence_after
from sarmitsuba.scene.materials.vegetation.plant_pieces import OverGround, Piece


def plant_permittivity(moisture: float, frequency: float) -> complex:
    r"""Relative permittivity ``eps' - j eps''`` of leaves, stalks, fresh wood: the dual-dispersion model.

    .. math:: \epsilon = \epsilon_r + v_{fw} \epsilon_f + v_b \epsilon_b

    of dry matter, free water with ions of conductivity 1.27 S/m (Debye at 18 GHz) and water bound to sugars
    (Cole-Cole at 0.18 GHz, exponent 1/2).

    Parameters
    ----------
    moisture : gravimetric, mass of water over the whole mass, 0 to 0.7
    frequency : Hz

    Notes
    -----
    Ignores temperature (22 degrees Celsius), salinity other than 8.5 g/kg, grain of the wood, and frost: frozen plants
    have ``eps'`` below 5. Measured from 0.2 to 20 GHz.

    References
    ----------
    Ulaby & El-Rayes 1987, IEEE Transactions on Geoscience and Remote Sensing GE-25, 550-557.
    """
    ghz = frequency / 1e9
    dry = 1.7 + moisture * (6.16 * moisture - 0.74)
    share_free = max(moisture * (0.55 * moisture - 0.076), 0.0)
    share_bound = 4.64 * moisture**2 / (1.0 + 7.36 * moisture**2)
    free = 4.9 + 75.0 / (1.0 + 1j * ghz / 18.0) - 18.0j * 1.27 / ghz
    bound = 2.9 + 55.0 / (1.0 + np.sqrt(1j * ghz / 0.18))
    return complex(dry + share_free * free + share_bound * bound)


# nodes of the tables, uniform in the cosine to the vertical from 0 to 1
NODES = 17


def node_cosines() -> F64:
    """Cosines between the wave and the vertical at the nodes of the tables, (NODES,)."""
    return np.linspace(0.0, 1.0, NODES)


@dataclass(frozen=True, eq=False)
class Covariance:
    """Mean polarimetric powers of a return, tables over the cosine between the wave and the vertical.

    Parameters
    ----------
    power : (NODES, 3) m^2/m^3, mean cross sections HH, VV and HV
    product : (NODES,) m^2/m^3, mean of the amplitude HH times the conjugate of VV
    """

    power: F64
    product: C128

    @property
    def factors(self) -> tuple[F64, F64, C128, F64]:
        r"""Cholesky factors, (NODES,) each, of the amplitudes from independent Gaussians :math:`g_i`.

        .. math:: HH = l_{11} g_1, \quad VV = l_{21} g_1 + l_{22} g_2, \quad HV = l_{33} g_3
        """
        hh, vv, hv = self.power.T
        first: F64 = np.sqrt(hh)
        mixed = np.conj(self.product) / np.where(first > 0.0, first, 1.0)
        second: F64 = np.sqrt(np.maximum(vv - np.abs(mixed) ** 2, 0.0))
        return first, second, np.asarray(mixed), np.asarray(np.sqrt(hv))


@dataclass(frozen=True, eq=False)
class VolumeMedium:
    """Tables over the cosine between the wave and the vertical, see `node_cosines`.

    Parameters
    ----------
    name : unique in a scene
    extinction : (NODES, 2) 1/m, of the power of H and of V
    back : of direct backscatter
    over_ground : of the ground bounce: incident directly and scattered over level ground, or reciprocal
    temporal_coherence : of the return between two passes long apart, 0 ... 1; 1: nothing changes
    decorrelation_days : time constant of its decay to that; 0: at once

    Notes
    -----
    Ignores delay (plants slow a wave by less than 1e-3), azimuth dependence (leaves and branches have none), and
    multiple scattering. H and V do not couple in propagation.
    """

    name: str
    extinction: F64
    back: Covariance
    over_ground: Covariance
    temporal_coherence: float = 1.0
    decorrelation_days: float = 0.0

    def coherence_after(self, days: float) -> float:
        """Coherence of the return between two passes, ``days`` apart."""
        return coherence_after(days, self.temporal_coherence, self.decorrelation_days)

    def at(self, cosine: float) -> tuple[F64, F64]:
        """Extinctions (2,) 1/m and powers (3,) m^2/m^3 at a cosine, between the nodes as the kernel takes them."""
        nodes = node_cosines()
        return tuple(
            np.array([np.interp(cosine, nodes, column) for column in table.T])
            for table in (self.extinction, self.back.power)
        )  # type: ignore[return-value]


def water_cloud(
    name: str,
    sigma_v: tuple[float, float],
    extinction: tuple[float, float],
    cross_ratio: float,
) -> VolumeMedium:
    r"""Water cloud: isotropic medium of given coefficients, equal for backscatter and ground bounce.

    H and V are correlated as in a cloud of scatterers turned at random about the line of sight,
    :math:`\langle HH \, VV^* \rangle = \sqrt{\sigma_H \sigma_V} (1 - 2 x)`.

    Parameters
    ----------
    name : of the medium
    sigma_v : m^2/m^3, HH and VV
    extinction : 1/m, of the power of H and V
    cross_ratio : x, power of HV over the geometric mean of HH and VV, 0 to 1

    References
    ----------
    Attema & Ulaby 1978, Radio Science 13, 357-364.
    """
    mean = float(np.sqrt(sigma_v[0] * sigma_v[1]))
    returned = Covariance(
        np.tile([*sigma_v, mean * cross_ratio], (NODES, 1)),
        np.full(NODES, mean * (1.0 - 2.0 * cross_ratio), dtype=np.complex128),
    )
    taken = np.tile(np.asarray(extinction, dtype=np.float64), (NODES, 1))
    return VolumeMedium(name, taken, returned, returned)


# azimuth nodes of an axis about the wave, and polar nodes in addition to those for the lobes of long pieces
_LEAST_TURNS, _LEAST_ANGLES, _ANGLES_PER_LOBE = 24, 96, 6.0
# least spread, deg: below, the sums over orientations are too coarse
LEAST_SPREAD = 2.0


@dataclass(frozen=True)
class Orientation:
    r"""Orientation distribution of the axes of pieces: about a tilt from the vertical, uniform in azimuth.

    Per solid angle :math:`\exp(-\tfrac12 (\tau - \tau_0)^2 / s^2)` of the tilt :math:`\tau`, 0 to 90 degrees.

    Parameters
    ----------
    tilt_deg : most frequent tilt, of a stick or of a leaf's normal
    spread_deg : standard deviation; inf: uniform over all directions

    Raises
    ------
    SceneError : the spread is below ``LEAST_SPREAD``
    """

    tilt_deg: float = 0.0
    spread_deg: float = np.inf

    def __post_init__(self) -> None:
        if not self.spread_deg >= LEAST_SPREAD:
            raise SceneError(
                f"orientation: spread_deg = {self.spread_deg:g} deg is below the bound {LEAST_SPREAD:g} deg; "
                "give more, or none for uniform directions"
            )

    def density(self, cosine: F64) -> F64:
        """Relative density per solid angle at cosines of the tilt, of any shape."""
        if not np.isfinite(self.spread_deg):
            return np.ones(cosine.shape)
        tilt = np.degrees(np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)))
        return np.asarray(np.exp(-0.5 * ((tilt - self.tilt_deg) / self.spread_deg) ** 2))

    @property
    def total(self) -> float:
        """Integral of `density` over the half sphere, sr."""
        cosine = np.linspace(0.0, 1.0, 4001)[1:] - 1.25e-4
        return float(2.0 * np.pi * np.mean(self.density(cosine)))


@dataclass(frozen=True)
class Constituent:
    """Constituent of a canopy: pieces of one kind and size.

    Parameters
    ----------
    piece : its shape
    density : pieces per m^3
    moisture : gravimetric, 0 to 0.7
    orientation : of the axes
    """

    piece: Piece
    density: float
    moisture: float
    orientation: Orientation = Orientation()


@dataclass(frozen=True)
class Canopy:
    """A named canopy for scene files: ``<string name="preset" value="NAME"/>``.

    Parameters
    ----------
    name : in the scene file
    title : half a line for tables
    constituents : all pieces in it
    """

    name: str
    title: str
    constituents: tuple[Constituent, ...]

    def denser(self, factor: float) -> "Canopy":
        """The canopy with the density of all pieces multiplied by a factor."""
        return replace(
            self, constituents=tuple(replace(c, density=factor * c.density) for c in self.constituents)
        )

    def medium(self, frequency: float) -> VolumeMedium:
        """The medium at a frequency, Hz."""
        means = [_mean(part, frequency) for part in self.constituents]
        density = [part.density for part in self.constituents]
        extinction = np.zeros((NODES, 2))
        for number, mean in zip(density, means, strict=True):
            extinction += number * mean.extinction
        back = _sum_pieces(density, [mean.back for mean in means])
        return VolumeMedium(
            self.name, extinction, back, _sum_pieces(density, [mean.over_ground for mean in means])
        )


CANOPIES: Registry[Canopy] = Registry("vegetation", Canopy, "sarmitsuba.scene.materials.vegetation.presets")


def _mean(part: Constituent, frequency: float) -> VolumeMedium:
    r"""Mean of one piece over its orientations (tables in m^2).

    In the frame of the wave the axis is at an angle :math:`\beta` from it and turned by :math:`\psi`,

    .. math::
        S_{hh} = S_\parallel \cos^2\psi + S_\perp \sin^2\psi, \quad
        S_{vv} = S_\parallel \sin^2\psi + S_\perp \cos^2\psi, \quad
        S_{hv} = (S_\parallel - S_\perp) \sin\psi \cos\psi
    """
    wavelength = SPEED_OF_LIGHT / frequency
    permittivity = plant_permittivity(part.moisture, frequency)
    # a long piece scatters back within a lobe of lambda / (2 l) about broadside
    lobes = 2.0 * part.piece.size / wavelength
    steps = int(_LEAST_ANGLES + _ANGLES_PER_LOBE * lobes)
    cosine = (np.arange(steps) + 0.5) / steps
    beta = np.arccos(cosine)
    # of the half circle: the other has the same tilts and powers
    turns = max(_LEAST_TURNS, round(400.0 / part.orientation.spread_deg))
    turn = ((np.arange(turns) + 0.5) / turns - 0.5) * np.pi
    c2, s2 = np.cos(turn) ** 2, np.sin(turn) ** 2
    parallel, across = (s[:, None] for s in part.piece.backscatter(beta, wavelength, permittivity))
    taken = part.piece.extinction(beta, wavelength, permittivity)
    hh, vv = parallel * c2 + across * s2, parallel * s2 + across * c2
    hv = np.abs(parallel - across) ** 2 * (c2 * s2)
    powers = [np.abs(hh) ** 2, np.abs(vv) ** 2, hv]
    lost = [taken[0][:, None] * c2 + taken[1][:, None] * s2, taken[0][:, None] * s2 + taken[1][:, None] * c2]
    product = hh * np.conj(vv)
    cell = 2.0 * np.pi / (steps * turns * part.orientation.total)
    extinction, power = np.zeros((NODES, 2)), np.zeros((NODES, 3))
    mean = np.zeros(NODES, dtype=np.complex128)
    for i, along in enumerate(node_cosines()):
        if i and not np.isfinite(part.orientation.spread_deg):  # uniform over all directions
            extinction[i], power[i], mean[i] = extinction[0], power[0], mean[0]
            continue
        # cosine between axis and vertical; v is in the plane of the wave and the vertical
        up = cosine[:, None] * along + np.sin(beta)[:, None] * np.sqrt(1.0 - along**2) * np.sin(turn)
        weight = part.orientation.density(up) * cell
        extinction[i] = [np.sum(x * weight) for x in lost]
        power[i] = [np.sum(x * weight) for x in powers]
        mean[i] = np.sum(product * weight)
    ground = _mean_over_ground(part, wavelength, permittivity, cosine, turn, cell)
    return VolumeMedium("", extinction, Covariance(power, mean), ground)


def _mean_over_ground(
    part: Constituent, wavelength: float, permittivity: complex, cosine: F64, turn: F64, cell: float
) -> Covariance:
    """Mean ground-bounce return of one piece, m^2; axes by their angle from the horizontal cross-range line.

    Both directions differ along that line: a long piece scatters within a lobe about the perpendicular plane.
    """
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    x, y, z = np.broadcast_arrays(cosine[:, None], sine * np.cos(turn), sine * np.sin(turn))
    weight = part.orientation.density(z) * cell
    nodes = node_cosines()
    # of every second node; at nadir and at the horizon there is no ground bounce
    picked = nodes[::2]
    power, product = np.zeros((picked.size, 3)), np.zeros(picked.size, dtype=np.complex128)
    for i, along in enumerate(np.clip(picked, 0.02, 0.999)):
        hh, vv, vh, hv = part.piece.over_ground(OverGround(float(along), x, y, z), wavelength, permittivity)
        cross = 0.5 * (np.abs(vh) ** 2 + np.abs(hv) ** 2)
        power[i] = [np.sum(p * weight) for p in (np.abs(hh) ** 2, np.abs(vv) ** 2, cross)]
        product[i] = np.sum(hh * np.conj(vv) * weight)
    return Covariance(
        np.stack([np.interp(nodes, picked, column) for column in power.T], axis=1),
        np.interp(nodes, picked, product.real) + 1j * np.interp(nodes, picked, product.imag),
    )


def _sum_pieces(density: Sequence[float], parts: Sequence[Covariance]) -> Covariance:
    """Sum of the returns of pieces, weighted by their densities."""
    power, product = np.zeros((NODES, 3)), np.zeros(NODES, dtype=np.complex128)
    for number, part in zip(density, parts, strict=True):
        power += number * part.power
        product += number * part.product
    return Covariance(power, product)
