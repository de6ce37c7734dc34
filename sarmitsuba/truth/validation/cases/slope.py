"""Foreshortening and layover of a slope."""

import numpy as np

from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import chain
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.slant_profiles import (
    BRIGHT,
    LENGTH,
    RANGE_CELL,
    SCATTERER_CELL,
    diffuse_only,
    edge,
    profile,
    scene_of,
)


def slope(quick: bool = False) -> Case:
    """Foreshortening: slant-range length of a slope facing the radar, from flat to laid over."""
    comparisons = []
    settings = diffuse_only(TraceSettings(max_depth=1, scatterer_cell=SCATTERER_CELL))
    size = 16.0
    slopes = np.array([0.0, 15.0] if quick else [-15.0, 0.0, 15.0, 30.0])
    for theta in (35.0,) if quick else (25.0, 40.0, 55.0):
        keep = np.abs(theta - slopes) > 8.0
        want, got = [], []
        for alpha in np.radians(slopes[keep]):
            dx, dz = size * np.cos(alpha), size * np.sin(alpha)
            ramp = ([targets.parallelogram([0, -LENGTH / 2, 0], [dx, 0, dz], [0, LENGTH, 0])], [0])
            scene = scene_of([ramp], (BRIGHT,), theta, settings)
            axis, power = profile(chain(scene, window="taylor:4:-35"), scene)
            ratio = theory.foreshortening(float(alpha), np.radians(theta))
            end = size * ratio
            want.append(end)
            first, last = min(0.0, end), max(0.0, end)
            reach = min(3.0, 0.8 * (last - first))
            length = edge(axis, power, last, False, reach) - edge(axis, power, first, True, reach)
            got.append(np.sign(end) * length)
        comparisons.append(
            Comparison(
                f"look angle {theta:g} deg",
                slopes[keep],
                np.asarray(want),
                np.asarray(got),
                tolerance=RANGE_CELL,
                reason="half a range cell at either end",
                unit="m",
            )
        )
    return Case(
        name="slope",
        topic="geometry",
        title="Foreshortening and layover of a slope",
        formula="l sin(t - a)",
        source="plane-wave geometry",
        x_label="slope towards the radar (deg)",
        y_label="slant-range length (m), negative when laid over",
        comparisons=tuple(comparisons),
        note=f"{size:g} m slope.",
    )


CASES.register(CaseEntry("slope", "geometry", slope))
