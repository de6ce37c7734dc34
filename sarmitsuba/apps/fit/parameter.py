"""Interface of the parameters by which raw data can be differentiated."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from sarmitsuba.core.arrays import C64, F64, I64

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.tracing.derivatives.tangents import Displacement

AXES = "xyz"


def quote_name(name: str) -> str:
    """A name as it stands in the text of a parameter: in quotation marks where it holds commas, colons or these."""
    plain = name and name == name.strip() and not any(mark in name for mark in ',:"')
    return name if plain else '"' + name.replace('"', '""') + '"'


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the raw data that the kernel and the synthesis give, complex64 (channels, pulses, samples).

    Parameters
    ----------
    data : the raw data
    farther : by a slant range common to all echoes, per m
    displaced : by each displacement of a parameter
    levelled : by each level of a parameter, per dB
    changed : by each property of a material, per unit
    mapped : by each texel of a level map, per dB
    pointed : by the azimuth and the elevation angle of the beam, per rad; empty without a beam, or where not used
    aside : (2, n_pulses, 3) 1/m, aperture axes in azimuth and elevation over the slant range: angle by which the beam
        would have to turn to see the scene as a displaced antenna does
    center_frequency : Hz
    times : (n_pulses,) s each, of transmission, and where the antenna moves on meanwhile, of reception
    """

    data: C64
    farther: C64
    displaced: Sequence[C64]
    levelled: Sequence[C64]
    changed: Sequence[C64]
    mapped: Sequence[C64]
    pointed: Sequence[C64]
    aside: F64
    center_frequency: float
    times: tuple[F64, ...]


@dataclass(frozen=True)
class Step:
    """Values of a property of a material, between which amplitudes are differentiated along every path.

    Parameters
    ----------
    material : name
    below, above : changes of the material, by field
    size : difference of the property between both
    """

    material: str
    below: Mapping[str, float | complex]
    above: Mapping[str, float | complex]
    size: float


class Parameter(ABC):
    """Parameter of a scene, or several of one kind.

    Attributes
    ----------
    label : as in :func:`parse`
    direct : whether its displacements, levels or texels are those of its values, one for each value
    pointing : whether derivatives by the angles of the beam are used, where the antenna has one
    of_radar : fields of the radar that it changes
    """

    label: str
    direct: ClassVar[bool] = False
    pointing: ClassVar[bool] = False
    of_radar: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def names(self, scene: Scene) -> tuple[str, ...]:
        """Name of each value, with its unit in brackets."""

    @abstractmethod
    def values(self, scene: Scene) -> F64:
        """(n,) float64 values in a scene as it is."""

    @abstractmethod
    def changed(self, scene: Scene, values: F64) -> Scene:
        """The scene with other values, (n,)."""

    def moved(self, scene: Scene, values: F64) -> tuple[int, F64, F64] | None:
        """Mesh that :meth:`changed` moves, with the matrix (3, 3) and the offset (3,), m, of its points; None: none."""
        return None

    def displacements(self, scene: Scene, face_mesh: I64) -> Sequence[Displacement]:
        """Displacements whose derivatives are needed; ``face_mesh``: (n_faces,) mesh of each traced face."""
        return ()

    def levels(self, scene: Scene) -> Sequence[frozenset[int]]:
        """Levels whose derivatives are needed, by numbers of the kernel's materials."""
        return ()

    def steps(self, scene: Scene) -> Sequence[Step]:
        """Steps of properties of materials over which derivatives are needed."""
        return ()

    def texels(self, scene: Scene) -> Sequence[tuple[int, int]]:
        """Texels of level maps whose derivatives are needed: number of the material and of its bitmap's texel."""
        return ()

    @abstractmethod
    def derivative(self, found: Derivatives) -> Iterable[C64]:
        """Derivative by each value, (channels, pulses, samples) per unit; ``found`` holds the requested derivatives."""
