"""Flat and curved perfect conductors over angle and frequency: plate, disc, sphere, cylinder."""

import numpy as np

from sarmitsuba import theory
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.simulation.rcs import monostatic_rcs
from sarmitsuba.validation import targets
from sarmitsuba.validation.comparison import Case, CaseEntry, Comparison, db

# sides in m: 8 wavelengths or more, where physical optics holds to 0.1 dB, and no two bands alike
PLATE_SIDE = {"L": 2.0, "C": 1.0, "X": 1.0, "Ka": 0.3}
# dB below the peak down to which patterns are compared: three sidelobes of a plate (-20.8 dB) and of a disc (-28.0)
PLATE_FLOOR, DISC_FLOOR = 25.0, 30.0
# rays across a target at least: where 4.5 a wavelength are fewer than this, its rim is coarse and not its phase
RAYS_ACROSS = 128
RIM = f"rim resolved to the ray spacing: 4.5 rays a wavelength, {RAYS_ACROSS} across the target at least"


def bands(quick: bool) -> tuple[str, ...]:
    """Return the bands of a run."""
    return ("X",) if quick else ("L", "C", "X", "Ka")


def spacing(lam: float, size: float) -> float:
    """Ray spacing of the canonical cases, m."""
    return min(lam / 4.5, size / RAYS_ACROSS)


def plate(quick: bool = False) -> Case:
    """Square plate: main lobe and three sidelobes, along an edge and along the diagonal."""
    comparisons = []
    for band in bands(quick):
        lam, side = targets.wavelength(band), PLATE_SIDE[band]
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
                targets.BANDS[band],
                max_depth=1,
                ray_spacing=spacing(lam, side),
            )
            amplitude = theory.plate_amplitude(side, side, lam, u, v)
            for channel in ("HH", "VV") if band == "X" and name == "principal" else ("HH",):
                comparisons.append(
                    Comparison(
                        f"{band}, {side:g} m, {name} cut, {channel}",
                        np.degrees(np.arcsin(sine)),
                        db(amplitude**2),
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
        lam, radius = targets.wavelength(band), 0.5 * PLATE_SIDE[band]
        # the fourth zero of J1 is 13.32 = 2 k r sin t
        sine = np.linspace(0.0, 13.32 * lam / (4.0 * np.pi * radius), 41 if quick else 121)
        look = np.stack([sine, np.zeros_like(sine), np.sqrt(1.0 - sine**2)], axis=1)
        result = monostatic_rcs(
            targets.disc(radius, lam / 512),
            targets.PEC,
            look,
            targets.BANDS[band],
            channels=("VV",),
            max_depth=1,
            ray_spacing=spacing(lam, 2.0 * radius),
        )
        comparisons.append(
            Comparison(
                f"{band}, r = {radius:g} m",
                np.degrees(np.arcsin(sine)),
                db(theory.disc_rcs(radius, lam, np.arcsin(sine))),
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
                db(area * theory.sphere_po(ka)),
                simulated,
                tolerance=0.3,
                reason="the shadow boundary's own return, up to 0.22 dB at ka = 20, is smeared by tubes that graze it",
                canonical=True,
            ),
            Comparison(
                "Mie (exact)",
                ka,
                db(area * theory.sphere_mie(ka)),
                simulated,
                tolerance=0.3,
                reason="the false return of the sharp shadow boundary in physical optics, 1 / ka of the field",
                canonical=True,
            ),
        ),
        note="One look direction at random a frequency; radius 1 m.",
    )


def cylinder(quick: bool = False) -> Case:
    """Cylinder around broadside; caps are black so that the barrel alone returns."""
    comparisons = []
    for band in bands(quick):
        lam = targets.wavelength(band)
        radius, height = 4.0 * lam, PLATE_SIDE[band]
        sine = np.linspace(0.0, 3.0 * lam / (2.0 * height), 31 if quick else 61)
        look = np.stack([np.sqrt(1.0 - sine**2), np.zeros_like(sine), sine], axis=1)
        result = monostatic_rcs(
            targets.cylinder(radius, height, lam / 512),
            (*targets.PEC, targets.BLACK),
            look,
            targets.BANDS[band],
            channels=("VV",),
            max_depth=1,
            ray_spacing=spacing(lam, 2.0 * radius),
        )
        exact = theory.cylinder_rcs(radius, height, lam, np.arcsin(sine), exact=True)
        comparisons.append(
            Comparison(
                f"{band}, r = 4 lambda, h = {height:g} m",
                np.degrees(np.arcsin(sine)),
                db(exact),
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


CASES = (
    CaseEntry("plate", "canonical", plate),
    CaseEntry("disc", "canonical", disc),
    CaseEntry("sphere", "canonical", sphere),
    CaseEntry("cylinder", "canonical", cylinder),
)

__all__ = ["CASES", "cylinder", "disc", "plate", "sphere"]
