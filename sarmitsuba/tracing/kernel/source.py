"""Sources of echoes: each records its own launches into the accumulator of a batch.

Surfaces are one (:mod:`sarmitsuba.tracing.kernel.surfaces`), whose rays are traced from hit to hit. The others are
scatterers at
known positions, traced directly to the antenna. The common one of these, :class:`PointSource`, has scatterers with a
closed form of the scattering amplitude, seen straight and, where wanted, by reflection in the ground below.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Protocol, runtime_checkable

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.closing import select_contribution
from sarmitsuba.tracing.kernel.intersector import leave_surface, query_ray
from sarmitsuba.tracing.kernel.kernel import TraceCounts
from sarmitsuba.tracing.kernel.leg import (
    Leg,
    LegMirror,
    Surroundings,
    antenna_basis,
    pattern_gain,
    straight_leg,
)
from sarmitsuba.tracing.kernel.propagation import antenna_of, hit_point, reflect_fields
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.stage import KernelRecording, apply_at_mirror
from sarmitsuba.tracing.kernel.staged import through_stages
from sarmitsuba.tracing.kernel.state import SCATTERER, Contribution, Kernel
from sarmitsuba.tracing.kernel.table_rows import MaterialRow, SlabRow

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.derivatives.leg_tangents import Shift
    from sarmitsuba.tracing.kernel.kernel import Accumulator, LaneArrays
    from sarmitsuba.tracing.kernel.launch import LaunchGrid, PulseBatch

# lanes of one launch; bounds its memory
MAX_LANES = 4_000_000
# two facets are coplanar where the sine of their angle and their distance (m) are less
SAME_PLANE = 1e-4


@dataclass(frozen=True, eq=False)
class Part:
    """Share of a source's echoes that one launch computes.

    Parameters
    ----------
    grid : lattice that gives the kernel's constants, and the rays where the source traces any
    first, count : range of the scatterers; not used for rays
    rays : number of rays traced from hit to hit for each pulse; 0 for scatterers traced directly to the antenna
    every_pulse : whether it is traced at every pulse also where a block of pulses shares one tracing
    """

    grid: LaunchGrid
    first: int
    count: int
    rays: int = 0
    every_pulse: bool = False


class Source(Protocol):
    """Kind of scatterers with the launches that compute their echoes."""

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        """Launches for a batch of pulses with these lattices."""

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        """Record one launch; the caller evaluates it. See :func:`sarmitsuba.tracing.kernel.kernel.trace`."""

    def at(self, wavelength: float) -> Source:
        """The same scatterers at another wavelength, m."""


@runtime_checkable
class DrawnSource(Protocol):
    """Source whose random numbers are drawn when it is made: no other realisation of them is traced.

    Attributes
    ----------
    mechanism : name of its echoes in labels
    drawn : name of the drawn scatterers, in the plural
    """

    mechanism: ClassVar[str]
    drawn: ClassVar[str]


@dataclass(frozen=True, eq=False)
class Launch:
    """One kernel launch: a source, and which part of it."""

    source: Source
    part: Part

    def record(
        self, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        """Record the part (see :meth:`Source.record`), with the stages of the active effects applied to every echo."""
        with KernelRecording(kernel.flags):
            return self.source.record(self.part, kernel, antenna, through_stages(kernel, accumulator))


def launches(sources: Sequence[Source], rays: Sequence[LaunchGrid], n_pulses: int) -> list[Launch]:
    """All launches of a batch of pulses with these lattices, source by source."""
    return [Launch(source, part) for source in sources for part in source.parts(rays, n_pulses)]


class Scatterers(ABC):
    """Scatterers at known positions, each with a closed form of its scattering amplitude.

    Attributes
    ----------
    n : number of scatterers
    mechanism : name of their echoes in labels
    owner, middle, face : by one of them labels find the shape of each: (n,) number of its target, of the kind's;
        (n, 3) m, point on the side of a face of a mesh; (n, 2) rows of two faces
    """

    n: int
    mechanism: ClassVar[str] = "scatterer"

    @abstractmethod
    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """Phase centre, float64, m, scene frame."""

    @abstractmethod
    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        """Square root of the bistatic RCS with its phase, m: ``q . S e``, about the phase centre.

        Parameters
        ----------
        index : of the scatterer
        incident, scattered : legs of the incident and of the scattered wave
        e, q : incoming field and receiving vector, scene frame (no conjugate); ``S`` is symmetric under exchange of
            both legs
        """

    def departure(
        self, index: mi.UInt32, point: mi.Vector3f, direction: mi.Vector3f, clearance: mi.Float
    ) -> mi.Vector3f:
        """Start of a shadow ray, m: slightly off the scatterer, along the leg."""
        return point + direction * clearance

    def nearer(self, index: mi.UInt32, incident: Leg, scattered: Leg) -> mi.Float | None:
        """Reduction of the echo's slant range against the phase centre, m; None: zero.

        Its phase is not contained in :meth:`amplitude`.
        """
        return None

    def shifts(
        self, kernel: Kernel, index: mi.UInt32, incident: Leg, scattered: Leg
    ) -> Sequence[Shift | None]:
        """Velocities and growths by the displacements of a kernel; empty: the scatterers stay at rest."""
        return ()

    def at(self, wavelength: float) -> Scatterers:
        """The same scatterers at another wavelength, m: itself, where the kernel's wavenumber is all that changes."""
        return self


