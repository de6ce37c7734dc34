"""Parameters by which raw data can be differentiated: their values, a scene with other values, their derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.arrays import C64, F64
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.errors import SceneError
from sarmitsuba.materials.diffuse_law import LAWS
from sarmitsuba.materials.map_materials import with_parts
from sarmitsuba.trace.tangents import PER_DB, Displacement

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sarmitsuba.materials.material import Material
    from sarmitsuba.scene.scene import Scene

AXES = "xyz"


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
    center_frequency : Hz
    time : (n_pulses,) s
    """

    data: C64
    farther: C64
    displaced: Sequence[C64]
    levelled: Sequence[C64]
    changed: Sequence[C64]
    center_frequency: float
    time: F64


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
    """

    label: str

    @abstractmethod
    def names(self, scene: Scene) -> tuple[str, ...]:
        """Name of each value, with its unit in brackets."""

    @abstractmethod
    def values(self, scene: Scene) -> F64:
        """(n,) float64 values in a scene as it is."""

    @abstractmethod
    def changed(self, scene: Scene, values: F64) -> Scene:
        """The scene with other values, (n,)."""

    def translation(self, scene: Scene, values: F64) -> tuple[int, F64] | None:
        """Mesh that :meth:`changed` translates, and by what (3,), m; None where it does something else."""
        return None

    def displacements(self, scene: Scene, face_mesh: F64) -> Sequence[Displacement]:
        """Displacements whose derivatives are needed; ``face_mesh``: (n_faces,) mesh of each traced face."""
        return ()

    def levels(self, scene: Scene) -> Sequence[frozenset[int]]:
        """Levels whose derivatives are needed, by numbers of the kernel's materials."""
        return ()

    def steps(self, scene: Scene) -> Sequence[Step]:
        """Steps of properties of materials over which derivatives are needed."""
        return ()

    @abstractmethod
    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """Derivative by each value, (channels, pulses, samples) per unit; ``found`` holds what it asked for."""


