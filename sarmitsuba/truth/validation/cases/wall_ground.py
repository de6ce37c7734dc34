"""Double bounce of a wall on the ground."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS, wavelength
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.targets import PERMITTIVITY


def wall_ground(quick: bool = False) -> Case:
    """Double bounce of a concrete wall on soil, HH and VV: level and loss against metal."""
    lam = wavelength("X")
    height, length, ground = 0.8, 0.6, 2.0
    theta = np.linspace(15.0, 80.0, 14 if quick else 66)
    look = targets.from_azimuth(np.zeros_like(theta), np.radians(90.0 - theta))
    shape = targets.wall_and_ground(height, length, ground)

    def double(wall: Material, floor: Material) -> F64:
        result = monostatic_rcs(
            shape,
            (wall, floor),
            look,
            BANDS["X"],
            max_depth=2,
            keep_orders=True,
            ray_spacing=lam / 4.5,
        )
        return np.abs(result.amplitude[:, 1, :]) ** 2

    concrete = Material("concrete", permittivity=PERMITTIVITY["concrete"])
    soil = Material("soil", permittivity=PERMITTIVITY["soil"])
    metal = Material("metal", pec=True)
    power, perfect = double(concrete, soil), double(metal, metal)
    arguments = (height, length, ground, lam, np.radians(theta))
    closed = theory.wall_ground_amplitude(*arguments, concrete.permittivity, soil.permittivity)
    closed_metal = theory.wall_ground_amplitude(*arguments)
    comparisons = []
    for i, channel in enumerate(("HH", "VV")):
        comparisons += [
            Comparison(
                f"{channel}, concrete on soil",
                theta,
                db_from_power(np.abs(closed[i]) ** 2),
                db_from_power(power[:, i]),
                tolerance=0.3,
                reason="rim of the lit aperture resolved to a fifth of a wavelength",
                canonical=True,
                floor=30.0,
            ),
            Comparison(
                f"{channel}, relative to metal",
                theta,
                db_from_power(np.abs(closed[i] / closed_metal[i]) ** 2),
                db_from_power(power[:, i] / perfect[:, i]),
                tolerance=0.02,
                reason="the same rays: float32 rounding, a larger share near the Brewster angles of VV",
                unit="dB",
                floor=40.0,
            ),
        ]
    return Case(
        name="wall_ground",
        topic="materials",
        title="Wall-ground double bounce, concrete on soil",
        formula="(2 sqrt(pi) / lambda) 2 b min(h sin t, g cos t) R_wall(90 - t) R_ground(t); HH by TE, VV by TM",
        source="dihedral of unequal faces with both Fresnel coefficients (Ulaby and Long 2014)",
        x_label="incidence angle on the ground (deg)",
        y_label="RCS (dBsm) or ratio (dB)",
        comparisons=tuple(comparisons),
        note=f"Wall {height:g} m x {length:g} m, ground {ground:g} m, X band; eps 5.24 - 0.507j and 15 - 3j.",
    )


CASES.register(CaseEntry("wall_ground", "materials", wall_ground))
