r"""Parameters of shapes: place, height, scale and rotation.

Velocities of the points of a shape that several values deform, at any values.

Every value displaces the shape as the values before it left it: the height of a shape that was scaled is that of the
scaled one, a rotation turns about the middle of the base at that time. With the affine map :math:`\mathbf p =
M(\mathbf v) \, \mathbf p_0 + \mathbf c(\mathbf v)` from the shape at the start,

.. math:: \dot{\mathbf p} = \dot M M^{-1} (\mathbf p - \mathbf c) + \dot{\mathbf c}

where the derivatives of the map by a value are central differences: exact for heights and scales, in which it is
linear, and to 2e-9 for rotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.analysis.label_sight import ground_shapes
from sarmitsuba.apps.fit.parameter import AXES, Derivatives, Parameter, quote_name
from sarmitsuba.core.arrays import C64, F64, I64, unit_rows
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.ground import ENDLESS_GROUND
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.derivatives.tangents import Displacement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.scene.geometry import Geometry
    from sarmitsuba.scene.scene import Scene


@dataclass(frozen=True)
class Shift(Parameter):
    """Translation of a shape, m, with its diffuse scatterers.

    Parameters
    ----------
    shape : name of the mesh
    axis : of the scene frame: ``x``, ``y`` or ``z``
    """

    direct = True
    shape: str
    axis: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"shift:{quote_name(self.shape)}:{self.axis}"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [m]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        mesh_of(scene, self.shape, self.label)
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        return move_mesh(scene, *self.moved(scene, values))

    def moved(self, scene: Scene, values: F64) -> tuple[int, F64, F64]:
        """See the base class."""
        step = np.zeros(3)
        step[AXES.index(self.axis)] = float(values[0])
        return mesh_of(scene, self.shape, self.label), np.eye(3), step

    def displacements(self, scene: Scene, face_mesh: I64) -> Sequence[Displacement]:
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

    direct = True
    kind: str
    shape: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"{self.kind}:{quote_name(self.shape)}"

    def _place(self, scene: Scene) -> tuple[int, F64, float]:
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
        _, _, height = self._place(scene)
        return np.array([{"height": height, "scale": 1.0, "rotation": 0.0}[self.kind]])

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        return move_mesh(scene, *self.moved(scene, values))

    def moved(self, scene: Scene, values: F64) -> tuple[int, F64, F64]:
        """See the base class."""
        mesh, base, height = self._place(scene)
        value = float(values[0])
        if self.kind == "rotation":
            c, s = np.cos(value), np.sin(value)
            gradient = np.array([[c - 1.0, -s, 0.0], [s, c - 1.0, 0.0], [0.0, 0.0, 0.0]])
        elif not value > 0.0:
            raise SceneError(f"parameter {self.label} = {value:g} must be above 0")
        else:
            gradient = self._gradient(height) * (value - (height if self.kind == "height" else 1.0))
        return mesh, np.eye(3) + gradient, -gradient @ base

    def _gradient(self, height: float) -> F64:
        """Velocity gradient, 1 per unit."""
        if self.kind == "height":
            return np.diag([0.0, 0.0, 1.0 / height])
        if self.kind == "scale":
            return np.eye(3)
        return np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def displacements(self, scene: Scene, face_mesh: I64) -> Sequence[Displacement]:
        """See the base class."""
        mesh, base, height = self._place(scene)
        gradient = self._gradient(height)
        rate = turn_rate(scene.geometry, mesh, gradient)
        return [Displacement(np.zeros(3), face_mesh == mesh, -gradient @ base, gradient, rate)]

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.displaced


# derivative of a unit normal over the velocity gradient, down to which a face does not turn: rounding of its corners
LEAST_TURN = 1e-4

# kinds of deformation and their units
DEFORMATIONS = {"height": "m", "scale": "1", "rotation": "rad"}


def turn_rate(geometry: Geometry, mesh: int, gradient: F64) -> float:
    """Largest derivative of a unit normal of a mesh whose points move with a velocity gradient, 1 per unit."""
    first, stop = geometry.mesh_face_offset[mesh : mesh + 2]
    a, b, c = np.moveaxis(geometry.vertices[geometry.faces[first:stop]], 1, 0)
    n = np.cross(b - a, c - a)
    n = unit_rows(n)
    pulled = n @ gradient
    rate = float(np.linalg.norm(pulled - n * np.sum(n * pulled, axis=1, keepdims=True), axis=1).max())
    return rate if rate > LEAST_TURN * float(np.abs(gradient).max()) else 0.0


def bodies(scene: Scene, label: str) -> tuple[str, ...]:
    """Names of all shapes that rise above the ground: every mesh of some height that labels do not call ground.

    Raises
    ------
    SceneError : there is none
    """
    geometry, found = scene.geometry, []
    ground = ground_shapes(scene, {})
    for mesh, name in enumerate(geometry.mesh_names):
        first, stop = geometry.mesh_face_offset[mesh : mesh + 2]
        height = np.ptp(geometry.vertices[geometry.faces[first:stop], 2]) if stop > first else 0.0
        if not ground[mesh] and height > 0.0:
            found.append(name)
    if not found:
        raise SceneError(f"parameter {label}: no shape rises above the ground; name a shape")
    return tuple(found)


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
        own = sorted(set(names) - {ENDLESS_GROUND})
        raise SceneError(f"parameter {label}: {problem}; there are {', '.join(own)}")
    return found[0]


def move_mesh(scene: Scene, mesh: int, matrix: F64, offset: F64) -> Scene:
    """The scene with the vertices p of one mesh at ``matrix p + offset``."""
    geometry = scene.geometry
    faces = geometry.faces.copy()
    first, stop = geometry.mesh_face_offset[mesh : mesh + 2]
    own, inverse = np.unique(faces[first:stop], return_inverse=True)
    corners = geometry.vertices[own]
    moved = corners @ matrix.T + offset
    # vertices shared with other meshes stay theirs
    faces[first:stop] = len(geometry.vertices) + inverse.reshape(-1, 3)
    vertices = np.concatenate([geometry.vertices, moved])
    return replace(scene, geometry=replace(geometry, vertices=vertices, faces=faces))


# step of the differences, relative to heights and scales, rad of rotations
STEP = 1e-4


@dataclass(frozen=True, eq=False)
class ComposedMoves:
    """Displacements by the parameters of a model, at some values of all of them.

    Parameters
    ----------
    start : scene as it is without values
    parameters, values : of the model, in the order in which they change the scene
    """

    start: Scene
    parameters: tuple[Parameter, ...]
    values: Sequence[F64]

    @cached_property
    def _meshes(self) -> list[int | None]:
        """Mesh that each parameter moves; None: none."""
        moved = [p.moved(self.start, v) for p, v in zip(self.parameters, self.values, strict=True)]
        return [None if one is None else one[0] for one in moved]

    def of(self, parameter: Parameter, scene: Scene, face_mesh: I64) -> Sequence[Displacement]:
        """Displacements by a parameter, whether or not of the model.

        Parameters
        ----------
        scene : with the values
        face_mesh : (n_faces,) mesh of each traced face
        """
        own = parameter.displacements(scene, face_mesh)
        if not isinstance(parameter, Deformation) or parameter not in self.parameters:
            return own
        number = self.parameters.index(parameter)
        chain = [k for k, mesh in enumerate(self._meshes) if mesh == self._meshes[number]]
        if all(np.array_equal(self.values[k], self.parameters[k].values(self.start)) for k in chain):
            return own
        return [self._compose_move(one, number, chain, scene) for one in own]

    def _compose_move(
        self, own: Displacement, number: int, chain: Sequence[int], scene: Scene
    ) -> Displacement:
        """A displacement by a parameter of a number, with those that move the same mesh."""
        mesh, value = self._meshes[number], float(self.values[number][0])
        assert mesh is not None
        alone = replace(self.start, geometry=_alone(self.start.geometry, mesh))
        parameter = self.parameters[number]
        step = STEP if isinstance(parameter, Deformation) and parameter.kind == "rotation" else STEP * value
        matrix, offset = self._map(alone, chain, number, value)
        above, below = (self._map(alone, chain, number, value + x) for x in (step, -step))
        gradient = (above[0] - below[0]) / (2.0 * step) @ np.linalg.inv(matrix)
        base = (above[1] - below[1]) / (2.0 * step) - gradient @ offset
        rate = turn_rate(scene.geometry, mesh, gradient)
        return replace(own, offset=base, gradient=gradient, turn_rate=rate)

    def _map(self, alone: Scene, chain: Sequence[int], number: int, value: float) -> tuple[F64, F64]:
        """Matrix and offset of the map of a scene of one mesh with another value of one parameter."""
        matrix, offset = np.eye(3), np.zeros(3)
        for k in chain:
            values = np.array([value]) if k == number else self.values[k]
            found = self.parameters[k].moved(alone, values)
            assert found is not None
            _, own, shift = found
            matrix, offset = own @ matrix, own @ offset + shift
            alone = self.parameters[k].changed(alone, values)
        return matrix, offset


def _alone(geometry: Geometry, mesh: int) -> Geometry:
    """Geometry of one mesh."""
    rows = slice(*geometry.mesh_face_offset[mesh : mesh + 2])
    used, faces = np.unique(geometry.faces[rows], return_inverse=True)
    return Geometry(
        geometry.vertices[used],
        faces.reshape(-1, 3).astype(np.int32),
        geometry.face_material[rows],
        geometry.face_group[rows],
        (geometry.mesh_names[mesh],),
        np.array([0, rows.stop - rows.start]),
    )
