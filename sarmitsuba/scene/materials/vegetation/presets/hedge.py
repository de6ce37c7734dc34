"""A cut hedge, such as privet or hornbeam: small leaves, many thin twigs, upright stems.

Sizes and densities are chosen from typical hedges, none fitted to a radar measurement.
"""

from sarmitsuba.scene.materials.vegetation.canopy import CANOPIES, Canopy, Constituent, Orientation
from sarmitsuba.scene.materials.vegetation.plant_pieces import Leaf, Stick

CANOPIES.register(
    Canopy(
        "hedge",
        "hedge in leaf",
        (
            Constituent(Leaf(0.015, 0.0003), 900.0, 0.6),
            Constituent(Stick(0.0015, 0.15), 150.0, 0.5),
            Constituent(Stick(0.004, 0.4), 10.0, 0.5, Orientation(30.0, 30.0)),
        ),
    )
)
