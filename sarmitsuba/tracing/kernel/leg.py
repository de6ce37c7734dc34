"""Straight legs of a path between a scatterer and an antenna: occlusion, transmission, delay, polarisation and gain.

Used for hits of rays, scatterers with a closed form, pairs of diffuse scatterers and ideal points alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.polarisation import TRANSMITTED
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.antenna_weight import BeamPattern
from sarmitsuba.tracing.kernel.intersector import query_ray
from sarmitsuba.tracing.kernel.passage import pass_all
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import lets_waves_through
from sarmitsuba.tracing.scatterers.slabs.slab_passage import pass_leg

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.state import Kernel

    # start of a leg along a direction, m, and the lanes in which the scatterer has such a leg
    Departure = Callable[[mi.Vector3f], tuple[mi.Vector3f, mi.Bool]]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Objects that a leg may meet (facets, slabs, volumes), and the settings by which they act on it.

    Parameters
    ----------
    scene : facets, slabs and volumes
    wavenumber : rad/m
    clearance : m, distance off a facet at which a leg that leaves it starts
    up : vertical reference of the polarisation basis, scene frame
    visibility : whether facets occlude
    transmits : whether slabs transmit
    """

    scene: TraceScene
    wavenumber: mi.Float
    clearance: mi.Float
    up: mi.Vector3f
    visibility: bool
    transmits: bool

    @staticmethod
    def of(
        scene: TraceScene,
        flags: KernelFlags,
        wavelength: float,
        up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> Surroundings:
        """Surroundings outside of a kernel, at a wavelength, m."""
        transmits = lets_waves_through(scene.slabs, flags)
        if transmits and scene.slabs is not None:
            scene.slabs.prepare()
        return Surroundings(
            scene=scene,
            wavenumber=dr.opaque(mi.Float, 2.0 * np.pi / wavelength),
            clearance=dr.opaque(mi.Float, scene.clearance),
            up=mi.Vector3f(*(dr.opaque(mi.Float, x) for x in up)),
            visibility=flags.visibility,
            transmits=transmits,
        )

    @staticmethod
    def within(kernel: Kernel) -> Surroundings:
        """Surroundings of the legs of a kernel."""
        constants = kernel.constants
        return Surroundings(
            scene=kernel.scene,
            wavenumber=constants.wavenumber,
            clearance=constants.clearance,
            up=constants.up,
            visibility=kernel.flags.visibility,
            transmits=kernel.transmits,
        )

    @property
    def clear(self) -> bool:
        """Whether legs are not attenuated: no slab transmits and there is no volume."""
        return not self.scene.passages and not self.transmits

    def free(
        self, start: mi.Vector3f, direction: mi.Vector3f, distance: mi.Float, active: mi.Bool
    ) -> mi.Bool:
        """Lanes in which a straight leg is not occluded."""
        if not self.visibility:
            return mi.Bool(True)
        scene = self.scene.mi_scene
        if self.transmits:
            assert self.scene.slabs is not None
            walls = self.scene.slabs.walls
            if walls is None:
                return mi.Bool(True)
            scene = walls
        return ~scene.ray_test(query_ray(start, direction, distance), coherent=True, active=active)

    def passed(
        self,
        start: mi.Vector3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool,
        vectors: tuple[field.ComplexVector, ...],
        behind_slabs: mi.Bool | None = None,
    ) -> tuple[tuple[field.ComplexVector, ...], mi.Vector3f | None]:
        """Complex vectors at the start of a straight leg from those at its end, and the apparent shift of its end, m.

        Parameters
        ----------
        start, direction, distance : m, unit vector, m
        active : lanes that have the leg
        vectors : of waves along the leg, or receiving vectors: transmission is a symmetric dyad
        behind_slabs : lanes in which slabs may cross the leg; None: those of ``active``

        Returns
        -------
        vectors, shift : shift as of :func:`sarmitsuba.tracing.scatterers.slabs.slab_passage.pass_leg`; None where no
            slab transmits
        """
        vectors = pass_all(self.scene.passages, start, direction, distance, active, vectors)
        if not self.transmits:
            return vectors, None
        through = active if behind_slabs is None else behind_slabs
        return pass_leg(
            self.scene, self.wavenumber, self.clearance, start, direction, distance, through, vectors
        )


@dataclass(frozen=True, eq=False)
class LegMirror:
    """Mirror of a leg.

    Parameters
    ----------
    face : row of the scene's tables
    point, normal : float64, m, a point of it, and its unit normal
    antenna, velocity : float64, m and m/s, place of the antenna from the point, and its velocity
    """

    face: mi.UInt32
    point: mi.Vector3d
    normal: mi.Vector3d
    antenna: mi.Vector3d
    velocity: mi.Vector3d


@dataclass(frozen=True, eq=False)
class Leg:
    """Leg between a scatterer and an antenna, straight or over one mirror.

    Parameters
    ----------
    to_antenna64, to_antenna : unit vectors from the scatterer to the antenna or its image: to the apparent position
        (with the shift by slabs), and along the leg
    leaving : unit vector from the antenna along the leg
    length : float64, m, of the whole leg, with the delay in slabs
    rate : float64, m/s, its change
    seen : lanes in which the leg is not occluded
    h, v : complex vectors at the scatterer of a unit wave sent in H and V
    across : float64, 1/s, velocity of the antenna or its image across the leg, over its length
    mirror : None for a straight leg
    """

    to_antenna64: mi.Vector3d
    to_antenna: mi.Vector3f
    leaving: mi.Vector3f
    length: mi.Float64
    rate: mi.Float64
    seen: mi.Bool
    h: field.ComplexVector
    v: field.ComplexVector
    across: mi.Vector3d
    mirror: LegMirror | None = None

    @property
    def over_ground(self) -> bool:
        """Whether the leg has a mirror."""
        return self.mirror is not None

    def sent(self, letter: str) -> field.ComplexVector:
        """Field at the scatterer of a unit wave sent in a polarisation of the transmitter."""
        if letter in "HV":
            return self.h if letter == "H" else self.v
        z_h, z_v = TRANSMITTED[letter]
        return field.add(_times(z_h, self.h), _times(z_v, self.v))


def _times(z: complex, x: field.ComplexVector) -> field.ComplexVector:
    return x[0] * z.real - x[1] * z.imag, x[1] * z.real + x[0] * z.imag


def straight_leg(
    around: Surroundings,
    point: mi.Vector3d,
    departure: Departure,
    position: mi.Vector3d,
    velocity: mi.Vector3d,
) -> Leg:
    """Straight leg between a scatterer and an antenna.

    Parameters
    ----------
    around : objects that the leg may meet
    point : float64, m, phase centre of the scatterer
    departure : start of the leg, slightly off the scatterer
    position, velocity : float64, m and m/s, of the antenna; the velocity is relative to the scatterer
    """
    leg = position - point
    length = dr.norm(leg)
    to64 = leg / length
    to = mi.Vector3f(to64)
    start, seen = departure(to)
    seen = seen & around.free(start, to, mi.Float(length), seen)
    (h, v), shift = around.passed(start, to, mi.Float(length), seen, antenna_basis(around, to))
    if shift is not None:  # apparent position of the antenna
        leg = leg + mi.Vector3d(shift)
        length = dr.norm(leg)
        to64 = leg / length
    rate = dr.dot(to64, velocity)
    return Leg(to64, to, -to, length, rate, seen, h, v, (velocity - to64 * rate) / length)


def antenna_basis(around: Surroundings, to: mi.Vector3f) -> tuple[field.ComplexVector, field.ComplexVector]:
    """H and V vectors of the antenna in the direction ``to``, as complex vectors."""
    h, v = field.polarisation_basis(-to, around.up)
    none = dr.zeros(mi.Vector3f)
    return (h, none), (v, none)


def beam_patterns(
    kernel: Kernel, antenna: Antenna, pulse: mi.UInt32, first_leg: mi.Vector3f | None
) -> tuple[BeamPattern, BeamPattern] | None:
    """Patterns of the transmitting and of the receiving antenna; None where both are isotropic.

    ``first_leg`` : as in :class:`BeamPattern`
    """
    if not kernel.flags.antenna_pattern:
        return None
    pulses, receiver = kernel.pulses, kernel.pulses.receiver
    if receiver is None:
        both = BeamPattern(antenna, pulses, pulse, first_leg)
        return both, both
    # the synthesis of a block applies both antennas' azimuth patterns: no correction between the legs is needed
    return BeamPattern(antenna, pulses, pulse, None), BeamPattern(antenna, receiver, pulse, None)


def pattern_gain(
    kernel: Kernel, antenna: Antenna, pulse: mi.UInt32, out: mi.Vector3f, home: mi.Vector3f
) -> mi.Float:
    """Relative two-way amplitude of the antenna patterns, for the unit vectors along which both legs leave them."""
    beams = beam_patterns(kernel, antenna, pulse, out)
    return mi.Float(1.0) if beams is None else beams[0].one_way(out) * beams[1].received(home)
