"""Every diffuse law over angle through the kernel."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.band_sampling import X_WAVELENGTH
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.patch import mean_power
from sarmitsuba.truth.validation.targets import PERMITTIVITY

SOIL = PERMITTIVITY["soil"]
LAWS = (
    Material("constant", pec=True, diffuse_law="constant", diffuse_level_db=-12.0),
    Material("constant gamma", pec=True, diffuse_law="constant_gamma", diffuse_level_db=-12.0),
    Material(
        "kirchhoff", permittivity=SOIL, rms_height=0.02, correlation_length=0.141, diffuse_law="kirchhoff"
    ),
    Material(
        "small perturbation",
        permittivity=SOIL,
        rms_height=0.001,
        correlation_length=0.03,
        diffuse_law="small_perturbation",
    ),
    Material("iem", permittivity=SOIL, rms_height=0.004, correlation_length=0.04, diffuse_law="iem"),
    Material(
        "small slope", permittivity=SOIL, rms_height=0.004, correlation_length=0.04, diffuse_law="small_slope"
    ),
    Material("roughness", permittivity=SOIL, rms_height=0.004, diffuse_law="roughness"),
)


def diffuse_laws(quick: bool = False) -> Case:
    """Every law over angle through the kernel, HH and VV, with the speckle divided out."""
    degrees = np.array([10.0, 30.0, 50.0] if quick else [2.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0])
    theta = np.radians(degrees)
    unit = Material("unit", pec=True, diffuse_law="constant", diffuse_level_db=0.0)

    def power_of(material: Material) -> F64:
        return np.array([mean_power(material, float(t), size=8.0, looks=16, seeds=1) for t in theta])

    reference = power_of(unit)
    comparisons = []
    for material in LAWS:
        power = power_of(material) / reference
        closed = _closed_law(material, theta)
        for i, channel in enumerate(("HH", "VV")):
            if i == 1 and np.array_equal(closed[0], closed[1]):
                continue
            comparisons.append(
                Comparison(
                    f"{material.name}, {channel}",
                    degrees,
                    db_from_power(closed[i]),
                    db_from_power(power[:, i]),
                    tolerance=0.1,
                    reason="linear interpolation in a table of 256 angles",
                    unit="dB",
                    floor=60.0,
                    shown=int(np.argmin(np.abs(degrees - 30.0))),
                )
            )
    return Case(
        name="diffuse_laws",
        topic="rough",
        title="Diffuse laws over angle through the kernel",
        formula="constant, gamma cos t, Kirchhoff, small perturbation, integral equation, small slope, shared energy",
        source="Ulaby, Moore and Fung II (1982); Fung, Li and Chen (1992); each evaluated anew at the angle",
        x_label="incidence angle (deg)",
        y_label="sigma0 (dB)",
        comparisons=tuple(comparisons),
        note="Relative to a surface of sigma0 = 1 with the same rays and scatterers, so that speckle cancels.",
    )


def _closed_law(material: Material, theta: F64) -> tuple[F64, F64]:
    """Law of a material at exact angles as published, without the package's functions and without its table."""
    k, s, length = 2.0 * np.pi / X_WAVELENGTH, material.rms_height, material.correlation_length
    level = 10.0 ** (material.diffuse_level_db / 10.0)
    law = material.diffuse_law
    if law == "small_perturbation":
        return theory.small_perturbation_sigma0(theta, SOIL, k, s, length)
    if law == "small_slope":
        return theory.small_slope_sigma0(theta, SOIL, k, s, length)
    if law == "iem":
        return theory.integral_equation_sigma0(theta, SOIL, k, s, length)
    if law == "roughness":
        return theory.shared_energy_sigma0(theta, SOIL, k * s)
    if law == "constant":
        same = np.full_like(theta, level)
    elif law == "constant_gamma":
        same = level * np.cos(theta)
    else:
        r2 = float(np.abs(theory.fresnel(1.0, SOIL)[0]) ** 2)
        back = [
            theory.kirchhoff_sigma0(
                float(t), 0.5 * np.pi, X_WAVELENGTH, s, length, r2, model="geometrical_optics"
            )
            for t in theta
        ]
        same = np.asarray(back)
    return same, same


CASES.register(CaseEntry("diffuse_laws", "rough", diffuse_laws))
