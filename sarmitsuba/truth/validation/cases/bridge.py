"""Positions of the multiple returns of a bridge over water."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, chain
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.slant_profiles import (
    BLACK,
    BRIGHT,
    HALF_CELL,
    LENGTH,
    MIRROR,
    WHERE,
    diffuse_only,
    edge,
    incidence,
    line,
    plane,
    profile,
    scene_of,
)


def bridge(quick: bool = False) -> Case:
    """Bridge over calm water: single, double and triple returns of its side, and the ghost from under the deck."""
    comparisons = []
    height, thick = 8.0, 0.2
    series: dict[str, tuple[F64, dict[str, Parameter]]] = {
        "right": (np.array([40.0] if quick else [25.0, 35.0, 50.0]), {})
    }
    if not quick:
        series["left, squint 10 deg"] = (np.array([40.0]), {"look_side": "left", "squint_angle_deg": 10.0})
    deck_material = Material("deck", pec=True, diffuse_law="constant", diffuse_level_db=-10.0)
    for label, (angles, sensor) in series.items():
        names = ("single", "double", "triple", "under the deck, first", "under the deck, ghost")
        want: dict[str, list[float]] = {n: [] for n in names}
        got: dict[str, list[float]] = {n: [] for n in names}
        for theta in angles:
            # the deck's side alone, a strip, for the three orders of its edge
            side = targets.parallelogram([0, -LENGTH / 2, height - thick / 2], [0, LENGTH, 0], [0, 0, thick])
            scene = scene_of(
                [([side], [0]), plane(-18, 18, 1)],
                (BRIGHT, MIRROR),
                theta,
                diffuse_only(TraceSettings(max_depth=2, ray_spacing=0.09, scatterer_cell=0.5 * thick)),
                **(sensor | {"image_extent_range": 60.0}),
            )
            axis, power = profile(chain(scene, window="taylor:4:-35"), scene)
            t = incidence(scene)
            returns = theory.bridge_returns(height, t)
            for name, place in (
                ("single", returns.single),
                ("double", returns.double),
                ("triple", returns.triple),
            ):
                want[name].append(place)
                got[name].append(line(axis, power, place))
            # a wide deck whose underside scatters and mirrors over water that mirrors: what the water shows of
            # it, 2 h tan t wide, and behind that the same once more through deck and water
            reach = 2.0 * height * np.tan(t)
            # the roadway is black: its own return would lie over the end of the first
            deck = plane(0.0, 2.5 * reach, 0, height, LENGTH)
            roadway = plane(0.0, 2.5 * reach, 2, height + 0.02, LENGTH)
            under = scene_of(
                [deck, roadway, plane(-20, 60, 1)],
                (deck_material, MIRROR, BLACK),
                theta,
                diffuse_only(TraceSettings(max_depth=4, ray_spacing=0.18)),
                **(sensor | {"image_extent_range": 160.0}),
            )
            axis, power = profile(chain(under, window="taylor:4:-35"), under)
            want["under the deck, first"].append(returns.triple + reach * np.sin(t))
            got["under the deck, first"].append(edge(axis, power, want["under the deck, first"][-1], False))
            want["under the deck, ghost"].append(returns.under_deck[0] + reach * np.sin(t))
            got["under the deck, ghost"].append(edge(axis, power, want["under the deck, ghost"][-1], True))
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
        name="bridge",
        topic="geometry",
        title="Returns of a bridge over water",
        formula="single -h cos t, double 0, triple +h cos t; under the deck x sin t + h cos t, ghost + 2 h cos t",
        source="mirror images in the water (and in the deck)",
        x_label="look angle (deg)",
        y_label="slant range from the point below the edge (m)",
        comparisons=tuple(comparisons),
        note=f"Deck {height:g} m above the water.",
    )


CASES.register(CaseEntry("bridge", "geometry", bridge))
