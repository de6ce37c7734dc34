"""Scatterers of extensions' kinds, traced directly to the antenna, straight and over the ground."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.registry import Calling, checked_type
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.scatterers import ScattererKind
from sarmitsuba.tracing.kernel.device_arrays import device_array, vector_rows
from sarmitsuba.tracing.kernel.source import Scatterers

if TYPE_CHECKING:
    from sarmitsuba.scene.scatterers import ScattererTarget
    from sarmitsuba.tracing.kernel.field import ComplexVector
    from sarmitsuba.tracing.kernel.leg import Leg
    from sarmitsuba.tracing.kernel.state import Kernel


@dataclass(frozen=True)
class LocalWaves:
    """Incident and scattered wave at a scatterer, in the scatterer's axes.

    Parameters
    ----------
    wavenumber : rad/m, float32
    transmitter, receiver : unit vectors from the scatterer to both antennas, or their images in the ground, float32
    field : complex vector of the incident wave, real and imaginary part
    receiving : complex vector that the scattered field is received along (no conjugate)
    values : of the kind's parameters, float32
    """

    wavenumber: mi.Float
    transmitter: mi.Vector3f
    receiver: mi.Vector3f
    field: ComplexVector
    receiving: ComplexVector
    values: Mapping[str, mi.Float]

    @property
    def co_polar(self) -> mi.Complex2f:
        """Field along the receiving vector: a scatterer that keeps polarisation returns its amplitude times this."""
        (a, b), (c, d) = self.field, self.receiving
        return mi.Complex2f(dr.dot(a, c) - dr.dot(b, d), dr.dot(a, d) + dr.dot(b, c))


class Reflector(ScattererKind, ABC):
    """A kind of scatterers at known positions with a closed form.

    Notes
    -----
    Ignores mirrors other than the ground below, and the shadow that scatterers cast. Parameters may not be zero-sized
    arrays: every one of ``parameters`` is a number.
    """

    @abstractmethod
    def amplitude(self, waves: LocalWaves) -> mi.Complex2f:
        """Square root of the bistatic RCS with its phase, m: ``receiving . S field``.

        ``S`` must be symmetric under exchange of both antennas (reciprocity). No NumPy numbers: they cannot be mixed
        with arrays of a kernel.
        """


class Reflectors(Scatterers):
    """Scatterers of one kind.

    Parameters
    ----------
    kind : of all
    targets : where they stand
    weights : (n,) of their amplitudes
    owner : (n,) number of each among the targets of all extensions' kinds; None: in this order
    """

    def __init__(
        self,
        kind: Reflector,
        targets: Sequence[ScattererTarget],
        weights: F64,
        owner: NDArray[np.intp] | None = None,
    ) -> None:
        self.kind, self.n = kind, len(targets)
        self.owner = np.arange(self.n) if owner is None else owner
        self.positions = vector_rows(np.array([target.position for target in targets]))
        axes = np.array([target.axes.T.ravel() for target in targets], dtype=np.float32)
        self.axes = device_array(mi.Float, axes.ravel())
        self.weights = device_array(mi.Float, weights.astype(np.float32))
        self.values = {
            p.name: device_array(mi.Float, np.array([t.values[p.name] for t in targets], np.float32))
            for p in kind.parameters
        }

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """See :class:`Scatterers`."""
        return dr.gather(mi.Vector3d, self.positions, index)

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: ComplexVector,
        q: ComplexVector,
    ) -> mi.Complex2f:
        """See :class:`Scatterers`."""
        k = kernel.constants.wavenumber
        return self.scattered(k, index, (incident.to_antenna, scattered.to_antenna), e, q)

    def scattered(
        self,
        wavenumber: mi.Float,
        index: mi.UInt32,
        to_antennas: tuple[mi.Vector3f, mi.Vector3f],
        e: ComplexVector,
        q: ComplexVector,
    ) -> mi.Complex2f:
        """Scattering amplitude ``q . S e``, m, with unit vectors to both antennas; vectors in the scene frame."""
        axes = [dr.gather(mi.Vector3f, self.axes, index * 3 + i) for i in range(3)]

        def local(v: mi.Vector3f) -> mi.Vector3f:
            return mi.Vector3f(*(dr.dot(v, axis) for axis in axes))

        waves = LocalWaves(
            wavenumber,
            local(to_antennas[0]),
            local(to_antennas[1]),
            (local(e[0]), local(e[1])),
            (local(q[0]), local(q[1])),
            {name: dr.gather(mi.Float, column, index) for name, column in self.values.items()},
        )
        with Calling("kind of scatterer", self.kind, "amplitude"):
            found = checked_type(self.kind.amplitude(waves), mi.Complex2f, mi.Float)
        return mi.Complex2f(found) * dr.gather(mi.Float, self.weights, index)
