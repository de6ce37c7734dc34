"""Ideal points behind panes and volumes: what stands in a straight way without stopping it makes of their echoes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import device_array, dr, mi
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.radar.polarisation import RECEIVED, linear_parts
from sarmitsuba.trace import field
from sarmitsuba.trace.geometry import TraceScene
from sarmitsuba.trace.panes import along
from sarmitsuba.trace.passage import passed

F64 = NDArray[np.float64]
C128 = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class PointWay:
    """Straight ways between points and one antenna, through whatever lets waves pass.

    Parameters
    ----------
    shift : (n, 3) float64, m, of the antenna as the point sees it
    to_antenna : (n, 3) unit vectors
    waves : (n, 2, 2) complex128: the H and V (second) that a point has of unit waves sent in H and V (first); likewise
        home
    """

    shift: F64
    to_antenna: F64
    waves: C128

    @property
    def extra(self) -> F64:
        """(n,) m, by which a pulse finds the point farther off."""
        return np.asarray(np.einsum("ni,ni->n", self.shift, self.to_antenna))

    @staticmethod
    def of(
        trace_scene: TraceScene,
        flags: KernelFlags,
        wavelength: float,
        position: F64,
        antenna: F64,
        up: tuple[float, float, float],
    ) -> "PointWay":
        """Follow the ways.

        Parameters
        ----------
        trace_scene : with panes or passages
        flags : whether panes let waves through
        wavelength : m
        position, antenna : (n, 3) float64, m
        up : vertical reference of the polarisation
        """
        leg = antenna - position
        distance = np.linalg.norm(leg, axis=1)
        origin, direction, (far,) = (
            [device_array(mi.Float, row.astype(np.float32)) for row in rows.T]
            for rows in (position, leg / distance[:, None], distance[:, None])
        )
        start, to = mi.Vector3f(*origin), mi.Vector3f(*direction)
        h, v = field.polarisation_basis(-to, mi.Vector3f(*up))
        none, shift = dr.zeros(mi.Vector3f), dr.zeros(mi.Vector3f)
        active = dr.full(mi.Bool, True, len(position))
        vectors = passed(trace_scene.passages, start, to, far, active, ((h, none), (v, none)))
        if trace_scene.slabs is not None and panes_pass(trace_scene, flags):
            trace_scene.slabs.prepare()
            vectors, shift = along(
                trace_scene,
                dr.opaque(mi.Float, 2.0 * np.pi / wavelength),
                dr.opaque(mi.Float, trace_scene.clearance),
                start,
                to,
                far,
                active,
                vectors,
            )
        sent = np.stack([_rows(re) + 1j * _rows(im) for re, im in vectors]) + np.zeros((1, len(position), 1))
        basis = np.stack([_rows(h), _rows(v)])
        return PointWay(
            _rows(shift) + np.zeros(position.shape),
            leg / distance[:, None],
            np.einsum("ani,pni->nap", sent, basis),
        )

    @staticmethod
    def joined(ways: Sequence["PointWay"]) -> "PointWay":
        """Ways of one after the other."""
        return PointWay(
            np.concatenate([way.shift for way in ways]),
            np.concatenate([way.to_antenna for way in ways]),
            np.concatenate([way.waves for way in ways]),
        )

    def channel(self, home: "PointWay", name: str) -> C128:
        """What a channel has of an ideal point of unit RCS (HH = VV = 1), (n,), out this way and home another.

        See :func:`isotropic_response` where nothing stands in the way.
        """
        both = np.einsum("nap,nbp->nab", self.waves, home.waves)
        parts = [f * both[:, RECEIVED.index(p[0]), RECEIVED.index(p[1])] for f, p in linear_parts(name)]
        return np.asarray(sum(parts))


def panes_pass(trace_scene: TraceScene, flags: KernelFlags) -> bool:
    """Whether waves go through any panes of a scene."""
    return flags.transmission and flags.slabs and trace_scene.slabs is not None and trace_scene.slabs.passes


def in_the_way(trace_scene: TraceScene | None, flags: KernelFlags) -> TraceScene | None:
    """The scene where something in it takes a part of the waves on straight ways, else None."""
    if trace_scene is None or not (trace_scene.passages or panes_pass(trace_scene, flags)):
        return None
    return trace_scene


def _rows(vector: "mi.Vector3f") -> F64:
    """(n, 3) of a vector of the device."""
    return np.asarray(vector, np.float64).T


__all__ = ["PointWay", "in_the_way", "panes_pass"]
