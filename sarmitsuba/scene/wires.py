"""Straight round wires that scatter by a closed form: cables, rails, posts, members of lattice masts."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError


@dataclass(frozen=True, eq=False)
class WireTarget:
    """Straight round wire that scatters by the series of the infinite cylinder; no ray hits it.

    Parameters
    ----------
    name : of the shape that it came from
    start, end : (3,) float64, m, scene frame
    radius : m
    permittivity : relative, eps' - j eps''; None is a perfect conductor

    Raises
    ------
    SceneError : it has no length, or no thickness
    """

    name: str
    start: F64
    end: F64
    radius: float
    permittivity: complex | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.ends).all() and self.length > 0.0):
            raise SceneError(
                f'radar_wire "{self.name}": its ends are not two different finite points; give start and end'
            )
        if not 0.0 < self.radius < np.inf:
            raise SceneError(
                f'radar_wire "{self.name}": radius = {self.radius:g} m is not above 0 m; give a radius'
            )

    @property
    def ends(self) -> F64:
        """Start and end, (2, 3) float64, m, scene frame."""
        return np.stack([self.start, self.end])

    @property
    def length(self) -> float:
        """Length from end to end, m."""
        return float(np.linalg.norm(self.end - self.start))

    def moved(self, step: F64) -> "WireTarget":
        """The wire translated by (3,) m."""
        return WireTarget(self.name, self.start + step, self.end + step, self.radius, self.permittivity)


def wire_ends(wires: tuple[WireTarget, ...]) -> F64:
    """(2 n_wires, 3) float64 ends of all wires, m, scene frame."""
    return np.concatenate([wire.ends for wire in wires]) if wires else np.zeros((0, 3))
