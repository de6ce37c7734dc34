"""Curved perfect conductors over angle and frequency: sphere, cylinder."""

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS, PLATE_SIDE, RIM, bands, spacing, wavelength
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

# dB below the peak down to which patterns are compared: three sidelobes of a plate (-20.8 dB) and of a disc (-28.0)
PLATE_FLOOR, DISC_FLOOR = 25.0, 30.0


def sphere(quick: bool = False) -> Case:
    """PEC sphere over frequency, ka 20 to 100, against physical optics and the exact Mie series."""
    radius = 1.0
    ka = (
        np.linspace(20.0, 100.0, 9 if quick else 41) + 0.37
    )  # off the multiples of pi, where the ripple is typical
    shape = targets.sphere(radius, 2.0 * np.pi * radius / ka.max() / 512.0)
    looks = np.random.default_rng(3).normal(size=(ka.size, 3))
    simulated = np.array(
        [
            monostatic_rcs(
                shape,
                targets.PEC,
                look[None],
                float(x) * SPEED_OF_LIGHT / (2.0 * np.pi * radius),
                channels=("VV",),
                max_depth=1,
                ray_spacing=spacing(2.0 * np.pi * radius / float(x), 2.0 * radius),
            ).rcs_dbsm("VV")[0]
            for x, look in zip(ka, looks, strict=True)
        ]
    )
    area = np.pi * radius**2
    return Case(
        name="sphere",
        topic="canonical",
        title="Conducting sphere over ka",
        formula="physical optics: pi a^2 (1 - sin 2x / x + sin^2 x / x^2), x = ka; exact: Mie series",
        source="Ruck et al. (1970); Bohren and Huffman (1983), the series checked against miepython",
        x_label="ka",
        y_label="RCS (dBsm)",
        comparisons=(
            Comparison(
                "physical optics",
                ka,
                db_from_power(area * theory.sphere_po(ka)),
                simulated,
                tolerance=0.3,
                reason="the shadow boundary's own return, up to 0.22 dB at ka = 20, is smeared by tubes that graze it",
                canonical=True,
            ),
            Comparison(
                "Mie (exact)",
                ka,
                db_from_power(area * theory.sphere_mie(ka)),
                simulated,
                tolerance=0.3,
                reason="the false return of the sharp shadow boundary in physical optics, 1 / ka of the field",
                canonical=True,
            ),
        ),
        note="One random look direction per frequency; radius 1 m.",
    )


def cylinder(quick: bool = False) -> Case:
    """Cylinder around broadside; caps are black so that the barrel alone returns."""
    comparisons = []
    for band in bands(quick):
        lam = wavelength(band)
        radius, height = 4.0 * lam, PLATE_SIDE[band]
        sine = np.linspace(0.0, 3.0 * lam / (2.0 * height), 31 if quick else 61)
        look = np.stack([np.sqrt(1.0 - sine**2), np.zeros_like(sine), sine], axis=1)
        result = monostatic_rcs(
            targets.cylinder(radius, height, lam / 512),
            (*targets.PEC, targets.BLACK),
            look,
            BANDS[band],
            channels=("VV",),
            max_depth=1,
            ray_spacing=spacing(lam, 2.0 * radius),
        )
        exact = theory.cylinder_rcs(radius, height, lam, np.arcsin(sine), exact=True)
        comparisons.append(
            Comparison(
                f"{band}, r = 4 lambda, h = {height:g} m",
                np.degrees(np.arcsin(sine)),
                db_from_power(exact),
                result.rcs_dbsm("VV"),
                tolerance=0.25,
                reason="facets of sagitta lambda / 512; " + RIM,
                floor=PLATE_FLOOR,
                canonical=True,
            )
        )
    return Case(
        name="cylinder",
        topic="canonical",
        title="Cylinder about broadside",
        formula="(2 pi r h^2 / lambda) cos t sinc^2(k h sin t), here with the shadow boundary's term kept",
        source="Skolnik, Radar Handbook (broadside); Ruck et al. (1970); physical-optics integral with Struve function",
        x_label="angle off broadside (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="Ends closed by black caps. Compared down to 25 dB below the peak.",
    )


CASES.register(CaseEntry("sphere", "canonical", sphere))
CASES.register(CaseEntry("cylinder", "canonical", cylinder))
