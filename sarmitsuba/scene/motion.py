"""Motion of a shape: translation with constant velocity or acceleration, without rotation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line

Triple = tuple[float, float, float]

# m/s and m/s^2; above the first a target crosses a range cell within one pulse, above the second no vehicle accelerates
MAX_SPEED, MAX_ACCELERATION = 1e4, 1e4


@dataclass(frozen=True)
class Motion:
    r"""Translation of a shape from its position at time zero, that of its file.

    .. math:: \mathbf{x}(t) = \mathbf{x}_0 + \mathbf{v} t + \tfrac12 \mathbf{a} t^2

    Parameters
    ----------
    velocity : m/s at time zero: east, north, up; any three numbers, kept as a tuple
    acceleration : m/s^2, constant

    Raises
    ------
    SceneError
        One is not three finite numbers, or beyond ``MAX_SPEED`` or ``MAX_ACCELERATION``.

    Notes
    -----
    Time is that of the radar's track, zero at mid-aperture (of a track from a file: its own). Ignores rotation,
    deformation, wheels, and the motion during one pulse (stop-and-go, as the antenna).
    """

    velocity: Triple = (0.0, 0.0, 0.0)
    acceleration: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, unit, bound in (
            ("velocity", "m/s", MAX_SPEED),
            ("acceleration", "m/s^2", MAX_ACCELERATION),
        ):
            object.__setattr__(self, name, _triple(name, getattr(self, name), unit, bound))

    @staticmethod
    def of(velocity: ArrayLike = (0.0, 0.0, 0.0), acceleration: ArrayLike = (0.0, 0.0, 0.0)) -> "Motion":
        """Motion from any three numbers each."""
        return Motion(velocity, acceleration)  # type: ignore[arg-type]  # made triples there

    @property
    def still(self) -> bool:
        """True without velocity and acceleration."""
        return not (any(self.velocity) or any(self.acceleration))

    def displacement(self, time: ArrayLike) -> F64:
        """Displacement (..., 3) float64, m, from the place at time zero, for times (...,) in s."""
        t = np.asarray(time, dtype=np.float64)[..., None]
        return np.asarray(t * np.asarray(self.velocity) + 0.5 * t * t * np.asarray(self.acceleration))

    def velocity_at(self, time: ArrayLike) -> F64:
        """(..., 3) float64, m/s, at times (...,) in s."""
        t = np.asarray(time, dtype=np.float64)[..., None]
        return np.asarray(np.asarray(self.velocity) + t * np.asarray(self.acceleration))

    def __str__(self) -> str:
        speed = f"{float(np.linalg.norm(np.asarray(self.velocity))):.4g} m/s"
        size = float(np.linalg.norm(np.asarray(self.acceleration)))
        return f"{speed} and {size:.3g} m/s^2" if size else speed


def _triple(name: str, value: object, unit: str, bound: float) -> Triple:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise SceneError(
            f"{name} = {one_line(value)} is not three finite numbers; give east, north, up in {unit}"
        )
    size = float(np.linalg.norm(numbers))
    if size > bound:
        raise SceneError(f"{name} = {size:g} {unit} is above the bound {bound:g} {unit}; give it in {unit}")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


STILL = Motion()
