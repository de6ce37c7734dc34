"""Single paths of the trace kernel: slant range and amplitude of every bounce of every ray, nothing summed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64, U32
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.tracing.kernel.kernel import KernelSettings, trace
from sarmitsuba.tracing.kernel.launch import LaunchFrame, LaunchGrid, PulseBatch
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.kernel.state import Contribution, Kernel


@dataclass(frozen=True, eq=False)
class Paths:
    """Contributions of every ray.

    Parameters
    ----------
    slant_range : (max_order, n_rays) float64, m; NaN where there is no contribution of that order
    amplitude : (max_order, n_rays) complex64, of the one channel
    hits : (n_rays,) uint32 bounces of every ray
    """

    slant_range: F64
    amplitude: C64
    hits: U32

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(max_order, n_rays) True where a path closes to the antenna."""
        return np.isfinite(self.slant_range)


class RecordAccumulator:
    """Writes slant range and amplitude of the first channel of every lane's orders 1 ... ``max_order`` to memory.

    Attributes
    ----------
    slant_range : Dr.Jit float64, order after order, m; NaN where nothing came
    amplitude : Dr.Jit float32, the same with re and im
    """

    def __init__(self, max_order: int, n_lanes: int) -> None:
        self.max_order, self.n_lanes = max_order, n_lanes
        self.slant_range = dr.full(mi.Float64, float("nan"), max_order * n_lanes)
        self.amplitude = dr.zeros(mi.Float, 2 * max_order * n_lanes)
        dr.eval(self.slant_range, self.amplitude)

    def begin(self) -> tuple[Any, ...]:
        """Number of this lane."""
        return (dr.arange(mi.UInt32, self.n_lanes),)

    def add(self, state: tuple[Any, ...], contribution: Contribution) -> tuple[Any, ...]:
        """Store; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`. Orders above the highest are dropped."""
        order, first = contribution.order, contribution.amplitudes[0]
        kept = contribution.active & (order <= dr.opaque(mi.UInt32, self.max_order))
        row = (order - 1) * dr.opaque(mi.UInt32, self.n_lanes) + state[0]
        dr.scatter(self.slant_range, contribution.slant_range, row, kept)
        dr.scatter(self.amplitude, first.real, 2 * row, kept)
        dr.scatter(self.amplitude, first.imag, 2 * row + 1, kept)
        return state


def square_grid(
    half_x: float,
    half_y: float,
    spacing: float,
    *,
    turn: float = 0.0,
    shift: tuple[float, float] = (0.0, 0.0),
) -> LaunchGrid:
    """Square lattice through ``shift``, turned by ``turn`` (rad): the aligned one of a naive launch by default."""
    n = int(np.ceil(np.hypot(half_x, half_y) / spacing)) + 1
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    c, s = np.cos(turn), np.sin(turn)
    x, y = (i * c - j * s) * spacing + shift[0], (i * s + j * c) * spacing + shift[1]
    # a hair more: points on the rim of the window belong to it
    keep = (np.abs(x) <= half_x * (1.0 + 1e-9)) & (np.abs(y) <= half_y * (1.0 + 1e-9))
    return LaunchGrid(
        x[keep].astype(np.float32), y[keep].astype(np.float32), spacing, turn, half_x, half_y, 0.0
    )


def aimed_at(points: F64, position: F64) -> tuple[LaunchFrame, LaunchGrid]:
    """Launch plane and rays that pass exactly through given points, as exactly as float32 can.

    Parameters
    ----------
    points : (n, 3) float64, m, scene frame
    position : (3,) float64, m, antenna
    """
    center = points.mean(axis=0)
    sight = center - position
    sight /= np.linalg.norm(sight)
    axis_y = np.cross(sight, np.roll(np.eye(3)[int(np.argmin(np.abs(sight)))], 1))
    axis_y /= np.linalg.norm(axis_y)
    axis_x = np.cross(axis_y, sight)
    ray = points - position
    on_plane = ray * (((center - position) @ sight) / (ray @ sight))[:, None] + position - center
    x, y = (on_plane @ axis_x).astype(np.float32), (on_plane @ axis_y).astype(np.float32)
    reach = float(max(np.abs(x).max(), np.abs(y).max()))
    grid = LaunchGrid(x, y, 0.01 * max(reach, 1e-6), 0.0, reach, reach, 0.0)
    return LaunchFrame(center[None], axis_x[None], axis_y[None]), grid


def record_paths(
    geometry: Geometry,
    materials: tuple[Material, ...],
    position: F64,
    frame: LaunchFrame,
    grid: LaunchGrid,
    frequency: float,
    *,
    channel: str = "VV",
    max_depth: int = 2,
    flags: KernelFlags | None = None,
    scene: TraceScene | None = None,
) -> Paths:
    """Trace every ray of a grid from one antenna position and keep what each bounce returns.

    Parameters
    ----------
    geometry, materials : the target, scene frame
    position : (3,) float64, m, antenna
    frame, grid : launch plane and rays
    frequency : Hz
    channel : recorded
    max_depth : most bounces, all of them kept
    flags : effects; default all that the materials call for, without diffuse returns
    scene : built already, or None

    Notes
    -----
    Coherent returns only: a diffuse contribution of the same order would replace the coherent one. Amplitudes
    are those of a radar whose amplitude constant is 1: sqrt(sigma) over both legs.
    """
    ensure_backend()
    wavelength = SPEED_OF_LIGHT / frequency
    if flags is None:
        flags = coherent_flags(materials, (channel,), max_depth)
    if scene is None:
        scene = build_trace_scene(geometry, materials, wavelength)
    settings = KernelSettings(wavelength, max_depth, cell=1.0, seed=0, amplitude=1.0, reference_range=1.0)
    antenna = np.asarray(position, dtype=np.float64).reshape(1, 3)
    batch = PulseBatch(antenna, np.zeros((1, 3)), frame)
    accumulator = RecordAccumulator(max_depth, grid.n_rays)
    counts, state = trace(Kernel.of(scene, grid, batch, flags, settings), Antenna(), accumulator)
    dr.eval(counts.hits, state, accumulator.slant_range, accumulator.amplitude)
    lengths = accumulator.slant_range.numpy().reshape(max_depth, grid.n_rays)
    amplitude = accumulator.amplitude.numpy().view(np.complex64).reshape(max_depth, grid.n_rays)
    return Paths(lengths, amplitude, np.asarray(counts.hits.numpy()))


def coherent_flags(
    materials: tuple[Material, ...], channels: tuple[str, ...], max_depth: int, **changes: bool
) -> KernelFlags:
    """Effects that coherent returns of these materials need."""
    slabs = any(m.thickness > 0.0 for m in materials)
    switches: dict[str, Any] = {
        "fresnel": not all(m.pec for m in materials),
        "roughness": any(m.rms_height > 0 for m in materials),
        "diffuse": False,
        "depolarisation": False,
        "polarised_diffuse": False,
        "antenna_pattern": False,
        "taper": False,
        "multi_bounce": max_depth > 1 or slabs,
        "slabs": slabs,
        "transmission": slabs,
    }
    return KernelFlags(channels=channels, **(switches | changes))


__all__ = ["Paths", "RecordAccumulator", "aimed_at", "coherent_flags", "record_paths", "square_grid"]
