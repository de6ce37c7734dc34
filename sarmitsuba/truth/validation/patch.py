"""Mean echo of a rough patch alone, through the kernel in the far field."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import (
    X_BAND,
)

# edge of a scatterer cell in the far-field tracer, m
CELL = 1.0
RAYS_PER_CELL = 4.0
# edge of the patch, m, and looks per surface: few cells and many looks cost least for a given standard error
SIZE, LOOKS = 24.0, 150
# uncertainty of the number of nodes of a rotated lattice in the patch, three, dB
COUNT_DB = db_from_power(1.0 + 3.0 / SIZE**2)


def diffuse_flags(channels: tuple[str, ...]) -> KernelFlags:
    """Kernel effects of a lone rough patch: diffuse scatterers and nothing else."""
    return KernelFlags(
        channels=channels,
        fresnel=False,
        roughness=False,
        coherent=False,
        diffuse_double=False,
        depolarisation=False,
        antenna_pattern=False,
        taper=False,
        visibility=False,
        multi_bounce=False,
    )


def standard_error(seeds: int) -> float:
    """Relative standard error of ``mean_power``: independent looks, and independent cells of one surface each."""
    return float(np.sqrt(1.0 / (LOOKS * seeds) + 1.0 / (SIZE**2 * seeds)))


def mean_power(
    material: Material,
    theta: float,
    *,
    channels: tuple[str, ...] = ("HH", "VV"),
    size: float = SIZE,
    looks: int = LOOKS,
    seeds: int = 8,
    flags: KernelFlags | None = None,
    sector: tuple[float, float] = (0.0, 2.0 * np.pi),
) -> F64:
    """Mean |channel|^2 over the patch's area (sigma0, linear), one value per channel.

    Looks at one incidence angle from random azimuths are independent samples of speckle; each seed is another
    surface. ``sector``: azimuths to look from, rad; a few degrees hold many independent ones.
    """
    rng = np.random.default_rng(11)
    total = np.zeros(len(channels))
    spacing = CELL * np.sqrt(np.cos(theta) / RAYS_PER_CELL)
    for seed in range(seeds):
        azimuth = sector[0] + (sector[1] - sector[0]) * rng.random(looks)
        result = monostatic_rcs(
            targets.plate(size, size),
            (material,),
            targets.from_azimuth(azimuth, np.pi / 2.0 - theta),
            X_BAND,
            channels=channels,
            ray_spacing=float(spacing),
            max_depth=1,
            flags=flags or diffuse_flags(channels),
            cell=CELL,
            seed=seed,
        )
        total += np.mean(np.abs(result.amplitude[:, 0, :]) ** 2, axis=0)
    return total / seeds / size**2