@dataclass(frozen=True, eq=False)
class PointSource:
    r"""Echoes of scatterers with a closed form, straight and by reflection in the ground.

    .. math:: K g_t g_r \, \mathbf q \cdot S \mathbf e / (L_t L_r)

    with the lengths :math:`L_t, L_r` of both legs, each straight or reflected by the ground below the scatterer (image
    of the antenna, exact for plane ground). With one antenna the two paths with one leg over the ground have the same
    length.

    Parameters
    ----------
    scatterers : of the source
    max_order : 1: straight legs only; 2: also one leg over the ground; 3: also both legs

    Notes
    -----
    Ignores reflection by anything but the ground below, ground that is not plane between the scatterer and the point of
    reflection, coupling between scatterers, and the shadow that they cast.
    """

    scatterers: Scatterers
    max_order: int = 1

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        """Launches for a batch of pulses, as few as memory allows."""
        step = max(1, MAX_LANES // n_pulses)
        n = self.scatterers.n
        return [Part(rays[0], first, min(step, n - first)) for first in range(0, n, step)]

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        """See :class:`Source`."""
        pulses = kernel.pulses
        number = dr.arange(mi.UInt32, part.count * pulses.n_pulses)
        count = dr.opaque(mi.UInt32, part.count)
        pulse = number // count
        index = number - pulse * count + dr.opaque(mi.UInt32, part.first)
        point = self.scatterers.point(index)
        incident = self._legs(kernel, pulses, pulse, index, point)
        scattered = incident
        if pulses.receiver is not None:
            scattered = self._legs(kernel, pulses.receiver, pulse, index, point)
        returns = []
        for i, out in enumerate(incident):
            for j, home in enumerate(scattered):
                order = 1 + out.over_ground + home.over_ground
                if order > self.max_order or (pulses.receiver is None and j < i):
                    continue
                back = () if pulses.receiver is not None or i == j else ((home, out),)
                returns.append(
                    self._return(kernel, antenna, pulse, index, point, order, ((out, home), *back))
                )
        added = accumulator.begin()
        added, contributions = _add_echoes(accumulator, added, returns)
        return TraceCounts(dr.zeros(mi.UInt32, part.count * pulses.n_pulses), contributions), added

    def scatterers_of(self, part: Part) -> Scatterers:
        """The scatterers of a part."""
        return self.scatterers

    def at(self, wavelength: float) -> PointSource:
        """See :class:`Source`."""
        return replace(self, scatterers=self.scatterers.at(wavelength))

    def _legs(
        self,
        kernel: Kernel,
        pulses: PulseBatch,
        pulse: mi.UInt32,
        index: mi.UInt32,
        point: mi.Vector3d,
    ) -> list[Leg]:
        position, velocity = antenna_of(pulses, pulse)
        here = mi.Vector3f(point)

        def departure(to: mi.Vector3f) -> tuple[mi.Vector3f, mi.Bool]:
            start = self.scatterers.departure(index, here, to, kernel.constants.clearance)
            return start, mi.Bool(True)

        legs = [straight_leg(Surroundings.within(kernel), point, departure, position, velocity)]
        if self.max_order > 1:
            legs.append(self._reflect_by_ground(kernel, index, point, position, velocity))
        return legs

    def _reflect_by_ground(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        point: mi.Vector3d,
        position: mi.Vector3d,
        velocity: mi.Vector3d,
    ) -> Leg:
        """Leg reflected by the ground: the reflecting facet is searched from the facet below the scatterer."""
        clearance = kernel.constants.clearance
        down = mi.Vector3f(0.0, 0.0, -1.0)
        here = mi.Vector3f(point)
        below = _Ground.of(
            kernel, self.scatterers.departure(index, here, down, clearance), down, mi.Bool(True)
        )
        # two steps: on a slope the facet below the scatterer is not the reflecting one
        seen, found = below.found, below
        for _ in range(2):
            image = position - found.normal * (2.0 * dr.dot(position - found.point, found.normal))
            leg = image - point
            length = dr.norm(leg)
            to64 = leg / length
            to = mi.Vector3f(to64)
            start = self.scatterers.departure(index, here, to, clearance)
            before, found = found, _Ground.of(kernel, start, to, seen)
            seen = seen & found.found
        offset = dr.abs(dr.dot(found.point - before.point, before.normal))
        same = dr.dot(found.normal, before.normal) > 1.0 - 0.5 * SAME_PLANE**2
        seen &= same & (offset < mi.Float64(SAME_PLANE + 8.0 * mi.Float(clearance)))
        n64 = before.normal
        # antenna and scatterer both above the ground
        above = mi.Vector3d(start) - before.point
        seen &= (dr.dot(position - before.point, n64) > 0.0) & (dr.dot(above, n64) > 0.0)
        there = point + to64 * (dr.dot(before.point - point, n64) / dr.dot(to64, n64))
        leg_out = position - there
        outer = dr.norm(leg_out)
        to_antenna = mi.Vector3f(leg_out / outer)
        n = mi.Vector3f(n64)
        departure = leave_surface(mi.Vector3f(there), n, -to_antenna, clearance)
        around = Surroundings.within(kernel)
        seen &= around.free(departure, to_antenna, mi.Float(outer), mi.Bool(True))
        basis = antenna_basis(around, to_antenna)
        fields, first = around.passed(departure, to_antenna, mi.Float(outer), seen, basis)
        reflection = reflect_fields(
            kernel, -to_antenna, n, found.properties, found.slab, dr.dot(found.own, n64) < 0.0, fields
        )
        fields = apply_at_mirror(kernel, found.properties, dr.dot(to_antenna, n), reflection.fields)
        fields, second = around.passed(start, to, mi.Float(length - outer), seen, fields)
        for along, shift in ((to_antenna, first), (to, second)):
            if shift is not None:  # the delay; the lateral shift changes only the range rate
                length = length + dr.dot(mi.Vector3d(along), mi.Vector3d(shift))
        image_velocity = velocity - n64 * (2.0 * dr.dot(velocity, n64))
        rate = dr.dot(to64, image_velocity)
        across = (image_velocity - to64 * rate) / length
        ground = LegMirror(before.face, before.point, n64, position - before.point, velocity)
        return Leg(to64, to, -to_antenna, length, rate, seen, fields[0], fields[1], across, ground)

    def _return(
        self,
        kernel: Kernel,
        antenna: Antenna,
        pulse: mi.UInt32,
        index: mi.UInt32,
        point: mi.Vector3d,
        order: int,
        pairs: Sequence[tuple[Leg, Leg]],
    ) -> Contribution:
        """One contribution: the sum over all paths of equal length (each leg straight or over the ground)."""
        flags, constants = kernel.flags, kernel.constants
        out, home = pairs[0]
        loss = constants.spreading_loss(out.length, home.length)
        amplitudes = [mi.Complex2f(0.0)] * len(flags.channels)
        for incident, scattered in pairs:
            gain = pattern_gain(kernel, antenna, pulse, incident.leaving, scattered.leaving)
            factor = constants.amplitude * loss * gain
            for i, channel in enumerate(flags.channels):
                e, q = incident.sent(channel[0]), scattered.sent(channel[1])
                value = self.scatterers.amplitude(kernel, index, incident, scattered, e, q)
                amplitudes[i] = amplitudes[i] + value * factor
        slant_range = 0.5 * (out.length + home.length)
        nearer = self.scatterers.nearer(index, out, home)
        if nearer is not None:
            slant_range = slant_range - mi.Float64(nearer)
        echo = Contribution(
            kind=mi.UInt32(SCATTERER),
            order=mi.UInt32(order),
            pulse=pulse,
            slant_range=slant_range,
            range_rate=0.5 * (out.rate + home.rate),
            amplitudes=tuple(amplitudes),
            active=out.seen & home.seen,
            point=point,
        )
        shifts = partial(self.scatterers.shifts, kernel, index, out, home)
        return derivatives_of(kernel).at_echo(kernel, antenna, echo, (out, home), shifts)

    @property
    def unknown(self) -> frozenset[str]:
        """Kinds of parameters whose derivatives are not known: the materials of the ground, where legs go over it."""
        return frozenset({"materials"} if self.max_order > 1 else ())


@dataclass(frozen=True, eq=False)
class _Ground:
    """First hit of a ray from a scatterer: point, normal facing the ray, the facet's normal (float64), material."""

    found: mi.Bool
    face: mi.UInt32
    point: mi.Vector3d
    normal: mi.Vector3d
    own: mi.Vector3d
    properties: MaterialRow
    slab: SlabRow | None

    @staticmethod
    def of(kernel: Kernel, start: mi.Vector3f, direction: mi.Vector3f, active: mi.Bool) -> _Ground:
        scene = kernel.scene
        found = scene.mi_scene.ray_intersect_preliminary(
            query_ray(start, direction), coherent=True, active=active
        )
        valid = active & found.is_valid()
        p, own, vertex0, _ = hit_point(scene, found.prim_index, found.prim_uv, valid)
        n64 = dr.select(dr.dot(own, mi.Vector3d(direction)) > 0.0, -own, own)
        bits = scene.material_of(found.prim_index, valid)
        bits = scene.material_at(found.prim_index, bits, mi.Vector3f(p - vertex0), valid)
        material = bits & MATERIAL_MASK
        properties = MaterialRow.of(scene.material_table, material, valid)
        row = None
        if scene.slabs is not None:
            row = SlabRow.of(scene.slabs.table, material, valid)
        return _Ground(valid, found.prim_index, p, n64, own, properties, row)


def _add_echoes(
    accumulator: Accumulator, added: LaneArrays, returns: Sequence[Contribution]
) -> tuple[LaneArrays, mi.UInt32]:
    """Pass echoes to the accumulator in a loop (its code is in the kernel once); returns their number."""
    if len(returns) == 1:
        one = returns[0]
        return accumulator.add(added, one), dr.select(one.active, mi.UInt32(1), 0)

    def some_left(slot: mi.UInt32, count: mi.UInt32, added: LaneArrays) -> mi.Bool:
        return slot < len(returns)

    def add_next(
        slot: mi.UInt32, count: mi.UInt32, added: LaneArrays
    ) -> tuple[mi.UInt32, mi.UInt32, LaneArrays]:
        one, active = returns[0], returns[0].active
        for i, other in enumerate(returns[1:], 1):
            there = slot == i
            one, active = select_contribution(there, other, one), dr.select(there, other.active, active)
        one = replace(one, active=active)
        return slot + 1, count + dr.select(active, mi.UInt32(1), 0), accumulator.add(added, one)

    _, count, added = dr.while_loop(
        (mi.UInt32(0), mi.UInt32(0), added),
        some_left,
        add_next,
        labels=("slot", "count", "added"),
        label="returns",
        mode="symbolic",
    )
    return added, count
