"""Radar cross section over look directions: the trace kernel in the far field, without pulses or images.

A target has aspect angles, a centre, an outline, and a site from which its sources are made.
"""

import itertools
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import C128, F64, all_finite, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.catalog.max_depth import DEFAULT_DEPTH
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TOLERANCE_DB
from sarmitsuba.simulation.execution.blame import blame_stages, check_traced, find_blame
from sarmitsuba.simulation.execution.recording import Recording
from sarmitsuba.simulation.planning.sampling.density_plan import (
    CELLS_PER_RESOLUTION,
    FINE_RAYS,
    RAYS_PER_WAVELENGTH,
)
from sarmitsuba.simulation.planning.site import VIEW_TURN
from sarmitsuba.tracing.kernel.accumulators import SumAccumulator
from sarmitsuba.tracing.kernel.kernel import KernelSettings, trace
from sarmitsuba.tracing.kernel.launch import (
    LaunchFrame,
    LaunchGrid,
    PulseBatch,
    frame_towards,
    lattice,
    project,
)
from sarmitsuba.tracing.kernel.passage import Passage
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.kernel.source import Source, launches
from sarmitsuba.tracing.kernel.staged import through_stages
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.kernel.surfaces import Surfaces
from sarmitsuba.tracing.scatterers.sources import Site, passages_of

# lanes of one launch: few enough for progress to be seen, many enough that the launch itself costs nothing
MAX_LANES = 4_000_000
# bytes of a ray: its place while the lattice is sorted, and its lane
RAY_BYTES = 80
# default bound on the bounces, and number of directions used to determine how many are enough
MOST_DEPTH, PROBED = 256, 24
# rad: allowed phase error of the plane wave by rounding of the distance, and total error allowed for large targets
MOST_ROUNDING, MOST_PHASE_ERROR = 0.05, 0.5
# direction whose projection gives the x axes of the launch planes
_ALONG = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class RcsResult:
    """Scattering amplitudes over directions.

    Parameters
    ----------
    amplitude : (n_directions, n_orders, n_channels) complex128, m; ``|.|^2`` is the RCS in m^2. One order (the sum)
        unless orders were kept
    channels : labels of the last axis
    rays_per_direction : rays in the launch window
    ray_spacing : m, between them
    max_depth : bounces that were traced
    unfinished : (n_directions,) whether some ray was still active at the last bounce
    """

    amplitude: C128
    channels: tuple[str, ...]
    rays_per_direction: int
    ray_spacing: float
    max_depth: int
    unfinished: NDArray[np.bool_]

    def rcs_dbsm(self, channel: str | None = None) -> F64:
        """RCS (n_directions,) of all orders summed coherently, dB above 1 m^2."""
        i = self.channels.index(channel) if channel else 0
        total = np.abs(self.amplitude[:, :, i].sum(axis=1)) ** 2
        with np.errstate(divide="ignore"):
            return np.asarray(db_from_power(total))


