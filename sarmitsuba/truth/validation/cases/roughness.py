"""Smooth and rough shares of one surface: coherent loss, shared energy."""

import numpy as np
from scipy.integrate import simpson

from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND, X_WAVELENGTH
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.targets import PERMITTIVITY

SOIL = PERMITTIVITY["soil"]


def coherent_loss(quick: bool = False) -> Case:
    """Loss of the specular return over roughness (plate) and over angle (wall on rough ground)."""
    ks = np.linspace(0.0, 2.0, 9 if quick else 21)
    side = 0.5
    plate = targets.plate(side, side)
    levels = [
        monostatic_rcs(
            plate,
            (Material("rough", pec=True, rms_height=float(x) * X_WAVELENGTH / (2.0 * np.pi)),),
            [[0.0, 0.0, 1.0]],
            X_BAND,
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
            db_from_power(np.exp(-4.0 * ks**2)),
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
        for s in (0.0, x * X_WAVELENGTH / (2.0 * np.pi)):
            materials = (Material("wall", pec=True), Material("ground", pec=True, rms_height=s))
            result = monostatic_rcs(
                shape, materials, look, X_BAND, channels=("VV",), max_depth=2, keep_orders=True
            )
            power.append(db_from_power(np.abs(result.amplitude[:, 1, 0]) ** 2))
        comparisons.append(
            Comparison(
                f"wall on ground of k s = {x:g}, over incidence angle / 10 deg",
                theta / 10.0,
                db_from_power(
                    theory.coherent_loss(x * X_WAVELENGTH / (2.0 * np.pi), X_WAVELENGTH, np.radians(theta))
                ),
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
    """Coherent and diffuse power of a rough surface add up to the power that a smooth one reflects."""
    theta = np.radians(np.arange(0.0, 86.0, 5.0))
    comparisons = []
    for ks in (0.3, 1.0, 3.0):
        material = Material(
            "soil", permittivity=SOIL, rms_height=ks * X_WAVELENGTH / (2.0 * np.pi), diffuse_law="roughness"
        )
        table = diffuse_tables(material, X_WAVELENGTH, 256)
        for name, amplitude, r in (
            ("HH", table.amplitude_h, theory.fresnel(np.cos(theta), SOIL)[0]),
            ("VV", table.amplitude_v, theory.fresnel(np.cos(theta), SOIL)[1]),
        ):
            # sigma0(i, s) = a(i) a(s); albedo = integral over the hemisphere / (4 pi cos_i)
            hemisphere = simpson(2.0 * np.pi * amplitude * np.sin(table.theta), x=table.theta)
            at = np.interp(theta, table.theta, amplitude)
            diffuse = at * hemisphere / (4.0 * np.pi * np.cos(theta))
            smooth = np.abs(r) ** 2
            kept = smooth * theory.coherent_loss(material.rms_height, X_WAVELENGTH, theta)
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


CASES.register(CaseEntry("coherent_loss", "rough", coherent_loss))
CASES.register(CaseEntry("shared_energy", "rough", shared_energy))
