"""Crowns of conifers and broad-leaved trees, and hedges.

Conifers, such as spruces, have needles in all directions and branches nearly horizontal. Broad-leaved trees, such as
limes and maples along a street, are in leaf or bare, with about 0.8 m^2 of leaf and 1 kg of fresh wood in a cubic
metre. Hedges, such as cut privet or hornbeam, have small leaves, many thin twigs and upright stems. Sizes and
densities are chosen within forestry data, none fitted to a radar measurement; their backscatter is printed by ``python
-m benchmarks.studies.vegetation --presets``.
"""

from sarmitsuba.scene.materials.vegetation.canopy import CANOPIES, Canopy, Constituent, Orientation
from sarmitsuba.scene.materials.vegetation.plant_pieces import Leaf, Stick

CANOPIES.register(
    Canopy(
        "conifer",
        "crown of a spruce",
        (
            Constituent(Stick(0.0005, 0.02), 15_000.0, 0.55),
            Constituent(Stick(0.0015, 0.15), 50.0, 0.5, Orientation(75.0, 20.0)),
            Constituent(Stick(0.004, 0.5), 6.0, 0.5, Orientation(80.0, 15.0)),
            Constituent(Stick(0.01, 1.2), 0.6, 0.5, Orientation(80.0, 15.0)),
        ),
    )
)


def _wood(moisture: float) -> tuple[Constituent, ...]:
    """Twigs to limbs, growing outwards and up."""
    return (
        Constituent(Stick(0.0015, 0.2), 60.0, moisture, Orientation(50.0, 30.0)),
        Constituent(Stick(0.005, 0.5), 4.0, moisture, Orientation(45.0, 25.0)),
        Constituent(Stick(0.015, 1.2), 0.4, moisture, Orientation(50.0, 20.0)),
        Constituent(Stick(0.04, 2.0), 0.05, moisture, Orientation(40.0, 20.0)),
    )


CANOPIES.register(
    Canopy(
        "deciduous_summer",
        "crown of a broad-leaved tree in leaf",
        (Constituent(Leaf(0.035, 0.0002), 220.0, 0.65), *_wood(0.5)),
    )
)
CANOPIES.register(
    Canopy("deciduous_winter", "crown of a broad-leaved tree without leaves, dormant", _wood(0.4))
)


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
