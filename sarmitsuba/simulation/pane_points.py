"""Ideal points behind panes: what a straight way through slabs makes of their echoes."""

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

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PaneWay:
    """Ways between points and one antenna, out and home through whatever panes there are.

    Parameters
    ----------
    shift : (n, 3) float64, m, of the antenna as the point sees it
    to_antenna : (n, 3) unit vectors
    linear : of each linear channel, (n,) complex128: what it has of an ideal point of unit RCS
    """

    shift: F64
    to_antenna: F64
    linear: dict[str, NDArray[np.complex128]]

    @property
    def extra(self) -> F64:
        """(n,) m, by which a pulse finds the point farther off."""
        return np.asarray(np.einsum("ni,ni->n", self.shift, self.to_antenna))

    @staticmethod
    def of(
        trace_scene: TraceScene,
        wavelength: float,
        position: F64,
        antenna: F64,
        up: tuple[float, float, float],
    ) -> "PaneWay":
        """Follow the ways.

        Parameters
        ----------
        trace_scene : with panes
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
        none = dr.zeros(mi.Vector3f)
        vectors, shift = along(
            trace_scene,
            dr.opaque(mi.Float, 2.0 * np.pi / wavelength),
            dr.opaque(mi.Float, trace_scene.clearance),
            start,
            to,
            far,
            dr.full(mi.Bool, True, len(position)),
            ((h, none), (v, none)),
        )
        rows = [np.asarray(re, np.float64).T + 1j * np.asarray(im, np.float64).T for re, im in vectors]
        basis = dict(zip(RECEIVED, rows, strict=True))
        return PaneWay(
            np.asarray(shift, np.float64).T + np.zeros(position.shape),
            leg / distance[:, None],
            {a + b: np.einsum("ni,ni->n", basis[a], basis[b]) for a in RECEIVED for b in RECEIVED},
        )

    @staticmethod
    def joined(ways: Sequence["PaneWay"]) -> "PaneWay":
        """Ways of one after the other."""
        return PaneWay(
            np.concatenate([way.shift for way in ways]),
            np.concatenate([way.to_antenna for way in ways]),
            {name: np.concatenate([way.linear[name] for way in ways]) for name in ways[0].linear},
        )

    def channel(self, name: str) -> NDArray[np.complex128]:
        """What a channel has of an ideal point of unit RCS, (n,); see :func:`isotropic_response` without panes."""
        return np.asarray(sum(factor * self.linear[part] for factor, part in linear_parts(name)))


def panes_of(trace_scene: TraceScene | None, flags: KernelFlags, n_antennas: int) -> TraceScene | None:
    """The scene where its points are seen through panes, None where there are none or two antennas.

    Notes
    -----
    A point that two antennas see keeps hidden behind a pane: an ideal point has no bistatic polarisation.
    """
    if trace_scene is None or trace_scene.slabs is None or n_antennas > 1:
        return None
    return trace_scene if flags.transmission and flags.slabs and trace_scene.slabs.passes else None


__all__ = ["PaneWay", "panes_of"]