@dataclass(frozen=True)
class BouncesLeft:
    r"""Truncation error by the number of bounces: relative energy of the bounces that are not traced.

    Of scattering amplitudes :math:`a_m` over some directions the larger of the shares

    .. math:: \frac{\sum |\sum_{m > n} a_m|^2}{\sum |\sum_m a_m|^2}, \quad
        \frac{\max |\sum_{m > n} a_m|^2}{\max |\sum_m a_m|^2}

    sums and maxima over the directions, of the channel where it is largest.

    Parameters
    ----------
    depth : number of bounces n after which it is below the tolerance; where there is none, the number traced in the
        search
    left_db : relative energy after as many bounces, dB; -inf for none
    enough : whether it is below the tolerance
    by_depth : relative energy after 0, 1, ... bounces, dB, of those traced in the search
    """

    depth: int
    left_db: float
    enough: bool
    by_depth: tuple[float, ...] = ()

    @staticmethod
    def of(
        traced: Callable[[int], C128],
        depth: int,
        tolerance_db: float = TOLERANCE_DB,
        most: int = MOST_DEPTH,
    ) -> "BouncesLeft":
        """Trace an increasing number of bounces until the remaining energy falls below a tolerance.

        Parameters
        ----------
        traced : scattering amplitudes (n_directions, depth, n_channels) of a few directions by bounce order
        depth : initial number of bounces; twice as many are traced at first
        tolerance_db : dB
        most : bound on the bounces
        """
        while True:
            depth = min(2 * depth, most)
            amplitude = traced(depth)
            left = np.cumsum(amplitude[:, ::-1], axis=1)[:, ::-1]  # of each order and all after it
            power = np.square(np.abs(left))
            with np.errstate(divide="ignore", invalid="ignore"):
                shares = [np.nan_to_num(over(power) / over(power)[0]) for over in (_energy, _strongest)]
                left_db = db_from_power(np.max(shares, axis=(0, 2)))
            # the last quarter shows that later bounces are negligible
            above = np.flatnonzero(left_db > tolerance_db)
            needed = int(above[-1]) + 1 if above.size else 1
            if needed <= (3 * depth) // 4:
                return BouncesLeft(needed, float(left_db[needed]), True, tuple(left_db.tolist()))
            if depth == most:
                return BouncesLeft(depth, float(left_db[-1]), False, tuple(left_db.tolist()))

    def after(self, followed: int) -> float:
        """Relative energy of the bounces after ``followed``, dB; of the last one that is known where it is less."""
        return self.by_depth[min(followed, len(self.by_depth) - 1)] if self.by_depth else math.nan

    def notes(self, name: str, followed: int) -> tuple[str, ...]:
        """Notes on a scene for which ``followed`` bounces are traced."""
        if self.enough and self.depth <= followed:
            return ()
        if self.enough:
            return (
                f"{name}: {followed} bounces are traced, and {self.depth} are significant; set max_depth to auto",
            )
        return (
            f"{name}: {followed} bounces are traced, and bounce {self.depth} still returns {self.left_db:.0f} dB of "
            "the total; set a higher max_depth, or give some surfaces a lossy material",
        )


