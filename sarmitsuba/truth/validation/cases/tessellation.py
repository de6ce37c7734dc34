"""Independence of the result from the number of triangles."""

import numpy as np

from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison


def tessellation(quick: bool = False) -> Case:
    """The same corner reflectors in 1 (or 2), 10 and 1000 triangles per face, against their fewest."""
    counts = np.array([1, 10, 1000])
    comparisons = []
    looks = {
        "dihedral, 30 deg": (np.radians(30.0), 0.0),
        "square trihedral, 45, 35.26 deg": (np.radians(45.0), np.radians(35.264)),
        "triangular trihedral, 35, 30 deg": (np.radians(35.0), np.radians(30.0)),
        "plate, 1 deg": (np.radians(89.0), 0.0),
    }
    for name, (azimuth, elevation) in looks.items():
        levels = []
        for n in counts:
            if name.startswith("dihedral"):
                shape = targets.dihedral(0.5, 0.5, 0.5, int(n))
            elif name.startswith("plate"):
                shape = targets.geometry(
                    [targets.parallelogram([-0.25, 0, -0.25], [0.5, 0, 0], [0, 0, 0.5], int(n))]
                )
            else:
                shape = targets.trihedral(0.5, name.split()[0], int(n))
            result = monostatic_rcs(
                shape,
                targets.PEC,
                targets.from_azimuth(azimuth, elevation)[None],
                BANDS["X"],
                max_depth=3,
            )
            levels.append(float(result.rcs_dbsm("VV")[0]))
        comparisons.append(
            Comparison(
                name,
                counts.astype(np.float64),
                np.full(counts.size, levels[0]),
                np.asarray(levels),
                tolerance=0.1,
                reason="float32 rounding decides which of two touching triangles a ray on their edge hits",
                shown=counts.size - 1,
            )
        )
    return Case(
        name="tessellation",
        topic="canonical",
        title="Tessellation does not matter",
        formula="level with the fewest triangles per face (2 for four-sided faces)",
        source="the simulator itself",
        x_label="triangles per face",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="X band, 0.5 m; interior vertices of four-sided faces are scattered at random.",
    )


CASES.register(CaseEntry("tessellation", "canonical", tessellation))
