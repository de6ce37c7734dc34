"""Shapes of a scene file that are scatterers beside the meshes, each read by the kind of its bsdf."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, cast

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import float_value
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.overrides import Overrides
from sarmitsuba.loading.shapes import MeshReader, Placed, sphere_center
from sarmitsuba.scene.scatterers import SCATTERERS, Medium, ScattererKind, ScattererTarget, Target

Made = TypeVar("Made")


@dataclass
class Reading:
    """Input of a kind that reads its shapes.

    Parameters
    ----------
    frequency : Hz, of the permittivities
    overrides : from the command line
    notes : filled with one line for every assumption
    reader : of triangles; caches mesh files
    """

    frequency: float
    overrides: Overrides
    notes: list[str]
    reader: MeshReader
    # elements are kept: a deleted one would leave its Python id to another
    _made: dict[int, tuple[Element, object]] = field(default_factory=dict)

    def once(self, bsdf: Element, make: Callable[[int], Made]) -> Made:
        """Result of ``make`` for a bsdf, from the number of such bsdfs: the same object for all shapes with it."""
        if id(bsdf) not in self._made:
            self._made[id(bsdf)] = (bsdf, make(len(self._made) + 1))
        return cast(Made, self._made[id(bsdf)][1])

    def known(self, bsdf: Element) -> Element:
        """An equal bsdf that was read before; else itself."""
        old = (one for one, _ in self._made.values())
        return next((e for e in old if (e.plugin, e.values) == (bsdf.plugin, bsdf.values)), bsdf)


class ShapeKind(ScattererKind, ABC):
    """A kind of scatterers with targets of a class of its own, read from shapes with its bsdf."""

    @abstractmethod
    def read(self, placed: Placed, bsdf: Element, reading: Reading) -> Sequence[Target]:
        """Targets of a shape with the bsdf, in the file frame.

        Raises
        ------
        SceneError : the shape or the bsdf does not serve
        """

    def read_mesh(
        self, name: str, vertices: F64, faces: I32, bsdf: Element | Medium, where: str, reading: Reading
    ) -> Sequence[Target]:
        """Targets of a mesh with the bsdf, or a medium: vertices (n, 3) m, file frame; ``where`` starts errors.

        Raises
        ------
        SceneError : meshes have no such bsdf, the default, or the mesh does not serve
        """
        raise SceneError(f"{where}: {self.name} is on a mesh; put it on {self.on}")


def read_targets(placed: Placed, bsdf: Element, reading: Reading) -> Sequence[Target]:
    """Targets of a shape whose bsdf is a kind of scatterers.

    Raises
    ------
    SceneError : the shape or the bsdf does not serve
    """
    kind = SCATTERERS[bsdf.plugin]
    return (
        kind.read(placed, bsdf, reading)
        if isinstance(kind, ShapeKind)
        else [_point(kind, placed, bsdf, reading)]
    )


def _point(kind: ScattererKind, placed: Placed, bsdf: Element, reading: Reading) -> ScattererTarget:
    """Scatterer of an extension's kind, at the centre of a sphere element and turned as it is."""
    shape = placed.element
    values, _ = reading.overrides.read(bsdf, kind.table)
    if shape.plugin != "sphere":
        raise SceneError(f"{shape.where}: {kind.name} is on a {shape.plugin}; put it on a sphere")
    if not placed.motion.still:
        raise SceneError(f"{shape.where}: {kind.name} on a shape that moves; leave its velocity out")
    if "radius" in shape.given():
        raise SceneError(
            f"{shape.where}: the sphere of a {kind.name} gives its place and axes only; leave radius out"
            + (" and set that of the bsdf" if "radius" in values else "")
        )
    missing = [p.name for p in kind.parameters if values[p.name] is None]
    if missing:
        raise SceneError(f"{bsdf.where}: {kind.name} has no {missing[0]}; give it a number")
    linear = placed.to_world[:3, :3]
    position = linear @ sphere_center(shape) + placed.to_world[:3, 3]
    numbers = {parameter.name: float_value(values, parameter.name) for parameter in kind.parameters}
    return ScattererTarget(placed.name, kind.name, position, linear, numbers)
