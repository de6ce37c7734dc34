"""Positions of a building's returns: layover, roof, shadow, dihedral line, triple bounce."""

import numpy as np

from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import chain
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.slant_profiles import (
    BLACK,
    BRIGHT,
    HALF_CELL,
    HEIGHT,
    LENGTH,
    MIRROR,
    RANGE_CELL,
    SCATTERER_CELL,
    WHERE,
    WIDTH,
    box,
    diffuse_only,
    edge,
    incidence,
    line,
    plane,
    profile,
    scene_of,
    setups,
)


def building(quick: bool = False) -> Case:
    """Layover of a wall, roof, shadow, dihedral line and wall-ground-wall return of a building."""
    comparisons = []
    settings = diffuse_only(TraceSettings(max_depth=1, scatterer_cell=SCATTERER_CELL))
    bounces = diffuse_only(TraceSettings(max_depth=3, keep_orders=True, scatterer_cell=SCATTERER_CELL))
    half = LENGTH / 2
    for label, (angles, sensor) in setups(quick).items():
        names = (
            "wall's top",
            "roof's far edge",
            "foot",
            "shadow's end",
            "dihedral line",
            "wall-ground-wall end",
        )
        want: dict[str, list[float]] = {n: [] for n in names}
        got: dict[str, list[float]] = {n: [] for n in names}
        for theta in angles:
            body = box((0, -half, 0), (WIDTH, half, HEIGHT), 0)
            own = scene_of([body, plane(-60, 60, 1)], (BRIGHT, BLACK), theta, settings, **sensor)
            axis, power = profile(chain(own, window="taylor:4:-35"), own)
            returns = theory.building_returns(HEIGHT, WIDTH, incidence(own))
            want["wall's top"].append(-returns.layover_slant)
            got["wall's top"].append(edge(axis, power, -returns.layover_slant, True))
            far = max(returns.roof_slant[1], 0.0)  # the later of roof and wall ends the building's own return
            want["roof's far edge"].append(far)
            got["roof's far edge"].append(edge(axis, power, far, False, 1.5))
            other = scene_of([body, plane(-60, 60, 1)], (MIRROR, BRIGHT), theta, bounces, **sensor)
            image = chain(other, window="taylor:4:-35")
            axis, power = profile(image, other, 1)
            want["foot"].append(0.0)
            got["foot"].append(edge(axis, power, 0.0, False))
            want["shadow's end"].append(returns.lit_ground_slant)
            got["shadow's end"].append(edge(axis, power, returns.lit_ground_slant, True))
            axis, power = profile(image, other, 2)
            want["dihedral line"].append(returns.dihedral_slant)
            got["dihedral line"].append(line(axis, power, 0.0))
            axis, power = profile(image, other, 3)
            end = returns.triple_ground * np.sin(incidence(other))
            want["wall-ground-wall end"].append(end)
            got["wall-ground-wall end"].append(edge(axis, power, end, False, min(3.0, 0.8 * end)))
        for name in names:
            comparisons.append(
                Comparison(
                    f"{name}, {label}",
                    angles,
                    np.asarray(want[name]),
                    np.asarray(got[name]),
                    tolerance=HALF_CELL,
                    reason=WHERE,
                    unit="m",
                    shown=0,
                )
            )
    return Case(
        name="building",
        topic="geometry",
        title="Layover, roof, shadow, dihedral line and triple bounce of a building",
        formula="top -h cos t, shadow's end (w + h tan t) sin t, dihedral 0, wall-ground-wall to h tan t sin t",
        source="plane-wave geometry; shared figures of a 20 m building reproduced by the closed forms",
        x_label="look angle (deg)",
        y_label="slant range from the wall's foot (m)",
        comparisons=tuple(comparisons),
        note=f"{HEIGHT:g} m high, {WIDTH:g} m deep, {LENGTH:g} m long; cell {RANGE_CELL:.3f} m; 50 km. "
        "Slant range at zero Doppler, so that squint must not move anything. Diffuse returns alone.",
    )


CASES.register(CaseEntry("building", "geometry", building))
