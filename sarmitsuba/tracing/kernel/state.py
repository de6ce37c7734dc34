"""Data of the trace kernel: constants of a launch, values of a lane, state of the loop, a hit, a contribution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.tangents import (  # as the next
    EchoDerivative,
    KernelDerivatives,
    RayDerivative,
)
from sarmitsuba.tracing.kernel.field import ComplexVector
from sarmitsuba.tracing.kernel.movement import ShadowBoundary  # as the next
from sarmitsuba.tracing.kernel.tubes.tube import (
    TubeExtent,  # at run time: Dr.Jit reads the types of the loop's state
)
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import lets_waves_through

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.tracing.derivatives.tangents import LaneDerivative
    from sarmitsuba.tracing.kernel.antenna_weight import BeamPattern
    from sarmitsuba.tracing.kernel.launch import LaunchGrid, PulseBatch
    from sarmitsuba.tracing.kernel.movement import Movement
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.table_rows import MaterialRow, SlabRow
    from sarmitsuba.tracing.kernel.tubes.polygon import Bounds
    from sarmitsuba.tracing.kernel.tubes.tube import Patch

# a receiving vector: real, or complex behind slabs and volumes
Receiving: TypeAlias = "mi.Vector3f | ComplexVector"
# kinds of return, as numbers that a lane can carry
COHERENT, DIFFUSE, RECIPROCAL = range(3)
# reversed diffuse path to a separate receiver, and echo of a scatterer at a known position; 3: ideal point
REVERSED, SCATTERER = 4, 5
# above every finite float32
LARGEST = 3.4028235e38
# independent random numbers of a diffuse scatterer, at most
RANDOM_TERMS = 3
# hit number that means no hit
NO_HIT = 0xFFFFFFFF


@dataclass(frozen=True)
class KernelSettings:
    """Numerical settings of a launch, other than the switches of effects.

    Parameters
    ----------
    wavelength : m
    max_depth : most bounces
    cell : m, edge of a diffuse scatterer's cell
    seed : of the diffuse scatterers
    amplitude : factor on every contribution (the radar's amplitude constant, sqrt(W) m^2 per m)
    reference_range : m, length used for both legs where spreading is off
    up : (3,) vertical reference of the polarisation basis, scene frame
    days : since the first pass
    kept_up_to : largest phase difference of neighbouring rays, rad, at which terms of common sides of tubes are kept;
        None: as at the carrier
    term : number of the independent random numbers of diffuse scatterers that is one, the others of which are zero,
        without the random texture of surfaces: the powers of all ``RANDOM_TERMS`` add up to the mean power; None: all
        are drawn
    """

    wavelength: float
    max_depth: int
    cell: float
    seed: int
    amplitude: float
    reference_range: float
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    days: float = 0.0
    kept_up_to: float | None = None
    term: int | None = None


@dataclass(frozen=True, eq=False)
class Constants:
    """Settings as opaque Dr.Jit scalars: a new value does not compile a new kernel.

    Parameters
    ----------
    wavenumber : rad/m
    po_gain : factor of the coherent return, 2 sqrt(pi) / wavelength times the amplitude
    spreads : whether echoes are divided by the lengths of both legs. A number, not a switch in Python: it depends on
        the look, and a switch would compile a second kernel
    inverse_range2 : 1/m^2, of the reference range
    clearance : m, distance off a facet at which rays that leave it start
    turn : rotation of the launch lattice, rad
    others : as in :class:`KernelSettings`
    """

    wavenumber: mi.Float
    max_depth: mi.UInt32
    cell: mi.Float64
    seed: mi.UInt32
    amplitude: mi.Float
    po_gain: mi.Float
    spreads: mi.Bool
    inverse_range2: mi.Float
    clearance: mi.Float
    up: mi.Vector3f
    turn: mi.Float64
    days: mi.Float
    kept_up_to: mi.Float | None
    term: mi.UInt32 | None

    @classmethod
    def of(
        cls, settings: KernelSettings, flags: KernelFlags, scene: TraceScene, grid: LaunchGrid
    ) -> Constants:
        """Constants of a launch."""
        f32, f64, u32 = mi.Float, mi.Float64, mi.UInt32
        amplitude = dr.opaque(f32, settings.amplitude)
        wavelength = dr.opaque(f32, settings.wavelength)
        return cls(
            wavenumber=dr.opaque(f32, 2.0 * np.pi / settings.wavelength),
            max_depth=dr.opaque(u32, settings.max_depth),
            cell=dr.opaque(f64, settings.cell),
            seed=dr.opaque(u32, settings.seed & 0xFFFFFFFF),
            amplitude=amplitude,
            po_gain=(2.0 * float(np.sqrt(np.pi))) / wavelength * amplitude,
            spreads=dr.opaque(mi.Bool, flags.spreading),
            inverse_range2=dr.rcp(dr.opaque(f32, settings.reference_range**2)),
            clearance=dr.opaque(f32, scene.clearance),
            up=mi.Vector3f(*(dr.opaque(f32, x) for x in settings.up)),
            turn=dr.opaque(f64, grid.turn),
            days=dr.opaque(f32, settings.days),
            kept_up_to=None if settings.kept_up_to is None else dr.opaque(f32, settings.kept_up_to),
            term=None if settings.term is None else dr.opaque(u32, settings.term),
        )

    def spreading_loss(self, out: mi.Float64, home: mi.Float64) -> mi.Float:
        """Spherical spreading of the incident and of the scattered leg, 1/m^2, from their lengths, m."""
        return dr.select(self.spreads, mi.Float(1.0 / (out * home)), self.inverse_range2)


@dataclass(frozen=True, eq=False)
class Kernel:
    """Common inputs of all parts of one recorded kernel; its scene lacks the tables of effects that are off.

    ``derivatives`` : carried along the paths, see :mod:`sarmitsuba.tracing.derivatives.hooks`; None without parameters
    """

    scene: TraceScene
    grid: LaunchGrid
    pulses: PulseBatch
    flags: KernelFlags
    constants: Constants
    derivatives: KernelDerivatives | None = None

    @classmethod
    def of(
        cls,
        scene: TraceScene,
        grid: LaunchGrid,
        pulses: PulseBatch,
        flags: KernelFlags,
        settings: KernelSettings,
    ) -> Kernel:
        """Kernel of a launch with these settings."""
        scene = scene.with_tables(surfaces=flags.texture, movers=flags.motion, slabs=flags.slabs)
        if settings.term is not None and scene.surfaces is not None:
            scene = replace(scene, surfaces=scene.surfaces.without_texture())
        if scene.slabs is not None:
            scene.slabs.prepare()  # before anything is recorded
        return cls(scene, grid, pulses, flags, Constants.of(settings, flags, scene, grid))

    @property
    def curved(self) -> bool:
        """Whether curved mirrors are traced, behind which tubes spread differently from a point source."""
        return self.flags.multi_bounce and self.scene.curvature_table is not None

    @property
    def reciprocal_diffuse(self) -> bool:
        """Whether reciprocal diffuse paths, back through their chains of mirrors, are traced."""
        return self.flags.diffuse and self.flags.diffuse_double and self.flags.multi_bounce

    @property
    def transmits(self) -> bool:
        """Whether paths are transmitted through slabs, which needs the branching loop and the slabs' coefficients."""
        return self.flags.multi_bounce and lets_waves_through(self.scene.slabs, self.flags)

    @property
    def bistatic(self) -> bool:
        """Whether a separate antenna receives."""
        return self.pulses.receiver is not None

    @property
    def reversible(self) -> bool:
        """Whether a coherent path and the reversed one are two estimates of one return."""
        return self.flags.coherent and self.flags.multi_bounce


@dataclass(frozen=True, eq=False)
class Lane:
    """Values of a ray that stay the same over all its bounces.

    Parameters
    ----------
    pulse : number of the pulse in the batch
    antenna, velocity : of the receiving antenna at that pulse, m and m/s, scene frame
    transmitter, transmitter_velocity : of the transmitting antenna, likewise
    tube_area : m^2, cross-section of the tube at the launch plane
    inverse_start : 1/m, of the distance from the antenna to the launch plane
    tube_rate_a, tube_rate_b : m/s, change of the outgoing leg's range rate over the tube's two edges
    nudge : m, displacement of a ray that missed at a vertex, for a second try
    needs : m, lower and upper bound of the ray spacing needed by the faces that this ray samples
    serves : whether the ray gives echoes of its first hit, and of later ones
    weight : factor on the amplitudes of its echoes
    pattern : of the receiving antenna, None for an isotropic one
    time : s, float64, of the pulse, where the kernel depends on it; None: everything is as at time zero
    derivative : values for the derivatives along its path; None without parameters
    """

    pulse: mi.UInt32
    antenna: mi.Vector3d
    velocity: mi.Vector3d
    transmitter: mi.Vector3d
    transmitter_velocity: mi.Vector3d
    tube_area: mi.Float
    inverse_start: mi.Float
    tube_rate_a: mi.Float
    tube_rate_b: mi.Float
    nudge: mi.Vector3f
    needs: tuple[mi.Float, mi.Float]
    serves: tuple[mi.Bool, mi.Bool]
    weight: mi.Float
    pattern: BeamPattern | None
    time: mi.Float64 | None = None
    derivative: LaneDerivative | None = None


@dataclass(frozen=True, eq=False)
class LaunchPlace:
    """Place of a lane in its launch.

    Parameters
    ----------
    row : of the lane in the tables of the launch
    distance : float64, m, from the antenna to the launch plane
    axes : float64, unit vectors of the launch plane
    beam : of the transmitting antenna; None for an isotropic one
    """

    row: mi.UInt32
    distance: mi.Float64
    axes: tuple[mi.Vector3d, mi.Vector3d]
    beam: BeamPattern | None


@dataclass
class TubeSpread:
    """Growth of a tube's two edges per metre behind curved mirrors, from the unfolded length ``start`` on."""

    a: mi.Vector3f
    b: mi.Vector3f
    start: mi.Float64


@dataclass
class Mirror:
    """Facet of a ray's last reflection.

    Parameters
    ----------
    face : row of the scene's tables
    bits : of its own material, with those that mark edges between coplanar parts of the facet
    point : m, of reflection, from the triangle's vertex 0
    normal : facing the ray
    length : float64, m, unfolded path length to it
    flat : 1 on a flat facet, 0 on a curved surface (lanes keep no booleans in local memory)
    """

    face: mi.UInt32
    bits: mi.UInt32
    point: mi.Vector3f
    normal: mi.Vector3f
    length: mi.Float64
    flat: mi.UInt32

    @staticmethod
    def none() -> Mirror:
        """Value before the first reflection."""
        zero = dr.zeros(mi.Vector3f)
        return Mirror(mi.UInt32(0), mi.UInt32(0), zero, zero, mi.Float64(0.0), mi.UInt32(0))


@dataclass
class RayState:
    """Ray between two bounces: the state of the loop.

    Parameters
    ----------
    active, hits : lanes still traced, and their number of hits so far
    origin : m, scene frame
    direction : float64, mirrored exactly like the antenna
    virtual_antenna, virtual_velocity : transmitting antenna and its velocity, mirrored through the chain so far, whose
        mirrors may move
    virtual_receiver, virtual_receiver_velocity : separate receiving antenna, likewise; None without one, or without
        reversed paths
    edge_a, edge_b : m, tube cross-section at the launch plane, behind curved mirrors at the last hit
    spread : growth of the cross-section behind curved mirrors, None where there are none
    extent : of the tube, limited by the facets hit so far
    rim : shadow boundary of the lit area, None where nothing moves
    fields : of each tracked transmit polarisation, unit at launch
    contributions : number so far
    crossed : number of slabs that the path crossed; None where no slab transmits
    mirror : facet of the last reflection; None where paths and their reverses are not averaged
    trail : number given to the last hit by a follower, ``NO_HIT`` before the first; None without a follower
    derivative : of the path so far; None without parameters
    """

    active: mi.Bool
    hits: mi.UInt32
    origin: mi.Vector3f
    direction: mi.Vector3d
    virtual_antenna: mi.Vector3d
    virtual_velocity: mi.Vector3d
    virtual_receiver: mi.Vector3d | None
    virtual_receiver_velocity: mi.Vector3d | None
    edge_a: mi.Vector3f
    edge_b: mi.Vector3f
    spread: TubeSpread | None
    extent: TubeExtent
    shadow_boundary: ShadowBoundary | None
    fields: tuple[ComplexVector, ...]
    contributions: mi.UInt32
    crossed: mi.UInt32 | None = None
    mirror: Mirror | None = None
    trail: mi.UInt32 | None = None
    derivative: RayDerivative | None = None


@dataclass(frozen=True, eq=False)
class Hit:
    """Hit of a ray on a facet, and the leg from there to the antenna.

    Parameters
    ----------
    active : lanes that hit something
    first : lanes whose first hit this is
    order : number of this hit, from 1
    face : row of the scene's tables
    material, own_material : bits of the material at the hit, and of the face, regardless of maps
    largest_cell : m, of a diffuse scatterer on the face's piece of surface
    p : float64, m, intersection of the ray and the facet
    vertex0, centroid : float64, m, vertex 0 and middle of the triangle
    departure : m, start of the rays that leave the hit
    direction64, direction : of the ray, from the virtual antenna to the hit
    normal64, normal : facing the ray; ``behind`` where it is the reverse of the face's normal
    cos_incidence : > 0
    length, length_back : m, from the virtual antenna to here, and from here to the antenna
    to_antenna64, to_antenna : unit vector to the antenna
    sees : lanes in which the hit is visible from the antenna
    properties : row of the material: permittivity, rms height, cross-polar power ratio
    movement : of the face; None where nothing moves
    slab : row of `Slabs.table` of the material, None where slabs are left out
    met : lanes that hit something, whether or not this ray samples it
    before_facet : m along the ray, from the hit on a slab's face to the facet; None where hits lie on facets
    """

    active: mi.Bool
    first: mi.Bool
    order: mi.UInt32
    face: mi.UInt32
    material: mi.UInt32
    own_material: mi.UInt32
    largest_cell: mi.Float
    p: mi.Vector3d
    vertex0: mi.Vector3d
    centroid: mi.Vector3d
    departure: mi.Vector3f
    direction64: mi.Vector3d
    direction: mi.Vector3f
    normal64: mi.Vector3d
    normal: mi.Vector3f
    behind: mi.Bool
    cos_incidence: mi.Float
    length: mi.Float64
    length_back: mi.Float64
    to_antenna64: mi.Vector3d
    to_antenna: mi.Vector3f
    sees: mi.Bool
    properties: MaterialRow
    movement: Movement | None
    slab: SlabRow | None
    met: mi.Bool
    before_facet: mi.Float | None = None

    def without(self, lost: mi.Bool) -> Hit:
        """The hit without some lanes, whose rays end before it."""
        kept = ~lost
        order = dr.select(kept | ~self.active, self.order, self.order - 1)
        return replace(
            self, active=self.active & kept, sees=self.sees & kept, met=self.met & kept, order=order
        )


@dataclass(frozen=True, eq=False)
class TubeFootprint:
    """Footprint of the ray tube on the facet that was hit.

    Parameters
    ----------
    u, v : m, edges of the whole tube's footprint
    extent : of the tube, limited by the facets hit so far
    patch : area of its diffuse return, as a quadrilateral
    bounds : of the area of its coherent return, exact up to the facet's corners
    area : m^2, of the whole footprint
    loss, loss_reciprocal : 1/m^2, spreading loss of the straight and of the reciprocal return path, times the weight
    lost : lanes whose tube was spread by curved mirrors beyond ``WIDEST_SPREAD``; None without curved mirrors
    """

    u: mi.Vector3f
    v: mi.Vector3f
    extent: TubeExtent
    patch: Patch
    bounds: Bounds
    area: mi.Float
    loss: mi.Float
    loss_reciprocal: mi.Float
    lost: mi.Bool | None = None


@dataclass(frozen=True, eq=False)
class Reflection:
    """Direction and fields of the ray after reflection by the facet that was hit.

    ``conductor`` : every surface is a perfect conductor (effect `fresnel` off)
    """

    direction: mi.Vector3f
    fields: tuple[ComplexVector, ...]
    conductor: bool = False


@dataclass(frozen=True, eq=False)
class Closing:
    """Coherent return of the tube at a hit, before polarisation, which the stages of effects may change.

    Parameters
    ----------
    factor : 1/m^2 times the footprint's area and the radar's amplitude constant
    integral : of the phase over the lit share of the footprint, relative to its area; None: that share, as if the phase
        were constant
    slant_range, range_rate : float64, m and m/s, of the echo
    point : float64, m, scene frame, phase centre
    velocity, virtual_velocity : float64, m/s, of the antenna and of its image in the mirrors, relative to the lit patch
    changes : derivatives of ``integral`` by the deformations of shapes; empty without any
    """

    factor: mi.Float
    integral: mi.Complex2f | None
    slant_range: mi.Float64
    range_rate: mi.Float64
    point: mi.Vector3d
    velocity: mi.Vector3d
    virtual_velocity: mi.Vector3d
    changes: tuple[mi.Complex2f, ...] = ()


@dataclass(frozen=True, eq=False)
class Receiver:
    """Receiving polarisations (by letter) and one-way gain in the direction from a hit to the antenna."""

    basis: dict[str, Receiving]
    gain: mi.Float


@dataclass  # not frozen: result of a branch, which Dr.Jit writes to
class TubeReturn:
    """Coherent return of a tube at a hit, before polarisation.

    Parameters
    ----------
    counts : lanes in which it is not negligible
    weight : 1/m^2 times the lit area and the radar's amplitude constant, with the integral of the phase
    slant_range, range_rate : float64, m and m/s, of the echo
    point : float64, m, scene frame, phase centre
    derivative : of slant range and range rate; None without parameters
    """

    counts: mi.Bool
    weight: mi.Complex2f
    slant_range: mi.Float64
    range_rate: mi.Float64
    point: mi.Vector3d
    derivative: EchoDerivative | None = None

    @staticmethod
    def none(derivative: EchoDerivative | None) -> TubeReturn:
        """No return; ``derivative``: of none."""
        # opaque: Dr.Jit merges equal literals of two branches, and then finds none of them in scope
        zero, weight = mi.Float64(0.0), dr.opaque(mi.Float, 0.0)
        none, nowhere = mi.Complex2f(weight, weight), mi.Vector3d(0.0)
        return TubeReturn(mi.Bool(False), none, zero, zero, nowhere, derivative)


@dataclass
class Contribution:
    """One echo of one hit or scatterer.

    Parameters
    ----------
    kind : uint32, ``COHERENT``, ``DIFFUSE``, ``RECIPROCAL``, ``REVERSED`` or ``SCATTERER``
    order : uint32, number of bounces, from 1
    pulse : uint32, number in the batch
    slant_range : float64, m, absolute
    range_rate : float64, m/s, its derivative
    amplitudes : one complex float32 per channel, without the phase of the slant range
    active : lanes that have the echo
    point : float64, m, scene frame; phase centre on the surface of the hit
    derivative : of the echo; None without parameters
    """

    kind: mi.UInt32
    order: mi.UInt32
    pulse: mi.UInt32
    slant_range: mi.Float64
    range_rate: mi.Float64
    amplitudes: tuple[mi.Complex2f, ...]
    active: mi.Bool
    point: mi.Vector3d
    derivative: EchoDerivative | None = None

    @property
    def values(self) -> tuple[mi.Complex2f, ...]:
        """Amplitudes, then their derivatives as in :class:`EchoDerivative`."""
        changes = None if self.derivative is None else self.derivative.amplitudes
        return self.amplitudes + (changes or ())

    def with_values(self, values: tuple[mi.Complex2f, ...]) -> Contribution:
        """The echo with other :attr:`values`."""
        n, derivative = len(self.amplitudes), self.derivative
        if derivative is not None:
            derivative = replace(derivative, amplitudes=values[n:] or None)
        return replace(self, amplitudes=values[:n], derivative=derivative)

    @property
    def placed(self) -> mi.Bool:
        """Lanes whose slant range, range rate and phase centre are finite."""
        fine = mi.Bool(True)
        for x in (self.slant_range, self.range_rate, *self.point):
            fine &= dr.abs(x) <= LARGEST
        return fine

    @property
    def finite(self) -> mi.Bool:
        """Lanes whose amplitudes are finite too."""
        fine = self.placed
        for a in self.amplitudes:
            fine &= (dr.abs(a.real) <= LARGEST) & (dr.abs(a.imag) <= LARGEST)
        return fine
