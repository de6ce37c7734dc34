"""Scatterers of a user's own kinds: what a scene file says of them, and where they stand."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param, ParamTable, did_you_mean
from sarmitsuba.core.registry import Registry


class ScattererKind:
    """A kind of scatterers at known positions, each with a closed form; register an instance in ``SCATTERERS``.

    The scattering itself is in :class:`sarmitsuba.tracing.scatterers.reflectors.reflector.Reflector`, which kinds
    derive from.

    Attributes
    ----------
    name : of the bsdf in scene files, on a `sphere` whose centre and axes are the scatterer's
    title : half a sentence
    parameters : of the bsdf, numbers
    frequencies : at which the band is traced for it at least; 1 for an amplitude without frequency dependence over the
        band, 2 for up to the square of the frequency (where that exceeds the tolerance), more for delays
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    parameters: ClassVar[tuple[Param, ...]] = ()
    frequencies: ClassVar[int] = 2

    @property
    def states_frequencies(self) -> bool:
        """Whether a class or instance of its own sets ``frequencies``."""
        return any(
            "frequencies" in vars(part) for part in (self, *type(self).__mro__) if part is not ScattererKind
        )

    @property
    def table(self) -> ParamTable:
        """Parameters of the bsdf."""
        return ParamTable(self.name, "bsdf", self.title, self.parameters)


SCATTERERS: Registry[ScattererKind] = Registry("kind of scatterer", ScattererKind)


def scatterer_tables() -> dict[str, ParamTable]:
    """Parameter tables of the kinds of a user's own, by bsdf."""
    return {kind.name: kind.table for kind in SCATTERERS}


@dataclass(frozen=True, eq=False)
class ScattererTarget:
    """One scatterer of a kind of a user's own; no ray hits it, and it casts no shadow.

    Parameters
    ----------
    name : of the shape
    kind : name in ``SCATTERERS``
    position : (3,) float64, m, scene frame
    axes : (3, 3) float64, its own unit axes x, y, z as columns, scene frame
    values : of the kind's parameters

    Raises
    ------
    SceneError
        There is no such kind, or position or axes are not finite and right-angled.
    """

    name: str
    kind: str
    position: F64
    axes: F64
    values: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.kind not in SCATTERERS:
            known = ", ".join(SCATTERERS.names) or "none"
            guess = did_you_mean(self.kind, SCATTERERS.names)
            raise SceneError(
                f'scatterer "{self.name}": there is no kind {self.kind!r}{guess}; registered: {known}'
            )
        square = np.allclose(self.axes.T @ self.axes, np.eye(3), atol=1e-6) and np.linalg.det(self.axes) > 0.0
        if not (np.isfinite(self.position).all() and square):
            raise SceneError(
                f'{self.kind} "{self.name}": to_world is not a turn and a shift; give it rotate and translate alone'
            )

    def moved(self, step: F64) -> "ScattererTarget":
        """The same, (3,) m farther on."""
        return replace(self, position=self.position + step)


def positions_of(targets: tuple[ScattererTarget, ...]) -> F64:
    """(n, 3) float64, m, scene frame."""
    return np.array([target.position for target in targets], dtype=np.float64).reshape(-1, 3)
