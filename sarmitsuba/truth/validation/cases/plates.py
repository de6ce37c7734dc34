"""Flat perfect conductors over angle and frequency: plate, disc."""

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS, PLATE_SIDE, RIM, bands, spacing, wavelength
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

# dB below the peak down to which patterns are compared: three sidelobes of a plate (-20.8 dB) and of a disc (-28.0)
PLATE_FLOOR, DISC_FLOOR = 25.0, 30.0


def plate(quick: bool = False) -> Case:
    """Square plate: main lobe and three sidelobes, along an edge and along the diagonal."""
    comparisons = []
    for band in bands(quick):
        lam, side = wavelength(band), PLATE_SIDE[band]
        # nulls at multiples of lambda / 2a: four of them enclose three sidelobes
        sine = np.linspace(0.0, 4.0 * lam / (2.0 * side), 41 if quick else 121)
        zero = np.zeros_like(sine)
        for name, u, v in (("principal", sine, zero), ("diagonal", sine / np.sqrt(2), sine / np.sqrt(2))):
            if name == "diagonal" and band != "X":
                continue
            look = np.stack([u, v, np.sqrt(1.0 - u * u - v * v)], axis=1)
            result = monostatic_rcs(
                targets.plate(side, side),
                targets.PEC,
                look,
                BANDS[band],
                max_depth=1,
                ray_spacing=spacing(lam, side),
            )
            amplitude = theory.plate_amplitude(side, side, lam, u, v)
            for channel in ("HH", "VV") if band == "X" and name == "principal" else ("HH",):
                comparisons.append(
                    Comparison(
                        f"{band}, {side:g} m, {name} cut, {channel}",
                        np.degrees(np.arcsin(sine)),
                        db_from_power(amplitude**2),
                        result.rcs_dbsm(channel),
                        tolerance=0.1,
                        reason=RIM,
                        floor=PLATE_FLOOR,
                        canonical=True,
                    )
                )
    return Case(
        name="plate",
        topic="canonical",
        title="Square plate over angle",
        formula="(4 pi / lambda^2) (a b cos t sinc(k a sin t))^2",
        source="Ruck et al., Radar Cross Section Handbook (1970); Skolnik, Radar Handbook",
        x_label="angle off the normal (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note=f"Compared down to {PLATE_FLOOR:g} dB below the peak: main lobe and three sidelobes.",
    )


def disc(quick: bool = False) -> Case:
    """Circular disc: main lobe and three sidelobes."""
    comparisons = []
    for band in bands(quick):
        lam, radius = wavelength(band), 0.5 * PLATE_SIDE[band]
        # the fourth zero of J1 is 13.32 = 2 k r sin t
        sine = np.linspace(0.0, 13.32 * lam / (4.0 * np.pi * radius), 41 if quick else 121)
        look = np.stack([sine, np.zeros_like(sine), np.sqrt(1.0 - sine**2)], axis=1)
        result = monostatic_rcs(
            targets.disc(radius, lam / 512),
            targets.PEC,
            look,
            BANDS[band],
            channels=("VV",),
            max_depth=1,
            ray_spacing=spacing(lam, 2.0 * radius),
        )
        comparisons.append(
            Comparison(
                f"{band}, r = {radius:g} m",
                np.degrees(np.arcsin(sine)),
                db_from_power(theory.disc_rcs(radius, lam, np.arcsin(sine))),
                result.rcs_dbsm("VV"),
                tolerance=0.3,
                reason=RIM + "; sidelobes of a disc fall to -28 dB, where its error is a larger share",
                floor=DISC_FLOOR,
                canonical=True,
            )
        )
    return Case(
        name="disc",
        topic="canonical",
        title="Circular disc over angle",
        formula="(4 pi / lambda^2) (pi r^2 cos t 2 J1(x) / x)^2, x = 2 k r sin t",
        source="Ruck et al. (1970)",
        x_label="angle off the normal (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note=f"Compared down to {DISC_FLOOR:g} dB below the peak: main lobe and three sidelobes.",
    )


CASES.register(CaseEntry("plate", "canonical", plate))
CASES.register(CaseEntry("disc", "canonical", disc))