def choose_probes(unfinished: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Directions from which the needed number of bounces is determined, among those with rays still active."""
    rows = np.flatnonzero(unfinished)
    return np.asarray(rows[:: -(-rows.size // PROBED)])


def _energy(power: F64) -> F64:
    return np.asarray(power.sum(axis=0))


def _strongest(power: F64) -> F64:
    return np.asarray(power.max(axis=0))


def _far_enough(radius: float, wavelength: float) -> float:
    """Distance, m, at which the wave is plane over a target of this radius and phases are not affected by rounding."""
    wavenumber = 2.0 * np.pi / wavelength
    # sagitta of the wave over the target is r^2 / 2R; two-way phase k r^2 / R
    plane = wavenumber * radius**2 / 1e-4
    if wavenumber * np.spacing(plane) < MOST_ROUNDING:
        return float(plane)
    # distance at which both errors are equal
    even = radius / np.sqrt(np.finfo(np.float64).eps)
    if 2.0 * wavenumber * radius**2 / even > MOST_PHASE_ERROR:
        raise RadarError(
            f"rcs: a target of {2.0 * radius:.3g} m is too large for phases at a wavelength of {wavelength:.3g} m; "
            "check that the model is in metres, take a smaller part, or give the distance of the antenna"
        )
    return float(even)


@exclusive
def monostatic_rcs(
    geometry: Geometry,
    materials: tuple[Material, ...],
    directions: ArrayLike,
    frequency: float,
    *,
    channels: tuple[str, ...] = ("HH", "VV"),
    ray_spacing: float = 0.0,
    max_depth: int = 0,
    distance: float = 0.0,
    keep_orders: bool = False,
    flags: KernelFlags | None = None,
    seed: int = 0,
    realisation: int = 0,
    cell: float = 0.0,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    days: float = 0.0,
    most_rays: int = FINE_RAYS,
    sources: Sequence[Source] = (),
    places: F64 | None = None,
    passages: Sequence[Passage] = (),
    progress: Progress = silent,
) -> RcsResult:
    """Monostatic scattering amplitudes (RCS) of a target over directions.

    Parameters
    ----------
    geometry, materials : the target, scene frame
    directions : (n, 3) unit vectors from the target to the radar
    frequency : Hz
    ray_spacing : m; 0 = wavelength / 4.5, wider where a direction would need more than ``most_rays``
    max_depth : most bounces; 0 = 8, and where paths are longer, as many as are significant (`BouncesLeft`) in some of
        the directions
    distance : m to the antenna; 0 = far enough for a plane wave (phase error over the target below 1e-4 rad; for
        targets of kilometres as small as rounding allows, at most 0.5 rad)
    keep_orders : keep bounce orders separately
    flags : effects; default all coherent ones that apply to the materials
    seed : shift and turn of the ray lattice, and the diffuse scatterers
    realisation : number of the independent lattice of this seed
    cell : m, edge of the cells that carry one diffuse scatterer; 0 = a third of the wavelength
    up : (3,) vertical reference of the polarisation, scene frame
    days : since the first pass
    most_rays : of one direction, where the ray spacing is automatic
    sources : of echoes other than surfaces, such as edges and wires
    places : (n, 3) m, positions of wires and volumes; the mesh may then be empty
    passages : objects that attenuate waves, such as volumes
    progress : called after every launch

    Raises
    ------
    RadarError
        The directions are not (n, 3) finite vectors, ``max_depth`` is negative, or the target is too large for the
        phases of a plane wave in float64.
    ResourceError
        The rays of one direction do not fit into memory.

    Notes
    -----
    Phase is referred to the centre of the target's bounds. Limitations are those of the kernel; edge diffraction is
    included only by the ``sources``.
    """
    wavelength = SPEED_OF_LIGHT / frequency
    depth = max_depth or DEFAULT_DEPTH
    if depth < 0:
        raise RadarError(f"max_depth = {max_depth} is below the bound 0; give the most bounces, or 0 for 8")
    look = _unit_rows(directions)
    around = geometry.bounds if geometry.n_faces or places is None else places
    center, outline = 0.5 * (around.min(axis=0) + around.max(axis=0)), geometry.bounds
    if places is not None:
        outline = np.concatenate([around, places])
    radius = max(
        0.5 * float(np.linalg.norm(np.ptp(outline, axis=0))), wavelength
    )  # a single scatterer has none
    far = distance or _far_enough(radius, wavelength)
    position = center + look * far
    frame = frame_towards(position, center, _ALONG)
    half = _window(geometry, position, frame)
    spacing = ray_spacing or max(
        wavelength / RAYS_PER_WAVELENGTH, float(np.sqrt(4.0 * half[0] * half[1] / most_rays))
    )
    n_rays = 4.0 * float(np.prod(half + spacing)) / spacing**2
    check_fits(
        f"rcs of a target of {2.0 * radius:.3g} m",
        int(min(RAY_BYTES * n_rays, 2.0**62)),
        f"{n_rays:.3g} rays {spacing:.3g} m apart need the most: leave ray_spacing out or set it wider, or check that "
        "the model is in metres",
    )
    grid = lattice(half[0] + spacing, half[1] + spacing, spacing, seed=seed, realisation=realisation)
    flags = flags or _flags_of(materials, channels, depth)
    scene = replace(
        build_trace_scene(geometry, materials, wavelength, places=places), passages=tuple(passages)
    )
    settings = KernelSettings(
        wavelength=wavelength,
        max_depth=depth,
        cell=cell or wavelength / 3.0,
        seed=seed,
        amplitude=far**2,
        reference_range=far,
        up=up,
        days=days,
    )
    per_launch = max(1, MAX_LANES // grid.n_rays)

    def traced(
        rows: NDArray[np.intp], depth: int, apart: bool, progress: Progress
    ) -> tuple[C128, NDArray[np.bool_]]:
        """Amplitudes of some directions, and whether some ray was still active at the last bounce."""
        n_orders, alive = depth if apart else 1, np.zeros(rows.size, dtype=bool)
        amplitude = np.empty((rows.size, n_orders, len(channels)), dtype=np.complex128)
        deep = replace(settings, max_depth=depth)
        for start in range(0, rows.size, per_launch):
            here = slice(start, min(start + per_launch, rows.size))
            pick = rows[here]
            batch = PulseBatch(
                position=position[pick],
                velocity=np.zeros_like(position[pick]),
                frame=LaunchFrame(frame.center[pick], frame.axis_x[pick], frame.axis_y[pick]),
            )
            accumulator = SumAccumulator(
                batch.n_pulses, len(channels), depth if apart else 0, wavelength, far
            )
            for launch in launches((Surfaces(), *sources), [grid], batch.n_pulses):
                kernel = Kernel.of(scene, launch.part.grid, batch, flags, deep)
                counts, _ = launch.record(kernel, Antenna(), accumulator)
                if launch.part.rays and flags.multi_bounce:
                    alive[here] = np.asarray(counts.hits).reshape(batch.n_pulses, -1).max(axis=1) >= depth
            sums = accumulator.grid().reshape(n_orders, len(channels), batch.n_pulses)
            if not all_finite(sums):
                _stop(scene, grid, batch, flags, deep, geometry, materials)
            amplitude[here] = np.moveaxis(sums, 2, 0)
            progress("trace", here.stop, rows.size, {})
        return amplitude, alive

    every = np.arange(look.shape[0])
    amplitude, alive = traced(every, depth, keep_orders, progress)
    if alive.any() and not max_depth:
        few = choose_probes(alive)
        left = BouncesLeft.of(lambda n: traced(few, n, True, silent)[0], depth)
        if left.depth > depth:
            depth = left.depth
            amplitude, alive = traced(every, depth, keep_orders, progress)
        if not left.enough:
            warnings.warn(left.notes("monostatic_rcs", depth)[0], SarmitsubaWarning, stacklevel=2)
    return RcsResult(amplitude, channels, grid.n_rays, spacing, depth, alive)


def _stop(
    scene: TraceScene,
    grid: LaunchGrid,
    batch: PulseBatch,
    flags: KernelFlags,
    settings: KernelSettings,
    geometry: Geometry,
    materials: tuple[Material, ...],
) -> None:
    """Raise the error about a launch with echoes that are not finite; see `check_traced`."""
    look = batch.position - batch.frame.center
    label = partial(_direction, unit_rows(look))
    lanes, n_channels = grid.n_rays * batch.n_pulses, len(flags.channels)

    def culprit(flags: KernelFlags = flags) -> str:
        kernel = Kernel.of(scene, grid, batch, flags, settings)

        def again(recording: Recording) -> None:
            _, state = trace(kernel, Antenna(), through_stages(kernel, recording))
            dr.eval(state, recording.memory)

        return find_blame(again, lanes, settings.max_depth, n_channels, scene, geometry, materials, label)

    blame_stages(flags, "rcs", lambda other: not culprit(other))
    check_traced(np.zeros(0, np.complex64), np.nan, "rcs", culprit)


def _direction(look: F64, number: int) -> str:
    """Text for a direction."""
    return "direction ({:.4f}, {:.4f}, {:.4f})".format(*look[number])


def _unit_rows(directions: ArrayLike) -> F64:
    """Directions as (n, 3) unit vectors."""
    look = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    if look.ndim != 2 or look.shape[1] != 3 or not np.isfinite(look).all():
        raise RadarError(f"directions have the shape {look.shape}; (n, 3) finite vectors are needed")
    return unit_rows(look)


def _window(geometry: Geometry, position: F64, frame: LaunchFrame) -> F64:
    """Half extents (2,) of the launch window that covers the bounds of the geometry from every position, m."""
    if not geometry.n_faces:
        return np.zeros(2)
    corners = np.array(list(itertools.product(*geometry.bounds.T)))
    half = np.zeros(2)
    for place, center, x, y in zip(position, frame.center, frame.axis_x, frame.axis_y, strict=True):
        one = LaunchFrame(center[None], x[None], y[None])
        half = np.maximum(half, np.abs(project(corners, place, one)).max(axis=0))
    return half


def _flags_of(materials: tuple[Material, ...], channels: tuple[str, ...], depth: int) -> KernelFlags:
    """Kernel flags with the coherent effects that apply to the materials."""
    slabs = any(m.thickness > 0.0 for m in materials)
    return KernelFlags(
        channels=channels,
        fresnel=not all(m.pec for m in materials),
        roughness=any(m.rms_height > 0 for m in materials),
        diffuse=False,
        depolarisation=False,
        polarised_diffuse=False,
        antenna_pattern=False,
        spreading=True,
        taper=False,
        multi_bounce=depth > 1 or slabs,
        slabs=slabs,
        transmission=slabs,
    )


# slant range over the radius of the target: focusing removes the curvature of the wave, which hardly changes aspects
FAR = 1000.0
# cells of a volume's scatterers over the diameter of the target
BODY_CELLS = 32.0


@dataclass(frozen=True, eq=False)
class Aspects:
    """Directions from the target to the radar.

    Parameters
    ----------
    azimuth, elevation : (n,) float64, rad
    """

    azimuth: F64
    elevation: F64

    @property
    def directions(self) -> F64:
        """Unit vectors (n, 3) from the target to the radar, scene frame."""
        c = np.cos(self.elevation)
        return np.stack([c * np.cos(self.azimuth), c * np.sin(self.azimuth), np.sin(self.elevation)], axis=1)

    @property
    def by_azimuth(self) -> bool:
        """Whether only the azimuth changes."""
        return bool(np.ptp(self.azimuth) > 0.0)

    @property
    def whole_circle(self) -> bool:
        """Whether the azimuths, evenly spaced, cover the full circle."""
        n, turn = self.azimuth.size, float(np.ptp(self.azimuth))
        return n > 2 and turn * n / (n - 1) >= 2.0 * np.pi * (1.0 - 1e-9)


def target_middle(scene: Scene) -> tuple[F64, float]:
    """Centre of all visible objects, (3,) m, scene frame, and radius of the sphere about them, m."""
    around = scene.geometry.bounds if scene.geometry.n_faces else scene.places
    center = 0.5 * (around.min(axis=0) + around.max(axis=0))
    outline = np.concatenate([scene.geometry.vertices, scene.places])
    return center, float(np.linalg.norm(outline - center, axis=1).max())


def outline_of(scene: Scene) -> F64:
    """Points (n, 3) that outline all visible objects, m, scene frame."""
    return np.concatenate([scene.geometry.vertices, scene.places])


class FarSite(Site):
    """Site of a turntable target: fully lit, unresolved, and seen from the far field at all aspects.

    Parameters
    ----------
    scene, flags : see :class:`Site`
    aspects : directions to the radar
    """

    def __init__(self, scene: Scene, flags: KernelFlags, aspects: Aspects) -> None:
        super().__init__(scene, flags)
        self.aspects = aspects

    @cached_property
    def trace_scene(self) -> TraceScene | None:
        """See :class:`Site`; built for the sources that need it."""
        return geometry_of(self.scene)

    @property
    def cells(self) -> tuple[float, float]:
        """See :class:`Site`: unresolved."""
        return np.inf, np.inf

    @property
    def distance(self) -> float:
        """See :class:`Site`: the far field."""
        return np.inf

    @property
    def cell_area(self) -> float:
        """See :class:`Site`: ten thousand scatterers in a volume as large as the target."""
        return (self.resolution / BODY_CELLS) ** 2

    @property
    def half_cell(self) -> float:
        """See :class:`Site`: unresolved."""
        return np.inf

    @property
    def spacing(self) -> float:
        """See :class:`Site`: pieces of lines are as short as they need to be."""
        return 0.0

    def towards(self, point: F64) -> F64:
        """See :class:`Site`: the aspects."""
        return self.aspects.directions

    @property
    def box(self) -> F64:
        """See :class:`Site`."""
        places = outline_of(self.scene)
        return np.stack([places.min(axis=0), places.max(axis=0)])

    @property
    def center(self) -> F64:
        """See :class:`Site`."""
        return target_middle(self.scene)[0]

    @cached_property
    def views(self) -> F64:
        """See :class:`Site`."""
        center, radius = target_middle(self.scene)
        look = self.aspects.directions
        turn = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(look, axis=0), axis=1))])
        wanted = np.linspace(0.0, turn[-1], max(3, 2 * int(turn[-1] / (2.0 * VIEW_TURN)) + 1))
        pick = np.searchsorted(turn, wanted - 1e-9)
        return np.asarray(center + look[pick] * max(FAR * radius, 1.0))

    @property
    def scatterer_cell(self) -> float:
        """See :class:`Site`."""
        return self.scene.settings.scatterer_cell or 0.5 * self.wavelength / CELLS_PER_RESOLUTION

    @property
    def resolution(self) -> float:
        """See :class:`Site`: as large as the target."""
        return 2.0 * target_middle(self.scene)[1]

    @property
    def block(self) -> int:
        """See :class:`Site`."""
        return 1

    def shares(self, points: F64) -> F64:
        """See :class:`Site`."""
        return np.ones(len(points))

    def light(self, points: F64) -> F64:
        """See :class:`Site`."""
        return np.ones(len(points))


def geometry_of(scene: Scene) -> TraceScene | None:
    """Mesh of a scene on the device, with attenuating volumes; None where there is neither."""
    passages = passages_of(scene)
    if not scene.geometry.n_faces and not passages:
        return None
    made = build_trace_scene(
        scene.geometry, scene.materials, scene.radar.waveform.wavelength, places=scene.places
    )
    return replace(made, passages=passages)
