"""A smooth wall on rough ground."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND, X_WAVELENGTH
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.patch import CELL, RAYS_PER_CELL, diffuse_flags
from sarmitsuba.truth.validation.targets import PERMITTIVITY

SOIL, WALL = PERMITTIVITY["soil"], PERMITTIVITY["concrete"]
# ground lit through the wall, m: whole cells deep and long, since a cell lit in part returns less than its share
DEEP, LONG = 12.0, 24.0


def canonical_building(quick: bool = False) -> Case:
    """Wall with rough ground: single, double and triple diffuse returns, HH and VV."""
    degrees = np.array([35.0] if quick else [25.0, 35.0, 50.0])
    looks, seeds = (40, 4) if quick else (64, 20)
    constant = Material("ground", permittivity=SOIL, diffuse_law="constant", diffuse_level_db=-10.0)
    # rms slope 0.2: a lobe of 11 degrees about the specular direction
    facets = Material("ground", pec=True, rms_height=0.1, correlation_length=0.7071, diffuse_law="kirchhoff")
    sigma = float(10.0 / np.log(10.0) * np.sqrt(1.0 / (looks * seeds) + 1.0 / (DEEP * LONG * seeds)))
    comparisons = []
    for ground in (constant,) if quick else (constant, facets):
        power = np.array([_wall_on_ground(ground, float(np.radians(t)), looks, seeds) for t in degrees])
        for j, channel in enumerate(("HH", "VV")):
            closed = np.array([_building_closed(ground, float(np.radians(t)), channel) for t in degrees])
            parts = [("double and triple", closed[:, 1], power[:, 1:, j].sum(axis=1))]
            if ground is constant:
                parts.insert(0, ("ground alone", closed[:, 0], power[:, 0, j]))
            for name, want, got in parts:
                comparisons.append(
                    Comparison(
                        f"{ground.diffuse_law} ground, {channel}, {name}",
                        degrees,
                        db_from_power(want),
                        db_from_power(got),
                        tolerance=4.0 * sigma + 0.1,
                        reason=f"4 standard errors ({sigma:.2f} dB each) and 0.1 dB of the number of nodes in strips",
                        shown=int(np.argmin(np.abs(degrees - 35.0))),
                    )
                )
    return Case(
        name="canonical_building",
        topic="rough",
        title="Smooth wall on rough ground",
        formula="sigma2 = 4 |R_w|^2 sigma0(t, t) h l tan t, sigma3 = |R_w|^4 sigma0_back h l tan t",
        source="Franceschetti, Iodice and Riccio, IEEE TGRS 40 (8) 2002: the contributions; Barrick (1968): the lobe",
        x_label="incidence angle (deg)",
        y_label="mean RCS (dBsm)",
        comparisons=tuple(comparisons),
        note=f"Concrete wall {LONG:g} m long, its image {DEEP:g} m deep on the ground; diffuse returns alone. "
        "Ground of constant sigma0 = -10 dB, and of tilted metal facets (Kirchhoff, rms slope 0.2), whose double "
        "bounce is its forward lobe. For dielectric facets the simulator takes the reflectivity of normal incidence.",
    )


def _wall_on_ground(ground: Material, theta: float, looks: int, seeds: int) -> F64:
    """(3, 2) mean power of bounce orders 1 to 3 in HH and VV, m^2."""
    flags = replace(
        diffuse_flags(("HH", "VV")), fresnel=True, multi_bounce=True, visibility=True, diffuse_double=True
    )
    # azimuths far enough apart for speckle of 24 m to change, near enough for the wall's projection to stay
    azimuth = np.linspace(-0.02, 0.02, looks)
    power = np.zeros((3, 2))
    for seed in range(seeds):
        result = monostatic_rcs(
            targets.wall_and_ground(DEEP / np.tan(theta), LONG, 2.0 * DEEP),
            (Material("wall", permittivity=WALL), ground),
            targets.from_azimuth(azimuth, np.pi / 2.0 - theta),
            X_BAND,
            max_depth=3,
            keep_orders=True,
            ray_spacing=float(CELL * np.sqrt(min(np.cos(theta), np.sin(theta)) / RAYS_PER_CELL)),
            flags=flags,
            seed=seed,
            cell=CELL,
        )
        power += np.mean(np.abs(result.amplitude) ** 2, axis=0) / seeds
    return power


def _building_closed(ground: Material, theta: float, channel: str) -> tuple[float, float]:
    """Open ground, and double with triple bounce, m^2."""
    lit = DEEP * LONG
    if ground.diffuse_law == "kirchhoff":
        closed = theory.canonical_building(
            DEEP / np.tan(theta),
            LONG,
            theta,
            X_WAVELENGTH,
            ground.rms_height,
            ground.correlation_length,
            WALL,
            None,
            "hh" if channel == "HH" else "vv",
        )
        return closed.ground * 2.0 * lit, closed.double + closed.triple
    r2 = float(np.abs(theory.fresnel(np.sin(theta), WALL)[0 if channel == "HH" else 1]) ** 2)
    return 0.1 * 2.0 * lit, 0.1 * lit * (4.0 * r2 + r2**2)


CASES.register(CaseEntry("canonical_building", "rough", canonical_building))
