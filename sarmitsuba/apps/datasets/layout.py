"""Places of shapes in a scene, drawn so that nothing touches."""

from dataclasses import dataclass, field

import numpy as np

from sarmitsuba.apps.datasets.drawn_shapes import hull, separation, turn_points
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError

# trials of a place before a draw is given up
_TRIALS = 200


@dataclass
class ShapeLayout:
    """Plan of the shapes placed so far.

    Parameters
    ----------
    outlines : convex hulls (n, 2), m, in plan
    """

    outlines: list[F64] = field(default_factory=list)

    def place(
        self,
        name: str,
        vertices: F64,
        heading: float,
        spread: float,
        gap: float,
        generator: np.random.Generator,
    ) -> F64:
        """Vertices (n, 3) at a drawn place, at least ``gap`` from all others in plan.

        Parameters
        ----------
        name : of the shape, for the error
        vertices : (n, 3) m, about the origin
        heading : rad, from x to y
        spread : side of the square of places about the origin, m
        gap : m
        generator : of the places

        Raises
        ------
        SceneError
            No free place was found.
        """
        shape = turn_points(vertices, heading)
        outline = hull(shape[:, :2])
        for _ in range(_TRIALS):
            shift = generator.uniform(-0.5, 0.5, 2) * spread
            if all(separation(outline + shift, other) >= gap for other in self.outlines):
                self.outlines.append(outline + shift)
                shape[:, :2] += shift
                return shape
        raise SceneError(
            f"{name}: no free place among {len(self.outlines)} shapes within {spread:g} m in {_TRIALS} trials; draw "
            "fewer shapes or a larger spread"
        )
