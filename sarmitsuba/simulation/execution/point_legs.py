"""Legs between ideal points and antennas, with occlusion and transmission, for every method."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import C128, F64, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.radar.polarisation import RECEIVED, isotropic_response, linear_parts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw.sub_bands import SubBands
from sarmitsuba.simulation.execution.off_surface import off_surfaces
from sarmitsuba.tracing.kernel.leg import Surroundings, antenna_basis, straight_leg
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.stage import changes_echoes
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import lets_waves_through


@dataclass(frozen=True, eq=False)
class PointLegs:
    """Straight legs between points and one antenna.

    Parameters
    ----------
    seen : (n,) float64, 1 where the leg is not occluded, else 0
    shift : (n, 3) float64, m, apparent shift of the antenna by slabs
    to_antenna : (n, 3) unit vectors
    waves : (n, 2, 2) complex128: H and V components (second axis) at the point of unit waves sent in H and V (first);
        the same for reception. None where legs are not attenuated
    """

    seen: F64
    shift: F64
    to_antenna: F64
    waves: C128 | None

    @property
    def delay(self) -> F64:
        """One-way delay (n,) of slabs, m."""
        return np.asarray(np.einsum("ni,ni->n", self.shift, self.to_antenna))

    @staticmethod
    def of(
        trace_scene: TraceScene | None,
        flags: KernelFlags,
        wavelength: float,
        position: F64,
        antenna: F64,
        up: tuple[float, float, float],
    ) -> "PointLegs":
        """Legs between points and an antenna, traced.

        A point on a surface is not occluded by the facets that it touches, see
        :func:`sarmitsuba.simulation.execution.off_surface.off_surfaces`; a point farther behind a surface is.

        Parameters
        ----------
        trace_scene : objects that may occlude; None: free space
        flags : whether slabs transmit; facets occlude points also with ``visibility`` off
        wavelength : m
        position, antenna : (n, 3) float64, m
        up : vertical reference of the polarisation
        """
        leg = antenna - position
        to_antenna = unit_rows(leg)
        none = np.zeros(position.shape)
        if trace_scene is None:
            return PointLegs(np.ones(len(position)), none, to_antenna, None)
        around = Surroundings.of(trace_scene, replace(flags, visibility=True), wavelength, up)
        begin = _device(mi.Vector3f, off_surfaces(trace_scene, position, to_antenna))

        def departure(to: mi.Vector3f) -> tuple[mi.Vector3f, mi.Bool]:
            return begin, dr.full(mi.Bool, True, len(position))

        places = [_device(mi.Vector3d, rows) for rows in (position, antenna)]
        found = straight_leg(around, places[0], departure, places[1], mi.Vector3d(0.0))
        seen = np.asarray(found.seen, dtype=np.float64)
        if around.clear:
            return PointLegs(seen, none, to_antenna, None)
        sent = np.stack([_rows(re) + 1j * _rows(im) for re, im in (found.h, found.v)])
        basis = np.stack([_rows(x) for x, _ in antenna_basis(around, found.to_antenna)])
        apparent = _rows(found.to_antenna64) * np.asarray(found.length)[:, None]
        return PointLegs(seen, apparent - leg, to_antenna, np.einsum("ani,pni->nap", sent + none, basis))

    @staticmethod
    def at(
        trace_scene: TraceScene | None,
        flags: KernelFlags,
        wavelength: float,
        time: F64,
        position: F64,
        antenna: F64,
        up: tuple[float, float, float],
    ) -> "PointLegs":
        """Legs (n,) at different times (n,), s, each with moving shapes at their positions at that time."""
        if trace_scene is None or trace_scene.movers is None:
            return PointLegs.of(trace_scene, flags, wavelength, position, antenna, up)
        each = [
            PointLegs.of(trace_scene.at(float(t)), flags, wavelength, p[None], a[None], up)
            for t, p, a in zip(time, position, antenna, strict=True)
        ]
        return PointLegs.joined(each)

    @staticmethod
    def joined(legs: Sequence["PointLegs"]) -> "PointLegs":
        """Concatenation of several sets of legs."""
        waves = [leg.waves for leg in legs if leg.waves is not None]
        return PointLegs(
            np.concatenate([leg.seen for leg in legs]),
            np.concatenate([leg.shift for leg in legs]),
            np.concatenate([leg.to_antenna for leg in legs]),
            np.concatenate(waves) if waves else None,
        )

    def channel(self, home: "PointLegs", name: str) -> C128:
        """Response (n,) of a channel to an ideal point of unit RCS (HH = VV = 1), by these legs and back by ``home``.

        As :func:`isotropic_response` in free space. 0 where the point is occluded.
        """
        seen = self.seen * home.seen
        if self.waves is None or home.waves is None:
            return np.asarray(seen * isotropic_response(name), dtype=np.complex128)
        both = np.einsum("nap,nbp->nab", self.waves, home.waves)
        parts = [f * both[:, RECEIVED.index(p[0]), RECEIVED.index(p[1])] for f, p in linear_parts(name)]
        return np.asarray(seen * sum(parts))


def takes_part(trace_scene: TraceScene | None, flags: KernelFlags) -> bool:
    """Whether slabs or volumes act on straight legs, or stages on echoes: at each frequency, and in every channel."""
    within = trace_scene is not None and (
        bool(trace_scene.passages) or lets_waves_through(trace_scene.slabs, flags)
    )
    return within or changes_echoes(flags)


def build_legs(
    scene: Scene, trace_scene: TraceScene | None, bands: SubBands
) -> tuple[TraceScene | None, ...]:
    """Geometry that acts on straight legs, with the materials at each traced frequency."""
    if bands.count == 1 or trace_scene is None:
        return (trace_scene,) * bands.count
    return tuple(
        trace_scene.at_frequency(tuple(m.at_frequency(f) for m in scene.materials), SPEED_OF_LIGHT / f)
        for f in bands.frequencies.tolist()
    )


def _device(kind: type, rows: F64) -> "mi.Vector3d":
    """Rows (n, 3) as a Dr.Jit vector."""
    number = mi.Float64 if kind is mi.Vector3d else mi.Float
    return kind(*(device_array(number, np.ascontiguousarray(row)) for row in rows.T))


def _rows(vector: "mi.Vector3f") -> F64:
    """Rows (n, 3) of a Dr.Jit vector."""
    return np.asarray(vector, np.float64).T
