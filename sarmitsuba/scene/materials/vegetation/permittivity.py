"""Permittivity of plant matter from its moisture."""

import numpy as np


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
