"""Crown of a conifer, such as a spruce: needles in all directions, branches nearly horizontal.

Sizes and densities are chosen within forestry data, none fitted to a radar measurement.
"""

from sarmitsuba.scene.materials.vegetation.canopy import CANOPIES, Canopy, Constituent, Orientation
from sarmitsuba.scene.materials.vegetation.plant_pieces import Stick

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
