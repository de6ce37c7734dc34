"""Trihedral corner reflectors over angle, and the peaks of all corner reflectors."""

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS, RIM, bands, spacing, wavelength
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

TRIHEDRAL_EDGE = {"L": 2.0, "C": 1.0, "X": 0.75, "Ka": 0.25}
# edges of 16 wavelengths or more, where single bounces on the axis stay below the tolerance
PEAK_EDGE = {"L": 4.0, "C": 1.2, "X": 0.75, "Ka": 0.25}
CORNER_FLOOR = 20.0


def trihedral(quick: bool = False) -> Case:
    """Triangular and square trihedral over azimuth and elevation: triple bounces against the effective area."""
    comparisons = []
    for shape in ("triangular", "square"):
        for band in bands(quick):
            lam, edge = wavelength(band), TRIHEDRAL_EDGE[band]
            n = 15 if quick else 31
            scans = {
                "azimuth": (np.linspace(5.0, 85.0, n), np.full(n, 35.264)),
                "elevation": (np.full(n, 45.0), np.linspace(5.0, 80.0, n)),
            }
            for name, (azimuth, elevation) in scans.items():
                look = targets.from_azimuth(np.radians(azimuth), np.radians(elevation))
                result = monostatic_rcs(
                    targets.trihedral(edge, shape),
                    targets.PEC,
                    look,
                    BANDS[band],
                    channels=("VV",),
                    max_depth=3,
                    keep_orders=True,
                    ray_spacing=spacing(lam, edge),
                )
                closed = db_from_power(
                    theory.trihedral_rcs(edge, lam, look, "square" if shape == "square" else "triangular")
                )
                comparisons.append(
                    Comparison(
                        f"{shape}, {band}, {edge:g} m, {name}",
                        azimuth if name == "azimuth" else elevation,
                        closed,
                        db_from_power(np.abs(result.amplitude[:, 2, 0]) ** 2),
                        tolerance=0.3,
                        reason=RIM + ", a larger share of the effective area where that is small",
                        floor=CORNER_FLOOR,
                        canonical=True,
                    )
                )
    return Case(
        name="trihedral",
        topic="canonical",
        title="Trihedrals over azimuth and elevation, triple bounce",
        formula="4 pi A^2 / lambda^2, A the area common to the aperture and its inversion; "
        "peaks 4 pi a^4 / (3 lambda^2) and 12 pi a^4 / lambda^2",
        source="Robertson, Bell Syst. Tech. J. 26 (1947); Ruck et al. (1970); Skolnik, Radar Handbook (peaks)",
        x_label="angle (deg); azimuth at elevation 35.26, elevation at azimuth 45",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note=f"Bounce order 3 alone, as the closed form. Compared down to {CORNER_FLOOR:g} dB below the peak.",
    )


def corner_peaks(quick: bool = False) -> Case:
    """All orders together on the axis of each corner reflector, against the textbook peaks."""
    bore = np.ones((1, 3))
    comparisons = []
    names = bands(quick)
    for shape in ("dihedral", "triangular", "square"):
        simulated, closed, ka = [], [], []
        for band in names:
            lam, edge = wavelength(band), PEAK_EDGE[band]
            if shape == "dihedral":
                target = targets.dihedral(edge, edge, edge)
                look, level = np.array([[1.0, 1.0, 0.0]]), 8.0 * np.pi * edge**4 / lam**2
            else:
                target = targets.trihedral(edge, shape)
                factor = 4.0 / 3.0 if shape == "triangular" else 12.0
                look, level = bore, factor * np.pi * edge**4 / lam**2
            result = monostatic_rcs(
                target, targets.PEC, look, BANDS[band], max_depth=3, ray_spacing=spacing(lam, edge)
            )
            simulated.append(result.rcs_dbsm("VV")[0])
            closed.append(float(db_from_power(level)))
            ka.append(edge / lam)
        comparisons.append(
            Comparison(
                f"{shape}, {', '.join(names)} band",
                np.asarray(ka),
                np.asarray(closed),
                np.asarray(simulated),
                tolerance=0.3,
                reason="single and double bounces, 1 to 3 % of the field for edges of 17 wavelengths; " + RIM,
                canonical=True,
            )
        )
    return Case(
        name="corner_peaks",
        topic="canonical",
        title="Peaks of corner reflectors, all bounces",
        formula="8 pi a^4 / lambda^2, 4 pi a^4 / (3 lambda^2), 12 pi a^4 / lambda^2",
        source="Skolnik, Radar Handbook",
        x_label="edge in wavelengths",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="VV on the axis of symmetry.",
    )


CASES.register(CaseEntry("trihedral", "canonical", trihedral))
CASES.register(CaseEntry("corner_peaks", "canonical", corner_peaks))
