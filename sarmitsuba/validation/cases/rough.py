"""Rough surfaces: coherent loss, shared energy, and a wall on rough ground."""

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import simpson

from sarmitsuba import theory
from sarmitsuba.materials.diffuse import diffuse_tables
from sarmitsuba.materials.fresnel import fresnel
from sarmitsuba.materials.material import Material
from sarmitsuba.simulation.rcs import monostatic_rcs
from sarmitsuba.validation import targets
from sarmitsuba.validation.cases.diffuse import CELL, RAYS_PER_CELL, diffuse_flags
from sarmitsuba.validation.comparison import Case, CaseEntry, Comparison, db

F64 = NDArray[np.float64]
FREQUENCY = targets.BANDS["X"]
LAM = targets.wavelength("X")
SOIL = 15.0 - 3.0j
WALL = 5.24 - 0.507j
# ground lit through the wall, m: whole cells deep and long, since a cell lit in part returns less than its share
DEEP, LONG = 12.0, 24.0


def coherent_loss(quick: bool = False) -> Case:
    """Loss of the specular return over roughness (plate) and over angle (wall on rough ground)."""
    ks = np.linspace(0.0, 2.0, 9 if quick else 21)
    side = 0.5
    plate = targets.plate(side, side)
    levels = [
        monostatic_rcs(
            plate,
            (Material("rough", pec=True, rms_height=float(x) * LAM / (2.0 * np.pi)),),
            [[0.0, 0.0, 1.0]],
            FREQUENCY,
            channels=("VV",),
            max_depth=1,
        ).rcs_dbsm("VV")[0]
        for x in ks
    ]
    simulated = np.asarray(levels) - levels[0]
    comparisons = [
        Comparison(
            "plate at normal incidence over k s",
            ks,
            db(np.exp(-4.0 * ks**2)),
            simulated,
            tolerance=0.01,
            reason="float32 exponential",
            unit="dB",
            shown=int(np.argmin(np.abs(ks - 1.0))),
        )
    ]
    theta = np.arange(15.0, 81.0, 5.0)
    look = targets.from_azimuth(np.zeros_like(theta), np.radians(90.0 - theta))
    shape = targets.wall_and_ground(0.8, 0.6, 2.0)
    for x in (0.3, 0.8):
        power = []
        for s in (0.0, x * LAM / (2.0 * np.pi)):
            materials = (Material("wall", pec=True), Material("ground", pec=True, rms_height=s))
            result = monostatic_rcs(
                shape, materials, look, FREQUENCY, channels=("VV",), max_depth=2, keep_orders=True
            )
            power.append(db(np.abs(result.amplitude[:, 1, 0]) ** 2))
        comparisons.append(
            Comparison(
                f"wall on ground of k s = {x:g}, over incidence angle / 10 deg",
                theta / 10.0,
                db(theory.coherent_loss(x * LAM / (2.0 * np.pi), LAM, np.radians(theta))),
                power[1] - power[0],
                tolerance=0.01,
                reason="the same rays: float32 rounding",
                unit="dB",
                shown=int(np.argmin(np.abs(theta - 35.0))),
            )
        )
    return Case(
        name="coherent_loss",
        topic="rough",
        title="Coherent loss of rough surfaces",
        formula="exp(-4 (k s cos t)^2) in power",
        source="Ament, Proc. IRE 41 (1953); Beckmann and Spizzichino (1963)",
        x_label="k s, or incidence angle / 10 deg",
        y_label="loss (dB)",
        comparisons=tuple(comparisons),
        note="Relative to the smooth target with the same rays; for the wall the double bounce alone.",
    )


def shared_energy(quick: bool = False) -> Case:
    """Coherent and diffuse power of a rough surface add up to what a smooth one reflects."""
    theta = np.radians(np.arange(0.0, 86.0, 5.0))
    comparisons = []
    for ks in (0.3, 1.0, 3.0):
        material = Material(
            "soil", permittivity=SOIL, rms_height=ks * LAM / (2.0 * np.pi), diffuse_law="roughness"
        )
        table = diffuse_tables(material, LAM, 256)
        for name, amplitude, r in (
            ("HH", table.amplitude_h, fresnel(np.cos(theta), SOIL)[0]),
            ("VV", table.amplitude_v, fresnel(np.cos(theta), SOIL)[1]),
        ):
            # sigma0(i, s) = a(i) a(s); albedo = integral over the hemisphere / (4 pi cos_i)
            hemisphere = simpson(2.0 * np.pi * amplitude * np.sin(table.theta), x=table.theta)
            at = np.interp(theta, table.theta, amplitude)
            diffuse = at * hemisphere / (4.0 * np.pi * np.cos(theta))
            smooth = np.abs(r) ** 2
            kept = smooth * theory.coherent_loss(material.rms_height, LAM, theta)
            comparisons.append(
                Comparison(
                    f"k s = {ks:g}, {name}",
                    np.degrees(theta),
                    smooth,
                    kept + diffuse,
                    tolerance=2e-3,
                    reason="quadrature over the kernel's table of 256 angles",
                    unit="",
                    shown=int(np.argmin(np.abs(np.degrees(theta) - 35.0))),
                )
            )
    return Case(
        name="shared_energy",
        topic="rough",
        title="Energy is shared between the coherent and the diffuse return",
        formula="|R|^2 exp(-4 (k s cos t)^2) + albedo(t) = |R|^2",
        source="conservation of energy; tables as the kernel reads them",
        x_label="incidence angle (deg)",
        y_label="share of the incident power",
        comparisons=tuple(comparisons),
        note='Law "roughness", soil of eps 15 - 3j, X band.',
    )


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
                        db(want),
                        db(got),
                        tolerance=4.0 * sigma + 0.2,
                        reason=f"4 standard errors ({sigma:.2f} dB each) and 0.2 dB of cells lit in part",
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
    flags = diffuse_flags(("HH", "VV"), fresnel=True, multi_bounce=True, visibility=True, diffuse_double=True)
    # azimuths far enough apart for speckle of 24 m to change, near enough for the wall's projection to stay
    azimuth = np.linspace(-0.02, 0.02, looks)
    power = np.zeros((3, 2))
    for seed in range(seeds):
        result = monostatic_rcs(
            targets.wall_and_ground(DEEP / np.tan(theta), LONG, 2.0 * DEEP),
            (Material("wall", permittivity=WALL), ground),
            targets.from_azimuth(azimuth, np.pi / 2.0 - theta),
            FREQUENCY,
            max_depth=3,
            keep_orders=True,
            ray_spacing=float(CELL * np.sqrt(min(np.cos(theta), np.sin(theta)) / RAYS_PER_CELL)),
            flags=flags,
            seed=seed,
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
            LAM,
            ground.rms_height,
            ground.correlation_length,
            WALL,
            None,
            "hh" if channel == "HH" else "vv",
        )
        return closed.ground * 2.0 * lit, closed.double + closed.triple
    r2 = float(np.abs(fresnel(np.sin(theta), WALL)[0 if channel == "HH" else 1]) ** 2)
    return 0.1 * 2.0 * lit, 0.1 * lit * (4.0 * r2 + r2**2)


CASES = (
    CaseEntry("coherent_loss", "rough", coherent_loss),
    CaseEntry("shared_energy", "rough", shared_energy),
    CaseEntry("canonical_building", "rough", canonical_building),
)

__all__ = ["CASES", "canonical_building", "coherent_loss", "shared_energy"]
