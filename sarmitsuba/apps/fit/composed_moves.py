r"""Velocities of the points of a shape that several values deform, at any values.

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

import numpy as np

from sarmitsuba.apps.fit.parameter import Parameter
from sarmitsuba.apps.fit.shape_parameters import Deformation, turn_rate
from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.derivatives.tangents import Displacement

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