@dataclass(frozen=True)
class Gain(Parameter):
    """Gain of the whole radar, dB of power, relative to the scene's."""

    label: str = "gain"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return ("gain [dB]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        radar = scene.radar
        power = radar.transmit_power * 10.0 ** (0.1 * float(values[0]))
        return replace(scene, radar=replace(radar, transmit_power=power))

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return (found.data * np.float32(PER_DB),)


@dataclass(frozen=True)
class ClockOffset(Parameter):
    """Delay of the echoes against the clock that starts the receive window, s; the carrier's phase does not change."""

    label: str = "clock_offset"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return ("clock_offset [s]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        window = scene.radar.window
        start = window.start_range - 0.5 * SPEED_OF_LIGHT * float(values[0])
        return replace(scene, radar=replace(scene.radar, window=replace(window, start_range=start)))

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        carrier = 4j * np.pi * found.center_frequency / SPEED_OF_LIGHT
        envelope = found.farther + np.complex64(carrier) * found.data
        return (envelope * np.float32(0.5 * SPEED_OF_LIGHT),)


@dataclass(frozen=True)
class AntennaTrack(Parameter):
    """Displacement of the antenna's positions, m, linear between knots that divide the time of the track equally.

    Parameters
    ----------
    knots : number of them; 1: the same displacement at all pulses
    axes : of the scene frame, some of ``xyz``
    """

    knots: int = 1
    axes: str = AXES

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"track:{self.knots}:{self.axes}"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return tuple(f"track {axis} at knot {k} [m]" for axis in self.axes for k in range(self.knots))

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(self.knots * len(self.axes))

    def weights(self, time: F64) -> F64:
        """(n_pulses, knots) weight of each knot at the pulse times, s."""
        if self.knots == 1 or len(time) == 1:
            weights = np.zeros((len(time), self.knots))
            weights[:, 0] = 1.0
            return weights
        at = np.linspace(time[0], time[-1], self.knots)
        return np.stack([np.interp(time, at, one) for one in np.eye(self.knots)], axis=1)

    def offsets(self, time: F64, values: F64) -> F64:
        """(n_pulses, 3) displacement at the pulse times, m."""
        offsets = np.zeros((len(time), 3))
        weights = self.weights(time)
        for axis, knots in zip(self.axes, values.reshape(len(self.axes), self.knots), strict=True):
            offsets[:, AXES.index(axis)] = weights @ knots
        return offsets

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        track = scene.radar.track
        track = replace(track, position=track.position + self.offsets(track.time, values))
        return replace(scene, radar=replace(scene.radar, track=track))

    def displacements(self, scene: Scene, face_mesh: F64) -> Sequence[Displacement]:
        """See the base class."""
        return [Displacement(np.eye(3)[AXES.index(axis)]) for axis in self.axes]

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        weights = self.weights(found.time).astype(np.float32)
        return [plane * one[:, None] for plane in found.displaced for one in weights.T]


@dataclass(frozen=True)
class Level(Parameter):
    """Level of a material's diffuse law, dB: ``diffuse_level_db``.

    Parameters
    ----------
    material : name
    """

    material: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"level:{self.material}"

    def _own(self, scene: Scene) -> Material:
        m = material_of(scene, self.material, self.label)
        if not has_level(m):
            raise SceneError(
                f"parameter {self.label}: diffuse_law = {m.diffuse_law} has no level; differentiate by a property "
                "that it has"
            )
        return m

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [dB]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.array([self._own(scene).diffuse_level_db])

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        self._own(scene)
        return with_material(scene, self.material, diffuse_level_db=float(values[0]))

    def levels(self, scene: Scene) -> Sequence[frozenset[int]]:
        """See the base class."""
        return (numbers_of(scene, self.material),)

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.levelled


# share of a property by which it is changed on either side, and of the wavelength for the thickness of a slab
STEP, THICKNESS_STEP = 0.01, 0.002

# kinds of properties: what they are called in a fit's table
PROPERTIES = {
    "permittivity": "permittivity, real part",
    "loss": "permittivity, less the imaginary part",
    "rms_height": "rms height, m",
    "correlation_length": "correlation length, m",
    "thickness": "thickness of the slab, m",
}


@dataclass(frozen=True)
class Property(Parameter):
    """Property of a material: one of ``PROPERTIES``.

    Parameters
    ----------
    kind, material : names
    """

    kind: str
    material: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"{self.kind}:{self.material}"

    def _own(self, scene: Scene) -> Material:
        m = material_of(scene, self.material, self.label)
        problem = ""
        if self.kind in ("permittivity", "loss"):
            problem = (
                "a perfect conductor has none"
                if m.pec
                else "it is given over frequency"
                if m.dispersion is not None
                else ""
            )
        elif not getattr(m, self.kind) > 0.0:
            problem = f"its {self.kind} is 0"
        if problem:
            raise SceneError(f"parameter {self.label}: {problem}; differentiate by another property")
        return m

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [{'1' if self.kind in ('permittivity', 'loss') else 'm'}]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        m = self._own(scene)
        if self.kind == "permittivity":
            return np.array([m.permittivity.real])
        if self.kind == "loss":
            return np.array([-m.permittivity.imag])
        return np.array([getattr(m, self.kind)])

    def _field(self, m: Material, value: float) -> Mapping[str, float | complex]:
        """Change of the material to another value."""
        if self.kind == "permittivity":
            return {"permittivity": complex(value, m.permittivity.imag)}
        if self.kind == "loss":
            return {"permittivity": complex(m.permittivity.real, -value)}
        return {self.kind: value}

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        return with_material(scene, self.material, **self._field(self._own(scene), float(values[0])))

    def steps(self, scene: Scene) -> Sequence[Step]:
        """See the base class."""
        m, value = self._own(scene), float(self.values(scene)[0])
        step = STEP * (abs(m.permittivity) if self.kind in ("permittivity", "loss") else value)
        if self.kind == "thickness":
            step = min(step, THICKNESS_STEP * scene.radar.waveform.wavelength)
        low = value - step
        if self.kind == "loss":  # no medium that amplifies
            low = max(low, 0.0)
        return (Step(self.material, self._field(m, low), self._field(m, value + step), value + step - low),)

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.changed


@dataclass(frozen=True)
class Shift(Parameter):
    """Translation of a shape, m, with its diffuse scatterers.

    Parameters
    ----------
    shape : name of the mesh
    axis : of the scene frame: ``x``, ``y`` or ``z``
    """

    shape: str
    axis: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"shift:{self.shape}:{self.axis}"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [m]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        mesh_of(scene, self.shape, self.label)
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        mesh, step = self.translation(scene, values)
        return with_moved(scene, mesh, np.zeros((3, 3)), step)

    def translation(self, scene: Scene, values: F64) -> tuple[int, F64]:
        """See the base class."""
        step = np.zeros(3)
        step[AXES.index(self.axis)] = float(values[0])
        return mesh_of(scene, self.shape, self.label), step

    def displacements(self, scene: Scene, face_mesh: F64) -> Sequence[Displacement]:
        """See the base class."""
        faces = face_mesh == mesh_of(scene, self.shape, self.label)
        return [Displacement(np.zeros(3), faces, np.eye(3)[AXES.index(self.axis)])]

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.displaced


@dataclass(frozen=True)
class Deformation(Parameter):
    """Height, scale or rotation of a shape, whose base stays where it is.

    Parameters
    ----------
    kind : ``height`` (m, the shape is stretched upwards), ``scale`` (1, about the middle of its base) or ``rotation``
        (rad, about the vertical through the middle of its base, anticlockwise from above)
    shape : name of the mesh
    """

    kind: str
    shape: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"{self.kind}:{self.shape}"

    def _placed(self, scene: Scene) -> tuple[int, F64, float]:
        """Mesh, middle of its base (3,) and its height, m."""
        mesh, geometry = mesh_of(scene, self.shape, self.label), scene.geometry
        first, stop = geometry.mesh_face_offset[mesh : mesh + 2]
        corners = geometry.vertices[geometry.faces[first:stop]].reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        height = float(high[2] - low[2])
        if self.kind == "height" and not height > 0.0:
            raise SceneError(f"parameter {self.label}: the shape is flat; shift it instead")
        return mesh, np.array([*(0.5 * (low + high))[:2], low[2]]), height

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [{DEFORMATIONS[self.kind]}]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        _, _, height = self._placed(scene)
        return np.array([{"height": height, "scale": 1.0, "rotation": 0.0}[self.kind]])

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        mesh, base, height = self._placed(scene)
        value = float(values[0])
        if self.kind == "rotation":
            c, s = np.cos(value), np.sin(value)
            gradient = np.array([[c - 1.0, -s, 0.0], [s, c - 1.0, 0.0], [0.0, 0.0, 0.0]])
        elif not value > 0.0:
            raise SceneError(f"parameter {self.label} = {value:g} must be above 0")
        else:
            gradient = self._gradient(height) * (value - (height if self.kind == "height" else 1.0))
        return with_moved(scene, mesh, gradient, -gradient @ base)

    def _gradient(self, height: float) -> F64:
        """Velocity gradient, 1 per unit."""
        if self.kind == "height":
            return np.diag([0.0, 0.0, 1.0 / height])
        if self.kind == "scale":
            return np.eye(3)
        return np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def displacements(self, scene: Scene, face_mesh: F64) -> Sequence[Displacement]:
        """See the base class."""
        mesh, base, height = self._placed(scene)
        gradient = self._gradient(height)
        return [Displacement(np.zeros(3), face_mesh == mesh, -gradient @ base, gradient)]

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.displaced


# kinds of deformation and their units
DEFORMATIONS = {"height": "m", "scale": "1", "rotation": "rad"}


def has_level(m: Material) -> bool:
    """Whether the diffuse law of a material has a level."""
    return bool(LAWS[m.diffuse_law].level) and bool(np.isfinite(m.diffuse_level_db))


def material_of(scene: Scene, name: str, label: str) -> Material:
    """The material of a name.

    Raises
    ------
    SceneError : there is none
    """
    for m in with_parts(scene.materials):
        if m.name == name:
            return m
    known = ", ".join(sorted({m.name for m in with_parts(scene.materials)}))
    raise SceneError(f'parameter {label}: no material "{name}"; there are {known}')


def numbers_of(scene: Scene, name: str) -> frozenset[int]:
    """Numbers of the kernel's materials of a name."""
    return frozenset(i for i, m in enumerate(with_parts(scene.materials)) if m.name == name)


def with_material(scene: Scene, name: str, **changes: float | complex) -> Scene:
    """The scene with changes to all materials of a name, those of maps included."""

    def changed(m: Material) -> Material:
        if m.name == name:
            m = replace(m, **changes)  # type: ignore[arg-type]
        if m.maps is None or m.maps.classes is None:
            return m
        parts = tuple(changed(p) for p in m.maps.classes.materials)
        return replace(m, maps=replace(m.maps, classes=replace(m.maps.classes, materials=parts)))

    return replace(scene, materials=tuple(changed(m) for m in scene.materials))


def mesh_of(scene: Scene, name: str, label: str) -> int:
    """Number of the mesh of a name.

    Raises
    ------
    SceneError : there is none, or several
    """
    names = scene.geometry.mesh_names
    found = [i for i, n in enumerate(names) if n == name]
    if len(found) != 1:
        problem = f'{len(found)} shapes are named "{name}"' if found else f'no shape "{name}"'
        raise SceneError(f"parameter {label}: {problem}; there are {', '.join(sorted(set(names)))}")
    return found[0]


def with_moved(scene: Scene, mesh: int, gradient: F64, offset: F64) -> Scene:
    """The scene with the vertices p of one mesh at ``p + offset + gradient p``."""
    geometry = scene.geometry
    faces = geometry.faces.copy()
    first, stop = geometry.mesh_face_offset[mesh : mesh + 2]
    own, inverse = np.unique(faces[first:stop], return_inverse=True)
    corners = geometry.vertices[own]
    moved = corners + offset + corners @ gradient.T
    # vertices shared with other meshes stay theirs
    faces[first:stop] = len(geometry.vertices) + inverse.reshape(-1, 3)
    vertices = np.concatenate([geometry.vertices, moved])
    return replace(scene, geometry=replace(geometry, vertices=vertices, faces=faces))


def parse(text: str, scene: Scene) -> tuple[Parameter, ...]:
    """Parameters from a text such as ``gain,level:soil,track:5,shift:roof:z``; ``levels`` stands for all materials'.

    Raises
    ------
    SceneError : an unknown kind, or another number of parts than the kind has
    """
    found: list[Parameter] = []
    for word in filter(None, (part.strip() for part in text.split(","))):
        kind, *rest = word.split(":")
        match kind, rest:
            case "gain", []:
                found.append(Gain())
            case "clock_offset", []:
                found.append(ClockOffset())
            case "track", [n] if n.isdecimal() and int(n) > 0:
                found.append(AntennaTrack(int(n)))
            case "track", [n, axes] if n.isdecimal() and int(n) > 0 and axes and set(axes) <= set(AXES):
                found.append(AntennaTrack(int(n), axes))
            case "level", [material]:
                found.append(Level(material))
            case "levels", []:
                names = dict.fromkeys(m.name for m in with_parts(scene.materials) if has_level(m))
                found += [Level(name) for name in names]
            case kind, [shape] if kind in DEFORMATIONS:
                found.append(Deformation(kind, shape))
            case kind, [material] if kind in PROPERTIES:
                found.append(Property(kind, material))
            case "shift", [shape, axis] if axis in AXES and axis:
                found.append(Shift(shape, axis))
            case _:
                raise SceneError(
                    f"parameter {word!r} is not one of gain, clock_offset, track:KNOTS[:AXES], level:MATERIAL, "
                    f"levels, {', '.join(f'{k}:MATERIAL' for k in PROPERTIES)}, shift:SHAPE:AXIS, "
                    f"{', '.join(f'{k}:SHAPE' for k in DEFORMATIONS)}"
                )
    if not found:
        raise SceneError("parameters: none is given; name at least one, such as gain or levels")
    return tuple(found)
