"""Volume scattering medium: extinction and backscatter per metre, by polarisation and angle."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.scene.materials.change import coherence_after

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
